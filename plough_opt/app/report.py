"""`plough-opt report`: everything about a file's best share on one HTML page that loads nothing else; animations."""

import argparse
import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from plough_opt.app.page import Report, design_page, motion_page, page, shown_of
from plough_opt.app.page_model import design_model, frame_model
from plough_opt.app.panels import changing, gif, subject
from plough_opt.app.terminal import progress, read, wrote
from plough_opt.core.checks import check_domain, path_of, whole_number
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.expressions import as_number
from plough_opt.core.files import check_file, write_file
from plough_opt.core.process import optional
from plough_opt.core.quantities import BESIDE
from plough_opt.core.saving import versions
from plough_opt.design import Design, Progress, Sensitivity
from plough_opt.motion import Run
from plough_opt.motion.run import Machine
from plough_opt.motion.scene import Scene
from plough_opt.problem_file import Problem, read_problem
from plough_opt.problem_file.written import problem_of


def report(options: argparse.Namespace) -> None:
    """Optimise a file (or simulate it if it has no variables), and write the page.

    Raises:
        InputError: the file has a mistake, an uncertain soil, or several shares and nothing to minimise, or the page
            cannot be written.
    """
    optional("jinja2")  # before anything is read
    target = check_file(options.output, "page", ".html")
    problem = read(options)
    with progress() as notify:
        path = write_page(problem, target, notify, seed=options.seed)
    if options.json:
        told = {"wrote": [str(path)], "provenance": _provenance(problem, options.seed)}
        print(json.dumps(told, indent=2, allow_nan=False))
    wrote(path)


def explore(
    question: Problem | str | Path | Scene | Design,
    path: str | Path,
    *,
    duration: float | str | None = None,
    seed: int = 0,
) -> Path:
    """Write the page of a question: its report, and controls that compute any other design in the browser.

    Args:
        question: a problem, the path of its file, a numeric scene, or a design, which is solved. The page of a design
            has its variables, parameters, objective and requirements, but not the motions behind them.
        path: path of the page, ending in .html; an existing file is replaced.
        duration: simulated time of a scene [s], or a text such as "2 s"; omit it for a periodic orbit and for a
            problem, which has its own.
        seed: seed of the search's samples.

    Returns:
        The path.

    Raises:
        InputError: the file has a mistake, an uncertain soil, or several shares and nothing to minimise, the scene
            holds symbols or something that cannot be written as a problem file, the duration is missing or given for
            another question, the design has no JavaScript form, or the page cannot be written.
        InfeasibleDesign, NotConverged: as `Design.solve`.

    Example:
        >>> import plough_opt as po
        >>> po.explore("problems/cotton_subsoiler.toml", "out/cotton.html")  # doctest: +SKIP
    """
    target = check_file(path_of("the page", path), "page", ".html")
    whole_number("seed", seed)
    if isinstance(question, Scene):
        time = None if duration is None else float(as_number(BESIDE["scene.duration"].read(duration)))
        known = problem_of(question, time, "A scene of Python")
    elif duration is not None:
        raise InputError("only a scene needs a duration: leave it out, or change the problem or design")
    elif isinstance(question, Design):
        optional("jinja2")
        model = design_model(question)
        return write_file(
            target, "page", design_page(question.solve(seed=seed), model, "A design of Python", _made(seed))
        )
    else:
        known = question if isinstance(question, Problem) else read_problem(question)
    return write_page(known, target, lambda *_: None, seed=seed)


def write_page(problem: Problem, path: Path, notify: Progress, *, seed: int) -> Path:
    """Write the page of a problem; return its path. ``notify`` is told the present step and the fraction done."""
    optional("jinja2")
    _check(problem)
    if problem.shares:
        model = frame_model(problem)  # refused, if at all, before the search
        best, _ = problem.optimise(notify, seed=seed)
        text = design_page(best, model, problem.title, f"{problem.origin.file}, {_made(seed)}")
    else:
        text = page(replace(reported(problem, notify, seed), provenance=_provenance(problem, seed), text=problem.text))
    return write_file(path, "page", text)


def _made(seed: int) -> str:
    return f"plough_opt {versions()['plough_opt']}, seed {seed}"


def _check(problem: Problem) -> None:
    """Raise InputError for a file that a report does not cover."""
    if problem.shares and not (problem.variables and problem.table.minimise):
        raise InputError(
            f"{problem.name}: the page of several shares is that of their design: add [variables] and [minimise], or"
            f" choose one share by --set shares={next(iter(problem.shares))}"
        )
    if problem.table.uncertain is not None:
        raise InputError(
            f"{problem.name}: a report covers one soil: remove the table [uncertain], or use plough-opt optimise"
        )
    if problem.variables and not (problem.table.minimise or problem.table.trade_off):
        raise InputError(f"{problem.name}: nothing to look for: add a table [minimise] or [trade_off]")


def _provenance(problem: Problem, seed: int) -> dict[str, str]:
    """Return heading -> text of everything that identifies how a report was made."""
    changes = {"changed by --set": "; ".join(problem.overrides)} if problem.overrides else {}
    return {
        "file": problem.origin.file,
        "SHA-256 of the file": problem.origin.sha256,
        **changes,
        "seed of the search": str(seed),
        "written": datetime.now().astimezone().isoformat(sep=" ", timespec="minutes"),
        "made by": ", ".join(f"{name} {value}" for name, value in versions().items()),
    }


def reported(problem: Problem, notify: Progress, seed: int = 0) -> Report:
    """Return the contents of a report on one share, without its provenance.

    Args:
        problem: the file.
        notify: called with the present step in words and the fraction done.
        seed: seed of the search's samples.
    """
    best, unknown = None, ""
    run: Run | Machine
    sensitivities: tuple[Sensitivity, ...] = ()
    traded = problem.variables and problem.table.trade_off
    front = problem.trade_off(progress=notify) if traded else None
    if problem.variables and problem.table.minimise:
        best, run = problem.optimise(notify, parameters=True, seed=seed)
        notify("sensitivities", 1.0)
        try:
            sensitivities = best.every_sensitivity()
        except (InputError, NotConverged) as error:
            unknown = str(error)
    else:
        notify("simulating", 0.0)
        run = problem.simulate(None if front is None else shown_of(front).variables)
    assert isinstance(run, Run)  # several shares have a page of their own
    return Report(problem, run, best, sensitivities, unknown, front=front)


def write_animation(run: Run, target: str | Path, slower: float) -> Path:
    """Write the motion of a numeric run: see `Run.animate`."""
    path = path_of("the animation", target)
    check_domain("slower", slower, "times", above=0.0)
    if not changing(run):
        raise InputError("nothing changes over time in this run, so there is no motion to animate")
    if path.suffix.lower() == ".html":
        return write_file(path, "animation", motion_page(run, subject(run).replace("\n", ": ")))
    check_file(path, "animation", ".html", ".gif")
    return write_file(path, "animation", gif(run, slower))
