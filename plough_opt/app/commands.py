"""The commands: each reads, computes and reports; files are written last, when nothing can fail any more."""

import argparse
import dataclasses
import json
import shlex
from pathlib import Path
from typing import Any, Final

import shtab

from plough_opt.app import report
from plough_opt.app.options import QuantityOption, add_quantities, add_shared, given_quantities
from plough_opt.app.terminal import console, give, printable, progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import write_new
from plough_opt.design.effort import Search
from plough_opt.laws.forces import cone_index
from plough_opt.motion.effect_costs import effect_costs
from plough_opt.problem_file import TEMPLATE, Problem
from plough_opt.problem_file.json_schema import file_schema
from plough_opt.soil.soil import named_soil, soil_names

_AGAINST: Final = {
    "depth": QuantityOption("m", "0.4 m", "working depth, repeatable (default: the share's height)", several=True),
    "speed": QuantityOption(
        "m/s", "5 km/h", "speed, repeatable (default: 3, 5, 7, 9 km/h and the tow speed)", True, argument="speeds"
    ),
    "width": QuantityOption("m", "0.08 m", "width of the tine (default: base diameter of the equivalent cone)"),
    "rake": QuantityOption(
        "rad", "45 deg", "rake angle of the tine (default: the share's chisel angle)", argument="rake_angle"
    ),
    "adhesion": QuantityOption("Pa", "2 kPa", "adhesion of soil on the tine (default: none)"),
    "surcharge": QuantityOption("Pa", "1 kPa", "pressure on the soil's surface (default: none)"),
    "rupture-ratio": QuantityOption("", "2.5", "rupture distance over depth (default: of a plane wedge)"),
    "texture": QuantityOption(None, "NAME", "fine, medium or coarse, for ASABE D497 (default: all)"),
    "point": QuantityOption(None, "NAME", "narrow or winged, for ASABE D497 (default: narrow)"),
}


def add_init(verb: argparse.ArgumentParser) -> None:
    """Add the options of `init`."""
    verb.add_argument("file", metavar="FILE", help="file to write; it must not exist")
    add_shared(verb, json="print what was written as JSON")


def init(options: argparse.Namespace) -> None:
    """Write the template; an existing file is left alone, and no folder is made."""
    if not Path(options.file).parent.is_dir():
        raise InputError(f"'{options.file}' cannot be written: make its folder first, or name another place")
    path = write_new(options.file, "problem file", TEMPLATE)
    if options.json:
        print(json.dumps({"wrote": [str(path)]}))
        return
    line = f"wrote {path}; next: plough-opt optimise {shlex.quote(str(path))}"
    console().print(printable(line), markup=False, soft_wrap=True)


def soils(options: argparse.Namespace) -> None:
    """List the named soils."""
    found = [named_soil(name) for name in soil_names()]
    if options.json:
        properties = [{**dataclasses.asdict(soil), "cone_index": cone_index(soil)} for soil in found]
        print(json.dumps(properties, indent=2, allow_nan=False))
    else:
        report.print_soils(console(), found)


def schema(_options: argparse.Namespace) -> None:
    """Print the JSON schema of problem files."""
    print(json.dumps(file_schema(), indent=2, allow_nan=False))


def completion(options: argparse.Namespace) -> None:
    """Print a script for a shell that completes commands, options and file names."""
    print(shtab.complete(options.parser, shell=options.shell))


def add_check(verb: argparse.ArgumentParser) -> None:
    """Add the options of a check, and of the comparison with other draft models."""
    verb.add_argument("--effects", action="store_true", help="print what each effect costs, on or off")
    verb.add_argument("--against", action="store_true", help="print what other draft models give; next options need it")
    add_quantities(verb, _AGAINST)
    add_shared(verb, plot="write a picture of it: .png, .svg or .pdf",
               json="print the scene's quantities as JSON (SI units)")  # fmt: skip


def check(options: argparse.Namespace) -> None:
    """Check a file; print what its scene contains and what its guess is like."""
    for name in (*_AGAINST, "plot"):
        if not options.against and getattr(options, name.replace("-", "_")) is not None:
            raise InputError(f"--{name} belongs to a comparison: add --against")
    against = given_quantities(options, _AGAINST)
    problem = read(options)
    comparison = None
    if options.against:
        from plough_opt.studies.crosscheck import compare

        comparison = compare(problem.scene(), **against)
    if options.json and (options.effects or comparison is not None):
        raise InputError("--json is of the scene alone: leave --effects and --against out")
    if options.json:
        quantities = {key: float(value) for key, value in problem.values().items()}
        notes = (*problem.notes, *problem.cautions, *report.warnings_of(problem))
        print(json.dumps({"title": problem.title, "quantities": quantities, "notes": notes}, indent=2, allow_nan=False))
        return
    report.print_check(console(), problem)
    if options.effects:
        with progress() as notify:
            notify("measuring the effects", 0.0)
            duration: Any = problem.values().get("scene.duration")
            found = effect_costs(problem.scene(), duration)
        report.print_effects(console(), found)
    if comparison is not None:
        if problem.variables:
            guess = ", ".join(f"{key} = {v.display.text(v.guess)}" for key, v in problem.variables.items())
            line = f"Compared at the file's guess, {guess}; --set gives another design, such as the optimum."
            console().print(line, markup=False, soft_wrap=True)
        report.print_comparison(console(), comparison)
        if options.plot is not None:
            comparison.plot(options.plot)
            wrote(Path(options.plot))


def add_simulate(verb: argparse.ArgumentParser) -> None:
    """Add the options of a simulation."""
    add_shared(verb, "json", "plot")


def simulate(options: argparse.Namespace) -> None:
    """Simulate a file's scene with every variable at its guess."""
    problem = read(options)
    with progress() as notify:
        notify("simulating", 0.0)
        run = problem.machine() if problem.shares else problem.simulate()
    page = report.run_page(problem, run)
    give(options, page, lambda: run.to_json(page), run.plot)


def add_optimise(verb: argparse.ArgumentParser) -> None:
    """Add the options of an optimisation."""
    verb.add_argument(
        "--search",
        metavar="HOW",
        default="auto",
        help="auto, thorough (four times as much), near (the guess's basin), a number of designs, a time as"
        ' "20 s", or keys of variables, with commas (default: auto)',
    )
    verb.add_argument(
        "--judge",
        choices=("tolerance", "bare"),
        default="tolerance",
        help="compare optima by their median within the tolerances, or as they are (default: tolerance)",
    )
    verb.add_argument(
        "--sensitivity",
        action="store_true",
        help="print by how many per cent the optimum changes per per cent of every quantity and limit",
    )
    add_shared(verb, "seed", "json", "plot")


def optimise(options: argparse.Namespace) -> None:
    """Find the best share of a file; of one with an uncertain soil the robust one beside the nominal one."""
    problem = read(options)
    if problem.table.uncertain is not None:
        _optimise_robust(problem, options)
        return
    with progress() as notify:
        best, run = problem.optimise(
            notify,
            parameters=options.sensitivity,
            search=_search_of(options.search),
            judge=options.judge,
            seed=options.seed,
        )
        found = report.sensitivities_of(best, notify) if options.sensitivity else ()
    best = dataclasses.replace(best, sensitivities=found)
    page = best.page()
    page = dataclasses.replace(page, parts=(*page.parts, *report.own_results(problem, run)))
    page = report.with_sensitivities(page, problem, found)
    give(options, page, lambda: best.to_json(page), best.plot)


def _optimise_robust(problem: Problem, options: argparse.Namespace) -> None:
    if options.sensitivity:
        raise InputError(
            "--sensitivity is of an optimum for one soil: leave it out, for what the results owe to the uncertain"
            " properties is reported anyway, or leave out the table [uncertain]"
        )
    from plough_opt.problem_file.robust_design import optimise_robust  # scipy.stats is slow to import

    with progress() as notify:
        found = optimise_robust(problem, notify)
    give(options, found.page(), found.to_json, found.plot)


def _search_of(text: str) -> Search:
    """Return what a text of the command line says of a search: a word, a number of designs, a time, or keys."""
    if text.strip().isdigit():
        return int(text)
    return tuple(part.strip() for part in text.split(",")) if "," in text else text


def add_tradeoff(verb: argparse.ArgumentParser) -> None:
    """Add the options of a front."""
    verb.add_argument("--points", type=int, metavar="N", help="positions on the front (default: the file's)")
    add_shared(verb, "json", "plot", "csv", "output")


def tradeoff(options: argparse.Namespace) -> None:
    """Draw the front of the two or three results that a file trades."""
    problem = read(options)
    with progress() as notify:
        front = problem.trade_off(options.points, notify)
    give(options, front.page(), front.to_json, front.plot)
    if options.csv is not None:
        wrote(front.to_csv(options.csv))


def add_accuracy(verb: argparse.ArgumentParser) -> None:
    """Add the options of the accuracy study."""
    verb.add_argument("--error", type=float, default=1e-6, metavar="E", help="relative error wanted (default: 1e-6)")
    verb.add_argument(
        "--seconds",
        type=float,
        default=1.0,
        metavar="S",
        help="time one use of a method may take, and a tenth of what a solve may take (default: 1)",
    )
    verb.add_argument("--design", action="store_true", help="study the optimum of the design instead of its scene")
    verb.add_argument("--thin", action="store_true", help="try every other setting only")
    add_shared(verb, "json", "plot", output="write every figure as JSON")


def accuracy(options: argparse.Namespace) -> None:
    """Show what accuracy costs in time on a file's scene, with every variable at its guess, or on its design."""
    problem = read(options)
    from plough_opt.studies.accuracy.study import study_accuracy, study_design

    with progress() as notify:
        common: dict[str, Any] = {
            "wanted": options.error, "title": problem.title, "progress": notify, "thin": options.thin,
        }  # fmt: skip
        if options.design:
            study = study_design(problem.design()[0], limit=10.0 * options.seconds, **common)
        else:
            duration: Any = problem.values().get("scene.duration")
            study = study_accuracy(problem.scene(), duration, allowance=options.seconds, **common)
    nominal = ("the soil is the nominal one: its uncertainty takes no part",) if problem.table.uncertain else ()
    study = dataclasses.replace(study, origin=problem.origin, notes=(*study.notes, *nominal))
    give(options, study.page(), study.to_json, study.plot)
