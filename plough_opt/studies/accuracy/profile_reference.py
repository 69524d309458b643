"""The resistance by a density profile in the widest floats, from equations (14) to (24) as they stand.

The quadratures of `soil.plastic` and `laws.forces` are nested Gauss rules in variables of their own. Here
psi is an integral of its own for every radius, the front its root, and what remains are integrals over the particles s
and over the cone's face x, all by Gauss's rule in several panels.
"""

from dataclasses import dataclass

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number
from plough_opt.soil import plastic
from plough_opt.soil.geometry import Cone
from plough_opt.soil.soil import Soil
from plough_opt.studies.accuracy.wide import PI, WIDE, Wide, gauss

_NEWTON = 5


@dataclass(frozen=True)
class WideReaction:
    """F0 [N], Fd [N s^2/m^2] and the added mass [kg]."""

    static: Wide
    drag: Wide
    added_mass: Wide


def profile_reaction(cone: Cone, soil: Soil, panels: int, count: int) -> WideReaction:
    """Return what the soil's density profile adds up to.

    Args:
        cone: numeric.
        soil: numeric, with a density profile.
        panels: of every integral.
        count: points of Gauss's rule in each panel.

    Raises:
        InputError: a profile that takes no wide floats.
    """
    height, slope, friction, density = (
        WIDE(float(as_number(value))) for value in (cone.height, cone.slope, soil.tool_friction, soil.density)
    )
    profile = soil.density_profile
    assert profile is not None

    def ratio(r: Wide) -> Wide:
        try:
            found = np.asarray(profile.at(r), WIDE)
        except (TypeError, NotImplementedError, AttributeError) as error:
            raise InputError(f"the density profile takes no wide floats: {error}") from None
        return density / (found.reshape(r.shape) if found.size == r.size else found + 0 * r)

    parts, weights = _over(WIDE(1), panels, count)

    def psi(r: Wide) -> Wide:
        s = r[..., None] * parts
        return r * ((ratio(s) * s) @ weights)

    points, shares = height * parts, height * weights
    radius = points * slope
    front = _fronts(soil, radius)
    for _ in range(_NEWTON):
        front = front - (front**2 - 2 * psi(front) - radius**2) / (2 * front * (1 - ratio(front)))
    s = front[:, None] * parts
    y = np.sqrt(radius[:, None] ** 2 + 2 * psi(s))
    strength, rate, inertia = _wall(soil, radius, front, 1 - ratio(front), (s, y, weights))
    face = 2 * PI * slope * (slope + friction)
    return WideReaction(
        static=face * (shares @ (points * strength)),
        drag=face * slope**2 * density * (shares @ (points * rate)),
        added_mass=face * slope**2 * density * (shares @ (points**2 * inertia)),
    )


def _over(end: Wide, panels: int, count: int) -> tuple[Wide, Wide]:
    """Return Gauss points from 0 to an end, in panels, and their weights."""
    nodes, weights = gauss(count)
    half = end / panels / 2
    return ((2 * np.arange(panels)[:, None] + nodes + 1) * half).ravel(), np.tile(weights * half, panels)


def _fronts(soil: Soil, radius: Wide) -> Wide:
    """Return radii beside the front's; Newton's method gives them all their digits."""
    cavities = (plastic.Cavity(float(r), 0.0, 0.0) for r in radius)
    return np.array([float(as_number(plastic.front_radius(cavity, soil))) for cavity in cavities], WIDE)


def _wall(
    soil: Soil, radius: Wide, front: Wide, jump: Wide, particles: tuple[Wide, Wide, Wide]
) -> tuple[Wide, Wide, Wide]:
    """Return the wall's gauge pressure at rest [Pa], and its coefficients of rho0 R'^2 and rho0 R R''.

    Args:
        soil: numeric.
        radius: R of the wall, for each point of the face [m].
        front: radius of the front there [m].
        jump: 1 - b at the front.
        particles: where they began s and where they are y, a row for each wall [m]; weights of their integral.
    """
    angle, cohesion, ambient = (
        WIDE(float(as_number(value))) for value in (soil.friction_angle, soil.cohesion, soil.ambient_pressure)
    )
    mu = np.sin(angle)
    nu, tau = 2 * mu / (1 + mu), 2 * cohesion * np.cos(angle)
    log = np.log(front / radius)
    growth = np.expm1(nu * log) / nu if nu > 0 else log
    s, y, weights = particles
    share = (y / radius[:, None]) ** nu * s / y**2 * front[:, None]
    inertia = share @ weights
    slowing = (share * (radius[:, None] / y) ** 2) @ weights
    driven = np.exp(nu * log) * (radius / front) ** 2 / jump
    return growth * (nu * ambient + tau / (1 + mu)), driven + inertia - slowing, inertia
