"""`plough-opt export`: a file's scene for other tools, or its share for a workshop."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from plough_opt.app import part
from plough_opt.app.terminal import console, progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file, check_new_folder
from plough_opt.exchange import export as formats
from plough_opt.problem_file import Problem

FORMATS: Final = {
    "c": "a new folder with C source, header and a test",
    "casadi": "a serialised CasADi Function, .casadi",
    "openmdao": "a new folder with a Python module",
    "fmu": "an FMU for model exchange, FMI 3.0, .fmu",
    **part.FORMATS,
}


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    told = "; ".join(f"{name}: {what}" for name, what in FORMATS.items())
    verb.add_argument("--to", required=True, choices=FORMATS, metavar="FORMAT", help=told)
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
    part.add_options(verb)


def export(options: argparse.Namespace) -> None:
    """Write a file's scene for another tool; nothing is written unless everything is right."""
    _check_options(options)
    problem = read(options)
    if options.to in part.FORMATS:
        part.write(problem, options)
        return
    if options.to == "fmu":
        wrote(_fmu(problem, options))
        console().print(f"next: fmpy simulate {shlex.quote(options.output)} --show-plot", markup=False, soft_wrap=True)
        return
    with progress() as told:
        told("building the component", 0.0)
        names = (_names("inputs", options.inputs), _names("outputs", options.outputs))
        component = problem.component(*names, name=options.name or "share")
    if options.to == "casadi":
        path = formats.write_casadi(component, options.output, options.description)
    else:
        path = (formats.write_c if options.to == "c" else formats.write_openmdao)(component, options.output)
    console().print(str(component), markup=False)
    wrote(path)
    if options.description is not None:
        wrote(Path(options.description))
    console().print(f"next: {_next(options.to, path, component.name())}", markup=False, soft_wrap=True)


def _check_options(options: argparse.Namespace) -> None:
    """Refuse a place that cannot be written to, and options of another format, before anything is computed."""
    if options.to in ("c", "openmdao"):
        check_new_folder(options.output, FORMATS[options.to].removeprefix("a new folder with "))
    elif options.to not in part.FORMATS:
        check_file(options.output, f".{options.to}", FORMATS[options.to].partition(",")[0].partition(" ")[2])
    if options.description is not None and options.to == "casadi":
        check_file(options.description, ".json", "description")
    elif options.description is not None:
        raise InputError(f"--description does not go with --to {options.to}: what it says stands in that format itself")
    of_parts, of_fmus = ("opening", "thickness", "body", "at"), ("strut", "sources")
    if options.to in part.FORMATS:
        others = dict.fromkeys(("inputs", "outputs", "name", *of_fmus), "a part has a shape only")
        part.check_options(options)
    elif options.to == "fmu":
        others = dict.fromkeys(("inputs", "outputs"), "an FMU has the strut's motion as input")
    else:
        others = dict.fromkeys(of_fmus, "it belongs to an FMU")
    if options.to not in part.FORMATS:
        others |= dict.fromkeys(of_parts, f"it belongs to a part, {', '.join(part.FORMATS)}")
    for name, reason in others.items():
        if getattr(options, name):
            raise InputError(f"--{name} does not go with --to {options.to}: {reason}")


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


def _fmu(problem: Problem, options: argparse.Namespace) -> Path:
    values = problem.values()
    return formats.write_fmu(
        problem.scene(),
        options.output,
        strut=options.strut or "speed",
        steel_density=values["scene.steel_density"],
        duration=values.get("scene.duration"),
        name=options.name or "share",
        binary=not options.sources,
    )


def _next(to: str, path: Path, name: str) -> str:
    """Return what one does with what was written."""
    if to == "c":
        return f"make -C {shlex.quote(str(path))}"
    if to == "casadi":
        told = "  # such a file can run code when it is loaded: take none from strangers"
        return "python -c " + shlex.quote(f"import casadi; print(casadi.Function.load({path.as_posix()!r}))") + told
    return f"{path / name}.py holds an openmdao.api.ExplicitComponent; add_design declares variables and constraints"
