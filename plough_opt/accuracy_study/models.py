"""Contestants that leave something of the motion out: quasi-static, linearised, harmonic balance, lasting orbit."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

from plough_opt.accuracy import Accuracy
from plough_opt.accuracy_study.contest import Entry, median_time
from plough_opt.accuracy_study.methods import FACTORS, Task, failure, prepared, settings_of
from plough_opt.accuracy_study.reference import Reference, errors_of
from plough_opt.effects import HarmonicBalance
from plough_opt.errors import PloughError
from plough_opt.expressions import as_number
from plough_opt.motion import Run
from plough_opt.motion.plan import forced_rate, numbers_of, steps_for, timeline_of
from plough_opt.motion.quasi_static import quasi_static
from plough_opt.scene import Scene

HARMONICS: Final = (1, 3, 8, 16)
"""Numbers of harmonics tried."""


@dataclass(frozen=True)
class References:
    """What models are measured by; None where there is none.

    Attributes:
        motion: the scene's own motion.
        lasting: the lasting orbit that the scene's motion may tend to.
    """

    motion: Reference | None
    lasting: Reference | None


def lasting_orbit(scene: Scene) -> Scene | None:
    """Return the scene of the lasting orbit of a scene with a strength wave, or None where it can have none."""
    effects = scene.effects
    if effects.strength_wave is None or not effects.motion:
        return None
    try:
        return replace(scene, effects=replace(effects, orbit="periodic", start="equilibrium", tow_ramp=None))
    except PloughError:
        return None


def period_of(scene: Scene) -> float:
    """Return the time [s] in which a share passes one wavelength."""
    wave = scene.effects.strength_wave
    assert wave is not None  # else there is no orbit
    return float(as_number(wave.wavelength)) / float(as_number(scene.tow_speed))


def models(task: Task, references: References) -> Iterator[Entry]:
    """Yield the models; errors called "lasting ..." are those from the averages of the lasting orbit."""
    if task.scene.effects.entry:
        yield failure("model", "quasi-static", "", "has a share that is wholly buried, and so no entry")
    else:
        yield _entry("quasi-static", "", partial(_quasi_static, task), references, task.timing)
    orbit = lasting_orbit(task.scene)
    transient = task.scene.effects.orbit == "transient"
    if orbit is None or (transient and references.lasting is None):
        return
    around = replace(task, scene=orbit, duration=period_of(orbit))
    kinds: list[tuple[str, str, Any]] = [("linearised", "", "linearised")]
    kinds += [("harmonic balance", f"{n} harmonics" if n > 1 else "1 harmonic", HarmonicBalance(n))
              for n in task.some(HARMONICS)]  # fmt: skip
    steps = settings_of(around, "dop853")[-1]
    for name, setting, kind in kinds:
        scene = replace(orbit, effects=replace(orbit.effects, orbit=kind))
        yield _entry(name, setting, partial(prepared, replace(around, scene=scene), steps), references, task.timing)
    if transient:
        for accuracy in settings_of(around, "dop853", FACTORS[2:]):
            one = f"{accuracy.steps} steps"
            yield _entry("lasting orbit", one, partial(prepared, around, accuracy), references, task.timing)


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


def _entry(
    name: str,
    setting: str,
    prepare: Callable[[], tuple[Callable[[], object], Callable[[], Run]]],
    references: References,
    timing: float,
) -> Entry:
    started = time.perf_counter()
    try:
        once, run = prepare()
        built = time.perf_counter() - started
        found = run()
    except (PloughError, RuntimeError) as error:
        return failure("model", name, setting, str(error).splitlines()[-1])
    first = time.perf_counter() - started
    seconds = median_time(once, budget=timing, warm=True)
    return Entry("model", name, setting, seconds, max(built, first - seconds), _errors(found, references))


def _errors(found: Run, references: References) -> Mapping[str, float]:
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
