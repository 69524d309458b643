"""Optimality conditions of a scaled design, and the quadratic programs that lead to an optimum from nearby.

The design minimises f subject to low <= g <= high and 0 <= y <= 1. At an optimum the multipliers lam_g and lam_y are
positive at upper limits and negative at lower ones. First order: f_y + g_y' lam_g + lam_y = 0. Second order: the
Hessian of the Lagrangian f + lam_g' g curves upwards along every direction that leaves the active limits in place.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.model.ipopt import Vector


class Zero:
    """Sizes below which a part of the optimality conditions of a scaled design counts as zero."""

    multiplier: Final = 1e-7
    margin: Final = 1e-7  # of a limit, which then is active
    # Of the curvature along a direction, as a part of the largest: the optimum may then have no derivative.
    curvature: Final = 1e-7
    distance: Final = 1e-9  # between a variable and its bound; closer, it counts as on it
    # Of a singular value, relative to the largest or of rows of length 1, which then are linearly dependent.
    rank: Final = 1e-9


def decides(margin: Any, pull: Any) -> Any:
    """Return whether a limit is active, from its scaled margin and multiplier: at an optimum one of them vanishes."""
    return (pull > Zero.multiplier) & (pull > margin)


def lowest_dips(margins: Vector, most: int) -> NDArray[np.intp]:
    """Return the positions of the lowest local minima of a curve, lowest first and at most ``most`` of them."""
    dips = np.flatnonzero((margins <= np.r_[np.inf, margins[:-1]]) & (margins <= np.r_[margins[1:], np.inf]))
    return dips[np.argsort(margins[dips], kind="stable")[:most]]


def symmetric(upper: Vector) -> Vector:
    """Return a symmetric matrix from its upper triangle."""
    return upper + np.triu(upper, 1).T


def free_directions(rows: Vector) -> Vector:
    """Return an orthonormal basis, as columns, of the null space of a matrix."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, right = np.linalg.svd(rows)
    return np.asarray(right[int(np.sum(sizes > Zero.rank * max(1.0, sizes[0]))) :].T)


def reduced_curvatures(hessian: Vector, free: Vector) -> tuple[Vector, Vector]:
    """Return the curvatures within a subspace, ascending and relative to the Hessian's size, with their directions.

    Args:
        hessian: symmetric matrix.
        free: orthonormal basis of the subspace, as columns.

    Returns:
        Eigenvalues of the reduced Hessian, divided by the largest entry of ``hessian`` or by 1 if that is larger; and
        the eigenvectors, as columns in the coordinates of ``hessian``.
    """
    curvatures, vectors = np.linalg.eigh(free.T @ hessian @ free)
    return curvatures / max(1.0, float(np.max(np.abs(hessian)))), free @ vectors


def newton_step(
    hessian: Vector, gradient: Vector, rows: Vector, gaps: Vector, flat: float | None = None
) -> tuple[Vector, Vector]:
    """Return Newton's step for the optimality conditions with a given active set, and the multipliers after it.

    Args:
        hessian: of the Lagrangian.
        gradient: of the objective.
        rows: gradients of the active limits, a row for each.
        gaps: for each row, its value less its limit.
        flat: singular values below this part of the largest count as zero; default: below rounding.

    Returns:
        The step d and multipliers m with H d + gradient = rows' m and rows d = -gaps, by least squares if the system is
        singular.
    """
    n = len(gradient)
    system = np.zeros((n + len(gaps), n + len(gaps)))
    system[:n, :n], system[:n, n:], system[n:, :n] = hessian, -rows.T, rows
    solution = np.linalg.lstsq(system, -np.concatenate([gradient, gaps]), rcond=flat)[0]
    return solution[:n], solution[n:]


def made_convex(hessian: Vector) -> Vector:
    """Return a Hessian with every eigenvalue replaced by its absolute value, or a least curvature if that is larger."""
    sizes, directions = np.linalg.eigh(hessian)
    sizes = np.abs(sizes)
    # Smaller curvatures are raised to this, or to this part of the largest if that is below 1, so that the program is
    # strictly convex.
    least = max(1e-4 * min(1.0, float(np.max(sizes))), np.finfo(float).eps)
    return np.asarray((directions * np.maximum(sizes, least)) @ directions.T)


# Scaled step of difference quotients: a run's rounding (about 1e-13) leaves curvatures right to 1e-4, and the narrowest
# ripples are 1e-2 wide.
_DIFFERENCE = 5e-5


def difference_quotients(
    evaluate: Callable[[Vector], tuple[Vector, Vector]], y: Vector, reach: float = 1.0
) -> tuple[Vector, Vector, Vector] | None:
    """Return values, gradients and Hessians of the objective and of each row of the requirements; None without a value.

    Args:
        evaluate: scaled designs, a row each -> objective and rows of each.
        y: scaled variables; all steps point to the middle of a range.
        reach: factor on the steps.
    """
    signed = reach * np.where(y > 0.5, -_DIFFERENCE, _DIFFERENCE)
    one, other = _pairs(len(y))
    steps = np.diag(signed)
    values = np.column_stack(evaluate(np.vstack([y, y + steps, y + steps[one] + steps[other]])))
    if not np.all(np.isfinite(values)):
        return None
    first = values[1 : len(y) + 1] - values[0]
    hessians = np.empty((values.shape[1], len(y), len(y)))
    second = (values[len(y) + 1 :] - values[0] - first[one] - first[other]).T / (signed[one] * signed[other])
    hessians[:, one, other] = hessians[:, other, one] = second
    return values[0], first.T / signed - 0.5 * np.diagonal(hessians, axis1=1, axis2=2) * signed, hessians


# Of variables; NumPy takes longer to list them than to form the quotients.
_pairs = lru_cache(maxsize=16)(np.triu_indices)


def lagrangian(hessians: Vector, lam_g: Vector) -> Vector:
    """Return the Hessian of the Lagrangian from those of the objective and of each row of the requirements."""
    weighted = lam_g @ hessians[1:].reshape(len(lam_g), hessians[0].size)
    return np.asarray(hessians[0] + weighted.reshape(hessians[0].shape))


def curvature_of(hessians: Vector, lam_g: Vector) -> Vector:
    """Return the Hessian of the Lagrangian, made convex."""
    return made_convex(lagrangian(hessians, lam_g))


def quadratic_program(
    curvature: Vector, gradient: Vector, rows: Vector, limits: tuple[Vector, Vector]
) -> tuple[Vector, Vector] | None:
    """Return the step d that minimises d' H d / 2 + g' d with limits on A d, and the limits' multipliers.

    The problem is one of least distance, solved by non-negative least squares (Lawson and Hanson 1974, "Solving least
    squares problems", chapter 23).

    Args:
        curvature: H, positive definite.
        gradient: g.
        rows: A.
        limits: lower and upper limit of each row; infinite where there is none.

    Returns:
        The step, and multipliers, positive at an upper limit and negative at a lower one; None if no step is feasible.
    """
    from scipy.optimize import nnls  # slow to import, and every problem file imports this module

    low, high = limits
    below, above = np.flatnonzero(np.isfinite(low)), np.flatnonzero(np.isfinite(high))
    row_of = np.concatenate([below, above])
    signs = np.concatenate([np.ones(len(below)), -np.ones(len(above))])
    # Write the limits as B d >= b. In coordinates in which H is the identity, d is the feasible point nearest to the
    # unconstrained minimum.
    b = np.concatenate([low[below], -high[above]])
    b_rows = signs[:, None] * rows[row_of]
    root = np.linalg.cholesky(curvature)
    turned = np.linalg.solve(root, np.column_stack([b_rows.T, gradient]))
    system = np.vstack([turned[:, :-1], b + turned[:, :-1].T @ turned[:, -1]])
    target = np.zeros(len(system))
    target[-1] = 1.0
    weights, distance = nnls(system, target)
    # Distance left by the least-distance problem below which the limits contradict each other.
    if distance < 1e-13:
        return None
    # Positive weights mark the active limits; with these the step follows to rounding.
    active = np.flatnonzero(weights)
    step, exact = newton_step(curvature, gradient, b_rows[active], -b[active])
    multipliers = np.zeros(len(low))
    np.add.at(multipliers, row_of[active], -signs[active] * exact)
    return step, multipliers


def optimum_step(
    curvature: Vector,
    y: Vector,
    at: tuple[Vector, Vector, Vector],
    limits: tuple[Vector, Vector],
    longest: float = np.inf,
    box: tuple[Vector | float, Vector | float] = (0.0, 1.0),
) -> tuple[Vector, Vector, Vector] | None:
    """Return the step of sequential quadratic programming towards an optimum.

    Args:
        curvature: Hessian of the Lagrangian, made positive definite.
        y: scaled variables.
        at: requirements, gradient and Jacobian there, scaled.
        limits: lower and upper limits of the requirements, scaled.
        longest: largest move of a variable.
        box: lower and upper bounds of the variables.

    Returns:
        The step, and the multipliers of requirements and of bounds after it; None if no step is feasible.
    """
    g, gradient, jacobian = at
    low = np.concatenate([limits[0] - g, np.maximum(box[0] - y, -longest)])
    high = np.concatenate([limits[1] - g, np.minimum(box[1] - y, longest)])
    rows = np.concatenate([jacobian, np.eye(len(y))])
    solution = quadratic_program(curvature, gradient, rows, (low, high))
    if solution is None:
        return None
    step, multipliers = solution
    return step, multipliers[: len(g)], multipliers[len(g) :]


def relaxed_step(
    curvature: Vector,
    y: Vector,
    at: tuple[Vector, Vector, Vector],
    limits: tuple[Vector, Vector],
    box: tuple[Vector, Vector],
    owner: Vector,
    weight: float,
) -> tuple[Vector, Vector, Vector] | None:
    """Return `optimum_step` where limits contradict each other: each requirement's limits give way by a slack.

    Args:
        curvature: as in `optimum_step`, like all that is not named here.
        y: scaled variables.
        at: requirements, gradient and Jacobian.
        limits: of the requirements.
        box: bounds of the variables.
        owner: for each row of the requirements, the number of its requirement.
        weight: of the sum of the slacks in the objective.
    """
    (g, gradient, jacobian), n, count = at, len(y), int(np.max(owner, initial=-1)) + 1
    gives, unlimited = np.eye(count)[owner], np.full(len(g), np.inf)
    # Of the slacks: far below the weight of a violation, so that hardly any slack is left where none is needed.
    whole = np.diag(np.full(n + count, 1e-2))
    whole[:n, :n] = curvature
    found = optimum_step(
        whole,
        np.r_[y, np.zeros(count)],
        (np.r_[g, g], np.r_[gradient, np.full(count, weight)], np.block([[jacobian, gives], [jacobian, -gives]])),
        (np.r_[limits[0], -unlimited], np.r_[unlimited, limits[1]]),
        box=(np.r_[box[0], np.zeros(count)], np.r_[box[1], np.full(count, np.inf)]),
    )
    return None if found is None else (found[0][:n], found[1][: len(g)] + found[1][len(g) :], found[2][:n])
