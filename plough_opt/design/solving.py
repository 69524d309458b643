"""The solve of a program: search, refinement, certificate and report."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from plough_opt.core.compiler import compiler_problem
from plough_opt.core.errors import NotConverged
from plough_opt.design.confirmation import (
    converged_tightly,
    flat_directions,
    minimum_from,
    with_enough_steps,
)
from plough_opt.design.model.ipopt import Point, Vector
from plough_opt.design.model.program import Program, with_sure_steps
from plough_opt.design.result.catalogue import rounded
from plough_opt.design.result.optimum import Optimum
from plough_opt.design.result.optimum import Search as SearchRecord
from plough_opt.design.result.reporting import remarks, reports
from plough_opt.design.result.sensitivity import Solved
from plough_opt.design.search.effort import CAN_WIN, FEW_VARIABLES, Search, TimeLimit, effort_of, searched
from plough_opt.design.search.explore import Explored, Explorer, Progress
from plough_opt.design.search.landscape import Evaluations, Landscape
from plough_opt.design.search.local import AS_FOUND, descend, point_as_found, polished
from plough_opt.design.search.near import feasible_from, near_optimum


class _Optima:
    """Which basins IPOPT optimises, and which of the optima count."""

    most_of_few: Final = 8  # basins for each round of the search, with few variables
    most_of_many: Final = 3  # with more
    # The objective's scale is at least this part of its median over the sample: a scale of 0 would magnify rounding.
    least_scale: Final = 1e-4
    same: Final = 1e-4  # Optima count as the same if no scaled variable differs by this much.


_LEFT_OUT = (
    "the search left out {}: there may be a better design; search='thorough', a number of designs or a time such as"
    " '5 min' has no such limit"
)


@dataclass(frozen=True)
class Known:
    """Results of an earlier search: scaled designs that are nearly optimal, a row each, and its record."""

    points: Vector
    search: SearchRecord


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
        known: results of an earlier search, from which to optimise instead of searching; None to search.
    """

    p: Vector
    search: Search
    seed: int
    progress: Progress
    started: float
    limit: TimeLimit
    known: Known | None = None


def solve_program(program: Program, request: Request) -> Optimum:
    """Return the best optimum of a program.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
        NotConverged: no design has a value, or IPOPT reached no optimum from any design that was found.
    """
    vary = searched(request.search, program.declared.variables)
    request.progress("preparing the model", 0.0)
    return _Solve(program.at(request.p, any_guess=bool(vary)), request).solved(vary)


class _Solve:
    """A solve of a scaled program, which gets its integration steps on the way."""

    def __init__(self, program: Program, request: Request) -> None:
        self._program, self._request, self._p, self._progress = program, request, request.p, request.progress
        self._landscape = Landscape(program, request.p)

    def solved(self, vary: tuple[int, ...]) -> Optimum:
        """Return the best optimum.

        Args:
            vary: numbers of the variables to search over; if empty, the optimum of the guess's basin is returned.
        """
        p, landscape, limit = self._p, self._landscape, self._request.limit
        # Variables that follow from the others by algebra need no search.
        given = {variable.number for variable in landscape.eliminated}
        vary = tuple(k for k in vary if k not in given) or vary
        explored: Explored | None = None
        if (known := self._request.known) is not None:
            points = self._from_known(known.points)
        elif vary:
            explored, points = self._search(vary)
        else:
            self._progress("solving from the guess", 0.0)
            self._program, point = near_optimum(landscape, self._program.start())
            points = [point]
        order = np.argsort([point.f for point in points], kind="stable")
        program, points, accuracy_warnings = with_enough_steps(
            self._program, p, [points[k] for k in order], self._progress, limit
        )
        self._progress("checking", 0.0)
        best = converged_tightly(program, p, points[0])
        best = minimum_from(program, p, best)
        optima, warnings = reports(program, landscape, [best, *points[1:]])
        confirmed = best.status != AS_FOUND
        record = known.search if known else self._record(vary, explored, len(points))
        directions = flat_directions(program, p, best) if confirmed else []
        rounder = partial(rounded, self._request.seed, optima[0].objective)
        return Optimum(
            **optima[0].__dict__,
            status="unconfirmed" if not confirmed else "not unique" if directions else "solved",
            flat_directions=tuple(_in_units(program, best, d) for d in directions),
            local_optima=optima,
            search=record,
            seconds=time.perf_counter() - self._request.started,
            warnings=(
                *limit.warnings(_LEFT_OUT),
                *accuracy_warnings,
                *remarks(record.objective, best, optima[0], program.ipopt),
                *warnings,
            ),
            solved=Solved(program, p, best, rounder=rounder),
        )

    def _search(self, vary: tuple[int, ...]) -> tuple[Explored, list[Point]]:
        """Search over some variables; return the record and the local optima of the basins that can be best."""
        program, landscape, request = self._program, self._landscape, self._request
        start, required = program.start(), bool(program.declared.requirements)
        effort = effort_of(request.search, len(vary), program.population.runs, landscape.vectorised)
        known = landscape, start, vary, effort, self._progress, request.seed
        explored = Explorer(*known, limit=request.limit).explore()
        if not len(explored.minima.f) and not len(explored.least_violating.f):
            raise NotConverged(
                f"none of {landscape.designs_tried} designs between the bounds has a value, with"
                f" {program.declared.ranges()}: tighten the bounds, or shorten the duration",
                "no value",
            )
        size = len(vary), effort.rounds, _Optima.least_scale * float(np.nanmedian(np.abs(explored.sample.f)))
        minima, points = explored.minima, []
        if np.any(minima.feasible) or not required:
            points = self._optima(minima, *size)
        if not points and required:
            self._progress("looking for a design that meets the requirements", 0.0)
            y = feasible_from(landscape, explored, start, request.limit)
            minima = descend(landscape, y)
            points = self._optima(minima, *size)
            if not points and (met := point_as_found(self._program, self._p, y)).solved:
                points = [met]
        if not points:
            best_seen = program.declared.describe(program.values(minima.points[0]))
            raise NotConverged(
                f"no optimum was found; the best design that was tried is {best_seen}: check the bounds, or search more"
                " thoroughly",
                "no optimum",
            )
        return explored, points

    def _from_known(self, known: Vector) -> list[Point]:
        """Return the local optima near designs that are known to be nearly optimal."""
        minima = self._landscape(known)
        points = self._optima(minima, 0, len(known), _Optima.least_scale * float(np.nanmedian(np.abs(minima.f))))
        if not points:
            raise NotConverged("no optimum lies near the designs that are known to be nearly optimal", "no optimum")
        return points

    def _optima(self, minima: Evaluations, variables: int, rounds: int, least_scale: float) -> list[Point]:
        """Return the local optima of those basins that can be best.

        Args:
            minima: the best design of each basin.
            variables: number of variables that were searched.
            rounds: number of rounds of the search; the more rounds, the more basins are optimised.
            least_scale: smallest scale of the objective, in units of the merit.
        """
        landscape, p = self._landscape, self._p
        lowest = abs(float(minima.f[np.argmin(minima.merit)]))
        program = self._program.with_objective_scale(max(lowest, least_scale) * landscape.objective_scale)
        chosen = _basins_that_can_win(minima.merit, variables <= FEW_VARIABLES, rounds)
        program = self._program = with_sure_steps(program, p, list(minima.points[chosen]))
        points: list[Point] = []
        for number, k in enumerate(chosen):
            if points and self._request.limit.passed(f"the optima of {len(chosen) - number} basins"):
                break
            self._progress(f"optimising basin {number + 1} of {len(chosen)}", number / len(chosen))
            point = polished(program, p, minima.points[k], self._request.limit)
            if point.solved and not any(np.max(np.abs(point.y - other.y)) < _Optima.same for other in points):
                points.append(point)
        return points

    def _record(self, vary: tuple[int, ...], explored: Explored | None, polished: int) -> SearchRecord:
        """Return the record of a search, empty without one.

        Args:
            vary: numbers of the variables that were searched.
            explored: result of the search, or None.
            polished: number of basins that IPOPT optimised.
        """
        program, landscape, request = self._program, self._landscape, self._request
        variables = program.declared.variables
        sample = explored.sample if explored else Evaluations.none(len(variables))
        return SearchRecord(
            asked=str(request.search),
            variables=tuple(variables[k].name for k in vary),
            designs=landscape.designs_tried if explored else 0,
            one_by_one=not landscape.vectorised,
            basins=len(explored.minima.f) if explored else 1,
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


def _basins_that_can_win(criterion: Vector, few_variables: bool, rounds: int) -> list[int]:
    """Return the numbers of the basins to optimise, best first."""
    order = np.argsort(criterion, kind="stable")
    if few_variables:
        return [int(k) for k in order[: _Optima.most_of_few * rounds]]
    limit = criterion[order[0]] + CAN_WIN * abs(criterion[order[0]])
    return [int(k) for k in order if criterion[k] <= limit][: _Optima.most_of_many * rounds]


def _in_units(program: Program, point: Point, direction: Vector) -> dict[str, float]:
    """Return a scaled direction as changes of the variables, the largest of them 1 % of its variable's range."""
    step = 0.01 * direction / np.max(np.abs(direction))
    # At a bound only one sense of the direction stays inside.
    ends = [np.clip(point.y + sign * step, 0.0, 1.0) for sign in (1.0, -1.0)]
    change = program.values(max(ends, key=lambda end: float(np.sum(np.abs(end - point.y))))) - program.values(point.y)
    return program.declared.named(change)
