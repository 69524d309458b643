"""From the basin minima of a search to optima: full accuracy, curvature, and never a worse design than the start."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.landscape import FEASIBLE, FEASIBLE_ANSWER
from plough_opt.design.optimality import (
    PULLS,
    free_directions,
    made_convex,
    optimum_step,
    reduced_curvatures,
    residual,
    symmetric,
    without_rounding,
)
from plough_opt.design.program import Program

# Largest scaled residual of the first-order conditions at an optimum.
_STATIONARY: Final = 1e-10
# Most steps, and the longest one: a start further from the optimum is not nearly optimal.
_MOST_STEPS: Final = 5
_LONGEST_STEP: Final = 0.02
# Each step must reduce the residual by at least this factor; otherwise the steps do not converge.
_REDUCTION: Final = 0.5
# Scaled step of the difference quotients: between a run's rounding (about 1e-13) and the narrowest ripples (1e-2).
_DIFFERENCE: Final = 2e-4
# Factor on a sample's number of integration steps for these runs.
_FINER: Final = 2.0
# If difference quotients deviate from the exact slopes by this fraction of the largest, there is a kink in between, as
# in the RMS of an amplitude at 0.
_KINK: Final = 0.05
# The first step needs several rounds, because the curvature depends on the multipliers that the step yields.
_ROUNDS: Final = 3
# Scaled margin kept to each limit, so that rounding does not violate it.
_MARGIN: Final = 1e-11
# A limit is active below this scaled margin.
_ACTIVE_MARGIN: Final = 1e-8
# Slopes of length 1 are dependent if their matrix has a singular value below this.
_DEPENDENT: Final = 1e-7


def polished_by_quadratic_programs(program: Program, p: Vector, start: Vector) -> Point | None:
    """Return the optimum near a design by sequential quadratic programs, or None if a few short steps do not reach it.

    Curvatures need only be rough, so they come from difference quotients of runs that are integrated together. Two or
    three evaluations of exact slopes then suffice. An interior-point method needs as many again to let its barrier
    vanish.

    Args:
        program: the design's program, built.
        p: parameters.
        start: scaled variables, nearly optimal.
    """
    derivatives = _difference_quotients(program, p, start) if program.population.vectorised else None
    if derivatives is None:
        return None
    slopes, hessians = derivatives
    margin = np.where(program.low < program.high, _MARGIN, 0.0)
    y, lam_g, before = start, np.zeros(len(program.low)), np.inf
    for number in range(_MOST_STEPS):
        f, g, gradient, jacobian = (np.asarray(result) for result in program.nlp.slopes(y, p))
        g, gradient = g.ravel(), gradient.ravel()
        if not all(np.all(np.isfinite(part)) for part in (f, g, gradient, jacobian)):
            return None
        exact = np.vstack([gradient, jacobian])
        if not number and np.max(np.abs(exact - slopes)) > _KINK * max(1.0, float(np.max(np.abs(exact)))):
            return None
        at, limits = (g, gradient, jacobian), (program.low + margin, program.high - margin)
        for _ in range(1 if number else _ROUNDS):
            curvature = made_convex(hessians[0] + np.tensordot(lam_g, hessians[1:], 1))
            found = optimum_step(curvature, y, at, limits)
            if found is None:
                return None
            step, lam_g, lam_y = found
        point = Point(True, "Solve_Succeeded", y, float(f.item()), lam_g, without_rounding(y, lam_y), number)
        remaining = residual(point, at, (program.low, program.high))
        if remaining <= _STATIONARY:
            if np.all((margin == 0.0) | ((program.low <= g) & (g <= program.high))):
                return point if _multipliers_unique(point.y, at, limits) else None
        elif remaining > _REDUCTION * before or np.max(np.abs(step)) > _LONGEST_STEP:
            return None
        y, before = np.clip(y + step, 0.0, 1.0), remaining
    return None


def _multipliers_unique(y: Vector, at: tuple[Vector, Vector, Vector], limits: tuple[Vector, Vector]) -> bool:
    """Return whether the slopes of the active limits are independent; otherwise their multipliers are ambiguous."""
    (g, _, jacobian), (low, high) = at, limits
    margins = np.concatenate([np.minimum(g - low, high - g), np.minimum(y, 1.0 - y)])
    active = np.vstack([jacobian, np.eye(len(y))])[margins < _ACTIVE_MARGIN]
    lengths = np.maximum(np.linalg.norm(active, axis=1, keepdims=True), np.finfo(float).tiny)
    return not len(active) or int(np.linalg.matrix_rank(active / lengths, _DEPENDENT)) == len(active)


def _difference_quotients(program: Program, p: Vector, y: Vector) -> tuple[Vector, Vector] | None:
    """Return a gradient (a row) and a Hessian for the objective and each requirement row, by difference quotients.

    None if a neighbouring design cannot be evaluated.
    """
    n = len(y)
    steps = np.diag(np.where(y > 0.5, -_DIFFERENCE, _DIFFERENCE))
    pairs = list(itertools.combinations_with_replacement(range(n), 2))
    points = np.vstack([y, y + steps, *(y + steps[i] + steps[j] for i, j in pairs)])
    with np.errstate(all="ignore"):
        f, g = program.population(points, p, finer=_FINER, together=len(points))
    scales = np.array(program.scales)[np.array(program.owner, dtype=int)]
    values = np.column_stack([f / program.objective_scale, g / scales])
    if not np.all(np.isfinite(values)):
        return None
    hessians = np.empty((values.shape[1], n, n))
    for (i, j), value in zip(pairs, values[n + 1 :], strict=True):
        second = (value - values[1 + i] - values[1 + j] + values[0]) / (steps[i, i] * steps[j, j])
        hessians[:, i, j] = hessians[:, j, i] = second
    signed = np.diag(steps)
    slopes = (values[1 : n + 1] - values[0]).T / signed - 0.5 * np.einsum("kii->ki", hessians) * signed
    return slopes, hessians


# An optimum this close to a start, as a fraction of the range, belongs to the start's basin.
_NEAR = 0.05
# The same for the optimum of a ripple.
_RIPPLE = 0.005
# A polished design may lie above its start by this fraction of the objective, which is IPOPT's tolerance, and higher by
# this weight times the start's violation.
_NOT_WORSE = 1e-8
_VIOLATION_WEIGHT = 100.0
# Scaled margin below which a limit counts as active.
_ACTIVE = 1e-7
# IPOPT stops with these near an optimum if the objective is rough, as on a needle.
_STALLED = ("Search_Direction_Becomes_Too_Small", "Maximum_Iterations_Exceeded")


AS_FOUND = "taken as found"
"""Status of a design that IPOPT did not confirm as an optimum."""


def polished(program: Program, p: Vector, start: Vector) -> Point:
    """Return the local optimum near a basin minimum of a search, or the start itself if no better design lies near."""
    highest = _highest_accepted(program, p, start)
    near = polished_by_quadratic_programs(program, p, start)
    near_enough = near is not None and np.max(np.abs(near.y - start)) < _NEAR and near.f <= highest
    if near is not None and near_enough and not program.refuses(near.y, p):
        return near
    as_found = point_as_found(program, p, start)
    for box, exact in ((1.0, False), (_NEAR, True), (_RIPPLE, True)):
        point = program.solve(start, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if point.status in _STALLED and _violation(program, p, point.y)[1] <= FEASIBLE_ANSWER:
            point = _stalled(program, p, point)
        if point.solved and point.f <= highest:
            return point
    point = program.solve(start, p)
    if point.solved and point.f <= highest:
        return point
    if as_found.solved or not program.declared.requirements:
        return as_found
    # The search's rough runs may just have met a limit that these runs violate.
    return point_as_found(program, p, program.solve_relaxed(start, p)[0].y)


def solved_again(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum solved again after its program was rebuilt with other steps; the same basin, updated digits."""
    highest = _highest_accepted(program, p, point.y)
    for box, exact in ((_NEAR, False), (_RIPPLE, False), (_RIPPLE, True)):
        again = program.solve(point.y, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if again.solved and again.f <= highest:
            return again
    return replace(point, f=_violation(program, p, point.y)[0])


def converged_tightly(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum solved to the full tolerance if IPOPT stopped before that, else the same point."""
    if point.status in ("Solve_Succeeded", AS_FOUND):
        return point
    # A box around the point could cut off a long flat valley, and its edge would pass for the optimum.
    again = program.solve(point.y, p, SolveOptions(near=True, exact=False))
    return again if again.solved and again.f <= _highest_accepted(program, p, point.y) else point


def point_as_found(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as an unconfirmed point without multipliers; it is solved if it is feasible."""
    f, violation = _violation(program, p, y)
    count = len(program.owner)
    return Point(bool(violation <= FEASIBLE_ANSWER), AS_FOUND, y, f, np.zeros(count), np.zeros(len(y)), 0)


def _stalled(program: Program, p: Vector, point: Point) -> Point:
    """Return a feasible point at which IPOPT stalled as an unconfirmed one.

    Its multipliers have not converged: those of limits that the design does not touch are noise.
    """
    g = np.asarray(program.nlp.values(point.y, p)[1]).ravel()
    touches = np.minimum(g - program.low, program.high - g) <= _ACTIVE
    at_bound = np.minimum(point.y, 1.0 - point.y) <= _ACTIVE
    lam_g, lam_y = np.where(touches, point.lam_g, 0.0), np.where(at_bound, point.lam_y, 0.0)
    return replace(point, solved=True, status=AS_FOUND, lam_g=lam_g, lam_y=lam_y)


def _highest_accepted(program: Program, p: Vector, start: Vector) -> float:
    """Return the largest scaled objective at which an optimum counts as no worse than its start."""
    f, violation = _violation(program, p, start)
    return f + _NOT_WORSE * abs(f) + _VIOLATION_WEIGHT * violation if violation <= FEASIBLE else np.inf


def _violation(program: Program, p: Vector, y: Vector) -> tuple[float, float]:
    """Return the scaled objective, and the largest scaled violation; infinite if the design cannot be evaluated."""
    f, g = (np.asarray(result).ravel() for result in program.nlp.values(y, p))
    worst = np.max(np.maximum(program.low - g, g - program.high), initial=0.0)
    valid = np.all(np.isfinite(f)) and np.all(np.isfinite(g)) and not program.refuses(y, p)
    return float(f[0]), float(worst) if valid else np.inf


# A direction may be flat if its curvature is below this fraction of the largest.
_FLAT_CURVATURE = 1e-7
# It is flat if the objective changes by less than this fraction.
_FLAT_OBJECTIVE = 1e-9
# Scaled step from a point along a suspicious direction.
_ASIDE = 0.02


def flat_directions(program: Program, p: Vector, at: Point) -> list[Vector]:
    """Return the scaled directions along which designs as good as the optimum lie.

    Candidates are directions without curvature in the reduced Hessian. A candidate is confirmed by a step along it,
    after which the other variables are optimised again.
    """
    curvatures, directions = at.curvatures or _reduced_curvatures(program, p, at)
    flat = np.flatnonzero(np.abs(curvatures) < _FLAT_CURVATURE)
    return [directions[:, k] for k in flat if _confirmed(program, p, at, directions[:, k])]


def minimum_from(
    program: Program, p: Vector, at: Point, downhill: Callable[[Vector, Vector], Vector | None] | None = None
) -> Point:
    """Return a stationary point with its curvatures or, if it is a maximum or a saddle, a lower optimum near it.

    IPOPT accepts any stationary point that it starts from. The reduced Hessian shows whether it is a minimum.

    Args:
        program: the design's program.
        p: parameters.
        at: the stationary point.
        downhill: (the point, a design near it) -> the end of a descent from that design if it is lower than the
            point, else None. Without this function IPOPT starts from the design itself.
    """
    # At the top of a hill each descent may move a single variable.
    for _ in range(len(at.y) + 1):
        curvatures, directions = known = _reduced_curvatures(program, p, at)
        if not curvatures.size or curvatures[0] >= -_FLAT_CURVATURE:
            return replace(at, curvatures=known)
        step = _ASIDE * directions[:, 0] / np.max(np.abs(directions[:, 0]))
        starts = [np.clip(at.y + sign * step, 0.0, 1.0) for sign in (1.0, -1.0)]
        if downhill is not None:
            starts = [lower for start in starts if (lower := downhill(at.y, start)) is not None]
        points = [program.solve(start, p, SolveOptions(near=True, exact=False, enough=True)) for start in starts]
        found = [point for point in points if point.solved and point.f < at.f]
        if not found:
            return replace(at, curvatures=known)
        at = min(found, key=lambda point: point.f)
    return at


def _reduced_curvatures(program: Program, p: Vector, at: Point) -> tuple[Vector, Vector]:
    """Return the curvatures along the active limits, relative to the largest and ascending, and their directions.

    The directions are columns.
    """
    values, jacobian = program.built.solver.requirements(at.y, p)
    active = (values - program.low < _ACTIVE) | (program.high - values < _ACTIVE)
    # A bound without a multiplier does not stop a move away from it.
    bounds = ((at.y < _ACTIVE) | (at.y > 1.0 - _ACTIVE)) & (np.abs(at.lam_y) > PULLS)
    free = free_directions(np.vstack([jacobian[active], np.eye(len(at.y))[bounds]]))
    if not free.shape[1]:
        return np.empty(0), free
    hessian = symmetric(np.asarray(program.built.rough.hess_lag(at.y, p, 1.0, at.lam_g)))
    if not np.all(np.isfinite(hessian)):
        # Second derivatives may overflow if the motion is so damped that it forgets its start at once.
        return np.empty(0), free[:, :0]
    return reduced_curvatures(hessian, free)


def _confirmed(program: Program, p: Vector, at: Point, direction: Vector) -> bool:
    """Return whether the objective stays the same after a step along a direction."""
    leading = int(np.argmax(np.abs(direction)))
    for sign in (1.0, -1.0):
        moved = at.y + sign * _ASIDE * direction / abs(direction[leading])
        if np.all((moved >= 0.0) & (moved <= 1.0)):
            there = program.solve(moved, p, SolveOptions(near=True), fixed=[leading])
            return there.solved and abs(there.f - at.f) <= _FLAT_OBJECTIVE * max(1.0, abs(at.f))
    return False
