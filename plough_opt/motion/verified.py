"""Scenes of numbers: integrated by a method that suits them, checked by another or a finer one, and judged."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from plough_opt.accuracy import ADAPTIVE, DEFAULT_ERROR, ORDER_8, Accuracy
from plough_opt.compiler import NO_COMPILER
from plough_opt.effects import StickSlip
from plough_opt.errors import IntegrationError
from plough_opt.motion.compiled_steps import CompiledSteps, compiled_steps
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.judgement import (
    MissedEvent,
    likely_cause,
    refuse_countless_waves,
    refuse_drifting_own,
    refuse_missed_event,
    refuse_ringing,
    refuse_runaway,
    refuse_stiff_orbit,
)
from plough_opt.motion.plan import (
    MOST_FORCED,
    MOST_PANELLED,
    OUTPUTS,
    automatic,
    check_of,
    checked,
    finer,
    forced_rate,
    most_steps,
    numbers_of,
    phase,
    steps_for,
    suited,
    timeline_of,
    with_setting,
)
from plough_opt.motion.quasi_static import GAUSS_POINTS, quasi_static
from plough_opt.motion.run import Averages, Run, assemble, averages_of, mount_force
from plough_opt.motion.settling import which_motion
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure
from plough_opt.scene import Scene

Array = NDArray[np.float64]

# How often, and by what factor, the tolerance is tightened until the wanted error is reached.
_TIGHTENINGS = 3
_TIGHTER = 0.03
# Part of V0 sqrt(k0 M) that forces are at least related to.
_LEAST_FORCE = 1e-9
# Relative difference of a stand-in from the lasting orbit that a reader must know.
_TELLING = 1e-2


@dataclass(frozen=True)
class Case:
    """A scene of numbers over a time, read once for all its integrations.

    Attributes:
        scene: the scene.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        structure: what its equation of motion contains.
        p: the equation's parameters by name.
        code: its steps of order 8 in machine code, where they are wanted and can be had.
    """

    scene: Scene
    duration: float
    outputs: int
    structure: Structure
    p: dict[str, float]
    code: CompiledSteps | None = None

    @classmethod
    def of(cls, scene: Scene, duration: float, outputs: int, *, compiled: bool = False) -> Case:
        """Read a scene; translate its steps if they shall be compiled and can be.

        Raises:
            InputError: an array in the scene.
        """
        structure = Structure.of(scene)
        code = compiled_steps(structure) if compiled and scene.effects.motion and structure.stepped else None
        return cls(scene, duration, outputs, structure, numbers_of(scene), code)

    @property
    def phase(self) -> float:
        """Phase of the fastest oscillation over the run [rad]."""
        return phase(self.p, self.duration)


@dataclass(frozen=True)
class _Found:
    """What an integration found: states in rows of outputs, means and mean squares of the signals."""

    fractions: Array
    states: Array
    means: Array
    variances: Array


def verified(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate twice; return the run, its estimated error, and a note where the wanted error was missed."""
    effects = case.scene.effects
    if not effects.motion:
        return _quasi_static(case, accuracy)
    wanted = accuracy.error or DEFAULT_ERROR
    if effects.orbit != "transient":
        refuse_drifting_own(case.scene)
        if accuracy.method == "auto":
            refuse_stiff_orbit(case.scene)
    if effects.orbit not in ("transient", "periodic"):
        return _stand_in(case, wanted)
    if accuracy.method != "auto":
        named = with_setting(accuracy, steps_for(case.phase), case.outputs)
        other = check_of(named, case.p, case.duration, case.structure.kinked)
        return *_twice(case, named, other), ()
    refuse_ringing(case.scene, case.duration)
    refuse_countless_waves(case.scene, case.duration, MOST_FORCED)
    return _automatic(case, wanted)


def interpreted(case: Case, run: Run) -> tuple[str, ...]:
    """Return why a run that should have been compiled was not, or nothing."""
    if not run.scene.effects.motion:
        kind = "a quasi-static run"
    elif case.structure.orbit != "transient":
        kind = "a lasting orbit"
    elif run.accuracy.method not in ORDER_8:
        kind = f"a run by '{run.accuracy.method}'"
    else:
        return () if case.code else (NO_COMPILER,)
    return (f"compiled=True changes nothing in {kind}: machine code takes steps of order 8",)


def _quasi_static(case: Case, accuracy: Accuracy) -> tuple[Run, float, tuple[str, ...]]:
    scene, duration = case.scene, case.duration
    refuse_countless_waves(scene, duration, MOST_PANELLED)
    timeline = timeline_of(scene, duration, case.outputs, steps_for(forced_rate(case.p) * duration))
    run = quasi_static(scene, duration, timeline, accuracy)
    check = quasi_static(scene, duration, timeline, accuracy, GAUSS_POINTS + 6)
    if not all(np.isfinite(part).all() for part in (run.mount_force, run.mean_draft, run.force_rms)):
        raise IntegrationError(f"the resistance of a {scene.describe()} is not finite: look at its own effects")
    return run, _difference(run, check.averages, check.mount_force), ()


def _automatic(case: Case, wanted: float) -> tuple[Run, float, tuple[str, ...]]:
    """Integrate by the first of the methods that suit a scene which reaches the wanted error, or comes nearest."""
    best: tuple[Run, float] | None = None
    for method in suited(case.structure, case.phase):
        aim = wanted
        for _ in range(1 if method == "rosenbrock" else _TIGHTENINGS):
            try:
                run, error = _twice(case, *checked(method, aim, case.p, case.duration, case.structure.kinked))
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


def _stand_in(case: Case, wanted: float) -> tuple[Run, float, tuple[str, ...]]:
    """Return a stand-in for the lasting orbit, its relative difference from the orbit, and a note if there is none."""
    exact = replace(case.scene, effects=replace(case.scene.effects, orbit="periodic"))
    method = automatic("dop853", wanted, case.p, case.duration)
    run = _followed(case, method)
    try:
        orbit = _followed(Case.of(exact, case.duration, case.outputs), method)
    except IntegrationError:
        return run, math.inf, ("the lasting orbit that this run stands for was not found: its error is unknown",)
    error = _difference(run, orbit.averages, orbit.mount_force)
    _, _, lasting = which_motion(orbit)
    if error <= _TELLING:
        return run, error, lasting
    return run, error, (f"a stand-in for the lasting orbit, from which it differs by {error:.1%}", *lasting)


def _twice(case: Case, first: Accuracy, second: Accuracy) -> tuple[Run, float]:
    """Return the run by a method, and its relative difference from the run by another."""
    run = _followed(case, first)
    if case.structure.events:
        # An event that the check misses is a failure too.
        check = _followed(case, second)
        return run, _difference(run, check.averages, check.mount_force)
    try:
        found = _integrated(case, second)
    except IntegrationError:
        if first.method not in ADAPTIVE or first.method == second.method:
            raise
        # Fixed steps may be too long for what only an adaptive method notices.
        found = _integrated(case, finer(first))
    averages = averages_of(case.scene, case.structure, case.p, found.means, found.variances)
    return run, _difference(run, averages, mount_force(case.structure, case.p, found.states))


def _followed(case: Case, accuracy: Accuracy) -> Run:
    """Return the run by a method with its setting."""
    found = _integrated(case, accuracy)
    run = assemble(case.scene, case.duration, found.fractions, found.states, found.means, found.variances, accuracy)
    if isinstance(case.scene.effects.contact, StickSlip):
        refuse_missed_event(run)
    return run


def _integrated(case: Case, accuracy: Accuracy) -> _Found:
    """Integrate once, by a method with its setting, or say when and why it failed."""
    scene, duration = case.scene, case.duration
    refuse_runaway(scene, duration)
    steps = accuracy.steps or max(case.outputs, OUTPUTS)
    if accuracy.method in ADAPTIVE:
        steps = most_steps(case.phase)
    timeline = timeline_of(scene, duration, case.outputs, steps, accuracy.method)
    p = [*(case.p[name] for name in signals(case.structure).parameters), duration]
    if case.code is not None and accuracy.method in ORDER_8 and (found := case.code(timeline, p)) is not None:
        return _Found(timeline.output_fractions, *found)
    solver = integration(case.structure, accuracy, timeline)
    results = _attempt(solver, p)
    if results is None:
        _refuse(case, solver, p)
    states, means, variances = results
    return _Found(timeline.output_fractions, states.T, means.ravel(), variances.ravel())


def _refuse(case: Case, solver: Integration, p: list[float]) -> NoReturn:
    """Say of an integration that failed when and why it did."""
    scene, duration = case.scene, case.duration
    if scene.effects.orbit != "transient":
        raise IntegrationError(
            f"no lasting orbit of a {scene.describe()} was found from its linear response: simulate it from a start,"
            " orbit = 'transient', to see whether it settles, or damp the mount"
        )
    reached, failed = 0.0, duration
    for _ in range(12):
        middle = (reached + failed) / 2.0
        if _attempt(solver, [*p[:-1], middle]) is None:
            failed = middle
        else:
            reached = middle
    raise IntegrationError(
        f"the motion of a {scene.describe()} could not be integrated by '{solver.accuracy.method}' beyond"
        f" t = {reached:.4g} s of {duration:g} s: {likely_cause(scene, duration, solver)}"
    )


def _attempt(solver: Integration, p: list[float]) -> list[Array] | None:
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


def _difference(run: Run, averages: Averages, force: Array) -> float:
    """Return the largest relative difference of a run from another with the same output times: see `simulate`.

    Args:
        run: the run.
        averages: of the other.
        force: mount force of the other at the outputs [N].
    """
    scene = run.scene
    # Far below the force of a share that swings freely, a force is the rounding of a deflection.
    least = _LEAST_FORCE * scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia)
    size = max(abs(run.mean_draft), run.force_rms, least)
    pairs = (
        (abs(run.mean_draft - averages.mean_draft), size),
        (abs(run.force_rms - averages.force_rms), size),
        (np.abs(run.mount_force - force).max(), max(np.abs(run.mount_force).max(), least)),
    )
    return max((float(difference / scale) for difference, scale in pairs if scale > 0.0), default=0.0)
