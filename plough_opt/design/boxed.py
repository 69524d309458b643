"""A design question asked of the whole tolerance box: the mean or the worst objective, the requirements everywhere."""

import math
from dataclasses import replace
from typing import Literal

import casadi as ca
import numpy as np

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
"""The objective over the tolerances: its mean, or the worst."""

WORST = "worst objective"
"""Name of the variable that no design in the box exceeds."""

# Runs of a box together, and designs of a box at least.
_MOST_RUNS, _FEWEST = 64, 8
# Designs of a sample whose boxes are looked at.
_LOOKS = 256
# By so many of the sample's spreads the bounds of the worst objective reach below the lowest seen.
_BELOW = 2.0
_AT_THE_BOUND = 1e-6


class ToleranceBoxSolver:
    """A design's question asked of the tolerance box; its program is kept for further solves."""

    def __init__(self, bare: Program, over: Over) -> None:
        """Take the program of the design itself, and what is minimised."""
        self._bare, self._over = bare, over
        # The program that was made last, with the parameters and the bounds of the worst objective that it is for.
        self._built: tuple[tuple[bytes, tuple[float, float]] | None, Program] | None = None

    def solve(self, request: Request) -> Optimum:
        """Return the best optimum."""
        bounds, p = None, request.p
        if self._over == "worst":
            request.progress("looking at tolerances", 0.0)
            bounds = bounds_on_worst(self._bare, p)
        while True:
            best = solve_program(self._program(p, bounds), request)
            if bounds is None or best.objective > bounds[0] + _AT_THE_BOUND * (bounds[1] - bounds[0]):
                return best
            # No sampled design was nearly as low.
            bounds = bounds[0] - _BELOW * (bounds[1] - bounds[0]), bounds[1]

    def _program(self, p: Vector, bounds: tuple[float, float] | None) -> Program:
        key = None if bounds is None else (p.tobytes(), bounds)
        if self._built is None or self._built[0] != key:
            # The requirements that theories bring follow from the expressions, in every design of the box anew.
            own = replace(self._bare.declared, requirements=self._bare.own_requirements)
            designs = designs_per_box(own)
            over = (
                f"the objective is the {self._over} of {designs} designs within the tolerances, in all of which the"
                " requirements are kept"
            )
            declared = over_box(own, self._over, designs, bounds)
            self._built = key, Program(declared, compiled=self._bare.compiled, bare=self._bare, over=over)
        return self._built[1]


def over_box(declared: Declarations, over: Over, designs: int, bounds: tuple[float, float] | None) -> Declarations:
    """Return the same question of designs sampled in the tolerance box around the chosen one.

    Each of them has its variables within the tolerances, clipped at the bounds. Requirements must hold in all of them.

    Args:
        declared: the question.
        over: whether their mean or their worst objective is minimised.
        designs: number of them, a power of two.
        bounds: between which the worst objective lies.
    """
    symbols = [v.symbol for v in declared.variables]
    asked = [declared.objective, *(r.expression for r in declared.requirements)]
    found = []
    for parts in unit_box(len(symbols))[:designs]:
        within: list[Column] = [
            v.within_tolerance(v.symbol, float(part)) for v, part in zip(declared.variables, parts, strict=True)
        ]
        found.append(ca.graph_substitute(asked, symbols, within))
    objectives, *columns = (ca.vertcat(*column) for column in zip(*found, strict=True))
    everywhere = [replace(r, expression=column) for r, column in zip(declared.requirements, columns, strict=True)]
    if over == "mean" or bounds is None:
        mean = ca.sum1(objectives) / objectives.numel()
        return replace(declared, objective=mean, requirements=tuple(everywhere))
    worst = Variable(WORST, ca.MX.sym(WORST), bounds[1], *bounds, "", False, 0.0, auxiliary=True)
    below = Requirement("objective below its worst", objectives - worst.symbol, None, 0.0, "", auxiliary=True)
    return replace(
        declared,
        variables=(*declared.variables, worst),
        objective=worst.symbol,
        requirements=(*everywhere, below),
    )


def designs_per_box(declared: Declarations) -> int:
    """Return how many designs of a box are taken: fewer where each has several runs, or takes long."""
    parts = split([declared.objective, *(r.expression for r in declared.requirements)], declared.symbols())
    runs = max(1, len(parts.runs))
    if not all(run.integration.structure.stepped for run in parts.runs):
        return _FEWEST
    return max(_FEWEST, min(BOX_DESIGNS, 1 << int(math.log2(max(1, _MOST_RUNS // runs)))))


def bounds_on_worst(program: Program, p: Vector) -> tuple[float, float]:
    """Return bounds between which the least worst objective of a design lies, from a sample.

    Args:
        program: of the design itself.
        p: parameters.
    """
    program.prepare(p)
    landscape = Landscape(program, p)
    seen = evaluated_sample(landscape, _LOOKS if landscape.vectorised else _FEWEST)
    sound = np.flatnonzero(np.isfinite(seen.f))
    near = landscape(boxes(program.declared.variables, seen.points[sound]))
    worst, violation = (part.reshape(len(sound), -1).max(axis=1) for part in (near.f, near.violation))
    kept = np.isfinite(worst) & (violation <= FEASIBLE)
    if np.any(kept):
        high = float(worst[kept].min())
    else:
        high = float(np.max(worst[np.isfinite(worst)], initial=float(np.max(seen.f[sound], initial=1.0))))
    low = float(np.min(seen.f[sound], initial=high))
    # A spread of none is that of an objective that nothing changes.
    reach = max(high - low, abs(high), 1e-6)
    return (low - _BELOW * reach) * landscape.objective_scale, (high + reach) * landscape.objective_scale
