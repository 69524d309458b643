"""What to say when no design meets the requirements."""

from __future__ import annotations

import numpy as np

from plough_opt.design.declarations import in_words
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.program import Program
from plough_opt.errors import InfeasibleDesign

# Scaled by each limit: violations below are rounding, multipliers below do not hold anything back.
_VIOLATED = 1e-7
_HOLDS = 1e-6


def least_violation(program: Program, p: Vector) -> Point:
    """Return the design that violates the requirements least, of those reached from three starts."""
    n = len(program.declared.variables)
    starts = (program.start(), np.full(n, 0.5), np.full(n, 0.25))
    points = (program.solve_relaxed(start, p) for start in starts)
    best: Point | None = None
    for point in points:
        if best is None or (point.solved, -point.f) > (best.solved, -best.f):
            best = point
        if best.solved and best.f < _VIOLATED:
            break
    assert best is not None  # there is at least one start
    return best


def is_feasible(point: Point) -> bool:
    """Return whether the least violation is none."""
    return point.f < _VIOLATED


def infeasible(program: Program, point: Point) -> InfeasibleDesign:
    """Return the error that names the requirements that fail, by how much, and what holds them back."""
    declared = program.declared
    count, n = len(declared.requirements), len(declared.variables)
    slack = point.y[n : n + count] + point.y[n + count :]
    conflicts = {
        r.name: float(s * scale)
        for r, s, scale in zip(declared.requirements, slack, program.scales, strict=True)
        if s > _VIOLATED
    }
    pull = np.zeros(count)
    for multiplier, requirement in zip(point.lam_g, program.owner, strict=True):
        pull[requirement] = max(pull[requirement], abs(multiplier))
    blockers = [
        f"requirement '{r.name}' {r.limits_text()}"
        for r, force in zip(declared.requirements, pull, strict=True)
        if force > _HOLDS and r.name not in conflicts
    ]
    for variable, multiplier in zip(declared.variables, point.lam_y[:n], strict=True):
        if abs(multiplier) > _HOLDS:
            side, bound = ("upper", variable.upper) if multiplier > 0 else ("lower", variable.lower)
            blockers.append(f"{side} bound {in_words(bound, variable.unit)} of '{variable.name}'")
    fails = ", ".join(
        f"'{r.name}' ({r.limits_text()}) fails by {in_words(conflicts[r.name], r.unit)}"
        for r in declared.requirements
        if r.name in conflicts
    )
    alone = "no variable of this design changes it" if len(conflicts) == 1 else "against them stand only each other"
    against = f"against it stand {' and '.join(blockers)}" if blockers else alone
    place = declared.describe(program.values(np.clip(point.y[:n], 0.0, 1.0)))
    return InfeasibleDesign(
        f"no design was found that meets all requirements: at best {fails}; {against}."
        f" Nearest design: {place}. Loosen one of these",
        conflicts,
        blockers,
    )
