"""The local optimum in whose basin the guess lies, and the nearest design that meets all requirements."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from plough_opt.core.errors import InfeasibleDesign
from plough_opt.core.units import in_words
from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.program import Program, with_sure_steps
from plough_opt.design.search.effort import TimeLimit, effort_of
from plough_opt.design.search.explore import Explored, Explorer
from plough_opt.design.search.landscape import (
    FINER,
    SEED,
    Basins,
    Evaluations,
    Landscape,
    apart,
    concatenated,
    evaluated_sample,
    largest_rise,
)
from plough_opt.design.search.local import descend, least_violation, nearest_feasible, point_as_found, polished


class _Boxes:
    """Boxes that keep a descent in its basin, and the look for barriers in them. Lengths are fractions of the range."""

    half_width: Final = 0.05  # of the first box
    factor: Final = 3.0  # The box shrinks by this factor if it contains a barrier.
    smallest: Final = 2e-4
    most: Final = 80
    fewest_positions: Final = 40  # on the straight line to an end, at which a barrier is looked for
    positions_across: Final = 256  # on a line across the whole range


class _Nearer:
    """The search for a feasible design nearer to an infeasible guess than the one found so far."""

    rounds: Final = 5
    sample: Final = 128  # designs sampled in each round
    violation: Final = 0.2  # An infeasible sample is a start if its violation is below this fraction of the guess's.
    distance: Final = 0.999  # A result counts only if it reduces the distance at least by this factor.


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
    begin = landscape(start[None])
    if not begin.feasible[0]:
        begin = _nearest_feasible(landscape, begin)
    if not begin.feasible[0]:
        begin = _far_feasible(landscape, start)
    y = begin.points[0]
    end = descend(landscape, y).points[0]
    y = end if _is_downhill(landscape, y, end) else _descended_in_boxes(landscape, y)
    program = with_sure_steps(program, p, [y])
    return program, polished(program, p, y)


def _descended_in_boxes(landscape: Landscape, y: Vector) -> Vector:
    """Return the end of successive descents that are confined to small boxes and cross no barrier."""
    box = _Boxes.half_width
    for _ in range(_Boxes.most):
        end = descend(landscape, y, (np.maximum(y - box, 0.0), np.minimum(y + box, 1.0))).points[0]
        moved = np.max(np.abs(end - y))
        if _is_downhill(landscape, y, end):
            y = end
            if moved < 0.9 * box:
                break
            box = min(_Boxes.half_width, _Boxes.factor * box)
        elif min(box, moved) < _Boxes.smallest:
            break
        else:
            box = min(box, moved) / _Boxes.factor
    return y


def _nearest_feasible(landscape: Landscape, start: Evaluations) -> Evaluations:
    """Return the feasible design nearest to a start, as local searches and samples nearer to the start find it."""
    (guess,), rng = start.points, np.random.default_rng(SEED)
    found = nearest_feasible(landscape, guess)
    for _ in range(_Nearer.rounds if found.feasible[0] else 0):
        distance = np.linalg.norm(found.points[0] - guess)
        directions = rng.standard_normal((_Nearer.sample, len(guess)))
        lengths = distance * rng.random(_Nearer.sample) ** (1.0 / len(guess)) / np.linalg.norm(directions, axis=1)
        sampled = landscape(np.clip(guess + lengths[:, None] * directions, 0.0, 1.0))
        away = np.linalg.norm(sampled.points - found.points, axis=1) > 0.5 * distance
        less = sampled.violation < _Nearer.violation * start.violation
        promising = sampled.select(sampled.feasible | (away & less))
        if not len(promising.f):
            break
        # Feasible ones first, the nearest of them, then by violation.
        order = np.lexsort(
            (np.linalg.norm(promising.points - guess, axis=1), np.where(promising.feasible, 0.0, promising.violation))
        )
        again = nearest_feasible(landscape, guess, promising.points[order[0]])
        if not (again.feasible[0] and np.linalg.norm(again.points[0] - guess) < _Nearer.distance * distance):
            break
        found = again
    return found


def _far_feasible(landscape: Landscape, start: Vector) -> Evaluations:
    """Return a feasible design for a start near which the local search found none."""
    sampled = evaluated_sample(landscape)
    if np.any(sampled.feasible):
        others = sampled.points[sampled.feasible]
        return nearest_feasible(landscape, start, others[np.argmin(np.sum((others - start) ** 2, axis=1))])
    every = tuple(range(len(start)))
    effort = effort_of("auto", len(start), landscape.program.population.runs, landscape.vectorised)
    explored = Explorer(landscape, start, every, effort).explore()
    if len(explored.minima.f) and explored.minima.feasible[0]:
        return explored.minima.select([0])
    return landscape(feasible_from(landscape, explored, start)[None])


def _is_downhill(landscape: Landscape, start: Vector, end: Vector) -> bool:
    """Return whether the straight line from a start to an end crosses no barrier and does not end above the start."""
    count = max(_Boxes.fewest_positions, int(_Boxes.positions_across * np.max(np.abs(end - start))))
    fractions = np.linspace(0.0, 1.0, count)[:, None]
    merit = landscape(start + fractions * (end - start)).merit
    return bool(largest_rise(merit) <= Basins.barrier * abs(merit[0]))


class _LeastViolation:
    """Bounds of the search for the least violation, and what of it counts."""

    violated: Final = 1e-7  # A smaller violation, in units of the limit, is rounding.
    holds: Final = 1e-6  # A limit with a smaller scaled multiplier does not hold the design back.
    # IPOPT keeps a variable away from a bound by 1e-11 over its multiplier.
    near_bound: Final = 1e-5
    starts: Final = 8  # designs of the sample from which the least violation is searched
    distance: Final = 0.1  # smallest one between these, as a fraction of the range
    most_polished: Final = 3  # designs that go on to IPOPT
    excess: Final = 1e-3  # fraction of the least violation by which theirs may exceed it
    # Attempts to polish a design: the half width of the box it must stay in, and whether to use exact second
    # derivatives.
    attempts: Final = ((0.01, False), (0.01, True), (1e-3, False), (3e-4, True))
    higher: Final = 1e-6  # The violation of a polished design may be larger by this fraction.


def feasible_from(landscape: Landscape, explored: Explored, start: Vector, limit: TimeLimit | None = None) -> Vector:
    """Return a scaled design that meets all requirements, after a search found none.

    Args:
        landscape: the landscape that was searched.
        explored: the result of the search.
        start: the scaled guess, which is tried, too.
        limit: of the processor time, after which no further design goes on to IPOPT; default: none.

    Raises:
        InfeasibleDesign: the least violation found from several designs is not 0.
    """
    sample = explored.sample
    order = np.argsort(sample.violation, kind="stable")[: np.count_nonzero(np.isfinite(sample.violation))]
    starts = [start, *sample.points[apart(sample.points, order, _LeastViolation.distance, _LeastViolation.starts)]]
    known: Sequence[float] = [np.inf] * len(starts)
    if landscape.vectorised:
        ends = explored.least_violating
        if not len(ends.f):
            ends = concatenated([least_violation(landscape, one) for one in starts])
        ends = ends.select(np.argsort(ends.violation, kind="stable"))
        ends = ends.select(ends.violation <= (1.0 + _LeastViolation.excess) * ends.violation[0])
        starts, known = list(ends.points), ends.violation.tolist()
    starts = starts[: _LeastViolation.most_polished]
    program = landscape.program.with_steps(landscape.p, starts=starts)
    points, limit = list[tuple[Point, Vector]](), limit or TimeLimit("near")
    for one, violation in zip(starts, known, strict=False):
        if points and limit.passed("further attempts to meet the requirements"):
            break
        points.append(_polished(landscape, program, one, violation, limit))
    solved = [own for own in points if own[0].solved] or points
    best, short = min(solved, key=lambda own: own[0].f)
    if best.f < _LeastViolation.violated:
        return best.y
    raise _infeasible(program, best, short, landscape.designs_tried)


def _polished(
    landscape: Landscape, program: Program, y: Vector, violation: float, limit: TimeLimit
) -> tuple[Point, Vector]:
    """Return the design of least violation near another one, and the violation of each requirement.

    If IPOPT finds none that is as good, for instance because the violation has a kink, the other design is returned.

    Args:
        landscape: the landscape that was searched.
        program: its program, with integration steps.
        y: the other design, scaled.
        violation: its summed violation; infinite if unknown.
        limit: of the processor time, after which no further attempt begins.
    """
    p = landscape.p
    if not np.isfinite(violation):
        return program.solve_relaxed(y, p)
    for box, exact in _LeastViolation.attempts:
        point, short = program.solve_relaxed(y, p, box=box, exact=exact)
        if point.solved and point.f <= (1.0 + _LeastViolation.higher) * violation + _LeastViolation.violated:
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
    if loose.f >= _LeastViolation.violated:
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
        if s > _LeastViolation.violated
    }
    multipliers = np.zeros(len(declared.requirements))
    np.maximum.at(multipliers, program.owner, np.abs(point.lam_g))
    blockers = [
        f"requirement '{r.name}' {r.limits_text()}"
        for r, largest in zip(declared.requirements, multipliers, strict=True)
        if largest > _LeastViolation.holds and r.name not in conflicts
    ]
    for variable, y, multiplier in zip(declared.variables, point.y, point.lam_y, strict=True):
        # A box around the point may have held it instead.
        at_bound = min(y, 1.0 - y) < _LeastViolation.near_bound
        if abs(multiplier) > _LeastViolation.holds and at_bound:
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
