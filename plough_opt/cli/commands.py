"""What each command does: read, compute, report; files are written last, when nothing can fail any more."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from plough_opt import design as designs
from plough_opt.cli import report
from plough_opt.cli.against import asked_of
from plough_opt.cli.sensitivity_table import print_sensitivities, sensitivities_of
from plough_opt.effect_costs import effect_costs
from plough_opt.errors import InputError
from plough_opt.problem_file import TEMPLATE, Problem, read_problem
from plough_opt.soil import named_soil, soil_names


def init(options: argparse.Namespace) -> None:
    """Write the template; an existing file is left alone."""
    path = Path(options.file)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(TEMPLATE)
    except FileExistsError:
        raise InputError(f"'{path}' exists already and is left as it is: name another file") from None
    except OSError as error:
        raise InputError(f"'{path}' cannot be written: {error.strerror}") from None
    _console().print(f"wrote {path}; next: plough-opt optimise {path}", markup=False)


def soils(options: argparse.Namespace) -> None:
    """List the named soils."""
    found = [named_soil(name) for name in soil_names()]
    if options.json:
        print(json.dumps([dataclasses.asdict(soil) for soil in found], indent=2))
    else:
        report.print_soils(_console(), found)


def check(options: argparse.Namespace) -> None:
    """Say whether a file is right, what its scene contains and what its guess is like."""
    against = asked_of(options)
    problem = _read(options)
    comparison = None
    if options.against:
        from plough_opt.crosscheck import compare

        comparison = compare(problem.scene(), **against)
    report.print_check(_console(), problem)
    if options.effects:
        with _progress() as told:
            told("measuring the effects", 0.0)
            found = effect_costs(problem.scene(), problem.values().get("scene.duration"))
        report.print_effects(_console(), found)
    if comparison is not None:
        report.print_comparison(_console(), comparison)
        if options.plot is not None:
            comparison.plot(options.plot)
            _wrote(Path(options.plot))


def simulate(options: argparse.Namespace) -> None:
    """Simulate a file's scene with every variable at its guess."""
    problem = _read(options)
    with _progress() as told:
        told("simulating", 0.0)
        run = problem.simulate()
    if options.json:
        from plough_opt.results import SavedRun

        print(SavedRun.of(run, problem.title).to_json())
    else:
        report.print_run(_console(), problem, run)
    if options.plot:
        from plough_opt import plots

        _wrote(plots.save(plots.plot_run(run), options.plot))


def optimise(options: argparse.Namespace) -> None:
    """Find the best share of a file."""
    problem = _read(options)
    with _progress() as told:
        best, run = problem.optimise(told, parameters=options.sensitivity)
        asked = sensitivities_of(best, told) if options.sensitivity else ()
    if options.json:
        from plough_opt.results import SavedOptimum

        print(SavedOptimum.of(best, run, problem.title, asked).to_json())
    else:
        report.print_optimum(_console(), problem, best, run)
        if options.sensitivity:
            print_sensitivities(_console(), problem, asked)
    if options.plot:
        from plough_opt import plots

        _wrote(plots.save(plots.plot_optimum(best, run), options.plot))


def tradeoff(options: argparse.Namespace) -> None:
    """Draw the front of the two results that a file trades."""
    problem = _read(options)
    for kind, name in (("table", options.csv), ("output", options.output)):
        if name is not None and Path(name).is_dir():
            raise InputError(f"the {kind} '{name}' is a folder: name a file in it")
    with _progress() as told:
        front = problem.trade_off(options.points, told)
    if options.json:
        print(front.to_json())
    else:
        report.print_front(_console(), problem, front)
    if options.plot is not None:
        from plough_opt import plots

        _wrote(plots.save(front.plot(), options.plot))
    if options.csv is not None:
        _wrote(front.to_csv(options.csv))
    if options.output is not None:
        _wrote(front.save(options.output))


def accuracy(options: argparse.Namespace) -> None:
    """Show what accuracy costs in time on a file's scene, with every variable at its guess, or on its design."""
    problem = _read(options)
    if options.output is not None and Path(options.output).is_dir():
        raise InputError(f"the output '{options.output}' is a folder: name a file in it")
    from plough_opt.accuracy_study.study import study_accuracy, study_design

    with _progress() as told:
        common = {"wanted": options.error, "title": problem.title, "progress": told}
        if options.design:
            study = study_design(problem.design()[0], limit=10.0 * options.seconds, **common)
        else:
            duration = problem.values().get("scene.duration")
            study = study_accuracy(problem.scene(), duration, allowance=options.seconds, thin=options.thin, **common)
    report.print_accuracy(_console(), study)
    if options.plot is not None:
        from plough_opt import plots

        _wrote(plots.save(study.plot(), options.plot))
    if options.output is not None:
        _wrote(study.save(options.output))


def _read(options: argparse.Namespace) -> Problem:
    """Read the problem file; refuse an impossible plot before anything is computed."""
    problem = read_problem(options.file, options.set)
    if getattr(options, "plot", None) is not None:
        from plough_opt import plots

        plots.check_format(options.plot)
    for note in problem.notes:
        Console(stderr=True).print(f"note: {note}", markup=False)
    return problem


def _console() -> Console:
    """Return where results go; as wide as its tables need when it is no terminal."""
    console = _Console(highlight=False)
    return console if console.is_terminal else _Console(highlight=False, width=120)


class _Console(Console):
    """A console that leaves a closed pipe to `main`, which knows the exit status."""

    def on_broken_pipe(self) -> None:
        """Let the error pass."""
        raise BrokenPipeError


def _wrote(path: Path) -> None:
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"wrote {path}", markup=False)


@contextmanager
def _progress() -> Iterator[designs.Progress]:
    """Show on the terminal's error stream what is being done, and how long it has taken."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)
