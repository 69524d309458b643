"""Integration of the equation of motion by each method, behind one interface."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.expressions import stacked
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.equation import equation_of_motion, signals, start_state
from plough_opt.motion.methods import METHODS, is_stepped, tableau_of
from plough_opt.motion.orbit import orbit_map
from plough_opt.motion.runge_kutta import run_map
from plough_opt.motion.terms import Structure, lightest_mass, pull, start_resistance
from plough_opt.motion.timeline import Timeline

# A negligible force [N], which keeps the sizes of a scene without forces above zero.
_LEAST_FORCE = 1e-9
_MOST_EVENTS = 1_000_000
# CasADi quotes this name in its error if a forward derivative of a forward derivative, which it lacks, is requested.
_NAME_WITH_EVENTS = "motion_with_events_whose_second_derivatives_are_those_of_a_gradient_as_by_casadi_hessian"
# A failure is reported once, as an IntegrationError, and not by CasADi at every attempt.
_QUIET = {"show_eval_warnings": False}


@dataclass(frozen=True)
class Sized:
    """Run by a CasADi integrator whose absolute tolerances are relative to given sizes.

    The sizes are those of w [m] and w' [m/s], of each of the `signals`, and of the RMS of those that have one.

    Attributes:
        function: (parameters with the duration last, sizes) -> results of an `Integration`.
        expected: parameters -> sizes to expect before a run.
        solver: CasADi's integrator.
        given: (parameters, sizes) -> initial state and parameters of the integrator.
    """

    function: ca.Function
    expected: ca.Function
    solver: ca.Function
    given: ca.Function

    def evaluations(self, p: list[float]) -> tuple[int, int]:
        """Return how often a run evaluates the rates of the equation, and its event functions.

        Args:
            p: the parameters with the duration last.
        """
        first, known = self.given(p, self.expected(p))
        self.solver(x0=first, p=known)
        stats = self.solver.stats()
        return stats["n_call_rhsF"], stats.get("n_call_zeroF", 0)


@dataclass(frozen=True)
class Integration:
    """A run as a CasADi Function of the parameters ``names`` and, last, the duration [s].

    Its results are the states (w [m]; w' [m/s]) at the output times, a column each, the means of the `signals`, and the
    mean squares about the mean of those signals that have an RMS. CasADi's integrators also provide ``sized``, in which
    the sizes for the tolerances can be chosen.
    """

    structure: Structure
    accuracy: Accuracy
    timeline: Timeline
    function: ca.Function
    sized: Sized | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters before the duration."""
        return signals(self.structure).parameters

    @property
    def results(self) -> int:
        """Number of results."""
        return int(self.function.numel_out())


@lru_cache(maxsize=128)
def integration(structure: Structure, accuracy: Accuracy, timeline: Timeline) -> Integration:
    """Return the Function that integrates scenes of a structure by a named method with its setting."""
    if structure.orbit != "transient":
        return Integration(structure, accuracy, timeline, orbit_map(structure, timeline))
    if is_stepped(accuracy.method):
        run = run_map(structure, timeline, tableau_of(accuracy.method))
        return Integration(structure, accuracy, timeline, run)
    # The end of a symbolic ramp cannot be an output time, and a step across it would spoil derivatives by its time.
    locates = timeline.moving and accuracy.locates_events
    sized = _by_casadi(replace(structure, locates_ramp=locates and structure.ramp), accuracy, timeline)
    p = ca.MX.sym("p", sized.expected.size1_in(0))
    results = sized.function.call([p, sized.expected(p)])
    function = ca.Function(f"run_{accuracy.method}", [p], results, {"never_inline": True})
    return Integration(structure, accuracy, timeline, function, sized)


def _by_casadi(structure: Structure, accuracy: Accuracy, timeline: Timeline) -> Sized:
    """Wrap a CasADi integrator of the scaled equation."""
    observed, count = signals(structure), equation_of_motion(structure).states
    equation, transition = _scaled_equation(structure)
    options = _options(accuracy, timeline)
    if transition is not None:
        options |= {"transition": transition, "max_events": _MOST_EVENTS, "event_tol": 1e-12, "max_event_iter": 100}
    # Fixed steps end at the times of the results. The kink is one of them, so that the method keeps its order.
    times = (timeline.stops if METHODS[accuracy.method].order is not None else timeline.output_fractions)[1:]
    read = [int(i) for i in np.searchsorted(times, timeline.output_fractions[1:])]
    name = "motion" if transition is None else _NAME_WITH_EVENTS
    solver = ca.integrator(name, accuracy.method, equation, 0.0, times.tolist(), options)
    p, known = observed.symbols(ca.MX)
    sizes = ca.MX.sym("sizes", 2 + observed.count + observed.squared)
    unit = _units(structure, sizes)
    first = start_state(structure, known)
    given = stacked(first / unit, ca.MX.zeros(observed.squared)), stacked(p, sizes)
    result = solver(x0=given[0], p=given[1])
    states = result["xf"][:count, read] * ca.repmat(unit, 1, timeline.outputs)
    _, of_means, of_spreads = ca.vertsplit(sizes, [0, 2, 2 + observed.count, sizes.numel()])
    spreads, others = ca.vertsplit(result["qf"][:, -1], [0, observed.squared, observed.count])
    means = stacked(result["xf"][count:, -1], others) * of_means
    found = [ca.horzcat(first, states), means, spreads * of_spreads**2]
    function = ca.Function(f"sized_{accuracy.method}", [p, sizes], found, {"never_inline": True})
    expected = ca.Function("expected", [p], [_expected(structure, known, p[-1])])
    return Sized(function, expected, solver, ca.Function("given", [p, sizes], given))


def _expected(structure: Structure, p: dict[str, Any], duration: Any) -> Any:
    """Return the sizes to expect in a `Sized` run. In units of them one absolute tolerance suits every state."""
    # Parameters without influence on the motion count as zero.
    complete = dict.fromkeys(structure.names, 0.0) | p
    stiffness = ca.fabs(p["stiffness"])  # negative for a repelling spring
    hardness = ca.sqrt(stiffness * lightest_mass(p))
    force = start_resistance(structure, complete) + complete["tow_speed"] * hardness + _LEAST_FORCE
    if structure.relaxed and structure.sticks:
        # The resistance may be far greater than the force that the relaxed spring reaches.
        force = ca.fmin(force, complete["tow_speed"] * (stiffness * duration + hardness) + _LEAST_FORCE)
    deflection, rate = force / stiffness, force / hardness
    squared, others = [deflection], []
    if structure.damper:
        squared.append(force + pull(structure, p, 0.0, rate))
    if structure.ramp:
        others.append(force * (p["tow_speed"] + rate))
    return stacked(deflection, rate, *squared, *others, *squared)


def _units(structure: Structure, sizes: Any) -> Any:
    """Return the units of the states: deflection, its rate, opening of a gap; 1 for the mode and other flags."""
    modes = (sizes[0], 1.0) if structure.events else ()
    return stacked(sizes[0], sizes[1], *modes, *(1.0,) * len(structure.ending))


def _scaled_equation(structure: Structure) -> tuple[dict[str, ca.SX], ca.Function | None]:
    """Return CasADi's dictionary of the scaled equation, and its state transition at events, or None.

    Time is scaled by the duration, so that integrals are averages, and states by the given sizes. A mean square about
    the mean integrates the squared deviation from the running mean. Its derivative is exactly that square, so the RMS
    is never a difference of squares.
    """
    motion, observed = equation_of_motion(structure), signals(structure)
    fraction = ca.SX.sym("fraction")
    count = motion.states
    x = ca.SX.sym("x", count + observed.squared)
    p, known = observed.symbols(ca.SX)
    sizes = ca.SX.sym("sizes", 2 + observed.count + observed.squared)
    unit = _units(structure, sizes)
    _, of_means, of_spreads = ca.vertsplit(sizes, [0, 2, 2 + observed.count, sizes.numel()])
    duration = p[-1]
    time, state = fraction * duration, x[:count] * unit
    own = stacked(*(known[name] for name in motion.names))
    rate = motion.function(time, state, own)
    seen = stacked(state[:2], state[-1]) if structure.ends_ramp else state
    values = observed.function(time, seen[: observed.function.size1_in(1)], p[:-1]) / of_means
    squared = values[: observed.squared]
    # At the start the running mean would be 0/0; the deviation is 0 there.
    started = fraction > 0.0
    running_mean = x[count:] / ca.if_else(started, fraction, 1.0)
    deviation = ca.if_else(started, squared - running_mean, 0.0) * of_means[: observed.squared]
    given = stacked(p, sizes)
    equation = {
        "t": fraction,
        "x": x,
        "p": given,
        "ode": stacked(rate * duration / unit, squared),
        "quad": stacked((deviation / of_spreads) ** 2, values[observed.squared :, :]),
    }
    if motion.events is None:
        return equation, None
    index, none = ca.SX.sym("index"), [ca.SX(0, 1), ca.SX(0, 1)]
    zero, after = motion.events(time, state, own)
    chosen = after[:, 0]
    for k in range(1, after.shape[1]):
        chosen = ca.if_else(index < k - 0.5, chosen, after[:, k])
    following = stacked(chosen / unit, x[count:])
    names = ["index", "t", "x", "z", "p", "u"], ["post_x", "post_z"]
    transition = ca.Function("transition", [index, fraction, x, none[0], given, none[1]], [following, none[0]], *names)
    return equation | {"zero": zero}, transition


def _options(accuracy: Accuracy, timeline: Timeline) -> dict[str, Any]:
    """Return CasADi's options for a method and its setting."""
    if not accuracy.adaptive:
        return {"number_of_finite_elements": timeline.steps, **_QUIET}
    tolerance = accuracy.tolerance
    assert tolerance is not None  # `with_setting` or `automatic` has given it one
    options: dict[str, Any] = {**_QUIET, "reltol": tolerance, "abstol": 0.01 * tolerance}
    options["max_num_steps"] = timeline.steps
    if accuracy.method in ("cvodes", "idas"):
        # Without quadratures in the error control, sensitivities by these two methods can be silently wrong.
        options["quad_err_con"] = True
    return options
