"""Confidence intervals: of the profile likelihood, and linearised."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.core.kinds import shown
from plough_opt.studies.calibration.estimate import Data, Estimate
from plough_opt.studies.calibration.least_squares import LeastSquares
from plough_opt.studies.calibration.unknown import Unknown

Vector = NDArray[np.float64]
Kind = Literal["profile", "linearised"]

_AT_BOUND: Final = 1e-6
_STRAIGHT: Final = 1e-6
# How far towards the linearised end the search for the profile's end begins.
_BEGIN: Final = 0.98


@dataclass(frozen=True)
class Interval:
    """A confidence interval of one unknown, SI.

    Attributes:
        lower: its lower end; minus infinity if the data do not determine the unknown.
        upper: its upper end.
        clipped: the ends that are the unknown's bounds, "lower" or "upper", because the data do not exclude them.
        kind: "profile", or "linearised" if requested or if the profile could not be computed.
    """

    lower: float
    upper: float
    clipped: tuple[str, ...] = ()
    kind: Kind = "profile"

    def __contains__(self, value: float) -> bool:
        return self.lower <= value <= self.upper

    def __iter__(self) -> Iterator[float]:
        return iter((self.lower, self.upper))


def check_level(level: float) -> float:
    """Return a level, or raise InputError if it is not between 0 and 1."""
    if not isinstance(level, int | float) or not 0.0 < level < 1.0:
        raise InputError(f"level = {shown(level)} must lie between 0 and 1, such as 0.95")
    return float(level)


def interval(
    program: LeastSquares, unknowns: Sequence[Unknown], data: Data, fit: Estimate, k: int, level: float, kind: Kind
) -> Interval:
    """Return the interval of one unknown.

    Profile: all values with which, the other unknowns adjusted, the loss rises by no more than the quantile allows.
    Linearised: standard error times quantile, on the unknown's own scale (its logarithm where that is scaled).
    """
    if not fit.spread.determined[k]:
        return Interval(-np.inf, np.inf, kind=kind)
    quantile = fit.quantile(level)
    error = float(np.sqrt(fit.spread.covariance[k, k]))
    wald = [float(fit.y[k]) + sign * quantile * error for sign in (-1.0, 1.0)]
    # Within so small a part of the bounds the loss is quadratic.
    if kind == "linearised" or quantile * error < _STRAIGHT:
        return _interval(unknowns[k], wald, "linearised")
    ends = []
    for sign in (-1.0, 1.0):
        end = _profile_end(program, data, fit, k, sign, quantile)
        if end is None:
            return _interval(unknowns[k], wald, "linearised")
        ends.append(end)
    return _interval(unknowns[k], ends, "profile")


def _profile_end(
    program: LeastSquares, data: Data, fit: Estimate, k: int, sign: float, quantile: float
) -> float | None:
    """Return an end of the profile's interval in the scaled unknown, or None if the search failed."""
    direction = np.zeros(program.unknowns)
    direction[k] = sign
    error = np.sqrt(fit.spread.covariance[k, k])
    along = fit.spread.covariance[:, k] / error
    start = np.clip(fit.y + _BEGIN * sign * quantile * along, 0.0, 1.0)
    limit = fit.stop.loss + 0.5 * quantile**2 * fit.raise_
    centre = fit.y if fit.spread.free.shape[1] else None
    for begin in (start, fit.y):
        stop = program.extreme(direction, begin, data.observed, fit.weights, limit, centre)
        if stop.solved:
            break
    return float(stop.y[k]) if stop.solved else None


def _interval(unknown: Unknown, ends: Sequence[float], kind: Kind) -> Interval:
    low, high = ends
    clipped = tuple(
        side for side, beyond in (("lower", low <= _AT_BOUND), ("upper", high >= 1.0 - _AT_BOUND)) if beyond
    )
    lower = unknown.lower if "lower" in clipped else float(unknown.value(low))
    upper = unknown.upper if "upper" in clipped else float(unknown.value(high))
    return Interval(lower, upper, clipped, kind)
