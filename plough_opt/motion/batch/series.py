"""Taylor series in time of a differential equation's solution, computed order by order from its graph.

Jorba, Zou: A software package for the numerical integration of ODEs by means of high-order Taylor methods, Experimental
Mathematics 14 (2005); Griewank, Walther: Evaluating Derivatives, 2nd ed., 2008, chapter 13.

Each kind of operation is a method of `Graph` that states the recurrence for the coefficients of its result. A
coefficient that is zero for every design adds nothing to the compiled code: those of a constant beyond order 0, and of
the time beyond order 1.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import (
    BINARY,
    COMPARISONS,
    LANE_BY_LANE,
    LIBRARY,
    LIBRARY_OF_TWO,
    SIMPLE,
    Phase,
    c_source,
    instructions,
    loaded,
    name_of,
    variants,
)
from plough_opt.core.errors import InputError
from plough_opt.core.plain_data import Array

_ZERO, _ONE = ca.SX(0), ca.SX(1)


class Series:
    """Taylor coefficients of one quantity.

    Attributes:
        recurrence: (this series, an order) -> the coefficient of that order, once all lower orders of the graph are
            known; None if the caller supplies the coefficients.
        coefficients: those known so far, from order 0.
        constant: whether the quantity is independent of time.
        is_time: whether it is a multiple of the time.
        affine: (base, factor, summand) with this series = factor * base + summand, where factor and summand are
            independent of time. A series that was not made like this is its own base.
        derivative: for y = f(x), the series of f'(x). It may depend on y, so it is set after y was made.
    """

    derivative: Series

    def __init__(
        self,
        recurrence: Callable[[Series, int], ca.SX | None],
        *coefficients: ca.SX,
        constant: bool = False,
        is_time: bool = False,
        affine: tuple[Series, ca.SX, ca.SX] | None = None,
    ) -> None:
        """Take the recurrence and the coefficients known at first."""
        self.recurrence, self.coefficients = recurrence, list(coefficients)
        self.constant, self.is_time = constant, is_time
        self.affine = affine or (self, _ONE, _ZERO)

    def __getitem__(self, order: int) -> ca.SX:
        return self.coefficients[order]

    def rate(self, order: int) -> ca.SX:
        """Return a coefficient of the time derivative."""
        base, factor, _ = self.affine
        return (order + 1) * factor * base[order + 1]


@dataclass(frozen=True)
class Switch:
    """A series whose sign selects the right-hand side's formula.

    Attributes:
        series: the series.
        at_zero: the side, -1, 0 or 1, to which the value 0 belongs.
        kept: -1 or 1 if the step starts at a sign change, whose rounded value does not decide the side; otherwise 0.
    """

    series: Series
    at_zero: int
    kept: ca.SX

    def side_of(self, value: ca.SX) -> ca.SX:
        """Return the side, -1, 0 or 1, of a value of the series."""
        if self.at_zero == 0:
            return ca.sign(value)
        return ca.if_else(value > 0.0, 1.0, -1.0) if self.at_zero < 0 else ca.if_else(value < 0.0, -1.0, 1.0)

    @property
    def side(self) -> ca.SX:
        """The side whose formula holds in the step."""
        by_value = self.side_of(self.series[0])
        return by_value if self.kept.is_zero() else ca.if_else(self.kept == 0.0, by_value, self.kept)


class Graph:
    """Series that depend on each other, in an order in which each coefficient needs only those before it.

    Attributes:
        ramp_ended: whether the tow ramp is over. In minimum(time, ramp time) the ramp time is then the smaller.
        kept: `Switch.kept` of the first switches, in their order; 0 for all others.
        switches: the switches, in their order.
    """

    def __init__(self, ramp_ended: bool = False, kept: Sequence[ca.SX] = ()) -> None:
        """Begin without any series."""
        self.ramp_ended, self.kept = ramp_ended, kept
        self.switches: list[Switch] = []
        self._all: list[Series] = []
        self._sines_and_cosines: dict[int, tuple[Series, Series]] = {}
        self._squares: dict[int, Series] = {}

    def extend(self, order: int) -> None:
        """Compute the coefficients of an order of all series; those of the orders below must be known."""
        for series in self._all:
            if len(series.coefficients) == order and (found := series.recurrence(series, order)) is not None:
                series.coefficients.append(found)

    def _add(self, series: Series) -> Series:
        self._all.append(series)
        return series

    def given(self, *coefficients: ca.SX) -> Series:
        """Return a series whose coefficients the caller supplies."""
        return self._add(Series(lambda _, __: None, *coefficients))

    def constant(self, value: ca.SX) -> Series:
        """Return the series of a value that is independent of time."""
        return self._add(Series(lambda _, __: _ZERO, value, constant=True))

    def clock(self, now: ca.SX) -> Series:
        """Return the series of the time itself."""
        return self._add(Series(lambda _, k: _ONE if k == 1 else _ZERO, now, is_time=True))

    def scaled(self, x: Series, factor: ca.SX | float) -> Series:
        """Return a multiple of a series by a factor that is independent of time."""
        base, by, plus = x.affine
        affine = base, factor * by, factor * plus
        return self._add(Series(lambda _, k: factor * x[k], is_time=x.is_time, affine=affine))

    def total(self, a: Series, b: Series, sign: float = 1.0) -> Series:
        """Return a + b, or a - b if the sign is -1."""

        def added(x: ca.SX, y: ca.SX) -> ca.SX:
            return x + y if sign > 0.0 else x - y

        affine = None
        if a.constant:
            affine = b.affine[0], sign * b.affine[1], added(a[0], b.affine[2])
        elif b.constant:
            affine = a.affine[0], a.affine[1], added(a.affine[2], b[0])
        return self._add(Series(lambda _, k: added(a[k], b[k]), affine=affine))

    def product(self, a: Series, b: Series) -> Series:
        """Return a b. If both have the same base, it is computed from the square of that."""
        if a.constant or b.constant:
            return self.scaled(b, a[0]) if a.constant else self.scaled(a, b[0])
        (base, p, q), (other_base, r, s) = a.affine, b.affine
        if base is not other_base:
            return self._add(Series(lambda _, k: _convolved(a, b, k, 0)))
        # (p x + q) (r x + s) = p r x^2 + (p s + q r) x + q s
        square = self.square(base)
        return self._add(Series(lambda _, k: p * r * square[k] + (p * s + q * r) * base[k] if k else a[0] * b[0]))

    def square(self, x: Series) -> Series:
        """Return x^2, always the same series for the same x."""
        if id(x) not in self._squares:
            self._squares[id(x)] = self._add(Series(lambda _, k: _self_convolved(x, k, 0)))
        return self._squares[id(x)]

    def quotient(self, a: Series, b: Series) -> Series:
        """Return q = a/b, from a = b q."""
        if b.constant:
            return self.scaled(a, 1.0 / b[0])
        inverse = self._add(Series(lambda _, k: 1.0 / b[0] if k == 0 else _ZERO))
        return self._add(Series(lambda q, k: (a[k] - _convolved(b, q, k, 1)) * inverse[0]))

    def root(self, x: Series) -> Series:
        """Return r = sqrt(x), from x = r^2."""
        return self._add(Series(lambda r, k: (x[k] - _self_convolved(r, k, 1)) / (2.0 * r[0]) if k else ca.sqrt(x[0])))

    def function(self, f: Callable[[ca.SX], ca.SX], x: Series) -> Series:
        """Return y = f(x), from y' = f'(x) x'. The caller must set `Series.derivative`, which may be made of y."""

        def recurrence(y: Series, order: int) -> ca.SX:
            if order == 0:
                return f(x[0])
            rates = [x.rate(k) for k in range(order)]
            return _convolved(rates, y.derivative, order - 1, 0) / order

        return self._add(Series(recurrence))

    def sine_and_cosine(self, x: Series) -> tuple[Series, Series]:
        """Return sin(x) and cos(x), each the derivative of the other; always the same series for the same x."""
        if id(x) not in self._sines_and_cosines:
            sine, cosine = self.function(ca.sin, x), self.function(ca.cos, x)
            sine.derivative, cosine.derivative = cosine, self.scaled(sine, -1.0)
            self._sines_and_cosines[id(x)] = sine, cosine
        return self._sines_and_cosines[id(x)]

    def smaller(self, a: Series, b: Series) -> Series:
        """Return the smaller of two series."""
        switch = self.switch(self.total(a, b, -1.0), -1)
        return self._add(Series(lambda _, k: ca.if_else(switch.side < 0.0, a[k], b[k])))

    def masked(self, x: Series, condition: Series) -> Series:
        """Return a series if a condition is not 0 at the start of the step, otherwise 0."""
        return self._add(Series(lambda _, k: ca.if_else(condition[0], x[k], 0.0)))

    def switch(self, series: Series, at_zero: int) -> Switch:
        """Register a series whose sign selects the right-hand side's formula; see `Switch`."""
        number = len(self.switches)
        self.switches.append(Switch(series, at_zero, self.kept[number] if number < len(self.kept) else _ZERO))
        return self.switches[-1]

    def stepwise(self, f: Callable[..., ca.SX], *arguments: Series) -> Series:
        """Return f(arguments), which is constant as long as no switch changes its sign."""
        return self._add(Series(lambda _, k: f(*(series[0] for series in arguments)) if k == 0 else _ZERO))


def _convolved(a: Series | Sequence[ca.SX], b: Series, k: int, low: int) -> ca.SX:
    """Return the sum of a_j b_(k-j) for j from low to k."""
    pairs = ((a[j], b[k - j]) for j in range(low, k + 1))
    return sum((x * y for x, y in pairs if not (x.is_zero() or y.is_zero())), _ZERO)


def _self_convolved(a: Series, k: int, low: int) -> ca.SX:
    """Return the sum of a_j a_(k-j) for j from low to k - low; each pair of equal products is computed once."""
    pairs = ((a[j], a[k - j]) for j in range(low, (k + 1) // 2))
    total = 2.0 * sum((x * y for x, y in pairs if not (x.is_zero() or y.is_zero())), _ZERO)
    if k % 2 == 0 and k // 2 >= low:
        total = total + a[k // 2] ** 2
    return total


def series_of(graph: Graph, function: ca.Function, inputs: Sequence[Sequence[Series]]) -> list[Series]:
    """Return the series of the results of a Function, one result after the other.

    Args:
        graph: receives the series.
        function: of SX columns.
        inputs: the series of the elements of each argument.

    Raises:
        InputError: an operation without a rule.
    """
    work: dict[int, Series] = {}
    results: list[list[Series]] = [[] for _ in range(function.n_out())]
    for operation, into, of, constant in instructions(function):
        if operation == ca.OP_INPUT:
            work[into[0]] = inputs[of[0]][of[1]]
        elif operation == ca.OP_CONST:
            work[into[0]] = graph.constant(ca.SX(constant))
        elif operation == ca.OP_OUTPUT:
            results[into[0]].append(work[of[0]])
        else:
            work[into[0]] = _apply(graph, operation, [work[i] for i in of])
    return [series for column in results for series in column]


def _apply(graph: Graph, operation: int, of: list[Series]) -> Series:
    """Return the series of an operation's result."""
    if all(series.constant for series in of):
        return graph.constant(_evaluated(operation, *(series[0] for series in of)))
    if operation == ca.OP_FMIN and any(x.is_time for x in of) and any(x.constant for x in of):
        time, ramp_time = sorted(of, key=lambda x: x.constant)
        return ramp_time if graph.ramp_ended else time
    if operation in _RULES:
        return _RULES[operation](graph, *of)
    if operation in _DERIVATIVES:
        return _elementary(graph, operation, *of)
    if operation in _STEPWISE:
        return graph.stepwise(partial(_evaluated, operation), *of)
    raise InputError(
        f"a batch cannot expand the operation '{name_of(operation)}' of a quantity that changes with time: write the"
        " own resistance without it, or use po.simulate for each design"
    )


def _evaluated(operation: int, *of: ca.SX) -> ca.SX:
    return ca.SX.unary(operation, *of) if len(of) == 1 else ca.SX.binary(operation, *of)


def _elementary(graph: Graph, operation: int, x: Series) -> Series:
    """Return the series of y = f(x) for a function of `_DERIVATIVES`."""
    result = graph.function(partial(_evaluated, operation), x)
    derivative = ca.Function("derivative", [_X, _Y], [_DERIVATIVES[operation]])
    (result.derivative,) = series_of(graph, derivative, [[x], [result]])
    return result


def _power(graph: Graph, x: Series, exponent: Series) -> Series:
    if not exponent.constant:
        return _elementary(graph, ca.OP_EXP, graph.product(exponent, _elementary(graph, ca.OP_LOG, x)))
    # CasADi has already turned whole powers into products, which hold for x <= 0 too.
    number = exponent[0]
    result = graph.function(lambda value: value**number, x)
    result.derivative = graph.product(exponent, graph.quotient(result, x))
    return result


def _larger(graph: Graph, a: Series, b: Series) -> Series:
    return graph.scaled(graph.smaller(graph.scaled(a, -1.0), graph.scaled(b, -1.0)), -1.0)


def _less(graph: Graph, a: Series, b: Series, at_zero: int) -> Series:
    switch = graph.switch(graph.total(a, b, -1.0), at_zero)
    return graph.stepwise(lambda: switch.side < 0.0)


def _sign(graph: Graph, x: Series) -> Series:
    switch = graph.switch(x, 0)
    return graph.stepwise(lambda: switch.side)


def _only_if(graph: Graph, condition: Series, x: Series) -> Series:
    # Any number but 0 is true, as for CasADi.
    return graph.scaled(x, condition[0] != 0.0) if condition.constant else graph.masked(x, condition)


# Operations made of sums, products, quotients and roots, and those that change their formula at a switch.
_RULES: dict[int, Callable[..., Series]] = {
    ca.OP_ADD: Graph.total,
    ca.OP_SUB: partial(Graph.total, sign=-1.0),
    ca.OP_NEG: partial(Graph.scaled, factor=-1.0),
    ca.OP_TWICE: partial(Graph.scaled, factor=2.0),
    ca.OP_ASSIGN: partial(Graph.scaled, factor=1.0),
    ca.OP_MUL: Graph.product,
    ca.OP_SQ: Graph.square,
    ca.OP_DIV: Graph.quotient,
    ca.OP_INV: lambda graph, x: graph.quotient(graph.constant(_ONE), x),
    ca.OP_SQRT: Graph.root,
    ca.OP_HYPOT: lambda graph, a, b: graph.root(graph.total(graph.square(a), graph.square(b))),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SIN: lambda graph, x: graph.sine_and_cosine(x)[0],
    ca.OP_COS: lambda graph, x: graph.sine_and_cosine(x)[1],
    ca.OP_FMIN: Graph.smaller,
    ca.OP_FMAX: _larger,
    ca.OP_FABS: lambda graph, x: _larger(graph, x, graph.scaled(x, -1.0)),
    ca.OP_SIGN: _sign,
    ca.OP_IF_ELSE_ZERO: _only_if,
    ca.OP_LT: partial(_less, at_zero=1),
    ca.OP_LE: partial(_less, at_zero=-1),
}

# Functions y = f(x) of one argument, with f'(x) written in x or in y, whichever is shorter.
_X, _Y = ca.SX.sym("x"), ca.SX.sym("y")
_DERIVATIVES = {
    ca.OP_EXP: _Y,
    ca.OP_EXPM1: _Y + 1.0,
    ca.OP_LOG: 1.0 / _X,
    ca.OP_LOG1P: 1.0 / (1.0 + _X),
    ca.OP_SINH: ca.sqrt(1.0 + _Y**2),
    ca.OP_COSH: ca.sinh(_X),
    ca.OP_TAN: 1.0 + _Y**2,
    ca.OP_TANH: 1.0 - _Y**2,
    ca.OP_ATAN: 1.0 / (1.0 + _X**2),
    ca.OP_ATANH: 1.0 / (1.0 - _X**2),
    ca.OP_ASIN: 1.0 / ca.sqrt(1.0 - _X**2),
    ca.OP_ASINH: 1.0 / ca.sqrt(1.0 + _X**2),
    ca.OP_ERF: 2.0 / math.sqrt(math.pi) * ca.exp(-(_X**2)),
}

# Operations on conditions, whose results change only where a condition does.
_STEPWISE = (ca.OP_NOT, ca.OP_AND, ca.OP_OR)


# Only GCC has the flags of the first attempt, which reorder the long sequences of sums and products so that the
# processor waits less.
_BATCH_VARIANTS = variants("-O3", "-fassociative-math", scheduling=("-fschedule-insns", "-fsched-pressure"))
# Designs that NumPy evaluates at once: enough to outweigh the cost of its calls, few enough for the processor's cache.
_BLOCK = 4096


class Engine:
    """Evaluates Functions for many designs, and integrates designs by steps.

    Arrays have a row for each element and a column for each design. Functions of SX and the steps are compiled in the
    fastest variant that this system supports. Without a compiler CasADi evaluates the Functions and NumPy the steps.

    Attributes:
        compiled: whether a compiler was found.
    """

    def __init__(self, functions: dict[str, ca.Function], phases: Sequence[Phase], parameters: int) -> None:
        """Compile the steps and the Functions of SX, if there is a compiler.

        Args:
            functions: all Functions by name, each of one column.
            phases: of the motion, in their order.
            parameters: number of a step's parameters.
        """
        self._functions, self._phases = functions, phases
        self._compiled = {name: one for name, one in functions.items() if one.is_a("SXFunction")}
        whole, address = ctypes.c_int64, ctypes.c_void_p
        arguments: dict[str, tuple[Any, ...]] = dict.fromkeys(self._compiled, (whole, address, address))
        arguments["run"] = (whole, whole, *[address] * 4, ctypes.c_double)
        self._library = loaded(c_source(self._compiled, phases, parameters), _BATCH_VARIANTS, arguments)
        self.compiled = self._library is not None

    def evaluate(self, name: str, rows: Array) -> Array:
        """Return the results of a Function, a row each."""
        if self._library is None or name not in self._compiled:
            return np.asarray(self._functions[name].map(rows.shape[1])(rows))
        rows = np.ascontiguousarray(rows)
        results = np.empty((self._compiled[name].numel_out(), rows.shape[1]))
        getattr(self._library, name)(rows.shape[1], rows.ctypes.data, results.ctypes.data)
        return results

    def run(self, p: Array, states: Array, order: NDArray[np.int64], most: int) -> Array:
        """Integrate designs and return the number of steps that each took.

        Args:
            p: parameters of the steps.
            states: at the start; they are replaced by those at the end.
            order: numbers of the designs to integrate; neighbours share a vector register.
            most: limit on the number of steps.
        """
        taken = np.zeros(p.shape[1])
        if self._library is None:
            self._run_by_numpy(p, states, order, most, taken)
            return taken
        arrays = [array.ctypes.data for array in (order, p, states, taken)]
        self._library.run(p.shape[1], len(order), *arrays, most)
        return taken

    def _run_by_numpy(self, p: Array, states: Array, order: NDArray[np.int64], most: int, taken: Array) -> None:
        with np.errstate(all="ignore"):
            for step, end in self._phases:
                interpreted = Interpreter(step)
                for first in range(0, len(order), _BLOCK):
                    which = order[first : first + _BLOCK]
                    while len(which := which[(states[0, which] < p[end, which]) & (taken[which] < most)]):
                        states[:, which] = interpreted(states[:, which], p[:, which])
                        taken[which] += 1.0


def _error_function(x: Array) -> Array:
    from scipy.special import erf  # imported only if needed, because that is slow

    return np.asarray(erf(x))


EXPRESSIONS = {
    **SIMPLE,
    **{code: f"{{0}} {sign} {{1}}" for code, sign in BINARY.items()},
    **{code: f"({{0}} {sign} {{1}}) * 1.0" for code, sign in COMPARISONS.items()},
    ca.OP_NOT: "({0} == 0.0) * 1.0",
    ca.OP_AND: "logical_and({0}, {1}) * 1.0",
    ca.OP_OR: "logical_or({0}, {1}) * 1.0",
    ca.OP_FABS: "abs({0})",
    ca.OP_SIGN: "sign({0})",
    ca.OP_FMIN: "fmin({0}, {1})",
    ca.OP_FMAX: "fmax({0}, {1})",
    ca.OP_IF_ELSE_ZERO: "where({0}, {1}, 0.0)",
    **{code: f"{name}({{0}})" for code, name in (LIBRARY | LANE_BY_LANE).items()},
    **{code: f"{name}({{0}}, {{1}})" for code, name in LIBRARY_OF_TWO.items()},
}
"""Python's expression for each of CasADi's frequent operations, in which conditions are the numbers 0 and 1."""

# Up to this many designs are evaluated one by one, because arithmetic of NumPy's numbers is many times faster than that
# of short arrays. The results are the same.
_FEW = 8


class Interpreter:
    """Evaluates a Function of SX with one result, a dense column, by Python and NumPy.

    CasADi's own evaluation takes 3 to 7 times as long for a batch of 2000 designs.

    Attributes:
        evaluate: function of the arguments' elements, one sequence for each argument, and of the array that receives
            the results. Any type of floats will do.
    """

    def __init__(self, function: ca.Function) -> None:
        """Write the Function's operations in Python; intermediate results share names as in CasADi's own evaluation."""
        self._results = function.numel_out()
        names: dict[str, Any] = {**vars(np), "erf": _error_function}
        lines = [f"def evaluate({', '.join(f'x{k}' for k in range(function.n_in()))}, results):"]
        for number, (code, into, of, constant) in enumerate(instructions(function)):
            if code == ca.OP_OUTPUT:
                line = f"results[{into[1]}] = w{of[0]}"
            elif code == ca.OP_INPUT:
                line = f"w{into[0]} = x{of[0]}[{of[1]}]"
            elif code == ca.OP_CONST:
                names[f"c{number}"] = np.float64(constant)
                line = f"w{into[0]} = c{number}"
            else:
                line = f"w{into[0]} = " + EXPRESSIONS[code].format(*(f"w{k}" for k in of))
            lines.append(f"  {line}")
        exec("\n".join(lines), names)
        self.evaluate: Callable[..., None] = names["evaluate"]

    def __call__(self, *arguments: Array) -> Array:
        """Return the result, a row for each element; arguments have a row for each element too."""
        count = arguments[0].shape[1]
        results = np.empty((self._results, count))
        if count > _FEW:
            self.evaluate(*arguments, results)
        else:
            for k in range(count):
                self.evaluate(*(argument[:, k] for argument in arguments), results[:, k])
        return results
