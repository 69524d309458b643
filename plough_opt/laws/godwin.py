"""Godwin: the universal earthmoving equation for a narrow tine above its critical depth."""

from dataclasses import dataclass, field
from typing import Final

from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import Expression, cos, sin, tan
from plough_opt.laws.law import ShareInSoil, SoilReaction
from plough_opt.laws.wedge import (
    GRAVITY,
    Tine,
    TineLaw,
    horizontal,
    plane_rupture_angle,
    wedge_angles,
    wedge_factors,
)
from plough_opt.soil.soil import Soil

CRITICAL_RATIO: Final = 6.0
"""Depth over width beyond which soil would fail sideways at depth; 5 to 6 is said, not verified."""

_REACH = 0.6


@dataclass(frozen=True)
class UniversalEarthmoving(TineLaw):
    """`godwin_draft` as a law: F0 and Fd of a narrow tine, without added mass and loosened radius.

    Args:
        depth: see `TineLaw`, as all others but the last.
        width: as said.
        rake_angle: as said.
        surcharge: as said.
        adhesion: as said.
        rupture_ratio: m, rupture distance on the surface over depth; None: the plane wedge's.
    """

    rupture_ratio: Expression | None = field(default=None, metadata={"unit": ""})

    label = "the universal earthmoving equation"
    source = (
        "R. J. Godwin and M. J. O'Dogherty, Integrated soil tillage force prediction models, ISTVS 2003;"
        " J. Terramechanics 44 (2007) 3-14"
    )
    standing = "factors of a plane wedge in the place of Hettiaratchi's charts; the critical depth not verified"
    scalar = True

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2]: see `godwin_draft`."""
        return _reaction(at.soil, self.tine(at), at.speed, self.rupture_ratio)

    def check(self, at: ShareInSoil) -> None:
        """Refuse what is outside the domain, which no design keeps by itself."""
        self.reaction(at)


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
    found = _reaction(soil, tine, speed, rupture_ratio)
    return found.static + found.drag * speed**2


def _reaction(soil: Soil, tine: Tine, speed: Expression, rupture_ratio: Expression | None) -> SoilReaction:
    """Return the draft's part at rest, and what the squared speed multiplies; the speed is checked only."""
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
    return SoilReaction(
        static=horizontal(still * d * (w + d * (m - (m - 1.0) / 3.0)), tine, angles),
        drag=soil.density * n.inertia * d * (w + _REACH * d) * sin(angles.rake + angles.tool_friction),
    )


def plane_rupture_ratio(soil: Soil, tine: Tine) -> Expression:
    """Return the plane wedge's rupture distance over its depth, cot(alpha) + cot(beta) [-]."""
    beta = plane_rupture_angle(wedge_angles(soil, tine, 0.0))
    return 1.0 / tan(tine.rake_angle) + cos(beta) / sin(beta)
