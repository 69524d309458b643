"""Least squares between bounds with exact slopes: the best fit, its errors, what is not determined, and profiles."""

from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.stats import qmc

from plough_opt.core.errors import NotConverged
from plough_opt.core.plain_data import Array

NOMINAL: Final = 0.01
"""Nominal standard deviation of an error, relative to the mean measured or each predicted value, without sigma."""
SOFT_L1: Final = 1.287
"""Residual [standard deviations] beyond which soft_l1 counts less than squares; it gives 95 % of the efficiency of
squares if the errors are normal."""
UNIFORM: Final = 12.0**-0.5
"""Standard deviation of a number that is known only to lie between 0 and 1: a uniform distribution."""

# Near rounding: the loss is flat at its optimum, so that half the digits of the unknowns suffice for it.
_TOLERANCES: Final = {"ftol": 1e-11, "xtol": 1e-9, "gtol": 1e-11, "max_nfev": 200}
# Root of the weight of a ridge term that draws undetermined unknowns to the guess. The weight is a hundredth of the
# information in the bounds themselves, so it moves determined unknowns by less than a hundredth of their errors.
_RIDGE: Final = 0.1 / UNIFORM
# Least scale of residuals relative to the nominal one per cent: runs predict to 1e-8, so less is not scatter of data.
_LEAST_SCALE: Final = 1e-6


class Predictions:
    """Predictions (n) and slopes (n, p) as a function of the scaled unknowns (p); the last ones are remembered."""

    def __init__(self, function: ca.Function) -> None:
        self.closed, self._function = function.is_a("SXFunction"), function
        self._last: tuple[bytes, Array, Array] = (b"", np.zeros(0), np.zeros(0))

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Return the predictions and their Jacobian."""
        if self._last[0] != y.tobytes():
            values, slopes = map(np.asarray, self._function(y))
            self._last = y.tobytes(), values.ravel(), slopes.reshape(values.size, y.size)
        return self._last[1], self._last[2]


@dataclass(frozen=True)
class LeastSquares:
    """Observed values with weights, and the predictions to fit to them over scaled unknowns between 0 and 1.

    Attributes:
        predictions: scaled unknowns -> predictions (n) and slopes (n, p).
        guess: scaled unknowns from which the search starts (p).
        observed: measured values (n), SI.
        weights: 1/sigma (n), or relative weights if sigma is unknown.
        counted: mask of the rows that are fitted (n).
        stated: whether sigma is stated.
        relative: whether the errors are proportional to the predictions, so that weights are to be divided by these.
        robust: whether the loss is soft_l1.
    """

    predictions: Predictions
    guess: Array
    observed: Array
    weights: Array
    counted: NDArray[np.bool_]
    stated: bool
    relative: bool
    robust: bool

    @property
    def least_rows(self) -> int:
        """Number of rows that the unknowns need: one more if the scatter is estimated too."""
        return len(self.guess) + (0 if self.stated and not self.robust else 1)

    def over(self, predicted: Array) -> "LeastSquares":
        """Return the problem with the weights that belong to predictions, where the errors are proportional to them."""
        size = np.abs(predicted)
        # A prediction below a thousandth of the largest has the error of that, so that none has an error of 0.
        least = 1e-3 * float(np.max(size)) or 1.0
        return replace(self, weights=self.weights / np.maximum(size, least)) if self.relative else self

    def scaled(self, y: Array) -> "LeastSquares":
        """Return the problem with the weights of a fit: over its predictions, and for soft_l1 over the scatter."""
        sized = self.over(self.predictions(y)[0])
        if not self.robust:
            return sized
        size = np.abs(sized.residuals(y))[self.counted]
        # The median of the absolute residuals, and its part of a normal distribution's standard deviation.
        scale = float(np.median(size) / stats.norm.ppf(0.75) * (len(size) / max(len(size) - len(y), 1)) ** 0.5)
        return replace(sized, weights=sized.weights / max(scale, _LEAST_SCALE))

    def residuals(self, y: Array) -> Array:
        """Return predicted minus observed values times weights (n); 0 for rows that are not fitted."""
        return np.asarray(self.counted * self.weights * (self.predictions(y)[0] - self.observed))

    def slopes(self, y: Array) -> Array:
        """Return the derivatives of the residuals (n, p)."""
        return np.asarray((self.counted * self.weights)[:, None] * self.predictions(y)[1])

    def loss(self, y: Array) -> float:
        """Return the sum of the losses of the residuals."""
        r = self.residuals(y)
        return float(np.sum(SOFT_L1**2 * (np.hypot(1.0, r / SOFT_L1) - 1.0) if self.robust else r**2 / 2.0))

    def descend(self, start: Array, held: int = -1, ridge: float = 0.0) -> tuple[Array, float]:
        """Return the optimum reached from a start, and its loss; infinite if the search does not converge.

        Args:
            start: scaled unknowns.
            held: number of an unknown that stays at its start.
            ridge: root of the weight with which unknowns are drawn to the guess.
        """
        y, free = start.copy(), np.arange(len(start)) != held

        def residuals(x: Array) -> Array:
            y[free] = x
            # NaN makes the solver shorten its step.
            r = self.residuals(y) if np.all(np.isfinite(self.slopes(y))) else np.full(len(self.weights), np.nan)
            return np.concatenate([r, ridge * (y - self.guess)])

        def slopes(x: Array) -> Array:
            y[free] = x
            return np.vstack([self.slopes(y), ridge * np.eye(len(y))])[:, free]

        if not np.all(np.isfinite(residuals(start[free]))):
            return start, np.inf
        if np.any(free):
            options = {"loss": "soft_l1" if self.robust else "linear", "f_scale": SOFT_L1, **_TOLERANCES}
            end = optimize.least_squares(residuals, start[free], slopes, bounds=(0.0, 1.0), **options)
            y[free] = end.x
            if not end.success:
                return y, np.inf
        return y, self.loss(y)

    def search(self, guess: Array, starts: int) -> tuple[Array, tuple[float, ...]]:
        """Return the best optimum from a guess and the best of many points, and the losses of all distinct optima.

        Raises:
            NotConverged: no start led to an optimum.
        """
        points = qmc.Sobol(len(guess), seed=7).random(64 if self.predictions.closed else 16)
        losses = np.nan_to_num([self.loss(point) for point in points] if starts > 1 else [], nan=np.inf)
        tried = [guess, *(points[k] for k in np.argsort(losses)[: starts - 1])]
        inside = [np.clip(point, 0.02, 0.98) for point in tried]  # a search may stay at a bound
        sizes = np.linalg.svd(self.slopes(inside[0]), compute_uv=False)
        ridge = _RIDGE if len(sizes) < len(guess) or sizes[-1] * UNIFORM <= 1.0 else 0.0
        optima = sorted((self.descend(point, ridge=ridge) for point in inside), key=lambda optimum: optimum[1])
        if optima[0][1] == np.inf:
            remedy = "narrow the bounds, give guesses, or fix unknowns that the data do not determine"
            raise NotConverged(f"the fit did not converge from any of {starts} starts: {remedy}", "not converged")
        y, finite = optima[0][0], [loss for _, loss in optima if loss < np.inf]
        # The search ends where the loss changes by rounding only, which is half the digits of the unknowns. Inside the
        # bounds one more step of Gauss and Newton gives most of the others.
        step = np.linalg.lstsq(self.slopes(y), -self.residuals(y))[0]
        if not self.robust and not ridge and np.max(np.abs(step)) < 1e-6 and np.all(np.abs(y + step - 0.5) < 0.5):
            y = y + step
        return y, tuple(b for a, b in zip([-1.0, *finite], finite, strict=False) if b - a > 1e-6 * (1.0 + a))

    def fitted(self, starts: int) -> "Solution":
        """Return the best fit; weights that depend on the fit are settled with it.

        Raises:
            NotConverged: no start led to an optimum.
        """
        # Where errors are relative, the first weights are those of errors relative to the measured values.
        scaled = self.over(self.observed)
        y, optima = scaled.search(self.guess, starts)
        if self.relative or (self.robust and not self.stated):
            for _ in range(100):
                before, scaled = scaled, self.scaled(y)
                if np.all(np.abs(scaled.weights - before.weights) <= 1e-4 * before.weights):
                    break
                y, _ = scaled.descend(y)
            y, optima = scaled.search(y, starts)
        return Solution(self, scaled, y, optima)


def quantile(level: float, freedom: float) -> float:
    """Return Student's two-sided quantile at a confidence level; the normal one for infinite degrees of freedom."""
    return float(stats.t.ppf(0.5 + level / 2.0, freedom))


class Solution:
    """The best fit of n rows and p scaled unknowns, with its accuracy.

    Attributes:
        asked: the problem as it was asked.
        problem: the same with the weights that belong to the fit.
        y: scaled unknowns at the optimum.
        optima: sums of losses of all distinct local optima, the best first.
        predicted: predictions (n), SI.
        residuals: weighted residuals, predicted minus observed (n).
        freedom: degrees of freedom: fitted rows, minus directions that have an effect.
        student: degrees of freedom of Student's quantiles; infinite if the variance is known.
        variance: variance of a weighted residual in the covariance.
        rise: rise of twice the loss over the squared quantile.
        sigma: standard deviation of each measurement (n), SI, by its weight; infinite for one of weight 0.
        vectors: singular directions of the scaled unknowns as columns (p, p).
        deviation: standard deviation along each; infinite if no residual depends on it.
        free: mask of the directions along which the data tell less than the bounds.
        covariance: of the scaled unknowns (p, p), without directions that have no effect.
        errors: standard errors of the scaled unknowns (p); infinite where the data tell less than the bounds.
    """

    def __init__(self, asked: LeastSquares, problem: LeastSquares, y: Array, optima: tuple[float, ...]) -> None:
        self.asked, self.problem, self.y, self.optima = asked, problem, y, optima
        self.predicted, self.residuals = problem.predictions(y)[0], problem.residuals(y)
        _, sizes, right = np.linalg.svd(problem.slopes(y), full_matrices=True)
        sizes = np.pad(sizes, (0, len(y) - len(sizes)))
        effective = sizes > max(1e-9 * float(sizes[0]), np.finfo(float).tiny)  # less is rounding
        counted = self.residuals[problem.counted]
        self.freedom = len(counted) - int(np.sum(effective))
        self.student, self.variance, self.rise = np.inf, 1.0, 1.0
        if problem.robust or not problem.stated:
            self.student = self.freedom
            root = np.hypot(1.0, counted / SOFT_L1) if problem.robust else np.ones(len(counted))
            square = max(float(np.sum((counted / root) ** 2)) / max(self.freedom, 1), _LEAST_SCALE**2)
            curvature = float(np.mean(root**-3.0))
            self.variance, self.rise = square / curvature**2, square / curvature
        with np.errstate(divide="ignore"):
            self.sigma: Array = self.variance**0.5 / problem.weights
        self.vectors: Array = right.T
        self.deviation = np.divide(self.variance**0.5, sizes, out=np.full(len(y), np.inf), where=effective)
        self.free = self.deviation >= UNIFORM
        self.covariance = self._covariance(effective)
        errors = np.sqrt(np.diag(self.covariance))
        without_effect = np.any(np.abs(self.vectors[:, ~effective]) > 1e-6, axis=1)
        self.errors = np.where(without_effect | (errors >= UNIFORM), np.inf, errors)

    def _covariance(self, which: NDArray[np.bool_]) -> Array:
        """Return the covariance of the scaled unknowns along some directions (p, p)."""
        within = self.vectors[:, which] * self.deviation[which]
        return np.asarray(within @ within.T)

    def prediction_errors(self) -> Array:
        """Return the standard errors of the predictions (n), SI; infinite where the data do not determine them.

        Along an undetermined direction the unknowns may be anywhere between their bounds: there is no error where that
        changes a prediction by a notable part of the measurement's standard deviation.
        """
        slopes = self.problem.predictions(self.y)[1]
        within = np.sqrt(np.einsum("ni,ij,nj->n", slopes, self._covariance(~self.free), slopes))
        elsewhere = UNIFORM * np.linalg.norm(slopes @ self.vectors[:, self.free], axis=1)
        return np.where(elsewhere > 0.1 * self.sigma, np.inf, within)

    def profile(self, k: int, level: float) -> tuple[float, float]:
        """Return the ends of the profile interval of scaled unknown k, or the bounds that come first.

        It holds all values at which twice the loss, with the other unknowns fitted anew, rises by no more than the
        squared quantile times the noise.

        Raises:
            NotConverged: the other unknowns could not be fitted.
        """
        centre, error, least = float(self.y[k]), float(self.errors[k]), self.optima[0]
        reach = quantile(level, self.student)
        # Change of all unknowns per change of this one, to first order: it predicts the fit of the others.
        along = self.covariance[:, k] / self.covariance[k, k]
        ridge = _RIDGE if self.free.any() else 0.0

        def excess(value: float) -> float:
            """Return the root of the loss's rise minus the quantile; it is nearly linear in the value."""
            start = np.clip(self.y + (value - centre) * along, 0.0, 1.0)
            start[k] = value
            loss = least if value == centre else self.problem.descend(start, k, ridge)[1]
            if loss == np.inf:
                raise NotConverged("the profile likelihood has no optimum", "not converged")
            return float((max(2.0 * (loss - least), 0.0) / self.rise) ** 0.5) - reach

        def end(sign: float) -> float:
            for far in np.clip(centre + sign * reach * error * 2.0 ** np.arange(64), 0.0, 1.0).tolist():
                if excess(far) >= 0.0:
                    return float(optimize.brentq(excess, centre, far, xtol=1e-7 * error))
                if far in (0.0, 1.0):
                    break
            return float(far)

        return end(-1.0), end(1.0)
