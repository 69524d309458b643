"""Other laws for the equivalent cone: the linear elastic medium, and the spherical cavity after Forrestal and Luk."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import Expression, cos, expm1_ratio, log, sin, sqrt
from plough_opt.laws.forces import check_cone
from plough_opt.laws.law import STEADY, ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.soil.elastic import cone_force
from plough_opt.soil.soil import Soil, check_soil


@dataclass(frozen=True)
class ElasticMedium(ResistanceLaw):
    """Linear elastic soil around the equivalent cone: `po.elastic.cone_force`, an order of magnitude.

    It holds below the shear wave speed, for soil with Young's modulus and Poisson's ratio, and gives the contact force
    of steady sliding: a scene must have ``Effects(motion=False)``. Strains on the face of a cone are of order one, so
    neither the force nor its dependence on the speed is reliable. Its equations are those of a slender body in a
    linear elastic medium. It has no arguments.

    Raises:
        DomainError: by `reaction`: the soil has no elastic constants, or the speed reaches that of shear waves.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
        >>> still = po.Effects(motion=False)
        >>> law = po.laws.ElasticMedium()
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", still, medium=law)
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        146.32
    """

    label = "the elastic medium"
    standing = "an order of magnitude: strains on its face are of order one, and its rise with speed is not reliable"
    lacking: ClassVar[Mapping[str, str]] = STEADY | {
        "strength_wave": "has no strength and is solved for steady sliding only",
        "added_mass": "carries no soil along",
        "loosened_radius": "has no compaction front and loosens nothing",
        "cone_index": "has no strength",
        "entry": "is solved for steady sliding only",
        "uncertain": "has no strength",
        # The force follows from the gauge pressure; ambient pressure only maintains contact.
        "ambient_pressure": "is computed in gauge pressure",
    }
    scalar = False
    slender = True

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return the contact force at the tow speed as F0 [N].

        Raises:
            DomainError: as `po.elastic.cone_force`.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.ElasticMedium().reaction(at).static) / 1e3, 1)
            146.3
        """
        return SoilReaction(static=cone_force(at.cone, at.soil, at.speed))


@dataclass(frozen=True)
class SphericalCavity(ResistanceLaw):
    """Pressure on a spherical cavity that grows behind a compaction front: F0 and Fd of the equivalent cone.

    F = pi R^2 (tau0 A + B rho0 (V sin beta)^2)(1 + mu0 cot beta), R = h tan(beta): the face pushes the soil at
    V sin(beta) along its normal, as in penetration mechanics. After Forrestal and Luk, Int. J. Impact Engineering 12
    (1992) 427-444, derived anew in that form. It was made for projectiles; no test against tillage is known. It holds
    while elastic strains at the front stay below 5 % and the front is slower than elastic waves, ignores working depth,
    the free surface and the shank, and has no added mass and loosened radius. It has no arguments.

    Raises:
        DomainError: by `reaction`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", medium=po.laws.SphericalCavity())
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        8.4
    """

    label = "the spherical cavity (Forrestal-Luk)"
    source = "M. J. Forrestal and V. K. Luk, Int. J. Impact Engineering 12 (1992) 427-444"
    standing = "derived anew in that form; made for projectiles, no test against tillage known"
    lacking: ClassVar[Mapping[str, str]] = {
        name: why for name, why in ResistanceLaw.lacking.items() if name not in ("entry", "ambient_pressure")
    }

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2], of the gauge pressure, which depends on the soil's ambient pressure.

        Raises:
            DomainError: the speed is negative, elastic strains are large, or the front is as fast as elastic waves,
                sqrt(E/rho0).

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.SphericalCavity().reaction(at).static) / 1e3, 2)
            8.39
        """
        cone, soil = at.cone, at.soil
        check_cone(cone, soil)
        check_domain("speed", at.speed, "m/s", at_least=0.0)
        cavity, along = spherical_cavity(soil), sin(cone.half_angle)
        if soil.youngs_modulus is not None:
            check_domain(
                "speed of the compaction front over sqrt(E/rho0)",
                cavity.front_speed * at.speed * along / sqrt(soil.youngs_modulus / soil.density),
                below=1.0,
                why="elastic waves must run ahead of the front",
            )
        face = math.pi * cone.height**2 * cone.slope * (cone.slope + soil.tool_friction)
        return SoilReaction(static=face * cavity.static, drag=face * cavity.inertia * soil.density * along**2)


@dataclass(frozen=True)
class CavityPressure:
    """Gauge pressure sigma - p_a = static + inertia rho0 V^2 on the wall of a cavity whose radius grows at speed V.

    Attributes:
        static: tau0 A [Pa].
        inertia: B [-].
        front_speed: speed of the compaction front relative to the undisturbed soil, over V [-].
    """

    static: Expression
    inertia: Expression
    front_speed: Expression


def spherical_cavity(soil: Soil) -> CavityPressure:
    """Return the pressure coefficients of a spherical cavity that grows steadily from radius 0.

    Behind the front the soil locks at rho1 and satisfies sigma_r - sigma_t = lambda p + tau0, with the Mohr-Coulomb
    values lambda = 6 sin(theta)/(3 - sin(theta)) and tau0 = 6 k cos(theta)/(3 - sin(theta)) + lambda p_a. Ahead of the
    front it is incompressible: elastic if Young's modulus is given, else rigid. With alpha = 3 lambda/(3 + 2 lambda),
    e = tau0/2E (0 if rigid), eta = 1 - b1, g^3 = (1 + e)^3 - 1 + eta, x = (1 + e)/g and I(c) = (x^c - 1)/c,

        static  = 6 tau0/(3 + 2 lambda) I(2 alpha) + [elastic] 2 tau0/3 x^(2 alpha)
        inertia = x^(2 alpha) [g/(1 + e)^2 + 3 e/g^2] + 2/b1 [I(2 alpha - 1) - I(2 alpha - 4)].

    Source: the form of Forrestal and Luk 1992, derived anew; terms of the order of eta tau0/E differ from theirs.

    Raises:
        DomainError: tau0/2E exceeds 0.05, so that strains are not small.
    """
    check_soil(soil)
    s, eta = sin(soil.friction_angle), 1.0 - soil.density_ratio
    slope = 6.0 * s / (3.0 - s)
    tau = 6.0 * soil.cohesion * cos(soil.friction_angle) / (3.0 - s) + slope * soil.ambient_pressure
    alpha = 3.0 * slope / (3.0 + 2.0 * slope)
    strain: Expression = 0.0
    ahead: Expression = 0.0
    if soil.youngs_modulus is not None:
        strain, ahead = tau / (2.0 * soil.youngs_modulus), 2.0 / 3.0 * tau
        check_domain("strain tau0/2E at the front", strain, at_most=0.05, why="the soil ahead is linear elastic")
    cube = strain * (3.0 + strain * (3.0 + strain)) + eta  # (1 + strain)^3 - 1 + eta
    g = cube ** (1.0 / 3.0)
    x = (1.0 + strain) / g
    grown = x ** (2.0 * alpha)
    # Momentum balance across the front, and inertia of the elastic soil ahead of it.
    jump = g / (1.0 + strain) ** 2 + 3.0 * strain / g**2
    behind = 2.0 / soil.density_ratio * (_power(x, 2.0 * alpha - 1.0) - _power(x, 2.0 * alpha - 4.0))
    return CavityPressure(
        static=ahead * grown + tau * 6.0 / (3.0 + 2.0 * slope) * _power(x, 2.0 * alpha),
        inertia=grown * jump + behind,
        front_speed=1.0 / g,
    )


def _power(x: Expression, q: Expression) -> Expression:
    """Return (x^q - 1)/q, which is log(x) at q = 0."""
    length = log(x)
    return length * expm1_ratio(q * length)
