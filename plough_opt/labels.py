"""Values in somebody's graph that carry a meaning along, so that a design that holds them can find it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import casadi as ca

from plough_opt.expressions import Expression, is_symbolic


@dataclass(frozen=True)
class Label:
    """A call that returns its value unchanged, beside expressions that it carries along.

    Attributes:
        meaning: what the carried expressions are: any object that whoever looks for it knows.
        function: (value, carried expressions as a column) -> the same value.
    """

    meaning: object
    function: ca.Function


@dataclass(frozen=True)
class Limit:
    """A meaning: the carried expression must not exceed a number, or the labelled value has left its domain.

    Attributes:
        name: what the limited expression is, as a report names it.
        at_most: its largest value.
        unit: unit of both.
    """

    name: str
    at_most: float
    unit: str = ""


_BY_LAYOUT: dict[tuple[Hashable, tuple[int, int], int], Label] = {}
_KNOWN: dict[int, Label] = {}


def attach(value: Expression, carried: Expression, meaning: object, key: Hashable) -> Expression:
    """Return a value as it is; where value and carried expressions hold MX symbols, labelled in the graph.

    Args:
        value: what an expression is computed from.
        carried: a column of expressions that give the meaning its numbers.
        meaning: what they are.
        key: equal for equal meanings, which then share one Function.
    """
    if not (isinstance(value, ca.MX) and isinstance(carried, ca.MX) and is_symbolic(carried)):
        return value
    layout = (key, value.shape, carried.numel())
    if layout not in _BY_LAYOUT:
        x, c = ca.MX.sym("x", *value.shape), ca.MX.sym("c", carried.numel())
        function = ca.Function("label", [x, c], [x], ["value", "carried"], ["value_again"], {"never_inline": True})
        _BY_LAYOUT[layout] = _KNOWN[hash(function)] = Label(meaning, function)
    return _BY_LAYOUT[layout].function(ca.densify(value), carried)


def label_of(function: ca.Function) -> Label | None:
    """Return the label that a Function in a graph is, or None for any other Function."""
    return _KNOWN.get(hash(function))
