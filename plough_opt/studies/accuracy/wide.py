"""Numerics in the widest floats of the machine: CasADi graphs, quadrature, steps of x' = f(t, x), and events.

A step is a Chebyshev polynomial, found by Picard iteration. Its last coefficients show how accurate it is, and events
are located on it to all digits. Clenshaw, Norton: The solution of nonlinear ordinary differential equations in
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
"""Widest float type of the machine: 64 bits of mantissa on x86, elsewhere often the 53 of a double."""

EPS: Final = np.finfo(WIDE).eps
"""Relative spacing of `WIDE` at 1."""

WIDER: Final = bool(np.finfo(WIDE).eps < np.finfo(np.float64).eps)
"""Whether the machine has floats wider than a double."""

PI: Final = WIDE("3.14159265358979323846264338327950288419716939937511")

Wide: TypeAlias = Any
"""Number or array of `WIDE` floats."""

Rates: TypeAlias = Callable[[Wide, Wide], Wide]
"""Function (times, states) -> rates of the states, a row each."""

# Most Picard iterations of a step.
_MOST_ITERATIONS = 60
# Changes by an iteration, in units in the last place. It has converged at or below this.
_CONVERGED = 4.0
# Below this it has converged, too, if the changes no longer shrink: they are rounding.
_STALLED = 1e4
# From here on it diverges.
_DIVERGED = 1e40
# A coefficient below this many units in the last place is rounding.
_TAIL = 4.0
# Values below this many units in the last place of the largest value have no certain sign.
_ROUNDING = 1e3
# Degree of the polynomial that locates events in a step.
_EVENT_DEGREE = 48
# Parts of each subdivision of the interval around an event, and subdivisions: enough for one unit in the last place.
_PARTS, _SUBDIVISIONS = 32, 14

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
"""Function with one sequence of elements for each argument, each a number or an array over places.

It returns an array for each result, with a row for each element and a column for each place.
"""


def in_wide_floats(arguments: Sequence[ca.SX], results: Sequence[Any]) -> WideGraph:
    """Return a CasADi graph of scalars as a function that computes in the widest floats.

    Args:
        arguments: symbols.
        results: expressions of the symbols.

    Raises:
        InputError: the graph has an operation without a counterpart here, such as the lookup in a table.
    """
    graph = ca.Function("graph", list(arguments), [ca.densify(ca.SX(result)) for result in results])
    steps = []
    for k in range(graph.n_instructions()):
        kind = graph.instruction_id(k)
        if kind not in _OPERATIONS and kind not in (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT):
            raise InputError(
                "an effect of your own uses a function that cannot compute in wide floats, such as a table"
            )
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


@dataclass(frozen=True)
class Basis:
    """Chebyshev nodes of a degree on [-1, 1], with matrices for values at the nodes.

    Attributes:
        nodes: nodes from -1 to 1, both ends included.
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
    """Solution of a step: Chebyshev polynomials over time.

    Attributes:
        start: start of the step [s].
        size: length of the step [s].
        coefficients: Chebyshev coefficients, a row for each state.
        used: number of the second state's coefficients above rounding, divided by the degree; 1 if only the last is
            not.
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
    """Return the solution of one step, or None if the step is too long for the degree.

    Args:
        degree: degree of the polynomials.
        start: start of the step [s].
        size: length of the step [s].
        first: states at the start; the second is the rate of the first.
        rates: rates of the states.
        scales: sizes of the first two states, to which rounding is relative.
    """
    basis = Basis.of(degree)
    times = start + size * (basis.nodes + 1) / 2
    # A step that is too long may overflow before its divergence is detected.
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
    """Return the states at the nodes by Picard iteration, or None if it does not converge."""
    states = first[:, None] + np.zeros(len(times), WIDE)
    states[0] += first[1] * (times - times[0])
    last = np.inf
    for _ in range(_MOST_ITERATIONS):
        new = first[:, None] + rates(times, states) @ integral.T
        new[0] = first[0] + integral @ new[1]
        sizes = np.maximum(scales, np.max(np.abs(new[:2]), axis=1))
        moved = float(np.max(np.max(np.abs(new - states)[:2], axis=1) / sizes) / EPS)
        states = new
        if not moved < _DIVERGED:
            return None
        if moved <= _CONVERGED or (moved < _STALLED and moved >= last):
            return states
        last = moved
    return None


def first_end(function: Callable[[Wide], Wide], start: Wide, size: Wide) -> Wide | None:
    """Return the first time in a step after which a smooth function is negative, or None.

    The roots of its Chebyshev interpolant, in doubles, part the step into pieces without a change of sign. Repeated
    subdivision around one of them adds the digits of wide floats.

    Args:
        function: function of an array of times; positive or zero at the start.
        start: start of the step [s].
        size: length of the step [s].
    """

    def at(places: Wide) -> Wide:
        return function(start + size * (places + 1) / 2)

    basis = Basis.of(_EVENT_DEGREE)
    values = at(basis.nodes)
    zero = _ROUNDING * EPS * np.max(np.abs(values))
    series = chebyshev.chebtrim((basis.coefficients @ values).astype(float), float(zero))
    if series[0] > np.sum(np.abs(series[1:])):
        return None
    # Keep complex roots too: rounding may make them of two real ones, and one piece more does no harm.
    roots = chebyshev.chebroots(series).real
    ends = np.concatenate([[-1.0], np.sort(roots[np.abs(roots) < 1.0]), [1.0]])
    middles = (ends[1:] + ends[:-1]) / WIDE(2)
    negative = np.flatnonzero(at(middles) < -zero)
    if not negative.size:
        return None
    if not negative[0]:
        return start
    low, high = middles[negative[0] - 1], middles[negative[0]]
    for _ in range(_SUBDIVISIONS):
        places = low + (high - low) * np.arange(_PARTS + 1) / WIDE(_PARTS)
        first = max(1, int(np.argmax(at(places) < 0.0)))
        low, high = places[first - 1], places[first]
    return start + size * (high + 1) / 2
