"""The estimate: the best fit from several starts, the scale of its residuals, and the accuracy of the unknowns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from plough_opt.core.errors import NotConverged
from plough_opt.studies.calibration.identifiability import Spread, spread_of
from plough_opt.studies.calibration.least_squares import LeastSquares, Stop

Vector = NDArray[np.float64]

NOMINAL: Final = 0.01
"""Standard deviation, as a part of the mean measured value, from which weights follow if no sigma is stated."""

# Points between the bounds at which the loss is evaluated to choose starts; fewer if it needs runs, which take longer.
_SCANNED, _RUNS_SCANNED, _SEED = 64, 16, 7
# Median absolute deviation of normal errors over their standard deviation, inverted.
_MAD: Final = 1.4826
_RESCALINGS, _SETTLED = 20, 1e-4
# Least scatter of residuals over the nominal one per cent: data with less are exact to rounding.
_LEAST_SCALE: Final = 1e-10
# Losses that differ by less than this, relative, belong to the same optimum.
_SAME: Final = 1e-6


@dataclass(frozen=True)
class Data:
    """The data of a fit.

    Attributes:
        observed: values (n), SI.
        weights: of the residuals (n), one over sigma; relative ones if sigma is unknown.
        stated: whether the weights follow from stated sigmas.
    """

    observed: Vector
    weights: Vector
    stated: bool

    @property
    def count(self) -> int:
        """Number of rows that count."""
        return int(np.sum(self.weights > 0.0))


@dataclass(frozen=True)
class Estimate:
    """The best fit.

    Attributes:
        stop: where the solver stopped.
        optima: sums of losses of all distinct local optima, the best first.
        weights: of the residuals, the estimated scale included.
        predicted: values (n), SI.
        residuals: weighted, predicted less observed (n).
        slope: Jacobian of the predictions (n, p).
        spread: how far the data determine the unknowns.
        freedom: rows that count less the rank.
        variance: of a weighted residual in the covariance; 1 if sigma is stated.
        raise_: allowed rise of twice the sum of losses inside an interval, per squared quantile.
        normal: whether quantiles are normal, because the variance is known, or Student's.
    """

    stop: Stop
    optima: tuple[float, ...]
    weights: Vector
    predicted: Vector
    residuals: Vector
    slope: Vector
    spread: Spread
    freedom: int
    variance: float
    raise_: float
    normal: bool

    @property
    def y(self) -> Vector:
        """Scaled unknowns."""
        return self.stop.y

    def quantile(self, level: float) -> float:
        """Return the two-sided quantile of a level."""
        side = 0.5 + level / 2.0
        return float(stats.norm.ppf(side) if self.normal else stats.t.ppf(side, self.freedom))


def estimate(program: LeastSquares, data: Data, guess: Vector, starts: int) -> Estimate:
    """Return the best fit from a guess and further starts between the bounds.

    Raises:
        NotConverged: no start led to an optimum.
    """
    weights, scale = data.weights, 1.0
    stop, optima = _best(program, data, weights, guess, starts)
    if program.loss.robust and not data.stated:
        # A robust loss depends on the scale of the residuals, and that scale on the fit.
        for _ in range(_RESCALINGS):
            residuals = data.weights * (program.predict(stop.y) - data.observed)
            new = _scale(residuals[data.weights > 0.0], program.unknowns)
            settled = abs(new - scale) <= _SETTLED * new
            scale = new
            weights = data.weights / scale
            if settled:
                break
            stop = program.solve(stop.y, data.observed, weights)
        stop, optima = _best(program, data, weights, stop.y, starts)
    return _with_accuracy(program, data, weights, stop, optima)


def _best(
    program: LeastSquares, data: Data, weights: Vector, guess: Vector, starts: int
) -> tuple[Stop, tuple[float, ...]]:
    """Return the best optimum, and the losses of all."""
    inside = np.clip(guess, 0.02, 0.98)
    # Along an undetermined direction there are many optima: the nearest to the guess is wanted.
    open_ended = spread_of(program.slope(inside) * weights[:, None], 1.0).free.shape[1] > 0
    centre = inside if open_ended else None
    begin = [inside, *_starts(program, data, weights, starts - 1)]
    stops = [program.solve(y, data.observed, weights, centre) for y in begin]
    solved = sorted((stop for stop in stops if stop.solved), key=lambda stop: stop.loss)
    if not solved:
        raise NotConverged(
            f"the fit did not converge from any of {len(stops)} starts (IPOPT: {stops[0].status}): narrow the bounds,"
            " give guesses, or fix unknowns that the data do not determine",
            stops[0].status,
        )
    losses = [solved[0].loss]
    for stop in solved[1:]:
        if stop.loss - losses[-1] > _SAME * (1.0 + losses[-1]):
            losses.append(stop.loss)
    return solved[0], tuple(losses)


def _starts(program: LeastSquares, data: Data, weights: Vector, count: int) -> list[Vector]:
    """Return the best of many points between the bounds."""
    if count < 1:
        return []
    points = qmc.Sobol(program.unknowns, seed=_SEED).random(_SCANNED if program.predictor.closed else _RUNS_SCANNED)
    losses = np.array([program.total(point, data.observed, weights) for point in points])
    order = np.argsort(np.where(np.isfinite(losses), losses, np.inf))
    return [points[k] for k in order[:count]]


def _scale(residuals: Vector, unknowns: int) -> float:
    count = len(residuals)
    return max(_MAD * float(np.median(np.abs(residuals))) * math.sqrt(count / (count - unknowns)), _LEAST_SCALE)


def _with_accuracy(
    program: LeastSquares, data: Data, weights: Vector, stop: Stop, optima: tuple[float, ...]
) -> Estimate:
    """Return the estimate with the accuracy of the unknowns."""
    predicted = program.predict(stop.y)
    residuals = weights * (predicted - data.observed)
    slope = program.slope(stop.y)
    weighted = slope * weights[:, None]
    rank = spread_of(weighted, 1.0).rank
    freedom = data.count - rank
    counts = weights > 0.0
    pull = np.asarray(program.loss.weight(residuals)) * residuals
    bend = float(np.mean(np.asarray(program.loss.curvature(residuals))[counts]))
    normal = data.stated and not program.loss.robust
    square = 1.0 if normal else max(float(np.sum(pull[counts] ** 2)) / max(freedom, 1), _LEAST_SCALE**2)
    bend = max(bend, 0.05)
    variance = square / bend**2
    spread = spread_of(weighted, variance**0.5)
    return Estimate(
        stop, optima, weights, predicted, residuals, slope, spread, freedom, variance, square / bend, normal
    )
