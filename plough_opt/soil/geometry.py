"""Geometry of the share: a wedge, its equivalent cone, and their bodies as polygons."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain, checked_in_designs, plain_number, whole_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, arctan, cos, sqrt, tan
from plough_opt.core.quantities import BESIDE, read_fields

SEGMENTS = 4096
"""Sides of the polygon that replaces a cone's base; area, angle and volume are then within 4e-7 of the cone's."""
PLANE_SECTIONS_LIMIT = math.radians(20.0)
"""Half angle [rad] above which the hypothesis of plane sections does not hold."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed solid bounded by flat polygons, counter-clockwise as seen from outside.

    The origin is the share's tip; x points backwards along its height, y sideways, z up; lengths are in metres.

    Attributes:
        vertices: corners [m], shape (n, 3).
        polygons: indices of each face's corners; a face is star-shaped about its first corner.
        working: number of polygons, counted from the first, that are faces of the share in the model.
    """

    vertices: NDArray[np.float64]
    polygons: tuple[tuple[int, ...], ...]
    working: int

    @cached_property
    def triangles(self) -> NDArray[np.int64]:
        """Indices of the corners of triangles that cover the faces, shape (m, 3)."""
        return np.array([(p[0], b, c) for p in self.polygons for b, c in pairwise(p[1:])])

    @property
    def working_area(self) -> float:
        """Area of the faces of the share in the model [m^2]: equation (5) for a wedge, (6) for a cone."""
        count = sum(len(polygon) - 2 for polygon in self.polygons[: self.working])
        return float(np.sum(np.linalg.norm(self._normals[:count], axis=1)) / 2.0)

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        a = self.vertices[self.triangles[:, 0]]
        return float(np.sum(a * self._normals) / 6.0)

    @property
    def _normals(self) -> NDArray[np.float64]:
        """Normals of the triangles, with a length of twice their area."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return np.cross(b - a, c - a)


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
        """Return the mass [kg] of a solid cone with the given density [kg/m^3], about 7850 for steel.

        Example:
            >>> import plough_opt as po
            >>> round(float(po.Cone("10 deg", "25 cm").solid_mass(7850.0)), 2)
            3.99
        """
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
        whole_number("segments", segments, 3, 1_000_000)  # which take a gigabyte
        radius, turn = height * math.tan(half_angle), 2.0 * math.pi * np.arange(segments) / segments
        rim = np.column_stack([np.full(segments, height), radius * np.cos(turn), radius * np.sin(turn)])
        vertices = np.vstack([[0.0, 0.0, 0.0], rim, [height, 0.0, 0.0]])
        neighbours = [(k + 1, (k + 1) % segments + 1) for k in range(segments)]
        side = tuple((0, second, first) for first, second in neighbours)
        base = tuple((segments + 1, first, second) for first, second in neighbours)
        return Solid(vertices, (*side, *base), working=segments)


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

        Example:
            >>> import math
            >>> import plough_opt as po
            >>> cone = po.Wedge("30 deg", "15 deg", "25 cm").equivalent_cone()
            >>> round(math.degrees(cone.half_angle), 3)
            10.945
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
        opening = self.opening if opening is None else plain_number("opening", opening)
        check_domain("opening between the faces", opening, "rad", above=0.0, below=math.pi)
        ridge, half = height / math.cos(chisel_angle), opening / 2.0
        width = ridge * math.tan(angle)
        along = np.array([math.cos(chisel_angle), 0.0, math.sin(chisel_angle)])
        down = np.array([math.sin(chisel_angle), 0.0, -math.cos(chisel_angle)])

        def places(u: float, v: float, depth: float) -> list[NDArray[np.float64]]:
            """Return a point for each of the two faces, u along the ridge, v across the face and a depth below it."""
            side, below = v * math.sin(half) - depth * math.cos(half), v * math.cos(half) + depth * math.sin(half)
            return [u * along + below * down + np.array([0.0, sign * side, 0.0]) for sign in (1.0, -1.0)]

        outer = [0.0 * along, ridge * along, *places(ridge, width, 0.0)]
        if thickness is None:
            return Solid(np.array(outer), ((0, 1, 2), (0, 3, 1), (1, 3, 2), (0, 2, 3)), working=2)
        thickness = plain_number("thickness", thickness)
        # Distance from the ridge, along a face, at which the inner faces of the plates meet.
        mitre = thickness / math.tan(half)
        check_domain("thickness of the plate", thickness, "m", above=0.0)
        if mitre >= width:
            most = f"{width * math.tan(half):.4g} m"
            raise InputError(f"thickness = {thickness:g} m leaves nothing of the faces' inside: use less than {most}")
        inner = [places(u, mitre, thickness)[0] for u in (mitre / math.tan(angle), ridge)]
        vertices = np.array([*outer, *inner, *places(ridge, width, thickness)])
        # Corners: tip 0 and end 1 of the ridge, outer corners 2 and 3; 4 to 7 are the corresponding inner corners.
        edges = ((0, 1, 2), (0, 3, 1), (4, 6, 5), (4, 5, 7), (0, 2, 6, 4), (0, 4, 7, 3), (1, 3, 7, 5, 6, 2))
        return Solid(vertices, edges, working=2)

    @property
    def opening(self) -> float:
        """Default angle between the faces in `mesh` [rad]; only for a numeric share.

        The block's volume is e w^2 sin(opening) / 6 with e = h / cos(beta_pl) and w = e tan(lambda); the cone's is
        pi h^3 tan^2(beta) / 3. If the block is smaller at every angle, as for chisel angles above some 50 degrees, it
        is a right angle, at which the block is largest.
        """
        angle, chisel_angle, _ = _numbers(self, "angle", "chisel_angle", "height")
        slope = float(self.equivalent_cone().slope) / math.tan(angle)
        return math.asin(min(1.0, 2.0 * math.pi * math.cos(chisel_angle) ** 3 * slope**2))


def _numbers(share: Cone | Wedge, *names: str) -> list[float]:
    """Return attributes of a share as floats.

    Raises:
        InputError: an attribute is a symbol, or an array of several values.
    """
    return [plain_number(f"{name.replace('_', ' ')} of a body", getattr(share, name)) for name in names]
