"""Functions `study_accuracy` and `study_design`: what accuracy costs in time, and what to choose."""

import math
import platform
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from typing import TypeVar

from plough_opt.core.checks import (
    check_callable,
    check_domain,
    check_kind,
    check_switch,
    check_text,
    plain_number,
    shown,
)
from plough_opt.core.compiler import interpretation_warning
from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.expressions import as_number, holds_casadi, is_count, map_expressions
from plough_opt.core.process import available
from plough_opt.core.quantities import BESIDE
from plough_opt.core.saving import versions
from plough_opt.design import Design, Progress
from plough_opt.design.exploring import silent
from plough_opt.motion.methods import DEFAULT_ERROR
from plough_opt.motion.plan import MOST_OUTPUTS
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.methods import Task, gradients, integrators, models, periodic_orbit_of
from plough_opt.studies.accuracy.optimum import DEFAULT, best_of, reference_optimum, search_trials
from plough_opt.studies.accuracy.reference import HAS_EXTENDED, Reference, reference_gradient, reference_run
from plough_opt.studies.accuracy.result import (
    AUTO,
    DERIVATIVES,
    LASTING,
    MOTION,
    OPTIMUM,
    SEARCH,
    VARIABLES,
    AccuracyStudy,
    Entry,
)

OUTPUTS = 40
"""Default number of intervals between output times: few, so that coarse steps can compete."""

ALLOWANCE = 1.0
"""Default time that one use of a method may take [s]."""

_T = TypeVar("_T")


def study_accuracy(
    scene: Scene,
    duration: float | None = None,
    *,
    wanted: float = 1e-6,
    outputs: int = OUTPUTS,
    allowance: float = ALLOWANCE,
    derivatives: bool = True,
    thin: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return error against time of every method and model that can simulate a scene.

    Args:
        scene: scene with numbers. If its orbit is approximate, such as "linearised", all methods are measured against
            the periodic orbit.
        duration: simulated time [s]; None for a periodic orbit.
        wanted: relative error that the advice is for [-], from 1e-15 to 0.1.
        outputs: number of equal intervals between output times, at which mount forces are compared.
        allowance: time that one use of a method may take [s]; slower settings are left out, with an entry that says so.
        derivatives: whether to measure derivatives of the averages too.
        thin: whether to leave out every other setting except the finest; the advice stays the same.
        title: title of the scene, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the scene holds symbols, the duration is missing or is given for a periodic orbit, an argument has
            the wrong type, or ``outputs`` is out of range.
        DomainError: the duration, the wanted error or the allowance is out of range.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False).duration
        0.1
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    _check(wanted, title, progress, derivatives=derivatives, thin=thin)
    if holds_casadi(scene):
        scene = map_expressions(scene, lambda value: float(as_number(value)))
    check_domain("time allowed to a method", plain_number("allowance", allowance), "s", above=0.0)
    if not is_count(outputs) or outputs > MOST_OUTPUTS:
        raise InputError(f"outputs = {shown(outputs)} must be a whole number from 1 to {MOST_OUTPUTS}")
    if scene.effects.orbit != "transient":
        if duration is not None:
            raise InputError(
                "duration must be omitted for a periodic orbit, whose duration is one wavelength of the soil strength"
            )
        scene = replace(scene, effects=replace(scene.effects, orbit="periodic"))
        duration = float(as_number(scene.wave_period))
    if duration is None:
        raise InputError("the duration is missing: give the time to simulate in seconds")
    duration = plain_number("duration", BESIDE["scene.duration"].read(duration))
    task = Task(scene, float(duration), int(outputs), float(allowance), thin, wanted)
    entries, floors, notes = _contests(task, progress or silent, derivatives=derivatives)
    return AccuracyStudy(
        title=title,
        duration=task.duration,
        wanted=wanted,
        entries=tuple(entries),
        floors=floors,
        notes=tuple(notes),
        defaults={MOTION: (AUTO, f"error {DEFAULT_ERROR:.0e}"), DERIVATIVES: (AUTO, "default")},
        versions=_versions(),
    )


def study_design(
    design: Design,
    *,
    wanted: float = 1e-6,
    limit: float = 10.0,
    thin: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return error of the optimum against time of searches of growing effort, interpreted and compiled.

    Every effort is an argument of `Design.solve`, with several seeds and the declared values of the parameters. The
    study also reports how often each effort finds the best optimum that any of them finds.

    Args:
        design: design with an objective.
        wanted: relative error of objective and variables that the advice is for [-], from 1e-15 to 0.1.
        limit: time of one search [s] above which an effort is tried with one seed only, and larger ones not at all.
        thin: whether to take fewer seeds.
        title: title of the design, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the design has no objective or no variables.
        DomainError: an argument is outside its range.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser stopped without an optimum.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search="near")
        >>> study = po.study_design(design, thin=True)  # doctest: +SKIP
    """
    check_kind("the design", design, Design, "a Design")
    _check(wanted, title, progress, thin=thin)
    check_domain("time allowed to a search", plain_number("limit", limit), "s", above=0.0)
    trials = search_trials(design, limit=limit, thin=thin, progress=progress or silent)
    best, entries, floors, notes = best_of(trials), list[Entry](), dict[str, float](), list[str]()
    try:
        reference = reference_optimum(design.declared, best)
        # More effort does not always take longer; the advice takes entries of a method from the cheapest on.
        entries = sorted((trial.entry(reference) for trial in trials), key=lambda entry: entry.seconds)
        floors = {OPTIMUM: reference.floor, VARIABLES: reference.off}
    except PloughError as error:
        notes.append(f"no reference for the optimum: {error}")
    if all(trial.method != "compiled" for trial in trials):
        entries.append(Entry(SEARCH, "compiled", "", math.inf, failure=interpretation_warning()))
    return AccuracyStudy(
        title=title,
        duration=None,
        wanted=wanted,
        entries=tuple(entries),
        floors=floors,
        notes=tuple(notes),
        defaults=dict.fromkeys(floors, DEFAULT),
        versions=_versions(),
        thoroughness=tuple(trial.thoroughness(best) for trial in trials if trial.method == DEFAULT[0]),
    )


def _contests(task: Task, progress: Progress, *, derivatives: bool) -> tuple[list[Entry], dict[str, float], list[str]]:
    """Return the entries of all contests for a scene; by name of the reference its error; and notes.

    Notes say what has no reference.
    """
    scene, entries, floors, notes = task.scene, list[Entry](), dict[str, float](), list[str]()
    if not scene.effects.motion:
        return [], {}, ["a quasi-static scene has no motion to integrate, and so there is no method to choose"]

    def found(name: str, find: Callable[[], _T]) -> _T | None:
        try:
            return find()
        except PloughError as error:
            notes.append(f"no reference for the {name}: {error}")
            return None

    def reference(name: str, of: Scene, duration: float | None) -> Reference | None:
        run = found(name, partial(reference_run, of, duration, outputs=task.outputs))
        if run is not None:
            floors.update({name: run.errors["averages"], f"{name}, trajectory": run.errors["trajectory"]})
        return run

    progress("integrating the reference", 0.0)
    own, around = reference(MOTION, scene, task.given), periodic_orbit_of(scene)
    transient = scene.effects.orbit == "transient"
    periodic = reference(LASTING, around, None) if transient and around is not None else None
    if own is not None:
        progress("integrators", 0.1)
        entries += integrators(task, own)
    if own is not None or periodic is not None:
        progress("models", 0.5)
        entries += models(task, own, periodic)
    if derivatives:
        progress("derivatives", 0.7)
        gradient = found(DERIVATIVES, partial(reference_gradient, scene, task.given))
        if gradient is not None:
            floors[DERIVATIVES] = gradient.error
            entries += gradients(task, gradient)
    if not HAS_EXTENDED:
        notes.append("this machine has no floats wider than a double, so the references are not more exact")
    return entries, floors, notes


def _versions() -> dict[str, str]:
    """Return versions of packages, and the machine."""
    return {
        **versions(),
        "scipy": version("scipy"),
        "platform": platform.platform(),
        "processors": str(available()),
    }


def _check(wanted: float, title: str, progress: Progress | None, **switches: bool) -> None:
    """Raise InputError or DomainError if an argument has the wrong type or the wanted error is out of range."""
    check_text("title", title)
    if progress is not None:
        check_callable("progress", progress, "of what is being done and the fraction done")
    for name, value in switches.items():
        check_switch(name, value)
    check_domain("wanted error", plain_number("wanted", wanted), at_least=1e-15, at_most=0.1)
