"""The least-squares problem of a calibration, its losses, and its solution by SciPy's trust-region method."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from plough_opt.core.checks import check_named
from plough_opt.core.plain_data import Array

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
_LEAST_CURVATURE: Final = 0.1
# A fit has converged if a Gauss-Newton step would lower the sum of squares by less than this, in squared standard
# deviations: the unknowns are then within 1e-4 of a standard deviation.
_DECREMENT: Final = 1e-8
# A prediction below this part of the largest has the error of that part, so that none has an error of 0.
_LEAST_SIZE: Final = 1e-3
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

    def weight(self, r: Array) -> Array:
        """Return the loss's derivative over the residual: the weight of its square in a Gauss-Newton step."""
        return np.asarray(self.rho((r / self.size) ** 2)[1])

    def curvature(self, r: Array) -> Array:
        """Return the second derivative of the loss."""
        z = (r / self.size) ** 2
        _, first, second = self.rho(z)
        return np.asarray(first + 2.0 * z * second)


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
    loss.name: loss
    for loss in (
        Loss("squares", 1.0, _squares),
        Loss("huber", HUBER, _huber),
        Loss("soft_l1", SOFT_L1, _soft_l1),
        Loss("cauchy", CAUCHY, _cauchy),
    )
}


def loss_of(name: str) -> Loss:
    """Return a loss by name.

    Raises:
        InputError: an unknown name.
    """
    check_named("no loss is named {}", name, LOSSES)
    return LOSSES[name]


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
        return replace(self, weights=self.weights / np.maximum(size, _LEAST_SIZE * float(np.max(size)) or 1.0))

    @property
    def count(self) -> int:
        """Number of rows with a weight above 0."""
        return int(np.sum(self.weights > 0.0))


@dataclass(frozen=True)
class Minimum:
    """The point at which the solver stopped.

    Attributes:
        converged: whether it is a local optimum: no step between the bounds lowers the loss.
        status: message of the solver.
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

    def predict(self, y: Array) -> Array:
        """Return the predictions (n)."""
        return self.at(y)[0]

    def total(self, y: Array, data: Data) -> float:
        """Return the sum of losses."""
        return float(np.sum(self.loss.value(data.weights * (self.predict(y) - data.observed))))

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

        status = "all unknowns are held at the start"
        if not np.all(np.isfinite(residuals(y[free]))):
            return Minimum(False, "a prediction at the start is not finite", y, np.inf)
        if np.any(free):
            loss = self._rho if self.loss.robust else "linear"
            solution = optimize.least_squares(residuals, y[free], slopes, bounds=(0.0, 1.0), loss=loss,
                                           f_scale=self.loss.size, **_TOLERANCES)  # fmt: skip
            y[free], status = solution.x, solution.message
        total = self.total(y, data)
        converged = self._decrement(y, data, centre, free) <= _DECREMENT * max(1.0, 2.0 * total)
        return Minimum(converged, status, y, total)

    def _residuals(self, y: Array, data: Data, centre: Array | None) -> tuple[Array, Array]:
        """Return weighted residuals and their Jacobian; a centre adds the ridge term (`RIDGE`) as further rows."""
        predicted, slope = self.at(y)
        r, slope = data.weights * (predicted - data.observed), data.weights[:, None] * slope
        if centre is None:
            return r, slope
        ridge = RIDGE**0.5
        return np.r_[r, ridge * (y - centre)], np.vstack([slope, ridge * np.eye(self.unknowns)])

    def _rho(self, z: Array) -> Array:
        """Return the loss and its derivatives in SciPy's form; rows of the ridge term are plain squares."""
        ridge = z[self.rows :]
        return np.hstack([self.loss.rho(z[: self.rows]), [ridge, np.ones_like(ridge), np.zeros_like(ridge)]])

    def _decrement(self, y: Array, data: Data, centre: Array | None, free: NDArray[np.bool_]) -> float:
        """Return twice the decrease of the loss that a Gauss-Newton step between the bounds predicts."""
        r, slope = self._residuals(y, data, centre)
        z = (r / self.loss.size) ** 2
        _, first, second = self._rho(z)
        gradient = slope.T @ (first * r)
        outward = ((y < AT_BOUND) & (gradient >= 0.0)) | ((y > 1.0 - AT_BOUND) & (gradient <= 0.0))
        free = free & ~outward
        curvature = np.maximum(first + 2.0 * z * second, _LEAST_CURVATURE * first)
        hessian = (slope[:, free] * curvature[:, None]).T @ slope[:, free]
        return float(gradient[free] @ np.linalg.lstsq(hessian, gradient[free], rcond=1e-12)[0])
