"""An optimum's last digits by sequential quadratic programs, from a design that a search left nearly optimal.

Its curvatures, which need only be roughly right, come from differences of runs side by side, so that two or three
evaluations of exact slopes do, where an interior-point method takes as many again for its barrier to vanish.
"""

import itertools
from typing import Final

import numpy as np

from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.optimality import residual, without_rounding
from plough_opt.design.program import Program
from plough_opt.design.quadratic import made_convex, optimum_step

# Of first-order conditions, scaled: what is left at an optimum.
_STATIONARY: Final = 1e-10
# Steps, and how long one is at most: a start further away is not nearly optimal.
_STEPS, _LONGEST = 5, 0.02
# By what factor a step must at least bring the conditions nearer: less is not convergence.
_FALLS: Final = 0.5
# Scaled step of the differences: between the rounding of a run (some 1e-13) and the narrowest ripples (some 1e-2); and
# the factor on a search's steps with which they are run.
_STEP, _FINER = 2e-4, 2.0
# Differences this far from the exact slopes, relative to the largest, have a kink between them, as the RMS of an
# amplitude has at 0.
_KINK: Final = 0.05
# Multipliers and the curvature that goes with them are found together, in so many rounds.
_ROUNDS: Final = 3
# Limits are kept by so much, scaled, so that rounding breaks none.
_KEPT: Final = 1e-11
# Scaled margin that leaves no room, and the least difference of slopes of length 1.
_TOUCHING, _ALIKE = 1e-8, 1e-7


def with_last_digits(program: Program, p: Vector, start: Vector) -> Point | None:
    """Return the optimum beside a design, or None where none is reached in a few short steps.

    Args:
        program: the design's program, built.
        p: parameters.
        start: scaled variables, nearly optimal.
    """
    known = _differences(program, p, start) if program.population.vectorised else None
    if known is None:
        return None
    slopes, bends = known
    kept = np.where(program.low < program.high, _KEPT, 0.0)
    y, lam_g, before = start, np.zeros(len(program.low)), np.inf
    for number in range(_STEPS):
        f, g, gradient, jacobian = (np.asarray(result) for result in program.nlp.slopes(y, p))
        g, gradient = g.ravel(), gradient.ravel()
        if not all(np.all(np.isfinite(part)) for part in (f, g, gradient, jacobian)):
            return None
        exact = np.vstack([gradient, jacobian])
        if not number and np.max(np.abs(exact - slopes)) > _KINK * max(1.0, float(np.max(np.abs(exact)))):
            return None
        at, limits = (g, gradient, jacobian), (program.low + kept, program.high - kept)
        for _ in range(1 if number else _ROUNDS):
            curvature = made_convex(bends[0] + np.tensordot(lam_g, bends[1:], 1))
            found = optimum_step(curvature, y, at, limits)
            if found is None:
                return None
            step, lam_g, lam_y = found
        point = Point(True, "Solve_Succeeded", y, float(f.item()), lam_g, without_rounding(y, lam_y), number)
        left = residual(point, at, (program.low, program.high))
        if left <= _STATIONARY:
            if np.all((kept == 0.0) | ((program.low <= g) & (g <= program.high))):
                return point if _independent(point.y, at, limits) else None
        elif left > _FALLS * before or np.max(np.abs(step)) > _LONGEST:
            return None
        y, before = np.clip(y + step, 0.0, 1.0), left
    return None


def _independent(y: Vector, at: tuple[Vector, Vector, Vector], limits: tuple[Vector, Vector]) -> bool:
    """Return whether the slopes of limits that leave no room are independent; else which of them pulls is open."""
    (g, _, jacobian), (low, high) = at, limits
    rooms = np.concatenate([np.minimum(g - low, high - g), np.minimum(y, 1.0 - y)])
    touching = np.vstack([jacobian, np.eye(len(y))])[rooms < _TOUCHING]
    sizes = np.maximum(np.linalg.norm(touching, axis=1, keepdims=True), np.finfo(float).tiny)
    return not len(touching) or int(np.linalg.matrix_rank(touching / sizes, _ALIKE)) == len(touching)


def _differences(program: Program, p: Vector, y: Vector) -> tuple[Vector, Vector] | None:
    """Return first and second derivatives of objective and requirements; None without a value somewhere.

    Their first derivatives are a row each, their second ones a matrix each.
    """
    n = len(y)
    steps = np.diag(np.where(y > 0.5, -_STEP, _STEP))
    both = list(itertools.combinations_with_replacement(range(n), 2))
    points = np.vstack([y, y + steps, *(y + steps[i] + steps[j] for i, j in both)])
    with np.errstate(all="ignore"):
        f, g = program.population(points, p, finer=_FINER, together=len(points))
    scales = np.array(program.scales)[np.array(program.owner, dtype=int)]
    values = np.column_stack([f / program.objective_scale, g / scales])
    if not np.all(np.isfinite(values)):
        return None
    bends = np.empty((values.shape[1], n, n))
    for (i, j), value in zip(both, values[n + 1 :], strict=True):
        bend = (value - values[1 + i] - values[1 + j] + values[0]) / (steps[i, i] * steps[j, j])
        bends[:, i, j] = bends[:, j, i] = bend
    sides = np.diag(steps)
    slopes = (values[1 : n + 1] - values[0]).T / sides - 0.5 * np.einsum("kii->ki", bends) * sides
    return slopes, bends
