"""Estimate of a calibration: its least-squares problem, the best fit, and how far data determine the unknowns."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, stats
from scipy.stats import qmc

from plough_opt.core.errors import NotConverged, listed
from plough_opt.core.plain_data import Array
from plough_opt.core.units import in_words
from plough_opt.studies.calibration.model import CalibrationModel, Measurements, Rows, Unknown

NOMINAL: Final = 0.01
"""Nominal standard deviation of an error, relative to the mean measured or each predicted value, without sigma."""

ERRORS: Final = ("constant", "relative")
"""Models of errors whose sigma is not stated: the same for each set of measurements, or proportional to the result."""

INSIDE: Final = 0.02
"""Starts keep at least this distance from the bounds, as a part of their distance: a search may stay at a bound."""

UNIFORM: Final = 12.0**-0.5
"""Standard deviation of a number that is known only to lie between 0 and 1: a uniform distribution."""

RIDGE: Final = 0.01 / UNIFORM**2
"""Weight of a ridge term that draws the unknowns to a centre if they are not all determined.

It is a hundredth of the information in the bounds themselves. It selects a point along an undetermined direction, and
moves determined unknowns by less than a hundredth of their standard errors.
"""

# Tolerances near rounding: the loss is flat at its optimum, so that half the digits of the unknowns suffice for it.
_TOLERANCES: Final = {"ftol": 1e-11, "xtol": 1e-8, "gtol": 1e-11, "max_nfev": 200}
# Least curvature of a loss, relative to its weight; a robust loss is concave for large residuals.
_LEAST_LOSS_CURVATURE: Final = 0.1
# A fit has converged if a Gauss-Newton step would lower the sum of squares by less than this, in squared standard
# deviations: the unknowns are then within 1e-4 of a standard deviation.
_DECREMENT: Final = 1e-8
# A prediction below this part of the largest has the error of that part, so that none has an error of 0.
_LEAST_PREDICTION: Final = 1e-3
AT_BOUND: Final = 1e-6
"""A scaled unknown that is closer to a bound counts as being on it."""


@dataclass(frozen=True)
class Loss:
    """A loss c^2/2 rho(z) of a residual r in standard deviations, with z = (r/c)^2 and rho(z) = z for small z.

    Attributes:
        name: its name in `calibrate`.
        size: c: in a robust loss, residuals well above it count less than their squares.
        rho: z -> rho and its first two derivatives, as `scipy.optimize.least_squares` expects them.
    """

    name: str
    size: float
    rho: Callable[[Any], tuple[Any, Any, Any]]

    @property
    def robust(self) -> bool:
        """Whether large residuals count less than their squares."""
        return self.name != "squares"

    def value(self, r: Array) -> Array:
        """Return the losses of residuals."""
        return np.asarray(0.5 * self.size**2 * self.rho((r / self.size) ** 2)[0])

    def derivatives(self, r: Array) -> tuple[Array, Array]:
        """Return the derivative over the residual, a weight in Gauss-Newton steps, and the second derivative."""
        z = (r / self.size) ** 2
        _, first, second = self.rho(z)
        return first, first + 2.0 * z * second


def _squares(z: Any) -> tuple[Any, Any, Any]:
    return z, np.ones_like(z), np.zeros_like(z)


def _cauchy(z: Any) -> tuple[Any, Any, Any]:
    return np.log1p(z), 1.0 / (1.0 + z), -1.0 / (1.0 + z) ** 2


def _huber(z: Any) -> tuple[Any, Any, Any]:
    root = np.sqrt(np.maximum(z, 1.0))
    return np.where(z <= 1.0, z, 2.0 * root - 1.0), 1.0 / root, np.where(z <= 1.0, 0.0, -0.5 / root**3)


def _soft_l1(z: Any) -> tuple[Any, Any, Any]:
    root = np.sqrt(1.0 + z)
    return 2.0 * z / (1.0 + root), 1.0 / root, -0.5 / root**3


# Tuning constants that give 95 % of the efficiency of least squares if the errors are normal.
HUBER, SOFT_L1, CAUCHY = 1.345, 1.287, 2.385

LOSSES: Final = {
    "squares": Loss("squares", 1.0, _squares),
    "huber": Loss("huber", HUBER, _huber),
    "soft_l1": Loss("soft_l1", SOFT_L1, _soft_l1),
    "cauchy": Loss("cauchy", CAUCHY, _cauchy),
}


@dataclass(frozen=True)
class Data:
    """The data of a fit.

    Attributes:
        observed: measured values (n), SI.
        weights: weights of the residuals (n): 1/sigma, or relative weights if sigma is unknown.
        stated: whether the weights follow from stated sigmas.
        relative: whether the errors are proportional to the predictions.
    """

    observed: Array
    weights: Array
    stated: bool
    relative: bool = False

    def at(self, predicted: Array) -> "Data":
        """Return the data with the weights that belong to predictions (n)."""
        if not self.relative:
            return self
        size = np.abs(predicted)
        return replace(self, weights=self.weights / np.maximum(size, _LEAST_PREDICTION * float(np.max(size)) or 1.0))

    @property
    def count(self) -> int:
        """Number of rows with a weight above 0."""
        return int(np.sum(self.weights > 0.0))


@dataclass(frozen=True)
class Minimum:
    """The point at which the solver stopped.

    Attributes:
        converged: whether it is a local optimum: no step between the bounds lowers the loss.
        status: "converged", or why it is not a local optimum.
        y: scaled unknowns.
        loss: sum of the losses.
    """

    converged: bool
    status: str
    y: Array
    loss: float


class LeastSquares:
    """The sum of the losses of weighted residuals, to minimise over scaled unknowns between 0 and 1."""

    def __init__(self, predicted: ca.Function, loss: Loss) -> None:
        """Store a Function of scaled unknowns (p) to predictions (n) and their Jacobian (n, p), and the loss."""
        self.loss = loss
        self.rows, self.unknowns = predicted.size_out(1)
        self.closed = predicted.is_a("SXFunction")
        self._predicted = predicted
        self._last: tuple[bytes, Array, Array] = (b"", np.zeros(0), np.zeros(0))

    def at(self, y: Array) -> tuple[Array, Array]:
        """Return the predictions (n) and their Jacobian (n, p); those at the last point are remembered."""
        if self._last[0] != y.tobytes():
            values, slopes = map(np.asarray, self._predicted(y))
            self._last = y.tobytes(), values.ravel(), slopes.reshape(self.rows, self.unknowns)
        return self._last[1:]

    def total(self, y: Array, data: Data) -> float:
        """Return the sum of losses."""
        return float(np.sum(self.loss.value(data.weights * (self.at(y)[0] - data.observed))))

    def solve(self, start: Array, data: Data, centre: Array | None = None, held: int | None = None) -> Minimum:
        """Return the local optimum reached from a start.

        Args:
            start: scaled unknowns.
            data: observed values and weights.
            centre: scaled unknowns; of many optima along an undetermined direction, the nearest to them is found.
            held: number of an unknown that is held at its start.
        """
        y, free = start.copy(), np.arange(self.unknowns) != (-1 if held is None else held)

        def residuals(x: Array) -> Array:
            y[free] = x
            r, slope = self._residuals(y, data, centre)
            return r if np.all(np.isfinite(slope)) else np.full_like(r, np.nan)  # NaN makes the solver shorten its step

        def slopes(x: Array) -> Array:
            y[free] = x
            return self._residuals(y, data, centre)[1][:, free]

        settled = True
        if not np.all(np.isfinite(residuals(y[free]))):
            return Minimum(False, "a prediction at the start is not finite", y, np.inf)
        if np.any(free):
            loss = self._rho if self.loss.robust else "linear"
            solution = optimize.least_squares(residuals, y[free], slopes, bounds=(0.0, 1.0), loss=loss,
                                           f_scale=self.loss.size, **_TOLERANCES)  # fmt: skip
            y[free], settled = solution.x, solution.success
        total = self.total(y, data)
        if self._decrement(y, data, centre, free) <= _DECREMENT * max(1.0, 2.0 * total):
            return Minimum(True, "converged", y, total)
        steps = f"after {_TOLERANCES['max_nfev']} steps the loss still falls"
        return Minimum(False, "the steps became too short while the loss still falls" if settled else steps, y, total)

    def _residuals(self, y: Array, data: Data, centre: Array | None) -> tuple[Array, Array]:
        """Return weighted residuals and their Jacobian; a centre adds the ridge term (`RIDGE`) as further rows."""
        predicted, slope = self.at(y)
        r, slope = data.weights * (predicted - data.observed), data.weights[:, None] * slope
        if centre is None:
            return r, slope
        ridge = RIDGE**0.5
        return np.r_[r, ridge * (y - centre)], np.vstack([slope, ridge * np.eye(self.unknowns)])

    def _rho(self, z: Array) -> Any:
        """Return the loss and its derivatives in SciPy's form; rows of the ridge term are plain squares."""
        ridge = z[self.rows :]
        return np.hstack([self.loss.rho(z[: self.rows]), [ridge, np.ones_like(ridge), np.zeros_like(ridge)]])

    def _decrement(self, y: Array, data: Data, centre: Array | None, free: NDArray[np.bool_]) -> float:
        """Return twice the decrease of the loss that a Gauss-Newton step between the bounds predicts."""
        r, slope = self._residuals(y, data, centre)
        weight, second = replace(self.loss, rho=self._rho).derivatives(r)
        gradient = slope.T @ (weight * r)
        outward = ((y < AT_BOUND) & (gradient >= 0.0)) | ((y > 1.0 - AT_BOUND) & (gradient <= 0.0))
        free = free & ~outward
        curvature = np.maximum(second, _LEAST_LOSS_CURVATURE * weight)
        hessian = (slope[:, free] * curvature[:, None]).T @ slope[:, free]
        return float(gradient[free] @ np.linalg.lstsq(hessian, gradient[free], rcond=1e-12)[0])


@dataclass(frozen=True)
class Setup:
    """A checked calibration.

    Attributes:
        model: the scene as a function of its quantities, with the unknowns.
        rows: the sets of measurements.
        problem: the least-squares problem.
        data: measured values and their weights.
    """

    model: CalibrationModel
    rows: tuple[Rows, ...]
    problem: LeastSquares
    data: Data

    @property
    def measured(self) -> tuple[Measurements, ...]:
        """The sets of measurements."""
        return tuple(rows.measured for rows in self.rows)

    @property
    def places(self) -> list[str]:
        """Name of every row for messages."""
        return [m.row(k) for m in self.measured for k in range(m.rows)]


# Singular values below this part of the largest are rounding: the predictions do not depend on such directions.
_STRUCTURAL: Final = 1e-9
# Smaller components of a direction without effect (a unit vector) are rounding.
_NO_PART: Final = 1e-6
# Smaller components of a combination with little effect, relative to its largest, are left out.
_MINOR: Final = 0.02


@dataclass(frozen=True)
class Undetermined:
    """A combination of unknowns along which predictions change by less than the scatter of the data, or not at all.

    Attributes:
        changes: unknown -> its change along the direction, SI, at the fit; the first is one per cent of its bounds.
        structural: whether the predictions do not change at all; otherwise the data are not accurate enough.
        words: a sentence about it.
    """

    changes: Mapping[str, float]
    structural: bool
    words: str


@dataclass(frozen=True)
class Identifiability:
    """How far the data determine the scaled unknowns.

    Attributes:
        covariance: covariance of the scaled unknowns (p, p); rows of undetermined ones are 0.
        along: covariance of the scaled unknowns along the determined directions alone (p, p). Predictions that depend
            on no other direction have its errors, even where single unknowns are undetermined.
        determined: whether an unknown's variance is smaller than that from its bounds alone (p).
        free: undetermined directions of the scaled unknowns, as columns (p, d).
        structural: for each of these, whether the predictions do not depend on it at all (d).
    """

    covariance: Array
    along: Array
    determined: NDArray[np.bool_]
    free: Array
    structural: NDArray[np.bool_]


def identifiability_of(slope: Array, noise: float) -> Identifiability:
    """Return how far data determine scaled unknowns.

    Args:
        slope: Jacobian of the weighted residuals by the unknowns (n, p).
        noise: standard deviation of a weighted residual.
    """
    count = slope.shape[1]
    _, sizes, right = np.linalg.svd(slope, full_matrices=True)
    sizes = np.concatenate([sizes, np.zeros(max(0, count - len(sizes)))])
    directions = right.T
    structural = sizes <= _STRUCTURAL * max(float(sizes[0]), np.finfo(float).tiny)
    deviation = np.full(count, np.inf)
    deviation[~structural] = noise / sizes[~structural]
    undetermined_directions = deviation >= UNIFORM
    parts = np.where(np.abs(directions) > np.where(structural, _NO_PART, 0.0), directions, 0.0)
    with np.errstate(invalid="ignore"):
        variance = np.where(parts != 0.0, parts**2 * deviation**2, 0.0).sum(axis=1)
    determined = variance < UNIFORM**2
    finite = np.where(np.isfinite(deviation), deviation, 0.0)
    covariance = (directions * finite**2) @ directions.T
    mask = determined.astype(float)
    within = directions[:, ~undetermined_directions] * deviation[~undetermined_directions]
    return Identifiability(
        covariance=covariance * np.outer(mask, mask),
        along=within @ within.T,
        determined=determined,
        free=directions[:, undetermined_directions],
        structural=structural[undetermined_directions],
    )


def undetermined(unknowns: Sequence[Unknown], y: Array, spread: Identifiability) -> tuple[Undetermined, ...]:
    """Return the undetermined combinations, each of as few unknowns as possible."""
    without_effect, pivots = _sparse(spread.free[:, spread.structural], _NO_PART)
    # Directions without effect may be subtracted from those with little effect, which leaves fewer unknowns in these.
    weak = spread.free[:, ~spread.structural]
    weak, _ = _sparse(weak - without_effect @ weak[pivots, :], _MINOR)
    combinations = [_combination(unknowns, y, direction, structural=True) for direction in without_effect.T]
    combinations += [_combination(unknowns, y, direction, structural=False) for direction in weak.T]
    # An unknown may be undetermined by a component that was left out: name it alone.
    named = {name for item in combinations for name in item.changes}
    left = (k for k in np.flatnonzero(~spread.determined).tolist() if unknowns[k].name not in named)
    combinations += [_combination(unknowns, y, np.eye(len(unknowns))[k], structural=False) for k in left]
    return tuple(combinations)


def _sparse(free: Array, least: float) -> tuple[Array, NDArray[np.intp]]:
    """Return a basis of the same space, and its pivots: each basis vector is the only one with its pivot unknown.

    Components of a basis vector below ``least``, relative to its largest, are set to 0.
    """
    if free.shape[1] == 0:
        return free, np.zeros(0, dtype=np.intp)
    _, _, order = linalg.qr(free.T, pivoting=True, mode="economic")
    pivots = order[: free.shape[1]]
    basis = np.linalg.solve(free[pivots, :].T, free.T).T
    return np.where(np.abs(basis) > least * np.max(np.abs(basis), axis=0), basis, 0.0), pivots


def _combination(unknowns: Sequence[Unknown], y: Array, direction: Array, structural: bool) -> Undetermined:
    """Return a direction as a combination: changes of the unknowns in SI units, and a sentence."""
    order = np.argsort(-np.abs(direction), kind="stable")
    members = [k for k in order if direction[k] != 0.0]
    size = 0.01 / direction[members[0]]
    changes = {unknowns[k].name: float(size * direction[k] * unknowns[k].slope(float(y[k]))) for k in members}
    return Undetermined(changes, structural, _words([unknowns[k] for k in members], changes, structural))


def _words(members: Sequence[Unknown], changes: Mapping[str, float], structural: bool) -> str:
    """Return the sentence about a combination."""
    names = [unknown.name for unknown in members]
    if len(names) == 1:
        if structural:
            return f"{names[0]} has no effect on the measured results: the data do not determine it"
        return f"{names[0]} is hardly determined: the data do not narrow it further than its bounds"
    first = changes[names[0]]
    moves = ", ".join(f"{_size(u, changes)} {'less' if changes[u.name] * first < 0.0 else 'more'} {u.name}"
                      for u in members[1:])  # fmt: skip
    apart = "cannot be told apart" if structural else "can hardly be told apart, with this scatter"
    sentence = f"{listed(names)} {apart}: {_size(members[0], changes)} more {names[0]} can be offset by {moves}"
    if len(names) == 2:
        ratio = -first / changes[names[1]]
        units = [f" [{u.unit}]" if u.unit else "" for u in members]
        sign = "+" if ratio > 0.0 else "-"
        held = f"{names[0]}{units[0]} {sign} {abs(ratio):.4g} x {names[1]}{units[1]}"
        sentence += f"; near the fit the data determine {held}, and neither alone"
    return sentence


def _size(unknown: Unknown, changes: Mapping[str, float]) -> str:
    return in_words(abs(changes[unknown.name]), unknown.unit, 3)


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
_SCALE_SETTLED: Final = 1e-4
# Least scale of residuals relative to the nominal one per cent: runs predict to 1e-8, so less is not scatter of data.
# With a much smaller one the search, whose steps end at 1e-8, would never count as converged.
_LEAST_SCALE: Final = 1e-6
# Optima whose losses differ by less than this, relative, count as the same.
_SAME_LOSS: Final = 1e-6
# Least mean curvature of a robust loss: with less, nearly all rows are outliers.
_LEAST_MEAN_CURVATURE: Final = 0.05


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
    residuals: Array
    spread: Identifiability
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
    def y(self) -> Array:
        """Scaled unknowns (p)."""
        return self.best.y

    @property
    def predicted(self) -> Array:
        """Predictions (n), SI."""
        return self.setup.problem.at(self.y)[0]

    @property
    def slope(self) -> Array:
        """Jacobian of the predictions (n, p)."""
        return self.setup.problem.at(self.y)[1]

    @property
    def deviation(self) -> Array:
        """Standard deviation of each measurement (n), SI; infinite for a row of weight 0."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.variance**0.5 / self.data.weights)

    def quantile(self, level: float) -> float:
        """Return the two-sided quantile at a confidence level."""
        side = 0.5 + level / 2.0
        return float(stats.norm.ppf(side) if self.normal else stats.t.ppf(side, self.freedom))


def estimate(setup: Setup, data: Data, guess: Array, starts: int) -> Estimate:
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
            if np.all(np.abs(scaled.weights - before.weights) <= _SCALE_SETTLED * before.weights):
                break
            best = problem.solve(best.y, scaled)
        best, optima = _best(problem, scaled, best.y, starts)
        drift = _drift(scaled, _rescaled(problem, data, best.y))
    return _with_accuracy(setup, scaled, best, optima, drift)


def _rescaled(problem: LeastSquares, data: Data, y: Array) -> Data:
    """Return the data with the weights that belong to a fit: over its predictions, and over the residuals' scale."""
    sized = data.at(problem.at(y)[0])
    return replace(sized, weights=sized.weights / _scale(problem, sized, y)) if problem.loss.robust else sized


def _drift(used: Data, settled: Data) -> float:
    """Return the factor by which errors exceed those of the weights that were used, where it differs most from 1."""
    counted = used.weights > 0.0
    ratios = used.weights[counted] / settled.weights[counted]
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def _best(problem: LeastSquares, data: Data, guess: Array, starts: int) -> tuple[Minimum, tuple[float, ...]]:
    """Return the best optimum, and the losses of all distinct ones."""
    inside = np.clip(guess, INSIDE, 1.0 - INSIDE)
    # Along an undetermined direction there are many optima: take the nearest to the guess.
    open_ended = identifiability_of(problem.at(inside)[1] * data.weights[:, None], 1.0).free.shape[1] > 0
    centre = inside if open_ended else None
    minima = [problem.solve(y, data, centre) for y in (inside, *_starts(problem, data, starts - 1))]
    converged = sorted((minimum for minimum in minima if minimum.converged), key=lambda minimum: minimum.loss)
    if not converged:
        failed = f"the fit did not converge from any of {len(minima)} starts ({minima[0].status})"
        remedy = "narrow the bounds, give guesses, or fix unknowns that the data do not determine"
        raise NotConverged(f"{failed}: {remedy}", minima[0].status)
    losses = [converged[0].loss]
    for minimum in converged[1:]:
        if minimum.loss - losses[-1] > _SAME_LOSS * (1.0 + losses[-1]):
            losses.append(minimum.loss)
    return converged[0], tuple(losses)


def _starts(problem: LeastSquares, data: Data, count: int) -> list[Array]:
    """Return the points between the bounds with the smallest losses, out of many."""
    if count < 1:
        return []
    points = qmc.Sobol(problem.unknowns, seed=_SEED).random(_SCANNED if problem.closed else _SCANNED_WITH_RUNS)
    losses = np.nan_to_num([problem.total(point, data) for point in points], nan=np.inf, posinf=np.inf)
    return [points[k] for k in np.argsort(losses)[:count]]


def _scale(problem: LeastSquares, data: Data, y: Array) -> float:
    """Return the standard deviation of the residuals, estimated from the median of their absolute values."""
    size = np.abs(data.weights * (problem.at(y)[0] - data.observed))[data.weights > 0.0]
    freedom = max(len(size) - problem.unknowns, 1)
    return max(_MAD * float(np.median(size)) * math.sqrt(len(size) / freedom), _LEAST_SCALE)


def _with_accuracy(setup: Setup, data: Data, best: Minimum, optima: tuple[float, ...], drift: float) -> Estimate:
    """Return the estimate with the accuracy of the unknowns."""
    problem = setup.problem
    predicted, slope = problem.at(best.y)
    residuals, weighted = data.weights * (predicted - data.observed), slope * data.weights[:, None]
    # Directions without effect use up no rows.
    freedom = data.count - problem.unknowns + int(np.sum(identifiability_of(weighted, 1.0).structural))
    counted = residuals[data.weights > 0.0]
    normal = data.stated and not problem.loss.robust
    weight, second = problem.loss.derivatives(counted)
    pull = weight * counted
    square = 1.0 if normal else max(float(np.sum(pull**2)) / max(freedom, 1), _LEAST_SCALE**2)
    curvature = max(float(np.mean(second)), _LEAST_MEAN_CURVATURE)
    variance = square / curvature**2
    spread = identifiability_of(weighted, variance**0.5)
    return Estimate(setup, data, best, optima, residuals, spread, freedom, variance, square / curvature, normal, drift)
