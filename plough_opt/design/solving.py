"""From a program to its certified optimum: local solve, global search, refinement, report."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, NotConverged
from plough_opt.design.basin import near_optimum
from plough_opt.design.curvature import flat_directions, minimum_from
from plough_opt.design.derivatives import build_surely, with_sure_derivatives
from plough_opt.design.effort import Search, effort_of, searched
from plough_opt.design.exploring import Explored, Explorer, Progress
from plough_opt.design.infeasible import feasible_from
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.landscape import Landscape, Seen
from plough_opt.design.local_optimum import LocalOptimum
from plough_opt.design.optimum import Optimum
from plough_opt.design.polishing import AS_FOUND, as_it_is, polished, solved_again, to_the_last_digit
from plough_opt.design.program import Program
from plough_opt.design.record import Search as SearchRecord
from plough_opt.design.reporting import (
    as_made,
    broken_by,
    designs_without_value,
    gap_of,
    local_optimum,
    names_of,
    scenes_at,
    unconfirmed,
    warnings_at,
)
from plough_opt.design.rounding import rounded
from plough_opt.design.sensitivity import Sensitivities
from plough_opt.design.tolerance import Judge, judgement, ranked
from plough_opt.design.verify import TightEvaluation

_REFINEMENTS = 4
# Of the gap before, to which half as many steps more bring it at least, by a method of order 8.
_FALLS = 0.5
_FINER = 1.5
# Above this gap a design by a method with its own setting carries a warning.
_COARSE = 1e-6
# Basins that are optimised, the best first.
_MOST_POLISHED = 8
# The same where each takes longer, of more variables than so many, with the part by which their judged values may be
# above the best.
_MOST_OF_MANY, _FEW_VARIABLES, _CAN_WIN = 3, 3, 0.15
# Two scaled optima nearer than this are one.
_SAME = 1e-4
# Positions along each variable alone through the lowest optimum, with finer steps, by what part another is lower, how
# many of these are optimised, and how often.
_ALONG, _FINER_LINES, _LOWER, _MOST_BETTER, _MOST_LINES = 256, 2.0, 1e-8, 2, 4


def solve_program(
    program: Program, p: Vector, how: tuple[Search, Judge, int], progress: Progress, started: float
) -> Optimum:
    """Return the best optimum of a program; ``how`` is search, judge and seed of `Design.solve`."""
    search, judge, seed = how
    variables = program.declared.variables
    vary = searched(search, variables)
    progress("preparing the model", 0.0)
    program.prepare(p, any_guess=bool(vary))
    landscape = Landscape(program, p)
    # What the algebra gives for a design is not searched.
    given = {variable.number for variable in landscape.settled}
    vary = tuple(k for k in vary if k not in given) or vary
    explored: Explored | None = None
    if vary:
        explored, points = _searched(program, landscape, p, how, vary, progress)
    else:
        progress("solving from the guess", 0.0)
        points = [near_optimum(program, landscape, p, program.start())]
    points, missed = _refined(program, p, points, progress)
    progress("checking", 0.0)
    order = ranked(landscape, judge, np.array([point.y for point in points]))
    points, unsure = with_sure_derivatives(program, p, [points[k] for k in order])
    missed += unsure
    scenes = [scenes_at(program, point, p) for point in points]
    names = names_of(program, [[scene for _, scene in own] for own in scenes])
    last = to_the_last_digit(program, p, points[0])
    points[0] = minimum_from(program, p, last, landscape.lower_from if landscape.vectorised else None)
    optima = [local_optimum(program, p, point, name, landscape) for point, name in zip(points, names, strict=True)]
    directions = [] if points[0].status == AS_FOUND else flat_directions(program, p, points[0])
    best = optima[0]
    return Optimum(
        **{name: getattr(best, name) for name in LocalOptimum.__dataclass_fields__},
        status="unconfirmed" if points[0].status == AS_FOUND else "not unique" if directions else "solved",
        over=program.over,
        flat_directions=tuple(_in_units(program, points[0], d) for d in directions),
        local_optima=tuple(optima),
        search=_record(program, landscape, (search, seed), vary, explored, len(points), time.perf_counter() - started),
        seconds=time.perf_counter() - started,
        warnings=(
            *missed,
            *designs_without_value(explored),
            *unconfirmed(points[0]),
            *as_made(best),
            *warnings_at(program, points[0], p, scenes[0]),
        ),
        evaluate=partial(_evaluated, program, p, program.values(points[0].y)),
        sensitivities=Sensitivities(program, p, points[0]),
        rounder=partial(
            rounded, program, p, judge, points[0], best, partial(_report, program, p), partial(_evaluated, program, p)
        ),
    )


def _searched(
    program: Program,
    landscape: Landscape,
    p: Vector,
    how: tuple[Search, Judge, int],
    vary: tuple[int, ...],
    progress: Progress,
) -> tuple[Explored, list[Point]]:
    """Return what a search over some variables saw, and the local optima of the basins that can be best.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
        NotConverged: no design has a value, or IPOPT made none of those that were found an optimum.
    """
    search, judge, seed = how
    start = program.start()
    effort = effort_of(search, len(vary), program.population.runs, landscape.vectorised)
    judged = judgement(landscape, judge)
    explored = Explorer(landscape, start, vary, judged, progress, seed).explored(effort)
    if not len(explored.bottoms.f) and explored.least is None:
        raise NotConverged(
            f"none of {landscape.tried} designs between the bounds has a value: tighten the bounds, or shorten the"
            " duration",
            "no value",
        )
    bottoms, points = explored.bottoms, []
    if np.any(bottoms.feasible) or not program.declared.requirements:
        points = _optima(program, landscape, p, bottoms, (judged, len(vary), effort.rounds), progress)
    if not points and program.declared.requirements:
        progress("looking for a design that meets the requirements", 0.0)
        y = feasible_from(program, landscape, p, explored, start)
        bottoms = landscape.descend(y) if landscape.vectorised else landscape(y[None])
        points = _optima(program, landscape, p, bottoms, (judged, len(vary), effort.rounds), progress)
        if not points and (met := as_it_is(program, p, y)).solved:
            points = [met]
    if not points:
        place = program.declared.describe(program.values(bottoms.points[0]))
        raise NotConverged(
            f"no optimum was found; the best design that was seen is {place}: check the bounds, or search more"
            " thoroughly",
            "no optimum",
        )
    return explored, points


def _optima(
    program: Program,
    landscape: Landscape,
    p: Vector,
    bottoms: Seen,
    size: tuple[Callable[[Vector], Vector], int, int],
    progress: Progress,
) -> list[Point]:
    """Return the local optima of the bottoms that can be best.

    Args:
        program: the design's program.
        landscape: in which the bottoms lie.
        p: parameters.
        bottoms: of basins.
        size: what they are judged by, number of variables, and rounds of the search.
        progress: called with what is being done.
    """
    judged, variables, rounds = size
    program.scale_by(float(bottoms.f[np.argmin(bottoms.merit)]) * landscape.objective_scale)
    chosen = _that_can_win(judged(bottoms.points), variables <= _FEW_VARIABLES, rounds)
    build_surely(program, p, list(bottoms.points[chosen]))
    points: list[Point] = []
    for number, k in enumerate(chosen):
        progress(f"optimising basin {number + 1} of {len(chosen)}", number / len(chosen))
        point = polished(program, p, bottoms.points[k])
        if point.solved and not any(np.max(np.abs(point.y - other.y)) < _SAME for other in points):
            points.append(point)
    return _along_each_variable(program, landscape, p, points) if points and landscape.vectorised else points


def _that_can_win(judged: Vector, few: bool, rounds: int) -> list[int]:
    """Return which bottoms to optimise: the best, and of many variables only those that are little worse."""
    order = np.argsort(judged, kind="stable")
    if few:
        return [int(k) for k in order[: _MOST_POLISHED * rounds]]
    limit = judged[order[0]] + _CAN_WIN * abs(judged[order[0]])
    return [int(k) for k in order if judged[k] <= limit][: _MOST_OF_MANY * rounds]


def _along_each_variable(program: Program, landscape: Landscape, p: Vector, points: list[Point]) -> list[Point]:
    """Return optima with those to which steps of one variable alone lead from the lowest: ripples of a flat valley."""
    points = list(points)
    for _ in range(_MOST_LINES):
        best = min(points, key=lambda point: point.f)
        n = len(best.y)
        lines = np.repeat(best.y[None], _ALONG * n, axis=0)
        for k in range(n):
            lines[k * _ALONG : (k + 1) * _ALONG, k] = np.linspace(0.0, 1.0, _ALONG)
        seen, own = landscape(lines, finer=_FINER_LINES), landscape(best.y[None], finer=_FINER_LINES)
        merit = np.where(seen.feasible, seen.merit, np.inf).reshape(n, -1)
        lowest = [k * _ALONG + int(np.argmin(row)) for k, row in enumerate(merit)]
        level = own.merit[0] - _LOWER * abs(own.merit[0])
        better = [
            k for k in sorted(lowest, key=lambda k: float(seen.merit[k])) if seen.merit[k] < level and seen.feasible[k]
        ]
        found = [polished(program, p, landscape.descend(lines[k]).points[0]) for k in better[:_MOST_BETTER]]
        lower = [point for point in found if point.solved and point.f < best.f - _LOWER * abs(best.f)]
        if not lower:
            return points
        points.append(min(lower, key=lambda point: point.f))
    return points


def _record(
    program: Program,
    landscape: Landscape,
    asked: tuple[Search, int],
    vary: tuple[int, ...],
    explored: Explored | None,
    polished: int,
    seconds: float,
) -> SearchRecord:
    """Return the record of a search, or of none."""
    own = [k for k, v in enumerate(program.declared.variables) if not v.auxiliary]
    n = len(program.declared.variables)
    sample = explored.sample if explored else Seen(np.empty((0, n)), np.empty(0), np.empty(0))
    return SearchRecord(
        asked=str(asked[0]),
        variables=tuple(program.declared.variables[k].name for k in vary),
        designs=landscape.tried if explored else 0,
        one_by_one=not landscape.vectorised,
        basins=len(explored.bottoms.f) if explored else 1,
        polished=polished,
        followed=explored.followed if explored else 0,
        reached=explored.reached if explored else 0,
        seed=asked[1],
        seconds=seconds,
        values=program.values_of(sample.points)[:, own],
        objective=sample.f * landscape.objective_scale,
        violation=sample.violation,
    )


def _refined(
    program: Program, p: Vector, points: list[Point], progress: Progress
) -> tuple[list[Point], tuple[str, ...]]:
    """Take more integration steps until objective and limits are those of the tight integration."""
    wanted = program.wanted_error
    if wanted is None:
        gap = max(gap_of(program, p, point) for point in points)
        coarse = f"the optimiser's objective is off by a relative {gap:.1e}: take more steps or a tighter tolerance"
        return points, (coarse,) if gap > _COARSE else ()
    last, begin = math.inf, program.built.refinement
    for refinement in range(1, _REFINEMENTS + 1):
        errors = [_error_of_steps(program, p, point) for point in points]
        if max(errors) <= wanted:
            return points, ()
        if max(errors) > _FALLS * last:  # a motion too sensitive for any number of steps
            break
        last = max(errors)
        progress(f"refining: error {max(errors):.1e}", refinement / _REFINEMENTS)
        program.build(p, begin * _FINER**refinement, [point.y for point in points])
        for k, error in enumerate(errors):
            if error > wanted:
                points[k] = solved_again(program, p, points[k])
    error = max(_error_of_steps(program, p, point) for point in points)
    if error <= wanted:
        return points, ()
    return points, (
        f"the wanted relative error {wanted:.1e} of objective and limits was not reached: it is {error:.1e}",
    )


def _error_of_steps(program: Program, p: Vector, point: Point) -> float:
    """Return the relative gap of the objective, or of a limit that the tight run breaks by more."""
    return max(gap_of(program, p, point), broken_by(program, p, point))


def _report(program: Program, p: Vector, point: Point) -> tuple[LocalOptimum, tuple[str, ...]]:
    """Return the report on a point, named as if it were alone, and its warnings."""
    scenes = scenes_at(program, point, p)
    (name,) = names_of(program, [[scene for _, scene in scenes]])
    return local_optimum(program, p, point, name, Landscape(program, p)), warnings_at(program, point, p, scenes)


def _in_units(program: Program, point: Point, direction: Vector) -> dict[str, float]:
    """Return a scaled direction as changes of the variables, for a step of 1 % of the range of the one that leads."""
    step = 0.01 * direction / np.max(np.abs(direction))
    change = program.values(np.clip(point.y + step, 0.0, 1.0)) - program.values(point.y)
    return {v.name: float(x) for v, x in zip(program.declared.variables, change, strict=True)}


def _evaluated(program: Program, p: Vector, values: Vector, expression: ca.MX) -> Vector:
    """Return an expression of the design's symbols at numbers, its runs integrated tightly."""
    if isinstance(expression, ca.SX):
        raise InputError("an SX expression cannot be of this design, whose variables are MX")
    symbols = program.declared.symbols()
    expression = ca.MX(expression)
    if strangers := program.declared.strangers(expression):
        raise InputError(f"the expression holds symbols that are not of this design: {', '.join(strangers)}")
    (value,) = TightEvaluation([expression], symbols, beside=program.exact).values([*values, *p])
    return np.squeeze(value)
