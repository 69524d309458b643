"""Commands that need one function each; every command writes its files last, when nothing else can fail."""

import argparse
import dataclasses
import json
import shlex
from pathlib import Path
from typing import Any, Final

import shtab

from plough_opt.app import report
from plough_opt.app.options import QuantityOption, add_option, add_quantities, add_shared, given_quantities
from plough_opt.app.terminal import console, give, progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import write_new
from plough_opt.design.effort import Search
from plough_opt.laws.forces import cone_index
from plough_opt.motion.effect_costs import effect_costs
from plough_opt.problem_file import Problem, template
from plough_opt.problem_file.schema import file_schema
from plough_opt.soil.soil import named_soil, soil_names

_AGAINST: Final = {
    "depth": QuantityOption("m", "0.4 m", "working depth; repeatable (default: the share's height)", several=True),
    "speed": QuantityOption(
        "m/s", "5 km/h", "speed; repeatable (default: 3, 5, 7, 9 km/h and the tow speed)", True, argument="speeds"
    ),
    "width": QuantityOption("m", "0.08 m", "width of the tine (default: base diameter of the equivalent cone)"),
    "rake": QuantityOption(
        "rad", "45 deg", "rake angle of the tine (default: the share's chisel angle)", argument="rake_angle"
    ),
    "adhesion": QuantityOption("Pa", "2 kPa", "adhesion of soil on the tine (default: 0)"),
    "surcharge": QuantityOption("Pa", "1 kPa", "pressure on the soil's surface (default: 0)"),
    "rupture-ratio": QuantityOption("", "2.5", "rupture distance over depth (default: that of a plane wedge)"),
    "texture": QuantityOption(None, "NAME", "soil texture for ASABE D497: fine, medium or coarse (default: all)"),
    "point": QuantityOption(None, "NAME", "point for ASABE D497: narrow or winged (default: narrow)"),
}


def add_init(verb: argparse.ArgumentParser) -> None:
    """Add the options of `init`."""
    verb.add_argument("file", metavar="FILE", help="new file to write; it must not exist yet")
    add_shared(verb, json="print the path of the file as JSON")


def init(options: argparse.Namespace) -> None:
    """Write the template to a new file in an existing folder."""
    if not Path(options.file).parent.is_dir():
        raise InputError(f"'{options.file}' cannot be written: create its folder first, or choose another place")
    path = write_new(options.file, "problem file", template())
    if options.json:
        print(json.dumps({"wrote": [str(path)]}))
        return
    line = f"wrote {path}; next: plough-opt optimise {shlex.quote(str(path))}"
    console().print(line, soft_wrap=True)


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
    """Print a shell script that completes commands, options and file names."""
    print(shtab.complete(options.parser, shell=options.shell))


def add_check(verb: argparse.ArgumentParser) -> None:
    """Add the options of a check, and of the comparison with other draft models."""
    verb.add_argument("--effects", action="store_true", help="print which effects are on, and the cost of each")
    against = "compare with other draft models; the options below need this one"
    verb.add_argument("--against", action="store_true", help=against)
    add_quantities(verb, _AGAINST)
    add_shared(verb, plot="draw the comparison: .png, .svg or .pdf",
               json="print the scene's quantities as JSON (SI units)")  # fmt: skip


def check(options: argparse.Namespace) -> None:
    """Check a file, and print the contents of its scene at the guess."""
    for name in (*_AGAINST, "plot"):
        if not options.against and getattr(options, name.replace("-", "_")) is not None:
            raise InputError(f"--{name} belongs to a comparison: add --against")
    if options.json and (options.effects or options.against):
        raise InputError("--json prints only the scene: remove --effects and --against")
    against = given_quantities(options, _AGAINST)
    problem = read(options)
    comparison = None
    if options.against:
        from plough_opt.studies.crosscheck import compare

        comparison = compare(problem.scene(), **against)
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
            line = f"Compared at the file's guess, {guess}; use --set to compare another design, such as the optimum."
            console().print(line, soft_wrap=True)
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
    search = (
        "effort of the search: auto, thorough (four times the designs), near (only the guess's basin), a number of"
        ' designs to sample or a time such as "20 s", after which no further round begins, or the variables to sample,'
        " with commas (default: auto)"
    )
    add_option(verb, "search", "HOW", search, default="auto")
    judge = "rank optima by their median within the tolerances, or by their own objective (default: tolerance)"
    verb.add_argument("--judge", choices=("tolerance", "bare"), default="tolerance", help=judge)
    change = "print the change of the optimum in per cent for one per cent more of every quantity and limit"
    verb.add_argument("--sensitivity", action="store_true", help=change)
    add_shared(verb, "seed", "json", "plot")


def optimise(options: argparse.Namespace) -> None:
    """Find the best share of a file, or with an uncertain soil the robust and the nominal optimum."""
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
            "--sensitivity needs one soil: remove it, since the report shows the influence of the uncertain properties"
            " anyway, or remove the table [uncertain]"
        )
    from plough_opt.problem_file.uncertain import optimise_robust  # scipy.stats is slow to import

    with progress() as notify:
        found = optimise_robust(problem, notify)
    give(options, found.page(), found.to_json, found.plot)


def _search_of(text: str) -> Search:
    """Return the search that a text describes: a word, a number of designs, a time, or keys of variables."""
    if text.strip().isdecimal():
        return int(text)
    return tuple(part.strip() for part in text.split(",")) if "," in text else text


def add_tradeoff(verb: argparse.ArgumentParser) -> None:
    """Add the options of a front."""
    add_option(verb, "points", "N", "positions on the front (default: the file's)", type=int)
    add_shared(verb, "json", "plot", "csv", "output")


def tradeoff(options: argparse.Namespace) -> None:
    """Compute the front of the two or three results that a file trades."""
    problem = read(options)
    with progress() as notify:
        front = problem.trade_off(options.points, notify)
    give(options, front.page(), front.to_json, front.plot)
    if options.csv is not None:
        wrote(front.to_csv(options.csv))


def add_accuracy(verb: argparse.ArgumentParser) -> None:
    """Add the options of the accuracy study."""
    add_option(verb, "error", "E", "relative error to reach (default: 1e-6)", type=float, default=1e-6)
    limit = "time limit of one use of a method; a search may take ten times as long (default: 1)"
    add_option(verb, "seconds", "S", limit, type=float, default=1.0)
    verb.add_argument("--design", action="store_true", help="study the optimum of the design instead of its scene")
    verb.add_argument("--thin", action="store_true", help="try only every other setting")
    add_shared(verb, "json", "plot", output="write all results as JSON")


def accuracy(options: argparse.Namespace) -> None:
    """Compare error and time of integration methods on a file's scene at its guess, or on its design."""
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
    nominal = ("the study uses the nominal soil and ignores its uncertainty",) if problem.table.uncertain else ()
    study = dataclasses.replace(study, origin=problem.origin, notes=(*study.notes, *nominal))
    give(options, study.page(), study.to_json, study.plot)
