"""The table [measures]: results that a file defines as expressions of other results and quantities."""

import ast
import math
import operator
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, TypeAlias

import numpy as np

from plough_opt.core import expressions
from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import EVERY, QUANTITIES
from plough_opt.core.units import Unit, registry
from plough_opt.motion import Run
from plough_opt.motion.scene import quantity_of
from plough_opt.motion.vocabulary import MEASURES, Measure
from plough_opt.problem_file.schema import ProblemTable
from plough_opt.problem_file.source import Source

TABLE = "measures"
# Longer or more deeply nested expressions belong in a script.
_MAX_LENGTH: Final = 300
_MAX_DEPTH: Final = 20
# No physical result needs a higher power.
_MAX_POWER: Final = 8.0
# Type of an operator, or name of a function -> function from the values of the operands to the result.
_Rules: TypeAlias = dict[Any, Callable[..., Any]]
_ARITHMETIC: Final[_Rules] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
} | {name: getattr(expressions, name) for name in ("sqrt", "exp", "log", "absolute", "minimum", "maximum")}
_FUNCTIONS: Final = tuple(name for name in _ARITHMETIC if isinstance(name, str))
_EXAMPLE: Final = '"tow_power / (2 * loosened_radius)"'


@lru_cache(maxsize=128)
def defined_measure(text: str, unit: str) -> Measure:
    """Return a measure that an expression computes from other results and quantities.

    Args:
        text: an expression of results such as mean_draft and quantities such as share.height, with + - * / **, sqrt,
            exp, log, absolute, minimum and maximum.
        unit: unit of the result, "" if it is dimensionless.

    Raises:
        InputError: the text is not such an expression, a name is unknown, or the units do not agree.
    """
    if len(text) > _MAX_LENGTH:
        raise InputError(f"the expression has {len(text)} characters; at most {_MAX_LENGTH} can be read")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError):
        raise InputError(f"= {short(repr(text))} cannot be read: write an expression like {_EXAMPLE}") from None
    Unit(unit).split(f"1 {unit}")  # raises InputError for an unreadable unit
    parts = [MEASURES[name] for name in _checked_names(tree, text, unit) if name in MEASURES]

    def of(run: Run) -> Expression:
        def leaf(what: str | float) -> Expression:
            if isinstance(what, float):
                return what
            return MEASURES[what].of(run) if what in MEASURES else quantity_of(run.scene, what)

        try:
            with np.errstate(all="ignore"):
                value: Expression = _value(tree, leaf, _ARITHMETIC)
        except ArithmeticError:  # division by 0, overflow
            value = math.nan
        if isinstance(value, complex) or (isinstance(value, float) and not math.isfinite(value)):
            raise InputError(f"{short(repr(text))} has no finite value in this run: check divisions, roots, logs")
        return value

    needs = tuple(dict.fromkeys(what for one in parts for what in one.needs))
    return Measure(Unit(_si(unit)), of, needs, random=any(one.random for one in parts))


def _si(unit: str) -> str:
    """Return the SI unit of the same dimension, or the unit itself if its factor to SI is 1."""
    base = registry().Quantity(1.0, unit or "dimensionless").to_base_units()
    return unit if base.magnitude == 1.0 else f"{base.units:~C}"


def _checked_names(tree: ast.expr, text: str, unit: str) -> dict[str, None]:
    """Return the names of results and quantities in an expression, in order.

    Raises:
        InputError: a name is unknown, unlike units are added, or the result's unit differs from the stated one.
    """
    unit_of, names = registry().Unit, dict[str, None]()
    plain, zero = unit_of("dimensionless"), unit_of("dimensionless")  # a plain 0 has any unit

    def leaf(what: str | float) -> Any:
        if isinstance(what, float):
            return plain if what else zero
        single = [name for name, measure in MEASURES.items() if not measure.everywhere]
        if what not in single and what not in QUANTITIES:
            raise InputError(f"'{what}' has no single value to compute with: {nearest(what, [*single, *QUANTITIES])}")
        names[what] = None
        return unit_of((MEASURES[what].unit.symbol if what in MEASURES else QUANTITIES[what].unit) or "dimensionless")

    def alike(one: Any, other: Any = plain) -> Any:
        if one is zero or other is zero:
            return other if one is zero else one
        if one.dimensionality != other.dimensionality:
            raise InputError(f"= {short(repr(text))} combines unlike units, {one} and {other}")
        return one

    rules = dict.fromkeys((ast.Add, ast.Sub, "exp", "log", "minimum", "maximum"), alike)
    powers = {"sqrt": lambda own: own**0.5, "absolute": lambda own: own}
    found = _value(tree, leaf, _ARITHMETIC | rules | powers)
    if found.dimensionality != unit_of(unit or "dimensionless").dimensionality:
        stated, given = (f"the unit '{one}'" if one else "no unit" for one in (unit, f"{found:~P}"))
        raise InputError(f"has {stated}, but its expression has {given}: change one of the two")
    return names


def _value(tree: ast.expr, leaf: Callable[[str | float], Any], rules: _Rules, depth: int = 0) -> Any:
    """Return the value of an expression: a number, a symbol, or its unit.

    Args:
        tree: the expression.
        leaf: function from a name, such as "mean_draft" or "share.height", or a number to its value.
        rules: how operators and functions compute.
        depth: how deep the expression is nested in others.
    """
    if depth > _MAX_DEPTH:
        raise InputError(f"the expression is nested more than {_MAX_DEPTH} deep: define its parts as separate results")

    def inner(part: ast.expr) -> Any:
        return _value(part, leaf, rules, depth + 1)

    match tree:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            if number > sys.float_info.max:
                raise InputError(f"the number {short(ast.unparse(tree))} is too large")
            return leaf(float(number))
        case ast.Name() | ast.Attribute():
            return leaf(ast.unparse(tree))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return rules[ast.Mult](leaf(-1.0), inner(operand))
        case ast.BinOp(left=base, op=ast.Pow(), right=power):
            return inner(base) ** _power(power)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in rules:
            return rules[type(op)](inner(left), inner(right))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in _FUNCTIONS:
            if len(arguments) != (2 if name in ("minimum", "maximum") else 1):
                raise InputError(f"'{ast.unparse(tree)}' has the wrong number of arguments")
            return rules[name](*map(inner, arguments))
    functions = ", ".join(_FUNCTIONS)
    raise InputError(f"'{short(ast.unparse(tree), 60)}' cannot be computed: use + - * / **, and {functions}")


def _power(tree: ast.expr) -> float:
    """Return the exponent of a power, which must be a number."""
    sign = 1.0
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
        sign, tree = -1.0, tree.operand
    if not isinstance(tree, ast.Constant) or isinstance(tree.value, bool) or not isinstance(tree.value, int | float):
        raise InputError(f"the power '{ast.unparse(tree)}' must be a number")
    if tree.value > _MAX_POWER:
        raise InputError(f"the power {tree.value} must be at most {_MAX_POWER:g}")
    return sign * float(tree.value)


def measures_of(table: ProblemTable) -> Mapping[str, Measure]:
    """Return name -> measure of every result that a file can name: those of plough_opt and those it defines."""
    return MEASURES | {name: defined_measure(entry.value, entry.unit) for name, entry in table.measures.items()}


def check_definitions(source: Source, table: ProblemTable) -> bool:
    """Note every invalid result in [measures]; return True if all are valid."""
    valid = 0
    for name, entry in table.measures.items():
        with source.noting((TABLE, name), prefix=f"'{name}' "):
            if name in MEASURES or name in EVERY:
                raise InputError("is the name of a built-in result or quantity: choose another")
            if not name.isidentifier():
                raise InputError("cannot be a name: use letters, digits and _")
            defined_measure(entry.value, entry.unit)
            valid += 1
    return valid == len(table.measures)


def total_of(measure: Measure, runs: Sequence[Run]) -> Expression:
    """Return the sum of a result over runs."""
    first, *rest = map(measure.of, runs)
    return sum(rest, first)
