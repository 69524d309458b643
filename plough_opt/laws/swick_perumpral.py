"""Swick and Perumpral: the plane wedge with the inertia of the soil in its balance, least over the rupture plane."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from plough_opt.core.expressions import Expression, minimum
from plough_opt.laws.law import STEADY, ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.laws.least import least_angle
from plough_opt.laws.wedge import (
    GRAVITY,
    Tine,
    TineLaw,
    WedgeAngles,
    horizontal,
    pressure,
    wedge_angles,
    wedge_factors,
)
from plough_opt.soil.soil import Soil


@dataclass(frozen=True)
class SwickPerumpral(TineLaw):
    """`swick_perumpral_draft` as a law of steady sliding: the rupture angle depends on the speed."""

    label = "Swick-Perumpral"
    source = "W. C. Swick and J. V. Perumpral, J. Terramechanics 25 (1988) 43-56"
    standing = "plane wedge without side forces; that its force is minimised is not verified against the paper"
    lacking: ClassVar[Mapping[str, str]] = {**ResistanceLaw.lacking, **STEADY}

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return the draft at the tow speed as F0 [N]."""
        return SoilReaction(static=swick_perumpral_draft(at.soil, self.tine(at), at.speed))


def swick_perumpral_draft(soil: Soil, tine: Tine, speed: Expression) -> Expression:
    """Return the draft [N] of a plane wedge whose soil is accelerated, without forces at its sides.

    H = P sin(alpha + delta) + the adhesion along the face, P/(w d) = gamma d Ng + c Nc + q Nq + c_a Nca + rho v^2 Na,
    P least over the rupture angle. Source: Swick and Perumpral 1988; the side forces of narrow tines are left out, and
    that P is minimised is not verified against the paper. For a narrow tine it is therefore a lower value.

    Args:
        soil: density, cohesion, friction and tool friction enter; its ambient pressure does not.
        tine: numbers, or scalars of CasADi.
        speed: v [m/s], from 0 to 5.

    Raises:
        DomainError: outside the domain of a wedge, or a force that is least at the end of the possible angles, which of
            MX symbols is a limit that a `Design` keeps.
    """
    angles = wedge_angles(soil, tine, speed)
    upper = minimum(math.pi / 2, math.pi - angles.total)
    beta = least_angle(
        _force,
        upper,
        angles.rake,
        angles.tool_friction,
        angles.friction,
        soil.density * GRAVITY * tine.depth,
        soil.cohesion,
        tine.surcharge,
        tine.adhesion,
        soil.density * speed**2,
        what="Swick and Perumpral",
    )
    mean = pressure(soil, tine, speed, wedge_factors(angles, beta))
    return horizontal(mean * tine.width * tine.depth, tine, angles)


def _force(
    beta: Expression, alpha: Expression, delta: Expression, phi: Expression, weight: Expression, *loads: Expression
) -> Expression:
    n = wedge_factors(WedgeAngles(alpha, delta, phi), beta)
    cohesion, surcharge, adhesion, inertia = loads
    still = weight * n.weight + cohesion * n.cohesion + surcharge * n.surcharge + adhesion * n.adhesion
    return still + inertia * n.inertia
