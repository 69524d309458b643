"""Second-order conditions: optima that are not unique, and stationary points that are not optima."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.optimality import PULLS, free_directions, reduced_curvatures, symmetric
from plough_opt.design.program import Program

# A curvature this far below the largest is suspected flat, and a change of the objective this small confirms it.
_FLAT_CURVATURE = 1e-7
_FLAT_OBJECTIVE = 1e-9
_ACTIVE = 1e-7
_STEP = 0.02
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
        step = _STEP * directions[:, 0] / np.max(np.abs(directions[:, 0]))
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
    hessian = symmetric(np.asarray(program.rough.hess_lag(at.y, p, 1.0, at.lam_g)))
    if not np.all(np.isfinite(hessian)):
        # Of a motion that forgets its start at once, second derivatives may be beyond floating point.
        return np.empty(0), free[:, :0]
    return reduced_curvatures(hessian, free)


def _confirmed(program: Program, p: Vector, at: Point, direction: Vector) -> bool:
    leading = int(np.argmax(np.abs(direction)))
    for sign in (1.0, -1.0):
        moved = at.y + sign * _STEP * direction / abs(direction[leading])
        if np.all((moved >= 0.0) & (moved <= 1.0)):
            there = program.solve_with_fixed(moved, p, leading)
            return there.solved and abs(there.f - at.f) <= _FLAT_OBJECTIVE * max(1.0, abs(at.f))
    return False
