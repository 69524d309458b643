"""McKyes and Ali: a wedge of soil ahead of a narrow tine, with a crescent at each side."""

import math
from dataclasses import dataclass

from plough_opt.core.expressions import Expression, minimum, sin, sqrt, tan
from plough_opt.laws.law import ShareInSoil, SoilReaction
from plough_opt.laws.least import least_angle
from plough_opt.laws.wedge import (
    GRAVITY,
    Tine,
    TineLaw,
    WedgeAngles,
    horizontal,
    wedge_angles,
    wedge_factors,
)
from plough_opt.soil.soil import Soil


@dataclass(frozen=True)
class McKyesAli(TineLaw):
    """`mckyes_ali_draft` as a law: F0 and Fd of a narrow tine, without added mass and loosened radius."""

    label = "McKyes-Ali"
    source = "E. McKyes and O. S. Ali, J. Terramechanics 14 (1977) 43-51; E. McKyes, Soil Cutting and Tillage, 1985"
    standing = "factors of the plane wedge as published; the crescents' factors not verified against the paper"

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2]: see `mckyes_ali_draft`."""
        return _reaction(at.soil, self.tine(at), at.speed)


def mckyes_ali_draft(soil: Soil, tine: Tine, speed: Expression) -> Expression:
    """Return the draft [N] of a narrow tine that shears off a wedge with a crescent at each side.

    H = {gamma d^2 Ng (1 + 2s/3w) + (c Nc + q Nq)(1 + s/w) d + (c_a Nca + rho v^2 Na) d} w sin(alpha + delta) + the
    adhesion along the face; s = d sqrt(cot beta (cot beta + 2 cot alpha)); beta makes the weight's factor least.
    Source: McKyes and Ali 1977; the crescents' factors are not verified against the paper. The crescents leave the
    term with the squared speed alone.

    Args:
        soil: density, cohesion, friction and tool friction enter; its ambient pressure does not.
        tine: numbers, or scalars of CasADi.
        speed: v [m/s], from 0 to 5.

    Raises:
        DomainError: outside the domain of a wedge, or a rake angle so flat and a tine so narrow that the weight's
            factor is least at the end of the possible angles, which of MX symbols is a limit that a `Design` keeps.
    """
    found = _reaction(soil, tine, speed)
    return found.static + found.drag * speed**2


def _reaction(soil: Soil, tine: Tine, speed: Expression) -> SoilReaction:
    """Return the draft's part at rest, and what the squared speed multiplies; the speed is checked only."""
    angles = wedge_angles(soil, tine, speed)
    beta = rupture_angle(angles, tine)
    n = wedge_factors(angles, beta)
    side = _side(angles.rake, beta, tine.depth / tine.width)
    weight = soil.density * GRAVITY * tine.depth * n.weight * (1.0 + 2.0 / 3.0 * side)
    strength = (soil.cohesion * n.cohesion + tine.surcharge * n.surcharge) * (1.0 + side)
    face = tine.width * tine.depth
    return SoilReaction(
        static=horizontal((weight + strength + tine.adhesion * n.adhesion) * face, tine, angles),
        drag=soil.density * n.inertia * face * sin(angles.rake + angles.tool_friction),
    )


def rupture_angle(angles: WedgeAngles, tine: Tine) -> Expression:
    """Return the beta [rad] at which the weight's factor, crescents included, is least.

    Raises:
        DomainError: it is least at the end of the possible angles.
    """
    upper = minimum(math.pi / 2, math.pi - angles.total)
    ratio = tine.depth / tine.width
    return least_angle(
        _weight_factor, upper, angles.rake, angles.tool_friction, angles.friction, ratio, what="McKyes and Ali"
    )


def _weight_factor(
    beta: Expression, alpha: Expression, delta: Expression, phi: Expression, ratio: Expression
) -> Expression:
    plane = wedge_factors(WedgeAngles(alpha, delta, phi), beta).weight
    return plane * (1.0 + 2.0 / 3.0 * _side(alpha, beta, ratio))


def _side(alpha: Expression, beta: Expression, ratio: Expression) -> Expression:
    """Return the half-width s of a crescent over the tine's width, ratio = d/w."""
    cot = 1.0 / tan(beta)
    return ratio * sqrt(cot * (cot + 2.0 / tan(alpha)))
