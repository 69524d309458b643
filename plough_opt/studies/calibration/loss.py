"""Losses of a standardised residual: squares, and robust ones that give outliers less weight."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_named

Vector = NDArray[np.float64]


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
