"""Optimality of a scaled design: which limits decide, which directions they leave free, what the conditions lack.

With objective f, requirements low <= g <= high and variables 0 <= y <= 1, an optimum has multipliers, positive at an
upper and negative at a lower limit, for which f_y + g_y' lam_g + lam_y = 0 (first order), and the Hessian of the
Lagrangian f + lam_g' g curves upwards along all directions that leave the deciding limits in place (second order).
"""

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.ipopt import Point

Vector = NDArray[np.float64]

PULLS = 1e-7
"""Scaled multipliers below this pull at nothing."""

# A scaled variable nearer to a bound is on it.
_AT_BOUND = 1e-9
# Of slopes, relative to the largest: below this one repeats the others.
_INDEPENDENT = 1e-9


def decides(margin: float, pull: float) -> bool:
    """Return whether a limit decides a design, by scaled margin and multiplier: at an optimum one of both vanishes."""
    return pull > PULLS and pull > margin


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
