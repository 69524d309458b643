"""The equation of motion under each integration method, behind one interface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.accuracy import ADAPTIVE, FIXED_STEP, ORDER_8, Accuracy
from plough_opt.motion.equation import equation_of_motion, start_state
from plough_opt.motion.orbit import orbit_map
from plough_opt.motion.runge_kutta import run_map
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure, lightest_mass, start_resistance
from plough_opt.motion.timeline import Timeline

# Lower than any force that matters; keeps the scales of a scene without forces above zero.
_LEAST_FORCE = 1e-9
_MOST_EVENTS = 1_000_000
# A failure is reported once, as an IntegrationError, and not by CasADi at every attempt.
_QUIET = {"show_eval_warnings": False}


@dataclass(frozen=True)
class Integration:
    """A run as a CasADi Function of the parameters ``names`` and, last, the duration [s].

    Its results are the states (w [m]; w' [m/s]) at the output times, a column each, the means of the
    `signals`, and the mean squares about the mean of those signals that have an RMS.
    """

    structure: Structure
    accuracy: Accuracy
    timeline: Timeline
    function: ca.Function

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters before the duration."""
        return signals(self.structure).parameters


@lru_cache(maxsize=128)
def integration(structure: Structure, accuracy: Accuracy, timeline: Timeline) -> Integration:
    """Build, or find, the Function that integrates scenes of a structure by a named method with its setting."""
    if structure.orbit != "transient":
        function = orbit_map(structure, timeline)
    elif accuracy.method in ORDER_8:
        function = run_map(structure, timeline)
    else:
        function = _by_casadi(structure, accuracy, timeline)
    return Integration(structure, accuracy, timeline, function)


def _by_casadi(structure: Structure, accuracy: Accuracy, timeline: Timeline) -> ca.Function:
    """Wrap a CasADi integrator of the scaled equation in the interface of `Integration`."""
    observed, count = signals(structure), equation_of_motion(structure).states
    equation, transition = _scaled_equation(structure)
    options = _options(accuracy, timeline)
    if transition is not None:
        options |= {"transition": transition, "max_events": _MOST_EVENTS, "event_tol": 1e-12, "max_event_iter": 100}
    # Fixed steps end where the result is asked for: at the kink too, so that they keep their order.
    times = (timeline.stops if accuracy.method in FIXED_STEP else timeline.output_fractions)[1:]
    asked = [int(i) for i in np.searchsorted(times, timeline.output_fractions[1:])]
    solver = ca.integrator("motion", accuracy.method, equation, 0.0, times.tolist(), options)
    p = ca.MX.sym("p", len(observed.parameters) + 1)
    known = observed.named(p)
    scales = _scales(structure, known)
    unit = _units(structure, scales)
    first = start_state(structure, known)
    result = solver(x0=ca.vertcat(first / unit, ca.MX.zeros(observed.squared)), p=ca.vertcat(p, *scales))
    states = result["xf"][:count, asked] * ca.repmat(unit, 1, timeline.outputs)
    sizes = _signal_scales(structure, known, scales)
    spreads, others = ca.vertsplit(result["qf"][:, -1], [0, observed.squared, observed.count])
    integrals = ca.vertcat(result["xf"][count:, -1], others)
    return ca.Function(
        f"run_{accuracy.method}",
        [p],
        [
            ca.horzcat(first, states),
            integrals * sizes,
            spreads * sizes[: observed.squared] ** 2,
        ],
        {"never_inline": True},
    )


def _scales(structure: Structure, p: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return scales of deflection [m] and rate [m/s], so that one absolute tolerance fits both, and of force [N]."""
    # A parameter that nothing in the equation needs moves nothing, and counts as zero here.
    own = (name for k, term in enumerate(structure.own) for name in term.names(k))
    complete = {**dict.fromkeys(("static", "drag", "rate_term", "tow_speed", *own), 0.0), **p}
    stiffness = ca.fabs(p["stiffness"])  # below zero where a spring repels
    hardness = ca.sqrt(stiffness * lightest_mass(p))
    force = start_resistance(structure, complete) + complete["tow_speed"] * hardness + _LEAST_FORCE
    return force / stiffness, force / hardness, force


def _units(structure: Structure, scales: Any) -> Any:
    """Return the units of an equation's states: deflection, rate, a gap's opening; mode and entry count."""
    modes = (scales[0], 1.0) if structure.events else ()
    return ca.vertcat(scales[0], scales[1], *modes, *((1.0,) if structure.entry else ()))


def _signal_scales(structure: Structure, p: dict[str, Any], scales: tuple[Any, Any, Any]) -> Any:
    """Return the scale of each signal, in the order of `signals`, from those of deflection, rate and force."""
    deflection, rate, force = scales
    sizes = [deflection]
    if structure.damper:
        sizes.append(force + p["damping"] * rate)
    if structure.ramp:
        sizes.append(force * (p["tow_speed"] + rate))
    return ca.vertcat(*sizes)


def _scaled_equation(structure: Structure) -> tuple[dict[str, ca.SX], ca.Function | None]:
    """Return the DAE over time as a fraction of the duration, in scaled states, and what an event does to them.

    Over the scaled time integrals are averages. That of a squared deviation takes the deviation from the running mean:
    its growth, d/dt of the sum about the mean, is exactly that square, so the RMS is never a difference of squares.
    """
    motion, observed = equation_of_motion(structure), signals(structure)
    fraction = ca.SX.sym("fraction")
    count = motion.states
    x = ca.SX.sym("x", count + observed.squared)
    p = ca.SX.sym("p", len(observed.parameters) + 1)
    scales = ca.SX.sym("scales", 3)
    unit = _units(structure, scales)
    known = observed.named(p)
    duration = p[-1]
    time, state = fraction * duration, x[:count] * unit
    own = ca.vertcat(*(known[name] for name in motion.names))
    rate = motion.function(time, state, own)
    sizes = _signal_scales(structure, known, (scales[0], scales[1], scales[2]))
    values = observed.function(time, state[:2], p[:-1]) / sizes
    squared = values[: observed.squared]
    # At the start the running mean is 0/0; the spread is 0 there.
    started = fraction > 0.0
    running_mean = x[count:] / ca.if_else(started, fraction, 1.0)
    spread = ca.if_else(started, squared - running_mean, 0.0) ** 2
    given = ca.vertcat(p, scales)
    equation = {
        "t": fraction,
        "x": x,
        "p": given,
        "ode": ca.vertcat(rate * duration / unit, squared),
        "quad": ca.vertcat(spread, values[observed.squared :, :]),
    }
    if motion.events is None:
        return equation, None
    index, none = ca.SX.sym("index"), [ca.SX(0, 1), ca.SX(0, 1)]
    zero, after = motion.events(time, state, own)
    chosen = after[:, 0]
    for k in range(1, after.shape[1]):
        chosen = ca.if_else(index < k - 0.5, chosen, after[:, k])
    following = ca.vertcat(chosen / unit, x[count:])
    names = ["index", "t", "x", "z", "p", "u"], ["post_x", "post_z"]
    transition = ca.Function("transition", [index, fraction, x, none[0], given, none[1]], [following, none[0]], *names)
    return equation | {"zero": zero}, transition


def _options(accuracy: Accuracy, timeline: Timeline) -> dict[str, Any]:
    """Return CasADi's options for a method and its setting."""
    if accuracy.method not in ADAPTIVE:
        return {"number_of_finite_elements": timeline.steps, **_QUIET}
    tolerance = accuracy.tolerance
    assert tolerance is not None  # `with_setting` or `automatic` has given it one
    options: dict[str, Any] = {**_QUIET, "reltol": tolerance, "abstol": 0.01 * tolerance}
    options["max_num_steps"] = timeline.steps
    if accuracy.method in ("cvodes", "idas"):
        # Without the quadratures in the error control, sensitivities of these two can be silently wrong.
        options["quad_err_con"] = True
    return options
