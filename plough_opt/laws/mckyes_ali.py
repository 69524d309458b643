"""McKyes and Ali: a wedge of soil ahead of a narrow tine, with a crescent at each side."""

from __future__ import annotations

import math
from typing import Final

from plough_opt.core.expressions import Expression, minimum, sqrt, tan
from plough_opt.laws.least import least_angle
from plough_opt.laws.wedge import (
    GRAVITY,
    Tine,
    WedgeAngles,
    horizontal,
    wedge_angles,
    wedge_factors,
)
from plough_opt.soil.soil import Soil

SOURCE: Final = "E. McKyes and O. S. Ali, J. Terramechanics 14 (1977) 43-51; E. McKyes, Soil Cutting and Tillage, 1985"
STANDING: Final = "factors of the plane wedge as published; the crescents' factors not verified against the paper"


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
    angles = wedge_angles(soil, tine, speed)
    beta = rupture_angle(angles, tine)
    n = wedge_factors(angles, beta)
    side = _side(angles.rake, beta, tine.depth / tine.width)
    weight = soil.density * GRAVITY * tine.depth * n.weight * (1.0 + 2.0 / 3.0 * side)
    strength = (soil.cohesion * n.cohesion + tine.surcharge * n.surcharge) * (1.0 + side)
    rest = tine.adhesion * n.adhesion + soil.density * speed**2 * n.inertia
    return horizontal((weight + strength + rest) * tine.width * tine.depth, tine, angles)


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
