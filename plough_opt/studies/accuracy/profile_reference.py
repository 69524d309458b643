"""The resistance by a density profile in the widest floats, from equations (14) to (24) as they stand.

The quadratures of `soil.plastic` and `laws.forces` are nested Gauss rules in variables of their own. Here
psi is a chain of Chebyshev polynomials over the radius, the front its root, and what remains are integrals over the
particles s and over the cone's face x, each in several panels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number
from plough_opt.soil import plastic
from plough_opt.soil.geometry import Cone
from plough_opt.soil.soil import Soil
from plough_opt.studies.accuracy.picard import PI, WIDE, Basis, Wide, chebyshev, gauss

_NEWTON = 5
# The table of psi ends a little beyond the front at the base.
_BEYOND = WIDE(1.001)


@dataclass(frozen=True)
class WideReaction:
    """F0 [N], Fd [N s^2/m^2] and the added mass [kg]."""

    static: Wide
    drag: Wide
    added_mass: Wide


@dataclass(frozen=True)
class _Psi:
    """psi(r), the integral of b(s) s from 0 to r, as polynomials in panels of one width [m]."""

    width: Wide
    coefficients: Wide

    @classmethod
    def of(cls, ratio: Callable[[Wide], Wide], end: Wide, panels: int, degree: int) -> _Psi:
        basis, width = Basis.of(degree), end / panels
        places = width * (np.arange(panels)[:, None] + (basis.nodes + 1) / 2)
        parts = width / 2 * (ratio(places) * places) @ basis.integral.T
        before = np.concatenate([[WIDE(0)], np.cumsum(parts[:-1, -1])])
        return cls(width, (parts + before[:, None]) @ basis.coefficients.T)

    def __call__(self, r: Wide) -> Wide:
        panel = np.minimum((r / self.width).astype(int), len(self.coefficients) - 1)
        rows = chebyshev(2 * (r / self.width - panel) - 1, self.coefficients.shape[1] - 1)
        found: Wide = np.sum(rows * self.coefficients[panel], axis=-1)
        return found


def profile_reaction(cone: Cone, soil: Soil, panels: int, degree: int) -> WideReaction:
    """Return what the soil's density profile adds up to.

    Args:
        cone: numeric.
        soil: numeric, with a density profile.
        panels: of psi over the radius; an eighth of them over particles and face.
        degree: of psi in a panel, and points of Gauss's rule in each of the others.

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

    points, weights = _over(height, max(2, panels // 8), degree)
    radius = points * slope
    front = _fronts(soil, radius)
    psi = _Psi.of(ratio, np.max(front) * _BEYOND, panels, degree)
    for _ in range(_NEWTON):
        front = front - (front**2 - 2 * psi(front) - radius**2) / (2 * front * (1 - ratio(front)))
    strength, rate, inertia = _wall(soil, psi, ratio, radius, front, max(2, panels // 8), degree)
    face = 2 * PI * slope * (slope + friction)
    return WideReaction(
        static=face * (weights @ (points * strength)),
        drag=face * slope**2 * density * (weights @ (points * rate)),
        added_mass=face * slope**2 * density * (weights @ (points**2 * inertia)),
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
    soil: Soil, psi: _Psi, ratio: Callable[[Wide], Wide], radius: Wide, front: Wide, panels: int, count: int
) -> tuple[Wide, Wide, Wide]:
    """Return the wall's gauge pressure at rest [Pa], and its coefficients of rho0 R'^2 and rho0 R R''."""
    angle, cohesion, ambient = (
        WIDE(float(as_number(value))) for value in (soil.friction_angle, soil.cohesion, soil.ambient_pressure)
    )
    mu = np.sin(angle)
    nu, tau = 2 * mu / (1 + mu), 2 * cohesion * np.cos(angle)
    log = np.log(front / radius)
    growth = np.expm1(nu * log) / nu if nu > 0 else log
    parts, weights = _over(WIDE(1), panels, count)
    s = front[:, None] * parts
    y = np.sqrt(radius[:, None] ** 2 + 2 * psi(s.ravel()).reshape(s.shape))
    share = (y / radius[:, None]) ** nu * s / y**2 * front[:, None]
    inertia = share @ weights
    slowing = (share * (radius[:, None] / y) ** 2) @ weights
    jump = np.exp(nu * log) * (radius / front) ** 2 / (1 - ratio(front))
    return growth * (nu * ambient + tau / (1 + mu)), jump + inertia - slowing, inertia
