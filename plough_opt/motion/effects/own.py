"""Resistances of a user's own class, in the equation of motion like the built-in ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from types import BuiltinFunctionType, FunctionType
from typing import Any, Final, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import (
    Expression,
    as_number,
    is_casadi,
    is_quantity,
    map_expressions,
    template_of,
)
from plough_opt.motion.effects.term import Parameters, Place, Rates, Term, Towed

# What prints all that it is, or its own place in memory, beside single numbers and expressions.
_DISTINCT = (str, bool, int, float, type(None), np.generic, Enum, type, FunctionType, BuiltinFunctionType, np.ufunc)
# Differences of travel [m] and speed [m/s] by which slopes that only choose steps are measured.
_DIFFERENCE = 1e-4


@runtime_checkable
class OwnResistance(Protocol):
    """A resistance that the toolkit does not know, such as that of the shank: a frozen dataclass with this method.

    Its fields are what it needs: single numbers or expressions, tuples of them, text, switches or functions. Effects of
    one class are distinguished by their repr, so that arrays and tables are refused. For example::

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

        Written with arithmetic and the functions of `plough_opt.core.expressions`, so that it takes symbols.
        """


OWN_EFFECTS: Final[dict[str, type[OwnResistance]]] = {}
"""Name -> class of own effects that problem files may name; a field's metadata gives its unit: {"unit": "N"}."""


@runtime_checkable
class RestingResistance(OwnResistance, Protocol):
    """An own resistance that says what it is at rest too, as `StickSlip` needs it."""

    def at_rest(self, travel: Expression) -> Expression:
        """Return the largest force [N] that holds a resting share at a travel L [m], no less than `force` at no speed.

        Written like `force`.
        """


def check_own(own: Any, resting: bool) -> None:
    """Refuse own resistances of the wrong type, without a distinct repr, or without ``at_rest``.

    Args:
        own: of a scene's `Effects`.
        resting: whether the contact law needs to know what they are at rest.

    Raises:
        InputError: as said.
    """
    if not isinstance(own, tuple):
        raise InputError(f"own = {shown(own)} must be a tuple of effects, as (Shank(150.0, 80.0),)")
    for effect in own:
        name = type(effect).__name__
        if isinstance(effect, type) or not (is_dataclass(effect) and isinstance(effect, OwnResistance)):
            raise InputError(
                f"own effect {shown(effect)} must be a frozen dataclass with a method force(travel, speed) in newtons"
            )
        if (found := _indistinct(effect)) is not None:
            raise InputError(
                f"own effect {name} holds {found}, and effects are compared by their repr, which may be the same for"
                " another one: give single numbers, or tuples of them, and wrap a lookup table in a function, as"
                " lambda travel: table(travel)"
            )
        if resting and not isinstance(effect, RestingResistance):
            raise InputError(
                f"own effect {name} does not say what it is at rest or in a gap: give it a method at_rest(travel), the"
                " largest force that it holds a resting share with; it is then zero in a gap, like the soil; or take"
                " contact = 'resisting' or Smooth"
            )


def _indistinct(item: Any) -> str | None:
    """Return the type of something in an own effect that two different effects may print alike, if any."""
    inner: Iterable[Any] = ()
    if is_dataclass(item) and not isinstance(item, type):
        inner = [getattr(item, each.name) for each in fields(item)]
    elif isinstance(item, Mapping):
        inner = item.values()
    elif isinstance(item, list | tuple):
        inner = item
    elif is_casadi(item):
        return None if item.numel() == 1 else f"a column of type {type(item).__name__}"
    elif not isinstance(item, _DISTINCT) and not _prints_its_place(item):
        return f"a value of type {type(item).__name__}"
    return next((found for each in inner if (found := _indistinct(each)) is not None), None)


def _prints_its_place(item: Any) -> bool:
    """Return whether something prints by its place in memory, as objects do unless they say otherwise."""
    printed: object = type(item).__repr__
    return printed is object.__repr__


@dataclass(frozen=True)
class Own(Term):
    """An own resistance with placeholders for its quantities: what it contains, apart from numbers.

    Attributes:
        number: its place among a scene's own effects.
        kind: its class.
        text: how it prints with placeholders, which print alike.
        count: number of its quantities.
        template: itself, with placeholders.
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
        assert at.travel is not None  # a share at rest is somewhere
        return force + self.at_rest(p, at.travel)

    def force(self, p: Parameters, travel: Expression, speed: Expression) -> Expression:
        """Return the resistance [N].

        Raises:
            InputError: the user's class returns something else.
        """
        return self._value("force", p, travel, speed)

    def at_rest(self, p: Parameters, travel: Expression) -> Expression:
        """Return the largest force [N] that it holds a share at rest with.

        Raises:
            InputError: the user's class returns something else.
        """
        return self._value("at_rest", p, travel)

    def _value(self, method: str, p: Parameters, *at: Expression) -> Expression:
        """Return what a method of the user's class gives at travel, and at speed if it takes one."""
        values = (p[name] for name in self.names)
        effect: OwnResistance = map_expressions(self.template, lambda _: next(values))
        found: Expression = getattr(effect, method)(*at)
        if not (is_quantity(found) or isinstance(found, np.ndarray)) or _size(found) not in {1, *map(_size, at)}:
            raise InputError(
                f"{self.kind.__name__}.{method} returned {found!r}: an own effect returns its resistance [N], a number"
                " or an expression of travel and speed"
            )
        if isinstance(found, ca.DM) and not is_casadi(at[0]):
            # CasADi's own functions of an array, as a table is one, give a column.
            number = as_number(found)
            return float(number) if number.ndim == 0 else number
        return found

    @staticmethod
    def rates(p: Parameters) -> Rates:
        return Rates(stiffness=p.get("own_stiffness", 0.0), steepest=p.get("own_damping", 0.0))


def _size(value: Expression) -> int:
    return math.prod(getattr(value, "shape", ()))


def slopes(own: Sequence[Own], p: Parameters) -> dict[str, float]:
    """Return the steepest slopes of own resistances, by travel [N/m] and by speed [N s/m], at rest and at tow speed."""
    steepest = {"own_stiffness": 0.0, "own_damping": 0.0}
    for speed in (0.0, float(as_number(p["tow_speed"]))):
        for name, dx, dv in (("own_stiffness", _DIFFERENCE, 0.0), ("own_damping", 0.0, _DIFFERENCE)):
            with np.errstate(all="ignore"):
                ahead, behind = (sum(term.force(p, s * dx, speed + s * dv) for term in own) for s in (1.0, -1.0))
            slope = abs(float(as_number(ahead - behind))) / (2.0 * _DIFFERENCE)
            if math.isfinite(slope):
                steepest[name] = max(steepest[name], slope)
    return steepest
