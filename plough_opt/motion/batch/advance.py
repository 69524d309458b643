"""One step of a design as a CasADi Function: the Taylor series of the motion, its length, its averages and its error.

The errors of all steps so far are kept as an ellipse in the plane of w and w' that contains their sum.

Errors add up as sizes, not as squares, since those of an oscillation's steps may all point along its path. Each step
moves the ellipse by the linearised equation of motion, so that it grows where neighbouring motions part, turns where
they oscillate about each other, and shrinks where a damper or the soil lets them decay.

Blanes, Casas, Oteo, Ros: The Magnus expansion and some of its applications, Physics Reports 470 (2009), section 5.4,
of order 4; Kurzhanski, Valyi: Ellipsoidal Calculus for Estimation and Control, 1997, section 2.7, for the sum.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from plough_opt.motion.batch.equations import Layout, slopes
from plough_opt.motion.batch.series import Graph, Series, series_of
from plough_opt.motion.equation import equation_of_motion, signals

# Coefficients of the slopes in a step, by w and by w': more of them change the estimate by some per cent.
_SPRING_TERMS, _DAMPER_TERMS = 6, 4

Matrix = tuple[ca.SX, ca.SX, ca.SX, ca.SX]
"""Elements 11, 12, 21 and 22, for (w, w'/s) with the mount's own angular frequency s."""
# Samples of a switch in a step; halvings, and steps of Newton's method, in the interval in which it changes its sign;
# and how far beyond that, as a part of the step, the next step begins.
_SAMPLES = 8
_HALVINGS = 4
_NEWTON = 3
_BEYOND = 1e-7
# Degree of the strut's speed in time during a ramp.
_RAMP_DEGREE = 5
# Keeps logarithms and quotients finite if nothing moves, no time has passed, or there is no error yet.
_TINY = 1e-290
_ROUNDING = 2.0**-52
# The truncated terms of a series are estimated from its last coefficients: how many of these, by how much each is taken
# to be smaller than an oscillation's before it, and their weight. In 200,000 runs under a wave no error was half of
# its estimate. All of them may be small by accident, so a step is limited by its phase [rad] too.
_LAST, _FALL, _WEIGHT = 4, 8.0, 0.35
_LONGEST = 4.0
# Factor on the weight if the soil has rates of its own, which the frequencies of mount and wave do not include.
_UNKNOWN = 3.0


@dataclass(frozen=True)
class Before:
    """A design before a step.

    Attributes:
        layout: positions in the two columns.
        x: its state; the first element is the time [s].
        p: its parameters.
        late: whether a ramp has ended.
    """

    layout: Layout
    x: ca.SX
    p: ca.SX
    late: bool

    def series(self, graph: Graph, function: ca.Function, moving: list[Series], names: Sequence[str]) -> list[Series]:
        """Return the series of a Function of time, w and w', and parameters with these names."""
        known = [graph.constant(self.layout.value(self.p, name)) for name in names]
        return series_of(graph, function, [[graph.clock(self.x[0])], moving, known])


def transfer(at: Before, moving: tuple[list[ca.SX], list[ca.SX]], powers: list[ca.SX]) -> Matrix:
    """Return the matrix that turns a small deviation at the start of a step into the one at its end.

    It is the exponential of a Magnus expansion of order 4, whose determinant is exact: an undamped oscillation neither
    grows nor decays by it.

    Args:
        at: the design before the step.
        moving: coefficients of w and of w'.
        powers: of the step's length [s], from 0 on.
    """
    structure, graph = at.layout.structure, Graph(at.late)
    known = [graph.given(*series[:_SPRING_TERMS]) for series in moving]
    spring, damper = at.series(graph, slopes(structure), known, equation_of_motion(structure).names)
    for k in range(_SPRING_TERMS):
        graph.extend(k)
    size, scale = powers[1], at.layout.own_frequency(at.p)
    # Averages of the slopes over the step, and of the spring's times the distance from the middle of the step, with the
    # step as unit of time.
    length = size / scale
    a, b = length * _mean(spring, powers[:_SPRING_TERMS]), size * _mean(damper, powers[:_DAMPER_TERMS])
    lean = length * _tilt(spring, powers[:_SPRING_TERMS])
    turn, half = size * scale, 0.5 * b
    diagonal, upper, lower = -turn * lean - half, turn, a - b * lean
    even, odd = _hyperbolic(diagonal**2 + upper * lower)
    decay = _exponential(half)
    even, odd = decay * even, decay * odd
    return even + odd * diagonal, odd * upper, odd * lower, even - odd * diagonal


def _mean(series: Series, powers: list[ca.SX]) -> ca.SX:
    """Return a series' average over the step."""
    base, factor, summand = series.affine
    return factor * _weighted(base, powers, [1.0 / (k + 1.0) for k in range(len(powers))]) + summand


def _tilt(series: Series, powers: list[ca.SX]) -> ca.SX:
    """Return the average of a series times the distance from the step's middle, as a fraction of the step."""
    base, factor, _ = series.affine
    return factor * _weighted(base, powers, [0.5 * k / ((k + 1.0) * (k + 2.0)) for k in range(len(powers))])


def _weighted(series: Series, powers: list[ca.SX], weights: list[float]) -> ca.SX:
    total = ca.SX(0)
    for c, power, weight in zip(series.coefficients, powers, weights, strict=False):
        if weight != 0.0 and not c.is_zero():
            total = total + weight * (c * power)
    return total


def _hyperbolic(x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return cosh(sqrt(x)) and sinh(sqrt(x))/sqrt(x), which for x < 0 are cos(sqrt(-x)) and sin(sqrt(-x))/sqrt(-x).

    Taylor polynomials at x/64, and the doubling formula three times, for each of which sqrt(x) doubles.
    """
    x = x / 64.0
    even = 1.0 + x * (1.0 / 2.0 + x * (1.0 / 24.0 + x * (1.0 / 720.0)))
    odd = 1.0 + x * (1.0 / 6.0 + x * (1.0 / 120.0 + x * (1.0 / 5040.0)))
    for _ in range(3):
        even, odd = 2.0 * even**2 - 1.0, odd * even
    return even, odd


def _exponential(x: ca.SX) -> ca.SX:
    """Return exp(x) as (1 + y + y^2/2 + y^3/6)^16 with y = x/16: to some per cent above -6, and nearly 0 below."""
    y = ca.fmax(x, -16.0) / 16.0
    y = 1.0 + y * (1.0 + y * (1.0 / 2.0 + y * (1.0 / 6.0)))
    for _ in range(4):
        y = y**2
    return y


def grown(ellipse: list[ca.SX], moved: Matrix, made: ca.SX) -> list[ca.SX]:
    """Return the ellipse after a step that makes an error.

    Args:
        ellipse: P11, P12 and P22 [m^2]: it contains the deviations e with e P^-1 e <= 1.
        moved: `transfer` of the step.
        made: the step's own error [m], in any direction.
    """
    (a, b, c, d), (p, q, r) = moved, ellipse
    left = a * p + b * q, a * q + b * r
    right = c * p + d * q, c * q + d * r
    turned = [left[0] * a + left[1] * b, left[0] * c + left[1] * d, right[0] * c + right[1] * d]
    radius = ca.sqrt(ca.fmax(0.5 * (turned[0] + turned[2]), 0.0))
    # Of all ellipses that contain the sum of an ellipse and a circle, the one with the least sum of squared axes.
    stretch, added = 1.0 + made / (radius + _TINY), made * (made + radius)
    return [stretch * turned[0] + added, stretch * turned[1], stretch * turned[2] + added]


def square_of_error(at: Before, ellipse: list[ca.SX]) -> ca.SX:
    """Return the square of the largest error of the mount force over the stiffness in an ellipse [m^2]."""
    layout = at.layout
    if not layout.structure.damper:
        return ellipse[0]
    lever = layout.own_frequency(at.p) * layout.value(at.p, "damping") / layout.value(at.p, "stiffness")
    return ellipse[0] + lever * (2.0 * ellipse[1] + lever * ellipse[2])


def advance(layout: Layout, order: int, part: int) -> ca.Function:
    """Return (state, parameters) -> state after one step, for a design that is not at its end.

    Args:
        layout: positions in the two columns.
        order: of the Taylor polynomial of w'.
        part: of the motion, as `Layout.ends` has them: 0 until a ramp's end, the last one after it or without a ramp.
    """
    x, p = ca.SX.sym("x", layout.state), ca.SX.sym("p", layout.allowed + 1)
    at, end = Before(layout, x, p, part == len(layout.ends) - 1), p[layout.ends[part]]
    w, rate, switches = _solution(at, order)
    observed = _signals(at, w, rate)
    # The truncated terms, estimated from the last terms of w' as the deflection into which a mount turns them.
    last_terms = _last_terms(at, rate, order) / layout.own_frequency(p)
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
    ellipse = grown(before[:3], transfer(at, (w, rate), powers), made)
    mean_square = 0.5 * (square_of_error(at, before[:3]) + square_of_error(at, ellipse))
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


def _solution(at: Before, order: int) -> tuple[list[ca.SX], list[ca.SX], list[list[ca.SX]]]:
    """Return the coefficients of w, of w' and of the switches, whose signs decide on the right-hand side's formula."""
    motion, graph = equation_of_motion(at.layout.structure), Graph(at.late)
    w, rate = graph.given(at.x[1]), graph.given(at.x[2])
    slopes = at.series(graph, motion.function, [w, rate], motion.names)
    for k in range(order):
        graph.extend(k)
        w.coefficients.append(slopes[0][k] / (k + 1))
        rate.coefficients.append(slopes[1][k] / (k + 1))
    w.coefficients.append(rate[order] / (order + 1))
    return w.coefficients, rate.coefficients, [switch.coefficients for switch in graph.switches]


def _signals(at: Before, w: list[ca.SX], rate: list[ca.SX]) -> list[list[ca.SX]]:
    """Return the coefficients of the signals; during a ramp of all orders that the product with its speed has."""
    graph, structure = Graph(at.late), at.layout.structure
    extended = len(w) + (_RAMP_DEGREE if structure.ramp and not at.late else 0)
    moving = [graph.given(*c, *[ca.SX(0)] * (extended - len(c))) for c in (w, rate)]
    found = at.series(graph, signals(structure).function, moving, at.layout.parameters)
    for k in range(extended):
        graph.extend(k)
    return [one.coefficients for one in found]


def _last_terms(at: Before, series: list[ca.SX], highest: int) -> ca.SX:
    """Return the size of a polynomial's last coefficient, together with the ones before it.

    Those count as an oscillation's at the frequencies of mount and wave: the last may just pass through zero.
    """
    rate = at.layout.fastest_frequency(at.p) / _FALL
    total = ca.SX(0)
    for k in range(_LAST):
        total = total + ca.fabs(series[highest - k]) * rate**k
    unknown = at.layout.structure.own or at.layout.structure.smooth
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
