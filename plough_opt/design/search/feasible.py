"""Designs that meet all requirements: those nearest to a guess, those of a search, or why there are none."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from plough_opt.core.errors import InfeasibleDesign
from plough_opt.core.units import in_words
from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.program import Program
from plough_opt.design.search.descent import descend
from plough_opt.design.search.effort import TimeLimit, effort_of
from plough_opt.design.search.explore import Progress, explore, silent
from plough_opt.design.search.landscape import FINER, SAME, SEED, Evaluations, Landscape, concatenated, even_points
from plough_opt.design.search.polish import point_as_found

# A smaller violation, in units of the limit, is rounding.
_VIOLATED: Final = 1e-7
# A limit with a smaller scaled multiplier does not hold the design back.
_HOLDS: Final = 1e-6
# Designs from which to descend to the best one.
_MOST_FEASIBLE: Final = 8


def feasible_designs(
    landscape: Landscape,
    start: Vector,
    known: Evaluations,
    *,
    seed: int = 0,
    progress: Progress = silent,
    limit: TimeLimit | None = None,
) -> Evaluations:
    """Return designs that meet all requirements, after a search for the best design found none.

    Args:
        landscape: the landscape that was searched.
        start: the scaled guess, which is tried, too.
        known: designs with little violation.
        seed: of the samples.
        progress: called with what is being done and the fraction of it done.
        limit: of the processor time, after which no further design goes on to IPOPT; default: none.

    Raises:
        InfeasibleDesign: the least violation found from several designs is not 0.
    """
    limit, every = limit or TimeLimit("near"), range(len(start))
    effort = effort_of("auto", len(start), landscape.program.population.runs, landscape.vectorised)
    # The last per mille of a violation may take many looks.
    effort = replace(effort, looks=16)
    first = known.distinct(SAME, _MOST_FEASIBLE).points
    bare = landscape.without_objective()
    ends = explore(bare, start, every, effort, seed=seed, known=first, progress=progress, limit=limit).ends
    if np.any(ends.feasible):
        return landscape(ends.select(ends.feasible).distinct(SAME, _MOST_FEASIBLE).points, finer=FINER)
    # Those that are as good but for the accuracy of descents go on to IPOPT.
    least = ends.violation <= (1.0 + 1e-3) * ends.violation[0]
    ends = ends.select(least if landscape.vectorised else slice(None)).distinct(SAME, 3)
    program = landscape.program.with_steps(landscape.p, starts=list(ends.points))
    points: list[tuple[Point, Vector]] = []
    for y, violation in zip(ends.points, ends.violation, strict=True):
        if points and limit.passed("further attempts to meet the requirements"):
            break
        points.append(_polished(landscape, program, y, violation, limit))
    solved = [own for own in points if own[0].solved] or points
    best, short = min(solved, key=lambda own: own[0].f)
    if best.f >= _VIOLATED:
        raise _infeasible(program, best, short, landscape.designs_tried)
    return landscape(best.y[None], finer=FINER)


def nearest_feasible(landscape: Landscape, guess: Vector) -> Vector:
    """Return a scaled guess, or the feasible design nearest to it that descents from it and from a sample find.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
    """
    if landscape(guess[None]).feasible[0]:
        return guess
    sampled = landscape(even_points(len(guess), 1024, np.random.default_rng(SEED)))
    others = sampled.points[sampled.feasible]
    others = others[np.argsort(np.sum((others - guess) ** 2, axis=1), kind="stable")]

    def ends(starts: Sequence[Vector] | Vector) -> Evaluations:
        found = [
            descend(landscape, start, objective=lambda points: np.sum((points - guess) ** 2, axis=1))
            for start in starts
        ]
        every = concatenated(found)
        return every.select(every.feasible)

    nearest = ends([guess])
    found = np.min(np.linalg.norm(nearest.points - guess, axis=1), initial=np.inf)
    if len(others) and np.linalg.norm(others[0] - guess) < found:
        nearest = concatenated([nearest, ends(others[:1])])
    if not len(nearest.f):
        nearest = ends(feasible_designs(landscape, guess, sampled).points)
    distance = np.sum((nearest.points - guess) ** 2, axis=1)
    return np.asarray(nearest.points[np.argmin(distance)])


def _polished(
    landscape: Landscape, program: Program, y: Vector, violation: float, limit: TimeLimit
) -> tuple[Point, Vector]:
    """Return the design of least violation near another one, and the violation of each requirement.

    If IPOPT finds none that is as good, for instance because the violation has a kink, the other design is returned.

    Args:
        landscape: the landscape that was searched.
        program: its program, with integration steps.
        y: the other design, scaled.
        violation: its summed violation.
        limit: of the processor time, after which no further attempt begins.
    """
    p = landscape.p
    if not landscape.vectorised:
        return program.solve_relaxed(y, p)
    # The half width of the box that a design must stay in, and whether to use exact second derivatives.
    for box, exact in ((0.01, False), (0.01, True), (1e-3, False), (3e-4, True)):
        point, short = program.solve_relaxed(y, p, box=box, exact=exact)
        # The violation of a polished design may be larger by this fraction.
        if point.solved and point.f <= (1.0 + 1e-6) * violation + _VIOLATED:
            return point, short
        if limit.passed("further attempts to meet the requirements"):
            break
    short = landscape.violations(landscape.rows(y[None], finer=FINER)[1])[0]
    return replace(point, solved=True, y=y, f=float(short.sum())), short


def from_least_violation(program: Program, p: Vector, start: Vector, fixed: Sequence[int] = ()) -> Point:
    """Return the optimum found from the feasible design nearest to a start, with some variables held.

    Args:
        program: the design's program, with integration steps.
        p: parameters.
        start: the scaled start.
        fixed: numbers of the variables to hold.

    Raises:
        InfeasibleDesign: no feasible design was found.
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
    """Return a text that names the requirements that fail, each with its shortfall."""
    return ", ".join(
        f"'{r.name}' ({r.limits_text()}) fails by {in_words(conflicts[r.name], r.unit)}"
        for r in program.declared.requirements
        if r.name in conflicts
    )


def _infeasible(program: Program, point: Point, short: Vector, designs: int = 0) -> InfeasibleDesign:
    """Return the error that names the requirements that fail, their shortfalls, and the limits that block them.

    Args:
        program: the design's program.
        point: the design with the least violation found.
        short: scaled violation of each requirement there.
        designs: number of designs tried; 0 if it need not be stated.
    """
    declared = program.declared
    conflicts = {
        r.name: float(s * scale)
        for r, s, scale in zip(declared.requirements, short, program.scales, strict=True)
        if s > _VIOLATED
    }
    multipliers = np.zeros(len(declared.requirements))
    np.maximum.at(multipliers, program.owner, np.abs(point.lam_g))
    blockers = [
        f"requirement '{r.name}' {r.limits_text()}"
        for r, largest in zip(declared.requirements, multipliers, strict=True)
        if largest > _HOLDS and r.name not in conflicts
    ]
    for variable, y, multiplier in zip(declared.variables, point.y, point.lam_y, strict=True):
        # A box around the point may have held it instead.
        # IPOPT keeps a variable away from a bound by 1e-11 over its multiplier.
        at_bound = min(y, 1.0 - y) < 1e-5
        if abs(multiplier) > _HOLDS and at_bound:
            side, bound = ("upper", variable.upper) if multiplier > 0 else ("lower", variable.lower)
            blockers.append(f"{side} bound {in_words(bound, variable.unit)} of '{variable.name}'")
    fails = failures(program, conflicts)
    alone = (
        "no variable of this design makes it smaller" if len(conflicts) == 1 else "they conflict only with each other"
    )
    against = f"in conflict with {' and '.join(blockers)}" if blockers else alone
    place = declared.describe(program.values(point.y))
    best = f"in the best of {designs} designs tried," if designs else "at best"
    return InfeasibleDesign(
        f"no design was found that meets all requirements: {best} {fails}; {against}."
        f" Nearest design: {place}. Loosen one of these limits",
        conflicts,
        blockers,
    )
