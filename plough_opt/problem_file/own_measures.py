"""The [measures] table: a file's own results, simple expressions of results and quantities with a unit."""

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
# An expression that is longer or more deeply nested belongs into a script.
_LONGEST: Final = 300
_DEEPEST: Final = 20
_LARGEST_POWER: Final = 8.0
_OPERATORS: Final[dict[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_FUNCTIONS: Final[dict[str, Callable[..., Expression]]] = {
    name: getattr(expressions, name) for name in ("sqrt", "exp", "log", "absolute", "minimum", "maximum")
}
# Functions of pure numbers alone; of the others minimum and maximum keep the unit, and sqrt halves its powers.
_OF_NUMBERS: Final = ("exp", "log")
_EXAMPLE: Final = '"tow_power / (2 * loosened_radius)"'


@dataclass(frozen=True)
class _Known:
    """Values of the names in an expression.

    Attributes:
        name: name, such as "mean_draft" or "share.height" -> value.
        call: name of a function and its arguments -> value.
        power: base and exponent -> value.
    """

    name: Callable[[str], Any]
    call: Callable[[str, list[Any]], Any]
    power: Callable[[Any, float], Any] = operator.pow


@lru_cache(maxsize=128)
def own_measure(text: str, unit: str) -> Measure:
    """Return a result that an expression computes from others.

    Args:
        text: sums, differences, products, quotients, powers, and the functions sqrt, exp, log, absolute, minimum and
            maximum of results such as mean_draft and quantities such as share.height.
        unit: unit of the result, "" for a pure number.

    Raises:
        InputError: a text that is not such an expression, a name that is unknown, or a unit of another kind.
    """
    if len(text) > _LONGEST:
        raise InputError(f"the expression has {len(text)} characters, and at most {_LONGEST} can be read")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError):
        raise InputError(f"= {short(repr(text))} cannot be read: write an expression like {_EXAMPLE}") from None
    names = _names(tree)
    Unit(unit).split(f"1 {unit}")  # refuses a unit that cannot be read
    _check_unit(tree, text, unit)

    def of(run: Run) -> Expression:
        value: Expression = _value(tree, _Known(lambda name: _of_run(run, name), _applied))
        return value

    parts = [MEASURES[name] for name in names if name in MEASURES]
    needs = tuple(dict.fromkeys(what for one in parts for what in one.needs))
    return Measure(Unit(_si(unit)), of, needs, random=any(one.random for one in parts))


def _of_run(run: Run, name: str) -> Expression:
    return MEASURES[name].of(run) if name in MEASURES else quantity_of(run.scene, name)


def _applied(name: str, arguments: list[Any]) -> Expression:
    return _FUNCTIONS[name](*arguments)


def _names(tree: ast.expr) -> set[str]:
    """Return the names of an expression's results and quantities, each of them known."""
    found: set[str] = set()

    def note(name: str) -> float:
        single = [one for one, measure in MEASURES.items() if not measure.everywhere]
        if name not in single and name not in QUANTITIES:
            raise InputError(f"'{name}' has no single value to compute with: {nearest(name, [*single, *QUANTITIES])}")
        found.add(name)
        return 1.0

    _value(tree, _Known(note, lambda _, arguments: arguments[0], lambda base, _: base))
    return found


def display_of_own(unit: str) -> Display:
    """Return the unit in which a file shows a result of its own."""
    return Display(unit, float(registry().Quantity(1.0, unit or "dimensionless").to_base_units().magnitude))


def _si(unit: str) -> str:
    """Return the SI unit of a unit's kind: itself where it is one."""
    base = registry().Quantity(1.0, unit or "dimensionless").to_base_units()
    return unit if base.magnitude == 1.0 else f"{base.units:~C}"


def _check_unit(tree: ast.expr, text: str, unit: str) -> None:
    """Refuse an expression that joins unlike units, or gives another kind than the file says."""
    import pint

    quantity = registry().Quantity

    def of_name(name: str) -> Any:
        symbol = MEASURES[name].unit.symbol if name in MEASURES else QUANTITIES[name].unit
        return quantity(1.0, symbol or "dimensionless")

    def of_call(name: str, arguments: list[Any]) -> Any:
        if name in _OF_NUMBERS:
            return arguments[0].to("dimensionless")
        if name == "sqrt":
            return arguments[0] ** 0.5
        return sum(arguments[1:], arguments[0])  # which asks for one unit

    try:
        found = quantity(1.0, "dimensionless") * _value(tree, _Known(of_name, of_call))
    except pint.DimensionalityError as error:
        raise InputError(f"= {short(repr(text))} joins {error.units1} and {error.units2}, which are unlike") from None
    except (ZeroDivisionError, OverflowError):
        found = None  # by the numbers in the place of values, which say nothing of the units
    kind = quantity(1.0, unit or "dimensionless")
    if found is not None and found.dimensionality != kind.dimensionality:
        raise InputError(f"has the unit {unit or 'of a pure number'}, and its expression gives {found.units:~P}")


def _value(tree: ast.expr, known: _Known, depth: int = 0) -> Any:
    """Return an expression's value, whatever its names stand for."""
    if depth > _DEEPEST:
        raise InputError(f"the expression is nested more than {_DEEPEST} deep: name its parts as results of their own")
    match tree:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name() | ast.Attribute():
            return known.name(ast.unparse(tree))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_value(operand, known, depth + 1)
        case ast.BinOp(left=base, op=ast.Pow(), right=power):
            return known.power(_value(base, known, depth + 1), _power(power))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_value(left, known, depth + 1), _value(right, known, depth + 1))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in _FUNCTIONS:
            if len(arguments) != (2 if name in ("minimum", "maximum") else 1):
                raise InputError(f"'{ast.unparse(tree)}' has the wrong number of arguments")
            return known.call(name, [_value(one, known, depth + 1) for one in arguments])
    functions = ", ".join(_FUNCTIONS)
    raise InputError(f"'{short(ast.unparse(tree), 60)}' cannot be computed: take + - * / **, and {functions}")


def _power(tree: ast.expr) -> float:
    sign = 1.0
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
        sign, tree = -1.0, tree.operand
    if not isinstance(tree, ast.Constant) or isinstance(tree.value, bool) or not isinstance(tree.value, int | float):
        raise InputError(f"the power '{ast.unparse(tree)}' must be a number")
    if tree.value > _LARGEST_POWER:
        raise InputError(f"the power {tree.value} must be at most {_LARGEST_POWER:g}")
    return sign * float(tree.value)


def measures_of(table: ProblemTable) -> Mapping[str, Measure]:
    """Return the results that a file can name: the toolkit's and its own."""
    return MEASURES | {name: own_measure(own.value, own.unit) for name, own in table.measures.items()}


def check_own(source: Source, table: ProblemTable) -> bool:
    """Note own results that cannot be computed or whose names are taken; return True if there are none."""
    sound = 0
    for name, own in table.measures.items():
        with source.noting((TABLE, name), prefix=f"'{name}' "):
            if name in MEASURES or name in EVERY:
                raise InputError("is the name of a result or quantity of the toolkit: take another")
            if not name.isidentifier():
                raise InputError("cannot be a name: take letters, digits and _")
            own_measure(own.value, own.unit)
            sound += 1
    return sound == len(table.measures)


def total_of(measure: Measure, runs: Sequence[Run]) -> Expression:
    """Return a result of one run, or the sum over several."""
    first, *rest = map(measure.of, runs)
    return sum(rest, first)
