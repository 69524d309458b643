"""The export formats by name, each with its options and the function that writes it.

The modules that write are imported on use: the list alone is needed for help and completion.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
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
class Written:
    """Files that an export has written.

    Attributes:
        paths: paths of the files, or of the folder.
        said: a description of the content, or "".
        next: a command or a sentence on how to use it.
    """

    paths: tuple[Path, ...]
    said: str = ""
    next: str = ""


@dataclass(frozen=True)
class Format:
    """An export format.

    Args:
        what: what is written, such as "a new folder with C source", or the kind of file.
        write: writes it.
        endings: possible endings of the file's name, such as (".fmu",); () for a new folder.
        options: names of its options beside the path: see `plough-opt export --help`.
        needs: module of an optional library that it needs, or "".
    """

    what: str
    write: Callable[[Request], Written]
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


def _c(request: Request) -> Written:
    from plough_opt.exchange.export.c import write_c

    component = request.component()
    path = write_c(component, request.path)
    return Written((path,), str(component), f"make -C {shlex.quote(str(path))}")


def _casadi(request: Request) -> Written:
    from plough_opt.exchange.export.c import write_casadi

    component, description = request.component(), request.options.get("description")
    path = write_casadi(component, request.path, description)
    load = shlex.quote(f"import casadi; print(casadi.Function.load({path.as_posix()!r}))")
    warning = "  # loading such a file can run code: load only files that you trust"
    return Written((path, *([Path(description)] if description else [])), str(component), f"python -c {load}{warning}")


def _javascript(request: Request) -> Written:
    from plough_opt.exchange.export.javascript import write_javascript

    component = request.component()
    path = write_javascript(component, request.path)
    hint = f"in node or a page: import {{ evaluate }} from './{path.name}'; evaluate({{}}) has the results"
    return Written((path,), str(component), hint)


def _openmdao(request: Request) -> Written:
    from plough_opt.exchange.export.openmdao import write_openmdao

    component = request.component()
    path = write_openmdao(component, request.path)
    module = path / component.name()
    hint = f"{module}.py holds an openmdao.api.ExplicitComponent; add_design declares variables and constraints"
    return Written((path,), str(component), hint)


def _fmu(request: Request) -> Written:
    from plough_opt.exchange.export.fmu import write_fmu

    given: dict[str, Any] = {name: getattr(request, name) for name in ("steel_density", "duration", "name")}
    binary = not request.options.get("sources")
    path = write_fmu(request.scene, request.path, strut=request.options.get("strut") or "speed", binary=binary, **given)
    return Written((path,), "", f"fmpy simulate {shlex.quote(request.path)} --show-plot")


def _part(request: Request) -> Written:
    from plough_opt.exchange.export.part import write_part

    given = request.options
    if given.get("body") == "cone" and (given.get("opening") or given.get("thickness")):
        raise InputError("--opening and --thickness belong to a wedge: leave them out for a cone, which is solid")
    scene = request.scene if request.best is None else request.best()
    body: Wedge | Cone = scene.cone if given.get("body") == "cone" else scene.share
    opening, thickness = given.get("opening"), given.get("thickness")
    path = write_part(body, request.path, opening=opening, thickness=thickness)
    return Written((path,), _described(body, opening, thickness, request.design))


def _described(body: Wedge | Cone, opening: float | None, thickness: float | None, design: str) -> str:
    """Return the measures of a part in words."""
    from plough_opt.soil.geometry import Cone

    if isinstance(body, Cone):
        angle = math.degrees(body.half_angle)
        return (
            f"Cone of {design}: half angle {angle:.4g} deg, height {1e3 * body.height:.4g} mm, solid,"
            f" {1e6 * body.volume:.4g} cm^3, lateral surface {1e4 * body.area:.4g} cm^2"
        )
    solid = body.mesh(opening=opening, thickness=thickness)
    kind = "a block" if thickness is None else f"plate of {1e3 * thickness:.4g} mm"
    between = math.degrees(body.opening if opening is None else opening)
    return (
        f"Share of {design}: wedge angle {math.degrees(body.angle):.4g} deg, chisel angle"
        f" {math.degrees(body.chisel_angle):.4g} deg, height {1e3 * body.height:.4g} mm, {between:.4g} deg between the"
        f" faces, {kind}, {1e6 * solid.volume:.4g} cm^3, faces {1e4 * solid.working_area:.4g} cm^2"
    )


_PART_OPTIONS = ("opening", "thickness", "body", "at")

FORMATS: Final[dict[str, Format]] = {
    "c": Format("a new folder with C source, header and a test", _c),
    "casadi": Format("serialised CasADi Function", _casadi, (".casadi",), ("inputs", "outputs", "name", "description")),
    "javascript": Format("ES module for web pages and node", _javascript, (".mjs", ".js")),
    "openmdao": Format("a new folder with a Python module", _openmdao, needs="openmdao.api"),
    "fmu": Format("FMU for model exchange, FMI 3.0", _fmu, (".fmu",), ("name", "strut", "sources")),
    "stl": Format("triangles of the share in mm", _part, (".stl",), _PART_OPTIONS, "trimesh"),
    "gltf": Format("triangles of the share in m", _part, (".gltf", ".glb"), _PART_OPTIONS, "trimesh"),
    "dxf": Format("the share's faces laid flat in mm, a cutting pattern", _part, (".dxf",), _PART_OPTIONS, "ezdxf"),
    "step": Format("the share's faces in mm for CAD", _part, (".step", ".stp"), _PART_OPTIONS, "build123d"),
}
"""Name of a format in `plough-opt export --to` -> the format."""
