"""Steps and times of a run: fixed-step integration by a Butcher tableau as one CasADi Function; by default DOP853.

A step is a small symbolic graph, and a run a loop over it (``mapaccum``). The size of the graph is independent of the
number of steps, and derivatives are exactly those of the computed results.

Steps of order 8 are longer than the intervals between outputs. The deflection w and its rate w' at the eight ends of
steps around an output time determine a Hermite polynomial of degree 15. Its error falls by a higher power of the step
size than that of the method. Interpolated states are linear in those at the ends, and so are their derivatives.

A step ends at the end of a tow ramp, even if parameters move that end. Across a kink steps of order 8 lose their order,
and each differentiation by a parameter that moves the kink loses one order more. The smooth contact has four
derivatives everywhere, which is enough.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.expressions import Column, stacked
from plough_opt.motion.equation import Equation
from plough_opt.motion.methods import DOP853, Tableau

READ_FROM: Final = 8
"""Number of ends of steps from which an output between them is interpolated."""


# A kink closer to the end of a step than this fraction of the duration is at that end, up to rounding.
_SHORT: Final = 1e-9

GAUSS_POINTS: Final = 10
"""Gauss-Legendre nodes in each panel, for the averages of a numeric quasi-static run and of a component."""

MORE_POINTS: Final = 6
"""Additional nodes in each panel of the checking run."""

Array = NDArray[np.float64]
# Times closer than this fraction of the duration are equal up to rounding.
_SAME: Final = 4.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Timeline:
    """Steps and outputs of a run, as fractions of its duration.

    Args:
        outputs: number of equal intervals between output times.
        steps: number of integration steps; for an adaptive method the largest number.
        kinks: fractions between 0 and 1, rising, at which the right-hand side is not smooth: the end of a tow ramp or
            the knots of a speed profile. A step ends there, so that the method keeps its order. Without ``aligned`` the
            steps between two of them are equally long, no longer than they would be without a kink.
        aligned: whether a step ends at each output. Each output interval then has the nearest whole number of steps, at
            least one. Otherwise outputs are interpolated between the ends of `READ_FROM` steps.
        moving: whether parameters move the end of a ramp. It divides one of the steps, which are then aligned.
    """

    outputs: int
    steps: int
    kinks: tuple[float, ...] = ()
    aligned: bool = True
    moving: bool = False

    @cached_property
    def output_fractions(self) -> NDArray[np.float64]:
        """Output times as fractions of the duration, both ends included."""
        return np.linspace(0.0, 1.0, self.outputs + 1)

    @cached_property
    def nodes(self) -> NDArray[np.float64]:
        """Ends of the steps as fractions of the duration, both ends included."""
        if not self.aligned:
            return self._between_kinks([kink for kink in self.kinks if _SHORT <= kink <= 1.0 - _SHORT])
        per_interval = max(1, round(self.steps / self.outputs))
        return self._with_kink(np.linspace(0.0, 1.0, self.outputs * per_interval + 1))

    def _between_kinks(self, kinks: list[float]) -> NDArray[np.float64]:
        """Return the ends of steps before, between and after kinks."""
        # A run of n steps has at least this factor times n^(3/4) on either side of a kink. That is enough to
        # interpolate between, and the number for a check is sufficiently smaller to show the error that a short ramp
        # leaves.
        least = min(self.steps, math.ceil(0.6 * (self.steps / len(kinks)) ** 0.75)) if kinks else 0
        parts = [
            self._smooth_part(start, end, max(math.ceil((end - start) * self.steps), least))
            for start, end in itertools.pairwise((0.0, *kinks, 1.0))
        ]
        return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])

    def _smooth_part(self, start: float, end: float, steps: int) -> NDArray[np.float64]:
        """Return the ends of equal steps of which the first and the last are halved.

        Interpolation near the ends, where all data lie on one side, is then as exact as in the middle. With 0.5 rad per
        step the error of rates is 1e-14 instead of 3e-12, and with 1.6 rad it is 2e-7 instead of 8e-5.
        """
        equal = np.linspace(start, end, steps + 1)
        if self.outputs == 1:  # nothing is interpolated
            return equal
        halves = (equal[0] + equal[1]) / 2.0, (equal[-2] + equal[-1]) / 2.0
        return np.unique(np.append(equal, halves))

    @cached_property
    def stops(self) -> NDArray[np.float64]:
        """Times at which a fixed step must end: the outputs and the kinks, as fractions of the duration."""
        return self._with_kink(self.output_fractions)

    def _with_kink(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        apart = [kink for kink in self.kinks if np.min(np.abs(nodes - kink)) >= _SHORT]
        return np.sort(np.append(nodes, apart)) if apart else nodes


class Readings(NamedTuple):
    """Ends of steps from which each output is interpolated, and their weights.

    The unit of time is the duration, in rates too. Near a kink an output may be read from fewer ends; the rest then
    have no weight.

    Attributes:
        ends: numbers of the ends, a row for each output.
        weights: (output, end, component of the output, component at the end) -> weight.
    """

    ends: NDArray[np.int64]
    weights: Array


def at_outputs(timeline: Timeline, states: ca.MX, duration: ca.MX, ramp: Any = None) -> ca.MX:
    """Return the states (w [m]; w' [m/s]) at the output times, a column each.

    Args:
        timeline: steps and outputs.
        states: states at the ends of all steps, including the start, a column each; the upper half of the rows has w
            and the lower half w', if there are more than two.
        duration: simulated time [s].
        ramp: time of a ramp [s] whose end divides a step.
    """
    if timeline.aligned:
        # Index of each output time among the nodes, where one of them is at each.
        columns = [int(i) for i in np.searchsorted(timeline.nodes, timeline.output_fractions - 1e-12)]
        if not timeline.moving:
            return states[:, columns]
        # After the ramp's end an output is one column further on.
        reached = ca.repmat(ca.DM(timeline.output_fractions).T * duration <= ramp, states.shape[0], 1)
        return ca.if_else(reached, states[:, columns], states[:, [k + 1 for k in columns]])
    w, rate = ca.vertsplit(states, states.shape[0] // 2)
    w_by_w, w_by_rate, rate_by_w, rate_by_rate = _matrices(timeline)
    return ca.vertcat(w @ w_by_w + duration * (rate @ w_by_rate), (w @ rate_by_w) / duration + rate @ rate_by_rate)


@lru_cache(maxsize=64)
def _matrices(timeline: Timeline) -> list[ca.DM]:
    """Return the weights of `Readings` as sparse matrices, ends of steps in rows, outputs in columns."""
    ends, weights = readings(timeline)
    kept = np.any(weights != 0.0, axis=(2, 3))
    column, size = np.nonzero(kept)[0].tolist(), (len(timeline.nodes), len(ends))
    values = weights[kept].reshape(-1, 4).T
    return [ca.DM.triplet(ends[kept].tolist(), column, ca.DM(each), *size) for each in values]


@lru_cache(maxsize=64)
def readings(timeline: Timeline) -> Readings:
    """Return the interpolation weights of a timeline; no polynomial extends across a kink."""
    nodes, outputs = timeline.nodes, timeline.output_fractions
    kinks = [int(np.argmin(np.abs(nodes - kink))) for kink in timeline.kinks]
    inner = [kink for kink in kinks if 0 < kink < len(nodes) - 1]
    read = np.zeros((len(outputs), READ_FROM), dtype=np.int64)
    weights = np.zeros((len(outputs), READ_FROM, 2, 2))
    for first, last in zip([0, *inner], [*inner, len(nodes) - 1], strict=True):
        inside = np.flatnonzero((outputs <= nodes[last]) & ((first == 0) | (outputs > nodes[first])))
        count = min(READ_FROM, last + 1 - first)
        around = np.searchsorted(nodes, outputs[inside], side="right") - count // 2
        ends = np.clip(around, first, last + 1 - count)[:, None] + np.arange(count)
        read[inside, :count] = ends
        found = np.stack(hermite(nodes[ends], outputs[inside]), axis=-1)
        weights[inside, :count] = found.reshape(*found.shape[:2], 2, 2)
    return Readings(read, weights)


def hermite(x: Array, t: Array) -> tuple[Array, Array, Array, Array]:
    """Return the weights of values and slopes at points x in the value and in the slope of their polynomial at t.

    The four arrays are value by values, value by slopes, slope by values and slope by slopes. If t is one of the
    points, only that point has weight: otherwise the relative rounding of very short steps would enter the slope.

    Args:
        x: points, a row for each t.
        t: times at which the polynomial is evaluated.
    """
    count = x.shape[1]
    gap = x[:, :, None] - x[:, None, :] + np.eye(count)
    part = (t[:, None, None] - x[:, None, :]) / gap
    part[:, np.arange(count), np.arange(count)] = 1.0
    lagrange = np.prod(part, axis=2)
    steep = np.sum(1.0 / gap, axis=2) - 1.0
    slope = np.zeros_like(x)
    for k in range(count):
        others = np.delete(part, k, axis=2)
        slope += np.where(np.arange(count) == k, 0.0, np.prod(others, axis=2) / gap[:, :, k])
    since = t[:, None] - x
    by_value, by_slope = 1.0 - 2.0 * since * steep, since
    grows = 2.0 * lagrange * slope
    here = np.abs(since) <= _SAME
    apart = ~here.any(axis=1, keepdims=True)
    return (
        np.where(apart, by_value * lagrange**2, here),
        np.where(apart, by_slope * lagrange**2, 0.0),
        np.where(apart, by_value * grows - 2.0 * steep * lagrange**2, 0.0),
        np.where(apart, by_slope * grows + lagrange**2, here),
    )


def pairs(count: int) -> list[tuple[int, int]]:
    """Return the index pairs (a, b) with a <= b of second derivatives, in the order that jets use."""
    return [(a, b) for a in range(count) for b in range(a, count)]


def product(x: Sequence[Any], y: Sequence[Any], count: int) -> list[Any]:
    """Return the Taylor coefficients of an elementwise product from those of its factors.

    Args:
        x: value, first derivatives by ``count`` parameters and, for order 2, the second ones of `pairs`.
        y: the same for the other factor.
        count: number of parameters.
    """
    found = [x[0] * y[0], *(x[0] * y[a] + x[a] * y[0] for a in range(1, 1 + count))]
    for k, (a, b) in enumerate(pairs(count) if len(x) > 1 + count else [], start=1 + count):
        found.append(x[0] * y[k] + x[k] * y[0] + x[1 + a] * y[1 + b] + x[1 + b] * y[1 + a])
    return found


def pooled(
    moments: ca.MX, spans: ca.MX | ca.DM, signals: int, count: int = 0, ramp_part: ca.MX | None = None
) -> tuple[ca.MX, ca.MX]:
    """Return the means, and the mean squares about the mean, over a run from the moments of its steps.

    Args:
        moments: jets of the moments (means of all signals, then their spreads), step by step.
        spans: see `spans_of`.
        signals: number of signals.
        count: number of parameters by which the moments are differentiated.
        ramp_part: jet of the ramp's part of the duration, if its end divides a step.

    Returns:
        Both with a row for each signal and the columns of the jet.
    """
    # All columns of the jet together: with many steps CasADi takes longer to build a graph than to evaluate it.
    rows, steps = moments.shape[0], spans.shape[1]
    width = moments.shape[1] // steps
    flat = ca.reshape(moments, rows * width, steps)

    def average(summed: Callable[[ca.MX | ca.DM], ca.MX]) -> ca.MX:
        """Return the jets of averages from the function that sums jets with weights of the steps."""
        by_duration = summed(spans[1, :])
        if ramp_part is None:
            return by_duration
        parts = ca.horzsplit(ramp_part), ca.horzsplit(summed(spans[3, :]))
        return ca.MX(by_duration + ca.horzcat(*product(*parts, count)))

    sums = average(lambda sizes: ca.reshape(flat @ sizes.T, rows, width))
    means, spreads = ca.vertsplit(sums, [0, signals, rows])
    # The spreads within steps and the spread of their means are both positive, so nothing cancels in the sum.
    drifts = [flat[k::rows, :] - ca.repmat(means[k, :].T, 1, steps) for k in range(rows - signals)]
    if drifts:
        spreads += average(lambda sizes: ca.vertcat(*(_summed_square(drift, sizes, count) for drift in drifts)))
    return means, spreads


def _summed_square(jet: ca.MX, weights: ca.MX | ca.DM, count: int) -> ca.MX:
    """Return the jet of the weighted sum of a quantity's square, as a row; ``jet`` has a column for each summand."""
    sums = (jet[0, :] * weights) @ jet.T
    slopes, bends = 2.0 * sums[:, 1 : 1 + count], 2.0 * sums[:, 1 + count :]
    if bends.numel():
        first = jet[1 : 1 + count, :]
        mixed = 2.0 * (first * ca.repmat(weights, count, 1)) @ first.T
        bends = bends + ca.horzcat(*(mixed[a, b] for a, b in pairs(count)))
    return ca.horzcat(sums[:, 0], slopes, bends)


def step_symbols(equation: Equation, rows: int = 2) -> tuple[ca.SX, ca.SX, Column, Column]:
    """Return symbols of a step: its span as in `spans_of`, the parameters with the duration last, start and size [s].

    Start and size follow from the other two.
    """
    span, (p, known) = ca.SX.sym("span", rows), equation.symbols(ca.SX)
    start, size = span[0] * p[-1], span[1] * p[-1]
    if rows == 2:
        return span, p, start, size
    return span, p, start + span[2] * known["ramp_time"], size + span[3] * known["ramp_time"]


def spans_of(timeline: Timeline, duration: ca.MX, ramp: Any) -> ca.MX | ca.DM:
    """Return start and size of each step as fractions of the duration, a column each.

    If the end of a ramp divides a step, two more rows are parts of both as fractions of the ramp's time, to be added.
    If it ends at an end of a step or after the run, one step has no length. All are constant under differentiation.
    """
    if not timeline.moving:
        return ca.DM(np.vstack([timeline.nodes[:-1], np.diff(timeline.nodes)]))
    before, after = ca.DM(timeline.nodes[:-1]), ca.DM(timeline.nodes[1:])
    begun, reached = before * duration <= ramp, after * duration <= ramp
    ends, at_ramp = stacked(0.0, reached * after + (1.0 - begun) * before, 1.0), stacked(0.0, begun - reached, 0.0)
    # Second derivatives of the ramp's formulas jump at its end. A stage there belongs to the side on which its step is.
    side = stacked(1.0 - 2.0 * begun, 1.0)
    starts, sizes = at_ramp[:-1] + 1e-14 * side, at_ramp[1:] - at_ramp[:-1]
    rows: ca.MX = ca.horzcat(ends[:-1], ends[1:] - ends[:-1], starts, sizes).T
    return rows


def ramp_of(timeline: Timeline, equation: Equation, p: Any) -> Any:
    """Return the time [s] of a ramp whose end divides a step, from the equation's parameters, or None."""
    return equation.named(p)["ramp_time"] if timeline.moving else None


def quadrature(timeline: Timeline, points: int) -> tuple[Array, Array]:
    """Return the nodes and weights of a time average by panels, as fractions of the duration.

    Args:
        timeline: times of a quasi-static run; each step is a panel.
        points: number of Gauss-Legendre nodes in each panel.
    """
    nodes, weights = np.polynomial.legendre.leggauss(points)
    sizes = np.diff(timeline.nodes)[:, None]
    inner = timeline.nodes[:-1, None] + sizes * (nodes + 1.0) / 2.0
    return inner.ravel(), (sizes * weights / 2.0).ravel()


@lru_cache(maxsize=64)
def step(equation: Equation, tableau: Tableau = DOP853, rows: int = 2) -> ca.Function:
    """Return one step as a Function: (state, span, parameters with the duration last) -> (state, moments).

    The span is that of `spans_of`, with as many rows. The moments are the mean of each signal over the step and then,
    for each signal with an RMS, the mean square about that mean. Both are computed from the deviation from the value at
    the step's start, in which cancellation costs at most a factor of four.
    """
    span, p, start, size = step_symbols(equation, rows)
    given, state = p[:-1], ca.SX.sym("state", equation.states)
    rates: list[ca.SX] = []
    first = equation.signals(start, state, given)
    mean, square = ca.SX.zeros(equation.count), ca.SX.zeros(equation.squared)

    def moved(weights: Sequence[float]) -> ca.SX:
        """Return the state after the step if its rate is the weighted sum of those so far."""
        return sum(((size * part) * rate for part, rate in zip(weights, rates, strict=True) if part != 0.0), state)

    for row, node, weight in zip(tableau.stages, tableau.nodes, tableau.weights, strict=True):
        time, stage = start + node * size, moved(row)
        rates.append(equation.rate(time, stage, given))
        if weight != 0.0:
            change = equation.signals(time, stage, given) - first
            mean += weight * change
            square += weight * change[: equation.squared] ** 2
    spread = square - mean[: equation.squared] ** 2
    return ca.Function("step", [state, span, p], ca.cse([moved(tableau.weights), stacked(first + mean, spread)]))


def run_map(equation: Equation, timeline: Timeline, tableau: Tableau = DOP853) -> ca.Function:
    """Return a run as a Function of the parameters: see `plough_opt.motion.solvers.integrators.Integration`."""
    p, _ = equation.symbols(ca.MX)
    results = run_from(equation, timeline, tableau)(equation.start(p[:-1]), p)
    return ca.Function("run_map", [p], list(results), {"never_inline": True})


@lru_cache(maxsize=64)
def run_from(equation: Equation, timeline: Timeline, tableau: Tableau = DOP853) -> ca.Function:
    """Return a run from any state: (state at time 0, parameters) -> (states at the outputs, means, variances)."""
    first, (p, _) = ca.MX.sym("first", 2), equation.symbols(ca.MX)
    ramp = ramp_of(timeline, equation, p)
    spans = spans_of(timeline, p[-1], ramp)
    rows, count = spans.shape
    states, moments = step(equation, tableau, rows).mapaccum(count)(first, spans, ca.repmat(p, 1, count))
    averages = pooled(moments, spans, equation.count, ramp_part=None if ramp is None else ramp / p[-1])
    found = at_outputs(timeline, ca.horzcat(first, states), p[-1], ramp)
    return ca.Function("run_from", [first, p], [found, *averages])
