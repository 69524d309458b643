"""Godwin: the universal earthmoving equation for a narrow tine above its critical depth."""

from __future__ import annotations

from typing import Final

from plough_opt.core.domain import check_domain
from plough_opt.core.expressions import Expression, cos, sin, tan
from plough_opt.laws.wedge import (
    GRAVITY,
    Tine,
    horizontal,
    plane_rupture_angle,
    wedge_angles,
    wedge_factors,
)
from plough_opt.soil.soil import Soil

SOURCE: Final = (
    "R. J. Godwin and M. J. O'Dogherty, Integrated soil tillage force prediction models, ISTVS 2003;"
    " J. Terramechanics 44 (2007) 3-14"
)
STANDING: Final = "factors of a plane wedge in the place of Hettiaratchi's charts; the critical depth not verified"

CRITICAL_RATIO: Final = 6.0
"""Depth over width beyond which soil would fail sideways at depth; 5 to 6 is said, not verified."""

_REACH = 0.6


def godwin_draft(soil: Soil, tine: Tine, speed: Expression, *, rupture_ratio: Expression | None = None) -> Expression:
    """Return the draft [N] by the universal earthmoving equation, crescents at the sides included.

    H = {(gamma d^2 Ng + c d Nc + c_a d Nca + q d Nq)(w + d (m - (m - 1)/3)) + rho v^2 Na d (w + 0.6 d)}
    sin(alpha + delta) + the adhesion along the face. Source: Godwin and O'Dogherty 2003. The charts of Hettiaratchi and
    Reece for the factors are replaced by the plane wedge with least weight factor, which for rough tools gives more.

    Args:
        soil: density, cohesion, friction and tool friction enter; its ambient pressure does not.
        tine: numbers, arrays or CasADi expressions.
        speed: v [m/s], from 0 to 5.
        rupture_ratio: m, rupture distance on the surface over depth, at least 1; None: the plane wedge's
            cot(alpha) + cot(beta).

    Raises:
        DomainError: outside the domain of a wedge, or more than six times as deep as wide.
    """
    angles = wedge_angles(soil, tine, speed)
    check_domain(
        "depth over width", tine.depth / tine.width, at_most=CRITICAL_RATIO,
        why="below the critical depth the soil fails sideways, which this equation lacks",
    )  # fmt: skip
    n = wedge_factors(angles, plane_rupture_angle(angles))
    m = plane_rupture_ratio(soil, tine) if rupture_ratio is None else rupture_ratio
    check_domain("rupture distance ratio m", m, at_least=1.0)
    d, w = tine.depth, tine.width
    still = soil.density * GRAVITY * d * n.weight + soil.cohesion * n.cohesion
    still = still + tine.adhesion * n.adhesion + tine.surcharge * n.surcharge
    inertia = soil.density * speed**2 * n.inertia * d * (w + _REACH * d)
    return horizontal(still * d * (w + d * (m - (m - 1.0) / 3.0)) + inertia, tine, angles)


def plane_rupture_ratio(soil: Soil, tine: Tine) -> Expression:
    """Return the plane wedge's rupture distance over its depth, cot(alpha) + cot(beta) [-]."""
    beta = plane_rupture_angle(wedge_angles(soil, tine, 0.0))
    return 1.0 / tan(tine.rake_angle) + cos(beta) / sin(beta)
