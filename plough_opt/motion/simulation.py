"""`simulate`: one verb for scenes of numbers, checked, and for symbolic scenes inside a design."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.accuracy import ADAPTIVE, DEFAULT_ERROR, LOCATE_EVENTS, ORDER_8, Accuracy
from plough_opt.domain import check_domain
from plough_opt.effects import StickSlip
from plough_opt.errors import InputError, IntegrationError
from plough_opt.expressions import Expression, as_number, holds_casadi, is_casadi, is_symbolic, map_expressions
from plough_opt.motion.embedding import embed
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.judgement import (
    MissedEvent,
    likely_cause,
    refuse_missed_event,
    refuse_ringing,
    refuse_runaway,
    remarks,
    stability,
)
from plough_opt.motion.plan import (
    IMPOSED,
    MOST_ADAPTIVE,
    TIGHTEST,
    automatic,
    check_of,
    checked,
    forced_rate,
    most_steps,
    numbers_of,
    phase,
    steps_for,
    suited,
    timeline_of,
    with_setting,
)
from plough_opt.motion.quasi_static import GAUSS_POINTS, SYMBOLIC_GAUSS_POINTS, quasi_static
from plough_opt.motion.run import Checks, Run, assemble
from plough_opt.motion.terms import Structure, parameters
from plough_opt.scene import Scene

OUTPUTS = 400
"""Default number of intervals between output times."""

# How often, and by what factor, the tolerance is tightened until the wanted error is reached.
_TIGHTENINGS = 3
_TIGHTER = 0.03
# Part of V0 sqrt(k0 M) that forces are at least related to.
_LEAST_FORCE = 1e-9
# Relative difference of a stand-in from the lasting orbit that a reader must know.
_TELLING = 1e-2


def simulate(
    scene: Scene, duration: Expression | None = None, *, accuracy: Accuracy | None = None, outputs: int = OUTPUTS
) -> Run:
    """Simulate a share on its mount, equation (27), or its quasi-static limit.

    Args:
        scene: of floats, or with CasADi expressions in it.
        duration: simulated time [s], above 0; a float or an expression. Of a lasting orbit it is one wavelength of
            the soil's strength and must be left out.
        accuracy: method and setting, or the error to reach; default: a relative error of 1e-8.
        outputs: number of equal intervals between output times, at least 1.

    Returns:
        A `Run` of numbers or of expressions. A run of numbers is integrated a second time, by another
        method, finer, or by three quarters of the steps, and its ``error_estimate`` is the largest difference of the
        two: of mean draft and RMS force relative to the larger of them, of the mount force at the outputs relative to
        its peak; of forces below 1e-9 V0 sqrt(k0 M), relative to that. Of a stand-in for the lasting orbit it is the
        difference from that orbit. A symbolic run is an exactly differentiable expression that has no such estimate.
        A symbolic quasi-static run in which the tow speed, the wavelength or the ramp's time is a symbol averages over
        as many panels as it has outputs, at least 400: enough for some hundred waves, and told by nothing beyond.

    Raises:
        DomainError: the duration is not positive.
        InputError: no duration, or one for an orbit, fewer than one output interval, an array in the scene, an
            integration method for a quasi-static scene, or SX symbols with a method that cannot take them.
        IntegrationError: the method failed; the message says for which scene, when and the likely cause.
    """
    duration = _duration(scene, duration)
    if outputs < 1:
        raise InputError(f"outputs = {outputs} must be at least 1: the number of intervals between output times")
    accuracy = accuracy or Accuracy()
    if accuracy.method != "auto" and not scene.effects.motion:
        raise InputError(f"accuracy method '{accuracy.method}' has nothing to integrate in a quasi-static scene")
    if scene.effects.orbit != "transient" and accuracy.method not in ORDER_8:
        raise InputError(
            f"accuracy method '{accuracy.method}' finds no orbit: take 'auto', or 'dop853' with a number of steps"
        )
    if scene.effects.events and accuracy.method not in LOCATE_EVENTS:
        raise InputError(
            f"accuracy method '{accuracy.method}' finds no events, which stick and slip and the entry of a share have:"
            " take 'auto', 'erk' or 'rosenbrock'"
        )
    if holds_casadi((scene, duration)):
        if any(map(is_symbolic, (*parameters(scene).values(), scene.mass, duration))):
            return _symbolic(scene, duration, accuracy, outputs)
        scene, duration = map_expressions((scene, duration), lambda value: float(as_number(value)))
    for name, value in parameters(scene).items():
        if np.ndim(value) > 0:
            raise InputError(f"{name} is an array of {np.size(value)} values: simulate takes one scene at a time")
    started = time.perf_counter()
    run, error, notes = _verified(scene, float(duration), accuracy, outputs)
    multipliers, unstable = stability(run) if scene.effects.orbit == "periodic" else ((), ())
    notes = (*notes, *remarks(run), *unstable)
    return replace(run, checks=Checks(error, time.perf_counter() - started, notes, multipliers))


def repeat(scene: Scene, duration: Expression, *, outputs: int = OUTPUTS) -> Run:
    """Simulate a scene for the duration of a run of its like; an orbit has its own."""
    return simulate(scene, duration if scene.effects.orbit == "transient" else None, outputs=outputs)


def _duration(scene: Scene, duration: Expression | None) -> Expression:
    """Return the simulated time, of an orbit one wavelength."""
    if scene.effects.orbit == "transient":
        if duration is None:
            raise InputError("the duration is missing: how long shall the scene be simulated, in seconds?")
        check_domain("duration", duration, "s", above=0.0)
        return duration
    if duration is not None:
        raise InputError("a lasting orbit has a duration of its own, one wavelength of the soil: leave it out")
    check_domain("tow speed", scene.tow_speed, "m/s", above=0.0, why="a share that stands still has no orbit")
    wave = scene.effects.strength_wave
    assert wave is not None  # an orbit without one is refused
    return wave.wavelength / scene.tow_speed


def _symbolic(scene: Scene, duration: Expression, accuracy: Accuracy, outputs: int) -> Run:
    """Return the run as expressions of the scene's symbols."""
    if not scene.effects.motion:
        imposed = {name: value for name, value in parameters(scene).items() if name in IMPOSED}
        panels = max(outputs, OUTPUTS)
        if not any(map(is_symbolic, (*imposed.values(), duration))):
            rate = forced_rate({name: float(as_number(value)) for name, value in imposed.items()})
            panels = max(panels, steps_for(rate * float(as_number(duration))))
        timeline = timeline_of(scene, duration, outputs, panels)
        return quasi_static(scene, duration, timeline, accuracy, SYMBOLIC_GAUSS_POINTS)
    if accuracy.method != "auto":
        accuracy = with_setting(accuracy, max(outputs, OUTPUTS), outputs)
    elif scene.effects.events:
        accuracy = Accuracy("erk", tolerance=max(0.01 * (accuracy.error or DEFAULT_ERROR), TIGHTEST))
    return _integrate(scene, duration, accuracy, outputs)


def _verified(scene: Scene, duration: float, accuracy: Accuracy, outputs: int) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate twice; return the run, its estimated error, and a note where the wanted error was missed."""
    if not scene.effects.motion:
        timeline = timeline_of(scene, duration, outputs, steps_for(forced_rate(numbers_of(scene)) * duration))
        run = quasi_static(scene, duration, timeline, accuracy)
        check = quasi_static(scene, duration, timeline, accuracy, GAUSS_POINTS + 6)
        return run, _difference(run, check), ()
    total = _phase(scene, duration)
    wanted = accuracy.error or DEFAULT_ERROR
    if scene.effects.orbit not in ("transient", "periodic"):
        return _stand_in(scene, duration, wanted, outputs)
    if accuracy.method != "auto":
        named = with_setting(accuracy, steps_for(total), outputs)
        other = check_of(named, numbers_of(scene), duration, Structure.of(scene).kinked)
        return *_twice(scene, duration, outputs, named, other), ()
    refuse_ringing(scene, duration)
    return _automatic(scene, duration, wanted, outputs)


def _automatic(scene: Scene, duration: float, wanted: float, outputs: int) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate by the first of the methods that suit a scene which reaches the wanted error, or comes nearest."""
    p, structure = numbers_of(scene), Structure.of(scene)
    best: tuple[Run, float] | None = None
    for method in suited(structure, phase(p, duration)):
        aim = wanted
        for _ in range(1 if method == "rosenbrock" else _TIGHTENINGS):
            try:
                run, error = _twice(scene, duration, outputs, *checked(method, aim, p, duration, structure.kinked))
            except IntegrationError as failed:
                failure = failed
                if not isinstance(failed, MissedEvent):
                    break
                aim *= _TIGHTER
                continue
            if error <= wanted:
                return run, error, ()
            if best is None or error < best[1]:
                best = run, error
            aim *= min(_TIGHTER, 0.5 * wanted / error)
    if best is None:
        raise failure
    return *best, (f"the wanted relative error {wanted:.1e} was not reached: the estimate is {best[1]:.1e}",)


def _stand_in(scene: Scene, duration: float, wanted: float, outputs: int) -> tuple[Run, float, tuple[str, ...]]:
    """Return a stand-in for the lasting orbit, its relative difference from the orbit, and a note if there is none."""
    exact = replace(scene, effects=replace(scene.effects, orbit="periodic"))
    method = automatic("dop853", wanted, numbers_of(scene), duration)
    run = _integrate(scene, duration, method, outputs)
    try:
        orbit = _integrate(exact, duration, method, outputs)
    except IntegrationError:
        return run, math.inf, ("the lasting orbit that this run stands for was not found: its error is unknown",)
    error = _difference(run, orbit)
    if error <= _TELLING:
        return run, error, ()
    return run, error, (f"a stand-in for the lasting orbit, from which it differs by {error:.1%}",)


def _twice(scene: Scene, duration: float, outputs: int, first: Accuracy, second: Accuracy) -> tuple[Run, float]:
    """Return the run by a method, and its relative difference from the run by another."""
    run = _integrate(scene, duration, first, outputs)
    return run, _difference(run, _integrate(scene, duration, second, outputs))


def _integrate(scene: Scene, duration: Expression, accuracy: Accuracy, outputs: int) -> Run:
    """Integrate once, by a method with its setting."""
    p = parameters(scene)
    symbolic = any(map(is_symbolic, (*p.values(), duration)))
    steps = accuracy.steps or max(outputs, OUTPUTS)
    if accuracy.method in ADAPTIVE:
        steps = MOST_ADAPTIVE if symbolic else most_steps(_phase(scene, float(as_number(duration))))
    timeline = timeline_of(scene, duration, outputs, steps, accuracy.method)
    solver = integration(Structure.of(scene), accuracy, timeline)
    values = [*(p[name] for name in solver.names), duration]
    if symbolic:
        states, means, variances = embed(solver, values, scene)
        states = states.T
    else:
        arrays = _evaluate(solver, [float(as_number(value)) for value in values], scene)
        states, means, variances = arrays[0].T, arrays[1].ravel(), arrays[2].ravel()
    run = assemble(scene, duration, timeline.output_fractions, states, means, variances, accuracy)
    if isinstance(scene.effects.contact, StickSlip) and not is_casadi(states):
        refuse_missed_event(run)
    return run


def _evaluate(solver: Integration, p: list[float], scene: Scene) -> list[NDArray[np.float64]]:
    """Evaluate the run of numbers (its duration is the last), or say when and why it failed."""
    refuse_runaway(scene, p[-1])
    found = _attempt(solver, p)
    if found is not None:
        return found
    if scene.effects.orbit != "transient":
        raise IntegrationError(
            f"no lasting orbit of a {scene.describe()} was found from its linear response: simulate it from a start,"
            " orbit = 'transient', to see whether it settles, or damp the mount"
        )
    reached, failed = 0.0, p[-1]
    for _ in range(12):
        middle = (reached + failed) / 2.0
        if _attempt(solver, [*p[:-1], middle]) is None:
            failed = middle
        else:
            reached = middle
    raise IntegrationError(
        f"the motion of a {scene.describe()} could not be integrated by '{solver.accuracy.method}' beyond"
        f" t = {reached:.4g} s of {p[-1]:g} s: {likely_cause(scene, p[-1], solver)}"
    )


def _attempt(solver: Integration, p: list[float]) -> list[NDArray[np.float64]] | None:
    """Return the results, or None where the method failed or they are not finite."""
    function, given = solver.function, np.array(p)
    made: Any = function.buffer()  # its stubs know no arrays
    buffer, evaluate = made
    buffer.set_arg(0, given.data)
    # A result that is zero by structure stays as it is.
    results = [np.zeros(function.size_out(k), order="F") for k in range(function.n_out())]
    for k, result in enumerate(results):
        if function.nnz_out(k) == result.size:
            buffer.set_res(k, result.ravel(order="K").data)
    try:
        evaluate()
    except RuntimeError:
        return None
    sound = buffer.ret() == 0 and all(np.isfinite(result).all() for result in results)
    return results if sound else None


def _phase(scene: Scene, duration: float) -> float:
    return phase(numbers_of(scene), duration)


def _difference(run: Run, check: Run) -> float:
    """Return the largest relative difference of two runs with the same output times: see `simulate`."""
    scene = run.scene
    # Far below the force of a share that swings freely, a force is the rounding of a deflection.
    least = _LEAST_FORCE * scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia)
    size = max(abs(run.mean_draft), run.force_rms, least)
    pairs = (
        (abs(run.mean_draft - check.mean_draft), size),
        (abs(run.force_rms - check.force_rms), size),
        (np.max(np.abs(run.mount_force - check.mount_force)), max(np.max(np.abs(run.mount_force)), least)),
    )
    return max((float(difference / scale) for difference, scale in pairs if scale > 0.0), default=0.0)
