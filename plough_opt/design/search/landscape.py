"""The scaled objective and the violations of the requirements over all variables, as a search evaluates them."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.program import Program

FINER = 2.0
"""Factor on a sample's number of steps, used for descents and comparisons, which need more accuracy."""

SEED = 2008
"""Seed of every sample, so that the same problem has the same answer."""

SAME = 1e-3
"""Two scaled designs count as the same if no variable differs by more than this."""


class Violation:
    """Which violations of the requirements a search allows, and what they weigh."""

    allowed: Final = 1e-6  # sum of the scaled violations of a design that a search counts as feasible
    allowed_in_answer: Final = 5e-10  # the same for a design that is returned as an answer
    weight: Final = 100.0  # in a descent: it must outweigh any gain in the scaled objective, which is of order 1
    # Base key of an infeasible design: above every scaled objective, yet small enough not to swallow the digits of
    # the violation that is added to it.
    infeasible: Final = 1e8


@dataclass(frozen=True)
class Evaluations:
    """Designs with their objectives and violations, a row for each design.

    Attributes:
        points: scaled variables.
        f: scaled objective; NaN where the design cannot be evaluated.
        violation: sum over the requirements of each one's largest scaled violation; infinite where the design cannot be
            evaluated.
    """

    points: Vector
    f: Vector
    violation: Vector

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Whether each design meets all requirements."""
        return np.asarray(self.violation <= Violation.allowed)

    @property
    def key(self) -> Vector:
        """What designs are ranked by: feasible ones by their objective, then the others by their violation.

        Infinite where the design cannot be evaluated (Deb 2000, "An efficient constraint handling method for genetic
        algorithms").
        """
        infeasible = Violation.infeasible + np.minimum(self.violation, Violation.infeasible)
        has_value = np.isfinite(self.f) & np.isfinite(self.violation)
        return np.where(has_value, np.where(self.feasible, self.f, infeasible), np.inf)

    def select(self, which: Any) -> Evaluations:
        """Return the designs at an index, a slice or a mask."""
        return Evaluations(self.points[which], self.f[which], self.violation[which])

    def distinct(self, least: float, most: int | None = None) -> Evaluations:
        """Return the best designs that differ by a least distance in some variable, best first and at most so many."""
        order = np.argsort(self.key, kind="stable")
        order = order[np.isfinite(self.key[order])]
        return self.select(apart(self.points, order, least, most))


def concatenated(parts: Sequence[Evaluations]) -> Evaluations:
    """Return the designs of all parts in one object."""
    columns = ([getattr(part, name) for part in parts] for name in ("points", "f", "violation"))
    return Evaluations(*map(np.concatenate, columns))


def apart(points: Vector, order: Iterable[int], least: float, most: int | None = None) -> list[int]:
    """Return the first points in an order that differ by a least distance in some variable, at most ``most`` of them.

    Args:
        points: a row for each point.
        order: numbers of points.
        least: the distance.
        most: number of points; None for all.
    """
    chosen: list[int] = []
    for k in order:
        if len(chosen) == most:
            break
        if np.all(np.max(np.abs(points[chosen] - points[k]), axis=1) >= least):
            chosen.append(int(k))
    return chosen


class Landscape:
    """Scaled objective and requirements over the scaled variables, at given parameters.

    Attributes:
        program: the design's program.
        p: parameters.
        dimensions: number of variables.
        objective_scale: of the objective. It stays the same if the program is rescaled later.
        vectorised: whether all runs of many designs are integrated together.
    """

    def __init__(self, program: Program, p: Vector) -> None:
        """Create the landscape of a program whose scales are set."""
        self.program, self.p = program, p
        self.dimensions = len(program.declared.variables)
        self._scale, self.objective_scale = program.row_scales, program.objective_scale
        self.vectorised = program.population.vectorised
        self._bare, self._tried = False, [0]

    @property
    def designs_tried(self) -> int:
        """Number of designs evaluated so far, also without their objective."""
        return self._tried[0]

    def without_objective(self) -> Landscape:
        """Return the landscape of the violations alone: every design that has a value has an objective of 0."""
        bare = copy.copy(self)
        bare._bare = True
        return bare

    def rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the scaled objective and requirements, a row for each design.

        Args:
            points: scaled variables, a row for each design.
            finer: factor on the number of integration steps.
            together: this many consecutive designs are integrated with equal numbers of steps.
        """
        self._tried[0] += len(points)
        with np.errstate(all="ignore"):
            f, g = self.program.population(points, self.p, finer=finer, together=together)
            return f / self.objective_scale, g / self._scale

    def valued(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return `rows` with an objective of NaN where a design has no value, or of 0 in `without_objective`."""
        f, g = self.rows(points, finer=finer, together=together)
        return np.where(np.isfinite(f), 0.0 if self._bare else f, np.nan), g

    def violations(self, g: Vector) -> Vector:
        """Return each requirement's largest violation, a row for each design; infinite where g is not finite."""
        with np.errstate(all="ignore"):
            worst = -self.program.least_margins(g)
        return np.where(np.isfinite(worst), np.maximum(worst, 0.0), np.inf)

    def __call__(self, points: Vector, *, finer: float = 1.0) -> Evaluations:
        """Evaluate designs, a row each; see `rows` for the arguments."""
        f, g = self.valued(points, finer=finer)
        return Evaluations(points, f, np.where(np.isnan(f), np.inf, self.violations(g).sum(axis=1)))


def only_falls(
    landscape: Landscape, starts: Vector, end: Vector, rise: float, positions: int = 40
) -> NDArray[np.bool_]:
    """Return for each start whether objective plus weighted violation only falls on the straight line to an end.

    The start then lies in that end's basin.

    Args:
        landscape: the landscape.
        starts: scaled designs, a row each.
        end: a scaled design.
        rise: fraction of its value at the end by which the sum may rise.
        positions: number of designs on each line, denser towards both ends, where narrow basins would show.
    """
    fractions = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, positions))
    lines = (starts[:, None] + fractions[:, None] * (end - starts)[:, None]).reshape(-1, len(end))
    # Equal numbers of steps along a line: a change of the number would look like a rise.
    f, g = landscape.valued(lines, together=positions)
    with np.errstate(invalid="ignore"):
        merit = (f + Violation.weight * landscape.violations(g).sum(axis=1)).reshape(-1, positions)
        risen = np.max(merit - np.minimum.accumulate(merit, axis=1), axis=1)
        return np.asarray(np.isfinite(merit).all(axis=1) & (risen <= rise * np.abs(merit[:, -1])))


def with_variables(y: Vector, variables: Sequence[int], points: Any) -> Vector:
    """Return copies of a scaled design with some variables, by number, at other points, a row each."""
    designs = np.repeat(y[None], len(points), axis=0)
    designs[:, variables] = points
    return designs


def even_points(n: int, count: int, rng: np.random.Generator) -> Vector:
    """Return points spread evenly between 0 and 1, a row each.

    They are multiples of a vector of irrational numbers, without their integer parts, from a random first one on
    (Kronecker's sequence, with powers of the generalised golden ratio: Roberts 2018, "The unreasonable effectiveness of
    quasirandom sequences").
    """
    ratio = 2.0
    for _ in range(60):  # its fixed point, ratio**(n + 1) = ratio + 1
        ratio = (1.0 + ratio) ** (1.0 / (n + 1))
    return np.asarray((rng.random(n) + np.arange(1, count + 1)[:, None] * ratio ** -np.arange(1.0, n + 1)) % 1.0)
