"""One step of a batch: the Taylor series of the motion, the step size, the averages so far and the error so far.

A step expands w and w' about its start, takes the largest size whose truncated terms stay below the allowed error, ends
early where the right-hand side changes its formula, and evaluates the series there. The same series give the means and
variances of the signals. The error of the step is added to those before it by `plough_opt.motion.batch.error_ellipse`.
"""

import itertools
import math
from functools import reduce

import casadi as ca

from plough_opt.motion.batch.error_ellipse import TINY, deviation_map, ellipse_after, largest_squared_error
from plough_opt.motion.batch.layout import Layout, StepStart
from plough_opt.motion.batch.series import Switch
from plough_opt.motion.equation import equation_of_motion, signals

# Degree in time of the strut's speed during a ramp, by which the product with it has more orders than the motion.
_RAMP_DEGREE = 5
_ROUNDING = 2.0**-52

# The truncated terms are estimated from this number of last coefficients, because a single one may pass through zero.
_LAST_COEFFICIENTS = 4
# How much faster than an oscillation's they are taken to fall from each to the next.
_FALL = 8.0
# Weight of their sum. In 200,000 runs under a wave no error was more than half of its estimate.
_WEIGHT = 0.35
# Factor on that weight if the soil has rates of its own, which the frequencies of mount and wave do not include.
_UNKNOWN_RATES = 3.0
# All last coefficients may be small by accident, so the phase of a step [rad] is limited too.
_LONGEST_PHASE = 4.0

# Equal intervals of a step between which the polynomial is sampled.
_INTERVALS = 8
# Halvings of the interval that contains the sign change, and steps of Newton's method after them.
_HALVINGS = 4
_NEWTON_STEPS = 3


def advance(layout: Layout, order: int, phase: int) -> ca.Function:
    """Return (state, parameters) -> state after one step, for a design that has not reached the end of the phase.

    Args:
        layout: positions in the two columns.
        order: of the Taylor polynomial of w'.
        phase: index in `Layout.ends`; in the last phase the tow ramp, if any, is over.
    """
    x, p = ca.SX.sym("x", layout.states), ca.SX.sym("p", layout.parameters)
    start, end = StepStart(layout, x, p, phase == len(layout.ends) - 1), p[layout.ends[phase]]
    w, rate, switches = _solution(start, order)
    observed = _signals(start, w, rate)
    # From the terms of w', as the deflection into which the mount turns them.
    last_terms = _last_terms(start, rate, order) / layout.mount_frequency(p)
    longest = ca.exp((ca.log(p[layout.allowed_error]) - ca.log(last_terms + TINY)) / order)
    longest = ca.fmin(longest, _LONGEST_PHASE / layout.fastest_frequency(p))
    if layout.structure.relaxed or layout.structure.ramp:
        # The force on a share that begins to move may grow by a high power of time that its first series does not show.
        longest = ca.fmin(longest, x[0] + p[layout.longest_first_step])
    size, time, kept = _size(x[0], end, longest, switches)
    powers = _powers(size, len(observed[0]) - 1)
    terms = [[c * power for c, power in zip(series, powers, strict=False)] for series in observed]
    part_of_time = size / ca.fmax(time, TINY)
    averages = _averages(layout, terms, x, part_of_time)
    state = [sum(c * power for c, power in zip(series, powers, strict=False)) for series in (w, rate)]
    made = last_terms * powers[order] + _ROUNDING * ca.fabs(state[0])
    *ellipse_before, mean_before = ca.vertsplit(x[-4:])
    ellipse = ellipse_after(ellipse_before, deviation_map(start, (w, rate), powers), made)
    squared_error = 0.5 * (largest_squared_error(start, ellipse_before) + largest_squared_error(start, ellipse))
    mean_squared_error = mean_before + part_of_time * (squared_error - mean_before)
    result = ca.vertcat(time, *state, *averages, *kept, *ellipse, mean_squared_error)
    return ca.Function("advance", [x, p], [ca.cse(result)])


def _solution(start: StepStart, order: int) -> tuple[list[ca.SX], list[ca.SX], list[Switch]]:
    """Return the coefficients of w and of w', and the switches of the right-hand side."""
    motion = equation_of_motion(start.layout.structure)
    graph = start.graph(ca.vertsplit(start.state[-4 - start.layout.switches : -4]))
    w, rate = graph.given(start.state[1]), graph.given(start.state[2])
    w_rate, acceleration = start.series(graph, motion.function, [w, rate], motion.names)
    for k in range(order):
        graph.extend(k)
        w.coefficients.append(w_rate[k] / (k + 1))
        rate.coefficients.append(acceleration[k] / (k + 1))
    w.coefficients.append(rate[order] / (order + 1))
    return w.coefficients, rate.coefficients, graph.switches


def _signals(start: StepStart, w: list[ca.SX], rate: list[ca.SX]) -> list[list[ca.SX]]:
    """Return the coefficients of the signals; during a ramp of all orders of the product with the strut's speed."""
    graph, structure = start.graph(), start.layout.structure
    orders = len(w) + (_RAMP_DEGREE if structure.ramp and not start.ramp_ended else 0)
    motion = [graph.given(*c, *[ca.SX(0)] * (orders - len(c))) for c in (w, rate)]
    observed = start.series(graph, signals(structure).function, motion, start.layout.names)
    for k in range(orders):
        graph.extend(k)
    return [series.coefficients for series in observed]


def _last_terms(start: StepStart, series: list[ca.SX], highest: int) -> ca.SX:
    """Return the size of a polynomial's highest coefficient, judged by the ones before it too.

    Each of these is carried to the highest order as that of an oscillation at the frequencies of mount and wave.
    """
    rate = start.layout.fastest_frequency(start.p) / _FALL
    total = ca.SX(0)
    for k in range(_LAST_COEFFICIENTS):
        total = total + ca.fabs(series[highest - k]) * rate**k
    unknown = start.layout.structure.own or start.layout.structure.smooth
    return _WEIGHT * (_UNKNOWN_RATES if unknown else 1.0) * total


def _size(now: ca.SX, end: ca.SX, longest: ca.SX, switches: list[Switch]) -> tuple[ca.SX, ca.SX, list[ca.SX]]:
    """Return the size of a step, the time at its end, and there `Switch.kept` of each switch.

    The time that remains is divided into equal steps. The step ends early at the first sign change of a switch.
    """
    count = ca.fmax(ca.ceil((end - now) / longest), 1.0)
    whole, is_last = (end - now) / count, count <= 1.0
    changes = [_first_change(switch, whole) for switch in switches]
    size = reduce(ca.fmin, [change for change, _ in changes], whole)
    kept = []
    for switch, (change, side) in zip(switches, changes, strict=True):
        is_last = ca.logic_and(is_last, change >= whole)
        at_end = switch.side_of(_value_and_slope(switch.series.coefficients, size)[0])
        kept.append(ca.if_else(change <= size, side, ca.if_else(at_end == switch.side, 0.0, switch.side)))
    return size, ca.if_else(is_last, end, now + size), kept


def _first_change(switch: Switch, size: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the time [s] at which a switch first changes its side within a step, and the new side.

    The time is infinite if it does not. A switch that is zero at the start may change at once. Otherwise it is sampled
    at equal distances and, between each two of these, where its slopes there let it turn. The interval of the first
    change is halved, then Newton's method finds the root.

    Args:
        switch: with Taylor coefficients by the time since the start of the step.
        size: of the step [s].
    """
    polynomial, side = switch.series.coefficients, switch.side

    def has_changed(value: ca.SX) -> ca.SX:
        return switch.side_of(value) != side

    low, high, found = ca.SX(0), ca.SX(1), ca.SX(0)
    samples = [(ca.SX(0), polynomial[0]), *_samples(polynomial, size)]
    # From the last interval to the first, so that the earliest change remains.
    for (start, _), (end, value) in reversed(list(itertools.pairwise(samples))):
        here = has_changed(value)
        low, high = ca.if_else(here, start, low), ca.if_else(here, end, high)
        found = ca.logic_or(found, here)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        past = has_changed(_value_and_slope(polynomial, size * middle)[0])
        low, high = ca.if_else(past, low, middle), ca.if_else(past, middle, high)
    root = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        value, slope = _value_and_slope(polynomial, size * root)
        root = ca.fmin(ca.fmax(root - value / (size * _nonzero(slope)), low), high)
    # The sign just after the start is that of the first coefficient other than zero.
    first = reduce(lambda later, c: ca.if_else(c == 0.0, later, c), reversed(polynomial))
    at_once = ca.logic_and(polynomial[0] == 0.0, has_changed(first))
    after = switch.side_of(_value_and_slope(polynomial, size * high)[0])
    change = ca.if_else(found, root * size, math.inf)
    return ca.if_else(at_once, 0.0, change), ca.if_else(at_once, switch.side_of(first), after)


def _samples(polynomial: list[ca.SX], size: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return (fraction of the step, value) at the ends of all intervals, and in each where it may turn."""
    ends = [_value_and_slope(polynomial, size * (k / _INTERVALS)) for k in range(_INTERVALS + 1)]
    samples = []
    for k, ((_, slope_before), (value, slope_after)) in enumerate(itertools.pairwise(ends)):
        # Where a slope that changes linearly from one end to the other is zero. The start is no sample: at a sign
        # change the value there is only rounding.
        part = slope_before / _nonzero(slope_before - slope_after)
        turn = (k + ca.if_else(ca.logic_and(part > 0.0, part < 1.0), part, 1.0)) / _INTERVALS
        samples += [(turn, _value_and_slope(polynomial, size * turn)[0]), (ca.SX((k + 1) / _INTERVALS), value)]
    return samples


def _nonzero(x: ca.SX) -> ca.SX:
    return ca.if_else(x == 0.0, 1.0, x)


def _value_and_slope(polynomial: list[ca.SX], x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a polynomial and its derivative at x, by Horner's scheme."""
    value, slope = ca.SX(polynomial[-1]), ca.SX(0)
    for c in reversed(polynomial[:-1]):
        slope = value + x * slope
        value = c + x * value
    return value, slope


def _averages(layout: Layout, terms: list[list[ca.SX]], x: ca.SX, part: ca.SX) -> list[ca.SX]:
    """Return the means and variances up to the end of a step.

    A variance pools those before and within the step with the squared distance of their means. That is a sum of
    squares, which cannot cancel.

    Args:
        layout: positions in the state.
        terms: coefficients of each signal times the powers of the step size.
        x: state before the step.
        part: size of the step over the time until its end [-].
    """
    means, variances = [], []
    for k, series in enumerate(terms):
        legendre = _legendre(series, 2 * len(series) // 5 if k < layout.squared else 0)
        before = x[3 + k]
        distance = legendre[0] - before
        means.append(before + part * distance)
        if k < layout.squared:
            spread = sum(c**2 / (2 * degree + 1) for degree, c in enumerate(legendre[1:], start=1))
            old = x[3 + layout.averaged + k]
            variances.append((1.0 - part) * (old + part * distance**2) + part * spread)
    return [*means, *variances]


def _legendre(terms: list[ca.SX], highest: int) -> list[ca.SX]:
    """Return the coefficients of a polynomial on [0, 1] in Legendre polynomials, which are orthogonal.

    The coefficient of degree l of u^k is (2l + 1) k!^2 / ((k - l)! (k + l + 1)!).
    """
    factorial = math.factorial
    coefficients = []
    for degree in range(highest + 1):
        total = ca.SX(0)
        for k, c in enumerate(terms[degree:], start=degree):
            weight = (2 * degree + 1) * factorial(k) ** 2 / (factorial(k - degree) * factorial(k + degree + 1))
            total = total + weight * c
        coefficients.append(total)
    return coefficients


def _powers(x: ca.SX, highest: int) -> list[ca.SX]:
    """Return 1, x, x^2 ..., each as a product of two halves, so that a processor can compute several at once."""
    powers = [ca.SX(1), x]
    for k in range(2, highest + 1):
        powers.append(powers[k // 2] * powers[k - k // 2])
    return powers
