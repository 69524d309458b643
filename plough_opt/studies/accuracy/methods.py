"""Contestants that integrate the equation of motion: every method over its settings, values and gradients."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.compiler import find_compiler
from plough_opt.core.errors import IntegrationError, PloughError
from plough_opt.core.expressions import Expression, as_number
from plough_opt.motion import Run, simulate
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.compiled_steps import CompiledSteps, compiled_steps
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.integrators import integration
from plough_opt.motion.judgement import refuse_missed_event
from plough_opt.motion.methods import METHODS, ORDER_8, adaptive, fixed_step
from plough_opt.motion.plan import fastest_rate, most_steps, numbers_of, phase, steps_for, timeline_of, with_setting
from plough_opt.motion.run import assemble
from plough_opt.motion.scene import Scene
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline
from plough_opt.studies.accuracy.contest import AUTO, BARE, COMPILED, Entry, efficient, error_text, median_time
from plough_opt.studies.accuracy.gradients import AVERAGES, QUANTITIES, ReferenceGradient
from plough_opt.studies.accuracy.reference import Reference, errors_of
from plough_opt.studies.accuracy.tracks import Track, Use, measured, rungs_of

ERRORS: Final = (1e-3, 1e-5, 1e-6, 1e-8, 1e-10)
TOLERANCES: Final = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
FACTORS: Final = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Settings tried: wanted errors of "auto", relative tolerances, and multiples of the steps taken by default."""

DEFAULT: Final = Accuracy(error=DEFAULT_ERROR)
"""The default of `simulate`."""

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
# How many times its allowance the default may take.
_PATIENCE = 20.0


MACHINE_CODE: Final = "machine code"
"""Family of what is compiled."""

_Number = TypeVar("_Number", int, float)


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

    @property
    def timing(self) -> float:
        """Time [s] in which one use is repeated for its median."""
        return 0.1 * self.allowance

    def some(self, settings: tuple[_Number, ...]) -> tuple[_Number, ...]:
        """Return the settings, or every other one and the last: a thin study then reaches what a full one does."""
        if not self.thin:
            return settings
        return settings[::2] if len(settings) % 2 else settings[::2] + settings[-1:]


def prepared(task: Task, accuracy: Accuracy) -> tuple[Callable[[], object], Callable[[], Run]]:
    """Return one integration by a named method, without the check that `simulate` adds, and the run that it gives."""
    timeline = _timeline(task, accuracy)
    solver = integration(Structure.of(task.scene), accuracy, timeline)
    known = numbers_of(task.scene)
    p = ca.DM([*(known[name] for name in solver.names), task.duration])

    def once() -> list[ca.DM]:
        found: list[ca.DM] = solver.function.call([p])
        return found

    def run() -> Run:
        states, means, variances = (np.asarray(result) for result in once())
        found = _assembled(task, accuracy, timeline, states.T, means.ravel(), variances.ravel())
        if isinstance(task.scene.effects.contact, StickSlip):
            refuse_missed_event(found)
        return found

    return once, run


def _compiled(task: Task, code: CompiledSteps, accuracy: Accuracy) -> tuple[Callable[[], object], Callable[[], Run]]:
    """Return the same in machine code."""
    timeline, known = _timeline(task, accuracy), numbers_of(task.scene)
    p = [*(known[name] for name in signals(Structure.of(task.scene)).parameters), task.duration]

    def run() -> Run:
        found = code(timeline, p)
        if found is None:
            raise IntegrationError("the result is not finite")
        return _assembled(task, accuracy, timeline, *found)

    return lambda: code(timeline, p), run


def _timeline(task: Task, accuracy: Accuracy) -> Timeline:
    steps = accuracy.steps or most_steps(phase(numbers_of(task.scene), task.duration))
    return timeline_of(task.scene, task.duration, task.outputs, steps, accuracy.method)


def _assembled(task: Task, accuracy: Accuracy, timeline: Timeline, states: Any, means: Any, variances: Any) -> Run:
    """Return a run of finite results.

    Raises:
        IntegrationError: they are not.
    """
    if not all(np.all(np.isfinite(part)) for part in (states, means, variances)):
        raise IntegrationError("the result is not finite")
    return assemble(task.scene, task.duration, timeline.output_fractions, states, means, variances, accuracy)


def values(task: Task, reference: Reference) -> list[Entry]:
    """Return every method that can integrate the scene, over its settings from coarse to fine."""
    errors = partial(_errors_from, reference)
    tracks, refused = [_automatic_track(task, AUTO, errors)], []
    for method in (*fixed_step(), *adaptive()):
        if reason := refusal(task.scene, method):
            refused.append(failure("integrator", method, "", reason))
        else:
            tracks.append(_track(task, "integrator", method, partial(prepared, task), errors))
    return [*measured(tracks, "averages", task.wanted, task.allowance), *refused]


def in_machine_code(task: Task, reference: Reference) -> list[Entry]:
    """Return what is there in machine code: steps of order 8, bare and chosen and checked by "auto"."""
    if not (task.scene.effects.motion and Structure.of(task.scene).stepped and find_compiler() is not None):
        return []
    code = compiled_steps(Structure.of(task.scene))
    if code is None:
        return []
    errors = partial(_errors_from, reference)
    bare = _track(task, MACHINE_CODE, "dop853", partial(_compiled, task, code), errors)
    tracks = [_automatic_track(task, COMPILED, errors), replace(bare, method=BARE)]
    return measured(tracks, "averages", task.wanted, task.allowance)


def _errors_from(reference: Reference, found: Run) -> Mapping[str, float]:
    return errors_of(found, reference)


def _automatic_track(task: Task, name: str, errors: Callable[[Run], Mapping[str, float]]) -> Track:
    settings = tuple(automatic_settings(task))
    return Track(
        family="integrator" if name == AUTO else MACHINE_CODE,
        method=name,
        rungs=settings,
        shown=tuple(range(len(settings))),
        label=text,
        prepare=partial(_automatic, task, compiled=name == COMPILED),
        errors=errors,
        # The default is reported even if it takes long.
        patient=lambda accuracy: _PATIENCE if accuracy == DEFAULT else 1.0,
        narrows=False,
    )


def _track(
    task: Task,
    family: str,
    method: str,
    prepare: Callable[[Accuracy], tuple[Use, Callable[[], Any]]],
    errors: Callable[[Any], Mapping[str, float]],
    *,
    gradient: bool = False,
) -> Track:
    """Return a named method over its settings."""
    rungs, shown = settings_of(replace(task, outputs=1) if gradient else task, method, gradient=gradient)
    return Track(
        family=family,
        method=method,
        rungs=rungs,
        shown=shown,
        label=text,
        prepare=prepare,
        errors=errors,
        least=lambda accuracy: (_GRADIENT if gradient else 1.0) * hopeless(task, accuracy),
    )


def with_checks(task: Task, entries: list[Entry], floor: float) -> list[Entry]:
    """Return entries of `values`, the efficient ones with the time that `simulate` takes by them, which checks itself.

    Args:
        task: what they did.
        entries: of all methods.
        floor: relative error of their reference [-].
    """
    front = efficient(entries, "averages", floor)

    def checked(entry: Entry) -> Entry:
        if entry not in front or entry.method in (AUTO, COMPILED):
            return entry
        compiled = entry.family == MACHINE_CODE
        method: str = "dop853" if compiled else next(m for m in (*fixed_step(), *adaptive()) if m == entry.method)
        accuracy = next(a for a in settings_of(task, method)[0] if text(a) == entry.setting)
        try:
            use, _ = _automatic(task, accuracy, compiled=compiled)
            return replace(entry, checked=median_time(use, budget=task.timing))
        except PloughError:
            return entry

    return [checked(entry) for entry in entries]


def refusal(scene: Scene, method: str) -> str:
    """Return why a method cannot do a scene, or nothing."""
    if scene.effects.orbit != "transient" and method not in ORDER_8:
        return "finds no lasting orbit"
    if scene.effects.events and not METHODS[method].locates_events:
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


def text(accuracy: Accuracy) -> str:
    """Return a setting as text."""
    if accuracy.method == "auto":
        return f"error {error_text(accuracy.error)}" if accuracy.error else "default"
    return f"{accuracy.steps} steps" if accuracy.steps else f"tolerance {accuracy.tolerance:.0e}"


def failure(family: str, method: str, setting: str, reason: object) -> Entry:
    """Return the entry of a contestant without a result."""
    return Entry(family, method, setting, math.inf, failure=str(reason))


def _automatic(task: Task, accuracy: Accuracy, *, compiled: bool) -> tuple[Callable[[], object], Callable[[], Run]]:
    def run() -> Run:
        return simulate(task.scene, task.given, accuracy=accuracy, outputs=task.outputs, compiled=compiled)

    return run, run


def hopeless(task: Task, accuracy: Accuracy) -> float:
    """Return the time [s] that a method needs at the very least, by its number of steps."""
    if accuracy.steps is not None:
        return accuracy.steps * _ONE_STEP
    if accuracy.method == "erk":
        # Stability holds the steps of an explicit method to the fastest oscillation, whether or not it swings.
        return fastest_rate(numbers_of(task.scene)) * task.duration / _PHASE_OF_A_STEP * _ONE_STEP
    return 0.0


def gradients(task: Task, reference: ReferenceGradient) -> list[Entry]:
    """Return the derivatives of mean draft and RMS by every method, as CasADi differentiates its run."""
    at = [float(as_number(getattr(task.scene, name))) for name in QUANTITIES]

    def prepare(accuracy: Accuracy) -> tuple[Use, Callable[[], Any]]:
        function = gradient_function(task, accuracy)

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

    default = Track("derivatives", AUTO, (Accuracy(),), (0,), text, prepare, errors)
    tracks = [
        _track(task, "derivatives", method, prepare, errors, gradient=True)
        for method in (*fixed_step(), *adaptive())
        if not refusal(task.scene, method)
    ]
    return measured([default, *tracks], "gradient", task.wanted, task.allowance)


def gradient_function(task: Task, accuracy: Accuracy) -> ca.Function:
    """Return the derivatives of `AVERAGES`, a row each, by `QUANTITIES`, as CasADi finds them."""
    x = ca.MX.sym("x", len(QUANTITIES))
    varied: dict[str, Any] = dict(zip(QUANTITIES, ca.vertsplit(x), strict=True))
    scene = replace(task.scene, **varied)
    run = simulate(scene, task.given, accuracy=accuracy, outputs=1)
    averages: Expression = ca.vertcat(*(getattr(run, name) for name in AVERAGES))
    return ca.Function("gradient", [x], [ca.densify(ca.jacobian(averages, x))])
