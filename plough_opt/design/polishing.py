"""From the bottoms that a search found to local optima: IPOPT's last digits, and never a worse design."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.landscape import MET
from plough_opt.design.program import Program

# How far from a start, in parts of the range, an optimum may lie that is the start's own.
_BESIDE = 0.05
# Part of the objective by which a polished design may be above its start: what the search's rougher runs are off by.
_NOT_WORSE = 1e-5
# IPOPT stops with these beside an optimum where the objective is rough, as a needle's is.
_STALLED = ("Search_Direction_Becomes_Too_Small", "Maximum_Iterations_Exceeded")


AS_FOUND = "taken as found"
"""Status of a design that the optimiser did not confirm as an optimum."""


def polished(program: Program, p: Vector, start: Vector) -> Point:
    """Return the local optimum of a search's bottom: the start as it is, where no better one lies beside it."""
    begins = as_it_is(program, p, start)
    for box, exact in ((1.0, False), (_BESIDE, True)):
        point = program.solve(start, p, box, near=True, exact=exact, enough=True)
        if point.status in _STALLED and _meets(program, p, point.y):
            point = replace(point, solved=True, status=AS_FOUND)
        beside = box == 1.0 or np.max(np.abs(point.y - start)) < box
        if point.solved and beside and _not_worse(point, begins):
            return point
    point = program.solve(start, p)
    if point.solved and _not_worse(point, begins):
        return point
    if begins.solved or not program.declared.requirements:
        return begins
    # The search's rougher runs may have kept a limit by a hair which these do not.
    return as_it_is(program, p, np.clip(program.solve_relaxed(start, p).y[: len(start)], 0.0, 1.0))


def to_the_last_digit(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum with the last digits of its derivatives, where these can be had; else as it is."""
    if point.status in ("Solve_Succeeded", AS_FOUND):
        return point
    again = program.solve(point.y, p, _BESIDE, near=True, exact=False)
    inside = np.max(np.abs(again.y - point.y)) < _BESIDE
    return again if again.solved and inside and _not_worse(again, point) else point


def as_it_is(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as a point without multipliers, solved if it meets all requirements."""
    f, g = (np.asarray(result).ravel() for result in program.nlp.values(y, p))
    meets = bool(np.all(np.isfinite(f)) and _excess(program, g) <= MET)
    return Point(meets, AS_FOUND, y, float(f[0]), np.zeros(len(g)), np.zeros(len(y)), 0)


def _not_worse(point: Point, begins: Point) -> bool:
    return not begins.solved or point.f <= begins.f + _NOT_WORSE * abs(begins.f)


def _meets(program: Program, p: Vector, y: Vector) -> bool:
    return _excess(program, np.asarray(program.nlp.values(y, p)[1]).ravel()) <= MET


def _excess(program: Program, g: Vector) -> float:
    """Return the largest scaled violation, infinite without a value."""
    worst = np.max(np.maximum(program.low - g, g - program.high), initial=0.0)
    return float(worst) if np.all(np.isfinite(g)) else np.inf
