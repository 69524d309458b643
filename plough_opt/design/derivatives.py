"""Enough integration steps for a program: for objective and limits at its optima, and for derivatives at the best."""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from plough_opt.core.errors import DomainError, InputError
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.nlp import RunGroup
from plough_opt.design.polishing import AS_FOUND, solved_again
from plough_opt.design.program import Program
from plough_opt.motion.batch.many_runs import ManyRuns
from plough_opt.motion.derivatives import derivative_error, difference_of_jets, finer_than
from plough_opt.motion.plan import summed_rate
from plough_opt.motion.runge_kutta import pairs

SMALL = 0.25
"""Part of the program's scale below which an objective is next to nothing, and errors are relative to the scale."""

# Times that more steps are taken, while each brings what is missed down to this part at least.
_REFINEMENTS, _FALLS = 4, 0.5
# Above this gap a design by a method with its own setting carries a warning.
_COARSE = 1e-6
# Steps to an error are more by this power of how far it was missed, and at once by no more than this factor.
_ORDER, _COARSER_BY = 0.125, 3.0
# Relative change of a parameter by which derivatives are taken as differences: by so much of the run's phase [rad], and
# no more than the second. What differences miss is a hundredth of an error, and rounding 1e-12 of the derivatives.
_OF_PHASE, _MOST_CHANGE = 0.3, 0.03
# Scaled designs nearer than this have the same error.
_NEAR = 1e-3
# Runs of a structure that are compared, of however many there are.
_MOST_RUNS = 8


def error_of_derivatives(program: Program, y: Vector, p: Vector) -> float:
    """Return the largest error of the derivatives of a program's runs at a scaled design."""
    return max((_error(own, own.inputs(y, p).full()) for own in program.built.plain.groups), default=0.0)


def _error(own: RunGroup, theta: Vector) -> float:
    """Return the largest error of the derivatives of alike runs, from their parameters, a column for each."""
    many = _side_by_side(own)
    found = math.nan
    if many is not None:
        chosen = np.unique(np.linspace(0, theta.shape[1] - 1, _MOST_RUNS).round().astype(int))
        found = max(error_by_differences(own, p, many) for p in theta.T[chosen])
    return derivative_error(own.solver, own.first, own.varying, theta) if math.isnan(found) else found


def _side_by_side(own: RunGroup) -> ManyRuns | None:
    """Return what follows very many of alike runs by their own steps in machine code, if anything does.

    Equal steps are all the same to both where nothing is read between them and none ends at a kink.
    """
    solver = own.solver
    structure = solver.structure
    if not (own.first and own.varying and structure.stepped and solver.accuracy.order_8):
        return None
    if structure.kinked or structure.ramp:
        return None
    try:
        many = ManyRuns(structure, 0)
    except InputError:  # an operation without a vector form
        return None
    return many if many.compiled else None


def error_by_differences(own: RunGroup, p: Vector, many: ManyRuns) -> float:
    """Return what `derivative_error` does of one run, its derivatives as differences of runs; NaN without a value.

    Differences of runs of equal steps are those of the steps' own derivatives, so that what they miss of these is
    nearly the same for few steps as for more.

    Args:
        own: the run's kind; of it no more than averages is asked for.
        p: its parameters, the duration last.
        many: follows runs of its structure.
    """
    count = len(own.varying)
    phase = float(summed_rate(dict(zip(own.solver.names, map(float, p), strict=False)))) * float(p[-1])
    step = min(_MOST_CHANGE, _OF_PHASE / max(phase, _OF_PHASE))
    first, second = np.array(pairs(count)).T
    directions = np.zeros((1 + 2 * len(first), count))
    for part, sign in ((slice(1, None, 2), 1.0), (slice(2, None, 2), -1.0)):
        np.put_along_axis(directions[part], np.column_stack([first, second]), sign, axis=1)
    given = np.repeat(p[None], len(directions), axis=0)
    given[:, list(own.varying)] *= 1.0 + step * directions
    used, better = (
        _jet(many(given, count=len(solver.timeline.nodes) - 1), (first, second), step, own.first)
        for solver in (own.solver, finer_than(own.solver))
    )
    if not (np.all(np.isfinite(used)) and np.all(np.isfinite(better))):
        return math.nan
    return difference_of_jets(own.solver, p, used, better, own.first)


def _jet(results: Vector, both: tuple[np.ndarray, np.ndarray], step: float, missing: int) -> Vector:
    """Return value, first and second derivatives of results, columns as those of `plough_opt.motion.derivatives`.

    Args:
        results: at a place, then upwards and downwards along the sum of each pair of parameters, a row each.
        both: the pairs, the first and the second of each; those of a parameter with itself are along it alone.
        step: the change of each.
        missing: rows of zeros that come before those of the results.
    """
    value, up, down = results[0], results[1::2], results[2::2]
    alone = np.flatnonzero(both[0] == both[1])
    slopes = (up[alone] - down[alone]) / (2.0 * step)
    bends = (up - 2.0 * value + down) / step**2
    apart = (both[0] != both[1])[:, None]
    mixed = np.where(apart, 0.5 * (bends - bends[alone[both[0]]] - bends[alone[both[1]]]), bends)
    jet = np.vstack([value, slopes, mixed]).T
    return np.vstack([np.zeros((missing, jet.shape[1])), jet])


def build_surely(program: Program, p: Vector, starts: Sequence[Vector]) -> None:
    """Write the program for designs, with so many steps that derivatives at the first of them reach the wanted error.

    Args:
        program: prepared.
        p: parameters.
        starts: scaled designs.

    Raises:
        InputError, DomainError: as `Program.build`.
    """
    program.build(p, starts=starts)
    error, wanted = _known_error(program, starts[0], p), _wanted(program)
    if error > wanted:
        with contextlib.suppress(DomainError):  # too many steps
            program.build(p, _times(error / wanted), starts)


def _wanted(program: Program) -> float:
    """Return the wanted error of a program's derivatives."""
    return min((run.integration.accuracy.wanted_derivatives for run in program.exact.runs), default=math.inf)


def _times(missed: float) -> float:
    """Return by what factor more steps there are to be where an error is so many times what it should be."""
    return min(_COARSER_BY, 1.1 * missed**_ORDER) if missed < math.inf else _COARSER_BY


def _known_error(program: Program, y: Vector, p: Vector) -> float:
    """Return `error_of_derivatives`, or what that was beside the design at the last check."""
    checked = program.built.checked
    if checked is None or not np.array_equal(checked[0], p) or np.max(np.abs(checked[1] - y)) >= _NEAR:
        checked = program.built.checked = p, y, error_of_derivatives(program, y, p)
    return checked[2]


def with_enough_steps(
    program: Program, p: Vector, points: list[Point], progress: Callable[[str, float], None]
) -> tuple[list[Point], tuple[str, ...]]:
    """Take more steps until objective and limits of points, and derivatives at the best, are right, or say so.

    Objective and limits are to be those of the tight integration, derivatives those of finer steps. Kinks, across which
    derivatives lose more than values, call for more steps than the objective does.

    Args:
        program: built.
        p: parameters.
        points: optima, the best first.
        progress: called with what is being done.

    Returns:
        The points, and what a reader must know where an error is not reached.
    """
    wanted, factor, last = program.wanted_error, program.built.refinement, math.inf
    for number in range(_REFINEMENTS + 1):
        off, unsure = _off(program, p, points), _derivatives_off(program, p, points[0])
        missed = max(off / (wanted or math.inf), unsure / _wanted(program))
        # A motion may be too sensitive for any number of steps.
        if missed <= 1.0 or missed > _FALLS * last or number == _REFINEMENTS:
            break
        before = program.built
        progress(f"refining: error {max(off, unsure):.1e}", number / _REFINEMENTS)
        factor *= _times(missed)
        try:
            program.build(p, factor, [point.y for point in points])
        except DomainError:  # too many steps
            break
        # So few more may be no more, as numbers of steps are rounded.
        last = math.inf if program.built is before else missed
        if program.built is not before:
            points = [solved_again(program, p, point) for point in points]
    return points, tuple(_shortcomings(program, off, unsure))


def _off(program: Program, p: Vector, points: Sequence[Point]) -> float:
    """Return the largest relative gap of points' objectives, or of a limit that the tight run breaks by more."""
    return max(max(gap_of(program, p, point), broken_by(program, p, point)) for point in points)


def _derivatives_off(program: Program, p: Vector, best: Point) -> float:
    """Return the error of derivatives at the best point; none of one that IPOPT could not follow to an optimum."""
    return 0.0 if best.status == AS_FOUND else _known_error(program, best.y, p)


def _shortcomings(program: Program, off: float, unsure: float) -> Iterator[str]:
    wanted, sure = program.wanted_error, _wanted(program)
    if wanted is None and off > _COARSE:
        yield f"the optimiser's objective is off by a relative {off:.1e}: take more steps or a tighter tolerance"
    if wanted is not None and off > wanted:
        yield f"the wanted relative error {wanted:.1e} of objective and limits was not reached: it is {off:.1e}"
    if unsure > sure:
        yield (
            f"the wanted error {sure:.1e} of the motion's derivatives was not reached: it is {unsure:.1e}; the"
            " certificate and the sensitivities rest on them: take a tighter tolerance, or more steps"
        )


def gap_of(program: Program, p: Vector, point: Point) -> float:
    """Return the relative difference of the optimiser's objective at a point from the tightly integrated one."""
    exact = float(program.exact_values(point.y, p)[0][0].item())
    return abs(point.f * program.objective_scale - exact) / max(abs(exact), SMALL * program.objective_scale)


def broken_by(program: Program, p: Vector, point: Point) -> float:
    """Return by what part of its size the most broken requirement is beyond its limit in the tight integration."""
    values = zip(program.exact_values(point.y, p)[0][1:], program.scales, strict=True)
    g = np.concatenate([np.ravel(value) / scale for value, scale in values] or [np.empty(0)])
    return float(np.max(np.maximum(program.low - g, g - program.high), initial=0.0))
