"""`plough-opt export --to stl | gltf | dxf | step`: a file's share as a part for a workshop."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Final

from plough_opt.app.messages import printable
from plough_opt.app.terminal import console, progress, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit
from plough_opt.exchange import export as formats
from plough_opt.motion.scene import Scene
from plough_opt.problem_file import Problem
from plough_opt.soil.geometry import Cone, Wedge

FORMATS: Final = {
    "stl": "triangles of the share in mm, .stl",
    "gltf": "triangles of the share in m, .gltf or .glb",
    "dxf": "the share's faces laid flat in mm, a cutting pattern, .dxf",
    "step": "the share's faces in mm for CAD, .step or .stp",
}
_ENDINGS: Final = {"stl": (".stl",), "gltf": (".gltf", ".glb"), "dxf": (".dxf",), "step": (".step", ".stp")}
_UNITS: Final = {"opening": Unit("rad"), "thickness": Unit("m")}


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of a part."""
    verb.add_argument(
        "--opening",
        metavar='"90 deg"',
        help="of a part: angle between the share's faces (default: at which the block weighs what the model counts)",
    )
    verb.add_argument("--thickness", metavar='"10 mm"', help="of a part: bent from plate (default: a block)")
    verb.add_argument("--body", choices=("share", "cone"), help="of a part: which body (default: share)")
    verb.add_argument(
        "--at",
        choices=("best", "guess"),
        help="of a part: the best design, or the variables' guesses (default: best where the file minimises)",
    )


def check_options(options: argparse.Namespace) -> None:
    """Refuse a name without the format's ending, and bending a cone.

    Raises:
        InputError: as said.
    """
    endings = _ENDINGS[options.to]
    if Path(options.output).suffix.lower() not in endings:
        raise InputError(f"'{options.output}' is no name for a part: end it in {' or '.join(endings)}")
    if Path(options.output).is_dir():
        raise InputError(f"'{options.output}' is a folder: name a file in it")
    if options.body == "cone" and (options.opening or options.thickness):
        raise InputError("--opening and --thickness belong to a wedge: leave them out for a cone, which is solid")
    for name in _UNITS:
        _measure(options, name)


def write(problem: Problem, options: argparse.Namespace) -> None:
    """Write the share of a file, at its best design or at the guesses, and say what was written."""
    best = options.at == "best" or (options.at is None and bool(problem.variables and problem.table.minimise))
    scene = _best(problem) if best else problem.scene()
    opening, thickness = (_measure(options, name) for name in _UNITS)
    body = scene.cone if options.body == "cone" else scene.share
    path = formats.write_part(body, options.output, opening=opening, thickness=thickness)
    design = "the best design" if best else "the guesses" if problem.variables else "the file"
    console().print(printable(_described(body, opening, thickness, design)), markup=False, soft_wrap=True)
    wrote(path)


def _best(problem: Problem) -> Scene:
    """Return the scene of the best design, of the robust one where the soil is uncertain."""
    with progress() as told:
        if problem.table.uncertain is None:
            return problem.optimise(told)[1].scene
        from plough_opt.problem_file.robust_design import optimise_robust  # scipy.stats is slow to import

        return optimise_robust(problem, told).run.scene


def _measure(options: argparse.Namespace, name: str) -> float | None:
    written = getattr(options, name)
    try:
        return None if written is None else _UNITS[name].parse(written)
    except InputError as error:
        raise InputError(f"--{name} {error}") from None


def _described(body: Wedge | Cone, opening: float | None, thickness: float | None, design: str) -> str:
    """Return the measures of a part in words."""
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
