"""The solve of a design over its tolerance box: the mean or the worst of many designs as a workshop makes them.

The worst is solved by cutting sets (Blankenship and Falk 1976, "Infinitely constrained optimization problems"). A
program of the few positions in the box that can be worst is solved. Then the whole box around each of its optima is
evaluated, and positions that turn out worse join the program. An optimum for some positions that all others allow is
an optimum for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import replace
from functools import cache
from typing import Final, Literal

import casadi as ca
import numpy as np

from plough_opt.core.errors import InfeasibleDesign, NotConverged
from plough_opt.core.expressions import Column
from plough_opt.design.confirmation import BoxSample, boxes, corners, unit_box
from plough_opt.design.declarations import Declarations, Requirement, Variable
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.nlp import split
from plough_opt.design.model.program import Program, cached
from plough_opt.design.result.optimum import Optimum
from plough_opt.design.result.sensitivity import Solved
from plough_opt.design.search.explore import silent
from plough_opt.design.search.landscape import FINER, Landscape, Violation, evaluated_sample
from plough_opt.design.solving import Known, Request, solve_program

Over = Literal["mean", "worst"]
"""Which value of the objective over the tolerance box is minimised: its mean, or the worst."""

WORST = "worst objective\n"
"""Name of the auxiliary variable that bounds the objective of every design in the box; users' names have no line."""

# The requirement that does so; sensitivities call its sides by this name.
_BELOW_WORST: Final = "one of the worst designs within the tolerances\n"


class _CuttingSets:
    """Bounds of the worst objective, and which positions join the program."""

    sample: Final = 256  # designs whose boxes are sampled to find bounds
    promising: Final = 8  # the best of them, whose worst positions make the first program
    # The lower bound lies below the lowest sampled objective by this many times the sampled range. Bounds that prove
    # too narrow are extended by as much.
    below: Final = 2.0
    at_bound: Final = 1e-6  # An optimum within this fraction of the range from the lower bound calls for a lower one.
    # A position joins if its scaled objective or violation is worse than the program's own by more than this.
    worse: Final = 1e-10


class ToleranceBoxSolver:
    """Solves a design over its tolerance box; it keeps the last program for further solves."""

    def __init__(self, bare: Program, over: Over) -> None:
        """Take the program of the bare design, and which value of its objective to minimise."""
        self._bare, self._over = bare, over
        # Requirements implied by theories are derived again, from the expressions of every design in the box.
        self._own = replace(bare.declared, requirements=bare.own_requirements)
        # Positions in the unit box, a row each: sampled designs, then corners, at which only requirements must be met.
        n, self._count = len(self._own.variables), designs_per_box(self._own)
        self._unit = np.vstack([unit_box(n)[: self._count], corners(n, self._count)])
        self._every = tuple(range(len(self._unit)))
        # (Parameters, bounds of the worst objective, positions) -> the last program that was built.
        self._built: dict[Hashable, Program] = {}

    def solve(self, request: Request) -> Optimum:
        """Return the best optimum."""
        if self._over == "mean":
            return solve_program(self._program(request.p, None, self._every), request)
        request.progress("sampling tolerances", 0.0)
        bare = self._bare.at(request.p, any_guess=True)
        # All designs in a box are made as they are: no variable is solved for again.
        landscape = Landscape(bare, request.p, range(len(bare.declared.variables)))
        bounds = bounds_on_worst(landscape)
        chosen, raised, asked = self._first_positions(landscape), False, request
        while True:
            try:
                best = solve_program(self._program(request.p, bounds, chosen), request)
            except (InfeasibleDesign, NotConverged) as error:
                conflicts = error.conflicts if isinstance(error, InfeasibleDesign) else {}
                above = list(conflicts) == [_BELOW_WORST]
                if above and not raised:
                    # The optimum is higher than the sample suggested.
                    reach = max(bounds[1] - bounds[0], conflicts[_BELOW_WORST])
                    bounds, raised = (bounds[0], bounds[1] + _CuttingSets.below * reach), True
                elif chosen != self._every:
                    # Reasons are given for all positions.
                    chosen, request = self._every, asked
                elif above:
                    raise NotConverged(
                        f"every design that was tried has an objective above {bounds[1]:.6g} somewhere within its"
                        " tolerances: narrow the tolerances, or tighten the bounds",
                        "no optimum",
                    ) from None
                else:
                    raise
                continue
            if best.objective <= bounds[0] + _CuttingSets.at_bound * (bounds[1] - bounds[0]):
                # The optimum is lower than the sample suggested: extend the range downwards and solve again.
                bounds = bounds[0] - _CuttingSets.below * (bounds[1] - bounds[0]), bounds[1]
            elif chosen == self._every:
                return best
            elif best.status != "solved":
                # Further positions may confirm it, or leave one of many equally good designs.
                chosen, request = self._every, asked
            else:
                known, missing = self._missing(landscape, best, bounds, chosen)
                if not missing:
                    # The others were checked above; what is asked for later is that of the best.
                    known = replace(known, points=known.points[:1])
                    return self._with_whole_box(best, replace(request, known=known, progress=silent), bounds)
                chosen, request = tuple(sorted({*chosen, *missing})), replace(request, known=known)

    def _first_positions(self, landscape: Landscape) -> tuple[int, ...]:
        """Return the positions that are worst for the objective or a requirement in the boxes of promising designs.

        Those are all of them if the runs are integrated one by one.
        """
        if not landscape.vectorised:
            return self._every
        sampled = evaluated_sample(landscape, _CuttingSets.sample)
        best = np.argsort(sampled.merit, kind="stable")[: _CuttingSets.promising]
        points = np.vstack([landscape.program.start()[None], sampled.points[best]])
        f, violation = self._rows(landscape, points)
        return tuple(sorted({*np.argmax(f, axis=1).tolist(), *np.argmax(violation, axis=1).ravel().tolist()}))

    def _rows(self, landscape: Landscape, points: Vector) -> tuple[Vector, Vector]:
        """Return scaled objectives and violations in the boxes around scaled designs.

        Args:
            landscape: of the bare design, without eliminated variables.
            points: the designs, a row each.

        Returns:
            Objectives, -inf at corners and inf where there is none, with a row for each design and a column for each
            position; and the scaled violation of each requirement, negative if it is met, with a further axis.
        """
        with np.errstate(all="ignore"):
            f, g = landscape.rows(boxes(landscape.program.declared.variables, points, self._unit), finer=FINER)
            violation = -landscape.program.least_margins(g)
        shape = len(points), len(self._unit)
        f = np.where(np.isfinite(f), f, np.inf).reshape(shape)
        f[:, self._count :] = -np.inf
        return f, np.where(np.isfinite(violation), violation, np.inf).reshape(*shape, -1)

    def _missing(
        self, landscape: Landscape, best: Optimum, bounds: tuple[float, float], chosen: tuple[int, ...]
    ) -> tuple[Known, set[int]]:
        """Return the optima of a program as starts of the next one, and positions that turn out worse around them.

        Args:
            landscape: of the bare design.
            best: the best optimum for some positions.
            bounds: of the worst objective.
            chosen: the positions.
        """
        assert best.search is not None  # only a loaded optimum has none
        variables = landscape.program.declared.variables
        points = np.array([[v.scaled(one.variables[v.name]) for v in variables] for one in best.local_optima])
        f, violation = self._rows(landscape, points)
        values = np.concatenate([f[:, :, None], violation], axis=2)
        worst, own = np.max(values, axis=1), np.max(values[:, chosen], axis=1)
        missing = set(np.argmax(values, axis=1)[worst > own + _CuttingSets.worse].tolist())
        if not missing:
            made = boxes(variables, points[:1], self._unit)
            missing = {k for k in {*self._every} - {*chosen} if landscape.program.refuses(made[k], landscape.p)}
        heights = (worst[:, 0] * landscape.objective_scale - bounds[0]) / (bounds[1] - bounds[0])
        return Known(np.column_stack([points, np.clip(heights, 0.0, 1.0)]), best.search), missing

    def _with_whole_box(self, best: Optimum, request: Request, bounds: tuple[float, float]) -> Optimum:
        """Return an optimum whose sensitivities and catalogue choices account for all positions."""

        @cache
        def whole() -> Solved:
            again = solve_program(self._program(request.p, bounds, self._every), request)
            assert again.solved is not None  # only a loaded optimum has none
            return again.solved

        own = best.solved
        assert own is not None
        return replace(best, solved=Solved(own.program, own.p, own.point, whole=whole))

    def _program(self, p: Vector, bounds: tuple[float, float] | None, chosen: tuple[int, ...]) -> Program:
        key = None if bounds is None else (p.tobytes(), bounds, chosen)
        return cached(self._built, key, lambda: self._written(bounds, chosen))

    def _written(self, bounds: tuple[float, float] | None, chosen: tuple[int, ...]) -> Program:
        over = (
            f"the objective is the {self._over} of {self._count} designs within the tolerances, all of which meet the"
            " requirements"
        )
        if self._own.requirements:
            over += f", as do {len(self._unit) - self._count} corners of the box"
        bare, objectives = self._bare, sum(k < self._count for k in chosen)
        declared = over_box(self._own, self._unit[list(chosen)], objectives, bounds)
        return Program.of(declared, compiled=bare.compiled, bare=bare, over=over, ipopt=bare.ipopt)


def over_box(declared: Declarations, positions: Vector, count: int, bounds: tuple[float, float] | None) -> Declarations:
    """Return a design problem over positions in the tolerance box around the chosen design.

    The designs there have their variables within the tolerances, clipped at the bounds. All of them must meet the
    requirements.

    Args:
        declared: the problem of the bare design.
        positions: in the unit box, a row each.
        count: number of the first positions whose objectives count.
        bounds: of their worst objective, which is minimised; None to minimise their mean.
    """
    symbols = [v.symbol for v in declared.variables]
    found = []
    for position in positions:
        within: list[Column] = [
            v.within_tolerance(v.symbol, float(part)) for v, part in zip(declared.variables, position, strict=True)
        ]
        found.append(ca.graph_substitute(declared.expressions(), symbols, within))
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
    parts = split(declared.expressions(), declared.symbols())
    runs = max(1, len(parts.runs))
    if not all(run.integration.structure.stepped for run in parts.runs):
        return BoxSample.fewest
    return max(BoxSample.fewest, min(BoxSample.designs, 1 << int(math.log2(max(1, BoxSample.most_runs // runs)))))


def bounds_on_worst(made: Landscape) -> tuple[float, float]:
    """Return bounds on the lowest possible worst objective over a tolerance box, estimated from a sample.

    Args:
        made: landscape of the bare design, in which no variable is solved for.
    """
    landscape = Landscape(made.program, made.p)
    sampled = evaluated_sample(landscape, _CuttingSets.sample if landscape.vectorised else BoxSample.fewest)
    valid = np.flatnonzero(np.isfinite(sampled.f))
    inside = made(boxes(made.program.declared.variables, sampled.points[valid]))
    worst, violation = (part.reshape(-1, BoxSample.designs).max(axis=1) for part in (inside.f, inside.violation))
    feasible = np.isfinite(worst) & (violation <= Violation.allowed)
    if np.any(feasible):
        high = float(worst[feasible].min())
    else:
        high = float(np.max(worst[np.isfinite(worst)], initial=float(np.max(sampled.f[valid], initial=1.0))))
    low = float(np.min(sampled.f[valid], initial=high))
    # The range must not be empty, even for a constant objective.
    reach = max(high - low, abs(high), 1e-6)
    return (low - _CuttingSets.below * reach) * landscape.objective_scale, (high + reach) * landscape.objective_scale
