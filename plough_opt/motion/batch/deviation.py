"""The errors of all steps of a motion so far: an ellipse in the plane of w and w' that contains their sum.

Errors add up as sizes, not as squares, since those of an oscillation's steps may all point along its path. Each step
moves the ellipse by the linearised equation of motion, so that it grows where neighbouring motions part, turns where
they oscillate about each other, and shrinks where a damper or the soil lets them decay.

Blanes, Casas, Oteo, Ros: The Magnus expansion and some of its applications, Physics Reports 470 (2009), section 5.4,
of order 4; Kurzhanski, Valyi: Ellipsoidal Calculus for Estimation and Control, 1997, section 2.7, for the sum.
"""

from functools import lru_cache

import casadi as ca

from plough_opt.motion.batch.layout import Layout
from plough_opt.motion.batch.rules import series_of
from plough_opt.motion.batch.series import Graph, Series
from plough_opt.motion.equation import equation_of_motion

# Coefficients of the slopes in a step, by w and by w': more of them change the estimate by some per cent.
_SPRING_TERMS, _DAMPER_TERMS = 6, 4
# Keeps a quotient finite as long as there is no error.
_TINY = 1e-290

Matrix = tuple[ca.SX, ca.SX, ca.SX, ca.SX]
"""Elements 11, 12, 21 and 22, for (w, w'/s) with the mount's own angular frequency s."""


@lru_cache(maxsize=16)
def slopes(layout: Layout) -> ca.Function:
    """Return (time, (w, w'), parameters of the equation of motion) -> (dw''/dw [1/s^2], dw''/dw' [1/s])."""
    motion = equation_of_motion(layout.structure)
    time, state, p = ca.SX.sym("time"), ca.SX.sym("state", 2), ca.SX.sym("p", len(motion.names))
    found = ca.densify(ca.jacobian(motion.function(time, state, p)[1], state))
    return ca.Function("slopes", [time, state, p], [ca.cse(found.T)])


def transfer(
    layout: Layout, moving: tuple[list[ca.SX], list[ca.SX]], start: ca.SX, p: ca.SX, late: bool, powers: list[ca.SX]
) -> Matrix:
    """Return the matrix that turns a small deviation at the start of a step into the one at its end.

    It is the exponential of a Magnus expansion of order 4, whose determinant is exact: an undamped oscillation neither
    grows nor decays by it.

    Args:
        layout: positions in the columns.
        moving: coefficients of w and of w'.
        start: time at which the step begins [s].
        p: parameters of a step.
        late: whether a ramp has ended.
        powers: of the step's length [s], from 0 on.
    """
    motion, graph = equation_of_motion(layout.structure), Graph()
    own = [graph.constant(layout.value(p, name)) for name in motion.names]
    known = [graph.given(*series[:_SPRING_TERMS]) for series in moving]
    spring, damper = series_of(graph, slopes(layout), [[graph.clock(start)], known, own], late)
    for k in range(_SPRING_TERMS):
        graph.extend(k)
    size, scale = powers[1], layout.own_frequency(p)
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


def square_of_error(layout: Layout, ellipse: list[ca.SX], p: ca.SX) -> ca.SX:
    """Return the square of the largest error of the mount force over the stiffness in an ellipse [m^2]."""
    if not layout.structure.damper:
        return ellipse[0]
    lever = layout.own_frequency(p) * layout.value(p, "damping") / layout.value(p, "stiffness")
    return ellipse[0] + lever * (2.0 * ellipse[1] + lever * ellipse[2])
