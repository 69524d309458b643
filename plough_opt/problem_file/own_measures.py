"""The table [measures]: results that a file defines as expressions of other results and quantities."""

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from plough_opt.core import expressions
from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import EVERY, QUANTITIES
from plough_opt.core.units import Display, Unit, registry
from plough_opt.motion import Run
from plough_opt.motion.scene_quantities import quantity_of
from plough_opt.motion.vocabulary import MEASURES, Measure
from plough_opt.problem_file.schema import ProblemTable
from plough_opt.problem_file.source import Source

TABLE = "measures"
# Longer or more deeply nested expressions belong in a script.
_MAX_LENGTH: Final = 300
_MAX_DEPTH: Final = 20
# No physical result needs a higher power.
_MAX_POWER: Final = 8.0
_OPERATORS: Final[dict[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_FUNCTIONS: Final[dict[str, Callable[..., Expression]]] = {
    name: getattr(expressions, name) for name in ("sqrt", "exp", "log", "absolute", "minimum", "maximum")
}
# Functions that require a dimensionless argument.
_DIMENSIONLESS: Final = ("exp", "log")
_EXAMPLE: Final = '"tow_power / (2 * loosened_radius)"'


@dataclass(frozen=True)
class _Evaluator:
    """What names, function calls and powers in an expression evaluate to: numbers, units, or nothing.

    Attributes:
        name: function from a name, such as "mean_draft" or "share.height", to its value.
        call: function from the name of a function and its arguments to the value.
        power: function from base and exponent to the value.
    """

    name: Callable[[str], Any]
    call: Callable[[str, list[Any]], Any]
    power: Callable[[Any, float], Any] = operator.pow


@lru_cache(maxsize=128)
def own_measure(text: str, unit: str) -> Measure:
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
    names = _names(tree)
    Unit(unit).split(f"1 {unit}")  # raises InputError for an unreadable unit
    _check_unit(tree, text, unit)

    def of(run: Run) -> Expression:
        value: Expression = _value(tree, _Evaluator(lambda name: _of_run(run, name), _applied))
        return value

    parts = [MEASURES[name] for name in names if name in MEASURES]
    needs = tuple(dict.fromkeys(what for one in parts for what in one.needs))
    return Measure(Unit(_si(unit)), of, needs, random=any(one.random for one in parts))


def _of_run(run: Run, name: str) -> Expression:
    return MEASURES[name].of(run) if name in MEASURES else quantity_of(run.scene, name)


def _applied(name: str, arguments: list[Any]) -> Expression:
    return _FUNCTIONS[name](*arguments)


def _names(tree: ast.expr) -> set[str]:
    """Return the names of results and quantities in an expression; raise InputError if one is unknown."""
    found: set[str] = set()

    def note(name: str) -> float:
        single = [one for one, measure in MEASURES.items() if not measure.everywhere]
        if name not in single and name not in QUANTITIES:
            raise InputError(f"'{name}' has no single value to compute with: {nearest(name, [*single, *QUANTITIES])}")
        found.add(name)
        return 1.0

    _value(tree, _Evaluator(note, lambda _, arguments: arguments[0], lambda base, _: base))
    return found


def display_of_own(unit: str) -> Display:
    """Return the display unit of a result that the file defines."""
    return Display(unit, float(registry().Quantity(1.0, unit or "dimensionless").to_base_units().magnitude))


def _si(unit: str) -> str:
    """Return the SI unit of the same dimension, or the unit itself if its factor to SI is 1."""
    base = registry().Quantity(1.0, unit or "dimensionless").to_base_units()
    return unit if base.magnitude == 1.0 else f"{base.units:~C}"


def _check_unit(tree: ast.expr, text: str, unit: str) -> None:
    """Raise InputError if an expression adds unlike units, or its unit differs in dimension from the stated one."""
    import pint

    quantity = registry().Quantity

    def of_name(name: str) -> Any:
        symbol = MEASURES[name].unit.symbol if name in MEASURES else QUANTITIES[name].unit
        return quantity(1.0, symbol or "dimensionless")

    def of_call(name: str, arguments: list[Any]) -> Any:
        if name in _DIMENSIONLESS:
            return arguments[0].to("dimensionless")
        if name == "sqrt":
            return arguments[0] ** 0.5
        return sum(arguments[1:], arguments[0])  # minimum and maximum: raises an error unless the units agree

    try:
        found = quantity(1.0, "dimensionless") * _value(tree, _Evaluator(of_name, of_call))
    except pint.DimensionalityError as error:
        raise InputError(f"= {short(repr(text))} combines unlike units, {error.units1} and {error.units2}") from None
    except (ZeroDivisionError, OverflowError):
        found = None  # caused by the placeholder values of 1, so the units remain unchecked
    kind = quantity(1.0, unit or "dimensionless")
    if found is not None and found.dimensionality != kind.dimensionality:
        stated, given = (f"the unit '{one}'" if one else "no unit" for one in (unit, f"{found.units:~P}"))
        raise InputError(f"has {stated}, but its expression has {given}: change one of the two")


def _value(tree: ast.expr, evaluator: _Evaluator, depth: int = 0) -> Any:
    """Return the value of an expression under an evaluator."""
    if depth > _MAX_DEPTH:
        raise InputError(f"the expression is nested more than {_MAX_DEPTH} deep: define its parts as separate results")
    match tree:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name() | ast.Attribute():
            return evaluator.name(ast.unparse(tree))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_value(operand, evaluator, depth + 1)
        case ast.BinOp(left=base, op=ast.Pow(), right=power):
            return evaluator.power(_value(base, evaluator, depth + 1), _power(power))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_value(left, evaluator, depth + 1), _value(right, evaluator, depth + 1))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in _FUNCTIONS:
            if len(arguments) != (2 if name in ("minimum", "maximum") else 1):
                raise InputError(f"'{ast.unparse(tree)}' has the wrong number of arguments")
            return evaluator.call(name, [_value(one, evaluator, depth + 1) for one in arguments])
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
    return MEASURES | {name: own_measure(own.value, own.unit) for name, own in table.measures.items()}


def check_own(source: Source, table: ProblemTable) -> bool:
    """Note every invalid result in [measures]; return True if all are valid."""
    valid = 0
    for name, own in table.measures.items():
        with source.noting((TABLE, name), prefix=f"'{name}' "):
            if name in MEASURES or name in EVERY:
                raise InputError("is the name of a built-in result or quantity: choose another")
            if not name.isidentifier():
                raise InputError("cannot be a name: use letters, digits and _")
            own_measure(own.value, own.unit)
            valid += 1
    return valid == len(table.measures)


def total_of(measure: Measure, runs: Sequence[Run]) -> Expression:
    """Return the sum of a result over runs."""
    first, *rest = map(measure.of, runs)
    return sum(rest, first)
