"""Reading a fixed-step run between its steps: Hermite interpolation of degree 15, linear in the states.

Steps of order 8 are long beside the spacing of a run's outputs. The deflection w and its rate w' at eight ends of steps
around an output time determine a polynomial whose error falls by a higher power of the step than the method's.
What is read is linear in the states, so that derivatives with respect to anything are read in the same way.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.timeline import READ_FROM, Timeline

Array = NDArray[np.float64]

# Rounding of times that are equal, as fractions of the duration.
_SAME: Final = 4.0 * float(np.finfo(np.float64).eps)


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
