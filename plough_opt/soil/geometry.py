"""The wedge-shaped share and the cone of equal height and surface: equations (5)-(7)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from plough_opt.core.domain import check_domain
from plough_opt.core.expressions import Expression, arctan, cos, sqrt, tan
from plough_opt.core.labels import checked_in_designs
from plough_opt.core.quantities import BESIDE, QUANTITIES

PLANE_SECTIONS_LIMIT = math.radians(20.0)
"""Half angle [rad] above which the hypothesis of plane sections is no longer credible."""


def deg(angle: Expression) -> Expression:
    """Return an angle given in degrees in radians [rad].

    Args:
        angle: a float, a NumPy array or a CasADi expression [degrees].

    Raises:
        DomainError: not a number, or one that is not finite.
    """
    check_domain("angle", angle, "degrees")
    return angle * (math.pi / 180.0)


@dataclass(frozen=True)
class Cone:
    """Right circular cone, moving along its axis with its tip ahead.

    Args:
        half_angle: semi-vertex angle beta [rad], between 0 and 90 degrees.
        height: height h [m], above 0.

    Every argument is a float, a NumPy array or a CasADi expression; results are the like.

    Raises:
        DomainError: an angle or height outside its domain.
    """

    half_angle: Expression
    height: Expression

    def __post_init__(self) -> None:
        QUANTITIES["share.half_angle"].check(self.half_angle)
        QUANTITIES["share.height"].check(self.height)

    @property
    @checked_in_designs
    def slope(self) -> Expression:
        """Tangent of the half angle [-]."""
        return tan(self.half_angle)

    @property
    @checked_in_designs
    def area(self) -> Expression:
        """Lateral surface S = pi h^2 tan(beta) / cos(beta) [m^2], equation (6)."""
        return math.pi * self.height**2 * self.slope / cos(self.half_angle)

    @property
    @checked_in_designs
    def volume(self) -> Expression:
        """Volume (pi/3) h^3 tan^2(beta) [m^3]."""
        return math.pi / 3.0 * self.height**3 * self.slope**2

    @checked_in_designs
    def solid_mass(self, density: Expression) -> Expression:
        """Mass [kg] of a solid cone of the given density [kg/m^3]; steel has about 7850."""
        BESIDE["scene.steel_density"].check(density)
        return density * self.volume


@dataclass(frozen=True)
class Wedge:
    """Ploughshare as a sharp wedge with two triangular faces, figure 2a of the source.

    Args:
        angle: wedge angle lambda at the top of the share [rad], between 0 and 90 degrees.
        chisel_angle: angle beta_pl of the chisel point to the base [rad], from 0 to below 90 degrees.
        height: height h of the share [m], above 0.

    Every argument is a float, a NumPy array or a CasADi expression; results are the like.

    Raises:
        DomainError: an angle or height outside its domain.
    """

    angle: Expression
    chisel_angle: Expression
    height: Expression

    def __post_init__(self) -> None:
        QUANTITIES["share.wedge_angle"].check(self.angle)
        QUANTITIES["share.chisel_angle"].check(self.chisel_angle)
        QUANTITIES["share.height"].check(self.height)

    @property
    @checked_in_designs
    def area(self) -> Expression:
        """Surface S = h^2 tan(lambda) / cos^2(beta_pl) [m^2], equation (5)."""
        return self.height**2 * tan(self.angle) / cos(self.chisel_angle) ** 2

    @checked_in_designs
    def equivalent_cone(self) -> Cone:
        """Return the cone of equal height and surface, equation (7).

        The source's sin(beta) = sqrt(p^2 + 1) - p cancels for a slender share and its arcsine rounds
        for a blunt one. With q = 1/p the same angle is tan(beta) = q / sqrt(2 (1 + sqrt(1 + q^2))),
        accurate to rounding at every wedge angle. Only this one angle enters the dynamics: wedge
        angle and chisel angle cannot be told apart by draft or motion.
        """
        q = 2.0 * tan(self.angle) / (math.pi * cos(self.chisel_angle) ** 2)
        slope = q / sqrt(2.0 * (1.0 + sqrt(1.0 + q**2)))
        return Cone(half_angle=arctan(slope), height=self.height)
