"""`plough-opt export`: a file's scene for other tools, and its share as a part."""

import argparse
import json
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from plough_opt.app.options import QuantityOption, add_quantities, add_shared, given_quantities
from plough_opt.app.terminal import console, printable, progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file
from plough_opt.exchange.component import Component
from plough_opt.exchange.export.formats import FORMATS, Request
from plough_opt.motion import Run
from plough_opt.motion.scene import Scene
from plough_opt.problem_file import Problem

_LENGTHS: Final = {
    "opening": QuantityOption(
        "rad", "90 deg", "of a part: angle between the share's faces (default: at which the block weighs what the model"
        " counts)"
    ),
    "thickness": QuantityOption("m", "10 mm", "of a part: bent from plate (default: a block)"),
}  # fmt: skip
_OPTIONS: Final = tuple(sorted({option for own in FORMATS.values() for option in own.options}))


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    formats_text = "; ".join(f"{name}: {own}" for name, own in FORMATS.items())
    add_shared(verb, json="print what was written as JSON")
    verb.add_argument("--to", required=True, choices=FORMATS, metavar="FORMAT", help=formats_text)
    verb.add_argument("--output", required=True, metavar="PATH", help="file or folder to write")
    verb.add_argument(
        "--inputs", metavar="NAMES", help="quantities to vary, as share.height,soil.cohesion (default: the variables)"
    )
    verb.add_argument(
        "--outputs",
        metavar="NAMES",
        help="results, as mean_draft,force_rms (default: what the file minimises, trades and requires)",
    )
    verb.add_argument("--description", metavar="FILE.json", help="of casadi: write names, units and bounds here too")
    verb.add_argument("--name", metavar="NAME", help="name of the function or model (default: share)")
    verb.add_argument("--strut", choices=("speed", "position"), help="of an FMU: its input (default: speed)")
    verb.add_argument("--sources", action="store_true", help="of an FMU: its C source only, which needs no compiler")
    add_quantities(verb, _LENGTHS)
    verb.add_argument("--body", choices=("share", "cone"), help="of a part: which body (default: share)")
    verb.add_argument(
        "--at",
        choices=("best", "guess"),
        help="of a part: the best design, or the variables' guesses (default: best where the file minimises)",
    )


def export(options: argparse.Namespace) -> None:
    """Write a file's scene for another tool; nothing is written if anything fails."""
    chosen = FORMATS[options.to]
    given = _options(options)
    problem = read(options)
    values: dict[str, Any] = problem.values()
    name = options.name or "share"
    request = Request(
        path=options.output,
        name=name,
        component=partial(_component, problem, options, name),
        scene=problem.scene(),
        best=_best_of(problem, options.at),
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
        console().print(printable(written.said), markup=False, soft_wrap=True)
    for path in written.paths:
        wrote(path)
    if written.next:
        console().print(f"next: {written.next}", markup=False, soft_wrap=True)


def _component(problem: Problem, options: argparse.Namespace, name: str) -> Component:
    with progress() as notify:
        notify("building the component", 0.0)
        names = (_names("inputs", options.inputs), _names("outputs", options.outputs))
        return problem.component(*names, name=name)


def _options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the format's options; refuse others, and a place that cannot be written, before anything is computed."""
    chosen = FORMATS[options.to]
    chosen.check_place(options.output)
    for name in _OPTIONS:
        if getattr(options, name) and name not in chosen.options:
            others = ", ".join(other for other, own in FORMATS.items() if name in own.options)
            raise InputError(f"--{name} does not go with --to {options.to}: it belongs to {others}")
    if options.description is not None:
        check_file(options.description, ".json", "description")
    given = {name: getattr(options, name) for name in chosen.options} | given_quantities(options, _LENGTHS)
    if chosen.check is not None:
        chosen.check(given)
    return given


def _names(option: str, written: str | None) -> tuple[str, ...]:
    """Return the names of a list, none where the option is not given."""
    if written is None:
        return ()
    names = tuple(part.strip() for part in written.split(","))
    if not all(names):
        raise InputError(
            f"--{option} '{written}' lacks a name: write them with commas between, as share.height,soil.cohesion"
        )
    return names


def _best_of(problem: Problem, at: str | None) -> Callable[[], Scene] | None:
    """Return a function that searches the scene of a file's best design, or None where none is wanted."""
    if at == "guess" or (at is None and not (problem.variables and problem.table.minimise)):
        return None
    return lambda: _best(problem)


def _best(problem: Problem) -> Scene:
    """Return the scene of the best design, of the robust one where the soil is uncertain."""
    with progress() as notify:
        if problem.table.uncertain is None:
            run = problem.optimise(notify)[1]
            assert isinstance(run, Run)  # several shares are refused
            return run.scene
        from plough_opt.problem_file.robust_design import optimise_robust  # scipy.stats is slow to import

        return optimise_robust(problem, notify).run.scene
