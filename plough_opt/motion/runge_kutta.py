"""Fixed-step integration by a Butcher tableau as one CasADi Function; by default Dormand and Prince's DOP853.

A step is a small symbolic graph, the run a loop over it (``mapaccum``), so the
size of the graph does not grow with the number of steps and every derivative is that of the numbers.
"""

from functools import lru_cache

import casadi as ca

from plough_opt.motion.breaks import moving_ramp, spans_of, start_and_size, telling, unbroken
from plough_opt.motion.equation import equation_of_motion, start_state
from plough_opt.motion.methods import DOP853, Tableau
from plough_opt.motion.pooling import pooled
from plough_opt.motion.readings import at_outputs
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline


@lru_cache(maxsize=64)
def step(structure: Structure, width: int = 2, tableau: Tableau = DOP853) -> ca.Function:
    """Return one step as a Function: (state, span, parameters with the duration last) -> (state, moments).

    The span is start and size of the step as fractions of the duration and, of width 5, of the ramp's time, which add
    up, and whether the ramp is over. The moments are, for each signal, the mean over the step, then, for each signal
    with an RMS, the mean square about that mean. Both are taken from the deviation from the value at the step's start,
    where they lose at most a factor of four to cancellation.
    """
    structure = telling(structure, width)
    motion, observed = equation_of_motion(structure), signals(structure)
    state = ca.SX.sym("state", 2)
    span = ca.SX.sym("span", width)
    p = ca.SX.sym("p", len(observed.parameters) + 1 - structure.tells_ramp)
    given = ca.vertcat(p[:-1], span[4:])
    known = observed.named(ca.vertcat(given, p[-1]))
    start, size = start_and_size(span, p[-1], known)

    rates: list[ca.SX] = []
    first = observed.function(start, state, given)
    mean, square = ca.SX.zeros(observed.count), ca.SX.zeros(observed.squared)
    for row, node, weight in zip(tableau.stages, tableau.nodes, tableau.weights, strict=True):
        stage = state
        for coefficient, rate in zip(row, rates, strict=True):
            if coefficient != 0.0:
                stage = stage + (size * coefficient) * rate
        time = start + node * size
        rates.append(motion.rates(time, stage, known))
        if weight != 0.0:
            change = observed.function(time, stage, given) - first
            mean += weight * change
            square += weight * change[: observed.squared] ** 2
    following = state
    for weight, rate in zip(tableau.weights, rates, strict=True):
        if weight != 0.0:
            following = following + (size * weight) * rate
    spread = square - mean[: observed.squared] ** 2
    return ca.Function("step", [state, span, p], ca.cse([following, ca.vertcat(first + mean, spread)]))


def run_map(structure: Structure, timeline: Timeline, tableau: Tableau = DOP853) -> ca.Function:
    """Return the whole run as a Function of the parameters: see `plough_opt.motion.integrators.Integration`."""
    p, known = signals(structure).symbols(ca.MX)
    results = run_from(structure, timeline, tableau)(start_state(structure, known), p)
    return ca.Function("run_map", [p], list(results), {"never_inline": True})


@lru_cache(maxsize=64)
def run_from(structure: Structure, timeline: Timeline, tableau: Tableau = DOP853) -> ca.Function:
    """Return the run from any state: (state at time 0, parameters) -> states at the outputs, means, variances."""
    observed = signals(structure)
    first = ca.MX.sym("first", 2)
    p, _ = observed.symbols(ca.MX)
    ramp = moving_ramp(structure, timeline, p)
    spans = spans_of(timeline, p[-1], ramp)
    sizes = spans[1, :] if ramp is None else spans[1, :] + spans[3, :] * (ramp / p[-1])
    count = sizes.shape[1]
    one = unbroken(structure, timeline, step(structure, spans.shape[0], tableau))
    states, moments = one.mapaccum(count)(first, spans, ca.repmat(p, 1, count))
    averages = pooled([moments], lambda parts: [part @ sizes.T for part in parts], observed.count)
    found = at_outputs(timeline, ca.horzcat(first, states), p[-1], ramp)
    return ca.Function("run_from", [first, p], [found, *averages])
