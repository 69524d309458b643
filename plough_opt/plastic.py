"""Rakhmatulin's plastic gas around an expanding cylindrical cavity: equation (23).

Soil that the share displaces is compacted at a front that runs ahead of the cavity wall to the locked
density, and keeps it. Stresses behind the front obey Mohr and Coulomb.
"""

from __future__ import annotations

from dataclasses import dataclass

from plough_opt.domain import check_domain
from plough_opt.expressions import Expression, cos, exp, expm1_ratio, log1p, log1p_ratio, sin
from plough_opt.soil import Soil


@dataclass(frozen=True)
class Cavity:
    """State of the cavity in one cross-section of the soil.

    Args:
        radius: cavity radius R [m], at least 0.
        rate: R' [m/s], at least 0: the plastic gas does not follow a wall that retreats.
        acceleration: R'' [m/s^2].

    Raises:
        DomainError: a number outside its domain.
    """

    radius: Expression
    rate: Expression
    acceleration: Expression

    def __post_init__(self) -> None:
        check_domain("cavity radius", self.radius, "m", at_least=0.0)
        check_domain("cavity rate", self.rate, "m/s", at_least=0.0)
        check_domain("cavity acceleration", self.acceleration, "m/s^2")


@dataclass(frozen=True)
class WallPressure:
    """Coefficients of the gauge pressure on the wall, p1 - p_a = strength + rho0 (rate R'^2 + inertia R R'').

    Attributes:
        strength: phi (nu p_a + tau0/(1 + mu)) [Pa].
        rate: the bracket {...} of equation (23) [-].
        inertia: phi/b1 [-].
    """

    strength: Expression
    rate: Expression
    inertia: Expression


def wall_pressure(soil: Soil) -> WallPressure:
    """Return the coefficients of equation (23) for a constant locked density.

    With nu = 2 mu/(1 + mu), mu = sin(theta), a = 1/(1 - b1), l = ln a and E(x) = (exp(x) - 1)/x::

        phi   = (l/2) E(nu l/2)
        {...} = (l/(2 b1)) (E(nu l/2) - E((nu/2 - 1) l)) + a^(nu/2)

    which is regular without internal friction (nu = 0) and for soil that locks at once (b1 = 0). Value,
    gradient and Hessian are accurate to a relative 1e-12 for b1 in (0, 1 - 1e-9) and every friction
    angle below 90 degrees.
    """
    mu = sin(soil.friction_angle)
    nu = 2.0 * mu / (1.0 + mu)
    b1 = soil.density_ratio
    log_a = -log1p(-b1)
    log_a_over_b1 = log1p_ratio(-b1)
    growth = expm1_ratio(nu * log_a / 2.0)
    phi = log_a / 2.0 * growth
    tau0 = 2.0 * soil.cohesion * cos(soil.friction_angle)
    return WallPressure(
        strength=phi * (nu * soil.ambient_pressure + tau0 / (1.0 + mu)),
        rate=log_a_over_b1 / 2.0 * (growth - expm1_ratio((nu / 2.0 - 1.0) * log_a)) + exp(nu * log_a / 2.0),
        inertia=log_a_over_b1 / 2.0 * growth,
    )


def surface_pressure(cavity: Cavity, soil: Soil) -> Expression:
    """Return the gauge pressure p1 - p_a [Pa] of the soil on the cavity wall, equation (23).

    On a cone that moves with speed L' the cavity at distance x behind the tip has R = x tan(beta),
    R' = L' tan(beta), R'' = L'' tan(beta). Positive is compression.
    """
    p = wall_pressure(soil)
    motion = p.rate * cavity.rate**2 + p.inertia * cavity.radius * cavity.acceleration
    return p.strength + soil.density * motion


def front_radius(cavity: Cavity, soil: Soil) -> Expression:
    """Return the radius r* = R sqrt(a) of the compaction front [m], a = 1/(1 - b1), equation (16)."""
    return cavity.radius * exp(-log1p(-soil.density_ratio) / 2.0)
