"""From the bottoms that a search found to local optima: IPOPT's last digits, and never a worse design."""

from dataclasses import replace

import numpy as np

from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.landscape import FEASIBLE, MET
from plough_opt.design.last_digits import with_last_digits
from plough_opt.design.program import Program

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
    near = with_last_digits(program, p, start)
    if near is not None and np.max(np.abs(near.y - start)) < _BESIDE and near.f <= most:
        return near
    begins = as_it_is(program, p, start)
    for box, exact in ((1.0, False), (_BESIDE, True), (_RIPPLE, True)):
        point = program.solve(start, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if point.status in _STALLED and _violation(program, p, point.y)[1] <= MET:
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
    return as_it_is(program, p, np.clip(program.solve_relaxed(start, p).y[: len(start)], 0.0, 1.0))


def solved_again(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum of a program that has been built anew since: the same one, with its new digits."""
    most = _most(program, p, point.y)
    for box, exact in ((_BESIDE, False), (_RIPPLE, False), (_RIPPLE, True)):
        again = program.solve(point.y, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if again.solved and np.max(np.abs(again.y - point.y)) < box and again.f <= most:
            return again
    return replace(point, f=_violation(program, p, point.y)[0])


def to_the_last_digit(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum with the last digits of its derivatives, where these can be had; else as it is."""
    if point.status in ("Solve_Succeeded", AS_FOUND):
        return point
    again = program.solve(point.y, p, SolveOptions(near=True, exact=False), _BESIDE)
    inside = np.max(np.abs(again.y - point.y)) < _BESIDE
    return again if again.solved and inside and again.f <= _most(program, p, point.y) else point


def as_it_is(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as a point without multipliers, solved if it meets all requirements."""
    f, violation = _violation(program, p, y)
    count = len(program.owner)
    return Point(bool(violation <= MET), AS_FOUND, y, f, np.zeros(count), np.zeros(len(y)), 0)


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
