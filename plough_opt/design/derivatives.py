"""Refinement of a program's integration steps until objective, limits and derivatives are accurate enough.

Objective and limits are compared with tight integration at every optimum, derivatives with those of finer steps at the
best one.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from plough_opt.core.errors import DomainError
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.polishing import AS_FOUND, solved_again
from plough_opt.design.program import Program
from plough_opt.motion.derivatives import derivative_error

SMALL = 0.25
"""Objectives below this part of the program's scale count as small: their errors are relative to the scale."""

_MOST_REFINEMENTS = 4
# A refinement must reduce the excess of the error to this part of the last one; otherwise more steps do not help.
_PROGRESS = 0.5
# A program whose method has a fixed setting gets a warning above this relative gap.
_COARSE = 1e-6
# An error e times too large takes e to this power times as many steps: the method has order 8.
_STEPS_EXPONENT = 0.125
# Largest factor on the number of steps in one refinement.
_MOST_STEPS_FACTOR = 3.0
# Within this distance of a scaled design the error of derivatives is not measured again.
_SAME_ERROR = 1e-3


def error_of_derivatives(program: Program, y: Vector, p: Vector) -> float:
    """Return the largest error of the derivatives of a program's runs at a scaled design."""
    known, at = program.built.errors, (y.tobytes(), p.tobytes())
    if at not in known:
        known.clear()
        known[at] = max(
            (
                derivative_error(group.solver, group.first, group.varying, group.inputs(y, p).full())
                for group in program.built.plain.groups
            ),
            default=0.0,
        )
    return known[at]


def with_sure_steps(program: Program, p: Vector, starts: Sequence[Vector]) -> Program:
    """Return a program with steps for certain designs, enough for accurate derivatives at the first of them.

    Args:
        program: scaled.
        p: parameters.
        starts: scaled designs.

    Raises:
        InputError, DomainError: as `Program.with_steps`.
    """
    program = program.with_steps(p, starts=starts)
    error, wanted = error_of_derivatives(program, starts[0], p), _wanted_of_derivatives(program)
    if error > wanted:
        with contextlib.suppress(DomainError):  # too many steps
            return program.with_steps(p, _steps_factor(error / wanted), starts)
    return replace(program, checked=(starts[0], error))


def _wanted_of_derivatives(program: Program) -> float:
    """Return the error that a program's derivatives should reach."""
    return min((run.integration.accuracy.wanted_derivatives for run in program.exact.runs), default=math.inf)


def _steps_factor(excess: float) -> float:
    """Return the factor on the number of steps that reduces an error by the factor ``excess``, with a margin."""
    return min(_MOST_STEPS_FACTOR, 1.1 * excess**_STEPS_EXPONENT) if excess < math.inf else _MOST_STEPS_FACTOR


def _known_error(program: Program, y: Vector, p: Vector) -> float:
    """Return `error_of_derivatives`, from the last check if that was at nearly the same design."""
    if program.checked is not None and np.max(np.abs(program.checked[0] - y)) < _SAME_ERROR:
        return program.checked[1]
    return error_of_derivatives(program, y, p)


def with_enough_steps(
    program: Program, p: Vector, points: list[Point], progress: Callable[[str, float], None]
) -> tuple[Program, list[Point], tuple[str, ...]]:
    """Refine the steps, and solve again, until the points are accurate or more steps do not help.

    Across kinks derivatives lose more accuracy than values do, so they may need more steps than the objective.

    Args:
        program: with integration steps.
        p: parameters.
        points: optima, best first.
        progress: called with what is being done and the fraction done.

    Returns:
        The program, the points, and a warning for each error that is still too large.
    """
    wanted, factor, last = program.wanted_error, program.refinement, math.inf
    for number in range(_MOST_REFINEMENTS + 1):
        value_error, slope_error = _value_error(program, p, points), _slope_error(program, p, points[0])
        excess = max(value_error / (wanted or math.inf), slope_error / _wanted_of_derivatives(program))
        # A motion may be too sensitive for any number of steps.
        if excess <= 1.0 or excess > _PROGRESS * last or number == _MOST_REFINEMENTS:
            break
        progress(f"refining: error {max(value_error, slope_error):.1e}", number / _MOST_REFINEMENTS)
        factor *= _steps_factor(excess)
        try:
            finer = program.with_steps(p, factor, [point.y for point in points])
        except DomainError:  # too many steps
            break
        # Numbers of steps are rounded: a factor near 1 may leave the program as it was.
        if finer.built is program.built:
            last = math.inf
            continue
        program, last = finer, excess
        points = [solved_again(program, p, point) for point in points]
    return program, points, tuple(_warnings(program, value_error, slope_error))


def _value_error(program: Program, p: Vector, points: Sequence[Point]) -> float:
    """Return the largest relative error of the objective at any point, or violation of a limit if that is larger."""
    return max(max(gap_of(program, p, point), _violation(program, p, point)) for point in points)


def _slope_error(program: Program, p: Vector, best: Point) -> float:
    """Return the error of derivatives at the best point, or 0 if IPOPT did not converge to an optimum from there."""
    return 0.0 if best.status == AS_FOUND else _known_error(program, best.y, p)


def _warnings(program: Program, value_error: float, slope_error: float) -> Iterator[str]:
    """Yield a warning for each of the two errors that is larger than wanted."""
    wanted, wanted_of_derivatives = program.wanted_error, _wanted_of_derivatives(program)
    if wanted is None and value_error > _COARSE:
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
    exact = float(program.exact_values(point.y, p)[0][0].item())
    return abs(point.f * program.objective_scale - exact) / max(abs(exact), SMALL * program.objective_scale)


def _violation(program: Program, p: Vector, point: Point) -> float:
    """Return the largest scaled violation of a requirement at a point by tight integration."""
    values = zip(program.exact_values(point.y, p)[0][1:], program.scales, strict=True)
    g = np.concatenate([np.ravel(value) / scale for value, scale in values] or [np.empty(0)])
    return float(np.max(np.maximum(program.low - g, g - program.high), initial=0.0))
