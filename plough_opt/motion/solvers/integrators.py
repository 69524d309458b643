"""Integration of the equation of motion by each method: as a CasADi Function, in a user's graph, and of numbers.

The quasi-static limit, which needs no integration, is computed here too.

A symbolic run is one call in the user's graph that carries its scene, so that a design can find and check it. A numeric
run is one call of the Function or, if the system has a compiler, the same operations in machine code.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import attach, shared
from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import (
    Column,
    Expression,
    column,
    dot,
    is_casadi,
    is_symbolic,
    key_of,
    rms,
    stacked,
    template_of,
)
from plough_opt.core.process import without_notices
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.effects.terms import Parameters
from plough_opt.motion.equation import Equation, OfEquation, Structure, equation_of
from plough_opt.motion.methods import METHODS, Accuracy
from plough_opt.motion.run import ARRAYS, Averages, Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers import plan
from plough_opt.motion.solvers.checks import (
    failed_by,
    refuse_missed_event,
    refuse_runaway,
    refuse_weak_rest,
    relative_difference,
)
from plough_opt.motion.solvers.compiled_steps import CompiledSteps, compiled_steps
from plough_opt.motion.solvers.orbit import orbit_map, without_orbit
from plough_opt.motion.solvers.steps import GAUSS_POINTS, Array, Timeline, quadrature, run_map

# CasADi quotes this name in its error if a forward derivative of a forward derivative, which it lacks, is requested.
_NAME_WITH_EVENTS = "motion_with_events_whose_second_derivatives_are_those_of_a_gradient_as_by_casadi_hessian"
# A failure is reported once, as an IntegrationError, and not by CasADi at every attempt.
_QUIET = {"show_eval_warnings": False}


@dataclass(frozen=True)
class Integration(OfEquation):
    """A run as a CasADi Function of the parameters ``names`` and, last, the duration [s].

    Its results are the states (w [m]; w' [m/s]) at the output times, a column each, the means of the `signals`, and the
    mean squares about the mean of those signals that have an RMS. CasADi's integrators also provide ``sized``:
    (parameters, sizes as in `Equation.sizes`, to which the tolerances relate) -> the same results.
    """

    equation: Equation
    accuracy: Accuracy
    timeline: Timeline
    function: ca.Function
    sized: ca.Function | None = None

    @property
    def results(self) -> int:
        """Number of results."""
        return int(self.function.numel_out())


@lru_cache(maxsize=128)
def integration(structure: Structure, accuracy: Accuracy, timeline: Timeline) -> Integration:
    """Return the Function that integrates scenes of a structure by a named method with its setting."""
    equation = equation_of(structure)
    if structure.orbit != "transient":
        return Integration(equation, accuracy, timeline, orbit_map(equation, timeline))
    if (tableau := accuracy.tableau) is not None:
        return Integration(equation, accuracy, timeline, run_map(equation, timeline, tableau))
    # A step across the end of a ramp would spoil derivatives by its time.
    located = equation_of(replace(structure, locates_ramp=structure.ramp and accuracy.locates_events))
    sized = _by_casadi(located, accuracy, timeline)
    p, _ = located.symbols(ca.MX)
    states, *averages = sized.call([p, located.sizes(p)])
    # Whether the ramp is over is a state of its own, which a run does not have.
    results = [states[: equation.states, :], *averages]
    function = ca.Function(f"run_{accuracy.method}", [p], results, {"never_inline": True})
    return Integration(equation, accuracy, timeline, function, sized)


def _by_casadi(equation: Equation, accuracy: Accuracy, timeline: Timeline) -> ca.Function:
    """Return a CasADi integrator of the equation, scaled by given sizes: `Integration.sized`."""
    scaled, transition = _scaled_equation(equation)
    options = _options(accuracy, timeline)
    if transition is not None:
        options |= {"transition": transition, "max_events": 1_000_000, "event_tol": 1e-12, "max_event_iter": 100}
    # Fixed steps end at the times of the results. The kink is one of them, so that the method keeps its order.
    times = (timeline.stops if METHODS[accuracy.method].order is not None else timeline.output_fractions)[1:]
    read = [int(i) for i in np.searchsorted(times, timeline.output_fractions[1:])]
    name = "motion" if transition is None else _NAME_WITH_EVENTS
    with without_notices():
        solver = ca.integrator(name, accuracy.method, scaled, 0.0, times.tolist(), options)
    p, _ = equation.symbols(ca.MX)
    sizes = ca.MX.sym("sizes", 2 + equation.averages)
    unit, of_means, of_spreads = units(equation, sizes)
    first = equation.start(p[:-1])
    result = solver(x0=stacked(first / unit, ca.MX.zeros(equation.squared)), p=stacked(p, sizes))
    states = result["xf"][: equation.states, read] * ca.repmat(unit, 1, timeline.outputs)
    spreads, others = ca.vertsplit(result["qf"][:, -1], [0, equation.squared, equation.count])
    means = stacked(result["xf"][equation.states :, -1], others) * of_means
    results = [ca.horzcat(first, states), means, spreads * of_spreads**2]
    return ca.Function(f"sized_{accuracy.method}", [p, sizes], results, {"never_inline": True})


def units(equation: Equation, sizes: Any) -> tuple[Any, Any, Any]:
    """Return the units of the states, of the signals and of their RMS.

    Those of the states are of deflection, its rate and the opening of a gap; 1 for the mode and other flags.
    """
    modes = (sizes[0], 1.0) if equation.structure.events else ()
    of_states = stacked(sizes[0], sizes[1], *modes, *(1.0,) * len(equation.structure.ending))
    return of_states, *ca.vertsplit(sizes, [0, 2, 2 + equation.count, sizes.numel()])[1:]


def _scaled_equation(equation: Equation) -> tuple[dict[str, ca.SX], ca.Function | None]:
    """Return CasADi's dictionary of the scaled equation, and its state transition at events, or None.

    Time is scaled by the duration, so that integrals are averages, and states by the given sizes. A mean square about
    the mean integrates the squared deviation from the running mean. Its derivative is exactly that square, so the RMS
    is never a difference of squares.
    """
    fraction = ca.SX.sym("fraction")
    count = equation.states
    x = ca.SX.sym("x", count + equation.squared)
    p, _ = equation.symbols(ca.SX)
    sizes = ca.SX.sym("sizes", 2 + equation.averages)
    unit, of_means, of_spreads = units(equation, sizes)
    duration = p[-1]
    time, state = fraction * duration, x[:count] * unit
    rate, values = equation.rate(time, state, p[:-1]), equation.signals(time, state, p[:-1]) / of_means
    squared = values[: equation.squared]
    # At the start the running mean would be 0/0; the deviation is 0 there.
    started = fraction > 0.0
    running_mean = x[count:] / ca.if_else(started, fraction, 1.0)
    deviation = ca.if_else(started, squared - running_mean, 0.0) * of_means[: equation.squared]
    given = stacked(p, sizes)
    scaled = {
        "t": fraction,
        "x": x,
        "p": given,
        "ode": stacked(rate * duration / unit, squared),
        "quad": stacked((deviation / of_spreads) ** 2, values[equation.squared :, :]),
    }
    if equation.events is None:
        return scaled, None
    index, none = ca.SX.sym("index"), [ca.SX(0, 1), ca.SX(0, 1)]
    zero, after = equation.events(time, state, p[:-1])
    chosen = after[:, 0]
    for k in range(1, after.shape[1]):
        chosen = ca.if_else(index < k - 0.5, chosen, after[:, k])
    following = stacked(chosen / unit, x[count:])
    names = ["index", "t", "x", "z", "p", "u"], ["post_x", "post_z"]
    transition = ca.Function("transition", [index, fraction, x, none[0], given, none[1]], [following, none[0]], *names)
    return scaled | {"zero": zero}, transition


def _options(accuracy: Accuracy, timeline: Timeline) -> dict[str, Any]:
    """Return CasADi's options for a method and its setting."""
    if not accuracy.adaptive:
        return {"number_of_finite_elements": timeline.steps, **_QUIET}
    tolerance = accuracy.tolerance
    assert tolerance is not None  # `with_setting` or `automatic` has given it one
    # Without quadratures in the error control, sensitivities by these two methods can be silently wrong.
    quadratures = {"quad_err_con": True} if accuracy.method in ("cvodes", "idas") else {}
    tolerances = {"reltol": tolerance, "abstol": 0.01 * tolerance}
    return {**_QUIET, **tolerances, "max_num_steps": timeline.steps, **quadratures}


@dataclass(frozen=True)
class Embedding:
    """Meaning of a call in a graph: (parameters, the duration last; quantities of the scene) -> results of a run.

    The quantities do not influence the results; with them a design can rebuild the scene.

    Attributes:
        integration: method, structure and times.
        template: the scene with a placeholder for each of its quantities.
    """

    integration: Integration
    template: Scene


def embed(solver: Integration, p: Sequence[Expression], scene: Scene) -> tuple[Column, ...]:
    """Return the results of a run as expressions of the symbols in its scene.

    Args:
        solver: the integration.
        p: its parameters, the duration last.
        scene: the scene from which they were computed.

    Raises:
        InputError: the symbols are SX, and the method supports only MX.
    """
    template, carried, key = _carried(scene)
    inputs = stacked(*p)
    if isinstance(inputs, ca.SX) or isinstance(carried, ca.SX):
        if solver.structure.orbit != "transient":
            raise InputError("an orbit takes MX symbols only, because it is the root of an equation: use casadi.MX")
        if solver.accuracy.tableau is None:
            raise InputError(f"method '{solver.accuracy.method}' takes MX symbols only: use casadi.MX, or use 'dop853'")
        return tuple(solver.function.call([inputs]))
    # Quantities are placeholders in the template, so that scenes which differ only in numbers share one Function.
    run = shared(
        ("run", hash(solver.function), key), lambda: (_build(solver, carried.numel()), Embedding(solver, template))
    )
    return tuple(run.call([inputs, carried]))


def _labelled(value: Column, scene: Scene) -> Expression:
    """Return a value with its scene attached as a label if the scene holds MX symbols."""
    template, carried, key = _carried(scene)
    if isinstance(carried, ca.MX) and is_symbolic(carried):
        value = ca.MX(value)
    return attach(value, carried, template, key)


def _carried(scene: Scene) -> tuple[Scene, Column, Hashable]:
    """Return a scene's template, a column of its quantities, and a key of the template."""
    template, quantities = template_of(scene)
    return template, stacked(*quantities), key_of(template)


def _build(solver: Integration, count: int) -> ca.Function:
    p, carried = ca.MX.sym("p", solver.function.numel_in(0)), ca.MX.sym("scene", count)
    # If a share never leaves equilibrium, its results are zero by structure. Made dense, they keep the call in the
    # graph, and with it the scene.
    results = [ca.densify(result) for result in solver.function.call([p])]
    names = ["parameters", "scene"], ["states", "means", "variances"]
    return ca.Function("run", [p, carried], results, *names, {"never_inline": True})


def assemble(
    scene: Scene,
    p: Parameters,
    duration: Expression,
    fractions: NDArray[np.float64],
    states: Column,
    means: Column,
    variances: Column,
    accuracy: Accuracy,
) -> Run:
    """Return the run that belongs to integrated changes since the start.

    Args:
        scene: the scene, numeric or symbolic.
        p: its parameters, as `plough_opt.motion.equation.parameters` returns them.
        duration: simulated time [s].
        fractions: output times as fractions of the duration.
        states: states (w, w', ...) in columns, a row for each output.
        means: means of the signals of `plough_opt.motion.equation`.
        variances: mean squares about the mean of those signals that have an RMS.
        accuracy: method and setting used.
    """
    structure, time = Structure.of(scene), column(fractions, is_casadi(states)) * duration
    state = [states[:, k] for k in range(states.shape[1])]
    force, soil, deflection, speed, travel, opening, mode = structure.outputs(p, time, state)
    averages = Averages(*structure.averages(p, means, variances))
    return Run(scene, duration, time, travel, speed, deflection, force, soil, opening, mode, averages, accuracy)


def symbolic(scene: Scene, p: Parameters, duration: Expression, accuracy: Accuracy, outputs: int) -> Run:
    """Return the run as expressions of the scene's symbols.

    Args:
        scene: the scene.
        p: its parameters, as `plough_opt.motion.equation.parameters` returns them.
        duration: simulated time [s].
        accuracy: the setting that was asked for.
        outputs: number of intervals between output times.

    Raises:
        InputError: as `embed`.
    """
    accuracy, timeline = plan.of_symbols(scene, p, duration, accuracy, outputs)
    if not scene.effects.motion:
        # Gauss-Legendre nodes in each panel of a symbolic run, whose graph grows with them.
        return quasi_static(scene, p, duration, timeline, accuracy, 4)
    solver = integration(Structure.of(scene), accuracy, timeline)
    states, means, variances = embed(solver, solver.equation.column(p, duration), scene)
    return assemble(scene, p, duration, timeline.output_fractions, states.T, means, variances, accuracy)


def quasi_static(
    scene: Scene,
    p: Parameters,
    duration: Expression,
    timeline: Timeline,
    accuracy: Accuracy,
    points: int = GAUSS_POINTS,
) -> Run:
    """Return the run of a share that follows the strut: P = F0 (1 + eps sin(2 pi s/ell)) + Fd s'^2, z = P/k0.

    Averages are composite Gauss-Legendre quadratures with a panel for each step of the timeline.

    Args:
        scene: the scene, numeric or symbolic.
        p: its parameters, as `plough_opt.motion.equation.parameters` returns them.
        duration: simulated time [s].
        timeline: panels and outputs.
        accuracy: the setting, which the run keeps.
        points: number of nodes in each panel.
    """
    structure, columns = Structure.of(scene), any(map(is_casadi, (*p.values(), duration)))
    steady = structure.steady_resistance(p, scene.tow_speed)
    p = {**p, "static": _labelled(p["static"], scene)}
    nodes, weights = quadrature(timeline, points)

    def course(fractions: Column) -> tuple[Column, Column, Column, Column]:
        """Return time [s], path [m], speed [m/s] and resistance [N] at fractions of the duration."""
        time = (column(fractions, columns) if isinstance(fractions, np.ndarray) else fractions) * duration
        path, speed = structure.towed(p, time)
        force, everywhere = structure.resistance(p, path, speed), 0.0 * time
        return time, path + everywhere, speed + everywhere, force + everywhere

    time, path, speed, force = course(timeline.output_fractions)
    _, _, node_speed, node_force = course(nodes)
    # Averages of the change since the first node: a constant force then has no variance by rounding of the weights.
    change = node_force - node_force[0]
    mean_change = dot(weights, change)
    mean_draft = node_force[0] + mean_change
    variance = dot(weights, (change - mean_change) ** 2)
    force_rms, stiffness, still = rms(variance, steady), scene.stiffness, 0.0 * force + 0.0
    tow_power = dot(weights, node_force * node_speed)
    averages = Averages(mean_draft, force_rms, mean_draft / stiffness, force_rms / stiffness, tow_power)
    deflection = force / stiffness
    return Run(scene, duration, time, path, speed, deflection, force, force, still, still, averages, accuracy)


@dataclass(frozen=True)
class Case(OfEquation):
    """A numeric scene and a duration, prepared once for all integrations of them.

    Attributes:
        scene: the scene.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        equation: the equation of motion.
        p: the equation's parameters by name.
        code: compiled steps of order 8, if requested and available.
    """

    scene: Scene
    duration: float
    outputs: int
    equation: Equation
    p: Mapping[str, float]
    code: CompiledSteps | None = None

    @classmethod
    def of(cls, scene: Scene, duration: float, outputs: int, *, compiled: bool = False) -> Case:
        """Return the case of a scene; compile its steps if requested and possible.

        Raises:
            InputError: a quantity of the scene is an array.
        """
        structure = Structure.of(scene)
        code = compiled_steps(structure) if compiled and scene.effects.motion and structure.stepped else None
        return cls(scene, duration, outputs, equation_of(structure), plan.numbers_of(scene), code)

    @property
    def output_factor(self) -> int:
        """Factor on the requested outputs that are computed, because events between distant outputs go unnoticed."""
        return -(-plan.OUTPUTS // self.outputs) if self.structure.events else 1

    @property
    def rate(self) -> float:
        """Angular frequency of the fastest oscillation, or rate of decay if that is faster [rad/s]."""
        return plan.rates_of(self.scene).fastest

    @cached_property
    def column(self) -> list[float]:
        """Parameters of the equation, with the duration last."""
        return self.equation.column(self.p, self.duration)

    def timeline(self, outputs: int, accuracy: Accuracy, steps: int = plan.OUTPUTS) -> Timeline:
        """Return the times of a run by a method, with its own number of steps if it has one."""
        return plan.timeline_of(self.scene, self.duration, outputs, accuracy.steps or steps, accuracy.method)

    @property
    def phase(self) -> float:
        """Phase of the fastest oscillation over the run [rad]."""
        return self.rate * self.duration


def integrate(case: Case, accuracy: Accuracy, *, perturbation: float = 0.0) -> Run:
    """Integrate a case by a method.

    Args:
        case: scene and duration.
        accuracy: method and setting.
        perturbation: relative change of the parameters, alternately up and down.

    Raises:
        IntegrationError: the method failed; the message names the scene, the time and the likely cause.
        MissedEvent: the method missed an event.
    """
    scene, duration = case.scene, case.duration
    refuse_runaway(scene, duration)
    outputs = case.outputs * case.output_factor
    steps = plan.most_steps(case.phase) if accuracy.adaptive else max(outputs, plan.OUTPUTS)
    timeline = case.timeline(outputs, accuracy, steps)
    p = [*(value * (1.0 + perturbation * (-1.0) ** k) for k, value in enumerate(case.column[:-1])), duration]
    results = case.code(timeline, p) if case.code is not None and accuracy.order_8 else None
    if results is None:
        solver = integration(case.structure, accuracy, timeline)
        results = _attempt(solver.function, p) if solver.sized is None else _sized(solver.sized, case.equation, p)
    if results is None:
        if scene.effects.orbit != "transient":
            raise IntegrationError(without_orbit(scene))
        raise failed_by(scene, duration, accuracy)
    run = assemble(scene, case.p, duration, timeline.output_fractions, *results, accuracy)
    if isinstance(scene.effects.contact, StickSlip):
        refuse_missed_event(run)
        refuse_weak_rest(run)
    if (every := case.output_factor) > 1:
        run = replace(run, **{name: getattr(run, name)[::every] for name in ARRAYS})
    return run


def compared(case: Case, accuracy: Accuracy, check: Accuracy) -> tuple[Run, float] | None:
    """Return a run by compiled steps and its `difference` from its check, which one call integrates side by side.

    The result is None if the steps leave results that are not finite.
    """
    assert case.code is not None  # see `Case`
    scene, p, equation = case.scene, case.p, case.equation
    refuse_runaway(scene, case.duration)
    timelines = case.timeline(case.outputs, accuracy), case.timeline(case.outputs, check)
    found = case.code.both(timelines, case.column, [p[name] for name in equation.outputs[0]])
    if found is None:
        return None
    (force, soil, deflection, speed, travel), sizes, averages = found
    ours, theirs = (
        Averages(*case.structure.averages(p, row[: equation.count], row[equation.count :])) for row in averages.tolist()
    )
    time, none = timelines[0].output_fractions * case.duration, np.zeros(len(force))
    run = Run(scene, case.duration, time, travel, speed, deflection, force, soil, none, none, ours, accuracy)
    largest, differences = sizes.tolist()
    return run, relative_difference(run, largest, differences, theirs)


Results = tuple[Array, Array, Array]
"""States at the output times, a row each, means of the signals, and mean squares about them."""


def _sized(function: ca.Function, equation: Equation, p: list[float]) -> Results | None:
    """Return the results of an adaptive method, integrated again if quantities are far smaller than expected."""
    sizes: Array = equation.sizes(p).full().ravel()
    results = _attempt(function, p, sizes)
    if results is None:
        return None
    states, means, variances = results
    rms, averages = np.sqrt(np.maximum(variances, 0.0)), np.abs(means)
    averages[: rms.size] += rms
    true = np.concatenate([np.abs(states[:, :2]).max(axis=0), averages, rms])
    # An absolute tolerance follows from the expected size of a quantity. It leaves too few digits if the quantity turns
    # out smaller than this part of it.
    small = (true > 0.0) & (true < 0.03 * sizes)
    return (_attempt(function, p, np.where(small, true, sizes)) or results) if small.any() else results


def _attempt(function: ca.Function, *inputs: list[float] | Array) -> Results | None:
    """Return the results of an integration's Function, or None if it failed or they are not finite."""
    try:
        states, means, variances = (part.full() for part in function.call([ca.DM(values) for values in inputs]))
    except RuntimeError:
        return None
    results = states.T, means.ravel(), variances.ravel()
    return results if all(np.isfinite(part).all() for part in results) else None
