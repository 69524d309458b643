"""One step of a design as a CasADi Function: the Taylor series of the motion, how far it holds, and its averages."""

import itertools
import math

import casadi as ca

from plough_opt.motion.batch.deviation import grown, square_of_error, transfer
from plough_opt.motion.batch.layout import Layout
from plough_opt.motion.batch.rules import series_of
from plough_opt.motion.batch.series import Graph
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.signals import signals

# Samples of a switch in a step; halvings, and steps of Newton's method, in the interval in which it changes its sign;
# and how far beyond that, as a part of the step, the next step begins.
_SAMPLES = 8
_HALVINGS = 4
_NEWTON = 3
_BEYOND = 1e-7
# Degree of the strut's speed in time during a ramp.
_RAMP_DEGREE = 5
# Keeps logarithms and quotients finite if nothing moves, or no time has passed.
_TINY = 1e-290
_ROUNDING = 2.0**-52
# The truncated terms of a series are estimated from its last coefficients: how many of these, by how much each is taken
# to be smaller than an oscillation's before it, and their weight. In 200,000 runs under a wave no error was half of
# its estimate. All of them may be small by accident, so a step is limited by its phase [rad] too.
_LAST, _FALL, _WEIGHT = 4, 8.0, 0.35
_LONGEST = 4.0
# Factor on the weight if the soil has rates of its own, which the frequencies of mount and wave do not include.
_UNKNOWN = 3.0


def advance(layout: Layout, order: int, part: int) -> ca.Function:
    """Return (state, parameters) -> state after one step, for a design that is not at its end.

    Args:
        layout: positions in the two columns.
        order: of the Taylor polynomial of w'.
        part: of the motion, as `Layout.ends` has them: 0 until a ramp's end, the last one after it or without a ramp.
    """
    x, p = ca.SX.sym("x", layout.state), ca.SX.sym("p", layout.allowed + 1)
    end, late = p[layout.ends[part]], part == len(layout.ends) - 1
    w, rate, switches = _solution(layout, order, x, p, late)
    observed = _signals(layout, w, rate, x, p, late)
    # The truncated terms, estimated from the last terms of w' as the deflection into which a mount turns them.
    last_terms = _last_terms(layout, rate, order, p) / layout.own_frequency(p)
    # The longest step whose truncated terms stay below the allowed error.
    longest = ca.exp((ca.log(p[layout.allowed]) - ca.log(last_terms + _TINY)) / order)
    longest = ca.fmin(longest, _LONGEST / layout.fastest_frequency(p))
    if layout.structure.relaxed or layout.structure.ramp:
        # The force on a share that begins to move may grow by a high power of time that its first series does not show.
        longest = ca.fmin(longest, x[0] + p[layout.longest_first_step])
    size, time = _size(x[0], end, longest, switches)
    powers = _powers(size, len(observed[0]) - 1)
    terms = [[c * power for c, power in zip(series, powers, strict=False)] for series in observed]
    part_of_time = size / ca.fmax(time, _TINY)
    averages = _averages(layout, terms, x, part_of_time)
    state = [sum(c * power for c, power in zip(series, powers, strict=False)) for series in (w, rate)]
    made = last_terms * powers[order] + _ROUNDING * ca.fabs(state[0])
    before = ca.vertsplit(x[-4:])
    ellipse = grown(before[:3], transfer(layout, (w, rate), x[0], p, late, powers), made)
    mean_square = 0.5 * (square_of_error(layout, before[:3], p) + square_of_error(layout, ellipse, p))
    error = before[3] + part_of_time * (mean_square - before[3])
    return ca.Function("advance", [x, p], [ca.cse(ca.vertcat(time, *state, *averages, *ellipse, error))])


def _size(now: ca.SX, end: ca.SX, longest: ca.SX, switches: list[list[ca.SX]]) -> tuple[ca.SX, ca.SX]:
    """Return the size of a step and the time at its end.

    The remaining time is divided into equal steps, of which the first is taken up to the first change of a switch.
    """
    count = ca.fmax(ca.ceil((end - now) / longest), 1.0)
    size, last = (end - now) / count, count <= 1.0
    for switch in switches:
        cut = _first_change(switch, size)
        last = ca.logic_and(last, cut >= size)
        size = ca.fmin(cut, size)
    return size, ca.if_else(last, end, now + size)


def _solution(
    layout: Layout, order: int, x: ca.SX, p: ca.SX, late: bool
) -> tuple[list[ca.SX], list[ca.SX], list[list[ca.SX]]]:
    """Return the coefficients of w, of w' and of the switches, whose signs decide on the right-hand side's formula."""
    motion, graph = equation_of_motion(layout.structure), Graph()
    time, w, rate = graph.clock(x[0]), graph.given(x[1]), graph.given(x[2])
    own = [graph.constant(layout.value(p, name)) for name in motion.names]
    slopes = series_of(graph, motion.function, [[time], [w, rate], own], late)
    for k in range(order):
        graph.extend(k)
        w.coefficients.append(slopes[0][k] / (k + 1))
        rate.coefficients.append(slopes[1][k] / (k + 1))
    w.coefficients.append(rate[order] / (order + 1))
    return w.coefficients, rate.coefficients, [switch.coefficients for switch in graph.switches]


def _signals(layout: Layout, w: list[ca.SX], rate: list[ca.SX], x: ca.SX, p: ca.SX, late: bool) -> list[list[ca.SX]]:
    """Return the coefficients of the signals; during a ramp of all orders that the product with its speed has."""
    graph = Graph()
    known = [graph.constant(p[k]) for k in range(len(layout.parameters))]
    extended = len(w) + (_RAMP_DEGREE if layout.structure.ramp and not late else 0)
    moving = [graph.given(*c, *[ca.SX(0)] * (extended - len(c))) for c in (w, rate)]
    found = series_of(graph, signals(layout.structure).function, [[graph.clock(x[0])], moving, known], late)
    for k in range(extended):
        graph.extend(k)
    return [one.coefficients for one in found]


def _last_terms(layout: Layout, series: list[ca.SX], highest: int, p: ca.SX) -> ca.SX:
    """Return the size of a polynomial's last coefficient, together with the ones before it.

    Those count as an oscillation's at the frequencies of mount and wave: the last may just pass through zero.
    """
    rate = layout.fastest_frequency(p) / _FALL
    total = ca.SX(0)
    for k in range(_LAST):
        total = total + ca.fabs(series[highest - k]) * rate**k
    unknown = layout.structure.own or layout.structure.smooth
    return _WEIGHT * (_UNKNOWN if unknown else 1.0) * total


def _first_change(series: list[ca.SX], size: ca.SX) -> ca.SX:
    """Return a time within a step just after a polynomial changes its sign, or infinity if it does not.

    It is sampled at equal distances and, between each two samples, where it turns according to its slopes there.
    """
    at_first = series[0] > 0.0

    def beyond(value: ca.SX) -> ca.SX:
        return ca.logic_not((value > 0.0) == at_first)

    samples = [_with_slope(series, size * (k / _SAMPLES)) for k in range(_SAMPLES + 1)]
    points = []
    for k, ((_, before), (value, after)) in enumerate(itertools.pairwise(samples)):
        change = before - after
        turn = ca.fmin(ca.fmax(before / ca.if_else(change == 0.0, 1.0, change), 0.0), 1.0)
        turn = (k + turn) / _SAMPLES
        points += [(turn, _with_slope(series, size * turn)[0]), (ca.SX((k + 1) / _SAMPLES), value)]
    low, high, found = ca.SX(0), ca.SX(1), ca.SX(0)
    for (start, _), (end, value) in reversed(list(itertools.pairwise([(ca.SX(0), series[0]), *points]))):
        here = beyond(value)
        low, high = ca.if_else(here, start, low), ca.if_else(here, end, high)
        found = ca.logic_or(found, here)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        past = beyond(_with_slope(series, size * middle)[0])
        low, high = ca.if_else(past, low, middle), ca.if_else(past, middle, high)
    root = 0.5 * (low + high)
    for _ in range(_NEWTON):
        value, slope = _with_slope(series, size * root)
        root = ca.fmin(ca.fmax(root - value / (size * ca.if_else(slope == 0.0, 1.0, slope)), low), high)
    after = ca.fmin(root + _BEYOND, high)
    high = ca.if_else(beyond(_with_slope(series, size * after)[0]), after, high)
    return ca.if_else(found, high * size, math.inf)


def _with_slope(series: list[ca.SX], x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a polynomial and its derivative at x."""
    value, slope = ca.SX(series[-1]), ca.SX(0)
    for c in reversed(series[:-1]):
        slope = value + x * slope
        value = c + x * value
    return value, slope


def _averages(layout: Layout, terms: list[list[ca.SX]], x: ca.SX, part: ca.SX) -> list[ca.SX]:
    """Return means and variances up to the end of a step.

    The variance within the step is pooled with the square of the distance of the means: a sum of squares, which cannot
    cancel.

    Args:
        layout: positions in the state.
        terms: coefficients of each signal, times the powers of the step.
        x: state before the step.
        part: length of the step over the time until its end [-].
    """
    means, variances = [], []
    for k, series in enumerate(terms):
        legendre = _legendre(series, 2 * len(series) // 5 if k < layout.squares else 0)
        before = x[3 + k]
        distance = legendre[0] - before
        means.append(before + part * distance)
        if k < layout.squares:
            spread = sum(c**2 / (2 * degree + 1) for degree, c in enumerate(legendre[1:], start=1))
            old = x[3 + layout.means + k]
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
