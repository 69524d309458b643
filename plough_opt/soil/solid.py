"""Closed solids with flat faces: the wedge-shaped share as a block or bent plate, and the circular cone."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count

SEGMENTS = 4096
"""Sides of the polygon that replaces a cone's base; area, angle and volume are then within 4e-7 of the cone's."""

_LEAST_SEGMENTS = 3
# Up to this number of sides a mesh takes less than a gigabyte.
_MOST_SEGMENTS = 1_000_000


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


def own_opening(angle: float, chisel_angle: float, slope: float) -> float:
    """Return the angle between a share's faces at which the block has the volume of its equivalent cone [rad].

    The block's volume is e w^2 sin(opening) / 6 with e = h / cos(beta_pl) and w = e tan(lambda); the cone's is
    pi h^3 tan^2(beta) / 3. If the block is smaller at every angle, as for chisel angles above some 50 degrees, the
    result is a right angle, at which it is largest.

    Args:
        angle: wedge angle lambda [rad].
        chisel_angle: beta_pl [rad].
        slope: tan(beta) of the equivalent cone [-].
    """
    ratio = 2.0 * math.pi * math.cos(chisel_angle) ** 3 * (slope / math.tan(angle)) ** 2
    return math.asin(min(1.0, ratio))


def share_solid(angle: float, chisel_angle: float, height: float, opening: float, thickness: float | None) -> Solid:
    """Return a wedge-shaped share: see `plough_opt.Wedge.mesh`."""
    check_domain("opening between the faces", opening, "rad", above=0.0, below=math.pi)
    ridge = height / math.cos(chisel_angle)
    width, half = ridge * math.tan(angle), opening / 2.0
    along = np.array([math.cos(chisel_angle), 0.0, math.sin(chisel_angle)])
    down = np.array([math.sin(chisel_angle), 0.0, -math.cos(chisel_angle)])

    def places(u: float, v: float, depth: float) -> list[NDArray[np.float64]]:
        """Return a point for each of the two faces, u along the ridge, v across the face and a depth below it."""
        side, below = v * math.sin(half) - depth * math.cos(half), v * math.cos(half) + depth * math.sin(half)
        return [u * along + below * down + np.array([0.0, sign * side, 0.0]) for sign in (1.0, -1.0)]

    outer = [0.0 * along, ridge * along, *places(ridge, width, 0.0)]
    if thickness is None:
        return Solid(np.array(outer), ((0, 1, 2), (0, 3, 1), (1, 3, 2), (0, 2, 3)), working=2)
    # Distance from the ridge, along a face, at which the inner faces of the plates meet.
    mitre = thickness / math.tan(half)
    check_domain("thickness of the plate", thickness, "m", above=0.0)
    if mitre >= width:
        raise InputError(
            f"the thickness of the plate, {thickness:g} m, leaves nothing of the faces' inside: use less than"
            f" {width * math.tan(half):.4g} m, or a larger opening"
        )
    inner = [places(u, mitre, thickness)[0] for u in (mitre / math.tan(angle), ridge)]
    vertices = np.array([*outer, *inner, *places(ridge, width, thickness)])
    # Corners: tip 0 and end 1 of the ridge, outer corners 2 and 3; 4 to 7 are the corresponding inner corners.
    edges = ((0, 1, 2), (0, 3, 1), (4, 6, 5), (4, 5, 7), (0, 2, 6, 4), (0, 4, 7, 3), (1, 3, 7, 5, 6, 2))
    return Solid(vertices, edges, working=2)


def cone_solid(radius: float, height: float, segments: int) -> Solid:
    """Return a cone as a pyramid: see `plough_opt.Cone.mesh`."""
    if not is_count(segments) or not _LEAST_SEGMENTS <= segments <= _MOST_SEGMENTS:
        raise InputError(f"segments = {segments!r} must be a whole number from {_LEAST_SEGMENTS} to {_MOST_SEGMENTS:,}")
    turn = 2.0 * math.pi * np.arange(segments) / segments
    rim = np.column_stack([np.full(segments, height), radius * np.cos(turn), radius * np.sin(turn)])
    vertices = np.vstack([[0.0, 0.0, 0.0], rim, [height, 0.0, 0.0]])
    neighbours = [(k + 1, (k + 1) % segments + 1) for k in range(segments)]
    side = tuple((0, second, first) for first, second in neighbours)
    base = tuple((segments + 1, first, second) for first, second in neighbours)
    return Solid(vertices, (*side, *base), working=segments)
