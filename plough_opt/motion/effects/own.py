"""Resistances of a user's own class, which enter the equation of motion like the built-in ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from types import BuiltinFunctionType, FunctionType
from typing import Any, Final, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_kind, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_casadi, is_quantity, map_expressions, template_of
from plough_opt.motion.effects.terms import Parameters, Place, Rates, Term, Towed

# Types whose repr is complete or holds their address in memory, so that different values print differently.
_DISTINCT = (str, bool, int, float, type(None), np.generic, Enum, type, FunctionType, BuiltinFunctionType, np.ufunc)
# Differences of travel [m] and speed [m/s] for slopes that only choose the number of steps.
_DIFFERENCE = 1e-4


@runtime_checkable
class OwnResistance(Protocol):
    """Resistance of the user's own, such as that of the shank: a frozen dataclass with this method.

    Its fields may be single numbers or expressions, tuples of them, text, switches or functions. Effects of one class
    are distinguished by their repr, so arrays and tables are not allowed. For example::

        @dataclass(frozen=True)
        class Shank:
            static: float
            viscous: float

            def force(self, travel, speed):
                return self.static + self.viscous * speed

    Example:
        >>> from dataclasses import dataclass
        >>> import plough_opt as po
        >>> @dataclass(frozen=True)
        ... class Shank:
        ...     static: float
        ...     def force(self, travel, speed):
        ...         return self.static + 0.0 * speed
        >>> isinstance(Shank(150.0), po.OwnResistance)
        True
    """

    def force(self, travel: Expression, speed: Expression) -> Expression:
        """Return the force [N] against the motion at a travel L [m] and a speed L' [m/s].

        Under `StickSlip` it acts while the share slips, and is zero in a gap, like the soil.

        Use arithmetic and the functions of `plough_opt.core.expressions` only, so that symbols work too.

        Example:
            >>> from dataclasses import dataclass
            >>> import plough_opt as po
            >>> @dataclass(frozen=True)
            ... class Shank:
            ...     static: float
            ...     viscous: float
            ...     def force(self, travel, speed):
            ...         return self.static + self.viscous * speed
            >>> Shank(150.0, 80.0).force(travel=0.0, speed=2.0)
            310.0
        """


OWN_EFFECTS: Final[dict[str, type[OwnResistance]]] = {}
"""Name in problem files -> class of an own effect. The metadata of a field gives its unit: {"unit": "N"}."""


@runtime_checkable
class RestingResistance(OwnResistance, Protocol):
    """Own resistance that also holds a resting share, as `StickSlip` requires."""

    def at_rest(self, travel: Expression) -> Expression:
        """Return the largest force [N] that holds a resting share at a travel L [m]; at least `force` at speed 0.

        Write it like `force`.
        """


def check_own(own: Any, resting: bool) -> None:
    """Check the own resistances of an `Effects`.

    Args:
        own: the value of its field ``own``.
        resting: whether the contact law lets a share rest, so that ``at_rest`` is required.

    Raises:
        InputError: they have the wrong type, a repr that may not be distinct, or no ``at_rest`` where it is required.
    """
    check_kind("own", own, tuple, "a tuple of effects, such as (Shank(150.0, 80.0),)")
    for effect in own:
        name = type(effect).__name__
        if isinstance(effect, type) or not (is_dataclass(effect) and isinstance(effect, OwnResistance)):
            raise InputError(
                f"own effect {shown(effect)} must be a frozen dataclass with a method force(travel, speed) in newtons"
            )
        if (found := _indistinct(effect)) is not None:
            raise InputError(
                f"own effect {name} holds {found}; effects are compared by their repr, which may be the same for two"
                " different values: use single numbers or tuples of them, and wrap a lookup table in a function, such"
                " as lambda travel: table(travel)"
            )
        if resting and not isinstance(effect, RestingResistance):
            raise InputError(
                f"own effect {name} does not define its force at rest: add a method at_rest(travel) that returns the"
                " largest force with which it holds a resting share (in a gap it is zero, like the soil), or use"
                " contact = 'resisting' or Smooth"
            )


def _indistinct(item: Any) -> str | None:
    """Return the type of a value, in an own effect, whose repr may not be distinct; None if there is none."""
    inner: Iterable[Any] = ()
    printed: object = type(item).__repr__  # Python's own shows the address in memory
    if is_dataclass(item) and not isinstance(item, type):
        inner = [getattr(item, each.name) for each in fields(item)]
    elif isinstance(item, Mapping):
        inner = item.values()
    elif isinstance(item, list | tuple):
        inner = item
    elif is_casadi(item):
        return None if item.numel() == 1 else f"a column of type {type(item).__name__}"
    elif not isinstance(item, _DISTINCT) and printed is not object.__repr__:
        return f"a value of type {type(item).__name__}"
    return next((found for each in inner if (found := _indistinct(each)) is not None), None)


@dataclass(frozen=True)
class Own(Term):
    """Own resistance with placeholders for its numbers.

    Attributes:
        number: its index among a scene's own effects.
        kind: its class.
        text: its repr with placeholders; all placeholders print alike.
        count: number of its numbers and expressions.
        template: the effect with placeholders.
    """

    number: int
    kind: type
    text: str
    count: int
    template: OwnResistance = field(compare=False)

    @classmethod
    def of(cls, scene: Towed) -> tuple[Own, ...]:
        templates = map(template_of, scene.effects.own)
        return tuple(cls(k, type(t), repr(t), len(quantities), t) for k, (t, quantities) in enumerate(templates))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"own_{self.number}_{k}" for k in range(self.count))

    def values(self, scene: Towed) -> dict[str, Expression]:
        return dict(zip(self.names, template_of(scene.effects.own[self.number])[1], strict=True))

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        own = at.of(lambda travel, speed: self.force(p, travel, speed))
        return own + force

    def hold(self, force: Expression, at: Place, p: Parameters) -> Expression:
        assert at.travel is not None  # None only describes steady sliding
        return force + self.at_rest(p, at.travel)

    def force(self, p: Parameters, travel: Expression, speed: Expression) -> Expression:
        """Return the resistance [N].

        Raises:
            InputError: the user's method returns neither a number nor an expression.
        """
        return self._call("force", p, travel, speed)

    def at_rest(self, p: Parameters, travel: Expression) -> Expression:
        """Return the largest force [N] with which it holds a resting share.

        Raises:
            InputError: the user's method returns neither a number nor an expression.
        """
        return self._call("at_rest", p, travel)

    def _call(self, method: str, p: Parameters, *at: Expression) -> Expression:
        """Return the value of a method of the user's class at a travel, and at a speed if it takes one."""
        values = (p[name] for name in self.names)
        effect: OwnResistance = map_expressions(self.template, lambda _: next(values))
        # In floats of Python a power that overflows, or a division by zero, would raise an error.
        given = [np.float64(x) if isinstance(x, float) else x for x in at]
        with np.errstate(all="ignore"):
            found: Expression = getattr(effect, method)(*given)
        if not (is_quantity(found) or isinstance(found, np.ndarray)) or _size(found) not in {1, *map(_size, at)}:
            raise InputError(
                f"{self.kind.__name__}.{method} returned {found!r}: an own effect must return its resistance [N], a"
                " number or an expression of travel and speed"
            )
        if isinstance(found, ca.DM) and not is_casadi(at[0]):
            # A CasADi function of an array, such as an interpolation table, returns a DM column.
            number = as_number(found)
            return float(number) if number.ndim == 0 else number
        return found

    @staticmethod
    def rates(p: Parameters) -> Rates:
        sliding = p.get("own_damping", 0.0)
        return Rates(p.get("own_stiffness", 0.0), sliding, p.get("own_steepest", 0.0) - sliding)


def _size(value: Expression) -> int:
    return math.prod(getattr(value, "shape", ()))


def slopes(own: Sequence[Own], p: Parameters) -> dict[str, float]:
    """Return the steepest slopes of own resistances by travel [N/m] and speed [N s/m], at speed 0 and the tow speed.

    "own_damping" is the slope by speed at the tow speed, as far as it is positive and so damps a sliding share.
    """
    found = {"own_stiffness": 0.0, "own_steepest": 0.0, "own_damping": 0.0}
    for speed in (0.0, float(as_number(p["tow_speed"]))):
        for name, dx, dv in (("own_stiffness", _DIFFERENCE, 0.0), ("own_steepest", 0.0, _DIFFERENCE)):
            ahead, behind = (sum(term.force(p, s * dx, speed + s * dv) for term in own) for s in (1.0, -1.0))
            slope = float(as_number(ahead - behind)) / (2.0 * _DIFFERENCE)
            if math.isfinite(slope):
                found[name] = max(found[name], abs(slope))
                found["own_damping"] = max(slope, 0.0) if dv else found["own_damping"]
    return found
