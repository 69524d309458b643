"""Optimality of a scaled design: which limits decide, which directions they leave free, what the conditions lack.

With objective f, requirements low <= g <= high and variables 0 <= y <= 1, an optimum has multipliers, positive at an
upper and negative at a lower limit, for which f_y + g_y' lam_g + lam_y = 0 (first order), and the Hessian of the
Lagrangian f + lam_g' g curves upwards along all directions that leave the deciding limits in place (second order).
Quadratic programs lead there from nearby, by least distances (Lawson and Hanson 1974, chapter 23).
"""

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.ipopt import Point, Vector

PULLS = 1e-7
"""Scaled multipliers below this pull at nothing."""

# A scaled variable nearer to a bound is on it.
_AT_BOUND = 1e-9
# Of slopes, relative to the largest: below this one repeats the others.
_INDEPENDENT = 1e-9


def decides(margin: float, pull: float) -> bool:
    """Return whether a limit decides a design, by scaled margin and multiplier: at an optimum one of both vanishes."""
    return pull > PULLS and pull > margin


def lowest_dips(margins: Vector, most: int) -> NDArray[np.intp]:
    """Return the numbers of the local minima of a curve of margins, the lowest first, at most so many."""
    dips = np.flatnonzero((margins <= np.r_[np.inf, margins[:-1]]) & (margins <= np.r_[margins[1:], np.inf]))
    return dips[np.argsort(margins[dips], kind="stable")[:most]]


def symmetric(upper: Vector) -> Vector:
    """Return a Hessian of which the upper triangle is given."""
    return upper + np.triu(upper, 1).T


def free_directions(rows: Vector) -> Vector:
    """Return an orthonormal basis, as columns, of the directions along which none of the rows changes."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, right = np.linalg.svd(rows)
    return np.asarray(right[int(np.sum(sizes > _INDEPENDENT * max(1.0, sizes[0]))) :].T)


def reduced_curvatures(hessian: Vector, free: Vector) -> tuple[Vector, Vector]:
    """Return the curvatures along free directions, rising and relative to the largest of all, with their directions."""
    curvatures, vectors = np.linalg.eigh(free.T @ hessian @ free)
    return curvatures / max(1.0, float(np.max(np.abs(hessian)))), free @ vectors


def newton_step(
    hessian: Vector, gradient: Vector, rows: Vector, gaps: Vector, flat: float | None = None
) -> tuple[Vector, Vector]:
    """Return the step to where the slope is that of some rows alone and their gaps close, and the rows' multipliers.

    Args:
        hessian: of the Lagrangian.
        gradient: of the objective.
        rows: slopes of the rows.
        gaps: of each row what it has beyond its limit.
        flat: singular values below this part of the largest are none; default: below rounding.

    Returns:
        The step d and multipliers m with H d + gradient = rows' m and rows d = -gaps, or the nearest to that.
    """
    n = len(gradient)
    system = np.zeros((n + len(gaps), n + len(gaps)))
    system[:n, :n], system[:n, n:], system[n:, :n] = hessian, -rows.T, rows
    found = np.linalg.lstsq(system, -np.concatenate([gradient, gaps]), rcond=flat)[0]
    return found[:n], found[n:]


def without_rounding(y: Vector, lam_y: Vector) -> Vector:
    """Return the multipliers of bounds without those of variables that are on none."""
    return np.where((y > _AT_BOUND) & (y < 1.0 - _AT_BOUND), 0.0, lam_y)


def residual(point: Point, at: tuple[Vector, Vector, Vector], limits: tuple[Vector, Vector]) -> float:
    """Return by how much a point misses the first-order conditions: slopes, limits, and one of two at each.

    Args:
        point: the point.
        at: requirements, gradient and Jacobian there, scaled.
        limits: lower and upper limits of the requirements, scaled.
    """
    (g, gradient, jacobian), (low, high) = at, limits
    values, pulls = np.concatenate([g, point.y]), np.concatenate([point.lam_g, point.lam_y])
    low, high = np.concatenate([low, np.zeros(len(point.y))]), np.concatenate([high, np.ones(len(point.y))])
    slope = gradient + jacobian.T @ point.lam_g + point.lam_y
    beyond = np.max(np.maximum(low - values, values - high), initial=0.0)
    rooms = np.where(pulls > 0.0, high - values, values - low)
    # A limit that is not there, at infinity, must have no multiplier.
    both = np.max(np.abs(pulls) * np.where(np.isfinite(rooms), np.abs(rooms), 1.0))
    return float(max(np.max(np.abs(slope)), both) / max(1.0, np.max(np.abs(pulls))) + beyond)


# Of a program whose limits contradict each other, the distance that is left.
_INFEASIBLE = 1e-13
# Curvatures below are made so large: quadratic programs stay convex.
_LEAST_CURVATURE = 1e-4


def made_convex(hessian: Vector) -> Vector:
    """Return a Hessian with its curvatures made positive."""
    sizes, directions = np.linalg.eigh(hessian)
    return np.asarray((directions * np.maximum(np.abs(sizes), _LEAST_CURVATURE)) @ directions.T)


def least(
    curvature: Vector, gradient: Vector, rows: Vector, limits: tuple[Vector, Vector]
) -> tuple[Vector, Vector] | None:
    """Return the step d that minimises d' H d / 2 + g' d with limits on A d, and the limits' multipliers.

    Args:
        curvature: H, positive definite.
        gradient: g.
        rows: A.
        limits: lower and upper limit of each row; infinite where there is none.

    Returns:
        The step, and multipliers, positive at an upper limit and negative at a lower one; None without a feasible step.
    """
    from scipy.optimize import nnls  # slow to import, and every problem file imports this module

    low, high = limits
    below, above = np.flatnonzero(np.isfinite(low)), np.flatnonzero(np.isfinite(high))
    own = np.concatenate([below, above])
    signs = np.concatenate([np.ones(len(below)), -np.ones(len(above))])
    # Written as B d >= b, in the measure in which H is the identity, the step is the point nearest to the free one.
    b = np.concatenate([low[below], -high[above]])
    wanted = signs[:, None] * rows[own]
    root = np.linalg.cholesky(curvature)
    turned = np.linalg.solve(root, np.column_stack([wanted.T, gradient]))
    system = np.vstack([turned[:, :-1], b + turned[:, :-1].T @ turned[:, -1]])
    target = np.zeros(len(system))
    target[-1] = 1.0
    pulls, distance = nnls(system, target)
    if distance < _INFEASIBLE:
        return None
    active = np.flatnonzero(pulls)
    step, exact = newton_step(curvature, gradient, wanted[active], -b[active])
    multipliers = np.zeros(len(low))
    np.add.at(multipliers, own[active], -signs[active] * exact)
    return step, multipliers


def optimum_step(
    curvature: Vector,
    y: Vector,
    at: tuple[Vector, Vector, Vector],
    limits: tuple[Vector, Vector],
    longest: float = np.inf,
) -> tuple[Vector, Vector, Vector] | None:
    """Return the step of sequential quadratic programming towards an optimum.

    Args:
        curvature: of the Lagrangian, positive definite.
        y: scaled variables.
        at: requirements, gradient and Jacobian there, scaled.
        limits: lower and upper limits of the requirements, scaled.
        longest: how far a variable moves at most.

    Returns:
        The step, and the multipliers of requirements and of bounds; None without a feasible step.
    """
    g, gradient, jacobian = at
    low = np.concatenate([limits[0] - g, np.maximum(-y, -longest)])
    high = np.concatenate([limits[1] - g, np.minimum(1.0 - y, longest)])
    found = least(curvature, gradient, np.concatenate([jacobian, np.eye(len(y))]), (low, high))
    return None if found is None else (found[0], found[1][: len(g)], found[1][len(g) :])
