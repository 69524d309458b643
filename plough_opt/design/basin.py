"""The optimum of the basin in which a guess lies."""

from __future__ import annotations

import numpy as np

from plough_opt.design.derivatives import build_surely
from plough_opt.design.effort import effort_of
from plough_opt.design.exploring import Explorer
from plough_opt.design.infeasible import feasible_from, infeasible, is_feasible
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.landscape import Landscape, Seen
from plough_opt.design.polishing import as_it_is, polished
from plough_opt.design.program import Program
from plough_opt.design.sampling import sample_of
from plough_opt.design.tolerance import judgement

# Part of the range by which a descent that stays in its basin moves at once, and how often.
_BOX, _MOST_BOXES = 0.05, 60
# Positions on the straight way to an optimum at which a barrier is looked for, and the rise of the merit that is one.
_BETWEEN, _BARRIER = 40, 1e-3


def near_optimum(program: Program, landscape: Landscape, p: Vector, start: Vector) -> Point:
    """Return the optimum of the guess's basin; from an infeasible guess, of that of the nearest feasible design.

    Args:
        program: the design's program.
        landscape: of the program.
        p: parameters.
        start: the guess, scaled.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
    """
    if not landscape.vectorised:
        program.build(p, starts=[start])
        point = program.solve(start, p)
        return point if point.solved else _from_least_violation(program, p, start)
    begin = landscape(start[None])
    if not begin.feasible[0]:
        begin = landscape.nearest_feasible(start)
    if not begin.feasible[0]:
        begin = _far_feasible(program, landscape, p, start)
    y = begin.points[0]
    end = landscape.descend(y).points[0]
    y = end if _downhill(landscape, y, end) else _descended_in_steps(landscape, y)
    build_surely(program, p, [y])
    return polished(program, p, y)


def _descended_in_steps(landscape: Landscape, y: Vector) -> Vector:
    """Return where descents lead that go no further than a part of the range at once."""
    for _ in range(_MOST_BOXES):
        end = landscape.descend(y, np.maximum(y - _BOX, 0.0), np.minimum(y + _BOX, 1.0)).points[0]
        moved, y = np.max(np.abs(end - y)), end
        if moved < 0.9 * _BOX:
            break
    return y


def _far_feasible(program: Program, landscape: Landscape, p: Vector, start: Vector) -> Seen:
    """Return a feasible design near a start beside which there is none."""
    seen = sample_of(landscape)
    if np.any(seen.feasible):
        others = seen.points[seen.feasible]
        return landscape.nearest_feasible(start, others[np.argmin(np.sum((others - start) ** 2, axis=1))])
    every = tuple(range(len(start)))
    effort = effort_of("auto", len(start), program.population.runs, landscape.vectorised)
    explored = Explorer(landscape, start, every, judgement(landscape, "bare"), lambda _stage, _part: None).explored(
        effort
    )
    if len(explored.bottoms.f) and explored.bottoms.feasible[0]:
        return explored.bottoms.of([0])
    return landscape(feasible_from(program, landscape, p, explored, start)[None])


def first_optimum(program: Program, p: Vector) -> Point:
    """Return the optimum of the basin of a program's guess."""
    program.prepare(p)
    return near_optimum(program, Landscape(program, p), p, program.start())


def _downhill(landscape: Landscape, start: Vector, end: Vector) -> bool:
    """Return whether no barrier lies on the straight way between two designs, nor the end above the start."""
    parts = np.linspace(0.0, 1.0, _BETWEEN)[:, None]
    merit = landscape(start + parts * (end - start)).merit
    rise = np.max(merit - np.minimum.accumulate(merit))
    return bool(rise <= _BARRIER * abs(merit[0]))


def _from_least_violation(program: Program, p: Vector, start: Vector) -> Point:
    """Return the optimum from the nearest design that meets the requirements."""
    n = len(start)
    loose = program.solve_relaxed(start, p)
    if not is_feasible(loose):
        raise infeasible(program, loose)
    y = np.clip(loose.y[:n], 0.0, 1.0)
    point = program.solve(y, p)
    return point if point.solved else as_it_is(program, p, y)
