"""Confirmation of optima: enough integration steps, the full tolerance, curvature, and other designs as good.

Objective and limits are compared with tight integration at every optimum, derivatives with those of finer steps at the
best one.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError
from plough_opt.design.declarations import Variable
from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.optimality import (
    Zero,
    decides,
    difference_quotients,
    free_directions,
    lagrangian,
    reduced_curvatures,
    symmetric,
)
from plough_opt.design.model.program import Program, error_of_derivatives
from plough_opt.design.model.tight_integration import steps_factor
from plough_opt.design.search.effort import TimeLimit
from plough_opt.design.search.landscape import FINER, SAME, Landscape, Violation, even_points
from plough_opt.design.search.polish import AS_FOUND, solved_again

SMALL = 0.25
"""An objective below this part of its typical size counts as small: near 0 a fraction of it would mean nothing."""


_MOST_REFINEMENTS: Final = 4


def with_enough_steps(
    program: Program, p: Vector, points: list[Point], progress: Callable[[str, float], None], limit: TimeLimit
) -> tuple[Program, list[Point], tuple[str, ...]]:
    """Refine the steps, and solve again, until the points are accurate or more steps do not help.

    Across kinks derivatives lose more accuracy than values do, so they may need more steps than the objective.

    Args:
        program: with integration steps.
        p: parameters.
        points: optima, best first.
        progress: called with what is being done and the fraction done.
        limit: of the processor time. After it no refinement begins, and of one that has begun only the best point is
            solved again.

    Returns:
        The program, the points, and a warning for each error that is still too large.
    """
    wanted, factor, last = program.wanted_error, program.refinement, math.inf
    for number in range(_MOST_REFINEMENTS + 1):
        # Of the objective at any point, or the violation of a limit if that is larger.
        value_error = max(max(gap_of(program, p, point), _violation(program, p, point)) for point in points)
        slope_error = _slope_error(program, p, points[0])
        excess = max(value_error / (wanted or math.inf), slope_error / program.wanted_of_derivatives)
        # A motion may be too sensitive for any number of steps.
        # A refinement must reduce the excess of the error to this part of the last one; otherwise more steps do not
        # help.
        if excess <= 1.0 or excess > 0.5 * last or number == _MOST_REFINEMENTS:
            break
        if limit.passed("finer integration steps"):
            break
        progress(f"refining: error {max(value_error, slope_error):.1e}", number / _MOST_REFINEMENTS)
        factor *= steps_factor(excess)
        try:
            finer = program.with_steps(p, factor, [point.y for point in points])
        except DomainError:  # too many steps
            break
        # Numbers of steps are rounded: a factor near 1 may leave the program as it was.
        if finer.built is program.built:
            last = math.inf
            continue
        program, last = finer, excess
        finest = [solved_again(program, p, points[0])]
        for k, point in enumerate(points[1:], 1):
            if limit.passed(f"finer integration steps of {len(points) - k} optima"):
                break
            finest.append(solved_again(program, p, point))
        points = finest
    return program, points, tuple(_warnings(program, value_error, slope_error))


def _slope_error(program: Program, p: Vector, best: Point) -> float:
    """Return the error of derivatives at the best point, from the last check if that was at nearly the same design.

    It is 0 if IPOPT did not converge to an optimum from there.
    """
    if best.status == AS_FOUND:
        return 0.0
    if program.checked is not None and np.max(np.abs(program.checked[0] - best.y)) < SAME:
        return program.checked[1]
    return error_of_derivatives(program, best.y, p)


def _warnings(program: Program, value_error: float, slope_error: float) -> Iterator[str]:
    """Yield a warning for each of the two errors that is larger than wanted."""
    wanted, wanted_of_derivatives = program.wanted_error, program.wanted_of_derivatives
    # A program whose method has a fixed setting gets a warning above this relative gap.
    if wanted is None and value_error > 1e-6:
        yield (
            f"the optimiser's objective has a relative error of {value_error:.1e}: use more steps or a tighter"
            " tolerance"
        )
    if wanted is not None and not value_error <= wanted:  # also if the optimiser's objective is NaN
        yield f"the wanted relative error {wanted:.1e} of objective and limits was not reached: it is {value_error:.1e}"
    if slope_error > wanted_of_derivatives:
        yield (
            f"the wanted error {wanted_of_derivatives:.1e} of the motion's derivatives was not reached: it is"
            f" {slope_error:.1e}; the certificate and the sensitivities depend on them: use a tighter tolerance or more"
            " steps"
        )


def gap_of(program: Program, p: Vector, point: Point) -> float:
    """Return the relative difference between the optimiser's objective at a point and the tightly integrated one."""
    exact = float(program.exact_values(point.y, p)[0].item())
    return abs(point.f * program.objective_scale - exact) / max(abs(exact), SMALL * program.objective_scale)


def _violation(program: Program, p: Vector, point: Point) -> float:
    """Return the largest scaled violation of a requirement at a point by tight integration."""
    values = zip(program.exact_values(point.y, p)[1:], program.scales, strict=True)
    return program.violation(np.concatenate([np.ravel(value) / scale for value, scale in values] or [np.empty(0)]))


# Length of a step aside, as a fraction of a range.
_ASIDE: Final = 0.02


def flat_directions(program: Program, p: Vector, at: Point) -> list[Vector]:
    """Return the scaled directions along which designs as good as the optimum lie.

    Candidates are directions without curvature in the reduced Hessian. A candidate is confirmed by a step along it,
    after which the other variables are optimised again.
    """
    curvatures, directions = at.curvatures or curvatures_at(program, p, at)
    flat = np.flatnonzero(np.abs(curvatures) < Zero.curvature)
    return [directions[:, k] for k in flat if _confirmed(program, p, at, directions[:, k])]


def minimum_from(program: Program, p: Vector, at: Point) -> Point:
    """Return a stationary point with its curvatures or, if it is a maximum or a saddle, a lower optimum near it.

    IPOPT accepts any stationary point that it starts from. The reduced Hessian shows whether it is a minimum.

    Args:
        program: the design's program.
        p: parameters.
        at: the stationary point.
    """
    # At the top of a hill each descent may move a single variable.
    for _ in range(len(at.y) + 1):
        curvatures, directions = known = curvatures_at(program, p, at, exact=False)
        if not curvatures.size or curvatures[0] >= -Zero.curvature:
            return replace(at, curvatures=known)
        step = _ASIDE * directions[:, 0] / np.max(np.abs(directions[:, 0]))
        starts = [np.clip(at.y + sign * step, 0.0, 1.0) for sign in (1.0, -1.0)]
        points = [program.solve(start, p, SolveOptions(near=True, exact=False, enough=True)) for start in starts]
        found = [point for point in points if point.solved and point.f < at.f]
        if not found:
            return replace(at, curvatures=known)
        at = min(found, key=lambda point: point.f)
    return at


# Curvatures above this, relative to the Hessian's size, are positive: difference quotients are right to 1e-4.
_CLEAR = 1e-2


def curvatures_at(
    program: Program, p: Vector, at: Point, rows: tuple[Vector, Vector] | None = None, *, exact: bool = True
) -> tuple[Vector, Vector]:
    """Return the curvatures along the active limits, relative to the Hessian's size, ascending, and their directions.

    The directions are columns.

    Args:
        program: the design's program.
        p: parameters.
        at: a stationary point.
        rows: the scaled requirements and their Jacobian there, if they are known.
        exact: whether curvatures that are clearly positive may not come from difference quotients, which take a tenth
            of the time if runs are integrated side by side.
    """
    values, jacobian = rows or program.built.solver.requirements(at.y, p)
    margins, pulls = program.margins(values), np.abs(at.lam_g)
    active = (margins < Zero.margin) | decides(margins, pulls)
    # A bound without a multiplier does not stop a move away from it.
    bounds = decides(np.minimum(at.y, 1.0 - at.y), np.abs(at.lam_y))
    free = free_directions(np.vstack([jacobian[active], np.eye(len(at.y))[bounds]]))
    if not free.shape[1]:
        return np.empty(0), free
    if not exact and (quotients := _quotients(program, p, at.y)) is not None:
        found = reduced_curvatures(lagrangian(quotients[2], at.lam_g), free)
        if found[0][0] > _CLEAR:
            return found
    hessian = symmetric(np.asarray(program.built.rough.hess_lag(at.y, p, 1.0, at.lam_g)))
    if not np.all(np.isfinite(hessian)):
        # Second derivatives may overflow if the motion is so damped that it forgets its start at once.
        return np.empty(0), free[:, :0]
    return reduced_curvatures(hessian, free)


def _quotients(program: Program, p: Vector, y: Vector) -> tuple[Vector, Vector, Vector] | None:
    """Return `difference_quotients` at a design; None without a value, or if runs are integrated one by one."""
    landscape = Landscape(program, p)
    if not landscape.vectorised:
        return None
    return difference_quotients(lambda points: landscape.rows(points, finer=FINER, together=len(points)), y)


def _confirmed(program: Program, p: Vector, at: Point, direction: Vector) -> bool:
    """Return whether the objective stays the same after a step along a direction."""
    leading = int(np.argmax(np.abs(direction)))
    for sign in (1.0, -1.0):
        moved = at.y + sign * _ASIDE * direction / abs(direction[leading])
        if np.all((moved >= 0.0) & (moved <= 1.0)):
            there = program.solve(moved, p, SolveOptions(near=True), fixed=[leading])
            # The direction is flat if the objective changes by less than this fraction.
            return there.solved and abs(there.f - at.f) <= 1e-9 * max(1.0, abs(at.f))
    return False


NEEDLE = 0.05
"""An optimum is a needle, which no workshop can hit, if its median is above its own objective by this fraction: of the
objective's magnitude, and at least of a quarter of its typical size over all designs."""


class BoxSample:
    """The sample of a tolerance box."""

    designs: Final = 64
    seed: Final = 64


@dataclass(frozen=True)
class Spread:
    """Objective and margins of a design within its tolerances, from a sample of `BoxSample.designs` designs.

    Attributes:
        median: median objective of the designs that can be evaluated.
        worst: largest objective of these.
        margins: smallest margin of each requirement in the sample and at corners of the box (all of them with up to six
            variables), positive if met, in its unit.
        kept: fraction of the designs that meet all requirements. It is about a tenth if two limits are active: a share
            that must meet its limits as made needs a margin.
        needle: whether the median exceeds the design's own objective by more than 5 % (of a quarter of its median size
            between the bounds if it is smaller than that), or half of the designs cannot be evaluated.
    """

    median: float
    worst: float
    margins: dict[str, float]
    kept: float
    needle: bool

    def in_words(self) -> str:
        """Return a sentence about the design as made."""
        kept = f"; {100.0 * self.kept:.0f} % of the designs meet all requirements" if self.margins else ""
        return f"As made, within the tolerances: median objective {self.median:.6g}, worst {self.worst:.6g}{kept}."


def boxes(variables: Sequence[Variable], points: Vector, unit: Vector | None = None) -> Vector:
    """Return the sampled designs of the tolerance boxes around scaled designs, box after box.

    Args:
        variables: of the design.
        points: scaled designs, a row each.
        unit: designs in the unit box, a row each (default: `unit_box`).
    """
    unit = unit_box(len(variables)) if unit is None else unit
    found = np.empty((len(points), len(unit), len(variables)))
    for k, v in enumerate(variables):
        low, high = v.tolerance_interval(points[:, k, None])
        found[:, :, k] = low + (high - low) * unit[:, k]
    return found.reshape(-1, len(variables))


def spread(landscape: Landscape, y: Vector, objective: float) -> Spread | None:
    """Return the spread of a scaled design within its tolerances; None if runs are integrated one by one.

    Args:
        landscape: of the design.
        y: the scaled design.
        objective: the design's own objective, in its unit.
    """
    if not landscape.vectorised:
        return None
    program = landscape.program
    n = len(program.declared.variables)
    designs = boxes(program.declared.variables, y[None], np.vstack([unit_box(n), corners(n, BoxSample.designs)]))
    f, g = landscape.rows(designs, finer=FINER)
    everywhere, g_everywhere, f, g = np.isfinite(f), g, f[: BoxSample.designs], g[: BoxSample.designs]
    valid = np.isfinite(f)
    scale = landscape.objective_scale
    values = f[valid] * scale if np.any(valid) else np.array([objective])
    median = float(np.median(values))
    too_high = _too_high(landscape, np.array([median / scale]), np.array([objective / scale]))
    margins = program.least_margins(g_everywhere)[everywhere]
    least = margins.min(axis=0) if np.any(everywhere) else np.zeros(len(program.scales))
    return Spread(
        median=median,
        worst=float(values.max()),
        margins={
            r.name: float(margin * scale)
            for r, margin, scale in zip(program.declared.requirements, least, program.scales, strict=True)
        },
        kept=float(np.mean(landscape.violations(g).sum(axis=1) <= Violation.allowed)),
        needle=bool(too_high[0] or 2 * np.sum(valid) < len(valid)),
    )


def _too_high(landscape: Landscape, median: Vector, own: Vector) -> NDArray[np.bool_]:
    """Return for each design whether the median over its tolerances is a needle's; both in units of the merit."""
    everywhere = landscape.program.population(unit_box(landscape.dimensions), landscape.p)[0]
    sizes = np.abs(everywhere[np.isfinite(everywhere)]) / landscape.objective_scale
    typical = float(np.median(sizes)) if len(sizes) else 0.0
    return np.asarray(median - own > NEEDLE * np.maximum(np.abs(own), SMALL * typical))


def corners(n: int, most: int) -> Vector:
    """Return the corners of the unit box, a row each; of more than ``most``, only those nearest to a sample."""
    if n < most.bit_length():
        return np.array([*itertools.product((0.0, 1.0), repeat=n)])
    return np.unique(np.round(unit_box(n)[:most]), axis=0)


@lru_cache(maxsize=16)
def unit_box(n: int) -> Vector:
    """Return the designs sampled in the unit box, a row each. The first of them are evenly spread, too."""
    return even_points(n, BoxSample.designs, np.random.default_rng(BoxSample.seed))
