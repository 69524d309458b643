"""From the bottoms that a search found to certified optima: last digits, curvature, and never a worse design."""

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


def polished_by_quadratic_programs(program: Program, p: Vector, start: Vector) -> Point | None:
    """Return the optimum beside a design by quadratic programs, or None where none is reached in a few short steps.

    Curvatures, which need only be roughly right, come from differences of runs side by side, so that two or three
    evaluations of exact slopes do, where an interior-point method takes as many again for its barrier to vanish.

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


# How far from a start, in parts of the range, an optimum may lie that is the start's own, and that of a ripple.
_BESIDE, _RIPPLE = 0.05, 0.005
# Part of the objective by which a polished design may be above its start: where the optimiser stops;
# and by how much more for each part of a limit by which the start breaks it.
_NOT_WORSE, _FOR_VIOLATION = 1e-8, 100.0
# IPOPT stops with these beside an optimum where the objective is rough, as a needle's is.
_STALLED = ("Search_Direction_Becomes_Too_Small", "Maximum_Iterations_Exceeded")


AS_FOUND = "taken as found"
"""Status of a design that the optimiser did not confirm as an optimum."""


def polished(program: Program, p: Vector, start: Vector) -> Point:
    """Return the local optimum of a search's bottom: the start as it is, where no better one lies beside it."""
    most = _most(program, p, start)
    near = polished_by_quadratic_programs(program, p, start)
    if near is not None and np.max(np.abs(near.y - start)) < _BESIDE and near.f <= most:
        return near
    begins = point_as_found(program, p, start)
    for box, exact in ((1.0, False), (_BESIDE, True), (_RIPPLE, True)):
        point = program.solve(start, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if point.status in _STALLED and _violation(program, p, point.y)[1] <= FEASIBLE_ANSWER:
            point = replace(point, solved=True, status=AS_FOUND)
        beside = box == 1.0 or np.max(np.abs(point.y - start)) < box
        if point.solved and beside and point.f <= most:
            return point
    point = program.solve(start, p)
    if point.solved and point.f <= most:
        return point
    if begins.solved or not program.declared.requirements:
        return begins
    # The search's rougher runs may have kept a limit by a hair which these do not.
    return point_as_found(program, p, program.solve_relaxed(start, p)[0].y)


def solved_again(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum of a program that has been built anew since: the same one, with its new digits."""
    most = _most(program, p, point.y)
    for box, exact in ((_BESIDE, False), (_RIPPLE, False), (_RIPPLE, True)):
        again = program.solve(point.y, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if again.solved and np.max(np.abs(again.y - point.y)) < box and again.f <= most:
            return again
    return replace(point, f=_violation(program, p, point.y)[0])


def converged_tightly(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum with the last digits of its derivatives, where these can be had; else as it is."""
    if point.status in ("Solve_Succeeded", AS_FOUND):
        return point
    again = program.solve(point.y, p, SolveOptions(near=True, exact=False), _BESIDE)
    inside = np.max(np.abs(again.y - point.y)) < _BESIDE
    return again if again.solved and inside and again.f <= _most(program, p, point.y) else point


def point_as_found(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as a point without multipliers, solved if it meets all requirements."""
    f, violation = _violation(program, p, y)
    count = len(program.owner)
    return Point(bool(violation <= FEASIBLE_ANSWER), AS_FOUND, y, f, np.zeros(count), np.zeros(len(y)), 0)


def _most(program: Program, p: Vector, start: Vector) -> float:
    """Return the largest scaled objective of an optimum that is not worse than its start."""
    f, violation = _violation(program, p, start)
    return f + _NOT_WORSE * abs(f) + _FOR_VIOLATION * violation if violation <= FEASIBLE else np.inf


def _violation(program: Program, p: Vector, y: Vector) -> tuple[float, float]:
    """Return the scaled objective, and the largest scaled violation, infinite without a value."""
    f, g = (np.asarray(result).ravel() for result in program.nlp.values(y, p))
    worst = np.max(np.maximum(program.low - g, g - program.high), initial=0.0)
    sound = np.all(np.isfinite(f)) and np.all(np.isfinite(g))
    return float(f[0]), float(worst) if sound else np.inf


# A curvature this far below the largest is suspected flat, and a change of the objective this small confirms it.
_FLAT_CURVATURE = 1e-7
_FLAT_OBJECTIVE = 1e-9
_ACTIVE = 1e-7
_ASIDE = 0.02
_DESCENTS = 3


def flat_directions(program: Program, p: Vector, at: Point) -> list[Vector]:
    """Return scaled directions in which designs as good as the optimum lie.

    The reduced Hessian suspects a direction; moving along it and solving again for the rest confirms it.
    """
    curvatures, directions = at.curvatures or _reduced_curvatures(program, p, at)
    flat = np.flatnonzero(np.abs(curvatures) < _FLAT_CURVATURE)
    return [directions[:, k] for k in flat if _confirmed(program, p, at, directions[:, k])]


def minimum_from(
    program: Program, p: Vector, at: Point, downhill: Callable[[Vector, Vector], Vector | None] | None = None
) -> Point:
    """Return the point itself, or where it leads downhill if it is a hilltop or a saddle, with its curvatures.

    IPOPT accepts any stationary point that it starts on; the reduced Hessian decides.

    Args:
        program: the design's program.
        p: parameters.
        at: the point.
        downhill: (the point, a design beside it) -> a lower design to which that leads, or None; without it the
            optimiser begins beside the point.
    """
    for _ in range(_DESCENTS):
        curvatures, directions = known = _reduced_curvatures(program, p, at)
        if not curvatures.size or curvatures[0] >= -_FLAT_CURVATURE:
            return replace(at, curvatures=known)
        step = _ASIDE * directions[:, 0] / np.max(np.abs(directions[:, 0]))
        starts = [np.clip(at.y + sign * step, 0.0, 1.0) for sign in (1.0, -1.0)]
        if downhill is not None:
            starts = [lower for start in starts if (lower := downhill(at.y, start)) is not None]
        found = [point for start in starts if (point := _beside(program, p, start)).solved and point.f < at.f]
        if not found:
            return replace(at, curvatures=known)
        at = min(found, key=lambda point: point.f)
    return at


def _beside(program: Program, p: Vector, start: Vector) -> Point:
    """Return the local optimum beside a start."""
    return program.solve(start, p, SolveOptions(near=True, exact=False, enough=True))


def _reduced_curvatures(program: Program, p: Vector, at: Point) -> tuple[Vector, Vector]:
    """Return the curvatures, relative to the largest, in ascending order, and their directions as columns."""
    values, jacobian = program.built.solver.requirements(at.y, p)
    touching = (values - program.low < _ACTIVE) | (program.high - values < _ACTIVE)
    # A bound that does not pull leaves the way back from it open.
    bounds = ((at.y < _ACTIVE) | (at.y > 1.0 - _ACTIVE)) & (np.abs(at.lam_y) > PULLS)
    free = free_directions(np.vstack([jacobian[touching], np.eye(len(at.y))[bounds]]))
    if not free.shape[1]:
        return np.empty(0), free
    hessian = symmetric(np.asarray(program.built.rough.hess_lag(at.y, p, 1.0, at.lam_g)))
    if not np.all(np.isfinite(hessian)):
        # Of a motion that forgets its start at once, second derivatives may be beyond floating point.
        return np.empty(0), free[:, :0]
    return reduced_curvatures(hessian, free)


def _confirmed(program: Program, p: Vector, at: Point, direction: Vector) -> bool:
    leading = int(np.argmax(np.abs(direction)))
    for sign in (1.0, -1.0):
        moved = at.y + sign * _ASIDE * direction / abs(direction[leading])
        if np.all((moved >= 0.0) & (moved <= 1.0)):
            there = program.solve(moved, p, SolveOptions(near=True), fixed=leading)
            return there.solved and abs(there.f - at.f) <= _FLAT_OBJECTIVE * max(1.0, abs(at.f))
    return False
