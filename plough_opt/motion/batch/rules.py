"""The rule for each operation of a right-hand side whose arguments are Taylor series in time."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number
from plough_opt.motion.batch.series import Graph, Series


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
    """Return the series of an operation's result."""
    if all(series.fixed for series in of):
        return graph.constant(_evaluated(operation, *(series[0] for series in of)))
    if operation == ca.OP_FMIN and any(x.timed for x in of) and any(x.fixed for x in of):
        time, cap = sorted(of, key=lambda x: x.fixed)
        return cap if late else time
    if operation in _RULES:
        return _RULES[operation](graph, *of)
    if operation in _DERIVATIVES:
        return _function(graph, operation, *of)
    if operation in _STEPS:
        return graph.step(partial(_evaluated, operation), *of)
    name = next(name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == operation)
    raise InputError(
        f"a batch does not know the operation '{name[3:].lower()}' of something that moves: write the own"
        " resistance without it, or use po.simulate for each design"
    )


def _evaluated(operation: int, *of: ca.SX) -> ca.SX:
    return ca.SX.unary(operation, *of) if len(of) == 1 else ca.SX.binary(operation, *of)


def _function(graph: Graph, operation: int, x: Series) -> Series:
    """Return the series of y = f(x) from the one of f'(x), which may be written with y."""
    result = graph.integral(partial(_evaluated, operation), x)
    derivative = ca.Function("derivative", [_X, _Y], [_DERIVATIVES[operation]])
    (result.derivative,) = series_of(graph, derivative, [[x], [result]], late=False)
    return result


def _power(graph: Graph, x: Series, exponent: Series) -> Series:
    if not exponent.fixed:
        return _function(graph, ca.OP_EXP, graph.product(exponent, _function(graph, ca.OP_LOG, x)))
    # x^n is a product for a small whole number: it then holds for x <= 0 too.
    number = exponent[0]
    if number.is_constant() and float(as_number(number)) in range(3, 9):
        return _whole_power(graph, x, int(as_number(number)))
    result = graph.integral(lambda value: value**number, x)
    result.derivative = graph.product(exponent, graph.quotient(result, x))
    return result


def _whole_power(graph: Graph, x: Series, exponent: int) -> Series:
    if exponent == 1:
        return x
    half = graph.square(_whole_power(graph, x, exponent // 2))
    return graph.product(half, x) if exponent % 2 else half


def _hyperbolic_cosine(graph: Graph, x: Series) -> Series:
    rising, falling = _function(graph, ca.OP_EXP, x), _function(graph, ca.OP_EXP, graph.scaled(x, -1.0))
    return graph.scaled(graph.total(rising, falling), 0.5)


def _smaller(graph: Graph, a: Series, b: Series) -> Series:
    return graph.chosen(graph.switch(graph.total(a, b, -1.0)), a, b)


def _larger(graph: Graph, a: Series, b: Series) -> Series:
    return graph.chosen(graph.switch(graph.scaled(graph.total(a, b, -1.0), -1.0)), a, b)


def _absolute(graph: Graph, x: Series) -> Series:
    minus = graph.switch(graph.scaled(x, -1.0))
    return graph.chosen(minus, x, minus)


def _compared(graph: Graph, a: Series, b: Series, operation: int) -> Series:
    graph.switch(graph.total(a, b, -1.0))
    return graph.step(partial(_evaluated, operation), a, b)


def _only_if(graph: Graph, condition: Series, x: Series) -> Series:
    return graph.scaled(x, condition[0]) if condition.fixed else graph.masked(x, condition)


# Operations made of sums, products, quotients and roots, and those that change their formula.
_RULES: dict[int, Callable[..., Series]] = {
    ca.OP_ADD: Graph.total,
    ca.OP_SUB: partial(Graph.total, sign=-1.0),
    ca.OP_NEG: partial(Graph.scaled, factor=-1.0),
    ca.OP_TWICE: partial(Graph.scaled, factor=2.0),
    ca.OP_ASSIGN: partial(Graph.scaled, factor=1.0),
    ca.OP_MUL: Graph.product,
    ca.OP_SQ: Graph.square,
    ca.OP_DIV: Graph.quotient,
    ca.OP_INV: Graph.inverse,
    ca.OP_SQRT: Graph.root,
    ca.OP_HYPOT: lambda graph, a, b: graph.root(graph.total(graph.square(a), graph.square(b))),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SIN: lambda graph, x: graph.circular(x)[0],
    ca.OP_COS: lambda graph, x: graph.circular(x)[1],
    ca.OP_COSH: _hyperbolic_cosine,
    ca.OP_FMIN: _smaller,
    ca.OP_FMAX: _larger,
    ca.OP_FABS: _absolute,
    ca.OP_SIGN: lambda graph, x: graph.step(ca.sign, graph.switch(x)),
    ca.OP_IF_ELSE_ZERO: _only_if,
    ca.OP_LT: partial(_compared, operation=ca.OP_LT),
    ca.OP_LE: partial(_compared, operation=ca.OP_LE),
}

# Functions y = f(x) of one argument, with f'(x) written in x or in y, whichever is shorter.
_X, _Y = ca.SX.sym("x"), ca.SX.sym("y")
_DERIVATIVES = {
    ca.OP_EXP: _Y,
    ca.OP_EXPM1: _Y + 1.0,
    ca.OP_LOG: 1.0 / _X,
    ca.OP_LOG1P: 1.0 / (1.0 + _X),
    ca.OP_SINH: ca.sqrt(1.0 + _Y**2),
    ca.OP_TAN: 1.0 + _Y**2,
    ca.OP_TANH: 1.0 - _Y**2,
    ca.OP_ATAN: 1.0 / (1.0 + _X**2),
    ca.OP_ATANH: 1.0 / (1.0 - _X**2),
    ca.OP_ASIN: 1.0 / ca.sqrt(1.0 - _X**2),
    ca.OP_ASINH: 1.0 / ca.sqrt(1.0 + _X**2),
    ca.OP_ERF: 2.0 / math.sqrt(math.pi) * ca.exp(-(_X**2)),
}

# Operations on conditions, whose result changes only where one of the conditions does.
_STEPS = (ca.OP_NOT, ca.OP_AND, ca.OP_OR)
