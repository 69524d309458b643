"""Losses of a standardised residual: squares, and robust ones that give outliers less weight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from plough_opt.core.expressions import Expression, absolute, log1p, maximum, minimum, sqrt, where
from plough_opt.core.kinds import check_named


@dataclass(frozen=True)
class Loss:
    """A loss rho of a residual r over its standard deviation, with rho = r^2/2 for small r.

    Attributes:
        name: as `calibrate` takes it.
        value: r -> rho.
        weight: r -> rho'/r, the weight of the squared residual in a Gauss-Newton step.
        curvature: r -> rho''.
        robust: whether large residuals count for less than their squares.
    """

    name: str
    value: Callable[[Expression], Expression]
    weight: Callable[[Expression], Expression]
    curvature: Callable[[Expression], Expression]
    robust: bool = True


# Tuning constants with which an estimate from normal errors has 95 % of the efficiency of least squares.
HUBER, SOFT_L1, CAUCHY = 1.345, 1.287, 2.385


def _soft(r: Expression) -> Expression:
    return sqrt(1.0 + (r / SOFT_L1) ** 2)


LOSSES: Final = {
    loss.name: loss
    for loss in (
        Loss("squares", lambda r: 0.5 * r**2, lambda r: 1.0 + 0.0 * r, lambda r: 1.0 + 0.0 * r, robust=False),
        Loss(
            "huber",
            lambda r: where(absolute(r) <= HUBER, 0.5 * r**2, HUBER * absolute(r) - 0.5 * HUBER**2),
            lambda r: minimum(1.0, HUBER / maximum(absolute(r), 1e-300)),
            lambda r: where(absolute(r) <= HUBER, 1.0 + 0.0 * r, 0.0 * r),
        ),
        Loss(
            "soft_l1",
            lambda r: r**2 / (1.0 + _soft(r)),
            lambda r: 1.0 / _soft(r),
            lambda r: 1.0 / _soft(r) ** 3,
        ),
        Loss(
            "cauchy",
            lambda r: 0.5 * CAUCHY**2 * log1p((r / CAUCHY) ** 2),
            lambda r: 1.0 / (1.0 + (r / CAUCHY) ** 2),
            lambda r: (1.0 - (r / CAUCHY) ** 2) / (1.0 + (r / CAUCHY) ** 2) ** 2,
        ),
    )
}  # fmt: skip


def loss_of(name: str) -> Loss:
    """Return a loss by name.

    Raises:
        InputError: an unknown name.
    """
    check_named("no loss is named {}", name, LOSSES)
    return LOSSES[name]
