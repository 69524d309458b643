"""The times of a run: where it is sampled, where steps end, and how outputs between those ends are read.

Steps of order 8 are long beside the spacing of a run's outputs. The deflection w and its rate w' at eight ends of steps
around an output time determine a Hermite polynomial of degree 15, whose error falls by a higher power of the step than
the method's. What is read is linear in the states, so that derivatives with respect to anything are read likewise.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

READ_FROM: Final = 8
"""Ends of steps from which an output is read that lies at none of them."""

# Of n steps so many times n^(3/4) at the least lie on either side of a kink. They are enough to read between, and of
# a check with fewer steps they are so much fewer there too that what a short ramp leaves of error is seen.
_LEAST: Final = 0.6

# Part of the duration below which a kink is at rounding distance from the end of a step: it would make steps of no
# length.
_SHORT: Final = 1e-9

Array = NDArray[np.float64]
# Rounding of times that are equal, as fractions of the duration.
_SAME: Final = 4.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Timeline:
    """Steps and outputs of a run, as fractions of its duration.

    Args:
        outputs: number of equal intervals between output times.
        steps: number of integration steps. Of an adaptive method the most that it takes.
        kink: fraction at which the right-hand side is not smooth (the end of a tow ramp), or None. A
            step ends there, so that the method keeps its order. Between 0 and 1. Where no step need end at the
            outputs, steps are of equal length on either side of it, no longer than without it, and some on each.
        aligned: whether a step ends at each output; each output interval then takes the nearest whole number of
            steps, at least one. Else outputs are read between the ends of `READ_FROM` steps.
        moving: whether steps of order 8 end at kinks too wherever the parameters put these: see
            `plough_opt.motion.runge_kutta`. Then they are aligned, an output interval takes no fewer steps than its
            share, and ``kink`` is None.
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
            return (
                self._in_two()
                if self.kink and _SHORT <= self.kink <= 1.0 - _SHORT
                else self._part(0.0, 1.0, self.steps)
            )
        share = self.steps / self.outputs
        per_interval = max(1, math.ceil(share) if self.moving else round(share))
        return self._with_kink(np.linspace(0.0, 1.0, self.outputs * per_interval + 1))

    def _in_two(self) -> NDArray[np.float64]:
        """Return the ends of steps to the kink and from there."""
        assert self.kink is not None  # else there is one part
        least = min(self.steps, math.ceil(_LEAST * self.steps**0.75))
        before, after = (max(math.ceil(part * self.steps), least) for part in (self.kink, 1.0 - self.kink))
        return np.concatenate([self._part(0.0, self.kink, before), self._part(self.kink, 1.0, after)[1:]])

    def _part(self, start: float, end: float, steps: int) -> NDArray[np.float64]:
        """Return the ends of a part's steps: of equal ones, of which the outermost two are halved.

        What is read from one side, between the outermost ends, is then as exact as in the middle: for half a radian a
        step rates are 1e-14 off, of equal steps 3e-12, and for 1.6 rad 2e-7, of equal steps 8e-5.
        """
        equal = np.linspace(start, end, steps + 1)
        if self.outputs == 1:  # and nothing is read
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


@dataclass(frozen=True)
class Readings:
    """Weights of the states at the ends of all steps in those at the outputs: ends in rows, outputs in columns.

    The time is counted in durations here, also in the rate.

    Attributes:
        w_by_w: of w in w.
        w_by_rate: of the rate in w.
        rate_by_w: of w in the rate.
        rate_by_rate: of the rate in the rate.
    """

    w_by_w: ca.DM
    w_by_rate: ca.DM
    rate_by_w: ca.DM
    rate_by_rate: ca.DM


def at_outputs(timeline: Timeline, states: ca.MX, duration: ca.MX, ramp: ca.MX | None = None) -> ca.MX:
    """Return the states (w [m]; w' [m/s]) at the output times, a column each.

    Args:
        timeline: steps and outputs.
        states: at the ends of all steps, the start included, a column each.
        duration: of the run [s].
        ramp: time of a ramp [s] at which a step ends too, wherever that is.
    """
    columns = timeline.output_columns
    if ramp is not None:
        # Behind the ramp's end the steps count one more.
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
    """Return the weights of a timeline; no polynomial reaches across its kink."""
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
    """Return the weights of values and slopes at points x in the value, and in the slope, at t.

    At a point itself they are those of the point alone: between steps much shorter than the others rounding of their
    length, divided by it, would else count in the slope.

    Args:
        x: points, a row for each t.
        t: where the polynomial is read.
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
