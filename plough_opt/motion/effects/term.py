"""How an effect enters the equation of motion: the base class of all of them, a user's own included."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, cast

from plough_opt.core.expressions import Expression
from plough_opt.laws.law import SoilReaction
from plough_opt.soil.geometry import Cone

Parameters = Mapping[str, Expression]
"""Numbers or symbols of an equation, by name."""


class Towed(Protocol):
    """The part of a scene that effects read."""

    @property
    def effects(self) -> Any:
        """Its `Effects`."""

    @property
    def cone(self) -> Cone:
        """Equivalent cone of the share."""

    @property
    def reaction(self) -> SoilReaction:
        """Resistance of the soil."""


@dataclass(frozen=True)
class Changed:
    """A quantity as its value at the start and the change since: what does not change cancels on paper.

    It takes the place of an expression in the sums and products of resistances.
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
    """Where a share is, and how fast.

    Attributes:
        travel: L [m]; None of a buried share that slides steadily, through soil of the mean strength.
        speed: L' [m/s]; as `Changed` where the resistance is wanted as its change from an equilibrium start.
    """

    travel: Expression | None
    speed: Any

    @property
    def squared_speed(self) -> Expression:
        """The share's speed, squared."""
        return cast(Expression, self.speed.squared() if isinstance(self.speed, Changed) else self.speed**2)

    def varying(self, value: Expression) -> Expression:
        """Return a quantity whose mean along the path is zero, and which an equilibrium start leaves out."""
        return cast(Expression, Changed(0.0, value)) if isinstance(self.speed, Changed) else value

    def of(self, function: Callable[..., Expression]) -> Expression:
        """Return a function of travel and speed."""
        if not isinstance(self.speed, Changed):
            return function(0.0 if self.travel is None else self.travel, self.speed)
        first = function(0.0, self.speed.first)
        change = function(self.travel, self.speed.first + self.speed.change) - first
        return cast(Expression, Changed(first, change))


class Rates(NamedTuple):
    """How an effect moves a share, for the choice of steps.

    Attributes:
        stiffness: steepest slope of its force by the travel [N/m], beside the mount's.
        damping: slope by the speed [N s/m], as long as the share slides.
        steepest: the same, that it only reaches somewhere.
    """

    stiffness: Any = 0.0
    damping: Any = 0.0
    steepest: Any = 0.0


_NOTHING = Rates()


@dataclass(frozen=True)
class Term:
    """An effect in the equation of motion, apart from numbers. What a class does not say leaves the equation alone.

    Attributes:
        label: its name in tables; "" for an effect that they leave out.
        field: of `Effects` that switches it on, or gives its only number.
        names: of its parameters.
        state: name of the state that is 0 until the effect is over, and then 1.
        kinked: whether it is not smooth where a share may come, so that steps of order 8 lose their order.
        events: whether it interrupts the motion by events, which an integrator must find.
    """

    label: ClassVar[str] = ""
    field: ClassVar[str] = ""
    state: ClassVar[str] = ""
    kinked: ClassVar[bool] = False
    events: ClassVar[bool] = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return ()

    @classmethod
    def of(cls, scene: Towed) -> Sequence[Term]:
        """Return the terms of a scene, none where the effect is off."""
        value = getattr(scene.effects, cls.field)
        return () if value is None or value is False else (cls(),)

    def values(self, scene: Towed) -> dict[str, Expression]:
        """Return its parameters in a scene, by name."""
        return {name: getattr(scene.effects, self.field) for name in self.names}

    @classmethod
    def usual(cls, scene: Any, duration: float) -> Any:
        """Return a strength of the order that a numeric scene calls for, to try the effect with."""
        raise NotImplementedError

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        """Return the resistance [N] with this effect, from that without it and those that follow."""
        return force

    def hold(self, force: Expression, at: Place, p: Parameters) -> Expression:
        """Return the largest force [N] that holds a share at rest, likewise."""
        return self.resist(force, at, p)

    def pull(self, p: Parameters, rate: Expression) -> Expression:
        """Return its part in the mount force [N], at a rate z' of the deflection [m/s]."""
        return 0.0

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        """Return what becomes negative when the effect is over, if it has a `state`."""
        raise NotImplementedError

    @staticmethod
    def rates(p: Parameters) -> Rates:
        """Return how it moves a share: of an effect whose parameters are not there, nothing."""
        return _NOTHING

    @staticmethod
    def imposed(p: Parameters) -> Sequence[Any]:
        """Return the angular frequencies [rad/s] that it imposes on a share."""
        return ()
