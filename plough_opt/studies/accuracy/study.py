"""Functions `study_accuracy` and `study_design`: what accuracy costs in time, and which method to choose."""

import contextlib
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from statistics import median
from typing import Final, TypeVar

from plough_opt.core.checks import (
    check_callable,
    check_domain,
    check_kind,
    check_switch,
    check_text,
    plain_number,
    shown,
)
from plough_opt.core.errors import InfeasibleDesign, InputError, NotConverged, PloughError
from plough_opt.core.expressions import as_number, holds_casadi, is_count, map_expressions
from plough_opt.core.process import available
from plough_opt.core.quantities import BESIDE
from plough_opt.core.saving import versions
from plough_opt.design import Design, Optimum, Progress
from plough_opt.design.effort import Search
from plough_opt.design.exploring import silent
from plough_opt.laws.cones import ElasticMedium
from plough_opt.laws.forces import PlasticGas
from plough_opt.motion.accuracy import DEFAULT_ERROR
from plough_opt.motion.plan import MOST_OUTPUTS
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.contest import Entry
from plough_opt.studies.accuracy.methods import AUTO, Task, gradients, integrators, models, periodic_orbit_of
from plough_opt.studies.accuracy.optimum import GRADIENT, VARIABLES, design_contest
from plough_opt.studies.accuracy.quadratures import density_profile, elastic_contact, quasi_static_course
from plough_opt.studies.accuracy.reference import Reference, reference_gradient, reference_run
from plough_opt.studies.accuracy.result import (
    CONTACT,
    COURSE,
    DERIVATIVES,
    LASTING,
    MOTION,
    OPTIMUM,
    PROFILE,
    AccuracyStudy,
    Thoroughness,
)
from plough_opt.studies.accuracy.wide import WIDER

OUTPUTS = 40
"""Default number of intervals between output times: few, so that coarse steps can compete."""

ALLOWANCE = 1.0
"""Default time that one use of a method may take [s]."""

# Efforts of the searches, from the basin of the guess to four times the default.
_EFFORTS: Final[tuple[Search, ...]] = ("near", 250, 1000, "auto", "thorough")
# Number of seeds for each effort, and in a thin study.
_SEEDS, _THIN_SEEDS = 8, 3
# Objectives or medians with a smaller relative difference belong to the same optimum: medians come from rough runs.
_SAME = 1e-5

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
    """Return error against time of every method, model and quadrature that can simulate a scene.

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
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01).duration
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
    entries, floors, defaults, notes = _contests(task, progress or silent, derivatives=derivatives)
    return AccuracyStudy(
        title=title,
        duration=task.duration,
        wanted=wanted,
        entries=tuple(entries),
        floors=floors,
        notes=tuple(notes),
        defaults=defaults,
        versions=_versions(),
    )


def study_design(
    design: Design,
    *,
    wanted: float = 1e-6,
    limit: float = 10.0,
    near: bool = False,
    thin: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return error of the optimum against time of every transcription, integrator and kind of derivative.

    Each method solves the design locally from the same start, with the declared values of the parameters. In addition
    the study reports what a thorough search costs: how often searches of growing effort, with different seeds, find the
    best optimum that any of them finds.

    Args:
        design: design with an objective.
        wanted: relative error of the objective that the advice is for [-], from 1e-15 to 0.1.
        limit: time after which a solve is given up [s]; its entry says so.
        near: whether to start near the optimum, as after a small change of parameters, instead of at the guess.
        thin: whether to leave out every other setting of a method.
        title: title of the design, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the design has no objective or no variables.
        DomainError: an argument is outside its range.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the reference was not found.

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
    _check(wanted, title, progress, near=near, thin=thin)
    check_domain("time allowed to a solve", plain_number("limit", limit), "s", above=0.0)
    progress = progress or silent
    found = design_contest(design, wanted=wanted, limit=limit, near=near, thin=thin, progress=progress)
    ours = [(e.method, e.setting) for e in found.entries if (e.family, e.method) == ("derivatives", GRADIENT)]
    return AccuracyStudy(
        title=title,
        duration=None,
        wanted=wanted,
        entries=found.entries,
        floors={OPTIMUM: found.best.floor, f"{OPTIMUM}, {VARIABLES}": found.best.off},
        defaults={OPTIMUM: ours[0]},
        versions=_versions(),
        thoroughness=_thoroughness(design, limit=limit, thin=thin, progress=progress),
    )


def _contests(
    task: Task, progress: Progress, *, derivatives: bool
) -> tuple[list[Entry], dict[str, float], dict[str, tuple[str, str]], list[str]]:
    """Return the entries of all contests for a scene; by name of the reference its error and the default; and notes.

    Notes say what has no reference.
    """
    scene, entries, floors, notes = task.scene, list[Entry](), dict[str, float](), list[str]()
    defaults = {MOTION: (AUTO, f"error {DEFAULT_ERROR:.0e}"), DERIVATIVES: (AUTO, "default")}

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

    if scene.effects.motion:
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
            progress("derivatives", 0.6)
            gradient = found(DERIVATIVES, partial(reference_gradient, scene, task.given))
            if gradient is not None:
                floors[DERIVATIVES] = gradient.error
                entries += gradients(task, gradient)
        if not WIDER:
            notes.append("this machine has no floats wider than a double, so the references are not more exact")
    quadratures = {
        COURSE: (quasi_static_course, not scene.effects.motion and not isinstance(scene.law, ElasticMedium)),
        CONTACT: (elastic_contact, not scene.effects.motion and isinstance(scene.law, ElasticMedium)),
        PROFILE: (density_profile, scene.soil.density_profile is not None and isinstance(scene.law, PlasticGas)),
    }
    progress("quadratures", 0.9)
    for name, (measure, takes_part) in quadratures.items():
        result = found(name, partial(measure, task)) if takes_part else None
        if result is not None:
            entries += result[0]
            floors[name], defaults[name] = result[1:]
    return entries, floors, defaults, notes


def _thoroughness(design: Design, *, limit: float, thin: bool, progress: Progress) -> tuple[Thoroughness, ...]:
    """Return success and time of each effort of a search.

    A search is right if it finds the best optimum that any of the searches found, since no other truth is known.

    Args:
        design: design with an objective.
        limit: time of one search [s] above which an effort is tried with one seed only, and larger ones not at all.
        thin: whether to take fewer seeds.
        progress: called with what is being done and the fraction done.

    Raises:
        InfeasibleDesign: no search found a design that meets the requirements.
    """
    design.solve(search="near")  # builds the program, which all searches share
    found: dict[Search, list[tuple[Optimum | None, float]]] = {}
    for number, search in enumerate(_EFFORTS):
        progress(f"searching: {search}", number / len(_EFFORTS))
        runs = found[search] = [_solved(design, search, 0)]
        too_long = runs[0][1] > limit
        seeds = 1 if search == "near" or too_long else _THIN_SEEDS if thin else _SEEDS
        runs += [_solved(design, search, seed) for seed in range(1, seeds)]
        if too_long:
            break
    best = min(_ranked_value(one) for runs in found.values() for one, _ in runs if one is not None)
    return tuple(
        Thoroughness(
            search=f"{search} designs" if isinstance(search, int) else str(search),
            designs=int(median([one.search.designs for one, _ in runs if one and one.search] or [0])),
            asked=len(runs),
            right=sum(one is not None and _ranked_value(one) <= best + _SAME * abs(best) for one, _ in runs),
            seconds=median(seconds for _, seconds in runs),
        )
        for search, runs in found.items()
    )


def _solved(design: Design, search: Search, seed: int) -> tuple[Optimum | None, float]:
    """Return the optimum that a search finds, or None, and its time [s]."""
    began, best = time.perf_counter(), None
    with contextlib.suppress(InfeasibleDesign, NotConverged):
        best = design.solve(search=search, seed=seed)
    return best, time.perf_counter() - began


def _ranked_value(best: Optimum) -> float:
    """Return the value by which `Design.solve` ranks optima: the median over tolerances, or else the objective."""
    return best.objective if best.spread is None else best.spread.median


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
