"""What becomes of each operation of a right-hand side when its arguments are series in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number
from plough_opt.motion.batch.series import Graph, Series

Rule = Callable[..., Series]


def series_of(graph: Graph, function: ca.Function, inputs: Sequence[Sequence[Series]], late: bool) -> list[Series]:
    """Return the series of an SX Function's results, each a column, one after the other.

    Args:
        graph: where the series are entered.
        function: of SX, of columns.
        inputs: the series of its arguments' elements.
        late: whether a ramp of the tow speed has ended: where the time is capped, the cap then counts.

    Raises:
        InputError: an operation that has no rule.
    """
    work: dict[int, Series] = {}
    results: list[list[Series]] = [[] for _ in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        into, of = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[into[0]] = inputs[of[0]][of[1]]
        elif operation == ca.OP_CONST:
            work[into[0]] = graph.constant(ca.SX(function.instruction_constant(k)))
        elif operation == ca.OP_OUTPUT:
            results[into[0]].append(work[of[0]])
        else:
            work[into[0]] = _apply(graph, operation, [work[i] for i in of], late)
    return [series for column in results for series in column]


def _apply(graph: Graph, operation: int, of: list[Series], late: bool) -> Series:
    if all(series.fixed for series in of):
        evaluate = ca.SX.unary if len(of) == 1 else ca.SX.binary
        return graph.constant(evaluate(operation, *(series[0] for series in of)))
    if operation == ca.OP_FMIN and any(x.timed for x in of) and any(x.fixed for x in of):
        time, cap = sorted(of, key=lambda x: x.fixed)
        return cap if late else time
    if operation not in _RULES:
        name = next(name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == operation)
        raise InputError(
            f"a batch does not know the operation '{name[3:].lower()}' of something that moves: write the own"
            " resistance without it, or take po.simulate for each design"
        )
    return _RULES[operation](graph, *of)


def _scaled(factor: float) -> Rule:
    return lambda graph, x: graph.scaled(x, factor)


def _smaller(graph: Graph, a: Series, b: Series, sign: float) -> Series:
    difference = graph.switch(graph.scaled(graph.total(a, b, -1.0), sign))
    return graph.chosen(lambda: difference[0] <= 0.0, a, b)


def _size(graph: Graph, x: Series) -> Series:
    minus = graph.switch(graph.scaled(x, -1.0))
    return graph.chosen(lambda: minus[0] <= 0.0, x, minus)


def _compared(operation: int) -> Rule:
    def rule(graph: Graph, a: Series, b: Series) -> Series:
        graph.switch(graph.total(a, b, -1.0))
        return graph.step(partial(ca.SX.binary, operation), a, b)

    return rule


def _logical(operation: int) -> Rule:
    def rule(graph: Graph, *of: Series) -> Series:
        return graph.step(partial(ca.SX.unary if len(of) == 1 else ca.SX.binary, operation), *of)

    return rule


def _sign(graph: Graph, x: Series) -> Series:
    return graph.step(ca.sign, graph.switch(x))


def _only_if(graph: Graph, condition: Series, x: Series) -> Series:
    return graph.scaled(x, condition[0]) if condition.fixed else graph.masked(x, condition)


def _shifted(graph: Graph, x: Series, by: float) -> Series:
    return graph.total(x, graph.constant(ca.SX(by)))


def _power(graph: Graph, x: Series, exponent: Series) -> Series:
    if not exponent.fixed:
        return _exponential(graph, graph.product(exponent, _logarithm(graph, x)))
    # x^n is a product for a small whole number: it then holds for x <= 0 too.
    number = exponent[0]
    if number.is_constant() and float(as_number(number)) in range(3, 9):
        return _whole_power(graph, x, int(as_number(number)))
    return graph.integral(lambda c: c ** exponent[0], x, lambda y: graph.product(exponent, graph.quotient(y, x)))


def _whole_power(graph: Graph, x: Series, exponent: int) -> Series:
    if exponent == 1:
        return x
    half = graph.square(_whole_power(graph, x, exponent // 2))
    return graph.product(half, x) if exponent % 2 else half


def _exponential(graph: Graph, x: Series) -> Series:
    return graph.integral(ca.exp, x, lambda y: y)


def _logarithm(graph: Graph, x: Series) -> Series:
    return graph.integral(ca.log, x, lambda _: _inverse(graph, x))


def _inverse(graph: Graph, x: Series) -> Series:
    return graph.quotient(graph.constant(ca.SX(1)), x)


def _from_square(outer: int, factor: float, added: float, root: bool, own: bool = False) -> Rule:
    """Return the rule of y = f(x) with y' = g(u) x', u = added + factor v^2, where v is x, or y itself."""

    def slope(graph: Graph, x: Series, y: Series) -> Series:
        inner = _shifted(graph, graph.scaled(graph.square(y if own else x), factor), added)
        if own:
            return graph.root(inner) if root else inner
        return _inverse(graph, graph.root(inner) if root else inner)

    return lambda graph, x: graph.integral(partial(ca.SX.unary, outer), x, partial(slope, graph, x))


def _error_function(graph: Graph, x: Series) -> Series:
    def slope(_: Series) -> Series:
        bell = _exponential(graph, graph.scaled(graph.square(x), -1.0))
        return graph.scaled(bell, 2.0 / math.sqrt(math.pi))

    return graph.integral(ca.erf, x, slope)


_RULES: dict[int, Rule] = {
    ca.OP_ADD: Graph.total,
    ca.OP_SUB: partial(Graph.total, sign=-1.0),
    ca.OP_NEG: _scaled(-1.0),
    ca.OP_TWICE: _scaled(2.0),
    ca.OP_ASSIGN: _scaled(1.0),
    ca.OP_MUL: Graph.product,
    ca.OP_SQ: Graph.square,
    ca.OP_DIV: Graph.quotient,
    ca.OP_INV: _inverse,
    ca.OP_SQRT: Graph.root,
    ca.OP_HYPOT: lambda graph, a, b: graph.root(graph.total(graph.square(a), graph.square(b))),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_EXP: _exponential,
    ca.OP_EXPM1: lambda graph, x: graph.integral(ca.expm1, x, lambda y: _shifted(graph, y, 1.0)),
    ca.OP_LOG: _logarithm,
    ca.OP_LOG1P: lambda graph, x: graph.integral(ca.log1p, x, lambda _: _inverse(graph, _shifted(graph, x, 1.0))),
    ca.OP_SIN: Graph.sine,
    ca.OP_COS: Graph.cosine,
    ca.OP_COSH: lambda graph, x: graph.scaled(
        graph.total(_exponential(graph, x), _exponential(graph, graph.scaled(x, -1.0))), 0.5
    ),
    ca.OP_SINH: _from_square(ca.OP_SINH, 1.0, 1.0, True, own=True),
    ca.OP_TAN: _from_square(ca.OP_TAN, 1.0, 1.0, False, own=True),
    ca.OP_TANH: _from_square(ca.OP_TANH, -1.0, 1.0, False, own=True),
    ca.OP_ATAN: _from_square(ca.OP_ATAN, 1.0, 1.0, False),
    ca.OP_ATANH: _from_square(ca.OP_ATANH, -1.0, 1.0, False),
    ca.OP_ASIN: _from_square(ca.OP_ASIN, -1.0, 1.0, True),
    ca.OP_ASINH: _from_square(ca.OP_ASINH, 1.0, 1.0, True),
    ca.OP_ERF: _error_function,
    ca.OP_FMIN: partial(_smaller, sign=1.0),
    ca.OP_FMAX: partial(_smaller, sign=-1.0),
    ca.OP_FABS: _size,
    ca.OP_SIGN: _sign,
    ca.OP_IF_ELSE_ZERO: _only_if,
    ca.OP_LT: _compared(ca.OP_LT),
    ca.OP_LE: _compared(ca.OP_LE),
    ca.OP_NOT: _logical(ca.OP_NOT),
    ca.OP_AND: _logical(ca.OP_AND),
    ca.OP_OR: _logical(ca.OP_OR),
}
