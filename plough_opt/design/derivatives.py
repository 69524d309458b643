"""Derivatives of a program's runs at its best design: whether they reach the wanted error, by more steps if need be."""

from __future__ import annotations

import math

from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.polishing import AS_FOUND, solved_again
from plough_opt.design.program import Program
from plough_opt.errors import DomainError
from plough_opt.motion.derivative_error import derivative_error

_REFINEMENTS = 4
# Steps to an error are more by this power of how far it was missed, and at once by no more than this factor.
_ORDER, _COARSER_BY = 0.125, 3.0


def error_of_derivatives(program: Program, y: Vector, p: Vector) -> float:
    """Return the largest error of the derivatives of a program's runs at a scaled design."""
    pairs = [(own, own.inputs(y, p).full()) for own in program.nlp.alike]
    return max((derivative_error(own.solver, own.first, own.varying, theta) for own, theta in pairs), default=0.0)


def with_sure_derivatives(program: Program, p: Vector, points: list[Point]) -> tuple[list[Point], tuple[str, ...]]:
    """Take more integration steps until derivatives at the best point are those of finer ones, or say that they miss.

    More steps than for the objective are called for by kinks, across which derivatives lose more than values.
    """
    if points[0].status == AS_FOUND:  # which IPOPT could not follow to an optimum
        return points, ()
    wanted = min((run.integration.accuracy.wanted_derivatives for run in program.exact.runs), default=math.inf)
    error, factor = error_of_derivatives(program, points[0].y, p), 1.0
    for _ in range(_REFINEMENTS):
        if error <= wanted:
            return points, ()
        factor *= min(_COARSER_BY, 1.1 * (error / wanted) ** _ORDER)
        before = program.nlp
        try:
            program.build(p, factor, [point.y for point in points])
        except DomainError:  # too many steps
            break
        if program.nlp is not before:
            points = [solved_again(program, p, point) for point in points]
            error = error_of_derivatives(program, points[0].y, p)
    if error <= wanted:
        return points, ()
    return points, (
        f"the wanted error {wanted:.1e} of the motion's derivatives was not reached: it is {error:.1e}; the certificate"
        " and the sensitivities rest on them: take a tighter tolerance, or more steps",
    )
