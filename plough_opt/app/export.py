"""`plough-opt export`: export of a file's scene to other tools, and of its share as a part."""

import argparse
import json
from functools import partial
from typing import Any, Final

from plough_opt.app.options import QuantityOption, add_option, add_quantities, add_shared, given_quantities
from plough_opt.app.terminal import console, progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file
from plough_opt.exchange.component import Component
from plough_opt.exchange.export.formats import FORMATS, Request
from plough_opt.motion import Run
from plough_opt.motion.scene import Scene
from plough_opt.problem_file import Problem

_PART_OPTIONS: Final = {
    "opening": QuantityOption(
        "rad", "90 deg", "for a part: angle between the share's faces (default: gives the block the mass that the model"
        " uses)"
    ),
    "thickness": QuantityOption("m", "10 mm", "for a part: thickness of a bent plate (default: a solid block)"),
}  # fmt: skip
_FORMAT_OPTIONS: Final = tuple(sorted({option for own in FORMATS.values() for option in own.options}))


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    formats_text = "; ".join(f"{name}: {own}" for name, own in FORMATS.items())
    add_shared(verb, json="print the paths of the files as JSON")
    verb.add_argument("--to", required=True, choices=FORMATS, metavar="FORMAT", help=formats_text)
    add_option(verb, "output", "PATH", "file or folder to write", required=True)
    add_option(verb, "inputs", "NAMES", "inputs, such as share.height,soil.cohesion (default: the variables)")
    results = "results, such as mean_draft,force_rms (default: those that the file minimises, trades and requires)"
    add_option(verb, "outputs", "NAMES", results)
    add_option(verb, "description", "FILE.json", "for casadi: also write names, units and bounds here")
    add_option(verb, "name", "NAME", "name of the function or model (default: share)")
    strut = "for an FMU: whether its input is the strut's speed or position (default: speed)"
    verb.add_argument("--strut", choices=("speed", "position"), help=strut)
    verb.add_argument("--sources", action="store_true", help="for an FMU: only its C source, which needs no compiler")
    add_quantities(verb, _PART_OPTIONS)
    verb.add_argument("--body", choices=("share", "cone"), help="for a part: which body (default: share)")
    at = "for a part: the best design, or the variables' guesses (default: best, if the file minimises)"
    verb.add_argument("--at", choices=("best", "guess"), help=at)


def export(options: argparse.Namespace) -> None:
    """Write a file's scene for another tool; write nothing if anything fails."""
    chosen = FORMATS[options.to]
    given = _options(options)
    problem = read(options)
    values: dict[str, Any] = problem.values()
    name = options.name or "share"
    at = options.at or ("best" if problem.variables and problem.table.minimise else "guess")
    request = Request(
        path=options.output,
        name=name,
        component=partial(_component, problem, options, name),
        scene=problem.scene(),
        best=partial(_best, problem) if at == "best" else None,
        steel_density=values["scene.steel_density"],
        duration=values.get("scene.duration"),
        varies=bool(problem.variables),
        options=given,
    )
    written = chosen.write(request)
    if options.json:
        paths = [str(path) for path in written.paths]
        print(json.dumps({"wrote": paths, "says": written.said, "next": written.next}, indent=2, allow_nan=False))
        return
    if written.said:
        console().print(written.said, soft_wrap=True)
    for path in written.paths:
        wrote(path)
    if written.next:
        console().print(f"next: {written.next}", soft_wrap=True)


def _component(problem: Problem, options: argparse.Namespace, name: str) -> Component:
    with progress() as notify:
        notify("building the component", 0.0)
        names = (_names("inputs", options.inputs), _names("outputs", options.outputs))
        return problem.component(*names, name=name)


def _options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the format's options; raise InputError for other options and for a path that cannot be written."""
    chosen = FORMATS[options.to]
    chosen.check(options.output)
    for name in _FORMAT_OPTIONS:
        if getattr(options, name) and name not in chosen.options:
            others = ", ".join(other for other, own in FORMATS.items() if name in own.options)
            raise InputError(f"--{name} cannot be used with --to {options.to}, only with {others}")
    if options.description is not None:
        check_file(options.description, "description", ".json")
    return {name: getattr(options, name) for name in chosen.options} | given_quantities(options, _PART_OPTIONS)


def _names(option: str, written: str | None) -> tuple[str, ...]:
    """Return the names in a comma-separated list; none if the option is not given."""
    if written is None:
        return ()
    names = tuple(part.strip() for part in written.split(","))
    if not all(names):
        raise InputError(
            f"--{option} '{written}' has an empty name: separate names by single commas, as share.height,soil.cohesion"
        )
    return names


def _best(problem: Problem) -> Scene:
    """Return the scene of the best design, or of the robust one if the soil is uncertain."""
    with progress() as notify:
        if problem.table.uncertain is None:
            run = problem.optimise(notify)[1]
            assert isinstance(run, Run)  # `problem.scene()` in `export` refuses several shares
            return run.scene
        from plough_opt.problem_file.uncertain import optimise_robust  # scipy.stats is slow to import

        return optimise_robust(problem, notify).run.scene
