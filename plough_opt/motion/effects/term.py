"""Term of an effect in the equation of motion: the base class of all effects, including a user's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, cast

from plough_opt.core.expressions import Expression
from plough_opt.laws.law import SoilReaction
from plough_opt.soil.geometry import Cone

Parameters = Mapping[str, Expression]
"""Parameters of an equation of motion by name: numbers or symbols."""


class Towed(Protocol):
    """Attributes of a scene that effects read."""

    @property
    def effects(self) -> Any:
        """`Effects` of the scene."""

    @property
    def cone(self) -> Cone:
        """Equivalent cone of the share."""

    @property
    def reaction(self) -> SoilReaction:
        """Reaction of the soil."""


@dataclass(frozen=True)
class Changed:
    """A quantity as the sum of its value at the start and its change since then.

    It replaces an expression in the sums and products of resistances. Constant parts then cancel algebraically instead
    of in floating point.
    """

    first: Expression
    change: Expression

    def __add__(self, other: Expression) -> Changed:
        own = other if isinstance(other, Changed) else Changed(other, 0.0)
        return Changed(self.first + own.first, self.change + own.change)

    def __mul__(self, other: Expression) -> Changed:
        if not isinstance(other, Changed):
            return Changed(self.first * other, self.change * other)
        now = other.first + other.change
        return Changed(self.first * other.first, self.first * other.change + self.change * now)

    __radd__, __rmul__ = __add__, __mul__

    def squared(self) -> Changed:
        """Return the square."""
        return Changed(self.first**2, self.change * (2.0 * self.first + self.change))


class Place(NamedTuple):
    """Position and speed of a share.

    Attributes:
        travel: L [m]; None for a buried share that slides steadily through soil of the mean strength.
        speed: L' [m/s]; a `Changed` to compute the change of resistance since an equilibrium start.
    """

    travel: Expression | None
    speed: Any

    @property
    def squared_speed(self) -> Expression:
        """Square of the speed."""
        return cast(Expression, self.speed.squared() if isinstance(self.speed, Changed) else self.speed**2)

    def varying(self, value: Expression) -> Expression:
        """Return a quantity that averages to zero along the path, and so does not count at an equilibrium start."""
        return cast(Expression, Changed(0.0, value)) if isinstance(self.speed, Changed) else value

    def of(self, function: Callable[..., Expression]) -> Expression:
        """Return the value of a function of travel and speed."""
        if not isinstance(self.speed, Changed):
            return function(0.0 if self.travel is None else self.travel, self.speed)
        first = function(0.0, self.speed.first)
        change = function(self.travel, self.speed.first + self.speed.change) - first
        return cast(Expression, Changed(first, change))


class Rates(NamedTuple):
    """Slopes of an effect's force, from which the number of steps is chosen.

    Attributes:
        stiffness: steepest slope by travel [N/m].
        damping: slope by speed [N s/m] of a share that slides.
        steepest: slope by speed [N s/m] that occurs only at some speeds.
    """

    stiffness: Any = 0.0
    damping: Any = 0.0
    steepest: Any = 0.0


def peak_strength(p: Parameters) -> Any:
    """Return the ratio of the soil's greatest strength along the path to its mean."""
    return 1.0 + sum(value for name, value in p.items() if name.startswith("wave_amplitude"))


@dataclass(frozen=True)
class Term:
    """An effect in the equation of motion, without numbers. Methods that a class does not override have no influence.

    Attributes:
        label: its name in tables; "" for an effect that tables omit.
        field: the field of `Effects` that switches it on, or holds its only number.
        law: class of the field's value, with the parameters as its attributes, if the field may have values of others.
        names: names of its parameters.
        usual: realistic value of the field to try the effect with, or a function of a numeric scene and a duration [s].
        state: name of a state that is 0 until the effect is over and 1 afterwards; "" without one.
        kinked: whether the force has a kink that a share may reach, where steps of order 8 lose their order.
        events: whether it interrupts the motion by events that an integrator must locate.
    """

    label: ClassVar[str] = ""
    field: ClassVar[str] = ""
    law: ClassVar[type | None] = None
    usual: ClassVar[Any] = None
    state: ClassVar[str] = ""
    kinked: ClassVar[bool] = False
    events: ClassVar[bool] = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return ()

    @classmethod
    def of(cls, scene: Towed) -> Sequence[Term]:
        """Return the terms of a scene; none if the effect is off."""
        value = getattr(scene.effects, cls.field)
        on = value is not None and value is not False if cls.law is None else isinstance(value, cls.law)
        return (cls(),) if on else ()

    def values(self, scene: Towed) -> dict[str, Expression]:
        """Return the parameters of a scene by name."""
        value = getattr(scene.effects, self.field)
        return {name: value if self.law is None else getattr(value, name) for name in self.names}

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        """Return the resistance [N] with this effect, given that of all terms before it."""
        return force

    def hold(self, force: Expression, at: Place, p: Parameters) -> Expression:
        """Return the largest force [N] that holds a resting share, given that of all terms before it."""
        return self.resist(force, at, p)

    def pull(self, p: Parameters, rate: Expression) -> Expression:
        """Return the contribution to the mount force [N] at a rate z' of the deflection [m/s]."""
        return 0.0

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        """Return a value that becomes negative when the effect is over; for an effect with a `state`."""
        raise NotImplementedError

    @staticmethod
    def rates(p: Parameters) -> Rates:
        """Return the slopes of the force; all zero if the parameters of the effect are missing."""
        return Rates()

    @staticmethod
    def imposed(p: Parameters) -> Sequence[Any]:
        """Return the angular frequencies [rad/s] that the effect imposes on a share."""
        return ()


def resisted(terms: Sequence[Term], force: Any, at: Place, p: Parameters) -> Any:
    """Return the resistance [N] that terms, one after another, make of the static force."""
    for term in terms:
        force = term.resist(force, at, p)
    return force
