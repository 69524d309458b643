"""`plough-opt export`: export of a file's scene to other tools, and of its share as a part."""

import argparse
import json
from functools import partial
from typing import Any, Final

from plough_opt.app.options import PART, given_quantities
from plough_opt.app.terminal import console, progress, read, wrote
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.files import check_file
from plough_opt.exchange.component import Component
from plough_opt.exchange.export.formats import FORMATS, Request
from plough_opt.motion import Run
from plough_opt.motion.scene import Scene
from plough_opt.problem_file import Problem

_DESIGNS: Final = {
    "best": "the best design", "catalogue": "the best design from the catalogue", "guess": "the guesses",
}  # fmt: skip
_FORMAT_OPTIONS: Final = tuple(sorted({option for own in FORMATS.values() for option in own.options}))


def export(options: argparse.Namespace) -> None:
    """Write a file's scene for another tool; write nothing if anything fails."""
    chosen = FORMATS[options.to]
    given = _options(options)
    problem = read(options)
    values: dict[str, Any] = problem.values()
    name = options.name or "share"
    bought = any(variable.catalogue is not None for variable in problem.variables.values())
    if options.at == "catalogue" and not bought:
        raise InputError(f"--at catalogue: no variable of {problem.name} has a catalogue or a step: add one")
    usual = "guess" if not (problem.variables and problem.table.minimise) else "catalogue" if bought else "best"
    at = options.at or usual
    request = Request(
        path=options.output,
        name=name,
        component=partial(_component, problem, options, name),
        scene=problem.scene(),
        best=None if at == "guess" else partial(_best, problem, bought=at == "catalogue"),
        design=_DESIGNS[at] if problem.variables else "the file",
        steel_density=values["scene.steel_density"],
        duration=values.get("scene.duration"),
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
    return {name: getattr(options, name) for name in chosen.options} | given_quantities(options, PART)


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


def _best(problem: Problem, *, bought: bool) -> Scene:
    """Return the scene of the best design, from the catalogue or not, or of the robust one if the soil is uncertain."""
    with progress() as notify:
        if problem.table.uncertain is None:
            best, run = problem.optimise(notify)
            assert isinstance(run, Run)  # `problem.scene()` in `export` refuses several shares
            if not bought:
                return run.scene
            if best.bought is None:
                raise NotConverged(f"{best.warnings[-1]}; --at best exports the best design without it", "catalogue")
            return problem.scene(best.bought.variables)
        from plough_opt.problem_file.uncertain import optimise_robust  # scipy.stats is slow to import

        return optimise_robust(problem, notify).run.scene
