"""The share as a part for a workshop: STL, DXF and STEP, each written by a library for the format."""

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from plough_opt.core.checks import check_kind, path_of
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file, write_file
from plough_opt.core.process import optional
from plough_opt.soil.geometry import Cone, Solid, Wedge

# Millimetres in a metre.
_MM: Final = 1e3
# Layer of a cutting pattern -> its line type and colour: 7 is black or white, 5 blue, 8 grey.
_LAYERS: Final = {"CUT": ("CONTINUOUS", 7), "BEND": ("DASHED", 5), "NOTES": ("CONTINUOUS", 8)}
# Height of the letters in notes, relative to the length of the part.
_LETTER_HEIGHT: Final = 0.03


@dataclass(frozen=True)
class _Part:
    """A numeric share with its body; opening [rad] and plate thickness [m] of a wedge."""

    share: Wedge | Cone
    body: Solid
    opening: float
    thickness: float | None


def write_part(
    share: Wedge | Cone, path: str | Path, *, opening: float | None = None, thickness: float | None = None
) -> Path:
    """Write a numeric share as a part for a workshop; the file's ending determines the format.

    * ``.stl``: triangles in millimetres, for printing and milling (trimesh).
    * ``.dxf``: a cutting pattern, the outer faces laid flat in millimetres without bend allowance: both faces of a
      wedge with the bending line, or the sector that rolls up into a cone (ezdxf).
    * ``.step``, ``.stp``: exact faces in millimetres, for CAD (build123d).

    Args:
        share: a wedge or a cone.
        path: path of the file; an existing file is replaced.
        opening: angle between a wedge's faces [rad], see `Wedge.mesh`.
        thickness: thickness of its plate [m].

    Returns:
        The path.

    Raises:
        InputError: another ending, a symbolic share, a library that is not installed, an option that a cone does not
            have, or a path that cannot be written.
        DomainError: as `Wedge.mesh`.

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_part(share, f"{folder}/share.stl")
        >>> path.name
        'share.stl'
    """
    check_kind("the share", share, Wedge | Cone, "a Wedge or a Cone")
    needs, write = _WRITERS[check_file(path_of("the part", path), "part", *_WRITERS).suffix.lower()]
    library = optional(needs)
    if isinstance(share, Wedge):
        body = share.mesh(opening=opening, thickness=thickness)
        part = _Part(share, body, share.opening if opening is None else opening, thickness)
    elif opening is None and thickness is None:
        part = _Part(share, share.mesh(), 0.0, None)
    else:
        raise InputError("opening and thickness belong to a wedge: leave them out for a cone, which is solid")
    return write_file(path, "part", write(library, part))


def _stl(trimesh: Any, part: _Part) -> bytes:
    body = trimesh.Trimesh(_MM * part.body.vertices, part.body.triangles, process=False)
    return bytes(body.export(file_type="stl"))


def _dxf(ezdxf: Any, part: _Part) -> str:
    drawing = ezdxf.new("R2010", setup=True, units=ezdxf.units.MM)
    for name, (line, colour) in _LAYERS.items():
        drawing.layers.add(name, linetype=line, color=colour)
    page = drawing.modelspace()
    if isinstance(part.share, Wedge):
        length, depth, notes = _wedge_pattern(page, part.share, part.opening, part.thickness)
    else:
        length, depth, notes = _cone_pattern(page, part.share)
    letters = _LETTER_HEIGHT * length
    for k, note in enumerate(notes):
        text = page.add_text(note, height=letters, dxfattribs={"layer": "NOTES"})
        text.set_placement((0.0, -depth - (2.0 + 1.6 * k) * letters))
    written = io.StringIO()
    drawing.write(written)
    return written.getvalue()


def _wedge_pattern(page: Any, share: Wedge, opening: float, thickness: float | None) -> tuple[float, float, list[str]]:
    """Draw both faces of a wedge, joined along the ridge; return length and half width [mm], and notes."""
    ridge = _MM * float(share.height) / math.cos(share.chisel_angle)
    width = ridge * math.tan(share.angle)
    page.add_lwpolyline([(0.0, 0.0), (ridge, -width), (ridge, width)], close=True, dxfattribs={"layer": "CUT"})
    page.add_line((0.0, 0.0), (ridge, 0.0), dxfattribs={"layer": "BEND"})
    plate = "a block: faces only" if thickness is None else f"plate {_MM * thickness:g} mm"
    notes = [
        f"Outer faces of the share, {plate}; all lengths in mm",
        f"Bend by {180.0 - math.degrees(opening):.2f} deg along the dashed ridge; no bend allowance",
    ]
    return ridge, width, notes


def _cone_pattern(page: Any, cone: Cone) -> tuple[float, float, list[str]]:
    """Draw the sector that rolls up into a cone; return length and half width [mm], and notes."""
    slant, half = _MM * float(cone.height) / math.cos(cone.half_angle), math.pi * math.sin(cone.half_angle)
    x, y = slant * math.cos(half), slant * math.sin(half)
    # DXF describes an arc by its bulge: the tangent of a quarter of the arc's angle.
    corners = [(0.0, 0.0, 0.0), (x, -y, math.tan(half / 2.0)), (x, y, 0.0)]
    page.add_lwpolyline(corners, format="xyb", close=True, dxfattribs={"layer": "CUT"})
    notes = [f"Lateral surface of the cone, half angle {math.degrees(cone.half_angle):.3f} deg; all lengths in mm"]
    return slant, slant * math.sin(min(half, math.pi / 2.0)), notes


def _step(cad: Any, part: _Part) -> bytes:
    if isinstance(part.share, Cone):
        height = _MM * part.share.height
        solid = cad.Solid.make_cone(0.0, height * math.tan(part.share.half_angle), height, plane=cad.Plane.YZ)
    else:
        corners = [cad.Vector(*place) for place in _MM * part.body.vertices]
        wires = [cad.Wire.make_polygon([corners[k] for k in polygon]) for polygon in part.body.polygons]
        solid = cad.Solid(cad.Shell([cad.Face(wire) for wire in wires]))
    solid.label = "share"
    written = io.BytesIO()
    cad.export_step(solid, written)
    return written.getvalue()


_WRITERS: Final[dict[str, tuple[str, Callable[[Any, _Part], str | bytes]]]] = {
    ".stl": ("trimesh", _stl),
    ".dxf": ("ezdxf", _dxf),
    ".step": ("build123d", _step),
    ".stp": ("build123d", _step),
}
"""Ending of a file's name -> the library for it, and a function of both that returns the file's content for a part."""
