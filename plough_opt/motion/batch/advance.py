"""One step of a batch: the Taylor series of the motion, the step size, the averages so far and the error so far.

A step expands w and w' about its start, takes the largest size whose truncated terms stay below the allowed error, ends
early where the right-hand side changes its formula, and evaluates the series there. The same series give the means and
variances of the signals.

The errors of the steps add up in the plane of w and w'/s, with the angular frequency s of the mount, where an ellipse
bounds them. Each step first maps the ellipse by the linearised equation of motion, so that it grows where neighbouring
motions diverge, turns where they oscillate about each other and shrinks where a damper or the soil lets them decay. It
then enlarges the ellipse by the step's own error. Errors add as sizes and not as squares, because those of an
oscillation may all point along its path.

The linear map is the exponential of a Magnus expansion of order 4: Blanes, Casas, Oteo, Ros: The Magnus expansion and
some of its applications, Physics Reports 470 (2009), section 5.4. The sum of an ellipse and a circle follows
Kurzhanski, Valyi: Ellipsoidal Calculus for Estimation and Control, 1997, section 2.7.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.checks import labels_in, without_labels
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, absolute, minimum, stacked, where
from plough_opt.core.plain_data import Array
from plough_opt.motion.batch.series import Graph, Series, Switch, series_of
from plough_opt.motion.effects import StrengthWaves
from plough_opt.motion.equation import Equation, OfEquation, parameters
from plough_opt.motion.run import Averages
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.plan import rates


@dataclass(frozen=True)
class Layout(OfEquation):
    """Positions in the columns of state and parameters.

    The parameters are those of the equation of motion, followed by the end of the tow ramp [s], the duration [s], the
    longest first step [s], and the error of the deflection [m] that one step may make.

    The state is time [s], w [m], w' [m/s], the averages so far (means, then variances), `Switch.kept` of each switch of
    the equation, and four numbers for the error so far: the three of the error ellipse, and the time average of the
    squared error of the mount force over the stiffness (see `plough_opt.motion.batch.advance`).

    Attributes:
        equation: the equation of motion.
        switches: number of switches that select the formula of its right-hand side.
    """

    equation: Equation
    switches: int

    @classmethod
    def of(cls, equation: Equation) -> Layout:
        """Return the layout of an equation of motion."""
        graph, unknown = Graph(), ca.SX.sym("unknown")
        state, known = [graph.given(unknown) for _ in range(2)], [graph.constant(unknown) for _ in equation.names]
        series_of(graph, equation.rate, [[graph.clock(unknown)], state, known])
        return cls(equation, len(graph.switches))

    @property
    def known(self) -> tuple[str, ...]:
        """Names of all parameters of the terms; events, which a batch does not have, would change the mass."""
        return tuple(name for name in self.structure.names if name != "mass")

    @property
    def ends(self) -> tuple[int, ...]:
        """Positions of the end times of the motion's phases: a tow ramp, if there is one, and the rest."""
        after = len(self.names)
        return (after, after + 1) if self.structure.ramp else (after + 1,)

    @property
    def longest_first_step(self) -> int:
        """Position of the longest first step."""
        return len(self.names) + 2

    @property
    def allowed_error(self) -> int:
        """Position of the error that one step may make."""
        return len(self.names) + 3

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return len(self.names) + 4

    @property
    def states(self) -> int:
        """Size of the state."""
        return 7 + self.equation.averages + self.switches

    def value(self, p: ca.SX, name: str) -> ca.SX:
        """Return a parameter of the equation by its name."""
        return p[self.names.index(name)]

    def mount_frequency(self, p: ca.SX) -> ca.SX:
        """Return sqrt(|k|/M), the angular frequency of the share on its mount [rad/s]."""
        return ca.sqrt(ca.fabs(self.value(p, "stiffness")) / self.value(p, "inertia"))

    def fastest_frequency(self, p: ca.SX) -> ca.SX:
        """Return the sum of the angular frequencies of the mount and of the fastest strength wave [rad/s]."""
        known = dict(zip(self.names, ca.vertsplit(p), strict=False))
        passing: ca.SX = reduce(ca.fmax, StrengthWaves.imposed(known), ca.SX(0)) / 2.0
        return self.mount_frequency(p) + passing


@dataclass(frozen=True)
class StepStart:
    """A design at the start of a step, as symbols.

    Attributes:
        layout: positions in the two columns.
        state: its state.
        p: its parameters.
        ramp_ended: whether the tow ramp is over.
    """

    layout: Layout
    state: ca.SX
    p: ca.SX
    ramp_ended: bool

    def series(self, graph: Graph, function: ca.Function, motion: list[Series]) -> list[Series]:
        """Enter a Function of (time, (w, w'), parameters) in a graph and return the series of its results.

        Args:
            graph: the graph.
            function: the Function, of SX.
            motion: the series of w and w'.
        """
        known = [graph.constant(self.layout.value(self.p, name)) for name in self.layout.names]
        return series_of(graph, function, [[graph.clock(self.state[0])], motion, known])


RESULTS = tuple(Averages.__dataclass_fields__)
"""Names of the results of each design, before its error."""

# Keeps the allowed error of a step above zero if nothing moves the share.
_TINY = 1e-300

# The number of steps of a run is estimated as the first of these plus the phase [rad] over the second.
_FEWEST_TAYLOR_STEPS = 4.0
_PHASE_PER_TAYLOR_STEP = 2.5
# Part of the wanted error that all steps together may make.
_PART_OF_STEPS = 0.8
# That part is divided by 1 + _CAUTION * (slope of the soil's resistance over stiffness), because such a slope may let
# errors grow.
_CAUTION = 4.0
# Moments of a run at which these slopes are sampled. Multiples of the golden section cover the run evenly.
_MOMENTS = 8
_GOLDEN_SECTION = (math.sqrt(5.0) - 1.0) / 2.0


def results_of(layout: Layout, known: Mapping[str, Array], state: Array) -> Array:
    """Return `RESULTS` and the relative error, a row each.

    Args:
        layout: of the state.
        known: `Layout.known` by name.
        state: at the end, from the means on, a row each.
    """
    means, variances, _ = np.split(state, [layout.equation.count, layout.equation.averages])
    found = layout.structure.averages(known, means, variances)
    size = np.maximum(np.abs(found[0]), found[1])
    stiffness = np.abs(known["stiffness"])  # a repelling spring has a negative one
    error = np.divide(np.sqrt(state[-1]) * stiffness, size, out=np.zeros_like(size), where=size != 0.0)
    # Motions that diverge for very long leave the range of floating point.
    error[np.isnan(error)] = np.inf
    return np.stack([*found, error])


def setup(layout: Layout, scene: Scene, duration: Expression, inputs: Sequence[Column], error: float) -> ca.Function:
    """Return a Function of the inputs whose result is a column.

    It holds the parameters of a step, the phase of the whole run [rad], and `Layout.known`.
    """
    structure, known = layout.structure, parameters(scene)
    values = [known[name] for name in layout.names]
    end = minimum(known["ramp_time"], duration) if structure.ramp else duration
    steady = absolute(scene.steady_resistance / scene.stiffness)
    # Where the soil never resists, the strut alone moves the share.
    size = where(steady > 0.0, steady, scene.tow_speed / scene.natural_frequency) + _TINY
    phase, part = _phase_and_error_part(layout)(stacked(*values, end, duration))
    longest_first_step, allowed_error = duration / (1.0 + phase), error * size * part
    every = (known[name] for name in layout.known)
    column = stacked(*values, end, duration, longest_first_step, allowed_error, phase, *every)
    return function_of_column("setup", inputs, column)


def function_of_column(name: str, inputs: Sequence[Column], result: Column) -> ca.Function:
    """Return the Function of a column of all inputs with this result, of SX if its graph allows that.

    Raises:
        InputError: the result depends on other symbols than the inputs.
    """
    dense: Any = ca.densify(result)
    inner = ca.Function(name, list(inputs), [dense], {"allow_free": True})
    if inner.has_free():
        raise InputError(f"the scene depends on {', '.join(inner.get_free())}: name it among the inputs of the batch")
    if inner.is_a("MXFunction") and (labels := labels_in(inner)):
        inner = ca.Function(name, list(inputs), without_labels([dense], labels))
    kind: Any = ca.MX
    with contextlib.suppress(RuntimeError):  # the solution of linear equations has no graph of scalar operations
        expanded = inner.expand()
        # A table or the root of an equation remains a call, which only CasADi evaluates.
        if ca.OP_CALL not in map(expanded.instruction_id, range(expanded.n_instructions())):
            inner, kind = expanded, ca.SX
    column = kind.sym("column", sum(one.numel() for one in inputs))
    ends = itertools.accumulate((one.numel() for one in inputs), initial=0)
    parts = [ca.reshape(column[a:b], *one.shape) for one, (a, b) in zip(inputs, itertools.pairwise(ends), strict=True)]
    return ca.Function(name, [column], inner.call(parts))


@lru_cache(maxsize=16)
def slopes(equation: Equation) -> ca.Function:
    """Return (time, (w, w'), parameters of the equation of motion) -> (dw''/dw [1/s^2], dw''/dw' [1/s])."""
    time, state, p = ca.SX.sym("time"), ca.SX.sym("state", 2), ca.SX.sym("p", len(equation.names))
    found = ca.densify(ca.jacobian(equation.rate(time, state, p)[1], state))
    return ca.Function("slopes", [time, state, p], [ca.cse(found.T)])


def _phase_and_error_part(layout: Layout) -> ca.Function:
    """Return parameters up to the duration -> (phase of the run [rad], part of the wanted error that a step may make).

    The errors of all steps add up. A damper, and a soil whose resistance grows with speed, let them decay; their rate
    is estimated from the slopes along the path of a share that moves with the strut. Errors may grow if the slope of
    the soil's resistance along the path is not small beside the stiffness. This is only a first guess: each run
    estimates its own error, and `Batch` repeats it if that is too large.
    """
    p = ca.SX.sym("p", layout.ends[-1] + 1)
    known = dict(zip(layout.names, ca.vertsplit(p), strict=False))
    duration, frequency_squared = p[layout.ends[-1]], layout.mount_frequency(p) ** 2
    soil_over_mount, decay = ca.SX(0), ca.SX(0)
    for k in range(_MOMENTS):
        moment = duration * math.fmod(_GOLDEN_SECTION * (k + 0.5), 1.0)
        spring, damper = ca.vertsplit(slopes(layout.equation)(moment, ca.SX.zeros(2), p[: len(layout.names)]))
        soil_over_mount = soil_over_mount + ca.fabs(spring + frequency_squared) / (_MOMENTS * frequency_squared)
        decay = decay - damper / (2.0 * _MOMENTS)
    # An overdamped mount has two rates of decay; this is the slower one, times the duration.
    decay = duration * ca.fmax(decay - ca.sqrt(ca.fmax(decay**2 - frequency_squared, 0.0)), 0.0)
    phase = duration * rates(known).summed
    # Nearly the root of the mean square of (1 - exp(-g u))/g over u from 0 to 1, with g for the decay.
    remembered = 1.0 / ca.sqrt(3.0 + decay * (2.0 + decay))
    steps = _FEWEST_TAYLOR_STEPS + phase / _PHASE_PER_TAYLOR_STEP
    part = _PART_OF_STEPS / ((1.0 + _CAUTION * soil_over_mount) * remembered * steps)
    return ca.Function("phase_and_error_part", [p], [phase, part])


# Taylor coefficients of dw''/dw and of dw''/dw' that enter the map. More would change the estimate by a few per cent.
_SPRING_TERMS = 6
_DAMPER_TERMS = 4
# Keeps quotients finite before there is an error.
TINY = 1e-290
# exp(x) is nearly 0 below this.
_LOWEST_EXPONENT = -16.0

Matrix = tuple[ca.SX, ca.SX, ca.SX, ca.SX]
"""Elements 11, 12, 21 and 22 of a map of (w, w'/s)."""


def deviation_map(start: StepStart, motion: tuple[list[ca.SX], list[ca.SX]], powers: list[ca.SX]) -> Matrix:
    """Return the matrix that maps a small deviation at the start of a step to the one at its end.

    Its determinant is exact, so that an undamped oscillation neither grows nor decays by it.

    Args:
        start: the design at the start of the step.
        motion: Taylor coefficients of w and of w'.
        powers: of the step size [s], from 0 on.
    """
    graph = Graph(start.ramp_ended)
    known = [graph.given(*coefficients[:_SPRING_TERMS]) for coefficients in motion]
    spring, damper = start.series(graph, slopes(start.layout.equation), known)
    for order in range(_SPRING_TERMS):
        graph.extend(order)
    size, frequency = powers[1], start.layout.mount_frequency(start.p)
    # Over the step (e, e'/s)' = A (e, e'/s) with A = [[0, s], [spring/s, damper]]. With the step as unit of time, `a`
    # and `b` are the averages of the lower row, and `tilt` is the average of the spring's element times the distance
    # from the middle of the step.
    length = size / frequency
    a, b = length * _mean(spring, powers[:_SPRING_TERMS]), size * _mean(damper, powers[:_DAMPER_TERMS])
    tilt = length * _tilt(spring, powers[:_SPRING_TERMS])
    turn, half = size * frequency, 0.5 * b
    # The expansion is half I + [[d, u], [l, -d]], and the exponential of the latter, which has no trace, is
    # cosh(q) I + sinh(q)/q [[d, u], [l, -d]] with q^2 = d^2 + u l.
    diagonal, upper, lower = -turn * tilt - half, turn, a - b * tilt
    even, odd = _cosh_and_sinh(diagonal**2 + upper * lower)
    decay = _exponential(half)
    even, odd = decay * even, decay * odd
    return even + odd * diagonal, odd * upper, odd * lower, even - odd * diagonal


def _mean(series: Series, powers: list[ca.SX]) -> ca.SX:
    """Return the average of a series over the step."""
    base, factor, summand = series.affine
    return factor * _weighted(base, powers, [1.0 / (k + 1.0) for k in range(len(powers))]) + summand


def _tilt(series: Series, powers: list[ca.SX]) -> ca.SX:
    """Return the average of a series times the distance from the middle of the step, in step sizes."""
    base, factor, _ = series.affine
    return factor * _weighted(base, powers, [0.5 * k / ((k + 1.0) * (k + 2.0)) for k in range(len(powers))])


def _weighted(series: Series, powers: list[ca.SX], weights: list[float]) -> ca.SX:
    """Return the sum of a series' terms at the end of the step, each times its weight."""
    terms = zip(series.coefficients, powers, weights, strict=False)
    return sum((weight * (c * power) for c, power, weight in terms if weight != 0.0 and not c.is_zero()), ca.SX(0))


def _cosh_and_sinh(x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return cosh(sqrt(x)) and sinh(sqrt(x))/sqrt(x), which for x < 0 are cos(sqrt(-x)) and sin(sqrt(-x))/sqrt(-x).

    They are Taylor polynomials at x/64, followed by three doublings of the argument.
    """
    x = x / 64.0
    even = 1.0 + x * (1.0 / 2.0 + x * (1.0 / 24.0 + x * (1.0 / 720.0)))
    odd = 1.0 + x * (1.0 / 6.0 + x * (1.0 / 120.0 + x * (1.0 / 5040.0)))
    for _ in range(3):
        even, odd = 2.0 * even**2 - 1.0, odd * even
    return even, odd


def _exponential(x: ca.SX) -> ca.SX:
    """Return exp(x) as (1 + y + y^2/2 + y^3/6)^16 with y = x/16: within some per cent above -6, and nearly 0 below."""
    y = ca.fmax(x, _LOWEST_EXPONENT) / 16.0
    y = 1.0 + y * (1.0 + y * (1.0 / 2.0 + y * (1.0 / 6.0)))
    for _ in range(4):
        y = y**2
    return y


def ellipse_after(ellipse: list[ca.SX], deviation: Matrix, made: ca.SX) -> list[ca.SX]:
    """Return the error ellipse after a step.

    Args:
        ellipse: elements 11, 12 and 22 of P [m^2] before the step; the ellipse is e P^-1 e <= 1.
        deviation: `deviation_map` of the step.
        made: the step's own error [m], in any direction.
    """
    (a, b, c, d), (p, q, r) = deviation, ellipse
    left = a * p + b * q, a * q + b * r
    right = c * p + d * q, c * q + d * r
    mapped = [left[0] * a + left[1] * b, left[0] * c + left[1] * d, right[0] * c + right[1] * d]
    radius = ca.sqrt(ca.fmax(0.5 * (mapped[0] + mapped[2]), 0.0))
    # Among all ellipses that contain the sum of this one and a circle, the one with the least sum of squared axes.
    stretch, added = 1.0 + made / (radius + TINY), made * (made + radius)
    return [stretch * mapped[0] + added, stretch * mapped[1], stretch * mapped[2] + added]


def largest_squared_error(start: StepStart, ellipse: list[ca.SX]) -> ca.SX:
    """Return the square of the largest error in an ellipse of the mount force over the stiffness [m^2]."""
    layout = start.layout
    if not layout.structure.damper:
        return ellipse[0]
    lever = layout.mount_frequency(start.p) * layout.value(start.p, "damping") / layout.value(start.p, "stiffness")
    return ellipse[0] + lever * (2.0 * ellipse[1] + lever * ellipse[2])


# Degree in time of the strut's speed during a ramp, by which the product with it has more orders than the motion.
_RAMP_DEGREE = 5
_EPSILON = 2.0**-52

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
    made = last_terms * powers[order] + _EPSILON * ca.fabs(state[0])
    *ellipse_before, mean_before = ca.vertsplit(x[-4:])
    ellipse = ellipse_after(ellipse_before, deviation_map(start, (w, rate), powers), made)
    squared_error = 0.5 * (largest_squared_error(start, ellipse_before) + largest_squared_error(start, ellipse))
    mean_squared_error = mean_before + part_of_time * (squared_error - mean_before)
    result = ca.vertcat(time, *state, *averages, *kept, *ellipse, mean_squared_error)
    return ca.Function("advance", [x, p], [ca.cse(result)])


def _solution(start: StepStart, order: int) -> tuple[list[ca.SX], list[ca.SX], list[Switch]]:
    """Return the coefficients of w and of w', and the switches of the right-hand side."""
    graph = Graph(start.ramp_ended, ca.vertsplit(start.state[-4 - start.layout.switches : -4]))
    w, rate = graph.given(start.state[1]), graph.given(start.state[2])
    w_rate, acceleration = start.series(graph, start.layout.equation.rate, [w, rate])
    for k in range(order):
        graph.extend(k)
        w.coefficients.append(w_rate[k] / (k + 1))
        rate.coefficients.append(acceleration[k] / (k + 1))
    w.coefficients.append(rate[order] / (order + 1))
    return w.coefficients, rate.coefficients, graph.switches


def _signals(start: StepStart, w: list[ca.SX], rate: list[ca.SX]) -> list[list[ca.SX]]:
    """Return the coefficients of the signals; during a ramp of all orders of the product with the strut's speed."""
    graph, structure = Graph(start.ramp_ended), start.layout.structure
    orders = len(w) + (_RAMP_DEGREE if structure.ramp and not start.ramp_ended else 0)
    motion = [graph.given(*c, *[ca.SX(0)] * (orders - len(c))) for c in (w, rate)]
    observed = start.series(graph, start.layout.equation.signals, motion)
    for k in range(orders):
        graph.extend(k)
    return [series.coefficients for series in observed]


def _last_terms(start: StepStart, series: list[ca.SX], highest: int) -> ca.SX:
    """Return the size of a polynomial's highest coefficient, judged by the ones before it too.

    Each of these is carried to the highest order as that of an oscillation at the frequencies of mount and wave.
    """
    rate = start.layout.fastest_frequency(start.p) / _FALL
    total = sum((ca.fabs(series[highest - k]) * rate**k for k in range(_LAST_COEFFICIENTS)), ca.SX(0))
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
        legendre = _legendre(series, 2 * len(series) // 5 if k < layout.equation.squared else 0)
        before = x[3 + k]
        distance = legendre[0] - before
        means.append(before + part * distance)
        if k < layout.equation.squared:
            spread = sum(c**2 / (2 * degree + 1) for degree, c in enumerate(legendre[1:], start=1))
            old = x[3 + layout.equation.count + k]
            variances.append((1.0 - part) * (old + part * distance**2) + part * spread)
    return [*means, *variances]


def _legendre(terms: list[ca.SX], highest: int) -> list[ca.SX]:
    """Return the coefficients of a polynomial on [0, 1] in Legendre polynomials, which are orthogonal.

    The coefficient of degree l of u^k is (2l + 1) k!^2 / ((k - l)! (k + l + 1)!).
    """
    factorial = math.factorial

    def weight(degree: int, k: int) -> float:
        return (2 * degree + 1) * factorial(k) ** 2 / (factorial(k - degree) * factorial(k + degree + 1))

    return [
        sum((weight(degree, k) * c for k, c in enumerate(terms[degree:], start=degree)), ca.SX(0))
        for degree in range(highest + 1)
    ]


def _powers(x: ca.SX, highest: int) -> list[ca.SX]:
    """Return 1, x, x^2 ..., each as a product of two halves, so that a processor can compute several at once."""
    powers = [ca.SX(1), x]
    for k in range(2, highest + 1):
        powers.append(powers[k // 2] * powers[k - k // 2])
    return powers
