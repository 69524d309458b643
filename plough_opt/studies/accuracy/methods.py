"""Contestants that integrate the equation of motion: every method over its settings, values and gradients."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.compiler import find_compiler
from plough_opt.core.errors import IntegrationError
from plough_opt.motion import Run, simulate
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.assembly import assemble
from plough_opt.motion.compiled_steps import compiled_steps
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import integration
from plough_opt.motion.judgement import refuse_missed_event
from plough_opt.motion.methods import METHODS, ORDER_8, adaptive, fixed_step
from plough_opt.motion.plan import fastest_rate, most_steps, numbers_of, phase, steps_for, timeline_of, with_setting
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline
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
Prepared = tuple[Use, Callable[[], Run]]


@dataclass(frozen=True)
class Task:
    """The task of all methods.

    Attributes:
        scene: numeric.
        duration: simulated time [s], of a lasting orbit its own.
        outputs: number of intervals between output times.
        allowance: time [s] that one use of a contestant may take.
        thin: leave out every other setting but the finest; what is advised is the same.
        wanted: relative error [-] that "auto" is asked for beside its usual ones.
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

    def timeline(self, accuracy: Accuracy) -> Timeline:
        """Return the times of a run by a named method."""
        steps = accuracy.steps or most_steps(phase(numbers_of(self.scene), self.duration))
        return timeline_of(self.scene, self.duration, self.outputs, steps, accuracy.method)

    def assembled(self, accuracy: Accuracy, timeline: Timeline, states: Any, means: Any, variances: Any) -> Run:
        """Return a run of finite results.

        Raises:
            IntegrationError: they are not.
        """
        if not all(np.all(np.isfinite(part)) for part in (states, means, variances)):
            raise IntegrationError("the result is not finite")
        return assemble(self.scene, self.duration, timeline.output_fractions, states, means, variances, accuracy)


def prepared(task: Task, accuracy: Accuracy) -> Prepared:
    """Return one integration by a named method, without the check that `simulate` adds, and the run that it gives."""
    timeline = task.timeline(accuracy)
    solver = integration(Structure.of(task.scene), accuracy, timeline)
    known = numbers_of(task.scene)
    p = ca.DM([*(known[name] for name in solver.names), task.duration])

    def once() -> list[ca.DM]:
        found: list[ca.DM] = solver.function.call([p])
        return found

    def run() -> Run:
        states, means, variances = (np.asarray(result) for result in once())
        found = task.assembled(accuracy, timeline, states.T, means.ravel(), variances.ravel())
        if isinstance(task.scene.effects.contact, StickSlip):
            refuse_missed_event(found)
        return found

    return once, run


def _in_machine_code(task: Task, accuracy: Accuracy) -> Prepared:
    """Return the same by steps of order 8 in machine code."""
    structure = Structure.of(task.scene)
    code, timeline, known = compiled_steps(structure), task.timeline(accuracy), numbers_of(task.scene)
    assert code is not None  # else it takes no part
    p = [*(known[name] for name in signals(structure).parameters), task.duration]

    def once() -> tuple[Any, ...]:
        found = code(timeline, p)
        if found is None:
            raise IntegrationError("the result is not finite")
        return found

    return once, lambda: task.assembled(accuracy, timeline, *once())


def simulated(task: Task, accuracy: Accuracy, *, compiled: bool = False) -> Callable[[], Run]:
    """Return the use of `simulate`, which checks itself."""
    return partial(simulate, task.scene, task.given, accuracy=accuracy, outputs=task.outputs, compiled=compiled)


def integrators(task: Task, reference: Reference) -> list[Entry]:
    """Return every method that can integrate the scene over its settings, and steps of order 8 in machine code."""

    def errors(run: Run) -> Mapping[str, float]:
        return errors_of(run, reference.run)

    def automatic(family: str, name: str, *, compiled: bool) -> Track:
        return Track(
            family, name, partial(simulated, task, compiled=compiled), errors, automatic_settings(task), label=text,
            patience=lambda accuracy: _PATIENCE if accuracy.error == DEFAULT_ERROR else 1.0,
        )  # fmt: skip

    def named(family: str, name: str, method: str, prepare: Callable[[Task, Accuracy], Prepared]) -> Track:
        check = partial(simulated, task, compiled=family == MACHINE_CODE)
        return _track(task, family, method, partial(prepare, task), errors, name=name, check=check)

    families = [[automatic("integrator", AUTO, compiled=False)]]
    refused = []
    for method in (*fixed_step(), *adaptive()):
        if reason := refusal(task.scene, method):
            refused.append(failure("integrator", method, reason))
        else:
            families[0].append(named("integrator", method, method, prepared))
    structure = Structure.of(task.scene)
    if structure.stepped and find_compiler() is not None and compiled_steps(structure) is not None:
        bare = named(MACHINE_CODE, BARE, "dop853", _in_machine_code)
        families.append([automatic(MACHINE_CODE, COMPILED, compiled=True), bare])
    floor = reference.errors["averages"]
    found = [task.ranked(tracks, "averages", floor) for tracks in families]
    return [*found[0], *refused, *(entry for entries in found[1:] for entry in entries)]


def gradients(task: Task, reference: ReferenceGradient) -> list[Entry]:
    """Return the derivatives of mean draft and RMS by every method, as CasADi differentiates its run."""
    at = [float(getattr(task.scene, name)) for name in QUANTITIES]

    def prepare(accuracy: Accuracy) -> tuple[Use, Callable[[], Any]]:
        x = ca.MX.sym("x", len(QUANTITIES))
        varied: dict[str, Any] = dict(zip(QUANTITIES, ca.vertsplit(x), strict=True))
        scene = replace(task.scene, **varied)
        run = simulate(scene, task.given, accuracy=accuracy, outputs=1)
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
    for method in (*fixed_step(), *adaptive()):
        if not refusal(task.scene, method):
            tracks.append(_track(replace(task, outputs=1), "derivatives", method, prepare, errors, slower=_GRADIENT))
    return task.ranked(tracks, "gradient")


def _track(
    task: Task,
    family: str,
    method: str,
    prepare: Callable[[Accuracy], tuple[Use, Callable[[], Any]]],
    errors: Callable[[Any], Mapping[str, float]],
    *,
    name: str = "",
    slower: float = 1.0,
    check: Callable[[Any], Use] | None = None,
) -> Track:
    """Return a named method over its settings."""
    rungs, shown = settings_of(task, method, gradient=family == "derivatives")
    return Track(
        family, name or method, prepare, errors, rungs, shown, text,
        least=lambda accuracy: slower * hopeless(task, accuracy), check=check,
    )  # fmt: skip


def refusal(scene: Scene, method: str) -> str:
    """Return why a method cannot do a scene, or nothing."""
    return refused(method, orbits=scene.effects.orbit != "transient", events=scene.effects.events)


def refused(method: str, *, orbits: bool, events: bool) -> str:
    """Return why a method cannot do lasting orbits, or motions with events, or nothing."""
    if orbits and method not in ORDER_8:
        return "finds no lasting orbit"
    if events and not METHODS[method].locates_events:
        return "finds no events, which stick and slip and the entry of a share have"
    return ""


def automatic_settings(task: Task) -> list[Accuracy]:
    """Return the errors asked of "auto", the default and the wanted one among them."""
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
    """Return an error that is asked for as text, with no more digits than it has."""
    return min((f"{error:.{digits}e}" for digits in range(3)), key=lambda text: (float(text) != error, len(text)))


def text(accuracy: Accuracy) -> str:
    """Return a setting as text."""
    if accuracy.method == "auto":
        return f"error {error_text(accuracy.error)}" if accuracy.error else "default"
    return f"{accuracy.steps} steps" if accuracy.steps else f"tolerance {accuracy.tolerance:.0e}"


def hopeless(task: Task, accuracy: Accuracy) -> float:
    """Return the time [s] that a method needs at the very least, by its number of steps."""
    if accuracy.steps is not None:
        return accuracy.steps * _ONE_STEP
    if accuracy.method == "erk":
        # Stability holds the steps of an explicit method to the fastest oscillation, whether or not it swings.
        return fastest_rate(numbers_of(task.scene)) * task.duration / _PHASE_OF_A_STEP * _ONE_STEP
    return 0.0
