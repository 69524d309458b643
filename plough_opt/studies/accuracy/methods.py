"""Contestants that simulate a scene: methods over their settings, values and gradients, and models of the motion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.compiler import find_compiler
from plough_opt.core.errors import IntegrationError, PloughError
from plough_opt.core.expressions import as_number
from plough_opt.motion import Run, simulate
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.assembly import assemble, quasi_static
from plough_opt.motion.compiled_steps import compiled_steps
from plough_opt.motion.effects import HarmonicBalance, StickSlip
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import integration
from plough_opt.motion.judgement import refuse_missed_event
from plough_opt.motion.methods import METHODS, ORDER_8, adaptive, fixed_step
from plough_opt.motion.plan import (
    fastest_rate,
    forced_rate,
    most_steps,
    numbers_of,
    phase,
    steps_for,
    timeline_of,
    with_setting,
)
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.studies.accuracy.contest import Entry, Track, Use, failure, measured, rungs_of
from plough_opt.studies.accuracy.reference import AVERAGES, QUANTITIES, Reference, ReferenceGradient, errors_of

AUTO, COMPILED, BARE = "auto", "auto, compiled", "dop853, compiled"
"""Names of what chooses and checks by itself, interpreted and in machine code, and of bare steps in machine code."""

MACHINE_CODE: Final = "machine code"
"""Family of what is compiled."""

ERRORS: Final = (1e-3, 1e-5, 1e-6, 1e-8, 1e-10)
TOLERANCES: Final = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
FACTORS: Final = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Settings tried: wanted errors of "auto", relative tolerances, and multiples of the steps taken by default."""

GRADIENT_TOLERANCES: Final = (1e-6, 1e-9)
GRADIENT_FACTORS: Final = (0.5, 1.0, 2.0)
"""The same of derivatives."""

HARMONICS: Final = (1, 3, 8, 16)
"""Numbers of harmonics tried."""

# Time [s] of one explicit step, by which hopeless ones are left out before they are tried; and how much longer a
# gradient may be expected to take.
_ONE_STEP = 2e-6
_PHASE_OF_A_STEP = 1.5
_GRADIENT = 10.0
# All tolerances that may be tried: one in five to ten is by no more than a tenth dearer than the next.
_ALL_TOLERANCES: Final = tuple(float(f"{digit}e-{power}") for power in range(2, 13) for digit in (5, 3, 2, 1))
# Least error that "auto" takes.
_TIGHTEST = 1e-12
# How many times its allowance the default may take: what the toolkit does by itself is shown even where it takes long.
_PATIENCE = 20.0

_Number = TypeVar("_Number", int, float)
Errors = Callable[[Any], Mapping[str, float]]


@dataclass(frozen=True)
class Task:
    """The task of all methods.

    Attributes:
        scene: numeric.
        duration: simulated time [s], of a lasting orbit its own.
        outputs: number of intervals between output times.
        allowance: time [s] that one use of a contestant may take.
        thin: leave out every other setting but the finest; what is advised is the same.
        wanted: relative error [-] that "auto" aims at too, beside its usual ones.
    """

    scene: Scene
    duration: float
    outputs: int
    allowance: float
    thin: bool = False
    wanted: float = DEFAULT_ERROR

    @property
    def given(self) -> float | None:
        """The duration as `simulate` takes it."""
        return self.duration if self.scene.effects.orbit == "transient" else None

    def some(self, settings: tuple[_Number, ...]) -> tuple[_Number, ...]:
        """Return the settings, or every other one and the last: a thin study then reaches what a full one does."""
        if not self.thin:
            return settings
        return settings[::2] if len(settings) % 2 else settings[::2] + settings[-1:]

    def ranked(self, tracks: list[Track], key: str, floor: float = 0.0) -> list[Entry]:
        """Return the entries of tracks that are ranked by an error."""
        return measured(tracks, key, self.wanted, self.allowance, floor=floor)


def prepared(task: Task, accuracy: Accuracy, *, compiled: bool = False) -> tuple[Use, Callable[[], Run]]:
    """Return one integration by a named method, without the check that `simulate` adds, and the run that it gives.

    Args:
        task: the task.
        accuracy: the method and its setting.
        compiled: whether to take steps of order 8 in machine code.
    """
    scene, structure, known = task.scene, Structure.of(task.scene), numbers_of(task.scene)
    steps = accuracy.steps or most_steps(phase(known, task.duration))
    timeline = timeline_of(scene, task.duration, task.outputs, steps, accuracy.method)
    code = compiled_steps(structure) if compiled else None
    once: Use
    if code is not None:
        once = partial(code, timeline, [*(known[name] for name in signals(structure).parameters), task.duration])
    else:
        solver = integration(structure, accuracy, timeline)
        once = partial(solver.function.call, [ca.DM([*(known[name] for name in solver.names), task.duration])])

    def run() -> Run:
        results: Any = once()
        if results is None or not all(np.all(np.isfinite(np.asarray(part))) for part in results):
            raise IntegrationError("the result is not finite")
        states, means, variances = map(np.asarray, results)
        states = states.T if code is None else states
        fractions = timeline.output_fractions
        found = assemble(scene, task.duration, fractions, states, means.ravel(), variances.ravel(), accuracy)
        if isinstance(scene.effects.contact, StickSlip):
            refuse_missed_event(found)
        return found

    return once, run


def integrators(task: Task, reference: Reference) -> list[Entry]:
    """Return every method that can integrate the scene over its settings, and steps of order 8 in machine code."""
    able, refused = _by_ability(task.scene)
    families: list[tuple[str, str, dict[str, str], bool]] = [("integrator", AUTO, {m: m for m in able}, False)]
    structure = Structure.of(task.scene)
    if structure.stepped and find_compiler() is not None and compiled_steps(structure) is not None:
        families.append((MACHINE_CODE, COMPILED, {BARE: "dop853"}, True))
    errors = partial(errors_of, reference=reference.run)
    entries = []
    for family, auto, names, compiled in families:
        simulated = partial(_simulated, task, compiled=compiled)
        once = partial(prepared, task, compiled=compiled)
        tracks = [Track(family, auto, simulated, errors, automatic_settings(task), label=text, patience=_patience)]
        tracks += [_track(task, family, m, once, errors, name=name, check=simulated) for name, m in names.items()]
        entries += task.ranked(tracks, "averages", reference.errors["averages"])
    return entries + [failure("integrator", method, reason) for method, reason in refused.items()]


def _simulated(task: Task, accuracy: Accuracy, *, compiled: bool) -> Callable[[], Run]:
    """Return the use of `simulate`, which checks itself."""
    return partial(simulate, task.scene, task.given, accuracy=accuracy, outputs=task.outputs, compiled=compiled)


def _patience(accuracy: Accuracy) -> float:
    return _PATIENCE if accuracy.error == DEFAULT_ERROR else 1.0


def gradients(task: Task, reference: ReferenceGradient) -> list[Entry]:
    """Return the derivatives of mean draft and RMS by every method, as CasADi differentiates its run."""
    at = [float(getattr(task.scene, name)) for name in QUANTITIES]

    def prepare(accuracy: Accuracy) -> tuple[Use, Callable[[], Any]]:
        x = ca.MX.sym("x", len(QUANTITIES))
        varied: dict[str, Any] = dict(zip(QUANTITIES, ca.vertsplit(x), strict=True))
        run = simulate(replace(task.scene, **varied), task.given, accuracy=accuracy, outputs=1)
        averages = ca.vertcat(*(getattr(run, name) for name in AVERAGES))
        function = ca.Function("gradient", [x], [ca.densify(ca.jacobian(averages, x))])

        def find() -> Any:
            found = np.asarray(function(at)) * at
            if not np.all(np.isfinite(found)):
                raise IntegrationError("the result is not finite")
            return found

        return lambda: function(at), find

    def errors(found: Any) -> Mapping[str, float]:
        size = np.max(np.abs(reference.values))
        wrong = np.max(np.abs(found - reference.values), axis=1) / (size if size > 0 else 1.0)
        own = zip(("mean draft", "RMS"), wrong, strict=True)
        return {"gradient": float(np.max(wrong)), **{f"gradient of {name}": float(w) for name, w in own}}

    tracks = [Track("derivatives", AUTO, prepare, errors, (Accuracy(),), label=text)]
    single = replace(task, outputs=1)
    tracks += [_track(single, "derivatives", method, prepare, errors) for method in _by_ability(task.scene)[0]]
    return task.ranked(tracks, "gradient")


def _track(
    task: Task,
    family: str,
    method: str,
    prepare: Callable[[Accuracy], Any],
    errors: Errors,
    *,
    name: str = "",
    check: Callable[[Any], Use] | None = None,
) -> Track:
    """Return a named method over its settings."""
    derivatives = family == "derivatives"
    rungs, shown = settings_of(task, method, gradient=derivatives)
    least = partial(_least_time, task, slower=_GRADIENT if derivatives else 1.0)
    return Track(family, name or method, prepare, errors, rungs, shown, text, least=least, check=check)


def _least_time(task: Task, accuracy: Accuracy, *, slower: float) -> float:
    """Return the time [s] that a method needs at the very least, by its number of steps."""
    steps: float = accuracy.steps or 0
    if accuracy.method == "erk":
        # Stability holds the steps of an explicit method to the fastest oscillation, whether or not it swings.
        steps = fastest_rate(numbers_of(task.scene)) * task.duration / _PHASE_OF_A_STEP
    return slower * steps * _ONE_STEP


def _by_ability(scene: Scene) -> tuple[list[str], dict[str, str]]:
    """Return the methods that can do a scene, and of the others why not."""
    orbits, events = scene.effects.orbit != "transient", scene.effects.events
    found = {method: refused(method, orbits=orbits, events=events) for method in (*fixed_step(), *adaptive())}
    return [method for method, why in found.items() if not why], {method: why for method, why in found.items() if why}


def refused(method: str, *, orbits: bool, events: bool) -> str:
    """Return why a method cannot do lasting orbits, or motions with events, or nothing."""
    if orbits and method not in ORDER_8:
        return "finds no lasting orbit"
    if events and not METHODS[method].locates_events:
        return "finds no events, which stick and slip and the entry of a share have"
    return ""


def automatic_settings(task: Task) -> list[Accuracy]:
    """Return the errors that "auto" aims at, the default and the wanted one among them."""
    errors = {*task.some(ERRORS), DEFAULT_ERROR, max(task.wanted, _TIGHTEST)}
    return [Accuracy(error=error) for error in sorted(errors, reverse=True)]


def settings_of(task: Task, method: str, *, gradient: bool = False) -> tuple[tuple[Accuracy, ...], tuple[int, ...]]:
    """Return a method's settings from coarse to fine, and the places of those that are tried in any case.

    Those lie around the settings that a scene's own time scales call for.
    """
    if METHODS[method].adaptive:
        chosen = task.some(GRADIENT_TOLERANCES if gradient else TOLERANCES)
        settings = tuple(Accuracy(method, tolerance=tolerance) for tolerance in _ALL_TOLERANCES)
        return settings, tuple(_ALL_TOLERANCES.index(tolerance) for tolerance in chosen)
    usual = with_setting(Accuracy(method), steps_for(phase(numbers_of(task.scene), task.duration)), 1).steps or 1
    # Steps of order 8 need not end at the outputs.
    unit = 1 if method in ORDER_8 else task.outputs
    rungs, shown = rungs_of(usual, task.some(GRADIENT_FACTORS if gradient else FACTORS), unit)
    return tuple(Accuracy(method, steps=steps) for steps in rungs), shown


def error_text(error: float) -> str:
    """Return a wanted error as text, with the digits that it has."""
    return min((f"{error:.{digits}e}" for digits in range(3)), key=lambda text: (float(text) != error, len(text)))


def text(accuracy: Accuracy) -> str:
    """Return a setting as text."""
    if accuracy.method == "auto":
        return f"error {error_text(accuracy.error)}" if accuracy.error else "default"
    return f"{accuracy.steps} steps" if accuracy.steps else f"tolerance {accuracy.tolerance:.0e}"


# --- models, which leave something of the motion out ---


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

    tracks, entries = [Track("model", "quasi-static", lambda _: _quasi_static(task), errors)], []
    if task.scene.effects.entry:
        entries = [failure("model", tracks.pop().method, "has a share that is wholly buried, and so no entry")]
    transient, orbit = task.scene.effects.orbit == "transient", lasting_orbit(task.scene)
    if orbit is not None and not (transient and lasting is None):
        around = replace(task, scene=orbit, duration=float(as_number(orbit.wave_period)))
        rungs, shown = settings_of(around, "dop853")

        def stand_in(kind: Any) -> tuple[Use, Callable[[], Run]]:
            scene = replace(orbit, effects=replace(orbit.effects, orbit=kind))
            return prepared(replace(around, scene=scene), rungs[-1])

        balances = tuple(map(HarmonicBalance, range(1, HARMONICS[-1] + 1)))
        chosen = tuple(count - 1 for count in task.some(HARMONICS))
        tracks.append(Track("model", "linearised", lambda _: stand_in("linearised"), errors))
        tracks.append(Track("model", "harmonic balance", stand_in, errors, balances, chosen, _counted))
        if transient:
            tracks.append(Track("model", "lasting orbit", partial(prepared, around), errors, rungs, shown, text))
    return entries + task.ranked(tracks, "lasting averages" if transient else "averages")


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
