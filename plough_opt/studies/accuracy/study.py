"""Time that accuracy costs, for a scene or a design: the efficient methods, and which one to choose."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version

from plough_opt.core.domain import check_domain, check_text, plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number, holds_casadi, is_count, map_expressions
from plough_opt.core.kinds import check_callable, check_kind, check_switch, shown
from plough_opt.core.origin import versions
from plough_opt.core.processors import available
from plough_opt.core.quantities import BESIDE
from plough_opt.design import Design
from plough_opt.laws.elastic_medium import ElasticMedium
from plough_opt.motion.accuracy import DEFAULT_ERROR
from plough_opt.motion.plan import MOST_OUTPUTS, forced_rate, numbers_of, steps_for
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.methods import Task
from plough_opt.studies.accuracy.models import period_of
from plough_opt.studies.accuracy.optimum import GRADIENT, VARIABLES, design_contest
from plough_opt.studies.accuracy.result import OPTIMUM, AccuracyStudy
from plough_opt.studies.accuracy.scenes import CONTACT, COURSE, DERIVATIVES, MOTION, PROFILE, Told, contest
from plough_opt.studies.accuracy.thoroughness import thoroughness

OUTPUTS = 40
"""Default number of intervals between output times: few, so that coarse steps can take part."""

ALLOWANCE = 1.0
"""Default time [s] that one use of a contestant may take."""


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
    progress: Told | None = None,
) -> AccuracyStudy:
    """Measure error against time of every method, model and quadrature that can do a scene.

    Args:
        scene: numeric. A stand-in for a lasting orbit is measured with all others against that orbit.
        duration: simulated time [s]; None for a lasting orbit.
        wanted: relative error that the advice is about [-], from 1e-15 to 0.1.
        outputs: number of equal intervals between output times, at which mount forces are compared.
        allowance: time [s] that one use of a contestant may take; what would take longer is left out and says so.
        derivatives: whether derivatives of the averages take part.
        thin: leave out every other setting but the finest; what is advised is the same.
        title: of the scene, for reports.
        progress: called with what is being done and with the part that is done.

    Raises:
        InputError: symbols in the scene, or a setting outside its range.
        DomainError: the duration is not positive.
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    _check_said(title, progress, derivatives=derivatives, thin=thin)
    if holds_casadi(scene):
        scene = map_expressions(scene, lambda value: float(as_number(value)))
    check_domain("wanted error", plain_number("wanted", wanted), at_least=1e-15, at_most=0.1)
    check_domain("time allowed to a contestant", plain_number("allowance", allowance), "s", above=0.0)
    if not is_count(outputs) or outputs > MOST_OUTPUTS:
        raise InputError(f"outputs = {shown(outputs)} must be a whole number from 1 to {MOST_OUTPUTS}")
    if scene.effects.orbit != "transient":
        if duration is not None:
            raise InputError("a lasting orbit has a duration of its own, one wavelength of the soil: leave it out")
        scene = replace(scene, effects=replace(scene.effects, orbit="periodic"))
        duration = period_of(scene)
    if duration is None:
        raise InputError("the duration is missing: how long shall the scene be simulated, in seconds?")
    BESIDE["scene.duration"].check(plain_number("duration", duration))
    task = Task(scene, float(duration), int(outputs), float(allowance), thin, wanted)
    found = contest(task, derivatives=derivatives, told=progress)
    return AccuracyStudy(
        title=title,
        duration=task.duration,
        wanted=wanted,
        entries=found.entries,
        floors=found.floors,
        notes=found.notes,
        defaults=dict(_defaults(task)),
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
    progress: Told | None = None,
) -> AccuracyStudy:
    """Measure error of the optimum against time of every transcription, integrator and kind of derivative.

    Each solves the design locally from the same start, with the declared values of its parameters. Beside them stands
    what the thoroughness of a search costs: how often searches of growing effort, with seeds of their own, come to the
    best that any of them finds.

    Args:
        design: with something to minimise.
        wanted: relative error of the objective that the advice is about [-], from 1e-15 to 0.1.
        limit: time [s] after which a solve is given up; its row says so.
        near: start beside the optimum, as a solve with slightly changed parameters would, instead of at the guess.
        thin: leave out every other setting of a method.
        title: of the design, for reports.
        progress: called with what is being done and with the part that is done.

    Raises:
        InputError: nothing to minimise or to vary.
        DomainError: a setting outside its range.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the reference was not found.
    """
    check_kind("the design", design, Design, "a Design")
    _check_said(title, progress, near=near, thin=thin)
    check_domain("wanted error", plain_number("wanted", wanted), at_least=1e-15, at_most=0.1)
    check_domain("time allowed to a solve", plain_number("limit", limit), "s", above=0.0)
    found = design_contest(design, limit=limit, near=near, thin=thin, progress=progress)
    ours = [(e.method, e.setting) for e in found.entries if (e.family, e.method) == ("derivatives", GRADIENT)]
    return AccuracyStudy(
        title=title,
        duration=None,
        wanted=wanted,
        entries=found.entries,
        floors={OPTIMUM: found.optima[0].floor, f"{OPTIMUM}, {VARIABLES}": found.optima[0].off},
        defaults={OPTIMUM: ours[0]},
        versions=_versions(),
        thoroughness=thoroughness(design, limit=limit, thin=thin, told=progress),
    )


def _defaults(task: Task) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the default method for each reference."""
    yield MOTION, ("auto", f"error {DEFAULT_ERROR:.0e}")
    yield DERIVATIVES, ("auto", "default")
    yield CONTACT, ("graded cells", "")
    profile = task.scene.soil.density_profile
    if profile is not None:
        yield PROFILE, ("density profile", f"order {profile.order}")
    if not task.scene.effects.motion and not isinstance(task.scene.law, ElasticMedium):
        panels = max(task.outputs, steps_for(forced_rate(numbers_of(task.scene)) * task.duration))
        yield COURSE, ("quasi-static", f"10 points in each of {panels} panels")


def _versions() -> dict[str, str]:
    """Return versions and machine."""
    return {
        **versions(),
        "scipy": version("scipy"),
        "platform": platform.platform(),
        "processors": str(available()),
    }


def _check_said(title: str, progress: Told | None, **switches: bool) -> None:
    """Raise InputError for a title, a progress function or a switch of the wrong type."""
    check_text("title", title)
    if progress is not None:
        check_callable("progress", progress, "of what is done and the part done")
    for name, value in switches.items():
        check_switch(name, value)
