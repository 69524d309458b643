"""Resistances of a user's own class as part of the differential equation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from plough_opt.effects import OwnResistance
from plough_opt.expressions import Expression, map_expressions, template_of


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
        """Return the resistance [N] with the parameters of the own effect of that number."""
        values = (p[name] for name in self.names(number))
        effect: OwnResistance = map_expressions(self.template, lambda _: next(values))
        return effect.force(travel, speed)

    def names(self, number: int) -> list[str]:
        """Return the names of its parameters as the own effect of that number."""
        return [f"own_{number}_{k}" for k in range(self.count)]
