"""Taylor series in time of a differential equation's solution, order by order from its graph.

Jorba, Zou: A software package for the numerical integration of ODEs by means of high-order Taylor methods, Experimental
Mathematics 14 (2005); Griewank, Walther: Evaluating Derivatives, 2nd ed., 2008, chapter 13. Each kind of operation is a
method of `Graph` with the recurrence for the coefficients of its result. A coefficient that is zero for every design
(those of a constant, or of the time beyond the first) adds nothing to the compiled code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca

from plough_opt.core.errors import InputError

_ZERO, _ONE = ca.SX(0), ca.SX(1)


class Series:
    """Taylor coefficients of one quantity.

    Attributes:
        coefficients: those known so far, from order 0.
        following: (this series, an order) -> the coefficient of that order, all lower ones being known; None if it
            comes from outside.
        fixed: whether the quantity is independent of time.
        timed: whether it is a multiple of the time.
        affine: (another series, factor, summand) of which it is made, the latter two independent of time. A series that
            is not made of another one has itself, 1 and 0.
        derivative: of a function y = f(x) the series of its slope; it is set once y can be used to make it.
    """

    derivative: Series

    def __init__(
        self,
        following: Callable[[Series, int], ca.SX | None],
        *coefficients: ca.SX,
        fixed: bool = False,
        timed: bool = False,
        affine: tuple[Series, ca.SX, ca.SX] | None = None,
    ) -> None:
        """Take the recurrence and the coefficients known at first."""
        self.following, self.coefficients = following, list(coefficients)
        self.fixed, self.timed = fixed, timed
        self.affine = affine or (self, _ONE, _ZERO)

    def __getitem__(self, order: int) -> ca.SX:
        return self.coefficients[order]

    def slope(self, order: int) -> ca.SX:
        """Return the coefficient of an order of the time derivative."""
        base, factor, _ = self.affine
        return (order + 1) * factor * base[order + 1]


class Graph:
    """Series that depend on each other, in an order in which each coefficient needs only those known by then."""

    def __init__(self, late: bool = False) -> None:
        """Begin without any.

        Args:
            late: whether a ramp of the tow speed has ended: where the time is capped, the cap then counts.
        """
        self.late = late
        self._all: list[Series] = []
        self._circles: dict[int, tuple[Series, Series]] = {}
        self._squares: dict[int, Series] = {}
        self.switches: list[Series] = []
        """Series whose sign decides on the right-hand side's formula."""

    def extend(self, order: int) -> None:
        """Compute the coefficients of an order of all series, the orders below being known."""
        for series in self._all:
            if len(series.coefficients) == order and (found := series.following(series, order)) is not None:
                series.coefficients.append(found)

    def _add(self, series: Series) -> Series:
        self._all.append(series)
        return series

    def given(self, *coefficients: ca.SX) -> Series:
        """Return a series whose coefficients come from outside."""
        return self._add(Series(lambda _, __: None, *coefficients))

    def constant(self, value: ca.SX) -> Series:
        """Return the series of a value that is independent of time."""
        return self._add(Series(lambda _, __: _ZERO, value, fixed=True))

    def clock(self, now: ca.SX) -> Series:
        """Return the series of the time itself."""
        return self._add(Series(lambda _, k: _ONE if k == 1 else _ZERO, now, timed=True))

    def scaled(self, x: Series, factor: ca.SX | float) -> Series:
        """Return a fixed multiple of a series."""
        base, by, plus = x.affine
        affine = base, factor * by, factor * plus
        return self._add(Series(lambda _, k: factor * x[k], timed=x.timed, affine=affine))

    def total(self, a: Series, b: Series, sign: float = 1.0) -> Series:
        """Return a + b, or with the sign -1 a - b."""

        def added(x: ca.SX, y: ca.SX) -> ca.SX:
            return x + y if sign > 0.0 else x - y

        affine = None
        if a.fixed:
            affine = b.affine[0], sign * b.affine[1], added(a[0], b.affine[2])
        elif b.fixed:
            affine = a.affine[0], a.affine[1], added(a.affine[2], b[0])
        return self._add(Series(lambda _, k: added(a[k], b[k]), affine=affine))

    def product(self, a: Series, b: Series) -> Series:
        """Return a b; if both are made of the same series, from the square of that."""
        if a.fixed or b.fixed:
            return self.scaled(b, a[0]) if a.fixed else self.scaled(a, b[0])
        (x, p, q), (other, r, s) = a.affine, b.affine
        if a is b:
            return self.square(a)
        if x is not other:
            return self._add(Series(lambda _, k: _convolved(a, b, k, 0)))
        square = self.square(x)
        return self._add(Series(lambda _, k: p * r * square[k] + (p * s + q * r) * x[k] if k else a[0] * b[0]))

    def square(self, x: Series) -> Series:
        """Return x^2, which is made once."""
        if id(x) not in self._squares:
            self._squares[id(x)] = self._add(Series(lambda _, k: _self_convolved(x, k, 0)))
        return self._squares[id(x)]

    def quotient(self, a: Series, b: Series) -> Series:
        """Return q = a/b, from a = b q."""
        if b.fixed:
            return self.scaled(a, 1.0 / b[0])
        inverse = self._add(Series(lambda _, k: 1.0 / b[0] if k == 0 else _ZERO))
        return self._add(Series(lambda q, k: (a[k] - _convolved(b, q, k, 1)) * inverse[0]))

    def inverse(self, x: Series) -> Series:
        """Return 1/x."""
        return self.quotient(self.constant(_ONE), x)

    def root(self, x: Series) -> Series:
        """Return r = sqrt(x), from x = r^2."""
        return self._add(Series(lambda r, k: (x[k] - _self_convolved(r, k, 1)) / (2.0 * r[0]) if k else ca.sqrt(x[0])))

    def integral(self, function: Callable[[ca.SX], ca.SX], x: Series) -> Series:
        """Return y = f(x), from y' = g x'; its `Series.derivative` g, which may be made of y, is still to be set."""

        def following(y: Series, order: int) -> ca.SX:
            if order == 0:
                return function(x[0])
            slopes = [x.slope(k) for k in range(order)]
            return _convolved(slopes, y.derivative, order - 1, 0) / order

        return self._add(Series(following))

    def circular(self, x: Series) -> tuple[Series, Series]:
        """Return sin(x) and cos(x), which are made once, each from the other."""
        if id(x) not in self._circles:
            sine, cosine = self.integral(ca.sin, x), self.integral(ca.cos, x)
            sine.derivative, cosine.derivative = cosine, self.scaled(sine, -1.0)
            self._circles[id(x)] = sine, cosine
        return self._circles[id(x)]

    def chosen(self, switch: Series, yes: Series, no: Series) -> Series:
        """Return one series until another becomes positive, then a third: by the sign at the start of the step."""
        return self._add(Series(lambda _, k: ca.if_else(switch[0] <= 0.0, yes[k], no[k])))

    def masked(self, x: Series, condition: Series) -> Series:
        """Return a series where a condition holds, elsewhere 0."""
        return self._add(Series(lambda _, k: ca.if_else(condition[0], x[k], 0.0)))

    def switch(self, series: Series) -> Series:
        """Note a series whose sign decides on the right-hand side's formula, and return it."""
        self.switches.append(series)
        return series

    def step(self, function: Callable[..., ca.SX], *of: Series) -> Series:
        """Return a function that is constant between switches."""
        return self._add(Series(lambda _, k: function(*(series[0] for series in of)) if k == 0 else _ZERO))


def _convolved(a: Series | Sequence[ca.SX], b: Series, k: int, low: int) -> ca.SX:
    """Return the sum of a_j b_(k-j) for j from low to k."""
    total = _ZERO
    for j in range(low, k + 1):
        if not (a[j].is_zero() or b[k - j].is_zero()):
            total = total + a[j] * b[k - j]
    return total


def _self_convolved(a: Series, k: int, low: int) -> ca.SX:
    """Return the sum of a_j a_(k-j) for j from low to k - low; equal products are taken once."""
    total = _ZERO
    for j in range(low, (k + 1) // 2):
        if not (a[j].is_zero() or a[k - j].is_zero()):
            total = total + a[j] * a[k - j]
    total = 2.0 * total
    if k % 2 == 0 and k // 2 >= low:
        total = total + a[k // 2] ** 2
    return total


def series_of(graph: Graph, function: ca.Function, inputs: Sequence[Sequence[Series]]) -> list[Series]:
    """Return the series of an SX Function's results, each a column, one after the other.

    Args:
        graph: where the series are entered.
        function: of SX, of columns.
        inputs: the series of its arguments' elements.

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
            work[into[0]] = _apply(graph, operation, [work[i] for i in of])
    return [series for column in results for series in column]


def _apply(graph: Graph, operation: int, of: list[Series]) -> Series:
    """Return the series of an operation's result."""
    if all(series.fixed for series in of):
        return graph.constant(_evaluated(operation, *(series[0] for series in of)))
    if operation == ca.OP_FMIN and any(x.timed for x in of) and any(x.fixed for x in of):
        time, cap = sorted(of, key=lambda x: x.fixed)
        return cap if graph.late else time
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
    (result.derivative,) = series_of(graph, derivative, [[x], [result]])
    return result


def _power(graph: Graph, x: Series, exponent: Series) -> Series:
    if not exponent.fixed:
        return _function(graph, ca.OP_EXP, graph.product(exponent, _function(graph, ca.OP_LOG, x)))
    # Of a whole number CasADi has made products before, which hold for x <= 0 too.
    number = exponent[0]
    result = graph.integral(lambda value: value**number, x)
    result.derivative = graph.product(exponent, graph.quotient(result, x))
    return result


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
