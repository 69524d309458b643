"""A numeric scene followed once, by a method with its setting, or a reason why it cannot be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import IntegrationError
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.assembly import assemble
from plough_opt.motion.compiled_steps import CompiledSteps, compiled_steps
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import Integration, Sized, integration
from plough_opt.motion.judgement import failed_by, refuse_missed_event, refuse_runaway, refuse_weak_rest
from plough_opt.motion.plan import OUTPUTS, STIFF_PHASE, fastest_rate, most_steps, numbers_of, timeline_of
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline

Array = NDArray[np.float64]

# Part of the expected sizes below which an absolute tolerance related to those leaves few digits.
_SMALL = 0.03
# When a motion fails is found by halving the time, with a tolerance and steps that soon come to the end of it.
_CLOSE = 2e-4
_SHORTEST = 1e-9
_COARSE = 1e-4
_COARSE_STEPS = 10_000


@dataclass(frozen=True)
class Case:
    """A numeric scene over a time, read once for all its integrations.

    Attributes:
        scene: the scene.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        structure: what its equation of motion contains.
        p: the equation's parameters by name.
        closer: how many times as many outputs as usual are followed where events may go unnoticed.
        code: its steps of order 8 in machine code, where they are wanted and can be had.
    """

    scene: Scene
    duration: float
    outputs: int
    structure: Structure
    p: dict[str, float]
    code: CompiledSteps | None = None
    closer: int = 1

    @classmethod
    def of(cls, scene: Scene, duration: float, outputs: int, *, compiled: bool = False) -> Case:
        """Read a scene; translate its steps if they shall be compiled and can be.

        Raises:
            InputError: an array in the scene.
        """
        structure = Structure.of(scene)
        code = compiled_steps(structure) if compiled and scene.effects.motion and structure.stepped else None
        return cls(scene, duration, outputs, structure, numbers_of(scene, structure), code)

    @property
    def every(self) -> int:
        """How many times as many outputs are followed: between few, events would go unnoticed."""
        return self.closer * -(-OUTPUTS // self.outputs) if self.structure.events else 1

    @cached_property
    def rate(self) -> float:
        """Angular frequency of the fastest oscillation, or rate of decay if that is faster [rad/s]."""
        return fastest_rate(self.p)

    @property
    def phase(self) -> float:
        """Phase of the fastest oscillation over the run [rad]."""
        return self.rate * self.duration


@dataclass(frozen=True)
class Followed:
    """A motion, and what a run of its like can learn from it.

    Attributes:
        run: the motion, at `Case.every` times as many outputs as are wanted.
        sizes: of what moves, to which an adaptive method relates its tolerance: see `Sized`. None of another method.
    """

    run: Run
    sizes: Array | None = None


def follow(case: Case, accuracy: Accuracy, sizes: Array | None = None, *, shaken: float = 0.0) -> Followed:
    """Follow a motion by a method with its setting.

    Args:
        case: scene and duration.
        accuracy: method and setting.
        sizes: of a run of its like. Without them an adaptive method takes those that are to be expected, and if it
            finds far smaller ones, of which it then knows few digits, it follows the motion again.
        shaken: relative change of every parameter, up and down in turn.

    Raises:
        IntegrationError: the method failed; the message says for which scene, when and the likely cause.
        MissedEvent: it missed an event.
    """
    scene, duration = case.scene, case.duration
    refuse_runaway(scene, duration)
    outputs = case.outputs * case.every
    steps = accuracy.steps or max(outputs, OUTPUTS)
    if accuracy.adaptive:
        steps = most_steps(case.phase)
    timeline = timeline_of(scene, duration, outputs, steps, accuracy.method)
    values = [case.p[name] for name in signals(case.structure).parameters]
    p = [*(value * (1.0 + shaken * (-1.0) ** k) for k, value in enumerate(values)), duration]
    if case.code is not None and accuracy.order_8 and (found := case.code(timeline, p)) is not None:
        return Followed(_assembled(case, timeline, found, accuracy))
    solver = integration(case.structure, accuracy, timeline)
    results, sizes = _sized(solver.sized, p, sizes) if solver.sized else (_attempt(solver.function, p), None)
    if results is None:
        _refuse(case, solver, p)
    states, means, variances = results
    run = _assembled(case, timeline, (states.T, means.ravel(), variances.ravel()), accuracy)
    if isinstance(scene.effects.contact, StickSlip):
        refuse_missed_event(run)
        refuse_weak_rest(scene, run)
    return Followed(run, sizes)


def _assembled(case: Case, timeline: Timeline, found: tuple[Array, Array, Array], accuracy: Accuracy) -> Run:
    """Return the run of states in rows of outputs, means and mean squares of the signals."""
    fractions, known = timeline.output_fractions, (case.structure, case.p)
    return assemble(case.scene, case.duration, fractions, *found, accuracy, known)


def thinned(run: Run, outputs: int) -> Run:
    """Return a run at so many equal intervals between outputs, of which it has a multiple."""
    every = (len(run.time) - 1) // outputs
    if every == 1:
        return run
    arrays = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance", "opening", "mode")
    return replace(run, **{name: getattr(run, name)[::every] for name in arrays})


def _sized(sized: Sized, p: list[float], sizes: Array | None) -> tuple[list[Array] | None, Array | None]:
    """Return the results, and the sizes of what they hold."""
    expected = sized.expected(p).full().ravel()
    results = _attempt(sized.function, p, expected if sizes is None else sizes)
    if results is None:
        return None, None
    found = _sizes(results, expected)
    if sizes is None and np.any(found < expected):
        results = _attempt(sized.function, p, found)
        if results is not None:
            found = _sizes(results, expected)
    return results, found


def _sizes(results: list[Array], expected: Array) -> Array:
    """Return the expected sizes of what was found, and where they are far too large, the true ones."""
    states, means, variances = results
    rms = np.sqrt(np.maximum(variances.ravel(), 0.0))
    averages = np.abs(means.ravel())
    averages[: rms.size] += rms
    found = np.concatenate([np.abs(states[:2]).max(axis=1), averages, rms])
    return np.where((found > 0.0) & (found < _SMALL * expected), found, expected)


def _refuse(case: Case, solver: Integration, p: list[float]) -> NoReturn:
    """Say of an integration that failed when and why it did."""
    scene, duration = case.scene, case.duration
    if scene.effects.orbit != "transient":
        raise IntegrationError(
            f"no lasting orbit of a {scene.describe()} was found from its linear response: simulate it from a start,"
            " orbit = 'transient', to see whether it settles, or damp the mount"
        )
    raise failed_by(scene, duration, solver, *_last(case, solver, p))


def _last(case: Case, solver: Integration, p: list[float]) -> tuple[Run | None, float]:
    """Return the motion until shortly before it can no longer be followed, and the pause until then [s]."""
    method: str = "rosenbrock" if case.phase > STIFF_PHASE else "erk"
    coarse = Accuracy(method, tolerance=_COARSE)
    sooner = integration(case.structure, coarse, timeline_of(case.scene, case.duration, OUTPUTS, _COARSE_STEPS, method))
    if _attempt(sooner.function, p) is None:
        # Coarse steps come to the end of a motion that has one in a fraction of the time.
        solver = sooner
    reached, failed = 0.0, case.duration
    last: list[Array] | None = None
    while failed - reached > failed * _CLOSE and failed > _SHORTEST * case.duration:
        middle = (reached + failed) / 2.0
        results = _attempt(solver.function, [*p[:-1], middle])
        if results is None:
            failed = middle
        else:
            reached, last = middle, results
    if last is None:
        return None, failed
    states, means, variances = last
    until = replace(case, duration=reached)
    found = states.T, means.ravel(), variances.ravel()
    with np.errstate(all="ignore"):  # steps that are too long end in any numbers
        return _assembled(until, solver.timeline, found, solver.accuracy), failed - reached


def _attempt(function: Any, *inputs: list[float] | Array) -> list[Array] | None:
    """Return the results, or None where the method failed or they are not finite."""
    given = [np.array(values) for values in inputs]
    made: Any = function.buffer()  # its stubs know no arrays
    buffer, evaluate = made
    for k, values in enumerate(given):
        buffer.set_arg(k, values.data)
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
