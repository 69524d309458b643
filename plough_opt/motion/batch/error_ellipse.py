"""The sum of the errors of a batch's steps over a run, bounded by an ellipse that is carried from step to step.

The errors live in the plane of w and w'/s, with the angular frequency s of the mount. Each step first maps the ellipse
by the linearised equation of motion, so that it grows where neighbouring motions diverge, turns where they oscillate
about each other and shrinks where a damper or the soil lets them decay. It then enlarges the ellipse by the step's own
error. Errors add as sizes and not as squares, because those of an oscillation may all point along its path.

The linear map is the exponential of a Magnus expansion of order 4: Blanes, Casas, Oteo, Ros: The Magnus expansion and
some of its applications, Physics Reports 470 (2009), section 5.4. The sum of an ellipse and a circle follows
Kurzhanski, Valyi: Ellipsoidal Calculus for Estimation and Control, 1997, section 2.7.
"""

import casadi as ca

from plough_opt.motion.batch.equations import slopes
from plough_opt.motion.batch.layout import StepStart
from plough_opt.motion.batch.series import Series
from plough_opt.motion.equation import equation_of_motion

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
    structure, graph = start.layout.structure, start.graph()
    known = [graph.given(*coefficients[:_SPRING_TERMS]) for coefficients in motion]
    spring, damper = start.series(graph, slopes(structure), known, equation_of_motion(structure).names)
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
    total = ca.SX(0)
    for c, power, weight in zip(series.coefficients, powers, weights, strict=False):
        if weight != 0.0 and not c.is_zero():
            total = total + weight * (c * power)
    return total


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
