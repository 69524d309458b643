"""Whether any design meets the requirements, and what to say when none was found."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from plough_opt.core.errors import InfeasibleDesign
from plough_opt.core.units import in_words
from plough_opt.design.descents import least_violation
from plough_opt.design.exploring import Explored
from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.landscape import FEASIBLE_ANSWER, FINER, Evaluations, Landscape, concatenated
from plough_opt.design.polishing import point_as_found
from plough_opt.design.program import Program

# Scaled by each limit: violations below are rounding, multipliers below do not hold anything back.
_VIOLATED = 1e-7
_HOLDS = 1e-6
# Designs of a sample from which the least violation is looked for, no two of them nearer than this part of the range.
_STARTS, _APART = 8, 0.1
# Of designs with little violation so many go on to the optimiser, which violate by so much more than the best at most.
_POLISHED, _NEAR_LEAST = 3, 1e-3
# How far from a design, in parts of the range, its polished one may lie, by which derivatives, and by how much its
# violation may be larger; and steps by which that is compared.
_BESIDE = ((0.01, False), (0.01, True), (1e-3, False), (3e-4, True))
_NOT_WORSE = 1e-6
# A requirement is to blame where the others are violated by so much less, in parts of the shortfall, without it.
_HELPS = 1e-3


def feasible_from(landscape: Landscape, explored: Explored, start: Vector) -> Vector:
    """Return a scaled design that meets all requirements, after a search that found none.

    Args:
        landscape: what was searched.
        explored: what was seen.
        start: the guess, which is tried too.

    Raises:
        InfeasibleDesign: the least violation that was found, from several designs, is one.
    """
    program = landscape.program
    starts = [start, *_apart(explored.sample)]
    known: Sequence[float] = [np.inf] * len(starts)
    if landscape.vectorised:
        ends = explored.least_violating
        if ends is None:
            ends = concatenated([least_violation(landscape, one) for one in starts])
        ends = ends.select(np.argsort(ends.violation, kind="stable"))
        if ends.violation[0] <= FEASIBLE_ANSWER:
            found: Vector = ends.points[0]
            return found
        ends = ends.select(ends.violation <= (1.0 + _NEAR_LEAST) * ends.violation[0])
        starts, known = list(ends.points), ends.violation.tolist()
    starts = starts[:_POLISHED]
    program.build(landscape.p, starts=starts)
    points = [_polished(landscape, one, violation) for one, violation in zip(starts, known, strict=False)]
    solved = [own for own in points if own[0].solved] or points
    best, short = min(solved, key=lambda own: own[0].f)
    if best.f < _VIOLATED:
        return best.y
    raise _infeasible(program, best, short, landscape.designs_tried, lambda k: _helps(landscape, best.y, k))


def _polished(landscape: Landscape, y: Vector, violation: float) -> tuple[Point, Vector]:
    """Return the design of least violation beside another, whose violation is known, and by how much each is violated.

    Where paths kink the optimiser may come to no better design: then it is the other with its violations.
    """
    program, p = landscape.program, landscape.p
    if not np.isfinite(violation):
        return program.solve_relaxed(y, p)
    for box, exact in _BESIDE:
        point, short = program.solve_relaxed(y, p, box=box, exact=exact)
        if point.solved and point.f <= (1.0 + _NOT_WORSE) * violation + _VIOLATED:
            return point, short
    short = landscape.violations(landscape.rows(y[None], finer=FINER)[1])[0]
    return replace(point, solved=True, y=y, f=float(short.sum())), short


def _apart(sample: Evaluations) -> list[Vector]:
    """Return the designs of a sample with the least violations, none near another."""
    chosen: list[Vector] = []
    for k in np.argsort(sample.violation, kind="stable"):
        if not np.isfinite(sample.violation[k]) or len(chosen) == _STARTS:
            break
        if all(np.max(np.abs(sample.points[k] - other)) > _APART for other in chosen):
            chosen.append(sample.points[k])
    return chosen


def _helps(landscape: Landscape, y: Vector, requirement: int) -> bool:
    """Return whether the others are violated less where a requirement is left out."""
    if not landscape.vectorised or requirement >= len(landscape.program.own_requirements):
        return True  # beyond the end of a theory nothing has a value
    others = np.arange(len(landscape.program.declared.requirements)) != requirement
    before = landscape.violations(landscape.rows(y[None])[1])[0][others].sum()
    end = least_violation(landscape, y, ignored={requirement}).points
    after = landscape.violations(landscape.rows(end)[1])[0][others].sum()
    return bool(after < (1.0 - _HELPS) * before)


def from_least_violation(program: Program, p: Vector, start: Vector, fixed: Sequence[int] = ()) -> Point:
    """Return the optimum, with some variables held, from the design near a start that meets the requirements.

    Raises:
        InfeasibleDesign: none was found.
    """
    loose, short = program.solve_relaxed(start, p, fixed=fixed)
    if loose.f >= _VIOLATED:
        raise _infeasible(program, loose, short)
    if len(fixed) < len(start):
        point = program.solve(loose.y, p, SolveOptions(near=len(fixed) > 0), fixed=fixed)
        if point.solved:
            return point
    return point_as_found(program, p, loose.y)


def failures(program: Program, conflicts: Mapping[str, float]) -> str:
    """Say by how much which requirements fail."""
    return ", ".join(
        f"'{r.name}' ({r.limits_text()}) fails by {in_words(conflicts[r.name], r.unit)}"
        for r in program.declared.requirements
        if r.name in conflicts
    )


def _infeasible(
    program: Program, point: Point, short: Vector, designs: int = 0, helps: Callable[[int], bool] = lambda _: True
) -> InfeasibleDesign:
    """Return the error that names the requirements that fail, by how much, and what holds them back.

    Args:
        program: the design's program.
        point: the least violation that was found.
        short: by how much each requirement is violated there, scaled.
        designs: number of designs that were tried; 0 leaves it unsaid.
        helps: number of a requirement that holds others back -> whether these are violated less without it.
    """
    declared = program.declared
    conflicts = {
        r.name: float(s * scale)
        for r, s, scale in zip(declared.requirements, short, program.scales, strict=True)
        if s > _VIOLATED
    }
    pull = np.zeros(len(declared.requirements))
    np.maximum.at(pull, program.owner, np.abs(point.lam_g))
    blockers = [
        f"requirement '{r.name}' {r.limits_text()}"
        for k, (r, force) in enumerate(zip(declared.requirements, pull, strict=True))
        if force > _HOLDS and r.name not in conflicts and helps(k)
    ]
    for variable, multiplier in zip(declared.variables, point.lam_y, strict=True):
        if abs(multiplier) > _HOLDS:
            side, bound = ("upper", variable.upper) if multiplier > 0 else ("lower", variable.lower)
            blockers.append(f"{side} bound {in_words(bound, variable.unit)} of '{variable.name}'")
    fails = failures(program, conflicts)
    alone = "no variable of this design changes it" if len(conflicts) == 1 else "against them stand only each other"
    against = f"against it stand {' and '.join(blockers)}" if blockers else alone
    place = declared.describe(program.values(point.y))
    tried = f" of {designs} tried" if designs else ""
    return InfeasibleDesign(
        f"no design was found that meets all requirements: at best{tried} {fails}; {against}."
        f" Nearest design: {place}. Loosen one of these",
        conflicts,
        blockers,
    )
