"""From a neighbouring optimum to the one beside it, by sequential quadratic programming.

With exact slopes, or by the steps of a batch with slopes by differences, which is some twenty times as fast.
"""

from dataclasses import replace
from typing import Final

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

_STEPS: Final = 15
# Longest step in a scaled variable: beyond it a neighbour is none.
_LONGEST: Final = 0.3
# Steps that do not shrink so often lead nowhere.
_PATIENCE: Final = 4
# Scaled margins below this leave no room.
_TOUCHING: Final = 1e-7
# Of Powell's damping.
_DAMPED: Final = 0.2
# Changes of gradients over shorter steps are rounding.
_TELLING: Final = 1e-9
# Factor on the steps of a search: averages are then right to some 1e-10, outputs to 1e-8.
_FINER: Final = 4.0
# Steps of differences: of slopes, between the rounding of a run (some 1e-13) and its third derivatives, and of
# curvatures, which only have to lead the right way.
_STEP: Final = 3e-6
_CURVED: Final = 1e-4
# Of first-order conditions: the differences have an error of some 1e-7.
_STATIONARY: Final = 5e-7


class Level:
    """The program as it is built, with exact slopes.

    Attributes:
        nlp: its functions.
        stationary: what is left of first-order conditions, scaled, at an optimum.
    """

    stationary = 1e-10

    def __init__(self, program: Program) -> None:
        """Take a program that is built."""
        self._program, self.nlp, self._built = program, program.built.nlp, program.built
        self._low, self._high = program.low, program.high
        self._curvature: Vector | None = None
        self._slopes: dict[bytes, tuple[Vector, Vector, Vector, Vector]] = {}
        self._values: dict[bytes, tuple[Vector, Vector]] = {}

    def values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return objective and requirements; they are kept."""
        key = y.tobytes() + p.tobytes()
        if key not in self._values:
            self._values[key] = self._new_values(y, p)
        return self._values[key]

    def _new_values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        f, g = self.nlp.values(y, p)
        return np.array(f.nonzeros()), np.array(g.nonzeros())

    def slopes(self, y: Vector, p: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """Return objective, requirements, gradient and Jacobian; they are kept."""
        key = y.tobytes() + p.tobytes()
        if key not in self._slopes:
            self._slopes[key] = self._new_slopes(y, p)
        return self._slopes[key]

    def _new_slopes(self, y: Vector, p: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        f, g, gradient, jacobian = (np.asarray(result) for result in self.nlp.slopes(y, p))
        return f.ravel(), g.ravel(), gradient.ravel(), jacobian

    def residual(self, point: Point, p: Vector) -> float:
        """Return by how much an optimum misses the first-order conditions: slopes, limits, and one of two at each."""
        _, g, gradient, jacobian = self.slopes(point.y, p)
        return residual(point, (g, gradient, jacobian), (self._low, self._high))

    def least_curvature(self, point: Point, p: Vector) -> float | None:
        """Return the least curvature of the Lagrangian along directions that leave every limit in place.

        Returns:
            Relative to the largest of the Lagrangian, roughly integrated; None where limits leave no direction.
        """
        _, g, _, jacobian = self.slopes(point.y, p)
        touching = _touches(np.minimum(g - self._low, self._high - g), point.lam_g)
        bounds = _touches(np.minimum(point.y, 1.0 - point.y), point.lam_y)
        free = free_directions(np.concatenate([jacobian[touching], np.eye(len(point.y))[bounds]]))
        if not free.size:
            return None
        whole = symmetric(np.asarray(self._built.rough.hess_lag(point.y, p, 1.0, point.lam_g)))
        return float(reduced_curvatures(whole, free)[0][0])

    def correct(self, at: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start by sequential quadratic programming from the multipliers of a neighbour.

        The curvature of the Lagrangian is kept from solve to solve, and renewed by its gradients (Powell 1978): along a
        front it hardly changes, so that a few steps do.

        Args:
            at: the neighbour.
            start: scaled variables.
            p: parameters.
        """
        begins = replace(at, solved=False, status="Search_Direction_Becomes_Too_Small", y=start)
        kept, self._curvature = self._curvature, None
        # The curvature of a neighbour may be that of another branch.
        for curvature in (kept, None) if kept is not None else (None,):
            try:
                own = self._first_curvature(start, p, at.lam_g) if curvature is None else curvature
                point = self._corrected(begins, own, p)
            except (RuntimeError, ValueError):  # no orbit, no number, or no end of an integration
                continue
            if point.solved:
                return point
        return begins

    def _corrected(self, point: Point, curvature: Vector, p: Vector) -> Point:
        """Take steps until the first-order conditions hold; the point is not solved where they lead nowhere."""
        stalled, shortest = 0, np.inf
        for number in range(_STEPS):
            f, g, gradient, jacobian = self.slopes(point.y, p)
            y, limits = point.y, (self._low, self._high)
            found = optimum_step(curvature, y, (g, gradient, jacobian), limits, _LONGEST)
            if found is None:
                return point
            step, lam_g, lam_y = found
            point = replace(point, f=float(f[0]), lam_g=lam_g, lam_y=without_rounding(y, lam_y))
            if self.residual(point, p) <= self.stationary:
                self._curvature = curvature
                return replace(point, solved=True, status="Solve_Succeeded", iterations=number)
            size = float(np.max(np.abs(step)))
            stalled = 0 if size < 0.7 * shortest else stalled + 1
            shortest = min(size, shortest)
            if stalled >= _PATIENCE:
                return point
            point = replace(point, y=np.clip(y + step, 0.0, 1.0), lam_y=lam_y)
            if size > _TELLING:
                _, _, next_gradient, next_jacobian = self.slopes(point.y, p)
                change = next_gradient - gradient + (next_jacobian - jacobian).T @ lam_g
                curvature = _renewed(curvature, step, change)
        return point

    def _first_curvature(self, y: Vector, p: Vector, lam_g: Vector) -> Vector:
        """Return the Lagrangian's Hessian, roughly integrated, with its curvatures made positive."""
        return made_convex(symmetric(np.asarray(self._built.rough.hess_lag(y, p, 1.0, lam_g))))

    def from_afar(self, at: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start that is further away, by IPOPT.

        Args:
            at: the neighbour.
            start: scaled variables.
            p: parameters.
        """
        del at  # IPOPT finds multipliers of its own
        point = self._program.solve(start, p, SolveOptions(near=True))
        return point if point.solved else self._program.solve(start, p)


class BatchLevel(Level):
    """A program whose designs and their neighbours are integrated side by side.

    Attributes:
        stationary: as of any level; in units of short ranges the rounding of objectives is larger.
    """

    def __init__(self, program: Program) -> None:
        """Take a program that is built."""
        super().__init__(program)
        self.stationary = _STATIONARY
        self._scale = np.array(program.scales)[np.array(program.owner, dtype=int)]

    def normalised(self, sizes: float) -> None:
        """Set the largest size of an objective in units of its range."""
        self.stationary = _STATIONARY * max(1.0, sizes)

    def _new_values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        f, g = self._rows(y[None], p)
        return f, g[0]

    def _new_slopes(self, y: Vector, p: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        around, steps = _around(y)
        return _differences(*self._rows(around, p), steps)

    def _rows(self, points: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return scaled objective and requirements of designs, a row each, all by equal numbers of steps."""
        with np.errstate(all="ignore"):
            f, g = self._program.population(points, p, finer=_FINER, together=len(points))
        return f, g / self._scale

    def from_afar(self, at: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start by a search's descent, corrected."""
        end = descend(Landscape(self._program, p), start)
        if not end.feasible[0]:
            return replace(at, solved=False, status="Infeasible_Problem_Detected", y=end.points[0])
        return self.correct(at, end.points[0], p)

    def _first_curvature(self, y: Vector, p: Vector, lam_g: Vector) -> Vector:
        """Return the Lagrangian's Hessian, its curvatures made positive, by differences of its slopes."""
        away = np.where(y > 0.5, -_CURVED, _CURVED)
        around = [_around(place) for place in (y, *(y + np.diag(away)))]
        f, g = self._rows(np.vstack([points for points, _ in around]), p)
        count, slopes = len(around[0][0]), []
        for k, (_, steps) in enumerate(around):
            own = slice(k * count, (k + 1) * count)
            _, _, gradient, jacobian = _differences(f[own], g[own], steps)
            slopes.append(gradient + jacobian.T @ lam_g)
        bend = (np.array(slopes[1:]) - slopes[0]) / away[:, None]
        return made_convex((bend + bend.T) / 2.0)


def _touches(margins: Vector, multipliers: Vector) -> NDArray[np.bool_]:
    """Return which limits leave no room: by their scaled margins, or because they pull harder than they are far."""
    pulls = np.abs(multipliers)
    return (margins < _TOUCHING) | ((pulls > PULLS) & (pulls > margins))


def _renewed(curvature: Vector, step: Vector, change: Vector) -> Vector:
    """Return the curvature that has met a change of the gradient over a step, damped so that it stays convex."""
    along = curvature @ step
    weight = float(step @ along)
    if weight <= np.finfo(float).tiny:
        return curvature
    met = float(step @ change)
    if met < _DAMPED * weight:
        share = (1.0 - _DAMPED) * weight / (weight - met)
        change = share * change + (1.0 - share) * along
        met = float(step @ change)
    return np.asarray(curvature - np.outer(along, along) / weight + np.outer(change, change) / met)


def _around(y: Vector) -> tuple[Vector, Vector]:
    """Return a design and two beside it along each variable, inwards, and the steps to the first of either."""
    steps = np.where(y > 0.5, -_STEP, _STEP)
    return np.vstack([y, y + np.diag(steps), y + 2.0 * np.diag(steps)]), steps


def _differences(f: Vector, g: Vector, steps: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Return objective, requirements, gradient and Jacobian, to the second order, from values at such designs."""
    n = len(steps)
    gradient, jacobian = (
        ((4.0 * (own[1 : n + 1] - own[0]) - (own[n + 1 :] - own[0])).T / (2.0 * steps)) for own in (f, g)
    )
    return f[:1], g[0], gradient, jacobian
