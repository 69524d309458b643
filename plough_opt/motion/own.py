"""Resistances of a user's own class as part of the differential equation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_casadi, is_quantity, map_expressions, template_of
from plough_opt.motion.effects import OwnResistance


@dataclass(frozen=True)
class OwnTerm:
    """An own resistance with placeholders for its quantities: what it contains, apart from numbers.

    Attributes:
        kind: its class.
        text: how it prints with placeholders, which print alike.
        count: number of its quantities.
        template: itself, with placeholders.
    """

    kind: type
    text: str
    count: int
    template: OwnResistance = field(compare=False)

    @classmethod
    def of(cls, effect: OwnResistance) -> OwnTerm:
        """Read the term off a user's effect."""
        template, quantities = template_of(effect)
        return cls(type(effect), repr(template), len(quantities), template)

    def force(self, number: int, p: Mapping[str, Expression], travel: Expression, speed: Expression) -> Expression:
        """Return the resistance [N] with the parameters of the own effect of that number.

        Raises:
            InputError: the user's class returns something else.
        """
        return self._value("force", number, p, travel, speed)

    def at_rest(self, number: int, p: Mapping[str, Expression], travel: Expression) -> Expression:
        """Return the largest force [N] that it holds a share at rest with, with the parameters of that number.

        Raises:
            InputError: the user's class returns something else.
        """
        return self._value("at_rest", number, p, travel)

    def _value(self, method: str, number: int, p: Mapping[str, Expression], *at: Expression) -> Expression:
        """Return what a method of the user's class gives at travel, and at speed if it takes one."""
        values = (p[name] for name in self.names(number))
        effect: OwnResistance = map_expressions(self.template, lambda _: next(values))
        found = getattr(effect, method)(*at)
        travel, sizes = at[0], {1, *map(_elements, at)}
        if not (is_quantity(found) or isinstance(found, np.ndarray)) or _elements(found) not in sizes:
            raise InputError(
                f"{self.kind.__name__}.{method} returned {found!r}: an own effect returns its resistance [N], a number"
                " or an expression of travel and speed"
            )
        if isinstance(found, ca.DM) and not is_casadi(travel):
            # CasADi's own functions of an array, as a table is one, give a column.
            found = as_number(found)
            return float(found) if found.ndim == 0 else found
        return found

    def names(self, number: int) -> list[str]:
        """Return the names of its parameters as the own effect of that number."""
        return [f"own_{number}_{k}" for k in range(self.count)]


def _elements(value: Expression) -> int:
    return math.prod(getattr(value, "shape", ()))
