"""One integration of a numeric scene by a given method, and the diagnosis if it fails."""

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
from plough_opt.motion.run import OUTPUTS as ARRAYS
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline

Array = NDArray[np.float64]

# An absolute tolerance follows from the expected size of a quantity. It leaves too few digits if the quantity turns out
# smaller than this part of it.
_TOO_SMALL = 0.03
# Bisection for the time at which a motion fails ends at this relative interval, and at this part of the duration.
_FAILURE_INTERVAL = 2e-4
_EARLIEST_FAILURE = 1e-9
# It is done with this tolerance and this limit on the steps, with which a motion without an end fails sooner.
_COARSE_TOLERANCE = 1e-4
_COARSE_STEPS = 10_000


@dataclass(frozen=True)
class Case:
    """A numeric scene and a duration, prepared once for all integrations of them.

    Attributes:
        scene: the scene.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        structure: what the equation of motion contains.
        p: the equation's parameters by name.
        code: compiled steps of order 8, if requested and available.
        event_refinement: factor on the number of outputs of a motion with events, so that none goes unnoticed.
        explained: whether an integration that fails looks for the time and the cause.
    """

    scene: Scene
    duration: float
    outputs: int
    structure: Structure
    p: dict[str, float]
    code: CompiledSteps | None = None
    event_refinement: int = 1
    explained: bool = True

    @classmethod
    def of(cls, scene: Scene, duration: float, outputs: int, *, compiled: bool = False) -> Case:
        """Return the case of a scene; compile its steps if requested and possible.

        Raises:
            InputError: a quantity of the scene is an array.
        """
        structure = Structure.of(scene)
        code = compiled_steps(structure) if compiled and scene.effects.motion and structure.stepped else None
        return cls(scene, duration, outputs, structure, numbers_of(scene, structure), code)

    @property
    def output_factor(self) -> int:
        """Factor on the requested outputs that are computed, because events between distant outputs go unnoticed."""
        return self.event_refinement * -(-OUTPUTS // self.outputs) if self.structure.events else 1

    @cached_property
    def rate(self) -> float:
        """Angular frequency of the fastest oscillation, or rate of decay if that is faster [rad/s]."""
        return fastest_rate(self.p)

    @property
    def phase(self) -> float:
        """Phase of the fastest oscillation over the run [rad]."""
        return self.rate * self.duration


@dataclass(frozen=True)
class Integrated:
    """The run of one integration.

    Attributes:
        run: the run, with `Case.output_factor` times the requested outputs.
        sizes: of the quantities to which an adaptive method relates its tolerance (see `Sized`); None for others. A
            similar integration can use them.
    """

    run: Run
    sizes: Array | None = None


def integrate(case: Case, accuracy: Accuracy, sizes: Array | None = None, *, perturbation: float = 0.0) -> Integrated:
    """Integrate a case by a method.

    Args:
        case: scene and duration.
        accuracy: method and setting.
        sizes: `Integrated.sizes` of a similar run. Without them an adaptive method uses the expected sizes; if it finds
            far smaller ones, which then have few digits, it integrates again with these.
        perturbation: relative change of the parameters, alternately up and down.

    Raises:
        IntegrationError: the method failed; the message names the scene, the time and the likely cause.
        MissedEvent: the method missed an event.
    """
    scene, duration = case.scene, case.duration
    refuse_runaway(scene, duration)
    outputs = case.outputs * case.output_factor
    steps = accuracy.steps or max(outputs, OUTPUTS)
    if accuracy.adaptive:
        steps = most_steps(case.phase)
    timeline = timeline_of(scene, duration, outputs, steps, accuracy.method)
    values = [case.p[name] for name in signals(case.structure).parameters]
    p = [*(value * (1.0 + perturbation * (-1.0) ** k) for k, value in enumerate(values)), duration]
    if case.code is not None and accuracy.order_8 and (found := case.code(timeline, p)) is not None:
        return Integrated(_assembled(case, timeline, found, accuracy))
    solver = integration(case.structure, accuracy, timeline)
    results, sizes = _sized(solver.sized, p, sizes) if solver.sized else (_attempt(solver.function, p), None)
    if results is None:
        _raise_failure(case, solver, p)
    states, means, variances = results
    run = _assembled(case, timeline, (states.T, means.ravel(), variances.ravel()), accuracy)
    if isinstance(scene.effects.contact, StickSlip):
        refuse_missed_event(run)
        refuse_weak_rest(scene, run)
    return Integrated(run, sizes)


def _assembled(case: Case, timeline: Timeline, found: tuple[Array, Array, Array], accuracy: Accuracy) -> Run:
    """Return the run of (states with a row for each output, means of the signals, mean squares about them)."""
    fractions, known = timeline.output_fractions, (case.structure, case.p)
    return assemble(case.scene, case.duration, fractions, *found, accuracy, known)


def thinned(run: Run, outputs: int) -> Run:
    """Return a run with fewer equal intervals between outputs; the run must have a multiple of them."""
    every = (len(run.time) - 1) // outputs
    if every == 1:
        return run
    return replace(run, **{name: getattr(run, name)[::every] for name in ARRAYS})


def _sized(sized: Sized, p: list[float], sizes: Array | None) -> tuple[list[Array] | None, Array | None]:
    """Return the results of an adaptive method (None if it failed) and the sizes of their quantities."""
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
    """Return the expected sizes, replaced by the true ones where these are far smaller."""
    states, means, variances = results
    rms = np.sqrt(np.maximum(variances.ravel(), 0.0))
    averages = np.abs(means.ravel())
    averages[: rms.size] += rms
    found = np.concatenate([np.abs(states[:2]).max(axis=1), averages, rms])
    return np.where((found > 0.0) & (found < _TOO_SMALL * expected), found, expected)


def _raise_failure(case: Case, solver: Integration, p: list[float]) -> NoReturn:
    """Raise the IntegrationError that says when and why an integration failed."""
    scene, duration = case.scene, case.duration
    if scene.effects.orbit != "transient":
        raise IntegrationError(
            f"no periodic orbit of a {scene.describe()} was found from its linear response: damp the mount, or use"
            " orbit = 'transient' to see whether the motion settles"
        )
    if not case.explained:
        raise IntegrationError(f"the motion of a {scene.describe()} could not be integrated")
    raise failed_by(scene, duration, solver, *_until_failure(case, solver, p))


def _until_failure(case: Case, solver: Integration, p: list[float]) -> tuple[Run | None, float]:
    """Return the motion until shortly before the integration fails, and the time from there to the failure [s]."""
    method: str = "rosenbrock" if case.phase > STIFF_PHASE else "erk"
    coarse = Accuracy(method, tolerance=_COARSE_TOLERANCE)
    timeline = timeline_of(case.scene, case.duration, OUTPUTS, _COARSE_STEPS, method)
    coarse_solver = integration(case.structure, coarse, timeline)
    if _attempt(coarse_solver.function, p) is None:
        solver = coarse_solver
    reached, failed = 0.0, case.duration
    last: list[Array] | None = None
    while failed - reached > failed * _FAILURE_INTERVAL and failed > _EARLIEST_FAILURE * case.duration:
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
    with np.errstate(all="ignore"):  # steps that are too long may give any numbers
        return _assembled(until, solver.timeline, found, solver.accuracy), failed - reached


def _attempt(function: Any, *inputs: list[float] | Array) -> list[Array] | None:
    """Return the results of a Function, or None if it failed or they are not finite."""
    given = [np.array(values) for values in inputs]
    untyped: Any = function.buffer()  # CasADi's type stubs do not accept arrays
    buffer, evaluate = untyped
    for k, values in enumerate(given):
        buffer.set_arg(k, values.data)
    # CasADi does not write a result that is zero by structure.
    results = [np.zeros(function.size_out(k), order="F") for k in range(function.n_out())]
    for k, result in enumerate(results):
        if function.nnz_out(k) == result.size:
            buffer.set_res(k, result.ravel(order="K").data)
    try:
        evaluate()
    except RuntimeError:
        return None
    valid = buffer.ret() == 0 and all(np.isfinite(result).all() for result in results)
    return results if valid else None
