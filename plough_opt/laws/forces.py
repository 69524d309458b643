"""Resistance of the plastic gas to a moving share: equations (24)-(26) with the factor pi only once, and as a law."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plough_opt.core.checks import check_domain, check_single, checked_in_designs, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, column, dot, gauss_legendre, holds_casadi
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.soil.geometry import Cone, Wedge
from plough_opt.soil.plastic import WallPressure, front, wall_pressure
from plough_opt.soil.soil import CONE_HALF_ANGLE, Soil, check_soil

# Height [m] of a penetrometer's standard cone, whose base is 323 mm^2; it matters only with a density profile.
_STANDARD_HEIGHT = math.sqrt(323e-6 / math.pi) / math.tan(CONE_HALF_ANGLE)


@dataclass(frozen=True)
class ResistanceCoefficients:
    """Coefficients of F = pi (1 + mu0 cot(beta)) h^2 (A + B rho0 L'^2 + C rho0 h L''), equation (25).

    Attributes:
        A: static part [Pa].
        B: coefficient of the squared speed [-].
        C: coefficient of the acceleration [-].
    """

    A: Expression
    B: Expression
    C: Expression


@checked_in_designs
def resistance_coefficients(cone: Cone, soil: Soil) -> ResistanceCoefficients:
    """Return A [Pa], B and C of equation (26); C has the factor 2/3 that the integral (24) gives.

    A is multiplied by the soil's measured strength factor.

    They hold for a slender cone (half angle up to some 20 degrees, hypothesis of plane sections) entirely in the soil.

    Args:
        cone: the share's equivalent cone.
        soil: the soil. Numbers in cone and soil may be floats, arrays or CasADi expressions. With a density profile
            arrays are not possible, and the coefficients are quadratures over the cone's height too.

    Raises:
        InputError: cone or soil has the wrong type, or there are arrays beside a density profile.
        DomainError: the density profile has no compaction front.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> round(float(po.resistance_coefficients(cone, soil).A) / 1e3, 1)
        2.8
    """
    p = _mean_wall_pressure(cone, soil)
    slope = cone.slope
    return ResistanceCoefficients(
        A=soil.strength_factor * slope**2 * p.strength, B=slope**4 * p.rate, C=2.0 / 3.0 * slope**4 * p.inertia
    )


def check_cone(cone: Cone, soil: Soil) -> None:
    """Raise InputError if one has the wrong type; for a wedge the message points to its equivalent cone."""
    if not isinstance(cone, Cone):
        remedy = ": use its equivalent_cone()" if isinstance(cone, Wedge) else ""
        raise InputError(f"the cone = {shown(cone)} must be a Cone{remedy}")
    check_soil(soil)


def _mean_wall_pressure(cone: Cone, soil: Soil) -> WallPressure:
    """Return the wall pressure coefficients; with a density profile, their means over the cone's face.

    Strength and rate are weighted with x and the inertia with x^2, as in the integral (24).
    """
    check_cone(cone, soil)
    profile = soil.density_profile
    if profile is None:
        return wall_pressure(soil)
    # The nodes form a column, which would combine element by element with an array.
    check_single("the resistance of a soil with a density profile", (cone, soil))
    nodes, weights = (np.array(values) for values in gauss_legendre(profile.order))
    shares = column(nodes, holds_casadi((cone, soil)))
    p = wall_pressure(soil, cone.height * cone.slope * shares)
    return WallPressure(
        strength=dot(2.0 * weights * nodes, p.strength),
        rate=dot(2.0 * weights * nodes, p.rate),
        inertia=dot(3.0 * weights * nodes**2, p.inertia),
    )


@checked_in_designs
def soil_reaction(cone: Cone, soil: Soil) -> SoilReaction:
    """Return F0 [N], Fd [N s^2/m^2] and the added mass [kg] of equations (25)-(27).

    (1 + mu0 cot(beta)) tan^2(beta) is computed as tan(beta) (tan(beta) + mu0), which is regular for a slender cone.
    Domain, arguments and errors are those of `resistance_coefficients`.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> float(po.soil_reaction(cone, soil).added_mass) > 0.0
        True
    """
    p = _mean_wall_pressure(cone, soil)
    slope = cone.slope
    face = math.pi * cone.height**2 * slope * (slope + soil.tool_friction)
    return SoilReaction(
        static=soil.strength_factor * face * p.strength,
        drag=face * slope**2 * p.rate * soil.density,
        added_mass=face * slope**2 * (2.0 / 3.0) * p.inertia * soil.density * cone.height,
    )


@checked_in_designs
def resistance(cone: Cone, soil: Soil, speed: Expression, acceleration: Expression) -> Expression:
    """Return the total resistance F [N] of equation (25), including friction on the face.

    Args:
        cone: the share's equivalent cone.
        soil: the soil; its ambient pressure matters, although F is the force of the gauge pressure p - p_a.
        speed: speed L' of the share [m/s], at least 0.
        acceleration: acceleration L'' [m/s^2].

    Raises:
        DomainError: the speed is negative, or a number is not finite.
        InputError: as `resistance_coefficients`.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> slow, fast = (po.resistance(cone, soil, speed, 0.0) for speed in (1.0, 2.0))
        >>> bool(fast > slow)
        True
    """
    speed = check_domain("speed", speed, "m/s", at_least=0.0, why="the plastic gas does not follow a retreating share")
    acceleration = check_domain("acceleration", acceleration, "m/s^2")
    return soil_reaction(cone, soil).at(speed, acceleration)


@checked_in_designs
def added_mass(cone: Cone, soil: Soil) -> Expression:
    """Return the mass of soil that accelerates with the share, pi (1 + mu0 cot(beta)) C rho0 h^3 [kg], equation (26).

    Arguments and errors are those of `resistance_coefficients`.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> float(po.added_mass(cone, soil)) > 0.0
        True
    """
    return soil_reaction(cone, soil).added_mass


@checked_in_designs
def loosened_radius(cone: Cone, soil: Soil) -> Expression:
    """Return the radius r* of the compaction front at the base of the cone [m], equation (16).

    For a constant density it is h tan(beta) sqrt(a) with a = 1/(1 - b1).

    Args:
        cone: the share's equivalent cone.
        soil: the soil; only its density ratio or density profile matters. Numbers may be floats, arrays or CasADi
            expressions.

    Raises:
        InputError: cone or soil has the wrong type.
        DomainError: the density profile has no compaction front.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> round(float(po.loosened_radius(cone, soil)), 3) > 0.04
        True
    """
    check_cone(cone, soil)
    return front(cone.height * cone.slope, soil)


def cone_index(soil: Soil) -> Expression:
    """Return the cone index [Pa]: the pressure on the base of a penetrometer's 30 degree cone.

    It is the static part F0/(pi h^2 tan^2 beta) of equation (25) at beta = 15 degrees, which is
    (1 + mu0/tan beta) phi (nu p_a + tau0/(1 + mu)) times the soil's strength factor. At a penetrometer's speed of
    30 mm/s inertia adds a few millionths. For a constant density ratio the cone index does not depend on the cone's
    size; with a density profile it is that of a base of 323 mm^2.

    Laboratory values of cohesion, friction and density ratio often give far too low a level, by up to two orders of
    magnitude in sand; see docs/howto/soils.md, and `Soil.from_cone_index` for adjusting a soil to a reading.

    Args:
        soil: the soil; its properties may be floats, NumPy arrays or CasADi expressions, and the result has their type.

    Raises:
        InputError: the soil has the wrong type.
        DomainError: the density profile has no compaction front.

    Example:
        >>> import plough_opt as po
        >>> round(po.cone_index(po.named_soil("serozem")))
        261446
    """
    cone = Cone(CONE_HALF_ANGLE, _STANDARD_HEIGHT)
    return soil_reaction(cone, soil).static / (math.pi * (cone.height * cone.slope) ** 2)


@dataclass(frozen=True)
class PlasticGas(ResistanceLaw):
    """Soil that yields and is compacted behind a front: F0, Fd, added mass and loosened radius, for any motion.

    Equations (25) to (27) of the source: a resistance F0 + Fd L'^2 + m_a L'' of `soil_reaction`. It holds for a slender
    cone (half angle up to some 20 degrees, hypothesis of plane sections) entirely in the soil, and ignores working
    depth, the free surface and the shank; the level of its draft should be measured. It has no arguments.

    Raises:
        DomainError: by `reaction`: see `soil_reaction`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", medium=po.laws.PlasticGas())
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        2.41
    """

    label = "the plastic gas"
    lacking: ClassVar[Mapping[str, str]] = {}
    slender = True

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N], Fd [N s^2/m^2] and added mass [kg]: `soil_reaction` of the equivalent cone.

        Raises:
            InputError, DomainError: as `soil_reaction`.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.PlasticGas().reaction(at).at(2.0)) / 1e3, 2)
            2.41
        """
        return soil_reaction(at.cone, at.soil)

    def loosened_radius(self, at: ShareInSoil) -> Expression:
        """Return the radius of the compaction front at the base [m]: h tan(beta) sqrt(a), `plough_opt.loosened_radius`.

        Raises:
            InputError, DomainError: as that function.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.PlasticGas().loosened_radius(at)), 3)
            0.107
        """
        return loosened_radius(at.cone, at.soil)

    def warnings(self, at: ShareInSoil) -> tuple[str, ...]:
        """Return warnings about the soil's properties, and about a blunt share.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("60 deg", "45 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> [warning.partition(":")[0] for warning in po.laws.PlasticGas().warnings(at)]
            ["the equivalent cone's half angle is 40.1 deg"]
        """
        return (*at.soil.warnings(), *super().warnings(at))
