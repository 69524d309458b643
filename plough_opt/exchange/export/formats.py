"""The export formats by name, each with its options and the function that writes it.

The modules that write are imported on use: the list alone is needed for help and completion.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file, check_new_folder
from plough_opt.core.process import optional

if TYPE_CHECKING:
    from plough_opt.exchange.component import Component
    from plough_opt.motion.scene import Scene
    from plough_opt.soil.geometry import Cone, Wedge


@dataclass(frozen=True)
class Request:
    """The arguments of an export.

    Attributes:
        path: path of the file or folder.
        name: name of the function or model.
        component: builds the component of the requested inputs and outputs.
        scene: the scene at the file's values, with variables at their guesses.
        best: searches for the best design and returns its scene; None to export the scene as it is.
        design: which design this is, such as "the best design".
        steel_density: density of the share's material [kg/m^3].
        duration: duration of a run [s]; None for a periodic orbit.
        options: given options of the format by name; quantities in SI units.
    """

    path: str
    name: str
    component: Callable[[], Component]
    scene: Scene
    best: Callable[[], Scene] | None
    design: str
    steel_density: float
    duration: float | None
    options: Mapping[str, Any]


@dataclass(frozen=True)
class Format:
    """An export format.

    Args:
        what: what is written, such as "a new folder with C source", or the kind of file.
        write: writes it; returns a description of the content, and how to use it, each may be "".
        endings: possible endings of the file's name, such as (".fmu",); () for a new folder.
        options: names of its options beside the path: see `plough-opt export --help`.
        needs: module of an optional library that it needs, or "".
    """

    what: str
    write: Callable[[Request], tuple[str, str]]
    endings: tuple[str, ...] = ()
    options: tuple[str, ...] = ("inputs", "outputs", "name")
    needs: str = ""

    def check(self, path: str) -> None:
        """Raise InputError for a path that cannot be written, or a missing library, before anything is computed.

        Raises:
            InputError: the folder exists already, the file's name has another ending, or the library is not installed.
        """
        if self.needs:
            optional(self.needs)
        if self.endings:
            check_file(path, self.what, *self.endings)
        else:
            check_new_folder(path, self.what.removeprefix("a new folder with ").removeprefix("a "))

    def __str__(self) -> str:
        """Return what is written, and the endings of the file's name."""
        return f"{self.what}{', ' if self.endings else ''}{' or '.join(self.endings)}"


def _of_component(writer: str, hint: Callable[[Path, str], str]) -> Callable[[Request], tuple[str, str]]:
    """Return what writes a component.

    Args:
        writer: the function that does it, as "module:name".
        hint: path and name of the component -> how to use it.
    """

    def write(request: Request) -> tuple[str, str]:
        component, more = request.component(), request.options.get("description")
        write_it = resolve_name(f"plough_opt.exchange.export.{writer}")
        path = write_it(component, request.path, *([more] if more else []))
        return str(component), hint(path, component.name())

    return write


def _load(path: Path, _: str) -> str:
    code = shlex.quote(f"import casadi; print(casadi.Function.load({path.as_posix()!r}))")
    return f"python -c {code}  # loading such a file can run code: load only files that you trust"


def _fmu(request: Request) -> tuple[str, str]:
    from plough_opt.exchange.export.fmu import write_fmu

    given: dict[str, Any] = {name: getattr(request, name) for name in ("steel_density", "duration", "name")}
    binary = not request.options.get("sources")
    write_fmu(request.scene, request.path, strut=request.options.get("strut") or "speed", binary=binary, **given)
    return "", f"fmpy simulate {shlex.quote(request.path)} --show-plot"


def _part(request: Request) -> tuple[str, str]:
    from plough_opt.exchange.export.part import write_part

    bent = {name: request.options.get(name) for name in ("opening", "thickness")}
    cone = request.options.get("body") == "cone"
    if cone and any(bent.values()):
        raise InputError("--opening and --thickness belong to a wedge: leave them out for a cone, which is solid")
    scene = request.scene if request.best is None else request.best()
    body: Wedge | Cone = scene.cone if cone else scene.share
    write_part(body, request.path, **bent)
    return _described(body, **bent, design=request.design), ""


def _described(body: Wedge | Cone, opening: float | None, thickness: float | None, design: str) -> str:
    """Return the measures of a part in words."""
    from plough_opt.soil.geometry import Cone

    size = f"height {1e3 * body.height:.4g} mm"
    if isinstance(body, Cone):
        what = f"Cone of {design}: half angle {math.degrees(body.half_angle):.4g} deg, {size}, solid"
        solid = body.mesh()
    else:
        solid = body.mesh(opening=opening, thickness=thickness)
        angles = (body.angle, body.chisel_angle, body.opening if opening is None else opening)
        wedge, chisel, between = (f"{math.degrees(angle):.4g} deg" for angle in angles)
        kind = "a block" if thickness is None else f"plate of {1e3 * thickness:.4g} mm"
        faces = f"wedge angle {wedge}, chisel angle {chisel}, {size}, {between} between the faces"
        what = f"Share of {design}: {faces}, {kind}"
    return f"{what}, {1e6 * solid.volume:.4g} cm^3, faces {1e4 * solid.working_area:.4g} cm^2"


_PART_OPTIONS = ("opening", "thickness", "body", "at")
_MODULE = "in node or a page: import {{ evaluate }} from './{}'; evaluate({{}}) has the results".format
_CLASS = "{}.py holds an openmdao.api.ExplicitComponent; add_design declares variables and constraints".format

FORMATS: Final[dict[str, Format]] = {
    "c": Format(
        "a new folder with C source, header and a test",
        _of_component("c:write_c", lambda path, _: f"make -C {shlex.quote(str(path))}"),
    ),
    "casadi": Format(
        "serialised CasADi Function",
        _of_component("c:write_casadi", _load),
        (".casadi",),
        ("inputs", "outputs", "name", "description"),
    ),
    "javascript": Format(
        "ES module for web pages and node",
        _of_component("javascript:write_javascript", lambda path, _: _MODULE(path.name)),
        (".mjs", ".js"),
    ),
    "openmdao": Format(
        "a new folder with a Python module",
        _of_component("openmdao:write_openmdao", lambda path, name: _CLASS(path / name)),
        needs="openmdao.api",
    ),
    "fmu": Format("FMU for model exchange, FMI 3.0", _fmu, (".fmu",), ("name", "strut", "sources")),
    "stl": Format("triangles of the share in mm", _part, (".stl",), _PART_OPTIONS, "trimesh"),
    "dxf": Format("the share's faces laid flat in mm, a cutting pattern", _part, (".dxf",), _PART_OPTIONS, "ezdxf"),
    "step": Format("the share's faces in mm for CAD", _part, (".step", ".stp"), _PART_OPTIONS, "build123d"),
}
"""Name of a format in `plough-opt export --to` -> the format."""
