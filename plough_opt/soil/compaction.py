"""Density of the soil behind the compaction front, and radius of the front: equations (9), (15) and (16).

A particle at the Lagrangian radius r has moved to the radius y, where y^2 = R^2 + 2 psi(r), psi = int_0^r b s ds and
b = rho0/rho. At the front y = r. For a constant density psi has a closed form; for a density profile it is computed by
Gauss-Legendre quadrature.
"""

import numpy as np

from plough_opt.core.checks import check_domain
from plough_opt.core.errors import DomainError
from plough_opt.core.expressions import (
    Expression,
    absolute,
    as_number,
    exp,
    gauss_legendre,
    is_symbolic,
    log1p,
    maximum,
    minimum,
    sqrt,
    where,
)
from plough_opt.soil.soil import Soil, check_soil

# Newton steps for the front, starting at the cavity; one suffices if the density hardly varies.
_FRONT_STEPS = 14
# Largest residual of the front's equation, relative to R^2.
_FRONT_RESIDUAL = 1e-12
# Rounding error of the terms in that equation, relative to r*^2.
_FRONT_ROUNDING = 4e-15
# Largest (r*/R)^2 accepted for a front; it corresponds to a density ratio b1 of 1 - 1e-13.
_MOST_RATIO_SQUARED = 1e13


def ratio(r: Expression, soil: Soil) -> Expression:
    """Return b = rho0/rho(r) of compacted soil [-] at a Lagrangian radius [m]."""
    check_soil(soil)
    profile = soil.density_profile
    return soil.density_ratio if profile is None else soil.density / profile.at(r)


def mean_ratio(r: Expression, soil: Soil) -> Expression:
    """Return 2 psi(r)/r^2, the mean of b over the section inside a Lagrangian radius [-]."""
    check_soil(soil)
    profile = soil.density_profile
    if profile is None:
        return soil.density_ratio
    total: Expression = 0.0
    for node, weight in zip(*gauss_legendre(profile.order), strict=True):
        total = total + 2.0 * weight * node * ratio(r * node, soil)
    return total


def front(radius: Expression, soil: Soil) -> Expression:
    """Return the radius r* of the compaction front [m] around a cavity of radius R [m], equation (16).

    Raises:
        DomainError: no front can hold all the soil displaced from the cavity with this density profile, or the profile
            falls below the undisturbed density somewhere behind the front.
    """
    check_soil(soil)
    radius = check_domain("cavity radius", radius, "m", at_least=0.0)
    if soil.density_profile is None:
        return radius * exp(-log1p(-soil.density_ratio) / 2.0)
    square = _front_square(radius**2, soil)
    radius_of_front = sqrt(square)
    if not is_symbolic(radius_of_front):
        _check_profile(as_number(radius_of_front), soil)
    return radius_of_front


def _front_square(square: Expression, soil: Soil) -> Expression:
    """Return r*^2, the root x of x (1 - mean b(sqrt(x))) - R^2, by a bracketed Newton iteration from R^2.

    The function increases with slope 1 - b, and R^2 lies below its root.
    """
    low, high = square, 10.0 * _MOST_RATIO_SQUARED * square
    x = square
    for _ in range(_FRONT_STEPS):
        r = sqrt(x)
        error = x * (1.0 - mean_ratio(r, soil)) - square
        low, high = where(error < 0.0, maximum(low, x), low), where(error < 0.0, high, minimum(high, x))
        slope = 1.0 - ratio(r, soil)
        step = x - error / where(slope > 0.0, slope, 1.0)
        inside = (step >= low) * (step <= high) * (slope > 0.0)
        x = where(inside, step, sqrt(low * high))
    residual = absolute(x * (1.0 - mean_ratio(sqrt(x), soil)) - square)
    missed = maximum(residual - _FRONT_RESIDUAL * square - _FRONT_ROUNDING * x, x - _MOST_RATIO_SQUARED * square) > 0.0
    if not is_symbolic(missed) and np.any(as_number(missed)):
        widest = float(np.sqrt(np.max(as_number(square))))
        raise DomainError(
            f"the compaction front around a cavity of {widest:.4g} m was not found: with this density profile no front"
            " can hold all the displaced soil; make the profile denser or wider, or raise the order of its quadrature"
        )
    # An expression cannot raise an error, so it evaluates to NaN if there is no front.
    return where(missed, np.nan, x) if is_symbolic(missed) else x


def _check_profile(front_radius: np.ndarray, soil: Soil) -> None:
    """Raise DomainError unless a numeric profile exceeds the undisturbed density everywhere behind the front."""
    profile = soil.density_profile
    assert profile is not None
    places = np.linspace(0.0, 1.0, 2 * profile.order + 1)
    for place in places:
        check_domain(
            f"density profile at {place:.2g} of the front radius over the undisturbed density",
            profile.at(front_radius * place) / soil.density,
            above=1.0,
            why="the soil behind the front is compacted; the profile must return rho(r) in kg/m^3",
        )
