"""Rakhmatulin's plastic gas around an expanding cylindrical cavity: equations (8)-(23), constant locked density.

Soil that the share displaces is compacted at a front that runs ahead of the cavity wall to the locked
density, and keeps it. Stresses behind the front obey Mohr and Coulomb.
"""

from __future__ import annotations

from dataclasses import dataclass

from plough_opt.domain import check_domain
from plough_opt.expressions import Expression, cos, exp, expm1_ratio, log1p, log1p_ratio, sin, sqrt
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


def front_speed(cavity: Cavity, soil: Soil) -> Expression:
    """Return the speed D = u*'/(1 - b1) = R' sqrt(a) of the compaction front [m/s], equations (19)-(21)."""
    return cavity.rate * exp(-log1p(-soil.density_ratio) / 2.0)


def current_radius(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return where a particle is now: y = r + u = sqrt(b1 r^2 + R^2) [m], equation (15) for constant density.

    Args:
        r: Lagrangian radius, the particle's distance from the axis before the share came [m], from 0 on the
            wall to the front radius r*. An array for a cavity of floats.
        cavity: state of the cavity.
        soil: the soil.

    Raises:
        DomainError: a radius below 0 or ahead of the front, where the soil is undisturbed.
    """
    check_domain("Lagrangian radius", r, "m", at_least=0.0)
    ahead = r / front_radius(cavity, soil)
    # Rounding may put the front itself ahead of itself.
    check_domain(
        "Lagrangian radius over front radius", ahead, at_most=1.0 + 1e-12, why="ahead of the front nothing moves"
    )
    return sqrt(soil.density_ratio * r**2 + cavity.radius**2)


def particle_velocity(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return the radial velocity R R'/y of the particle at Lagrangian radius r [m/s], equation (17)."""
    return cavity.radius * cavity.rate / current_radius(r, cavity, soil)


def particle_acceleration(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return (R'^2 + R R'')/y - R^2 R'^2/y^3 of the particle at Lagrangian radius r [m/s^2], equation (18).

    As y^2 - R^2 = b1 r^2, that is (R R'' + R'^2 b1 r^2/y^2)/y, which does not cancel for soil that locks at once.
    """
    y = current_radius(r, cavity, soil)
    return (cavity.radius * cavity.acceleration + cavity.rate**2 * soil.density_ratio * (r / y) ** 2) / y


@dataclass(frozen=True)
class Stress:
    """Stresses behind the front, tension positive as in the source.

    Attributes:
        radial: sigma_r [Pa].
        tangential: sigma_theta [Pa].
    """

    radial: Expression
    tangential: Expression


def stress(r: Expression, cavity: Cavity, soil: Soil) -> Stress:
    """Return both stresses of the particle at Lagrangian radius r [m], equations (10), (14), (22) corrected.

    With y the particle's radius and l = ln(r*/y), the radial pressure is::

        p = e^(nu l) (p_a + rho0 R'^2) + tau0/(1 + mu) l E(nu l)
            + (rho0/b1) l ((R'^2 + R R'') E(nu l) - (R R'/y)^2 E((nu - 2) l))

    and the tangential one follows from the yield condition p - p_theta = tau0 + mu (p + p_theta). The form is
    regular without internal friction and for b1 -> 0, and at r = 0 gives `surface_pressure`.

    Args:
        r: Lagrangian radius [m], from 0 to the front radius; an array for a cavity of floats.
        cavity: state of the cavity.
        soil: the soil.

    Raises:
        DomainError: a radius below 0 or ahead of the front.
    """
    mu = sin(soil.friction_angle)
    nu = 2.0 * mu / (1.0 + mu)
    tau0 = 2.0 * soil.cohesion * cos(soil.friction_angle)
    y = current_radius(r, cavity, soil)
    # r*^2 - y^2 = b1 (r*^2 - r^2): the logarithm of a ratio beside one, without cancellation.
    front = front_radius(cavity, soil)
    spread = (front - r) * (front + r) / y**2
    log_over_b1 = spread * log1p_ratio(soil.density_ratio * spread) / 2.0
    log = soil.density_ratio * log_over_b1
    growth = expm1_ratio(nu * log)
    spreading = cavity.rate**2 + cavity.radius * cavity.acceleration
    slowing = (cavity.radius * cavity.rate / y) ** 2 * expm1_ratio((nu - 2.0) * log)
    pressure = (
        exp(nu * log) * (soil.ambient_pressure + soil.density * cavity.rate**2)
        + tau0 / (1.0 + mu) * log * growth
        + soil.density * log_over_b1 * (spreading * growth - slowing)
    )
    return Stress(radial=-pressure, tangential=-((1.0 - mu) * pressure - tau0) / (1.0 + mu))
