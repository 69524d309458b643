"""The solve of a program: search, refinement, certificate and report."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial

import numpy as np

from plough_opt.core.compiler import compiler_problem
from plough_opt.core.errors import NotConverged
from plough_opt.design.confirmation import flat_directions, minimum_from, with_enough_steps
from plough_opt.design.model.ipopt import Point, Vector
from plough_opt.design.model.program import Program, with_sure_steps
from plough_opt.design.result.catalogue import rounded
from plough_opt.design.result.optimum import Optimum
from plough_opt.design.result.optimum import Search as SearchRecord
from plough_opt.design.result.reporting import remarks, reports
from plough_opt.design.result.sensitivity import Solved
from plough_opt.design.search.descent import descend
from plough_opt.design.search.effort import Effort, Search, TimeLimit, effort_of, searched
from plough_opt.design.search.explore import Explored, Progress, explore
from plough_opt.design.search.feasible import feasible_designs, from_least_violation, nearest_feasible
from plough_opt.design.search.landscape import Evaluations, Landscape, concatenated, only_falls
from plough_opt.design.search.polish import AS_FOUND, converged_tightly, point_as_found, polished

# Longest move of a variable in a descent that stays in the basin of its start. A rise by this fraction is a barrier
# between basins, sought at so many designs on the way.
_NEAR = 0.05
_BARRIER = 1e-3
_ACROSS = 256

_LEFT_OUT = (
    "the search left out {}: there may be a better design; search='thorough', a number of designs or a time such as"
    " '5 min' has no such limit"
)


@dataclass(frozen=True)
class Request:
    """The arguments of a solve: see `plough_opt.Design.solve`.

    Attributes:
        p: values of all parameters.
        search: extent of the search.
        seed: seed of the samples.
        progress: called with what is being done and the fraction done.
        started: time at which the solve began [s].
        limit: of the processor time.
    """

    p: Vector
    search: Search
    seed: int
    progress: Progress
    started: float
    limit: TimeLimit


def solve_program(program: Program, request: Request) -> Optimum:
    """Return the best optimum of a program.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
        NotConverged: no design has a value, or IPOPT reached no optimum from any design that was found.
    """
    p, progress, limit = request.p, request.progress, request.limit
    vary = searched(request.search, program.declared.variables)
    progress("preparing the model", 0.0)
    program = program.at(p, any_guess=bool(vary))
    landscape = Landscape(program, p)
    if vary:
        effort = effort_of(request.search, len(vary), program.population.runs, landscape.vectorised)
        landscape, explored = _explored(landscape, vary, effort, request)
        program, points = _searched(landscape, explored, 6 * effort.rounds, request)
    else:
        progress("solving from the guess", 0.0)
        explored = None
        program, point = near_optimum(landscape, program.start())
        points = [point]
    points.sort(key=lambda point: point.f)
    program, points, accuracy_warnings = with_enough_steps(program, p, points, progress, limit)
    progress("checking", 0.0)
    best = minimum_from(program, p, converged_tightly(program, p, points[0]))
    optima, warnings = reports(program, landscape, [best, *points[1:]])
    confirmed = best.status != AS_FOUND
    directions = flat_directions(program, p, best) if confirmed else []
    record = _record(landscape, request, vary, explored, len(points))
    return Optimum(
        **optima[0].__dict__,
        status="unconfirmed" if not confirmed else "not unique" if directions else "solved",
        flat_directions=tuple(_in_units(program, best, d) for d in directions),
        local_optima=optima,
        search=record,
        seconds=time.perf_counter() - request.started,
        warnings=(
            *limit.warnings(_LEFT_OUT),
            *accuracy_warnings,
            *remarks(record.objective, best, optima[0], program.ipopt),
            *warnings,
        ),
        solved=Solved(program, p, best, rounder=partial(rounded, request.seed, optima[0].objective)),
    )


def _explored(
    landscape: Landscape, vary: tuple[int, ...], effort: Effort, request: Request
) -> tuple[Landscape, Explored]:
    """Search over some variables; return the landscape with scales that hold around its best design, and the result."""
    program, p, known = landscape.program, request.p, None
    # A limit of 0 on exp(100 x) loses some four decades of its scale each time.
    for _ in range(8):
        explored = explore(landscape, program.start(), vary, effort, seed=request.seed, known=known,
                           progress=request.progress, limit=request.limit)  # fmt: skip
        known = explored.ends.points
        local = program.with_scales_around(known[0], p) if len(known) else program
        if local is program:
            break
        program, landscape = local, Landscape(local, p)
    return landscape, explored


def _searched(landscape: Landscape, explored: Explored, most: int, request: Request) -> tuple[Program, list[Point]]:
    """Return the local optima that can be best, at most so many, with their program."""
    program, p, limit, progress, seed = landscape.program, request.p, request.limit, request.progress, request.seed
    start, required = program.start(), bool(program.declared.requirements)
    ends, sample, points = explored.ends, explored.sample, list[Point]()
    if not len(ends.f):
        raise NotConverged(
            f"none of {landscape.designs_tried} designs between the bounds has a value, with"
            f" {program.declared.ranges()}: tighten the bounds, or shorten the duration",
            "no value",
        )
    # The objective's scale is at least this part of its median over the sample: a scale of 0 would magnify rounding.
    least_scale = 1e-4 * float(np.nanmedian(np.abs(sample.f)))
    if np.any(ends.feasible) or not required:
        program, points = _optima(landscape, ends, least_scale, most, request)
    if not points and required:
        progress("looking for a design that meets the requirements", 0.0)
        known = concatenated([ends, sample])
        met = feasible_designs(landscape, start, known, seed=seed, progress=progress, limit=limit)
        ends = concatenated([*(descend(landscape, y) for y in met.points), met])
        program, points = _optima(landscape, ends, least_scale, most, request)
        points = points or [point for y in met.points[:1] if (point := point_as_found(program, p, y)).solved]
    if not points:
        best_seen = program.declared.describe(program.values(ends.points[np.argmin(ends.key)]))
        raise NotConverged(
            f"no optimum was found; the best design that was tried is {best_seen}: check the bounds, or search more"
            " thoroughly",
            "no optimum",
        )
    return program, points


def _optima(
    landscape: Landscape, ends: Evaluations, least_scale: float, most: int, request: Request
) -> tuple[Program, list[Point]]:
    """Return the local optima of those ends that can be best, and the program with enough integration steps for them.

    Args:
        landscape: that was searched.
        ends: of descents.
        least_scale: smallest scale of the objective, in units of the merit.
        most: number of ends to optimise.
        request: of the solve.
    """
    ends = ends.distinct(0.02)
    # Ends that are worse by a larger part cannot win.
    limit = ends.key[0] + 0.3 * abs(ends.key[0])
    ends = ends.select(ends.key <= limit).select(slice(most))
    scale = max(abs(float(ends.f[0])), least_scale) * landscape.objective_scale
    program = with_sure_steps(landscape.program.with_objective_scale(scale), request.p, list(ends.points))
    points: list[Point] = []
    for number, y in enumerate(ends.points):
        if points and request.limit.passed(f"the optima of {len(ends.f) - number} basins"):
            break
        request.progress(f"optimising basin {number + 1} of {len(ends.f)}", number / len(ends.f))
        point = polished(program, request.p, y, request.limit)
        # Optima count as the same if no scaled variable differs by this much.
        if point.solved and not any(np.max(np.abs(point.y - other.y)) < 1e-4 for other in points):
            points.append(point)
    return program, points


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
    end = descend(landscape, start)
    if not end.feasible[0] or not only_falls(landscape, start[None], end.points[0], _BARRIER, _ACROSS)[0]:
        end = descend(landscape, nearest_feasible(landscape, start), longest=_NEAR)
    y = end.points[0]
    program = with_sure_steps(program, p, [y])
    return program, polished(program, p, y)


def _record(
    landscape: Landscape, request: Request, vary: tuple[int, ...], explored: Explored | None, polished: int
) -> SearchRecord:
    """Return the record of a search, empty without one; ``polished`` is the number of optima."""
    program = landscape.program
    sample = explored.sample if explored else Evaluations(np.empty((0, landscape.dimensions)), np.empty(0), np.empty(0))
    return SearchRecord(
        asked=str(request.search),
        variables=tuple(program.declared.variables[k].name for k in vary),
        designs=landscape.designs_tried if explored else 0,
        one_by_one=not landscape.vectorised,
        basins=len(explored.ends.f) if explored else 1,
        polished=polished,
        followed=explored.followed if explored else 0,
        reached=explored.reached if explored else 0,
        seed=request.seed,
        seconds=time.perf_counter() - request.started,
        values=program.values_of(sample.points),
        objective=sample.f * landscape.objective_scale,
        violation=sample.violation,
        slow="" if program.population.compiled or not explored else compiler_problem(),
    )


def _in_units(program: Program, point: Point, direction: Vector) -> dict[str, float]:
    """Return a scaled direction as changes of the variables, the largest of them 1 % of its variable's range."""
    step = 0.01 * direction / np.max(np.abs(direction))
    # At a bound only one sense of the direction stays inside.
    ends = [np.clip(point.y + sign * step, 0.0, 1.0) for sign in (1.0, -1.0)]
    change = program.values(max(ends, key=lambda end: float(np.sum(np.abs(end - point.y))))) - program.values(point.y)
    return program.declared.named(change)
