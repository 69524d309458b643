"""Rakhmatulin's plastic gas around an expanding cylindrical cavity: equations (8)-(23).

Soil displaced by the share is compacted at a front that runs ahead of the cavity wall, and keeps its density behind the
front. There the stresses satisfy the Mohr-Coulomb yield condition. For a constant locked density all results have a
closed form; for a density profile (`Soil.with_density_profile`) they are Gauss-Legendre quadratures.

Behind the front a particle at the Lagrangian radius r has moved to the radius y, where y^2 = R^2 + 2 psi(r),
psi = int_0^r b s ds and b = rho0/rho; at the front y = r.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from plough_opt.core import expressions as ex
from plough_opt.core.checks import check_domain, check_kind, checked_in_designs
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression
from plough_opt.soil.soil import Soil, check_soil

__all__ = [
    "Cavity", "Stress", "WallPressure", "current_radius", "density", "front", "front_radius", "front_speed",
    "mean_ratio", "particle_acceleration", "particle_velocity", "quadrature_error", "ratio", "stress",
    "surface_pressure", "wall_pressure",
]  # fmt: skip

# Largest (r*/R)^2 accepted for a front; it corresponds to a density ratio b1 of 1 - 1e-13.
_MOST_RATIO_SQUARED = 1e13


def ratio(r: Expression, soil: Soil) -> Expression:
    """Return b = rho0/rho(r) of compacted soil [-] at a Lagrangian radius [m].

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.plastic.ratio(0.02, soil)), 6)
        0.794
    """
    check_soil(soil)
    profile = soil.density_profile
    return soil.density_ratio if profile is None else soil.density / profile.at(r)


def mean_ratio(r: Expression, soil: Soil) -> Expression:
    """Return 2 psi(r)/r^2, the mean of b over the section inside a Lagrangian radius [-].

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.plastic.mean_ratio(0.02, soil)), 6)
        0.794
    """
    check_soil(soil)
    profile = soil.density_profile
    if profile is None:
        return soil.density_ratio
    nodes = zip(*ex.gauss_legendre(profile.order), strict=True)
    return sum(2.0 * weight * node * ratio(r * node, soil) for node, weight in nodes)


def front(radius: Expression, soil: Soil) -> Expression:
    """Return the radius r* of the compaction front [m] around a cavity of radius R [m], equation (16).

    Raises:
        DomainError: no front can hold all the soil displaced from the cavity with this density profile, or the profile
            falls below the undisturbed density somewhere behind the front.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.plastic.front(0.04, soil)), 4)
        0.0881
    """
    check_soil(soil)
    radius = check_domain("cavity radius", radius, "m", at_least=0.0)
    if soil.density_profile is None:
        return radius * ex.exp(-ex.log1p(-soil.density_ratio) / 2.0)
    square = _front_square(radius**2, soil)
    radius_of_front = ex.sqrt(square)
    if not ex.is_symbolic(radius_of_front):
        _check_profile(ex.as_number(radius_of_front), soil)
    return radius_of_front


def _front_square(square: Expression, soil: Soil) -> Expression:
    """Return r*^2, the root x of x (1 - mean b(sqrt(x))) - R^2, by a bracketed Newton iteration from R^2.

    The function increases with slope 1 - b, and R^2 lies below its root.
    """
    low, high = square, 10.0 * _MOST_RATIO_SQUARED * square
    x = square
    for _ in range(14):  # one suffices if the density hardly varies
        r = ex.sqrt(x)
        error = x * (1.0 - mean_ratio(r, soil)) - square
        low, high = ex.where(error < 0.0, ex.maximum(low, x), low), ex.where(error < 0.0, high, ex.minimum(high, x))
        slope = 1.0 - ratio(r, soil)
        step = x - error / ex.where(slope > 0.0, slope, 1.0)
        inside = (step >= low) * (step <= high) * (slope > 0.0)
        x = ex.where(inside, step, ex.sqrt(low * high))
    residual = ex.absolute(x * (1.0 - mean_ratio(ex.sqrt(x), soil)) - square)
    missed = ex.maximum(residual - 1e-12 * square - 4e-15 * x, x - _MOST_RATIO_SQUARED * square) > 0.0
    if not ex.is_symbolic(missed) and np.any(ex.as_number(missed)):
        widest = float(np.sqrt(np.max(ex.as_number(square))))
        raise DomainError(
            f"the compaction front around a cavity of {widest:.4g} m was not found: with this density profile no front"
            " can hold all the displaced soil; make the profile denser or wider, or raise the order of its quadrature"
        )
    # An expression cannot raise an error, so it evaluates to NaN if there is no front.
    return ex.where(missed, np.nan, x) if ex.is_symbolic(missed) else x


def _check_profile(front_radius: np.ndarray, soil: Soil) -> None:
    """Raise DomainError unless a numeric profile exceeds the undisturbed density everywhere behind the front."""
    profile = soil.density_profile
    assert profile is not None
    places = np.linspace(0.0, 1.0, 2 * profile.order + 1)
    for place in places:
        what = f"density profile at {place:.2g} of the front radius over the undisturbed density"
        why = "the soil behind the front is compacted; the profile must return rho(r) in kg/m^3"
        check_domain(what, profile.at(front_radius * place) / soil.density, above=1.0, why=why)


@dataclass(frozen=True)
class Cavity:
    """State of the cavity in one cross-section of the soil.

    Args:
        radius: cavity radius R [m], at least 0.
        rate: R' [m/s], at least 0, because the plastic gas does not follow a retreating wall.
        acceleration: R'' [m/s^2].

    Raises:
        DomainError: a number lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0).radius
        0.04
    """

    radius: Expression
    rate: Expression
    acceleration: Expression

    def __post_init__(self) -> None:
        for name, unit, least in (("radius", "m", 0.0), ("rate", "m/s", 0.0), ("acceleration", "m/s^2", -math.inf)):
            value = check_domain(f"cavity {name}", getattr(self, name), unit, at_least=least)
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class WallPressure:
    """Coefficients of the gauge pressure on the wall, p1 - p_a = strength + rho0 (rate R'^2 + inertia R R'').

    Attributes:
        strength: phi (nu p_a + tau0/(1 + mu)) [Pa].
        rate: the bracket {...} of equation (23) [-].
        inertia: phi/b1 [-].

    For a density profile they are the corresponding terms and depend on the cavity's radius.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> pressure = po.plastic.wall_pressure(soil)
        >>> round(float(pressure.around(po.plastic.Cavity(0.04, 0.5, 0.0), soil)) / 1e3, 1)
        92.0
    """

    strength: Expression
    rate: Expression
    inertia: Expression

    def around(self, cavity: Cavity, soil: Soil) -> Expression:
        """Return the gauge pressure [Pa] for a state of the cavity.

        Example:
            >>> import plough_opt as po
            >>> soil = po.named_soil("serozem")
            >>> pressure = po.plastic.wall_pressure(soil)
            >>> round(float(pressure.around(po.plastic.Cavity(0.04, 0.5, 0.0), soil)) / 1e3, 1)
            92.0
        """
        motion = self.rate * cavity.rate**2 + self.inertia * cavity.radius * cavity.acceleration
        return self.strength + soil.density * motion


@checked_in_designs
def wall_pressure(soil: Soil, radius: Expression | None = None) -> WallPressure:
    """Return the coefficients of equation (23).

    For a constant locked density, with nu = 2 mu/(1 + mu), mu = sin(theta), a = 1/(1 - b1), l = ln a and
    E(x) = (exp(x) - 1)/x::

        phi   = (l/2) E(nu l/2)
        {...} = (l/(2 b1)) (E(nu l/2) - E((nu/2 - 1) l)) + a^(nu/2)

    which is regular without internal friction (nu = 0) and for soil that locks at once (b1 = 0). Value,
    gradient and Hessian have a relative error below 1e-12 for b1 in (0, 1 - 1e-9) and every friction
    angle below 90 degrees.

    Args:
        soil: the soil.
        radius: cavity radius R [m], above 0; required for a density profile.

    Raises:
        InputError: the soil has a density profile, but no radius is given.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> pressure = po.plastic.wall_pressure(soil)
        >>> round(float(pressure.around(po.plastic.Cavity(0.04, 0.5, 0.0), soil)) / 1e3, 1)
        92.0
    """
    check_soil(soil)
    yielding = soil.yielding
    nu, b1 = yielding.nu, soil.density_ratio
    if soil.density_profile is not None:
        if radius is None:
            raise InputError("with a density profile the wall pressure depends on the cavity: give its radius")
        check_domain("cavity radius", radius, "m", above=0.0, why="with a density profile the pressure depends on it")
        return _pressure(0.0, radius, front(radius, soil), soil)
    log_a = -ex.log1p(-b1)
    log_a_over_b1 = ex.log1p_ratio(-b1)
    growth = ex.expm1_ratio(nu * log_a / 2.0)
    return WallPressure(
        strength=log_a / 2.0 * growth * yielding.strength(soil.ambient_pressure),
        rate=log_a_over_b1 / 2.0 * (growth - ex.expm1_ratio((nu / 2.0 - 1.0) * log_a)) + ex.exp(nu * log_a / 2.0),
        inertia=log_a_over_b1 / 2.0 * growth,
    )


@checked_in_designs
def surface_pressure(cavity: Cavity, soil: Soil) -> Expression:
    """Return the gauge pressure p1 - p_a [Pa] of the soil on the cavity wall, equation (23).

    On a cone that moves with speed L' the cavity at distance x behind the tip has R = x tan(beta),
    R' = L' tan(beta), R'' = L'' tan(beta). Positive is compression.

    Args:
        cavity: state of the cavity there; floats, arrays or CasADi expressions.
        soil: the soil.

    Raises:
        DomainError: the soil has a density profile, and the cavity's radius is 0 or there is no front.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.surface_pressure(cavity, soil)) / 1e3, 1)
        92.0
    """
    _check_cavity(cavity)
    return wall_pressure(soil, cavity.radius).around(cavity, soil)


@checked_in_designs
def front_radius(cavity: Cavity, soil: Soil) -> Expression:
    """Return the radius r* of the compaction front [m], equation (16).

    For a constant density it is R sqrt(a) with a = 1/(1 - b1).

    Raises:
        DomainError: no front can hold all the soil displaced from the cavity with this density profile.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.front_radius(cavity, soil)), 4)
        0.0881
    """
    _check_cavity(cavity)
    return front(cavity.radius, soil)


@checked_in_designs
def front_speed(cavity: Cavity, soil: Soil) -> Expression:
    """Return the speed D = u*'/(1 - b*) of the compaction front [m/s], equations (19)-(21).

    For a constant density it is R' sqrt(a) with a = 1/(1 - b1).

    Raises:
        DomainError: the soil has a density profile, and the cavity's radius is 0 or there is no front.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.front_speed(cavity, soil)), 3)
        1.102
    """
    check_soil(soil)
    _check_cavity(cavity)
    if soil.density_profile is None:
        return cavity.rate * ex.exp(-ex.log1p(-soil.density_ratio) / 2.0)
    r = front_radius(cavity, soil)
    check_domain("front radius", r, "m", above=0.0, why="a density profile has no front speed at the tip")
    return cavity.radius * cavity.rate / (r * (1.0 - ratio(r, soil)))


@checked_in_designs
def density(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return the density rho(r) [kg/m^3] of the compacted soil at Lagrangian radius r [m], equation (9).

    Raises:
        DomainError: the radius is negative, or ahead of the front, where the soil has its undisturbed density.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.density(0.02, cavity, soil)), 1)
        1700.3
    """
    _check_behind(r, front_radius(cavity, soil))
    return soil.density / ratio(r, soil) + 0.0 * r


@checked_in_designs
def current_radius(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return the present radius of a particle, y = r + u = sqrt(2 psi(r) + R^2) [m], equation (15).

    For a constant density 2 psi = b1 r^2.

    Args:
        r: Lagrangian radius, the particle's distance from the axis before the share arrived [m], from 0 on the
            wall to the front radius r*; it may be an array if the cavity's quantities are floats.
        cavity: state of the cavity.
        soil: the soil.

    Raises:
        DomainError: the radius is negative, or ahead of the front, where the soil is undisturbed.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.current_radius(0.0, cavity, soil)), 4)
        0.04
    """
    _check_behind(r, front_radius(cavity, soil))
    return ex.sqrt(mean_ratio(r, soil) * r**2 + cavity.radius**2)


@checked_in_designs
def particle_velocity(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return the radial velocity R R'/y of the particle at Lagrangian radius r [m/s], equation (17).

    Arguments and errors are those of `current_radius`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.particle_velocity(0.0, cavity, soil)), 4)
        0.5
    """
    y = current_radius(r, cavity, soil)
    return cavity.radius * cavity.rate / y


@checked_in_designs
def particle_acceleration(r: Expression, cavity: Cavity, soil: Soil) -> Expression:
    """Return (R'^2 + R R'')/y - R^2 R'^2/y^3 of the particle at Lagrangian radius r [m/s^2], equation (18).

    With y^2 - R^2 = 2 psi it is (R R'' + 2 psi R'^2/y^2)/y, which does not cancel for soil that locks at once.
    Arguments and errors are those of `current_radius`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.particle_acceleration(0.0, cavity, soil)), 3)
        0.0
    """
    y = current_radius(r, cavity, soil)
    return (cavity.radius * cavity.acceleration + cavity.rate**2 * mean_ratio(r, soil) * (r / y) ** 2) / y


@dataclass(frozen=True)
class Stress:
    """Stresses behind the front, tension positive as in the source.

    Attributes:
        radial: sigma_r [Pa].
        tangential: sigma_theta [Pa].

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.stress(0.02, cavity, soil).radial) / 1e3, 1)
        -180.4
    """

    radial: Expression
    tangential: Expression


@checked_in_designs
def stress(r: Expression, cavity: Cavity, soil: Soil) -> Stress:
    """Return both stresses at the particle with Lagrangian radius r [m], equations (10), (14), (22) corrected.

    With y the particle's radius and l = ln(r*/y), the radial pressure for a constant density is::

        p = e^(nu l) (p_a + rho0 R'^2) + tau0/(1 + mu) l E(nu l)
            + (rho0/b1) l ((R'^2 + R R'') E(nu l) - (R R'/y)^2 E((nu - 2) l))

    The tangential pressure follows from the yield condition p - p_theta = tau0 + mu (p + p_theta). This form is regular
    without internal friction and for b1 -> 0, and equals `surface_pressure` at r = 0. For a density profile the two
    inertial terms are quadratures.

    Args:
        r: Lagrangian radius [m], from 0 to the front radius; it may be an array if the cavity's quantities are floats.
        cavity: state of the cavity, with a radius above 0.
        soil: the soil.

    Raises:
        DomainError: the radius is negative or ahead of the front, or the cavity's radius is 0.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> round(float(po.plastic.stress(0.0, cavity, soil).radial) / 1e3, 1)
        -193.3
    """
    _check_cavity(cavity)
    check_domain("cavity radius", cavity.radius, "m", above=0.0, why="at the tip the stress is not unique")
    r_front = front_radius(cavity, soil)
    _check_behind(r, r_front)
    pressure = soil.ambient_pressure + _pressure(r, cavity.radius, r_front, soil).around(cavity, soil)
    yielding = soil.yielding
    # (1 - mu)/(1 + mu), written so that it does not cancel near 90 degrees.
    transferred = (ex.cos(soil.friction_angle) / (1.0 + yielding.mu)) ** 2
    tangential = transferred * pressure - yielding.tau0 / (1.0 + yielding.mu)
    return Stress(radial=-pressure, tangential=-tangential)


def quadrature_error(r: Expression, cavity: Cavity, soil: Soil) -> float:
    """Return an estimate of the relative error of `stress` due to the quadrature over a density profile.

    It is the largest difference from the stress with 1.5 times as many nodes, relative to the largest stress, and 0 for
    a constant density. The two quadratures give slightly different fronts; radii beyond the smaller front are replaced
    by it.

    Raises:
        DomainError: as `stress`.
        InputError: an argument holds symbols.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> cavity = po.plastic.Cavity(radius=0.04, rate=0.5, acceleration=0.0)
        >>> po.plastic.quadrature_error(0.02, cavity, soil) < 1e-9
        True
    """
    check_soil(soil)
    profile = soil.density_profile
    if profile is None:
        return 0.0
    finer = replace(soil, density_profile=replace(profile, order=profile.order + profile.order // 2 + 1))
    nearer = min(float(ex.as_number(front_radius(cavity, ground))) for ground in (soil, finer))
    _check_behind(r, front_radius(cavity, soil))
    places = np.minimum(ex.as_number(r), nearer)
    own, better = (ex.as_number(stress(places, cavity, ground).radial) for ground in (soil, finer))
    return float(np.max(np.abs(own - better)) / np.max(np.abs(better)))


def _check_cavity(cavity: Cavity) -> None:
    """Raise InputError if the cavity has the wrong type."""
    check_kind("the cavity", cavity, Cavity, "a plastic.Cavity, made of radius, rate and acceleration")


def _check_behind(r: Expression, r_front: Expression) -> None:
    """Raise DomainError for Lagrangian radii that are negative or ahead of the front."""
    check_domain("Lagrangian radius", r, "m", at_least=0.0)
    check_domain("front radius", r_front, "m", above=0.0, why="around a cavity of radius 0 the soil has not moved")
    # A radius on the front may exceed it by rounding, or by the tolerance of the front's equation.
    why = "the soil is at rest ahead of it"
    check_domain("Lagrangian radius over front radius", r / r_front, at_most=1.0 + 1e-11, why=why)


def _pressure(r: Expression, radius: Expression, r_front: Expression, soil: Soil) -> WallPressure:
    """Return the coefficients of the gauge pressure at Lagrangian radius r, equation (14) with (18) and (21)."""
    yielding = soil.yielding
    nu, wall = yielding.nu, radius**2
    y_squared = mean_ratio(r, soil) * r**2 + wall
    if soil.density_profile is None:
        # With r*^2 - y^2 = b1 (r*^2 - r^2) the logarithm of a ratio near 1 does not cancel.
        spread = (r_front - r) * (r_front + r) / y_squared
        log_over_b1 = spread * ex.log1p_ratio(soil.density_ratio * spread) / 2.0
        log = soil.density_ratio * log_over_b1
        jump: Expression = 1.0
        swelling = log_over_b1 * ex.expm1_ratio(nu * log)
        spreading = swelling - log_over_b1 * wall / y_squared * ex.expm1_ratio((nu - 2.0) * log)
    else:
        # R^2 is cancelled analytically in the difference of the squared radii of front and particle.
        log = ex.log1p((mean_ratio(r_front, soil) * r_front**2 - mean_ratio(r, soil) * r**2) / y_squared) / 2.0
        jump = (radius / r_front) ** 2 / (1.0 - ratio(r_front, soil))
        swelling, spreading = _inertia_of_profile(r, r_front, radius, soil)
    return WallPressure(
        strength=log * ex.expm1_ratio(nu * log) * yielding.strength(soil.ambient_pressure),
        rate=ex.exp(nu * log) * jump + spreading,
        inertia=swelling,
    )


def _inertia_of_profile(
    r: Expression, r_front: Expression, radius: Expression, soil: Soil
) -> tuple[Expression, Expression]:
    """Return the integrals from r to r* of (y_s/y)^nu s/y_s^2 ds, and of that integrand times 2 psi(s)/y_s^2 [-].

    The quadrature nodes are Gauss-Legendre nodes in sigma, where s^2 = R^2 (e^(2 l sigma^2) - 1)/b, l = ln(r*/R) and b
    is the mean 1 - (R/r*)^2. In sigma the integrands are entire functions for a constant density, and profiles given in
    r or r^2 are both smooth.
    """
    profile = soil.density_profile
    assert profile is not None
    nu, wall, mean = soil.yielding.nu, radius**2, mean_ratio(r_front, soil)
    y_squared, per_mean = wall + mean_ratio(r, soil) * r**2, ex.log1p_ratio(-mean)
    first = r / radius * ex.sqrt(ex.log1p_ratio(mean * (r / radius) ** 2) / per_mean)
    swelling: Expression = 0.0
    spreading: Expression = 0.0
    for node, weight in zip(*ex.gauss_legendre(profile.order), strict=True):
        sigma = first + (1.0 - first) * node
        exponent = mean * per_mean * sigma**2
        square = wall * per_mean * sigma**2 * ex.expm1_ratio(exponent)
        of_square = weight * (1.0 - first) * wall * per_mean * sigma * ex.exp(exponent)
        compacted = mean_ratio(ex.sqrt(square), soil) * square
        here = wall + compacted
        share = of_square * ex.exp(nu * ex.log1p((here - y_squared) / y_squared) / 2.0) / here
        swelling, spreading = swelling + share, spreading + share * compacted / here
    return swelling, spreading
