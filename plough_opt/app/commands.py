"""The commands: each reads, computes and reports; files are written last, when nothing can fail any more."""

import argparse
import dataclasses
import json
import shlex
from pathlib import Path

from plough_opt.app import report
from plough_opt.app.against import asked_of
from plough_opt.app.messages import printable
from plough_opt.app.sensitivity_table import sensitivities_of, with_sensitivities
from plough_opt.app.terminal import console, give, progress, read, wrote
from plough_opt.app.uncertain import optimise_uncertain
from plough_opt.core.errors import InputError
from plough_opt.core.files import write_new
from plough_opt.design.effort import Search
from plough_opt.laws.forces import cone_index
from plough_opt.motion.effect_costs import effect_costs
from plough_opt.problem_file import TEMPLATE
from plough_opt.soil.soil import named_soil, soil_names


def init(options: argparse.Namespace) -> None:
    """Write the template; an existing file is left alone."""
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
        print(json.dumps([{**dataclasses.asdict(soil), "cone_index": cone_index(soil)} for soil in found], indent=2,
                         allow_nan=False))  # fmt: skip
    else:
        report.print_soils(console(), found)


def check(options: argparse.Namespace) -> None:
    """Check a file; print what its scene contains and what its guess is like."""
    against = asked_of(options)
    problem = read(options)
    comparison = None
    if options.against:
        from plough_opt.studies.crosscheck import compare

        comparison = compare(problem.scene(), **against)
    if options.json and (options.effects or comparison is not None):
        raise InputError("--json is of the scene alone: leave --effects and --against out")
    if options.json:
        quantities = {key: float(value) for key, value in problem.values().items()}
        warnings = [text for part in problem.parts.values() for text in part.scene().warnings()]
        notes = (*problem.notes, *problem.cautions, *dict.fromkeys(warnings))
        print(json.dumps({"title": problem.title, "quantities": quantities, "notes": notes}, indent=2, allow_nan=False))
        return
    report.print_check(console(), problem)
    if options.effects:
        with progress() as notify:
            notify("measuring the effects", 0.0)
            found = effect_costs(problem.scene(), problem.values().get("scene.duration"))
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


def simulate(options: argparse.Namespace) -> None:
    """Simulate a file's scene with every variable at its guess."""
    problem = read(options)
    with progress() as notify:
        notify("simulating", 0.0)
        run = problem.machine() if problem.shares else problem.simulate()
    page = report.run_page(problem, run)
    give(options, page, lambda: run.to_json(page), run.plot)


def optimise(options: argparse.Namespace) -> None:
    """Find the best share of a file."""
    problem = read(options)
    if problem.table.uncertain is not None:
        optimise_uncertain(problem, options)
        return
    with progress() as notify:
        best, run = problem.optimise(
            notify,
            parameters=options.sensitivity,
            search=search_of(options.search),
            judge=options.judge,
            seed=options.seed,
        )
        asked = sensitivities_of(best, notify) if options.sensitivity else ()
    best = dataclasses.replace(best, sensitivities=asked)
    page = best.page()
    page = dataclasses.replace(page, parts=(*page.parts, *report.own_results(problem, run)))
    page = with_sensitivities(page, problem, asked)
    give(options, page, lambda: best.to_json(page), best.plot)


def search_of(text: str) -> Search:
    """Return what a text of the command line says of a search: a word, a number of designs, a time, or keys."""
    if text.strip().isdigit():
        return int(text)
    return tuple(part.strip() for part in text.split(",")) if "," in text else text


def tradeoff(options: argparse.Namespace) -> None:
    """Draw the front of the two or three results that a file trades."""
    problem = read(options)
    with progress() as notify:
        front = problem.trade_off(options.points, notify)
    give(options, front.page(), front.to_json, front.plot)
    if options.csv is not None:
        wrote(front.to_csv(options.csv))


def accuracy(options: argparse.Namespace) -> None:
    """Show what accuracy costs in time on a file's scene, with every variable at its guess, or on its design."""
    problem = read(options)
    from plough_opt.studies.accuracy.study import study_accuracy, study_design

    with progress() as notify:
        common = {"wanted": options.error, "title": problem.title, "progress": notify, "thin": options.thin}
        if options.design:
            study = study_design(problem.design()[0], limit=10.0 * options.seconds, **common)
        else:
            duration = problem.values().get("scene.duration")
            study = study_accuracy(problem.scene(), duration, allowance=options.seconds, **common)
    study = dataclasses.replace(study, origin=problem.origin)
    if problem.table.uncertain is not None:
        study = dataclasses.replace(
            study, notes=(*study.notes, "the soil is the nominal one: its uncertainty takes no part")
        )
    give(options, study.page(), study.to_json, study.plot)
