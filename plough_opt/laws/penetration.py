"""Cone index: the pressure that a penetrometer reads, from the plastic gas around its 30 degree cone."""

import math

from plough_opt.core.expressions import Expression
from plough_opt.laws.forces import soil_reaction
from plough_opt.soil.geometry import Cone
from plough_opt.soil.soil import CONE_HALF_ANGLE, Soil

# Height [m] of the standard cone with a base of 323 mm^2; it counts in a soil with a density profile only.
_HEIGHT = math.sqrt(323e-6 / math.pi) / math.tan(CONE_HALF_ANGLE)


def cone_index(soil: Soil) -> Expression:
    """Return the pressure [Pa] on the base of a penetrometer's 30 degree cone in a soil.

    It is the static part F0/(pi h^2 tan^2 beta) of equation (25) at beta = 15 degrees,
    (1 + mu0/tan beta) phi (nu p_a + tau0/(1 + mu)) times the soil's strength factor. At the 30 mm/s of a penetrometer
    the inertia adds some millionths. Of a constant density ratio it does not depend on the size of the cone; in a soil
    with a density profile it is that of a base of 323 mm^2.

    Laboratory values of cohesion, friction and density ratio give a level that is often far too low, by up to two
    orders of magnitude in sand: see docs/soils.md, and `Soil.from_cone_index` for the way back from a reading.

    Args:
        soil: the soil; its properties may be floats, NumPy arrays or CasADi expressions, and the result is the like.

    Raises:
        InputError: not a soil.
        DomainError: a density profile without a compaction front.

    Example:
        >>> import plough_opt as po
        >>> round(po.cone_index(po.named_soil("serozem")))
        261446
    """
    cone = Cone(CONE_HALF_ANGLE, _HEIGHT)
    return soil_reaction(cone, soil).static / (math.pi * (cone.height * cone.slope) ** 2)
