"""Whether any design meets the requirements, and what to say when none was found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plough_opt.design.declarations import in_words
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.landscape import MET, Landscape, Seen
from plough_opt.design.program import Program
from plough_opt.design.sampling import SEED
from plough_opt.errors import InfeasibleDesign

# Scaled by each limit: violations below are rounding, multipliers below do not hold anything back.
_VIOLATED = 1e-7
_HOLDS = 1e-6
# Designs from which the least violation is looked for, no two of them nearer than this part of the range.
_STARTS, _APART = 8, 0.1
# Islands of an evolution towards less violation, designs on each of either kind, and generations.
_ISLANDS, _LEAST, _GENERATIONS = 4, 20, 80
# Keeps the arithmetic of an evolution finite where designs have no value.
_WORST = 1e30
# Of these the best go on to the optimiser.
_POLISHED = 3
# A requirement is to blame where the others are violated by so much less, in parts of the shortfall, without it.
_HELPS = 1e-3


def feasible_from(program: Program, landscape: Landscape, p: Vector, sample: Seen, start: Vector) -> Vector:
    """Return a scaled design that meets all requirements, from a sample in which none does.

    Args:
        program: the design's program.
        landscape: what was sampled.
        p: parameters.
        sample: designs that were tried.
        start: the guess, which is tried too.

    Raises:
        InfeasibleDesign: the least violation that was found, from several designs of the sample, is one.
    """
    starts = [start, *_apart(sample)]
    if landscape.vectorised:
        ends = [landscape.least_violation(one) for one in starts]
        if min(float(one.violation[0]) for one in ends) > MET:
            ends += [landscape.least_violation(one) for one in _evolved(landscape, sample)]
        ends = sorted(ends, key=lambda one: float(one.violation[0]))
        if ends[0].violation[0] <= MET:
            found: Vector = ends[0].points[0]
            return found
        starts = [one.points[0] for one in ends]
    starts = starts[:_POLISHED]
    program.build(p, starts=starts)
    points = [program.solve_relaxed(one, p) for one in starts]
    n = len(start)
    solved = [point for point in points if point.solved] or points
    best = min(solved, key=lambda point: point.f)
    if is_feasible(best):
        return np.clip(best.y[:n], 0.0, 1.0)
    raise infeasible(program, best, landscape.tried, lambda k: _helps(landscape, best.y[:n], k))


def _evolved(landscape: Landscape, sample: Seen) -> list[Vector]:
    """Return the designs to which evolution towards the least violation comes, from parts of a sample."""
    from scipy.optimize import differential_evolution  # slow to import

    order = np.argsort(sample.violation, kind="stable")
    found = []
    for island in range(_ISLANDS):
        # The least violated, and others for the sake of breadth.
        part = np.r_[order[island : _LEAST * _ISLANDS : _ISLANDS], order[island::_ISLANDS][-_LEAST:]]
        result = differential_evolution(
            lambda x: np.minimum(landscape(np.ascontiguousarray(x.T)).violation, _WORST),
            [(0.0, 1.0)] * landscape.dimensions,
            init=sample.points[part],
            strategy="best1bin" if island % 2 == 0 else "rand1bin",
            maxiter=_GENERATIONS,
            recombination=0.9,
            rng=np.random.default_rng([SEED, island]),
            polish=False,
            updating="deferred",
            vectorized=True,
        )
        found.append(result.x)
    return found


def _apart(sample: Seen) -> list[Vector]:
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
    end = landscape.least_violation(np.clip(y, 0.0, 1.0), frozenset({requirement})).points
    after = landscape.violations(landscape.rows(end)[1])[0][others].sum()
    return bool(after < (1.0 - _HELPS) * before)


def is_feasible(point: Point) -> bool:
    """Return whether the least violation is none."""
    return point.f < _VIOLATED


def infeasible(
    program: Program, point: Point, designs: int = 0, helps: Callable[[int], bool] = lambda _: True
) -> InfeasibleDesign:
    """Return the error that names the requirements that fail, by how much, and what holds them back.

    Args:
        program: the design's program.
        point: the least violation that was found.
        designs: number of designs that were tried; 0 leaves it unsaid.
        helps: number of a requirement that holds others back -> whether these are violated less without it.
    """
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
        for k, (r, force) in enumerate(zip(declared.requirements, pull, strict=True))
        if force > _HOLDS and r.name not in conflicts and helps(k)
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
    tried = f" of {designs} tried" if designs else ""
    return InfeasibleDesign(
        f"no design was found that meets all requirements: at best{tried} {fails}; {against}."
        f" Nearest design: {place}. Loosen one of these",
        conflicts,
        blockers,
    )
