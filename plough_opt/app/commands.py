"""Commands that need one function each; every command writes its files last, when nothing else can fail."""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import shlex
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plough_opt.app import tables
from plough_opt.app.options import MODELS, given_quantities
from plough_opt.app.terminal import console, give, progress, read, wrote
from plough_opt.core.compiler import cache_folder
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file, write_new
from plough_opt.laws.forces import cone_index
from plough_opt.motion.effect_costs import effect_costs
from plough_opt.problem_file import Problem, template
from plough_opt.problem_file.schema import file_schema
from plough_opt.soil.soil import named_soil, soil_names

if TYPE_CHECKING:
    from plough_opt.design.search.effort import Search


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
        tables.print_soils(console(), found)


def schema(_options: argparse.Namespace) -> None:
    """Print the JSON schema of problem files."""
    print(json.dumps(file_schema(), indent=2, allow_nan=False))


def check(options: argparse.Namespace) -> None:
    """Check a file, and print the contents of its scene at the guess."""
    for name in (*MODELS, "plot"):
        if not options.against and getattr(options, name.replace("-", "_")) is not None:
            raise InputError(f"--{name} belongs to a comparison: add --against")
    if options.json and (options.effects or options.against):
        raise InputError("--json prints only the scene: remove --effects and --against")
    against = given_quantities(options, MODELS)
    problem = read(options)
    comparison = None
    if options.against:
        from plough_opt.studies.crosscheck import compare

        comparison = compare(problem.scene(), **against)
    if options.json:
        quantities = {key: float(value) for key, value in problem.values().items()}
        notes = (*problem.notes, *problem.cautions, *tables.warnings_of(problem), *problem.reliance)
        print(json.dumps({"title": problem.title, "quantities": quantities, "notes": notes}, indent=2, allow_nan=False))
        return
    tables.print_check(console(), problem)
    if options.effects:
        with progress() as notify:
            notify("measuring the effects", 0.0)
            duration: Any = problem.values().get("scene.duration")
            found = effect_costs(problem.scene(), duration)
        tables.print_effects(console(), found)
    if comparison is not None:
        if problem.variables:
            guess = ", ".join(f"{key} = {v.display.text(v.guess)}" for key, v in problem.variables.items())
            line = f"Compared at the file's guess, {guess}; use --set to compare another design, such as the optimum."
            console().print(line, soft_wrap=True)
        tables.print_comparison(console(), comparison)
        if options.plot is not None:
            comparison.plot(options.plot)
            wrote(Path(options.plot))


def simulate(options: argparse.Namespace) -> None:
    """Simulate a file's scene with every variable at its guess."""
    problem = read(options)
    with progress() as notify:
        notify("simulating", 0.0)
        run = problem.machine() if problem.shares else problem.simulate()
    page = tables.run_page(problem, run)
    give(options, page, lambda: run.to_json(page), run.plot, run.to_dataframe)


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
        found = tables.sensitivities_of(best, notify) if options.sensitivity else ()
    best = dataclasses.replace(best, sensitivities=found)
    page = best.page()
    page = dataclasses.replace(page, parts=(*page.parts, *tables.further_results(problem, run)))
    page = tables.with_sensitivities(page, problem, found)
    give(options, page, lambda: best.to_json(page), best.plot, best.to_dataframe)


def _optimise_robust(problem: Problem, options: argparse.Namespace) -> None:
    if options.sensitivity:
        raise InputError(
            "--sensitivity needs one soil: remove it, since the report shows the influence of the uncertain properties"
            " anyway, or remove the table [uncertain]"
        )
    from plough_opt.problem_file.uncertain import optimise_robust  # scipy.stats is slow to import

    with progress() as notify:
        found = optimise_robust(problem, notify)
    give(options, found.page(), found.to_json, found.plot, found.to_dataframe)


def _search_of(text: str) -> Search:
    """Return the search that a text describes: a word, a number of designs, a time, or keys of variables."""
    if text.strip().isdecimal():
        return int(text)
    return tuple(part.strip() for part in text.split(",")) if "," in text else text


def tradeoff(options: argparse.Namespace) -> None:
    """Compute the front of the two or three results that a file trades."""
    problem = read(options)
    with progress() as notify:
        front = problem.trade_off(options.points, notify)
    give(options, front.page(), front.to_json, front.plot, front.to_dataframe, front.to_csv)


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
    give(options, study.page(), study.to_json, study.plot, study.to_dataframe)


def explore(options: argparse.Namespace) -> None:
    """Write the page of a file, and open it in the browser unless a path is given.

    Raises:
        InputError: as `report`.
    """
    from plough_opt.app.report import explored_file

    target = _cached(options.file) if options.output is None else check_file(options.output, "page", ".html")
    problem = read(options)
    with progress() as notify:
        path = explored_file(problem, target, notify, seed=options.seed)
    if options.json:
        print(json.dumps({"wrote": [str(path)]}, indent=2, allow_nan=False))
    elif options.output is None:
        webbrowser.open(f"{path.resolve().as_uri()}#explore")
    wrote(path)


def _cached(file: str) -> Path:
    """Return the path of a file's page in the user's cache folder."""
    digest = hashlib.sha256(str(Path(file).resolve()).encode(errors="surrogateescape")).hexdigest()[:16]
    try:
        return cache_folder() / "pages" / f"{Path(file).stem}-{digest}.html"
    except (OSError, RuntimeError) as error:
        raise InputError(f"there is no cache folder for the page ({error}): give its path by -o FILE.html") from None
