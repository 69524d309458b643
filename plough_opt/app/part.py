"""Options of `plough-opt export --to stl | gltf | dxf | step`, and the best design of a file, whose part is written."""

import argparse
from collections.abc import Callable
from typing import Final

from plough_opt.app.terminal import progress
from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit
from plough_opt.motion import Run
from plough_opt.motion.scene import Scene
from plough_opt.problem_file import Problem

_UNITS: Final = {"opening": Unit("rad"), "thickness": Unit("m")}


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of a part."""
    verb.add_argument(
        "--opening",
        metavar='"90 deg"',
        help="of a part: angle between the share's faces (default: at which the block weighs what the model counts)",
    )
    verb.add_argument("--thickness", metavar='"10 mm"', help="of a part: bent from plate (default: a block)")
    verb.add_argument("--body", choices=("share", "cone"), help="of a part: which body (default: share)")
    verb.add_argument(
        "--at",
        choices=("best", "guess"),
        help="of a part: the best design, or the variables' guesses (default: best where the file minimises)",
    )


def in_si(name: str, written: str | None) -> str | float | None:
    """Return an option's value, that of a quantity in SI units.

    Raises:
        InputError: not a quantity of its kind.
    """
    if written is None or name not in _UNITS:
        return written
    try:
        return _UNITS[name].parse(written)
    except InputError as error:
        raise InputError(f"--{name} {error}") from None


def best_of(problem: Problem, at: str | None) -> Callable[[], Scene] | None:
    """Return what searches the scene of a file's best design, or None where no search is asked for."""
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
