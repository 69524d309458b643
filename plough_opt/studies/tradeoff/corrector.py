"""The corrector of a front: sequential quadratic programs with exact slopes, from a neighbour's multipliers."""

from collections.abc import Hashable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.optimality import Zero, made_convex, optimum_step, symmetric
from plough_opt.design.model.program import Program, cached


class _Correction:
    """Bounds of a correction's steps, and of the updates of its curvature."""

    most_steps: Final = 15
    longest: Final = 0.3  # step of a scaled variable; a design farther away is not a neighbour on the same branch
    shrinking: Final = 0.7  # A step counts as progress if it is shorter than this part of the shortest one before it.
    patience: Final = 4  # steps in a row without progress after which a correction is given up
    # Threshold of Powell's damping: the least curvature along a step, relative to that of the present estimate.
    damped: Final = 0.2
    # Over shorter steps the change of a gradient is mostly rounding, so the curvature is not updated.
    shortest_update: Final = 1e-9


class Slopes(NamedTuple):
    """Scaled values and first derivatives at a design.

    Attributes:
        f: objective, shape (1,).
        g: requirements, shape (m,).
        gradient: of the objective, shape (n,).
        jacobian: of the requirements, shape (m, n).
    """

    f: Vector
    g: Vector
    gradient: Vector
    jacobian: Vector


class Corrector:
    """Corrector with the exact slopes of a program as it was when the corrector was made.

    Attributes:
        largest_residual: scaled residual of the first-order conditions below which a design counts as an optimum.
    """

    largest_residual = 1e-10

    def __init__(self, program: Program) -> None:
        """Use a program that is built."""
        self._program, self._built = program, program.built
        self._limits = program.low, program.high
        self._curvature: Vector | None = None
        self._slopes: dict[Hashable, Slopes] = {}
        self._values: dict[Hashable, tuple[Vector, Vector]] = {}

    def values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return scaled objective and requirements, cached by design and parameters."""
        return cached(self._values, (y.tobytes(), p.tobytes()), lambda: self._evaluate(y, p), np.inf)

    def _evaluate(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        f, g = self._built.nlp.values(y, p)
        return np.array(f.nonzeros()), np.array(g.nonzeros())

    def slopes(self, y: Vector, p: Vector) -> Slopes:
        """Return scaled values and first derivatives, cached by design and parameters."""
        return cached(self._slopes, (y.tobytes(), p.tobytes()), lambda: self._differentiate(y, p), np.inf)

    def _differentiate(self, y: Vector, p: Vector) -> Slopes:
        f, g, gradient, jacobian = (np.asarray(result) for result in self._built.nlp.slopes(y, p))
        return Slopes(f.ravel(), g.ravel(), gradient.ravel(), jacobian)

    def residual(self, point: Point, p: Vector) -> float:
        """Return the scaled residual of the first-order conditions at a point."""
        _, g, gradient, jacobian = self.slopes(point.y, p)
        return residual(point, (g, gradient, jacobian), self._limits)

    def correct(self, neighbour: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start, by quadratic programs from a neighbour's multipliers.

        The estimate of the Lagrangian's curvature is updated from the change of its gradient (Powell 1978) and kept
        for the next solve: along a front it hardly changes, so that a few steps suffice.

        Args:
            neighbour: optimum whose multipliers to begin with.
            start: scaled variables.
            p: parameters.

        Returns:
            The optimum; or a point with ``solved=False`` if the steps lead to none.
        """
        begin = replace(neighbour, solved=False, status="Search_Direction_Becomes_Too_Small", y=start)
        kept, self._curvature = self._curvature, None
        # A kept curvature may belong to another branch; if it fails, begin again with that of the start.
        for curvature in (kept, None) if kept is not None else (None,):
            try:
                initial = self._initial_curvature(start, p, neighbour.lam_g) if curvature is None else curvature
                point = self.iterate(begin, initial, p)
            except (RuntimeError, ValueError):  # a run without an orbit, a finite value or an end
                continue
            if point.solved:
                return point
        return begin

    def iterate(self, point: Point, curvature: Vector, p: Vector, most: int = _Correction.most_steps) -> Point:
        """Return the optimum to which steps lead from a point; it is not ``solved`` if they cease to shrink.

        Args:
            point: with the scaled variables and the multipliers to begin with.
            curvature: of the Lagrangian there, positive definite.
            p: parameters.
            most: number of steps after which to give up.
        """
        stalled, shortest = 0, np.inf
        for number in range(most):
            f, g, gradient, jacobian = self.slopes(point.y, p)
            y = point.y
            solution = optimum_step(curvature, y, (g, gradient, jacobian), self._limits, _Correction.longest)
            if solution is None:
                return point
            step, lam_g, lam_y = solution
            point = replace(point, f=float(f[0]), lam_g=lam_g, lam_y=without_rounding(y, lam_y))
            if self.residual(point, p) <= self.largest_residual:
                self._curvature = curvature
                return replace(point, solved=True, status="Solve_Succeeded", iterations=number)
            size = float(np.max(np.abs(step)))
            stalled = 0 if size < _Correction.shrinking * shortest else stalled + 1
            shortest = min(size, shortest)
            if stalled >= _Correction.patience:
                return point
            point = replace(point, y=np.clip(y + step, 0.0, 1.0), lam_y=lam_y)
            if size > _Correction.shortest_update:
                _, _, next_gradient, next_jacobian = self.slopes(point.y, p)
                change = next_gradient - gradient + (next_jacobian - jacobian).T @ lam_g
                curvature = _updated(curvature, step, change)
        return point

    def _initial_curvature(self, y: Vector, p: Vector, lam_g: Vector) -> Vector:
        """Return the Hessian of the Lagrangian, by a rough integration, made positive definite."""
        return made_convex(symmetric(np.asarray(self._built.rough.hess_lag(y, p, 1.0, lam_g))))

    def solve_from_afar(self, neighbour: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start from which `correct` fails, by IPOPT.

        Args:
            neighbour: unused here; IPOPT finds its own multipliers.
            start: scaled variables.
            p: parameters.
        """
        del neighbour
        # Exact curvatures come last: around periodic orbits they take thirty times as long, and seldom help.
        for options in (SolveOptions(near=True, exact=False), SolveOptions(exact=False), SolveOptions(True, True)):
            point = self._program.solve(start, p, options)
            if point.solved or (not options.near and point.status == "Infeasible_Problem_Detected"):
                break
        return point


def _updated(curvature: Vector, step: Vector, change: Vector) -> Vector:
    """Return the BFGS update of a curvature, with Powell's damping, which keeps it positive definite.

    Args:
        curvature: estimate before the step.
        step: of the scaled variables.
        change: of the Lagrangian's gradient over the step.
    """
    along = curvature @ step
    expected = float(step @ along)
    if expected <= np.finfo(float).tiny:
        return curvature
    measured = float(step @ change)
    if measured < _Correction.damped * expected:
        share = (1.0 - _Correction.damped) * expected / (expected - measured)
        change = share * change + (1.0 - share) * along
        measured = float(step @ change)
    return np.asarray(curvature - np.outer(along, along) / expected + np.outer(change, change) / measured)


def without_rounding(y: Vector, lam_y: Vector) -> Vector:
    """Return the multipliers of bounds, set to 0 for variables that lie on neither bound."""
    return np.where((y > Zero.distance) & (y < 1.0 - Zero.distance), 0.0, lam_y)


def residual(point: Point, at: tuple[Vector, Vector, Vector], limits: tuple[Vector, Vector]) -> float:
    """Return how far a point is from the first-order conditions.

    The result is the larger of the Lagrangian's slope and of any multiplier times its margin, both relative to the
    largest multiplier if that exceeds 1, plus the largest violation of a limit.

    Args:
        point: the point.
        at: requirements, gradient and Jacobian there, scaled.
        limits: lower and upper limits of the requirements, scaled.
    """
    (g, gradient, jacobian), (low, high) = at, limits
    values, multipliers = np.concatenate([g, point.y]), np.concatenate([point.lam_g, point.lam_y])
    low, high = np.concatenate([low, np.zeros(len(point.y))]), np.concatenate([high, np.ones(len(point.y))])
    slope = gradient + jacobian.T @ point.lam_g + point.lam_y
    violation = np.max(np.maximum(low - values, values - high), initial=0.0)
    margins = np.where(multipliers > 0.0, high - values, values - low)
    # A limit at infinity must have a multiplier of 0: a margin of 1 counts any other in full.
    products = np.max(np.abs(multipliers) * np.where(np.isfinite(margins), np.abs(margins), 1.0))
    return float(max(np.max(np.abs(slope)), products) / max(1.0, np.max(np.abs(multipliers))) + violation)
