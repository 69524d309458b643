"""Contestants that integrate the equation of motion: every method over its settings, values and gradients."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import casadi as ca
import numpy as np

from plough_opt.accuracy import ADAPTIVE, DEFAULT_ERROR, FIXED_STEP, LOCATE_EVENTS, ORDER_8, Accuracy, Method
from plough_opt.accuracy_study.contest import AUTO, COMPILED, Entry, efficient, error_text, median_time
from plough_opt.accuracy_study.gradients import AVERAGES, QUANTITIES, ReferenceGradient
from plough_opt.accuracy_study.reference import Reference, errors_of
from plough_opt.compiler import find_compiler
from plough_opt.effects import StickSlip
from plough_opt.errors import IntegrationError, PloughError
from plough_opt.expressions import Expression, as_number
from plough_opt.motion import Run, simulate
from plough_opt.motion.integrators import integration
from plough_opt.motion.judgement import refuse_missed_event
from plough_opt.motion.plan import fastest_rate, most_steps, numbers_of, phase, steps_for, timeline_of, with_setting
from plough_opt.motion.run import assemble
from plough_opt.motion.terms import Structure
from plough_opt.scene import Scene

ERRORS: Final = (1e-3, 1e-5, 1e-6, 1e-8, 1e-10)
TOLERANCES: Final = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
FACTORS: Final = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Settings tried: wanted errors of "auto", relative tolerances, and multiples of the steps taken by default."""

DEFAULT: Final = Accuracy(error=DEFAULT_ERROR)
"""What `simulate` takes unasked."""

GRADIENT_TOLERANCES: Final = (1e-6, 1e-9)
GRADIENT_FACTORS: Final = (0.5, 1.0, 2.0)
"""The same of derivatives."""

# Time [s] of one explicit step, by which hopeless ones are left out before they are tried; and how much longer the
# next finer setting, and a gradient, may be expected to take.
_ONE_STEP = 2e-6
_PHASE_OF_A_STEP = 1.5
_NEXT, _GRADIENT = 3.0, 10.0
# Least error that "auto" takes.
_TIGHTEST = 1e-12
# How many times its allowance the default may take.
_PATIENCE = 20.0


_Number = TypeVar("_Number", int, float)


@dataclass(frozen=True)
class Task:
    """What contestants have to do.

    Attributes:
        scene: of numbers.
        duration: simulated time [s], of a lasting orbit its own.
        outputs: number of intervals between output times.
        allowance: time [s] that one use of a contestant may take.
        thin: leave out every other setting.
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
        """Return the settings, or every other one of them."""
        return settings[:: 2 if self.thin else 1]


def prepared(task: Task, accuracy: Accuracy) -> tuple[Callable[[], object], Callable[[], Run]]:
    """Return one integration by a named method, without the check that `simulate` adds, and the run that it gives."""
    steps = accuracy.steps or most_steps(phase(numbers_of(task.scene), task.duration))
    timeline = timeline_of(task.scene, task.duration, task.outputs, steps)
    solver = integration(Structure.of(task.scene), accuracy, timeline)
    known = numbers_of(task.scene)
    p = ca.DM([*(known[name] for name in solver.names), task.duration])

    def once() -> list[ca.DM]:
        found: list[ca.DM] = solver.function.call([p])
        return found

    def run() -> Run:
        states, means, variances = (np.asarray(result) for result in once())
        if not all(np.all(np.isfinite(part)) for part in (states, means, variances)):
            raise IntegrationError("the result is not finite")
        fractions = timeline.output_fractions
        found = assemble(task.scene, task.duration, fractions, states.T, means.ravel(), variances.ravel(), accuracy)
        if isinstance(task.scene.effects.contact, StickSlip):
            refuse_missed_event(found)
        return found

    return once, run


def values(task: Task, reference: Reference) -> Iterator[Entry]:
    """Yield every method that can integrate the scene, over its settings from coarse to fine."""
    yield from _series(task, AUTO, automatic_settings(task), lambda a: _automatic(task, a), reference)
    if task.scene.effects.motion and Structure.of(task.scene).stepped and find_compiler() is not None:
        compiled = partial(_automatic, task, compiled=True)
        yield from _series(task, COMPILED, automatic_settings(task), compiled, reference)
    for method in (*FIXED_STEP, *ADAPTIVE):
        refused = refusal(task.scene, method)
        if refused:
            yield failure("integrator", method, "", refused)
            continue
        yield from _series(task, method, settings_of(task, method), lambda a: prepared(task, a), reference)


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
        named = (a for method in (*FIXED_STEP, *ADAPTIVE) for a in settings_of(task, method))
        accuracy = next(a for a in named if (a.method, text(a)) == (entry.method, entry.setting))
        try:
            return replace(entry, checked=median_time(_automatic(task, accuracy)[0], budget=task.timing))
        except PloughError:
            return entry

    return [checked(entry) for entry in entries]


def refusal(scene: Scene, method: str) -> str:
    """Return why a method cannot do a scene, or nothing."""
    if scene.effects.orbit != "transient" and method not in ORDER_8:
        return "finds no lasting orbit"
    if scene.effects.events and method not in LOCATE_EVENTS:
        return "finds no events, which stick and slip and the entry of a share have"
    return ""


def automatic_settings(task: Task) -> list[Accuracy]:
    """Return the errors asked of "auto", the default and the wanted one among them."""
    errors = {*task.some(ERRORS), DEFAULT_ERROR, max(task.wanted, _TIGHTEST)}
    return [Accuracy(error=error) for error in sorted(errors, reverse=True)]


def settings_of(
    task: Task, method: Method, factors: tuple[float, ...] = FACTORS, tolerances: tuple[float, ...] = TOLERANCES
) -> list[Accuracy]:
    """Return a method's settings from coarse to fine, around those that a scene's own time scales call for."""
    if method in ADAPTIVE:
        return [Accuracy(method, tolerance=tolerance) for tolerance in task.some(tolerances)]
    usual = with_setting(Accuracy(method), steps_for(phase(numbers_of(task.scene), task.duration)), 1).steps or 1
    wanted = (math.ceil(factor * usual / task.outputs) * task.outputs for factor in task.some(factors))
    return [Accuracy(method, steps=steps) for steps in dict.fromkeys(wanted)]


def text(accuracy: Accuracy) -> str:
    """Return a setting as text."""
    if accuracy.method == "auto":
        return f"error {error_text(accuracy.error)}" if accuracy.error else "default"
    return f"{accuracy.steps} steps" if accuracy.steps else f"tolerance {accuracy.tolerance:.0e}"


def failure(family: str, method: str, setting: str, reason: object) -> Entry:
    """Return the entry of a contestant without a result."""
    return Entry(family, method, setting, math.inf, failure=str(reason))


def _automatic(
    task: Task, accuracy: Accuracy, *, compiled: bool = False
) -> tuple[Callable[[], object], Callable[[], Run]]:
    def run() -> Run:
        return simulate(task.scene, task.given, accuracy=accuracy, outputs=task.outputs, compiled=compiled)

    return run, run


def _series(
    task: Task,
    method: str,
    settings: list[Accuracy],
    prepare: Callable[[Accuracy], tuple[Callable[[], object], Callable[[], Run]]],
    reference: Reference,
) -> Iterator[Entry]:
    """Yield the settings of one method until they take too long."""
    expected = 0.0
    for accuracy in settings:
        expected = max(expected, hopeless(task, accuracy))
        # What the toolkit does unasked is told even where it takes long.
        allowed = task.allowance * (_PATIENCE if accuracy == DEFAULT else 1.0)
        if expected > allowed:
            yield failure("integrator", method, text(accuracy), _cut(expected, allowed))
            continue
        started = time.perf_counter()
        try:
            once, run = prepare(accuracy)
            built = time.perf_counter() - started
            found = run()
        except (PloughError, RuntimeError) as error:
            expected = _NEXT * (time.perf_counter() - started)
            yield failure("integrator", method, text(accuracy), _first_line(error))
            continue
        first = time.perf_counter() - started
        seconds = median_time(once, budget=task.timing, warm=True)
        yield Entry("integrator", method, text(accuracy), seconds, max(built, first - seconds),
                    errors_of(found, reference))  # fmt: skip
        expected = _NEXT * seconds


def hopeless(task: Task, accuracy: Accuracy) -> float:
    """Return the time [s] that a method needs at the very least, by its number of steps."""
    if accuracy.steps is not None:
        return accuracy.steps * _ONE_STEP
    if accuracy.method == "erk":
        # Stability holds the steps of an explicit method to the fastest oscillation, whether or not it swings.
        return fastest_rate(numbers_of(task.scene)) * task.duration / _PHASE_OF_A_STEP * _ONE_STEP
    return 0.0


def _cut(expected: float, allowance: float) -> str:
    return f"cut off: expected to take {expected:.2g} s, {allowance:.2g} s allowed"


def _first_line(error: Exception) -> str:
    if isinstance(error, PloughError):
        return str(error)
    return f"CasADi gave up: {str(error).strip().splitlines()[-1]}" if str(error).strip() else "CasADi gave up"


def gradients(task: Task, reference: ReferenceGradient) -> Iterator[Entry]:
    """Yield the derivatives of mean draft and RMS by every method, as CasADi differentiates its run."""
    for accuracy in gradient_settings(task):
        method = accuracy.method
        expected = _GRADIENT * hopeless(task, accuracy)
        if expected > task.allowance:
            yield failure("derivatives", method, text(accuracy), _cut(expected, task.allowance))
            continue
        yield _gradient(task, accuracy, reference)


def gradient_settings(task: Task) -> list[Accuracy]:
    """Return the methods that can differentiate the scene, with their settings; the default first."""
    found = [Accuracy()]
    whole = replace(task, outputs=1)
    for method in (*FIXED_STEP, *ADAPTIVE):
        if not refusal(task.scene, method):
            found += settings_of(whole, method, GRADIENT_FACTORS, GRADIENT_TOLERANCES)
    return found


def _gradient(task: Task, accuracy: Accuracy, reference: ReferenceGradient) -> Entry:
    started = time.perf_counter()
    at = [float(as_number(getattr(task.scene, name))) for name in QUANTITIES]
    try:
        function = gradient_function(task, accuracy)
        built = time.perf_counter() - started
        found = np.asarray(function(at)) * at
        first = time.perf_counter() - started
        if not np.all(np.isfinite(found)):
            raise IntegrationError("the result is not finite")
        seconds = median_time(lambda: function(at), budget=task.timing, warm=True)
    except (PloughError, RuntimeError) as error:
        return failure("derivatives", accuracy.method, text(accuracy), _first_line(error))
    size = np.max(np.abs(reference.values))
    wrong = np.max(np.abs(found - reference.values), axis=1) / (size if size > 0 else 1.0)
    errors: Mapping[str, float] = {
        "gradient": float(np.max(wrong)),
        **{f"gradient of {name}": float(w) for name, w in zip(("mean draft", "RMS"), wrong, strict=True)},
    }
    return Entry("derivatives", accuracy.method, text(accuracy), seconds, max(built, first - seconds), errors)


def gradient_function(task: Task, accuracy: Accuracy) -> ca.Function:
    """Return the derivatives of `AVERAGES`, a row each, by `QUANTITIES`, as CasADi finds them."""
    x = ca.MX.sym("x", len(QUANTITIES))
    varied: dict[str, Any] = dict(zip(QUANTITIES, ca.vertsplit(x), strict=True))
    scene = replace(task.scene, **varied)
    run = simulate(scene, task.given, accuracy=accuracy, outputs=1)
    averages: Expression = ca.vertcat(*(getattr(run, name) for name in AVERAGES))
    return ca.Function("gradient", [x], [ca.densify(ca.jacobian(averages, x))])
