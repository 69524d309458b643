"""The estimate: the best fit from several starts, the scale of its residuals, and confidence intervals."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.stats import qmc

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.plain_data import IntervalEnd
from plough_opt.studies.calibration.identifiability import Spread, spread_of
from plough_opt.studies.calibration.least_squares import AT_BOUND, Data, LeastSquares, Minimum
from plough_opt.studies.calibration.model import Unknown
from plough_opt.studies.calibration.setup import INSIDE, Setup

Vector = NDArray[np.float64]
Kind = Literal["profile", "linearised"]

# Number of points between the bounds at which the loss is evaluated to choose starts.
_SCANNED: Final = 64
# The same if the predictions need runs, which take longer.
_SCANNED_WITH_RUNS: Final = 16
_SEED: Final = 7
# Standard deviation of normal errors over their median absolute deviation.
_MAD: Final = 1.4826
# Limit on the number of fits that determine the scale of a robust loss. Poor data take some fifty, rarely more.
_MOST_RESCALINGS: Final = 100
# The scale has settled when it changes by less than this part.
_SETTLED: Final = 1e-4
# Least scale of residuals relative to the nominal one per cent: runs predict to 1e-8, so less is not scatter of data.
# With a much smaller one the search, whose steps end at 1e-8, would never count as converged.
_LEAST_SCALE: Final = 1e-6
# Optima whose losses differ by less than this, relative, count as the same.
_SAME: Final = 1e-6
# Least mean curvature of a robust loss: with less, nearly all rows are outliers.
_LEAST_CURVATURE: Final = 0.05
# If an interval's half width is a smaller part of the bounds, the loss is quadratic over it.
_QUADRATIC: Final = 1e-6
# Accuracy of an interval's ends, as a part of a standard error.
_ACCURACY: Final = 1e-7


@dataclass(frozen=True)
class Estimate:
    """The best fit, with its calibration; n rows and p unknowns.

    Attributes:
        setup: model, measurements and problem.
        data: observed values and weights; the weights include the estimated scale.
        best: the best optimum.
        optima: sums of losses of all distinct local optima, the best first.
        residuals: weighted residuals, predicted minus observed (n).
        spread: how far the data determine the unknowns.
        freedom: degrees of freedom: number of rows of weight above 0, minus the rank.
        variance: variance of a weighted residual in the covariance; 1 if sigma is stated.
        rise: rise of twice the sum of losses at the end of an interval, over the squared quantile.
        normal: whether quantiles are normal, because the variance is known; otherwise they are Student's.
        drift: ratio of the residuals' scale to the scale that a robust loss assumed; 1 where the two have settled.
    """

    setup: Setup
    data: Data
    best: Minimum
    optima: tuple[float, ...]
    residuals: Vector
    spread: Spread
    freedom: int
    variance: float
    rise: float
    normal: bool
    drift: float

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns with their bounds."""
        return self.setup.model.unknowns

    @property
    def y(self) -> Vector:
        """Scaled unknowns (p)."""
        return self.best.y

    @property
    def predicted(self) -> Vector:
        """Predictions (n), SI."""
        return self.setup.problem.at(self.y)[0]

    @property
    def slope(self) -> Vector:
        """Jacobian of the predictions (n, p)."""
        return self.setup.problem.at(self.y)[1]

    @property
    def deviation(self) -> Vector:
        """Standard deviation of each measurement (n), SI; infinite for a row of weight 0."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.variance**0.5 / self.data.weights)

    def quantile(self, level: float) -> float:
        """Return the two-sided quantile at a confidence level."""
        side = 0.5 + level / 2.0
        return float(stats.norm.ppf(side) if self.normal else stats.t.ppf(side, self.freedom))


def estimate(setup: Setup, data: Data, guess: Vector, starts: int) -> Estimate:
    """Return the best fit from a guess and further starts between the bounds.

    Raises:
        NotConverged: no start led to an optimum.
    """
    problem, drift = setup.problem, 1.0
    # Where errors are relative, the first weights are those of errors relative to the measured values.
    scaled = data.at(data.observed)
    best, optima = _best(problem, scaled, guess, starts)
    if (problem.loss.robust or data.relative) and not data.stated:
        # Relative weights, and the scale that a robust loss needs, depend on the fit: repeat until all settle.
        for _ in range(_MOST_RESCALINGS):
            before, scaled = scaled, _rescaled(problem, data, best.y)
            if np.all(np.abs(scaled.weights - before.weights) <= _SETTLED * before.weights):
                break
            best = problem.solve(best.y, scaled)
        best, optima = _best(problem, scaled, best.y, starts)
        drift = _drift(scaled, _rescaled(problem, data, best.y))
    return _with_accuracy(setup, scaled, best, optima, drift)


def _rescaled(problem: LeastSquares, data: Data, y: Vector) -> Data:
    """Return the data with the weights that belong to a fit: over its predictions, and over the residuals' scale."""
    sized = data.at(problem.predict(y))
    return replace(sized, weights=sized.weights / _scale(problem, sized, y)) if problem.loss.robust else sized


def _drift(used: Data, settled: Data) -> float:
    """Return the factor by which errors exceed those of the weights that were used, where it differs most from 1."""
    counted = used.weights > 0.0
    ratios = used.weights[counted] / settled.weights[counted]
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def _best(problem: LeastSquares, data: Data, guess: Vector, starts: int) -> tuple[Minimum, tuple[float, ...]]:
    """Return the best optimum, and the losses of all distinct ones."""
    inside = np.clip(guess, INSIDE, 1.0 - INSIDE)
    # Along an undetermined direction there are many optima: take the nearest to the guess.
    open_ended = spread_of(problem.at(inside)[1] * data.weights[:, None], 1.0).free.shape[1] > 0
    centre = inside if open_ended else None
    found = [problem.solve(y, data, centre) for y in (inside, *_starts(problem, data, starts - 1))]
    converged = sorted((one for one in found if one.converged), key=lambda one: one.loss)
    if not converged:
        raise NotConverged(
            f"the fit did not converge from any of {len(found)} starts ({found[0].status}): narrow the bounds,"
            " give guesses, or fix unknowns that the data do not determine",
            found[0].status,
        )
    losses = [converged[0].loss]
    for one in converged[1:]:
        if one.loss - losses[-1] > _SAME * (1.0 + losses[-1]):
            losses.append(one.loss)
    return converged[0], tuple(losses)


def _starts(problem: LeastSquares, data: Data, count: int) -> list[Vector]:
    """Return the points between the bounds with the smallest losses, out of many."""
    if count < 1:
        return []
    points = qmc.Sobol(problem.unknowns, seed=_SEED).random(_SCANNED if problem.closed else _SCANNED_WITH_RUNS)
    losses = np.nan_to_num([problem.total(point, data) for point in points], nan=np.inf, posinf=np.inf)
    return [points[k] for k in np.argsort(losses)[:count]]


def _scale(problem: LeastSquares, data: Data, y: Vector) -> float:
    """Return the standard deviation of the residuals, estimated from the median of their absolute values."""
    size = np.abs(data.weights * (problem.predict(y) - data.observed))[data.weights > 0.0]
    freedom = max(len(size) - problem.unknowns, 1)
    return max(_MAD * float(np.median(size)) * math.sqrt(len(size) / freedom), _LEAST_SCALE)


def _with_accuracy(setup: Setup, data: Data, best: Minimum, optima: tuple[float, ...], drift: float) -> Estimate:
    """Return the estimate with the accuracy of the unknowns."""
    problem = setup.problem
    predicted, slope = problem.at(best.y)
    residuals, weighted = data.weights * (predicted - data.observed), slope * data.weights[:, None]
    freedom = data.count - spread_of(weighted, 1.0).rank
    own = residuals[data.weights > 0.0]
    normal = data.stated and not problem.loss.robust
    pull = problem.loss.weight(own) * own
    square = 1.0 if normal else max(float(np.sum(pull**2)) / max(freedom, 1), _LEAST_SCALE**2)
    curvature = max(float(np.mean(problem.loss.curvature(own))), _LEAST_CURVATURE)
    variance = square / curvature**2
    spread = spread_of(weighted, variance**0.5)
    return Estimate(setup, data, best, optima, residuals, spread, freedom, variance, square / curvature, normal, drift)


@dataclass(frozen=True)
class Interval:
    """A confidence interval of one unknown, SI.

    Attributes:
        lower: its lower end; minus infinity if the data do not determine the unknown.
        upper: its upper end.
        clipped: which ends ("lower", "upper") are bounds of the unknown, because the data do not exclude the bounds.
        kind: "profile"; "linearised" if that was requested, if the interval is too short for the two to differ, or if
            the profile could not be computed.
    """

    lower: IntervalEnd
    upper: IntervalEnd
    clipped: tuple[str, ...] = ()
    kind: Kind = "profile"

    def __contains__(self, value: float) -> bool:
        return self.lower <= value <= self.upper

    def __iter__(self) -> Iterator[float]:
        return iter((self.lower, self.upper))


def check_level(level: float) -> float:
    """Return a confidence level as a float, or raise InputError if it is not between 0 and 1."""
    if not isinstance(level, int | float) or not 0.0 < level < 1.0:
        raise InputError(f"level = {shown(level)} must lie between 0 and 1, such as 0.95")
    return float(level)


def interval(fit: Estimate, k: int, level: float, kind: Kind) -> Interval:
    """Return the interval of unknown number k.

    A profile interval holds all values at which the loss, with the other unknowns fitted anew, rises by no more than
    the quantile allows. A linearised one is the value ± quantile times standard error, on the scale of the unknown (its
    logarithm if that is what is scaled).
    """
    if not fit.spread.determined[k]:
        return Interval(-np.inf, np.inf, kind=kind)
    reach = fit.quantile(level) * float(np.sqrt(fit.spread.covariance[k, k]))
    low, high = fit.y[k] - reach, fit.y[k] + reach
    if reach < _QUADRATIC:
        kind = "linearised"
    if kind == "profile":
        try:
            low, high = (_profile_end(fit, k, sign, fit.quantile(level)) for sign in (-1.0, 1.0))
        except NotConverged:
            kind = "linearised"
    unknown = fit.unknowns[k]
    clipped = {"lower": low <= AT_BOUND, "upper": high >= 1.0 - AT_BOUND}
    lower = unknown.lower if clipped["lower"] else float(unknown.value(low))
    upper = unknown.upper if clipped["upper"] else float(unknown.value(high))
    return Interval(lower, upper, tuple(side for side, at_bound in clipped.items() if at_bound), kind)


def _profile_end(fit: Estimate, k: int, sign: float, quantile: float) -> float:
    """Return one end of the profile interval of scaled unknown k, or the bound on that side if it comes first.

    Raises:
        NotConverged: the other unknowns could not be fitted.
    """
    error = float(np.sqrt(fit.spread.covariance[k, k]))
    # Change of all unknowns per change of this one, to first order: it predicts the fit of the others.
    direction = fit.spread.covariance[:, k] / error**2
    centre = fit.y if fit.spread.free.shape[1] else None
    solved = {float(fit.y[k]): fit.best}

    def excess(value: float) -> float:
        """Return the square root of the loss's rise minus the quantile; it is nearly linear in the value."""
        if value not in solved:
            nearest = min(solved, key=lambda other: abs(other - value))
            start = np.clip(solved[nearest].y + (value - nearest) * direction, 0.0, 1.0)
            start[k] = value
            solved[value] = minimum = fit.setup.problem.solve(start, fit.data, centre, held=k)
            if not minimum.converged:
                raise NotConverged(f"the profile likelihood has no optimum: {minimum.status}", minimum.status)
        return float(np.sqrt(max(2.0 * (solved[value].loss - fit.best.loss), 0.0) / fit.rise)) - quantile

    near, reach = float(fit.y[k]), sign * quantile * error
    while True:
        far = min(max(near + reach, 0.0), 1.0)
        if excess(far) >= 0.0:
            return float(optimize.brentq(excess, near, far, xtol=_ACCURACY * error))
        if far in (0.0, 1.0):
            return far
        near, reach = far, 2.0 * reach
