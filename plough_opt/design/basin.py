"""The optimum of the basin in which a guess lies."""

import numpy as np

from plough_opt.design.derivatives import build_surely
from plough_opt.design.descents import descend, nearest_feasible
from plough_opt.design.effort import effort_of
from plough_opt.design.exploring import Explorer
from plough_opt.design.infeasible import feasible_from, from_least_violation
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.landscape import Evaluations, Landscape
from plough_opt.design.polishing import point_as_found, polished
from plough_opt.design.program import Program
from plough_opt.design.sampling import SEED, evaluated_sample
from plough_opt.design.tolerance import ranking_criterion

# Part of the range by which a descent that stays in its basin moves at once, or a third of it and so on where a barrier
# lies within that; the least of these, and how often.
_BOX, _NARROWER, _NARROWEST, _MOST_BOXES = 0.05, 3.0, 2e-4, 80
# Designs nearer to an infeasible guess than the feasible one that was found: how many are looked at, and how often. One
# that is feasible, or away from that one and lacks less than this part of what the guess lacks, leads to a nearer one
# perhaps, by at least this factor.
_LOOKED, _LOOKS, _LESS, _NEARER = 128, 5, 0.2, 0.999
# Positions on the straight way to an optimum at which a barrier is looked for, at least and on a way across the whole
# range, and the rise of the merit that is one.
_BETWEEN, _ACROSS, _BARRIER = 40, 256, 1e-3


def near_optimum(landscape: Landscape, start: Vector) -> Point:
    """Return the optimum of the guess's basin; from an infeasible guess, of that of the nearest feasible design.

    Args:
        landscape: of the program.
        start: the guess, scaled.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
    """
    program, p = landscape.program, landscape.p
    if not landscape.vectorised:
        program.build(p, starts=[start])
        begins, point = point_as_found(program, p, start), program.solve(start, p)
        if point.solved and not (begins.solved and point.f > begins.f):
            return point
        return polished(program, p, start) if begins.solved else from_least_violation(program, p, start)
    begin = landscape(start[None])
    if not begin.feasible[0]:
        begin = _nearest_feasible(landscape, begin)
    if not begin.feasible[0]:
        begin = _far_feasible(landscape, start)
    y = begin.points[0]
    end = descend(landscape, y).points[0]
    y = end if _downhill(landscape, y, end) else _descended_in_steps(landscape, y)
    build_surely(program, p, [y])
    return polished(program, p, y)


def _descended_in_steps(landscape: Landscape, y: Vector) -> Vector:
    """Return where descents lead that go no further than a part of the range at once, and across no barrier."""
    box = _BOX
    for _ in range(_MOST_BOXES):
        end = descend(landscape, y, (np.maximum(y - box, 0.0), np.minimum(y + box, 1.0))).points[0]
        moved = np.max(np.abs(end - y))
        if _downhill(landscape, y, end):
            y = end
            if moved < 0.9 * box:
                break
            box = min(_BOX, _NARROWER * box)
        elif min(box, moved) < _NARROWEST:
            break
        else:
            box = min(box, moved) / _NARROWER
    return y


def _nearest_feasible(landscape: Landscape, start: Evaluations) -> Evaluations:
    """Return the feasible design nearest to one, as far as local searches and looks between the two find it."""
    (guess,), rng = start.points, np.random.default_rng(SEED)
    found = nearest_feasible(landscape, guess)
    for _ in range(_LOOKS if found.feasible[0] else 0):
        distance = np.linalg.norm(found.points[0] - guess)
        directions = rng.standard_normal((_LOOKED, len(guess)))
        lengths = distance * rng.random(_LOOKED) ** (1.0 / len(guess)) / np.linalg.norm(directions, axis=1)
        seen = landscape(np.clip(guess + lengths[:, None] * directions, 0.0, 1.0))
        away = np.linalg.norm(seen.points - found.points, axis=1) > 0.5 * distance
        less = seen.violation < _LESS * start.violation
        some = seen.select(seen.feasible | (away & less))
        if not len(some.f):
            break
        nearest = np.lexsort(
            (np.linalg.norm(some.points - guess, axis=1), np.where(some.feasible, 0.0, some.violation))
        )
        again = nearest_feasible(landscape, guess, some.points[nearest[0]])
        if not (again.feasible[0] and np.linalg.norm(again.points[0] - guess) < _NEARER * distance):
            break
        found = again
    return found


def _far_feasible(landscape: Landscape, start: Vector) -> Evaluations:
    """Return a feasible design near a start beside which there is none."""
    seen = evaluated_sample(landscape)
    if np.any(seen.feasible):
        others = seen.points[seen.feasible]
        return nearest_feasible(landscape, start, others[np.argmin(np.sum((others - start) ** 2, axis=1))])
    every = tuple(range(len(start)))
    effort = effort_of("auto", len(start), landscape.program.population.runs, landscape.vectorised)
    explored = Explorer(landscape, start, every, ranking_criterion(landscape, "bare"), effort).explore()
    if len(explored.minima.f) and explored.minima.feasible[0]:
        return explored.minima.select([0])
    return landscape(feasible_from(landscape, explored, start)[None])


def first_optimum(program: Program, p: Vector) -> Point:
    """Return the optimum of the basin of a program's guess."""
    program.prepare(p)
    return near_optimum(Landscape(program, p), program.start())


def _downhill(landscape: Landscape, start: Vector, end: Vector) -> bool:
    """Return whether no barrier lies on the straight way between two designs, nor the end above the start."""
    count = max(_BETWEEN, int(_ACROSS * np.max(np.abs(end - start))))
    parts = np.linspace(0.0, 1.0, count)[:, None]
    merit = landscape(start + parts * (end - start)).merit
    rise = np.max(merit - np.minimum.accumulate(merit))
    return bool(rise <= _BARRIER * abs(merit[0]))
