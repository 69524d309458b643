"""From a basin's bottom, as a search found it, to full accuracy by IPOPT with exact derivatives."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.optimality import Zero
from plough_opt.design.model.program import Program
from plough_opt.design.search.effort import TimeLimit
from plough_opt.design.search.landscape import Violation

AS_FOUND = "taken as found"
"""Status of a design that IPOPT did not confirm as an optimum."""


# An optimum this close to a start, as a fraction of the range, belongs to its basin.
_SAME_BASIN: Final = 0.05
_SAME_RIPPLE: Final = 0.005


# IPOPT stops with these near an optimum if the objective is rough, as on a needle.
_STALLED = ("Search_Direction_Becomes_Too_Small", "Maximum_Iterations_Exceeded")


def polished(program: Program, p: Vector, start: Vector, limit: TimeLimit | None = None) -> Point:
    """Return the local optimum near a basin minimum of a search, or the start itself if no better design lies near.

    Once the time is over, a start that meets the requirements is not tried again.
    """
    accepted, as_found = acceptance(program, p, start), cache(lambda: point_as_found(program, p, start))
    for box, exact in ((1.0, False), (_SAME_BASIN, True), (_SAME_RIPPLE, True)):
        point = program.solve(start, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if point.status in _STALLED and point_as_found(program, p, point.y).solved:
            point = _stalled(program, p, point)
        if accepted(point):
            return point
        if limit is not None and as_found().solved and limit.passed("further attempts to confirm an optimum"):
            return as_found()
    point = program.solve(start, p)
    if accepted(point):
        return point
    if as_found().solved or not program.declared.requirements:
        return as_found()
    # The search's rough runs may just have met a limit that these runs violate.
    return point_as_found(program, p, program.solve_relaxed(start, p)[0].y)


def solved_again(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum solved again after its program was rebuilt with other steps; the same basin, updated digits."""
    accepted = acceptance(program, p, point.y)
    for box, exact in ((_SAME_BASIN, False), (_SAME_RIPPLE, False), (_SAME_RIPPLE, True)):
        again = program.solve(point.y, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if accepted(again):
            return again
    return replace(point, f=_values(program, p, point.y)[0])


def converged_tightly(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum solved to the full tolerance if IPOPT stopped before that, else the same point."""
    if point.status in ("Solve_Succeeded", AS_FOUND):
        return point
    # A box around the point could cut off a long flat valley, and its edge would pass for the optimum.
    again = program.solve(point.y, p, SolveOptions(near=True, exact=False))
    return again if acceptance(program, p, point.y)(again) else point


def point_as_found(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as an unconfirmed point without multipliers; it is solved if it is feasible."""
    f, g = _values(program, p, y)
    violation = _violation(program, p, y, f, g)
    count = len(program.owner)
    return Point(bool(violation <= Violation.allowed_in_answer), AS_FOUND, y, f, np.zeros(count), np.zeros(len(y)), 0)


def _stalled(program: Program, p: Vector, point: Point) -> Point:
    """Return a feasible point at which IPOPT stalled as an unconfirmed one.

    Its multipliers have not converged: those of limits that the design does not touch are noise.
    """
    touches = program.margins(_values(program, p, point.y)[1]) <= Zero.margin
    at_bound = np.minimum(point.y, 1.0 - point.y) <= Zero.margin
    lam_g, lam_y = np.where(touches, point.lam_g, 0.0), np.where(at_bound, point.lam_y, 0.0)
    return replace(point, solved=True, status=AS_FOUND, lam_g=lam_g, lam_y=lam_y)


def acceptance(program: Program, p: Vector, start: Vector) -> Callable[[Point], bool]:
    """Return the function that tells whether a point is solved and counts as no worse than its start."""
    f, g = _values(program, p, start)
    # IPOPT's tolerance, of the objective or of its scale if that is larger.
    highest = f + 1e-8 * max(abs(f), 1.0)

    @cache
    def highest_of_all() -> float:
        violation = _violation(program, p, start, f, g)
        return highest + Violation.weight * violation if violation <= Violation.allowed else np.inf

    # Whether the start is valid need be known only if it is lower than the point.
    return lambda found: found.solved and (found.f <= highest or found.f <= highest_of_all())


def _values(program: Program, p: Vector, y: Vector) -> tuple[float, Vector]:
    """Return the scaled objective and requirements of a design."""
    f, g = program.built.nlp.values(y, p)
    return float(f), np.asarray(g).ravel()


def _violation(program: Program, p: Vector, y: Vector, f: float, g: Vector) -> float:
    """Return the largest scaled violation from a design's values; infinite if the design cannot be evaluated."""
    valid = np.isfinite(f) and np.all(np.isfinite(g)) and not program.refuses(y, p)
    return program.violation(g) if valid else np.inf
