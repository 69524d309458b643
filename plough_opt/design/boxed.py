"""Design over the tolerance box: the mean or the worst objective in the box, with the requirements met throughout."""

import math
from dataclasses import replace
from typing import Final, Literal

import casadi as ca
import numpy as np

from plough_opt.core.errors import InfeasibleDesign
from plough_opt.core.expressions import Column
from plough_opt.design.declarations import Declarations, Requirement, Variable
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import FEASIBLE, Landscape
from plough_opt.design.optimum import Optimum
from plough_opt.design.program import Program
from plough_opt.design.sampling import evaluated_sample
from plough_opt.design.solving import Request, solve_program
from plough_opt.design.split import split
from plough_opt.design.tolerance import BOX_DESIGNS, boxes, unit_box

Over = Literal["mean", "worst"]
"""Which value of the objective over the tolerance box is minimised: its mean, or the worst."""

WORST = "worst objective\n"
"""Name of the auxiliary variable that bounds the objective of every design in the box; users' names have no line."""

# The requirement that does so.
_BELOW_WORST: Final = "objective below its worst"
# Most runs of all designs in a box together: they take seconds for a whole solve.
_MOST_RUNS = 64
# Fewest designs in a box.
_FEWEST = 8
# Designs whose boxes are sampled to find bounds on the worst objective.
_SAMPLE_SIZE = 256
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
                if bounds is None or raised or list(error.conflicts) != [_BELOW_WORST]:
                    raise
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
            declared = over_box(own, count, bounds)
            self._built = key, Program.of(declared, compiled=self._bare.compiled, bare=self._bare, over=over)
        return self._built[1]


def over_box(declared: Declarations, count: int, bounds: tuple[float, float] | None) -> Declarations:
    """Return a design problem over a sample of the tolerance box around the chosen design.

    The sampled designs have their variables within the tolerances, clipped at the bounds. All of them must meet the
    requirements.

    Args:
        declared: the problem of the bare design.
        count: number of sampled designs, a power of two.
        bounds: of their worst objective, which is minimised; None to minimise their mean.
    """
    symbols = [v.symbol for v in declared.variables]
    expressions = [declared.objective, *(r.expression for r in declared.requirements)]
    found = []
    for position in unit_box(len(symbols))[:count]:
        within: list[Column] = [
            v.within_tolerance(v.symbol, float(part)) for v, part in zip(declared.variables, position, strict=True)
        ]
        found.append(ca.graph_substitute(expressions, symbols, within))
    objectives, *columns = (ca.vertcat(*column) for column in zip(*found, strict=True))
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
        return _FEWEST
    return max(_FEWEST, min(BOX_DESIGNS, 1 << int(math.log2(max(1, _MOST_RUNS // runs)))))


def bounds_on_worst(program: Program, p: Vector) -> tuple[float, float]:
    """Return bounds on the lowest possible worst objective over a tolerance box, estimated from a sample.

    Args:
        program: of the bare design.
        p: parameters.
    """
    landscape = Landscape(program.at(p, any_guess=True), p)
    sampled = evaluated_sample(landscape, _SAMPLE_SIZE if landscape.vectorised else _FEWEST)
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
