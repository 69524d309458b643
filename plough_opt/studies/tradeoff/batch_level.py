"""The program of a trade-off by the steps of a batch, with slopes by differences: some twenty times as fast."""

from dataclasses import replace

import numpy as np

from plough_opt.design.descents import descend
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.landscape import Landscape
from plough_opt.design.optimality import made_convex
from plough_opt.design.program import Program
from plough_opt.studies.tradeoff.level import Level

# Factor on the steps of a search: averages are then right to some 1e-10, outputs to 1e-8.
_FINER = 4.0
# Steps of differences: of slopes, between the rounding of a run (some 1e-13) and its third derivatives, and of
# curvatures, which only have to lead the right way.
_STEP, _CURVED = 3e-6, 1e-4
# Of first-order conditions: the differences have an error of some 1e-7.
_STATIONARY = 5e-7


class BatchLevel(Level):
    """A program whose designs and their neighbours are integrated side by side.

    Attributes:
        stationary: as of any level; in units of short ranges the rounding of objectives is larger.
    """

    def __init__(self, program: Program) -> None:
        """Take a program that is built."""
        super().__init__(program)
        self.stationary = _STATIONARY
        self._objective_scale = program.objective_scale
        self._scale = np.array(program.scales)[np.array(program.owner, dtype=int)]

    def normalised(self, sizes: float) -> None:
        """Set the largest size of an objective in units of its range."""
        self.stationary = _STATIONARY * max(1.0, sizes)

    def values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return objective and requirements; they are kept."""
        key = y.tobytes() + p.tobytes()
        if key not in self._values:
            f, g = self._rows(y[None], p)
            self._values[key] = f, g[0]
        return self._values[key]

    def slopes(self, y: Vector, p: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """Return objective, requirements, gradient and Jacobian; they are kept."""
        key = y.tobytes() + p.tobytes()
        if key not in self._slopes:
            around, steps = _around(y)
            self._slopes[key] = _differences(*self._rows(around, p), steps)
        return self._slopes[key]

    def _rows(self, points: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return scaled objective and requirements of designs, a row each, all by equal numbers of steps."""
        with np.errstate(all="ignore"):
            f, g = self._program.population(points, p, finer=_FINER, together=len(points))
        return f / self._objective_scale, g / self._scale

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
