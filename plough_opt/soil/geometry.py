"""The wedge-shaped share and the cone of equal height and surface: equations (5)-(7)."""

import math
from dataclasses import dataclass

from plough_opt.core.checks import check_domain, plain_number
from plough_opt.core.expressions import Expression, arctan, cos, sqrt, tan
from plough_opt.core.labels import checked_in_designs
from plough_opt.core.quantities import BESIDE, read_fields
from plough_opt.soil.solid import SEGMENTS, Solid, cone_solid, own_opening, share_solid

PLANE_SECTIONS_LIMIT = math.radians(20.0)
"""Half angle [rad] above which the hypothesis of plane sections does not hold."""


def deg(angle: Expression) -> Expression:
    """Return an angle in radians [rad], given in degrees.

    Args:
        angle: a float, a NumPy array or a CasADi expression [degrees].

    Raises:
        DomainError: the angle is not a finite number.

    Example:
        >>> import plough_opt as po
        >>> round(po.deg(180.0), 6)
        3.141593
    """
    found: Expression = check_domain("angle", angle, "degrees") * (math.pi / 180.0)
    return found


@dataclass(frozen=True)
class Cone:
    """A right circular cone that moves along its axis, tip first.

    Args:
        half_angle: semi-vertex angle beta [rad], between 0 and 90 degrees.
        height: height h [m], above 0.

    Every argument is a float, a NumPy array or a CasADi expression; results have the same type.

    Raises:
        DomainError: the angle or the height lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> round(float(po.Cone("10 deg", "25 cm").volume), 6)
        0.000509
    """

    half_angle: Expression
    height: Expression

    def __post_init__(self) -> None:
        read_fields(self, half_angle="share.half_angle", height="share.height")

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
        """Return the mass [kg] of a solid cone with the given density [kg/m^3], about 7850 for steel."""
        return BESIDE["scene.steel_density"].read(density, stacklevel=3) * self.volume

    def mesh(self, *, segments: int = SEGMENTS) -> Solid:
        """Return the cone as a closed solid [m]: a pyramid whose base is a polygon inscribed in the cone's base.

        Args:
            segments: sides of the polygon. Area, half angle and volume are smaller than the cone's by a fraction of at
                most about 2/3 (pi/segments)^2, which is 4e-7 by default and 1e-9 with 100,000 sides.

        Raises:
            InputError: the cone holds symbols, or the number of sides is invalid.

        Example:
            >>> cone = Cone(half_angle=deg(14), height=0.25)
            >>> round(float(cone.mesh().volume / cone.volume), 5)
            1.0
        """
        half_angle, height = _numbers(self, "half_angle", "height")
        return cone_solid(height * math.tan(half_angle), height, segments)


@dataclass(frozen=True)
class Wedge:
    """A ploughshare: a sharp wedge with two triangular faces, figure 2a of the source.

    Args:
        angle: wedge angle lambda at the top of the share [rad], between 0 and 90 degrees.
        chisel_angle: angle beta_pl of the chisel point to the base [rad], from 0 to below 90 degrees.
        height: height h of the share [m], above 0.

    Every argument is a float, a NumPy array or a CasADi expression; results have the same type.

    Raises:
        DomainError: an angle or the height lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge(angle="30 deg", chisel_angle="15 deg", height="25 cm")
        >>> share.equivalent_cone().height
        0.25
    """

    angle: Expression
    chisel_angle: Expression
    height: Expression

    def __post_init__(self) -> None:
        read_fields(self, angle="share.wedge_angle", chisel_angle="share.chisel_angle", height="share.height")

    @property
    @checked_in_designs
    def area(self) -> Expression:
        """Surface S = h^2 tan(lambda) / cos^2(beta_pl) [m^2], equation (5)."""
        return self.height**2 * tan(self.angle) / cos(self.chisel_angle) ** 2

    @checked_in_designs
    def equivalent_cone(self) -> Cone:
        """Return the cone of equal height and surface, equation (7).

        The source's sin(beta) = sqrt(p^2 + 1) - p cancels for a slender share, and its arcsine is inaccurate for a
        blunt one. With q = 1/p the same angle is given by tan(beta) = q / sqrt(2 (1 + sqrt(1 + q^2))), accurate to
        rounding at every wedge angle. Wedge angle and chisel angle affect draft and motion only through this one angle.
        """
        q = 2.0 * tan(self.angle) / (math.pi * cos(self.chisel_angle) ** 2)
        slope = q / sqrt(2.0 * (1.0 + sqrt(1.0 + q**2)))
        return Cone(half_angle=arctan(slope), height=self.height)

    def mesh(self, *, opening: float | None = None, thickness: float | None = None) -> Solid:
        """Return the share as a closed solid [m]: a block, or a bent plate.

        Equation (5) determines the two faces: right triangles with the angle lambda at the tip, which meet along a
        ridge of length h / cos(beta_pl) that rises at the angle beta_pl from the direction of travel. The angle between
        the faces and the shape behind them are free.

        Args:
            opening: interior angle between the two faces [rad], between 0 and 180 degrees. Default: the angle at which
                the block has the volume of the equivalent cone, and so the mass that `Cone.solid_mass` returns; 90
                degrees if the block is smaller than the cone at every angle.
            thickness: thickness of the plate [m], measured inwards from the faces. Default: a solid block.

        Raises:
            InputError: the share holds symbols, or the plate is so thick that its inner faces vanish.
            DomainError: the opening or the thickness lies outside its domain.

        Example:
            >>> share = Wedge(angle=deg(37), chisel_angle=deg(15), height=0.25)
            >>> block = share.mesh()
            >>> round(float(block.working_area / share.area), 9)
            1.0
        """
        angle, chisel_angle, height = _numbers(self, "angle", "chisel_angle", "height")
        own = self.opening if opening is None else plain_number("opening", opening)
        plate = None if thickness is None else plain_number("thickness", thickness)
        return share_solid(angle, chisel_angle, height, own, plate)

    @property
    def opening(self) -> float:
        """Default angle between the faces in `mesh` [rad]; only for a numeric share."""
        angle, chisel_angle, _ = _numbers(self, "angle", "chisel_angle", "height")
        return own_opening(angle, chisel_angle, float(self.equivalent_cone().slope))


def _numbers(share: Cone | Wedge, *names: str) -> list[float]:
    """Return attributes of a share as floats.

    Raises:
        InputError: an attribute is a symbol, or an array of several values.
    """
    return [plain_number(f"{name.replace('_', ' ')} of a body", getattr(share, name)) for name in names]
