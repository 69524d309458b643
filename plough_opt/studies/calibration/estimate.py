"""The estimate: the best fit from several starts, the scale of its residuals, and the intervals of the unknowns."""

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
from plough_opt.studies.calibration.identifiability import Spread, spread_of
from plough_opt.studies.calibration.least_squares import AT_BOUND, Data, LeastSquares, Minimum
from plough_opt.studies.calibration.model import Unknown
from plough_opt.studies.calibration.setup import Setup

Vector = NDArray[np.float64]
Kind = Literal["profile", "linearised"]

# Points between the bounds at which the loss is evaluated to choose starts; fewer if it needs runs, which take longer.
_SCANNED, _RUNS_SCANNED, _SEED = 64, 16, 7
# Starts keep this distance from the bounds, at which a search may stay.
_INSIDE: Final = 0.02
# Median absolute deviation of normal errors over their standard deviation, inverted.
_MAD: Final = 1.4826
_RESCALINGS, _SETTLED = 20, 1e-4
# Least scatter of residuals over the nominal one per cent: data with less are exact to rounding.
_LEAST_SCALE: Final = 1e-10
# Losses that differ by less than this, relative, belong to the same optimum.
_SAME: Final = 1e-6
# Least mean curvature of a robust loss: with less, nearly all rows are outliers.
_LEAST_BEND: Final = 0.05
# Within so small a part of the bounds the loss is quadratic.
_STRAIGHT: Final = 1e-6
# Of a standard error: how accurately the ends are found.
_ACCURACY: Final = 1e-7


@dataclass(frozen=True)
class Estimate:
    """The best fit, with its calibration.

    Attributes:
        setup: model, measurements and problem.
        data: observed values and weights, which include the estimated scale.
        best: the best optimum.
        optima: sums of losses of all distinct local optima, the best first.
        residuals: weighted, predicted less observed (n).
        spread: how far the data determine the unknowns.
        freedom: rows that count less the rank.
        variance: of a weighted residual in the covariance; 1 if sigma is stated.
        rise: allowed rise of twice the sum of losses inside an interval, per squared quantile.
        normal: whether quantiles are normal, because the variance is known, or Student's.
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

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns with their bounds."""
        return self.setup.model.unknowns

    @property
    def y(self) -> Vector:
        """Scaled unknowns."""
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
        """Return the two-sided quantile of a level."""
        side = 0.5 + level / 2.0
        return float(stats.norm.ppf(side) if self.normal else stats.t.ppf(side, self.freedom))


def estimate(setup: Setup, data: Data, guess: Vector, starts: int) -> Estimate:
    """Return the best fit from a guess and further starts between the bounds.

    Raises:
        NotConverged: no start led to an optimum.
    """
    problem, scaled = setup.problem, data
    best, optima = _best(problem, data, guess, starts)
    if problem.loss.robust and not data.stated:
        # A robust loss depends on the scale of the residuals, and that scale on the fit.
        scale = 1.0
        for _ in range(_RESCALINGS):
            before, scale = scale, _scale(problem, data, best.y)
            scaled = replace(data, weights=data.weights / scale)
            if abs(scale - before) <= _SETTLED * scale:
                break
            best = problem.solve(best.y, scaled)
        best, optima = _best(problem, scaled, best.y, starts)
    return _with_accuracy(setup, scaled, best, optima)


def _best(problem: LeastSquares, data: Data, guess: Vector, starts: int) -> tuple[Minimum, tuple[float, ...]]:
    """Return the best optimum, and the losses of all."""
    inside = np.clip(guess, _INSIDE, 1.0 - _INSIDE)
    # Along an undetermined direction there are many optima: the nearest to the guess is wanted.
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
    """Return the best of many points between the bounds."""
    if count < 1:
        return []
    points = qmc.Sobol(problem.unknowns, seed=_SEED).random(_SCANNED if problem.closed else _RUNS_SCANNED)
    losses = np.nan_to_num([problem.total(point, data) for point in points], nan=np.inf, posinf=np.inf)
    return [points[k] for k in np.argsort(losses)[:count]]


def _scale(problem: LeastSquares, data: Data, y: Vector) -> float:
    """Return the standard deviation of residuals, from the median of their sizes."""
    size = np.abs(data.weights * (problem.predict(y) - data.observed))[data.weights > 0.0]
    return max(_MAD * float(np.median(size)) * math.sqrt(len(size) / (len(size) - problem.unknowns)), _LEAST_SCALE)


def _with_accuracy(setup: Setup, data: Data, best: Minimum, optima: tuple[float, ...]) -> Estimate:
    """Return the estimate with the accuracy of the unknowns."""
    problem = setup.problem
    predicted, slope = problem.at(best.y)
    residuals, weighted = data.weights * (predicted - data.observed), slope * data.weights[:, None]
    freedom = data.count - spread_of(weighted, 1.0).rank
    own = residuals[data.weights > 0.0]
    normal = data.stated and not problem.loss.robust
    pull = problem.loss.weight(own) * own
    square = 1.0 if normal else max(float(np.sum(pull**2)) / max(freedom, 1), _LEAST_SCALE**2)
    bend = max(float(np.mean(problem.loss.curvature(own))), _LEAST_BEND)
    variance = square / bend**2
    spread = spread_of(weighted, variance**0.5)
    return Estimate(setup, data, best, optima, residuals, spread, freedom, variance, square / bend, normal)


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


def interval(fit: Estimate, k: int, level: float, kind: Kind) -> Interval:
    """Return the interval of unknown number k.

    Profile: all values with which, the other unknowns adjusted, the loss rises by no more than the quantile allows.
    Linearised: standard error times quantile, on the unknown's own scale (its logarithm where that is scaled).
    """
    if not fit.spread.determined[k]:
        return Interval(-np.inf, np.inf, kind=kind)
    reach = fit.quantile(level) * float(np.sqrt(fit.spread.covariance[k, k]))
    low, high = fit.y[k] - reach, fit.y[k] + reach
    if reach < _STRAIGHT:
        kind = "linearised"
    if kind == "profile":
        try:
            low, high = (_profile_end(fit, k, sign, fit.quantile(level)) for sign in (-1.0, 1.0))
        except NotConverged:
            kind = "linearised"
    unknown = fit.unknowns[k]
    beyond = {"lower": low <= AT_BOUND, "upper": high >= 1.0 - AT_BOUND}
    lower = unknown.lower if beyond["lower"] else float(unknown.value(low))
    upper = unknown.upper if beyond["upper"] else float(unknown.value(high))
    return Interval(lower, upper, tuple(side for side, clipped in beyond.items() if clipped), kind)


def _profile_end(fit: Estimate, k: int, sign: float, quantile: float) -> float:
    """Return the end of the profile's interval in scaled unknown k on one side, or the bound if that comes first.

    Raises:
        NotConverged: the other unknowns could not be adjusted.
    """
    error = float(np.sqrt(fit.spread.covariance[k, k]))
    along = fit.spread.covariance[:, k] / error**2
    centre = fit.y if fit.spread.free.shape[1] else None
    known = {float(fit.y[k]): fit.best}

    def excess(own: float) -> float:
        """Return the root of the loss's rise, in quantiles: nearly a straight line."""
        if own not in known:
            nearest = min(known, key=lambda other: abs(other - own))
            start = np.clip(known[nearest].y + (own - nearest) * along, 0.0, 1.0)
            start[k] = own
            known[own] = found = fit.setup.problem.solve(start, fit.data, centre, held=k)
            if not found.converged:
                raise NotConverged(f"the profile likelihood has no optimum: {found.status}", found.status)
        return float(np.sqrt(max(2.0 * (known[own].loss - fit.best.loss), 0.0) / fit.rise)) - quantile

    near, reach = float(fit.y[k]), sign * quantile * error
    while True:
        far = min(max(near + reach, 0.0), 1.0)
        if excess(far) >= 0.0:
            return float(optimize.brentq(excess, near, far, xtol=_ACCURACY * error))
        if far in (0.0, 1.0):
            return far
        near, reach = far, 2.0 * reach
