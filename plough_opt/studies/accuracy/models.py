"""Contestants that leave something of the motion out: quasi-static, linearised, harmonic balance, lasting orbit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeAlias

from plough_opt.core.errors import PloughError
from plough_opt.core.expressions import as_number
from plough_opt.motion import Run
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.effects import HarmonicBalance
from plough_opt.motion.plan import forced_rate, numbers_of, steps_for, timeline_of
from plough_opt.motion.quasi_static import quasi_static
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.contest import Entry
from plough_opt.studies.accuracy.methods import Task, failure, prepared, settings_of, text
from plough_opt.studies.accuracy.reference import Reference, errors_of
from plough_opt.studies.accuracy.tracks import Track, measured

HARMONICS: Final = (1, 3, 8, 16)
"""Numbers of harmonics tried."""


_Prepared: TypeAlias = tuple[Callable[[], object], Callable[[], Run]]
_Errors: TypeAlias = Callable[[Run], Mapping[str, float]]


@dataclass(frozen=True)
class References:
    """References for models; None if there is none.

    Attributes:
        motion: the scene's own motion.
        lasting: the lasting orbit that the scene's motion may tend to.
    """

    motion: Reference | None
    lasting: Reference | None


def lasting_orbit(scene: Scene) -> Scene | None:
    """Return the scene of the lasting orbit of a scene with one strength wave, or None where it can have none."""
    effects = scene.effects
    if len(effects.waves) != 1 or not effects.motion:
        return None
    try:
        return replace(scene, effects=replace(effects, orbit="periodic", start="equilibrium", tow_ramp=None))
    except PloughError:
        return None


def period_of(scene: Scene) -> float:
    """Return the time [s] in which a share passes one wavelength."""
    return float(as_number(scene.wave_period))


def models(task: Task, references: References) -> list[Entry]:
    """Return the models; errors called "lasting ..." are those from the averages of the lasting orbit."""
    errors = partial(_errors, references)
    still = "quasi-static"
    if task.scene.effects.entry:
        first = [failure("model", still, "", "has a share that is wholly buried, and so no entry")]
        tracks = []
    else:
        first, tracks = [], [_single(still, lambda _: _quasi_static(task), errors)]
    orbit = lasting_orbit(task.scene)
    transient = task.scene.effects.orbit == "transient"
    if orbit is not None and not (transient and references.lasting is None):
        tracks += _around(replace(task, scene=orbit, duration=period_of(orbit)), errors, transient=transient)
    key = "lasting averages" if transient else "averages"
    return [*first, *measured(tracks, key, task.wanted, task.allowance)]


def _around(task: Task, errors: _Errors, *, transient: bool) -> Iterator[Track]:
    """Yield what computes a lasting orbit; shooting itself only beside a motion from a start."""
    steps = settings_of(task, "dop853")[0][-1]

    def prepare(kind: Any) -> _Prepared:
        effects = replace(task.scene.effects, orbit=kind)
        return prepared(replace(task, scene=replace(task.scene, effects=effects)), steps)

    yield _single("linearised", lambda _: prepare("linearised"), errors)
    shown = tuple(count - 1 for count in task.some(HARMONICS))
    yield Track(
        family="model",
        method="harmonic balance",
        rungs=tuple(range(1, HARMONICS[-1] + 1)),
        shown=shown,
        label=lambda count: f"{count} harmonics" if count > 1 else "1 harmonic",
        prepare=lambda count: prepare(HarmonicBalance(count)),
        errors=errors,
    )
    if transient:
        rungs, places = settings_of(task, "dop853")
        yield Track("model", "lasting orbit", rungs, places, text, partial(prepared, task), errors)


def _single(name: str, prepare: Callable[[Any], _Prepared], errors: _Errors) -> Track:
    return Track("model", name, (None,), (0,), lambda _: "", prepare, errors)


def _quasi_static(task: Task) -> tuple[Callable[[], object], Callable[[], Run]]:
    """Return the quasi-static limit of a scene, over the same time."""
    effects = replace(
        task.scene.effects, motion=False, start="equilibrium", damping=None, contact="resisting", orbit="transient"
    )
    scene = replace(task.scene, effects=effects)
    steps = steps_for(forced_rate(numbers_of(scene)) * task.duration)
    timeline = timeline_of(scene, task.duration, task.outputs, steps)

    def run() -> Run:
        return quasi_static(scene, task.duration, timeline, Accuracy())

    return run, run


def _errors(references: References, found: Run) -> Mapping[str, float]:
    """Return the errors from both references; mount forces are compared where the outputs are the same times."""
    errors: dict[str, float] = {}
    for prefix, reference in (("", references.motion), ("lasting ", references.lasting)):
        if reference is None:
            continue
        same = len(found.time) == len(reference.time) and abs(found.time[-1] - reference.time[-1]) < 1e-9
        for name, error in errors_of(found, reference).items():
            if same or name in ("averages", "mean draft", "RMS"):
                errors[prefix + name] = error
    return errors
