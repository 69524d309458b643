"""Correctors of the path following: from a predicted design to the optimum near it, by quadratic programs.

`Corrector` uses the exact slopes of the program. `BatchCorrector` integrates a design and its neighbours side by side
and takes slopes from their differences, which is some twenty times as fast.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.descents import descend
from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.landscape import Landscape
from plough_opt.design.optimality import (
    PULLS,
    free_directions,
    made_convex,
    optimum_step,
    reduced_curvatures,
    residual,
    symmetric,
    without_rounding,
)
from plough_opt.design.program import Program

# Most steps of one correction.
_MOST_STEPS: Final = 15
# Longest step of a scaled variable. A design farther away is not a neighbour on the same branch.
_LONGEST_STEP: Final = 0.3
# A step counts as progress if it is shorter than this part of the shortest one before it.
_PROGRESS: Final = 0.7
# Steps in a row without progress after which a correction is given up.
_PATIENCE: Final = 4
# A limit whose scaled margin is smaller is active.
_TOUCHING: Final = 1e-7
# Threshold of Powell's damping: the least curvature along a step, relative to that of the present estimate.
_DAMPED: Final = 0.2
# Over shorter steps the change of a gradient is mostly rounding, so the curvature is not updated.
_LEAST_UPDATE_STEP: Final = 1e-9
# Factor on the number of integration steps of a search. It leaves averages with errors of some 1e-10, outputs 1e-8.
_FINER: Final = 4.0
# Step of differences for slopes, between the rounding of a run (some 1e-13) and the error by its third derivatives.
_SLOPE_STEP: Final = 3e-6
# Step of differences for curvatures, which only guide the steps and may be rough.
_CURVATURE_STEP: Final = 1e-4
# Residual of the first-order conditions that slopes by differences can reach: they have errors of some 1e-7.
_BATCH_RESIDUAL: Final = 5e-7


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
        self._slopes: dict[bytes, Slopes] = {}
        self._values: dict[bytes, tuple[Vector, Vector]] = {}

    def values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return scaled objective and requirements, cached by design and parameters."""
        key = y.tobytes() + p.tobytes()
        if key not in self._values:
            self._values[key] = self._evaluate(y, p)
        return self._values[key]

    def _evaluate(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        f, g = self._built.nlp.values(y, p)
        return np.array(f.nonzeros()), np.array(g.nonzeros())

    def slopes(self, y: Vector, p: Vector) -> Slopes:
        """Return scaled values and first derivatives, cached by design and parameters."""
        key = y.tobytes() + p.tobytes()
        if key not in self._slopes:
            self._slopes[key] = self._differentiate(y, p)
        return self._slopes[key]

    def _differentiate(self, y: Vector, p: Vector) -> Slopes:
        f, g, gradient, jacobian = (np.asarray(result) for result in self._built.nlp.slopes(y, p))
        return Slopes(f.ravel(), g.ravel(), gradient.ravel(), jacobian)

    def residual(self, point: Point, p: Vector) -> float:
        """Return the scaled residual of the first-order conditions at a point."""
        _, g, gradient, jacobian = self.slopes(point.y, p)
        return residual(point, (g, gradient, jacobian), self._limits)

    def least_curvature(self, point: Point, p: Vector) -> float | None:
        """Return the least curvature of the Lagrangian along directions that keep every active limit.

        Returns:
            Curvature relative to the largest of the Lagrangian, by a rough integration; None if the active limits leave
            no direction free.
        """
        _, g, _, jacobian = self.slopes(point.y, p)
        low, high = self._limits
        active_rows = _are_active(np.minimum(g - low, high - g), point.lam_g)
        active_bounds = _are_active(np.minimum(point.y, 1.0 - point.y), point.lam_y)
        free = free_directions(np.concatenate([jacobian[active_rows], np.eye(len(point.y))[active_bounds]]))
        if not free.size:
            return None
        hessian = symmetric(np.asarray(self._built.rough.hess_lag(point.y, p, 1.0, point.lam_g)))
        return float(reduced_curvatures(hessian, free)[0][0])

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
                point = self._iterate(begin, initial, p)
            except (RuntimeError, ValueError):  # a run without an orbit, a finite value or an end
                continue
            if point.solved:
                return point
        return begin

    def _iterate(self, point: Point, curvature: Vector, p: Vector) -> Point:
        """Take steps until the first-order conditions hold; ``solved`` stays False if they cease to shrink."""
        stalled, shortest = 0, np.inf
        for number in range(_MOST_STEPS):
            f, g, gradient, jacobian = self.slopes(point.y, p)
            y = point.y
            found = optimum_step(curvature, y, (g, gradient, jacobian), self._limits, _LONGEST_STEP)
            if found is None:
                return point
            step, lam_g, lam_y = found
            point = replace(point, f=float(f[0]), lam_g=lam_g, lam_y=without_rounding(y, lam_y))
            if self.residual(point, p) <= self.largest_residual:
                self._curvature = curvature
                return replace(point, solved=True, status="Solve_Succeeded", iterations=number)
            size = float(np.max(np.abs(step)))
            stalled = 0 if size < _PROGRESS * shortest else stalled + 1
            shortest = min(size, shortest)
            if stalled >= _PATIENCE:
                return point
            point = replace(point, y=np.clip(y + step, 0.0, 1.0), lam_y=lam_y)
            if size > _LEAST_UPDATE_STEP:
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
        point = self._program.solve(start, p, SolveOptions(near=True))
        return point if point.solved else self._program.solve(start, p)


class BatchCorrector(Corrector):
    """Corrector with slopes by differences of designs that are integrated side by side.

    Attributes:
        largest_residual: as of `Corrector`, but with room for the errors of differences. It grows with the objectives'
            sizes in units of their ranges, because the rounding of objectives does so too.
    """

    def __init__(self, program: Program) -> None:
        """Use a program that is built."""
        super().__init__(program)
        self.largest_residual = _BATCH_RESIDUAL
        self._scale = np.array(program.scales)[np.array(program.owner, dtype=int)]

    def set_largest_objective(self, size: float) -> None:
        """Set the largest objective, in units of its range over the front."""
        self.largest_residual = _BATCH_RESIDUAL * max(1.0, size)

    def _evaluate(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        f, g = self._integrate(y[None], p)
        return f, g[0]

    def _differentiate(self, y: Vector, p: Vector) -> Slopes:
        stencil, steps = _stencil(y)
        return _differences(*self._integrate(stencil, p), steps)

    def _integrate(self, designs: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return scaled objective and requirements, a row for each design, all with the same number of steps."""
        with np.errstate(all="ignore"):
            f, g = self._program.population(designs, p, finer=_FINER, together=len(designs))
        return f, g / self._scale

    def solve_from_afar(self, neighbour: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start from which `correct` fails: a descent of the search, then corrected.

        Args:
            neighbour: optimum whose multipliers to begin with.
            start: scaled variables.
            p: parameters.
        """
        end = descend(Landscape(self._program, p), start)
        if not end.feasible[0]:
            return replace(neighbour, solved=False, status="Infeasible_Problem_Detected", y=end.points[0])
        return self.correct(neighbour, end.points[0], p)

    def _initial_curvature(self, y: Vector, p: Vector, lam_g: Vector) -> Vector:
        """Return the Hessian of the Lagrangian by differences of slopes, made positive definite."""
        moves = np.where(y > 0.5, -_CURVATURE_STEP, _CURVATURE_STEP)
        stencils = [_stencil(place) for place in (y, *(y + np.diag(moves)))]
        f, g = self._integrate(np.vstack([designs for designs, _ in stencils]), p)
        count, slopes = len(stencils[0][0]), []
        for k, (_, steps) in enumerate(stencils):
            rows = slice(k * count, (k + 1) * count)
            own = _differences(f[rows], g[rows], steps)
            slopes.append(own.gradient + own.jacobian.T @ lam_g)
        hessian = (np.array(slopes[1:]) - slopes[0]) / moves[:, None]
        return made_convex((hessian + hessian.T) / 2.0)


def _are_active(margins: Vector, multipliers: Vector) -> NDArray[np.bool_]:
    """Return which limits are active: their scaled margin vanishes, or is smaller than their multiplier."""
    pulls = np.abs(multipliers)
    return (margins < _TOUCHING) | ((pulls > PULLS) & (pulls > margins))


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
    if measured < _DAMPED * expected:
        share = (1.0 - _DAMPED) * expected / (expected - measured)
        change = share * change + (1.0 - share) * along
        measured = float(step @ change)
    return np.asarray(curvature - np.outer(along, along) / expected + np.outer(change, change) / measured)


def _stencil(y: Vector) -> tuple[Vector, Vector]:
    """Return the designs whose differences give the slopes at a design, a row each, and the signed steps to them.

    Rows are the design itself, then one step along each variable, then two; all steps point to the middle of a range.
    """
    steps = np.where(y > 0.5, -_SLOPE_STEP, _SLOPE_STEP)
    return np.vstack([y, y + np.diag(steps), y + 2.0 * np.diag(steps)]), steps


def _differences(f: Vector, g: Vector, steps: Vector) -> Slopes:
    """Return slopes by one-sided differences of second order.

    Args:
        f: objective at each design of a stencil.
        g: requirements at each design of the stencil, a row each.
        steps: of the stencil.
    """
    n = len(steps)
    gradient, jacobian = (
        ((4.0 * (own[1 : n + 1] - own[0]) - (own[n + 1 :] - own[0])).T / (2.0 * steps)) for own in (f, g)
    )
    return Slopes(f[:1], g[0], gradient, jacobian)
