"""One step of a design as a CasADi Function: the Taylor series of the motion, how far it holds, and its averages."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from plough_opt.batch.rules import series_of
from plough_opt.batch.series import Graph
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure

# Samples of a switch in a step; halvings, and steps of Newton's method, in the interval in which it changes its sign;
# and how far beyond, as a part of the step, the next step begins.
_SAMPLES = 8
_HALVINGS = 4
_NEWTON = 3
_BEYOND = 1e-7
# Degree of the strut's speed in time during a ramp.
_RAMP_DEGREE = 5
# Keeps logarithms and quotients finite where nothing moves, or no time has passed.
_TINY = 1e-290
_ROUNDING = 2.0**-52
# Phase [rad] of the mount's oscillation in a usual step.
_PHASE = 3.0
# Coefficients by which the end of a series is judged, and their weight. With three one step in a million was far too
# long, all of them being small by accident; with four the estimates of 600,000 designs were all above their errors.
_LAST, _WEIGHT = 4, 0.1


@dataclass(frozen=True)
class Layout:
    """Where things stand in the columns that a step takes.

    Attributes:
        structure: the terms that are on.
        parameters: names of the equation's parameters; after them follow the end of the ramp [s], the duration [s], the
            longest first step [s] and the error of the deflection [m] that a step may make.
        means: number of signals that are averaged: see `plough_opt.motion.signals`.
        squares: how many of them have an RMS.
    """

    structure: Structure
    parameters: tuple[str, ...]
    means: int
    squares: int

    @classmethod
    def of(cls, structure: Structure) -> Layout:
        """Return the layout of a structure."""
        observed = signals(structure)
        return cls(structure, observed.parameters, observed.count, observed.squared)

    @property
    def ends(self) -> tuple[int, ...]:
        """Positions in the parameters of the time at which each part of the motion ends."""
        after = len(self.parameters)
        return (after, after + 1) if self.structure.ramp else (after + 1,)

    @property
    def first(self) -> int:
        """Position in the parameters of the longest first step."""
        return len(self.parameters) + 2

    @property
    def allowed(self) -> int:
        """Position in the parameters of the error that a step may make, the last of them."""
        return len(self.parameters) + 3

    @property
    def state(self) -> int:
        """Size of the state: time, w, w', means, variances, error so far [m]."""
        return 4 + self.means + self.squares


def advance(layout: Layout, order: int, part: int) -> ca.Function:
    """Return (state, parameters) -> state after one step; of a design at its end the state as it is.

    Args:
        layout: what the columns hold.
        order: of the Taylor polynomial of w'.
        part: 0 until a ramp's end, and after it, or without one, the last of `Layout.ends`.
    """
    x, p = ca.SX.sym("x", layout.state), ca.SX.sym("p", layout.allowed + 1)
    end, late = p[layout.ends[part]], part == len(layout.ends) - 1
    w, rate, switches = _solution(layout, order, x, p, late)
    observed = _signals(layout, w, rate, x, p, late)
    # What is cut off is judged by the last terms of the deflection and of the force, as a deflection.
    judged = [(_last_terms(layout, w, order + 1, p), order + 1)]
    if layout.squares > 1:
        stiffness = ca.fabs(p[layout.parameters.index("stiffness")])
        judged.append((_last_terms(layout, observed[1], order, p) / stiffness, order))
    remaining = end - x[0]
    reach = _reach(judged, p[layout.allowed])
    if layout.structure.relaxed or layout.structure.ramp:
        # A share that begins to move may feel by a high power of the time what its series at the start does not show.
        reach = ca.fmin(reach, x[0] + p[layout.first])
    count = ca.fmax(ca.ceil(remaining / reach), 1.0)
    size, last = remaining / count, count <= 1.0
    for switch in switches:
        cut = _first_change(switch, size)
        last = ca.logic_and(last, cut >= size)
        size = ca.fmin(cut, size)
    time = ca.if_else(last, end, x[0] + size)
    powers = _powers(size, len(observed[0]) - 1)
    made = sum(last * powers[highest] for last, highest in judged)
    terms = [[c * power for c, power in zip(series, powers, strict=False)] for series in observed]
    averages = _averages(layout, terms, x, size / ca.fmax(time, _TINY))
    state = [sum(c * power for c, power in zip(series, powers, strict=False)) for series in (w, rate)]
    growth = _exponential(size * growth_rate(layout)(x[0], x[1:3], p))
    # A design at its end stays as it is, and makes no error any more.
    rounding = ca.if_else(remaining > 0.0, _ROUNDING * ca.fabs(state[0]), 0.0)
    error = growth * x[-1] + made + rounding
    return ca.Function("advance", [x, p], [ca.cse(ca.vertcat(time, *state, *averages, error))])


def _solution(
    layout: Layout, order: int, x: ca.SX, p: ca.SX, late: bool
) -> tuple[list[ca.SX], list[ca.SX], list[list[ca.SX]]]:
    """Return the coefficients of w, of w' and of what changes its sign where the formula changes."""
    motion, graph = equation_of_motion(layout.structure), Graph()
    time, rate = graph.clock(x[0]), graph.given(x[2])
    w = graph.given(x[1], rate=rate)
    own = [graph.constant(p[layout.parameters.index(name)]) for name in motion.names]
    slopes = series_of(graph, motion.function, [[time], [w, rate], own], late)
    for k in range(order):
        graph.extend(k)
        w.coefficients.append(slopes[0][k] / (k + 1))
        rate.coefficients.append(slopes[1][k] / (k + 1))
    w.coefficients.append(rate[order] / (order + 1))
    return w.coefficients, rate.coefficients, [switch.coefficients for switch in graph.switches]


def _signals(layout: Layout, w: list[ca.SX], rate: list[ca.SX], x: ca.SX, p: ca.SX, late: bool) -> list[list[ca.SX]]:
    """Return the coefficients of the signals, of a product of the motion and a ramp all of them."""
    graph = Graph()
    known = [graph.constant(p[k]) for k in range(len(layout.parameters))]
    extended = len(w) + (_RAMP_DEGREE if layout.structure.ramp and not late else 0)
    moving = [graph.given(*c, *[ca.SX(0)] * (extended - len(c))) for c in (w, rate)]
    found = series_of(graph, signals(layout.structure).function, [[graph.clock(x[0])], moving, known], late)
    for k in range(extended):
        graph.extend(k)
    return [one.coefficients for one in found]


@lru_cache(maxsize=16)
def growth_rate(layout: Layout) -> ca.Function:
    """Return (time, (w, w'), parameters) -> a bound of the rate [1/s] at which a small deviation grows.

    In the norm s^2 w^2 + w'^2 it is the largest eigenvalue of the symmetric part of the equation's slopes; s is the
    mount's own angular frequency, at which a deviation merely oscillates.
    """
    motion = equation_of_motion(layout.structure)
    time, state, p = ca.SX.sym("time"), ca.SX.sym("state", 2), ca.SX.sym("p", layout.allowed + 1)
    own = ca.vertcat(*(p[layout.parameters.index(name)] for name in motion.names))
    slopes = ca.jacobian(motion.function(time, state, own)[1], state)
    scale = own_frequency(layout, p)
    tilt = (slopes[0] + scale**2) / (2.0 * scale)
    rate = 0.5 * slopes[1] + ca.sqrt(0.25 * slopes[1] ** 2 + tilt**2)
    return ca.Function("growth_rate", [time, state, p], [rate])


def own_frequency(layout: Layout, p: ca.SX) -> ca.SX:
    """Return sqrt(|k|/M) [rad/s]."""
    stiffness, inertia = (p[layout.parameters.index(name)] for name in ("stiffness", "inertia"))
    return ca.sqrt(ca.fabs(stiffness) / inertia)


def _exponential(x: ca.SX) -> ca.SX:
    """Return exp(x) for x of at least 0, as (1 + y + y^2/2)^16 with y = x/16: a bound needs no more."""
    y = x / 16.0
    y = 1.0 + y * (1.0 + 0.5 * y)
    for _ in range(4):
        y = y**2
    return y


def _last_terms(layout: Layout, series: list[ca.SX], highest: int, p: ca.SX) -> ca.SX:
    """Return the size of a polynomial's last coefficient, together with the ones before it.

    Those count as an oscillation's at the frequencies of mount and wave: the last may just pass through zero.
    """
    rate = own_frequency(layout, p)
    if layout.structure.wave:
        speed, wavelength = (p[layout.parameters.index(name)] for name in ("tow_speed", "wavelength"))
        rate = rate + 2.0 * math.pi * speed / wavelength
    rate = rate / _PHASE
    total = ca.SX(0)
    for k in range(_LAST):
        total = total + ca.fabs(series[highest - k]) * rate**k
    return _WEIGHT * total


def _reach(judged: list[tuple[ca.SX, int]], allowed: ca.SX) -> ca.SX:
    """Return the step at which the last terms of the polynomials are as large as allowed."""
    exponents = [(ca.log(allowed) - ca.log(last + _TINY)) / highest for last, highest in judged]
    return ca.exp(exponents[0] if len(exponents) == 1 else ca.fmin(*exponents))


def _first_change(series: list[ca.SX], size: ca.SX) -> ca.SX:
    """Return a time just after a polynomial has become positive, or no longer is, or infinity.

    Between two samples on one side of zero the polynomial is looked at where it turns, by its slopes at the samples.
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
    """Return means and variances up to the end of a step, which is a given part of the time until then.

    Pooling the variance within the step with the square of the distance of the means adds squares only.
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
    """Return the coefficients of a polynomial on [0, 1] in Legendre's polynomials, whose squares add up.

    The coefficient of degree l of u^k is (2l + 1) k!^2 / ((k - l)! (k + l + 1)!).
    """
    factorial = math.factorial
    found = []
    for degree in range(highest + 1):
        total = ca.SX(0)
        for k, c in enumerate(terms[degree:], start=degree):
            weight = (2 * degree + 1) * factorial(k) ** 2 / (factorial(k - degree) * factorial(k + degree + 1))
            total = total + weight * c
        found.append(total)
    return found


def _powers(x: ca.SX, highest: int) -> list[ca.SX]:
    """Return 1, x, x^2 ..., each from its halves, so that none waits for all others."""
    powers = [ca.SX(1), x]
    for k in range(2, highest + 1):
        powers.append(powers[k // 2] * powers[k - k // 2])
    return powers
