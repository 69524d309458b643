"""Contestants that leave something of the motion out: quasi-static, linearised, harmonic balance, lasting orbit."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final

from plough_opt.core.errors import PloughError
from plough_opt.core.expressions import as_number
from plough_opt.motion import Run
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.assembly import quasi_static
from plough_opt.motion.effects import HarmonicBalance
from plough_opt.motion.plan import forced_rate, numbers_of, steps_for, timeline_of
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.contest import Entry, Track, failure
from plough_opt.studies.accuracy.methods import Prepared, Task, prepared, settings_of, text
from plough_opt.studies.accuracy.reference import Reference, errors_of

HARMONICS: Final = (1, 3, 8, 16)
"""Numbers of harmonics tried."""


def lasting_orbit(scene: Scene) -> Scene | None:
    """Return the scene of the lasting orbit of a scene with one strength wave, or None where it can have none."""
    effects = scene.effects
    if len(effects.waves) != 1 or not effects.motion:
        return None
    try:
        return replace(scene, effects=replace(effects, orbit="periodic", start="equilibrium", tow_ramp=None))
    except PloughError:
        return None


def models(task: Task, motion: Reference | None, lasting: Reference | None) -> list[Entry]:
    """Return the models; errors called "lasting ..." are those from the averages of the lasting orbit.

    Args:
        task: the scene, and how long.
        motion: the scene's own motion, or None if there is no reference of it.
        lasting: the lasting orbit that the scene's motion may tend to, or None.
    """

    def errors(found: Run) -> Mapping[str, float]:
        return _errors("", found, motion) | _errors("lasting ", found, lasting)

    refused, tracks = [], []
    if task.scene.effects.entry:
        refused.append(failure("model", "quasi-static", "has a share that is wholly buried, and so no entry"))
    else:
        tracks.append(Track("model", "quasi-static", lambda _: _quasi_static(task), errors))
    orbit = lasting_orbit(task.scene)
    transient = task.scene.effects.orbit == "transient"
    if orbit is not None and not (transient and lasting is None):
        around = replace(task, scene=orbit, duration=float(as_number(orbit.wave_period)))
        tracks += _around(around, errors)
        if transient:
            rungs, shown = settings_of(around, "dop853")
            tracks.append(Track("model", "lasting orbit", partial(prepared, around), errors, rungs, shown, text))
    return [*refused, *task.ranked(tracks, "lasting averages" if transient else "averages")]


def _around(task: Task, errors: Callable[[Run], Mapping[str, float]]) -> list[Track]:
    """Return what stands in for a lasting orbit."""
    steps = settings_of(task, "dop853")[0][-1]

    def prepare(kind: Any) -> Prepared:
        effects = replace(task.scene.effects, orbit=kind)
        return prepared(replace(task, scene=replace(task.scene, effects=effects)), steps)

    balances = tuple(map(HarmonicBalance, range(1, HARMONICS[-1] + 1)))
    shown = tuple(count - 1 for count in task.some(HARMONICS))
    return [
        Track("model", "linearised", lambda _: prepare("linearised"), errors),
        Track("model", "harmonic balance", prepare, errors, balances, shown, _counted),
    ]


def _counted(balance: HarmonicBalance) -> str:
    return f"{balance.harmonics} harmonic{'s' * (balance.harmonics > 1)}"


def _quasi_static(task: Task) -> Callable[[], Run]:
    """Return the quasi-static limit of a scene, over the same time."""
    effects = replace(
        task.scene.effects, motion=False, start="equilibrium", damping=None, contact="resisting", orbit="transient"
    )
    scene = replace(task.scene, effects=effects)
    steps = steps_for(forced_rate(numbers_of(scene)) * task.duration)
    timeline = timeline_of(scene, task.duration, task.outputs, steps)
    return partial(quasi_static, scene, task.duration, timeline, Accuracy())


def _errors(prefix: str, found: Run, reference: Reference | None) -> dict[str, float]:
    """Return the errors from a reference; mount forces are compared where the outputs are the same times."""
    if reference is None:
        return {}
    truth = reference.run
    same = len(found.time) == len(truth.time) and abs(found.time[-1] - truth.time[-1]) < 1e-9
    own = errors_of(found, truth)
    names = own if same else ("averages", "mean draft", "RMS")
    return {prefix + name: own[name] for name in names}
