"""The equation of motion under each integration method, behind one interface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from plough_opt.accuracy import ADAPTIVE, ORDER_8, Accuracy
from plough_opt.motion.equation import (
    Structure,
    equation_of_motion,
    start_resistance,
    start_state,
)
from plough_opt.motion.runge_kutta import run_map
from plough_opt.motion.signals import signals
from plough_opt.motion.timeline import Timeline

# Lower than any force that matters; keeps the scales of a scene without forces above zero.
_LEAST_FORCE = 1e-9
_MOST_STEPS = 2_000_000
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
    if accuracy.method in ORDER_8:
        function = run_map(structure, timeline)
    else:
        function = _by_casadi(structure, accuracy, timeline)
    return Integration(structure, accuracy, timeline, function)


def _by_casadi(structure: Structure, accuracy: Accuracy, timeline: Timeline) -> ca.Function:
    """Wrap a CasADi integrator of the scaled equation in the interface of `Integration`."""
    observed = signals(structure)
    solver = ca.integrator(
        "motion",
        accuracy.method,
        _scaled_equation(structure),
        0.0,
        [float(t) for t in timeline.output_fractions[1:]],
        _options(accuracy, timeline),
    )
    p = ca.MX.sym("p", len(observed.parameters) + 1)
    known = dict(zip(observed.parameters, ca.vertsplit(p[:-1]), strict=True))
    scales = _scales(structure, known)
    unit = ca.vertcat(*scales[:2])
    first = start_state(structure, known)
    result = solver(x0=ca.vertcat(first / unit, ca.MX.zeros(observed.squared)), p=ca.vertcat(p, *scales))
    states = result["xf"][:2, :] * ca.repmat(unit, 1, timeline.outputs)
    sizes = _signal_scales(structure, known, scales)
    spreads, others = ca.vertsplit(result["qf"][:, -1], [0, observed.squared, observed.count])
    integrals = ca.vertcat(result["xf"][2:, -1], others)
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
    complete = {**dict.fromkeys(("static", "drag", "rate_term", "tow_speed"), 0.0), **p}
    stiffness = ca.fabs(p["stiffness"])  # below zero where a spring repels
    hardness = ca.sqrt(stiffness * p["inertia"])
    force = start_resistance(structure, complete) + complete["tow_speed"] * hardness + _LEAST_FORCE
    return force / stiffness, force / hardness, force


def _signal_scales(structure: Structure, p: dict[str, Any], scales: tuple[Any, Any, Any]) -> Any:
    """Return the scale of each signal, in the order of `signals`, from those of deflection, rate and force."""
    deflection, rate, force = scales
    sizes = [deflection]
    if structure.damper:
        sizes.append(force + p["damping"] * rate)
    if structure.ramp:
        sizes.append(force * (p["tow_speed"] + rate))
    return ca.vertcat(*sizes)


def _scaled_equation(structure: Structure) -> dict[str, ca.SX]:
    """Return the DAE over time as a fraction of the duration, in scaled states, with the signals' integrals.

    The integral of a squared deviation takes the deviation from the running mean: its growth,
    d/dt of the sum about the mean, is exactly that square, so the RMS is never a difference of squares.
    """
    motion, observed = equation_of_motion(structure), signals(structure)
    fraction = ca.SX.sym("fraction")
    x = ca.SX.sym("x", 2 + observed.squared)
    p = ca.SX.sym("p", len(observed.parameters) + 1)
    scales = ca.SX.sym("scales", 3)
    unit = scales[:2]
    known = dict(zip(observed.parameters, ca.vertsplit(p[:-1]), strict=True))
    duration = p[-1]
    time, state = fraction * duration, x[:2] * unit
    rate = motion.function(time, state, ca.vertcat(*(known[name] for name in motion.names)))
    sizes = _signal_scales(structure, known, (scales[0], scales[1], scales[2]))
    values = observed.function(time, state, p[:-1]) / sizes
    squared = values[: observed.squared]
    # At the start the running mean is 0/0; the spread is 0 there.
    started = fraction > 0.0
    running_mean = x[2:] / ca.if_else(started, fraction, 1.0)
    spread = ca.if_else(started, squared - running_mean, 0.0) ** 2
    return {
        "t": fraction,
        "x": x,
        "p": ca.vertcat(p, scales),
        "ode": ca.vertcat(rate * duration / unit, squared),
        "quad": ca.vertcat(spread, values[observed.squared :, :]),
    }


def _options(accuracy: Accuracy, timeline: Timeline) -> dict[str, Any]:
    """Return CasADi's options for a method and its setting."""
    if accuracy.method not in ADAPTIVE:
        return {"number_of_finite_elements": timeline.steps, **_QUIET}
    tolerance = accuracy.tolerance
    assert tolerance is not None  # `with_setting` or `automatic` has given it one
    options: dict[str, Any] = {**_QUIET, "reltol": tolerance, "abstol": 0.01 * tolerance, "max_num_steps": _MOST_STEPS}
    if accuracy.method in ("cvodes", "idas"):
        # Without the quadratures in the error control, sensitivities of these two can be silently wrong.
        options["quad_err_con"] = True
    return options
