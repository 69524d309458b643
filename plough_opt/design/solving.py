"""The solve of a program, or of one over its tolerance box: search, refinement, certificate and report."""

import math
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import casadi as ca
import numpy as np

from plough_opt.core.compiler import compiler_problem
from plough_opt.core.errors import InfeasibleDesign, NotConverged
from plough_opt.core.expressions import Column
from plough_opt.design.certify.confirmation import converged_tightly, flat_directions, minimum_from, with_enough_steps
from plough_opt.design.certify.tolerance import BOX_DESIGNS, Judge, boxes, corners, ranked, ranking_criterion, unit_box
from plough_opt.design.declarations import Declarations, Requirement, Variable
from plough_opt.design.model.ipopt import Point, Vector
from plough_opt.design.model.program import Program, with_sure_steps
from plough_opt.design.model.split import split
from plough_opt.design.result.catalogue import rounded
from plough_opt.design.result.optimum import Optimum
from plough_opt.design.result.optimum import Search as SearchRecord
from plough_opt.design.result.reporting import remarks, reports
from plough_opt.design.result.sensitivity import Solved
from plough_opt.design.search.effort import CAN_WIN, FEW_VARIABLES, Search, TimeLimit, effort_of, searched
from plough_opt.design.search.explore import Explored, Explorer, Progress
from plough_opt.design.search.landscape import FEASIBLE, Evaluations, Landscape
from plough_opt.design.search.local import AS_FOUND, descend, point_as_found, polished
from plough_opt.design.search.near import feasible_from, near_optimum
from plough_opt.design.search.points import evaluated_sample

# Basins that IPOPT optimises in each round of the search: with few variables, and with more.
_MOST_POLISHED_OF_FEW = 8
_MOST_POLISHED_OF_MANY = 3
# The objective's scale is at least this part of its median over the sample: a scale of 0 would magnify rounding.
_LEAST_SCALE = 1e-4
# Optima count as the same if no scaled variable differs by this much.
_SAME_OPTIMUM = 1e-4


@dataclass(frozen=True)
class Request:
    """The arguments of a solve: see `plough_opt.Design.solve`.

    Attributes:
        p: values of all parameters.
        search: extent of the search.
        judge: criterion by which optima are compared.
        seed: seed of the samples.
        progress: called with what is being done and the fraction done.
        started: time at which the solve began [s].
        limit: of the processor time of the search.
    """

    p: Vector
    search: Search
    judge: Judge
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
    vary = searched(request.search, program.declared.variables)
    request.progress("preparing the model", 0.0)
    return _Solve(program.at(request.p, any_guess=bool(vary)), request).solved(vary)


class _Solve:
    """A solve of a scaled program, which gets its integration steps on the way."""

    def __init__(self, program: Program, request: Request) -> None:
        self._program, self._request, self._p, self._progress = program, request, request.p, request.progress
        self._landscape = Landscape(program, request.p)
        self._criterion = ranking_criterion(self._landscape, request.judge)

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
        if vary:
            explored, points = self._search(vary)
        else:
            self._progress("solving from the guess", 0.0)
            self._program, point = near_optimum(landscape, self._program.start())
            points = [point]
        order = ranked(landscape, self._request.judge, np.array([point.y for point in points]))
        program, points, accuracy_warnings = with_enough_steps(
            self._program, p, [points[k] for k in order], self._progress
        )
        self._progress("checking", 0.0)
        best = converged_tightly(program, p, points[0])
        best = minimum_from(program, p, best)
        optima, warnings = reports(program, landscape, [best, *points[1:]])
        confirmed = best.status != AS_FOUND
        directions = flat_directions(program, p, best) if confirmed else []
        rounder = partial(rounded, self._request.judge, self._request.seed, optima[0].objective)
        return Optimum(
            **optima[0].__dict__,
            status="unconfirmed" if not confirmed else "not unique" if directions else "solved",
            over=program.over,
            flat_directions=tuple(_in_units(program, best, d) for d in directions),
            local_optima=optima,
            search=self._record(vary, explored, len(points)),
            seconds=time.perf_counter() - self._request.started,
            warnings=(
                *limit.warnings(),
                *accuracy_warnings,
                *remarks(explored, best, optima[0], program.ipopt),
                *warnings,
            ),
            solved=Solved(program, p, best, rounder=rounder),
        )

    def _search(self, vary: tuple[int, ...]) -> tuple[Explored, list[Point]]:
        """Search over some variables; return the record and the local optima of the basins that can be best."""
        program, landscape, request = self._program, self._landscape, self._request
        start, required = program.start(), bool(program.declared.requirements)
        effort = effort_of(request.search, len(vary), program.population.runs, landscape.vectorised)
        known = landscape, start, vary, self._criterion, effort, self._progress, request.seed
        explored = Explorer(*known, limit=request.limit).explore()
        if not len(explored.minima.f) and explored.least_violating is None:
            raise NotConverged(
                f"none of {landscape.designs_tried} designs between the bounds has a value, with"
                f" {program.declared.ranges()}: tighten the bounds, or shorten the duration",
                "no value",
            )
        size = len(vary), effort.rounds, _LEAST_SCALE * float(np.nanmedian(np.abs(explored.sample.f)))
        minima, points = explored.minima, []
        if np.any(minima.feasible) or not required:
            points = self._optima(minima, *size)
        if not points and required:
            self._progress("looking for a design that meets the requirements", 0.0)
            y = feasible_from(landscape, explored, start)
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
        chosen = _basins_that_can_win(self._criterion(minima.points), variables <= FEW_VARIABLES, rounds)
        program = self._program = with_sure_steps(program, p, list(minima.points[chosen]))
        points: list[Point] = []
        for number, k in enumerate(chosen):
            if points and self._request.limit.passed(f"the optima of {len(chosen) - number} basins"):
                break
            self._progress(f"optimising basin {number + 1} of {len(chosen)}", number / len(chosen))
            point = polished(program, p, minima.points[k])
            if point.solved and not any(np.max(np.abs(point.y - other.y)) < _SAME_OPTIMUM for other in points):
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
        own, none = [k for k, v in enumerate(variables) if not v.auxiliary], np.empty(0)
        sample = explored.sample if explored else Evaluations(np.empty((0, len(variables))), none, none)
        return SearchRecord(
            asked=str(request.search),
            variables=tuple(variables[k].name for k in vary if k in own),
            designs=landscape.designs_tried if explored else 0,
            one_by_one=not landscape.vectorised,
            basins=len(explored.minima.f) if explored else 1,
            polished=polished,
            followed=explored.followed if explored else 0,
            reached=explored.reached if explored else 0,
            seed=request.seed,
            seconds=time.perf_counter() - request.started,
            values=program.values_of(sample.points)[:, own],
            objective=sample.f * landscape.objective_scale,
            violation=sample.violation,
            slow="" if program.population.compiled or not explored else compiler_problem(),
        )


def _basins_that_can_win(criterion: Vector, few_variables: bool, rounds: int) -> list[int]:
    """Return the numbers of the basins to optimise, best first."""
    order = np.argsort(criterion, kind="stable")
    if few_variables:
        return [int(k) for k in order[: _MOST_POLISHED_OF_FEW * rounds]]
    limit = criterion[order[0]] + CAN_WIN * abs(criterion[order[0]])
    return [int(k) for k in order if criterion[k] <= limit][: _MOST_POLISHED_OF_MANY * rounds]


def _in_units(program: Program, point: Point, direction: Vector) -> dict[str, float]:
    """Return a scaled direction as changes of the variables, the largest of them 1 % of its variable's range."""
    step = 0.01 * direction / np.max(np.abs(direction))
    # At a bound only one sense of the direction stays inside.
    ends = [np.clip(point.y + sign * step, 0.0, 1.0) for sign in (1.0, -1.0)]
    change = program.values(max(ends, key=lambda end: float(np.sum(np.abs(end - point.y))))) - program.values(point.y)
    return {v.name: float(x) for v, x in zip(program.declared.variables, change, strict=True) if not v.auxiliary}


Over = Literal["mean", "worst"]
"""Which value of the objective over the tolerance box is minimised: its mean, or the worst."""

WORST = "worst objective\n"
"""Name of the auxiliary variable that bounds the objective of every design in the box; users' names have no line."""

# The requirement that does so; sensitivities call its sides by this name.
_BELOW_WORST: Final = "one of the worst designs within the tolerances\n"
# Most runs of all designs in a box together: they take seconds for a whole solve.
_MOST_RUNS_IN_BOX = 64
# Fewest designs in a box.
_FEWEST_IN_BOX = 8
# Designs whose boxes are sampled to find bounds on the worst objective.
_BOUNDING_SAMPLE = 256
# The lower bound lies below the lowest sampled objective by this many times the sampled range. Bounds that prove too
# narrow are extended by as much.
_BELOW = 2.0
# An optimum within this fraction of the range from the lower bound calls for a lower one.
_AT_THE_BOUND = 1e-6


class ToleranceBoxSolver:
    """Solves a design over its tolerance box; it keeps the last program for further solves."""

    def __init__(self, bare: Program, over: Over) -> None:
        """Take the program of the bare design, and which value of its objective to minimise."""
        self._bare, self._over = bare, over
        # The last program, with the parameters and the bounds of the worst objective it was built for.
        self._built: tuple[tuple[bytes, tuple[float, float]] | None, Program] | None = None

    def solve(self, request: Request) -> Optimum:
        """Return the best optimum."""
        bounds, p = None, request.p
        if self._over == "worst":
            request.progress("sampling tolerances", 0.0)
            bounds = bounds_on_worst(self._bare, p)
        raised = False
        while True:
            try:
                best = solve_program(self._program(p, bounds), request)
            except InfeasibleDesign as error:
                if bounds is None or list(error.conflicts) != [_BELOW_WORST]:
                    raise
                if raised:
                    raise NotConverged(
                        f"every design that was tried has an objective above {bounds[1]:.6g} somewhere within its"
                        " tolerances: narrow the tolerances, or tighten the bounds",
                        "no optimum",
                    ) from None
                # The optimum is higher than the sample suggested.
                reach = max(bounds[1] - bounds[0], error.conflicts[_BELOW_WORST])
                bounds, raised = (bounds[0], bounds[1] + _BELOW * reach), True
                continue
            if bounds is None or best.objective > bounds[0] + _AT_THE_BOUND * (bounds[1] - bounds[0]):
                return best
            # The optimum is lower than the sample suggested: extend the range downwards and solve again.
            bounds = bounds[0] - _BELOW * (bounds[1] - bounds[0]), bounds[1]

    def _program(self, p: Vector, bounds: tuple[float, float] | None) -> Program:
        key = None if bounds is None else (p.tobytes(), bounds)
        if self._built is None or self._built[0] != key:
            # Requirements implied by theories are derived again, from the expressions of every design in the box.
            own = replace(self._bare.declared, requirements=self._bare.own_requirements)
            count = designs_per_box(own)
            over = (
                f"the objective is the {self._over} of {count} designs within the tolerances, all of which meet the"
                " requirements"
            )
            if own.requirements:
                over += f", as do {len(corners(len(own.variables), count))} corners of the box"
            declared = over_box(own, count, bounds)
            self._built = (
                key,
                Program.of(declared, compiled=self._bare.compiled, bare=self._bare, over=over, ipopt=self._bare.ipopt),
            )
        return self._built[1]


def over_box(declared: Declarations, count: int, bounds: tuple[float, float] | None) -> Declarations:
    """Return a design problem over a sample of the tolerance box around the chosen design.

    The sampled designs have their variables within the tolerances, clipped at the bounds. All of them must meet the
    requirements, and so must the corners of the box, or with many variables some of them.

    Args:
        declared: the problem of the bare design.
        count: number of sampled designs, a power of two.
        bounds: of their worst objective, which is minimised; None to minimise their mean.
    """
    symbols = [v.symbol for v in declared.variables]
    expressions = [declared.objective, *(r.expression for r in declared.requirements)]
    found = []
    for position in np.vstack([unit_box(len(symbols))[:count], corners(len(symbols), count)]):
        within: list[Column] = [
            v.within_tolerance(v.symbol, float(part)) for v, part in zip(declared.variables, position, strict=True)
        ]
        found.append(ca.graph_substitute(expressions, symbols, within))
    objectives = ca.vertcat(*(objective for objective, *_ in found[:count]))
    columns = [ca.vertcat(*column) for column in [*zip(*found, strict=True)][1:]]
    everywhere = [replace(r, expression=column) for r, column in zip(declared.requirements, columns, strict=True)]
    if bounds is None:
        mean = ca.sum1(objectives) / objectives.numel()
        return replace(declared, objective=mean, requirements=tuple(everywhere))
    worst = Variable(WORST, ca.MX.sym(WORST), bounds[1], *bounds, "", False, 0.0, auxiliary=True)
    below = Requirement(_BELOW_WORST, objectives - worst.symbol, None, 0.0, "", auxiliary=True)
    return replace(
        declared, variables=(*declared.variables, worst), objective=worst.symbol, requirements=(*everywhere, below)
    )


def designs_per_box(declared: Declarations) -> int:
    """Return the number of designs sampled in a box: fewer if a design has several runs, or runs that take long."""
    parts = split([declared.objective, *(r.expression for r in declared.requirements)], declared.symbols())
    runs = max(1, len(parts.runs))
    if not all(run.integration.structure.stepped for run in parts.runs):
        return _FEWEST_IN_BOX
    return max(_FEWEST_IN_BOX, min(BOX_DESIGNS, 1 << int(math.log2(max(1, _MOST_RUNS_IN_BOX // runs)))))


def bounds_on_worst(program: Program, p: Vector) -> tuple[float, float]:
    """Return bounds on the lowest possible worst objective over a tolerance box, estimated from a sample.

    Args:
        program: of the bare design.
        p: parameters.
    """
    landscape = Landscape(program.at(p, any_guess=True), p)
    sampled = evaluated_sample(landscape, _BOUNDING_SAMPLE if landscape.vectorised else _FEWEST_IN_BOX)
    valid = np.flatnonzero(np.isfinite(sampled.f))
    # All designs in a box are made as they are: no variable is solved for again.
    made = Landscape(landscape.program, p, range(landscape.dimensions))
    inside = made(boxes(program.declared.variables, sampled.points[valid]))
    worst, violation = (part.reshape(-1, BOX_DESIGNS).max(axis=1) for part in (inside.f, inside.violation))
    feasible = np.isfinite(worst) & (violation <= FEASIBLE)
    if np.any(feasible):
        high = float(worst[feasible].min())
    else:
        high = float(np.max(worst[np.isfinite(worst)], initial=float(np.max(sampled.f[valid], initial=1.0))))
    low = float(np.min(sampled.f[valid], initial=high))
    # The range must not be empty, even for a constant objective.
    reach = max(high - low, abs(high), 1e-6)
    return (low - _BELOW * reach) * landscape.objective_scale, (high + reach) * landscape.objective_scale
