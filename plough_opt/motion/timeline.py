"""Times of a run: outputs, ends of steps, and the interpolation of outputs between those ends.

Steps of order 8 are longer than the intervals between outputs. The deflection w and its rate w' at the eight ends of
steps around an output time determine a Hermite polynomial of degree 15. Its error falls by a higher power of the step
size than that of the method. Interpolated states are linear in those at the ends, and so are their derivatives.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

READ_FROM: Final = 8
"""Number of ends of steps from which an output between them is interpolated."""

# A run of n steps has at least this factor times n^(3/4) on either side of a kink. That is enough to interpolate
# between, and the number for a check is sufficiently smaller to show the error that a short ramp leaves.
_LEAST_PER_SIDE: Final = 0.6

# A kink closer to the end of a step than this fraction of the duration is at that end, up to rounding.
_SHORT: Final = 1e-9

Array = NDArray[np.float64]
# Times closer than this fraction of the duration are equal up to rounding.
_SAME: Final = 4.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Timeline:
    """Steps and outputs of a run, as fractions of its duration.

    Args:
        outputs: number of equal intervals between output times.
        steps: number of integration steps; for an adaptive method the largest number.
        kink: fraction between 0 and 1 at which the right-hand side is not smooth (the end of a tow ramp), or None. A
            step ends there, so that the method keeps its order. Without ``aligned`` the steps on either side are
            equally long, no longer than they would be without a kink.
        aligned: whether a step ends at each output. Each output interval then has the nearest whole number of steps, at
            least one. Otherwise outputs are interpolated between the ends of `READ_FROM` steps.
        moving: whether steps of order 8 also end at kinks whose times depend on the parameters: see
            `plough_opt.motion.runge_kutta`. Steps are then aligned, their number in an output interval is rounded up,
            and ``kink`` is None.
    """

    outputs: int
    steps: int
    kink: float | None = None
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
            if self.kink and _SHORT <= self.kink <= 1.0 - _SHORT:
                return self._around_kink(self.kink)
            return self._smooth_part(0.0, 1.0, self.steps)
        steps_per_output = self.steps / self.outputs
        per_interval = max(1, math.ceil(steps_per_output) if self.moving else round(steps_per_output))
        return self._with_kink(np.linspace(0.0, 1.0, self.outputs * per_interval + 1))

    def _around_kink(self, kink: float) -> NDArray[np.float64]:
        """Return the ends of steps before and after a kink."""
        least = min(self.steps, math.ceil(_LEAST_PER_SIDE * self.steps**0.75))
        before, after = (max(math.ceil(part * self.steps), least) for part in (kink, 1.0 - kink))
        return np.concatenate([self._smooth_part(0.0, kink, before), self._smooth_part(kink, 1.0, after)[1:]])

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
        """Times at which a fixed step must end: the outputs and the kink, as fractions of the duration."""
        return self._with_kink(self.output_fractions)

    def _with_kink(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.kink is None or np.min(np.abs(nodes - self.kink)) < _SHORT:
            return nodes
        return np.sort(np.append(nodes, self.kink))

    @cached_property
    def output_columns(self) -> list[int]:
        """Index of each output time among the nodes of an aligned timeline."""
        return [int(i) for i in np.searchsorted(self.nodes, self.output_fractions - 1e-12)]


class Readings(NamedTuple):
    """Interpolation weights: ends of steps in rows, outputs in columns.

    The unit of time is the duration, in rates too.

    Attributes:
        w_by_w: weights of w at the ends in w at the outputs.
        w_by_rate: weights of the rate in w.
        rate_by_w: weights of w in the rate.
        rate_by_rate: weights of the rate in the rate.
    """

    w_by_w: ca.DM
    w_by_rate: ca.DM
    rate_by_w: ca.DM
    rate_by_rate: ca.DM


def at_outputs(timeline: Timeline, states: ca.MX, duration: ca.MX, ramp: ca.MX | None = None) -> ca.MX:
    """Return the states (w [m]; w' [m/s]) at the output times, a column each.

    Args:
        timeline: steps and outputs.
        states: states at the ends of all steps, including the start, a column each.
        duration: simulated time [s].
        ramp: time of a ramp [s] whose end is an additional end of a step; None without one.
    """
    columns = timeline.output_columns
    if ramp is not None:
        # After the ramp's end an output is one column further on.
        reached = ca.repmat(ca.DM(timeline.output_fractions).T * duration <= ramp, states.shape[0], 1)
        return ca.if_else(reached, states[:, columns], states[:, [column + 1 for column in columns]])
    if timeline.aligned:
        return states[:, columns]
    read = readings(timeline)
    w, rate = states[0, :], states[1, :]
    return ca.vertcat(
        w @ read.w_by_w + duration * (rate @ read.w_by_rate),
        (w @ read.rate_by_w) / duration + rate @ read.rate_by_rate,
    )


@lru_cache(maxsize=64)
def readings(timeline: Timeline) -> Readings:
    """Return the interpolation weights of a timeline; no polynomial extends across its kink."""
    nodes, outputs = timeline.nodes, timeline.output_fractions
    kinks = [] if timeline.kink is None else [int(np.argmin(np.abs(nodes - timeline.kink)))]
    inner = [kink for kink in kinks if 0 < kink < len(nodes) - 1]
    rows: list[NDArray[np.int64]] = []
    weights: list[tuple[Array, ...]] = []
    for first, last in zip([0, *inner], [*inner, len(nodes) - 1], strict=True):
        inside = outputs[(outputs <= nodes[last]) & ((first == 0) | (outputs > nodes[first]))]
        count = min(READ_FROM, last + 1 - first)
        around = np.searchsorted(nodes, inside, side="right") - count // 2
        ends = np.clip(around, first, last + 1 - count)[:, None] + np.arange(count)
        rows += list(ends)
        weights += list(zip(*hermite(nodes[ends], inside), strict=True))
    starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    pattern = ca.Sparsity(len(nodes), len(outputs), starts.tolist(), np.concatenate(rows).tolist())
    return Readings(*(ca.DM(pattern, np.concatenate(values)) for values in zip(*weights, strict=True)))


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
