"""Small convex quadratic programs, by least distances (Lawson and Hanson 1974, chapter 23)."""

import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.design.optimality import newton_step

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
