"""The local optimum in whose basin the guess lies: what `search="near"` returns."""

import numpy as np

from plough_opt.design.derivatives import with_sure_steps
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

# Boxes that keep a descent in its basin. Widths are fractions of the range.
_BOX = 0.05  # half width of the first box
_BOX_FACTOR = 3.0  # The box shrinks by this factor if it contains a barrier.
_SMALLEST_BOX = 2e-4
_MOST_BOXES = 80

# The search for a feasible design nearer to an infeasible guess than the one found so far.
_NEARER_ROUNDS = 5
_NEARER_SAMPLE = 128  # designs sampled in each round
_LESS_VIOLATION = 0.2  # An infeasible sample is a start if its violation is below this fraction of the guess's.
_NEARER = 0.999  # A result counts only if it reduces the distance at least by this factor.

# Positions on the straight line to an optimum at which a barrier is looked for.
_FEWEST_POSITIONS = 40
_POSITIONS_ACROSS = 256  # on a line across the whole range
_BARRIER = 1e-3  # A rise of the merit by this fraction is a barrier.


def near_optimum(landscape: Landscape, start: Vector) -> tuple[Program, Point]:
    """Return the optimum of the guess's basin or, if the guess is infeasible, of the nearest feasible design's basin.

    It is returned with the program that has enough integration steps for it.

    Args:
        landscape: of the program.
        start: the scaled guess.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
    """
    program, p = landscape.program, landscape.p
    if not landscape.vectorised:
        program = program.with_steps(p, starts=[start])
        guess, point = point_as_found(program, p, start), program.solve(start, p)
        if point.solved and not (guess.solved and point.f > guess.f):
            return program, point
        return program, (polished if guess.solved else from_least_violation)(program, p, start)
    begin = landscape(start[None])
    if not begin.feasible[0]:
        begin = _nearest_feasible(landscape, begin)
    if not begin.feasible[0]:
        begin = _far_feasible(landscape, start)
    y = begin.points[0]
    end = descend(landscape, y).points[0]
    y = end if _is_downhill(landscape, y, end) else _descended_in_boxes(landscape, y)
    program = with_sure_steps(program, p, [y])
    return program, polished(program, p, y)


def _descended_in_boxes(landscape: Landscape, y: Vector) -> Vector:
    """Return the end of successive descents that are confined to small boxes and cross no barrier."""
    box = _BOX
    for _ in range(_MOST_BOXES):
        end = descend(landscape, y, (np.maximum(y - box, 0.0), np.minimum(y + box, 1.0))).points[0]
        moved = np.max(np.abs(end - y))
        if _is_downhill(landscape, y, end):
            y = end
            if moved < 0.9 * box:
                break
            box = min(_BOX, _BOX_FACTOR * box)
        elif min(box, moved) < _SMALLEST_BOX:
            break
        else:
            box = min(box, moved) / _BOX_FACTOR
    return y


def _nearest_feasible(landscape: Landscape, start: Evaluations) -> Evaluations:
    """Return the feasible design nearest to a start, as local searches and samples nearer to the start find it."""
    (guess,), rng = start.points, np.random.default_rng(SEED)
    found = nearest_feasible(landscape, guess)
    for _ in range(_NEARER_ROUNDS if found.feasible[0] else 0):
        distance = np.linalg.norm(found.points[0] - guess)
        directions = rng.standard_normal((_NEARER_SAMPLE, len(guess)))
        lengths = distance * rng.random(_NEARER_SAMPLE) ** (1.0 / len(guess)) / np.linalg.norm(directions, axis=1)
        sampled = landscape(np.clip(guess + lengths[:, None] * directions, 0.0, 1.0))
        away = np.linalg.norm(sampled.points - found.points, axis=1) > 0.5 * distance
        less = sampled.violation < _LESS_VIOLATION * start.violation
        promising = sampled.select(sampled.feasible | (away & less))
        if not len(promising.f):
            break
        # Feasible ones first, the nearest of them, then by violation.
        order = np.lexsort(
            (np.linalg.norm(promising.points - guess, axis=1), np.where(promising.feasible, 0.0, promising.violation))
        )
        again = nearest_feasible(landscape, guess, promising.points[order[0]])
        if not (again.feasible[0] and np.linalg.norm(again.points[0] - guess) < _NEARER * distance):
            break
        found = again
    return found


def _far_feasible(landscape: Landscape, start: Vector) -> Evaluations:
    """Return a feasible design for a start near which the local search found none."""
    sampled = evaluated_sample(landscape)
    if np.any(sampled.feasible):
        others = sampled.points[sampled.feasible]
        return nearest_feasible(landscape, start, others[np.argmin(np.sum((others - start) ** 2, axis=1))])
    every = tuple(range(len(start)))
    effort = effort_of("auto", len(start), landscape.program.population.runs, landscape.vectorised)
    explored = Explorer(landscape, start, every, ranking_criterion(landscape, "bare"), effort).explore()
    if len(explored.minima.f) and explored.minima.feasible[0]:
        return explored.minima.select([0])
    return landscape(feasible_from(landscape, explored, start)[None])


def first_optimum(program: Program, p: Vector) -> tuple[Program, Point]:
    """Return the optimum of the basin in which a program's guess lies, as `near_optimum`."""
    return near_optimum(Landscape(program.at(p), p), program.start())


def _is_downhill(landscape: Landscape, start: Vector, end: Vector) -> bool:
    """Return whether the straight line from a start to an end crosses no barrier and does not end above the start."""
    count = max(_FEWEST_POSITIONS, int(_POSITIONS_ACROSS * np.max(np.abs(end - start))))
    fractions = np.linspace(0.0, 1.0, count)[:, None]
    merit = landscape(start + fractions * (end - start)).merit
    rise = np.max(merit - np.minimum.accumulate(merit))
    return bool(rise <= _BARRIER * abs(merit[0]))
