"""Small convex quadratic programs, by least distances (Lawson and Hanson 1974, chapter 23)."""

from __future__ import annotations

import numpy as np

from plough_opt.design.ipopt import Vector

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
    step, exact = _with_equal(curvature, gradient, wanted[active], b[active])
    multipliers = np.zeros(len(low))
    np.add.at(multipliers, own[active], -signs[active] * exact)
    return step, multipliers


def _with_equal(curvature: Vector, gradient: Vector, rows: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Return step and multipliers with rows that are met exactly."""
    n = len(gradient)
    system = np.zeros((n + len(b), n + len(b)))
    system[:n, :n], system[:n, n:], system[n:, :n] = curvature, -rows.T, rows
    found = np.linalg.lstsq(system, np.concatenate([-gradient, b]), rcond=None)[0]
    return found[:n], found[n:]
