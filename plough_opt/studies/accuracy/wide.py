"""Numerics in the machine's widest floats: CasADi's graphs, quadrature, steps of x' = f(t, x), and their events.

A step is a Chebyshev polynomial that Picard's iteration finds. Its last coefficients show how accurate it is, and on it
events are found to all their digits. Clenshaw, Norton: The solution of nonlinear ordinary differential equations in
Chebyshev series, Computer Journal 6 (1963), 88-92.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, TypeAlias

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev

from plough_opt.core.errors import InputError

WIDE: Final = np.longdouble
"""The widest floats of the machine: 64 bits of mantissa on x86, elsewhere often the 53 of a double."""

EPS: Final = np.finfo(WIDE).eps
"""Rounding of `WIDE`."""

WIDER: Final = bool(np.finfo(WIDE).eps < np.finfo(np.float64).eps)
"""Whether the machine has floats wider than a double."""

PI: Final = WIDE("3.14159265358979323846264338327950288419716939937511")

Wide: TypeAlias = Any
"""A number of `WIDE`, or an array of them."""

Rates: TypeAlias = Callable[[Wide, Wide], Wide]
"""Rates of the states, a row each, from times and states."""

_MOST_SWEEPS = 60
# Rounding of a sweep, in units of the last place, beyond which it no longer converges.
_CONVERGED = 4.0
_STALLED = 1e4
_LOST = 1e40
# A coefficient below this many units is rounding.
_TAIL = 4.0
# A value below this part of the largest is taken for rounding of zero, and has no sign.
_ROUNDING = 1e3
# Fractions of a step at which signs are looked at, dense towards both ends, 0 left out.
_LOOKS = (1 - np.cos(PI * np.arange(1, 97) / 96)) / 2
# An interval that holds an event is cut into so many parts, so often: to one unit of the last place.
_PARTS, _CUTS = 32, 14
# Part of the largest value below which the least one may hide a dip below zero between two looks.
_DIP = 0.05

_OPERATIONS: Final[dict[int, Callable[..., Wide]]] = {
    ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide, ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square, ca.OP_TWICE: lambda x: x + x, ca.OP_INV: lambda x: 1 / x, ca.OP_SQRT: np.sqrt,
    ca.OP_POW: np.power, ca.OP_CONSTPOW: np.power, ca.OP_EXP: np.exp, ca.OP_LOG: np.log, ca.OP_EXPM1: np.expm1,
    ca.OP_LOG1P: np.log1p, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan, ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos, ca.OP_ATAN: np.arctan, ca.OP_ATAN2: np.arctan2, ca.OP_SINH: np.sinh, ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh, ca.OP_ASINH: np.arcsinh, ca.OP_FABS: np.abs, ca.OP_SIGN: np.sign, ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum, ca.OP_LT: np.less, ca.OP_LE: np.less_equal, ca.OP_EQ: np.equal, ca.OP_NE: np.not_equal,
    ca.OP_NOT: np.logical_not, ca.OP_AND: np.logical_and, ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: lambda condition, value: np.where(condition, value, WIDE(0)),
}  # fmt: skip


WideGraph: TypeAlias = Callable[..., list[Wide]]
"""Takes for each argument its elements, numbers or arrays over places; returns each result, a row for each element."""


def in_wide_floats(arguments: Sequence[ca.SX], results: Sequence[Any]) -> WideGraph:
    """Return a graph of scalars as a function that computes in the widest floats.

    Raises:
        InputError: an operation that has no counterpart here, such as a table's.
    """
    graph = ca.Function("graph", list(arguments), [ca.densify(ca.SX(result)) for result in results])
    steps = []
    for k in range(graph.n_instructions()):
        kind = graph.instruction_id(k)
        if kind not in _OPERATIONS and kind not in (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT):
            raise InputError("an own effect holds a function that cannot compute in wide floats")
        constant = WIDE(graph.instruction_constant(k)) if kind == ca.OP_CONST else None
        steps.append((kind, graph.instruction_input(k), graph.instruction_output(k), constant))
    rows = [graph.nnz_out(k) for k in range(graph.n_out())]

    def evaluate(*given: Iterable[Wide]) -> list[Wide]:
        elements = [list(argument) for argument in given]
        places = max(np.size(element) for argument in elements for element in argument)
        work: list[Wide] = [None] * graph.sz_w()
        found = [np.zeros((count, places), WIDE) for count in rows]
        for kind, sources, targets, constant in steps:
            if kind == ca.OP_CONST:
                work[targets[0]] = constant
            elif kind == ca.OP_INPUT:
                work[targets[0]] = elements[sources[0]][sources[1]]
            elif kind == ca.OP_OUTPUT:
                found[targets[0]][targets[1]] = work[sources[0]]
            else:
                work[targets[0]] = _OPERATIONS[kind](*(work[source] for source in sources))
        return found

    return evaluate


@lru_cache(maxsize=8)
def gauss(count: int) -> tuple[Wide, Wide]:
    """Return Gauss-Legendre nodes on [-1, 1] and weights, NumPy's sharpened by Newton's method."""
    x: Wide = np.polynomial.legendre.leggauss(count)[0].astype(WIDE)
    for _ in range(3):
        # NumPy's own evaluation of the polynomial rounds its factors to doubles.
        before, now = np.ones_like(x), x
        for k in range(2, count + 1):
            before, now = now, ((2 * k - 1) * x * now - (k - 1) * before) / k
        slope = count * (before - x * now) / (1 - x**2)
        x = x - now / slope
    return x, 2 / ((1 - x**2) * slope**2)


@dataclass(frozen=True)
class Basis:
    """Chebyshev nodes of a degree on [-1, 1], both ends included, and what belongs to them.

    Attributes:
        nodes: from -1 to 1.
        coefficients: matrix from values at the nodes to Chebyshev coefficients.
        integral: matrix from values at the nodes to integrals from -1 to each node.
    """

    nodes: Wide
    coefficients: Wide
    integral: Wide

    @classmethod
    @lru_cache(maxsize=8)
    def of(cls, degree: int) -> Basis:
        """Return the basis of a degree."""
        k = np.arange(degree + 1)
        nodes = -np.cos(PI * k / degree)
        ends = np.where((k == 0) | (k == degree), WIDE(0.5), WIDE(1.0))
        coefficients = 2 * np.cos(PI * np.outer(k, degree - k) / degree) * ends[:, None] * ends[None, :] / degree
        antiderivative = chebyshev.chebint(coefficients, lbnd=-1)
        return cls(nodes, coefficients, chebyshev.chebvander(nodes, degree + 1) @ antiderivative)


@dataclass(frozen=True)
class Step:
    """Solution of a step: polynomials over the time from its start.

    Attributes:
        start: time [s].
        size: length [s].
        coefficients: of Chebyshev's polynomials, a row for each state.
        used: part of the second state's coefficients that are above rounding; 1 where all but the last are.
    """

    start: Wide
    size: Wide
    coefficients: Wide
    used: float

    def at(self, times: Wide) -> Wide:
        """Return the states, a row each, at times within the step."""
        places = 2 * (times - self.start) / self.size - 1
        return chebyshev.chebval(places, self.coefficients.T)


def step(degree: int, start: Wide, size: Wide, first: Wide, rates: Rates, scales: Wide) -> Step | None:
    """Return the solution of one step, or None where the step is too long for the degree.

    Args:
        degree: of the polynomials.
        start: of the step [s].
        size: of the step [s].
        first: states at the start; the second is the rate of the first.
        rates: of the states.
        scales: sizes of the first two states, to which rounding is relative.
    """
    basis = Basis.of(degree)
    times = start + size * (basis.nodes + 1) / 2
    # A step that is too long diverges, which is one way to find that out.
    with np.errstate(over="ignore", invalid="ignore"):
        states = _solved(size / 2 * basis.integral, times, first, rates, scales)
    if states is None:
        return None
    coefficients = states @ basis.coefficients.T
    largest = max(scales[1], np.max(np.abs(states[1])))
    above = np.flatnonzero(np.abs(coefficients[1]) > _TAIL * EPS * largest)
    used = (1.0 + above[-1]) / degree if above.size else 0.0
    return None if used > 1.0 else Step(start, size, coefficients, used)


def _solved(integral: Wide, times: Wide, first: Wide, rates: Rates, scales: Wide) -> Wide | None:
    """Return the states at the nodes; None where the iteration does not converge."""
    states = first[:, None] + np.zeros(len(times), WIDE)
    states[0] += first[1] * (times - times[0])
    last = np.inf
    for _ in range(_MOST_SWEEPS):
        new = first[:, None] + rates(times, states) @ integral.T
        new[0] = first[0] + integral @ new[1]
        sizes = np.maximum(scales, np.max(np.abs(new[:2]), axis=1))
        moved = float(np.max(np.max(np.abs(new - states)[:2], axis=1) / sizes) / EPS)
        states = new
        if not moved < _LOST:
            return None
        if moved <= _CONVERGED or (moved < _STALLED and moved >= last):
            return states
        last = moved
    return None


def first_end(function: Callable[[Wide], Wide], start: Wide, size: Wide) -> Wide | None:
    """Return the first time in a step after which a smooth function is negative, or None.

    Args:
        function: of an array of times; positive, or zero, at the start.
        start: of the step [s].
        size: of the step [s].
    """
    times = start + size * _LOOKS
    values = function(times)
    largest = np.max(np.abs(values))
    zero = _ROUNDING * EPS * largest
    negative = np.flatnonzero(values < -zero)
    if not negative.size:
        k = int(np.argmin(values))
        if not 0 < k < len(times) - 2 or values[k] > _DIP * largest:
            return None
        lowest = sum(_narrowed(function, times[k - 1], times[k + 1], _valley)) / 2
        return _crossing(function, times[k - 1], lowest) if function(np.array([lowest]))[0] < -zero else None
    positive = np.flatnonzero(values[: negative[0]] > zero)
    if positive.size:
        return _crossing(function, times[positive[-1]], times[negative[0]])
    starts_positive = function(np.array([start]))[0] > zero
    return _crossing(function, start, times[negative[0]]) if starts_positive else start


def _crossing(function: Callable[[Wide], Wide], low: Wide, high: Wide) -> Wide:
    """Return where a function that is positive at low and negative at high is zero."""
    low, high = _narrowed(function, low, high, _change)
    # A last chord takes the place of the halving that rounding of the time no longer allows.
    one, other = function(np.array([low, high]))
    return low + (high - low) * one / (one - other) if one > other else high


def _narrowed(
    function: Callable[[Wide], Wide], low: Wide, high: Wide, choose: Callable[[Wide], tuple[int, int]]
) -> tuple[Wide, Wide]:
    """Return the ends of an interval after cutting it again and again to the part that is chosen by its values."""
    for _ in range(_CUTS):
        times = low + (high - low) * np.arange(_PARTS + 1) / WIDE(_PARTS)
        first, last = choose(function(times))
        low, high = times[first], times[last]
        if high - low <= 2 * EPS * abs(high):
            break
    return low, high


def _change(values: Wide) -> tuple[int, int]:
    """Return the places before and after the first change to negative values."""
    k = max(1, int(np.argmax(values < 0.0))) if np.any(values < 0.0) else len(values) - 1
    return k - 1, k


def _valley(values: Wide) -> tuple[int, int]:
    """Return the places on both sides of the least value."""
    k = min(max(int(np.argmin(values)), 1), len(values) - 2)
    return k - 1, k + 1
