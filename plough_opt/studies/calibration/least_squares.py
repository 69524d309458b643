"""The least-squares problem of a calibration, by SciPy's trust-region method with exact derivatives, and its losses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from plough_opt.core.checks import check_named
from plough_opt.studies.calibration.identifiability import UNIFORM

Vector = NDArray[np.float64]

RIDGE: Final = 0.01 / UNIFORM**2
"""Weight of a term that draws the unknowns to a centre if they are not all determined.

It is a hundredth of the information in the bounds themselves. It selects a point along an undetermined direction, and
moves determined unknowns by less than a hundredth of their standard errors.
"""

# Nearly at rounding: the loss is flat at its optimum, and half the digits of the unknowns give all of the loss.
_TIGHT: Final = {"ftol": 1e-11, "xtol": 1e-8, "gtol": 1e-11, "max_nfev": 200}
# Least curvature of a loss, relative to its weight: the loss itself is concave for large residuals.
_LEAST_BEND: Final = 0.1
# A fit has converged if a Gauss-Newton step would lower the sum of squares by less than this, with 1 for one standard
# deviation: the unknowns are then within 1e-4 of a standard deviation.
_DECREMENT: Final = 1e-8
AT_BOUND: Final = 1e-6
"""Distance to a bound within which a scaled unknown is on it."""


@dataclass(frozen=True)
class Loss:
    """A loss c^2/2 rho(z) of a residual r over its standard deviation, with z = (r/c)^2, and rho = z for small z.

    Attributes:
        name: as `calibrate` takes it.
        size: c; residuals well above it count for less than their squares, if the loss is robust.
        rho: z -> rho and its first two derivatives, as `scipy.optimize.least_squares` expects them.
    """

    name: str
    size: float
    rho: Callable[[Any], tuple[Any, Any, Any]]

    @property
    def robust(self) -> bool:
        """Whether large residuals count for less than their squares."""
        return self.name != "squares"

    def value(self, r: Vector) -> Vector:
        """Return the losses of residuals."""
        return np.asarray(0.5 * self.size**2 * self.rho((r / self.size) ** 2)[0])

    def weight(self, r: Vector) -> Vector:
        """Return the derivative of the loss over the residual: the weight of its square in a Gauss-Newton step."""
        return np.asarray(self.rho((r / self.size) ** 2)[1])

    def curvature(self, r: Vector) -> Vector:
        """Return the second derivative of the loss."""
        z = (r / self.size) ** 2
        _, first, second = self.rho(z)
        return np.asarray(first + 2.0 * z * second)


def _huber(z: Any) -> tuple[Any, Any, Any]:
    root = np.sqrt(np.maximum(z, 1.0))
    return np.where(z <= 1.0, z, 2.0 * root - 1.0), 1.0 / root, np.where(z <= 1.0, 0.0, -0.5 / root**3)


def _soft_l1(z: Any) -> tuple[Any, Any, Any]:
    root = np.sqrt(1.0 + z)
    return 2.0 * z / (1.0 + root), 1.0 / root, -0.5 / root**3


# Tuning constants with which an estimate from normal errors has 95 % of the efficiency of least squares.
HUBER, SOFT_L1, CAUCHY = 1.345, 1.287, 2.385

LOSSES: Final = {
    loss.name: loss
    for loss in (
        Loss("squares", 1.0, lambda z: (z, np.ones_like(z), np.zeros_like(z))),
        Loss("huber", HUBER, _huber),
        Loss("soft_l1", SOFT_L1, _soft_l1),
        Loss("cauchy", CAUCHY, lambda z: (np.log1p(z), 1.0 / (1.0 + z), -1.0 / (1.0 + z) ** 2)),
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
class Minimum:
    """Where the solver stopped.

    Attributes:
        converged: whether it is a local optimum: no step between the bounds lowers the loss.
        status: of the solver.
        y: scaled unknowns.
        loss: sum of the losses.
    """

    converged: bool
    status: str
    y: Vector
    loss: float


class LeastSquares:
    """Sum of the losses of weighted residuals, over scaled unknowns between 0 and 1."""

    def __init__(self, predicted: ca.Function, loss: Loss) -> None:
        """Take scaled unknowns (p) -> (predictions (n), their Jacobian (n, p)), and the loss of a weighted residual."""
        self.loss = loss
        self.rows, self.unknowns = predicted.size_out(1)
        self.closed = predicted.is_a("SXFunction")
        self._predicted = predicted
        self._last: tuple[bytes, Vector, Vector] = (b"", np.zeros(0), np.zeros(0))

    def at(self, y: Vector) -> tuple[Vector, Vector]:
        """Return the predictions (n) and their Jacobian (n, p); those of the last point are kept."""
        if self._last[0] != y.tobytes():
            values, slopes = map(np.asarray, self._predicted(y))
            self._last = y.tobytes(), values.ravel(), slopes.reshape(self.rows, self.unknowns)
        return self._last[1:]

    def predict(self, y: Vector) -> Vector:
        """Return the predictions (n)."""
        return self.at(y)[0]

    def total(self, y: Vector, data: Data) -> float:
        """Return the sum of losses."""
        return float(np.sum(self.loss.value(data.weights * (self.predict(y) - data.observed))))

    def solve(self, start: Vector, data: Data, centre: Vector | None = None, held: int | None = None) -> Minimum:
        """Return the local optimum that a start leads to.

        Args:
            start: scaled unknowns.
            data: observed values and weights.
            centre: of many optima along an undetermined direction, the nearest to it is found.
            held: number of an unknown that stays at its start.
        """
        y, free = start.copy(), np.arange(self.unknowns) != (-1 if held is None else held)

        def residuals(x: Vector) -> Vector:
            y[free] = x
            r, slope = self._residuals(y, data, centre)
            return r if np.all(np.isfinite(slope)) else np.full_like(r, np.nan)  # the solver then shortens its step

        def slopes(x: Vector) -> Vector:
            y[free] = x
            return self._residuals(y, data, centre)[1][:, free]

        status = "the start is the only point"
        if not np.all(np.isfinite(residuals(y[free]))):
            return Minimum(False, "no finite prediction at the start", y, np.inf)
        if np.any(free):
            loss = self._rho if self.loss.robust else "linear"
            found = optimize.least_squares(residuals, y[free], slopes, bounds=(0.0, 1.0), loss=loss,
                                           f_scale=self.loss.size, **_TIGHT)  # fmt: skip
            y[free], status = found.x, found.message
        total = self.total(y, data)
        converged = self._decrement(y, data, centre, free) <= _DECREMENT * max(1.0, 2.0 * total)
        return Minimum(converged, status, y, total)

    def _residuals(self, y: Vector, data: Data, centre: Vector | None) -> tuple[Vector, Vector]:
        """Return weighted residuals and their Jacobian; a centre adds the weak pull described at `RIDGE` as rows."""
        predicted, slope = self.at(y)
        r, slope = data.weights * (predicted - data.observed), data.weights[:, None] * slope
        if centre is None:
            return r, slope
        pull = RIDGE**0.5
        return np.r_[r, pull * (y - centre)], np.vstack([slope, pull * np.eye(self.unknowns)])

    def _rho(self, z: Vector) -> Vector:
        """Return the loss and its derivatives in SciPy's form; the rows of a pull to a centre are plain squares."""
        pull = z[self.rows :]
        return np.hstack([self.loss.rho(z[: self.rows]), [pull, np.ones_like(pull), np.zeros_like(pull)]])

    def _decrement(self, y: Vector, data: Data, centre: Vector | None, free: NDArray[np.bool_]) -> float:
        """Return twice the decrease of the loss by a Gauss-Newton step between the bounds."""
        r, slope = self._residuals(y, data, centre)
        z = (r / self.loss.size) ** 2
        _, first, second = self._rho(z)
        gradient = slope.T @ (first * r)
        outward = ((y < AT_BOUND) & (gradient >= 0.0)) | ((y > 1.0 - AT_BOUND) & (gradient <= 0.0))
        free = free & ~outward
        bend = np.maximum(first + 2.0 * z * second, _LEAST_BEND * first)
        curvature = (slope[:, free] * bend[:, None]).T @ slope[:, free]
        return float(gradient[free] @ np.linalg.lstsq(curvature, gradient[free], rcond=1e-12)[0])
