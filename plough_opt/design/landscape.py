"""Scaled objective and violations over all variables: what a search samples, and the ways between its designs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.ipopt import Vector
from plough_opt.design.program import Program

FEASIBLE = 1e-6
"""Scaled violation below which a search's design counts as meeting its requirements."""

MET = 5e-10
"""The same of a design that is given as an answer."""

FINER = 2.0
"""Factor on a sample's steps in descents and comparisons, where a few steps more or less shift nothing that matters."""

PENALTY = 100.0
"""Weight of a violated requirement, which must outweigh any gain in the scaled objective of order 1."""

SAME = 1e-3
"""Two scaled designs nearer than this are one."""

# Above every scaled objective, and little enough for violations to count behind it.
_BEYOND = 1e8
# Positions on a way at which a barrier is looked for, and the part of the merit below which a rise is a ripple.
_BETWEEN, _RIPPLE = 24, 1e-3
# Positions on a way down to an end, denser towards both of its ends, where narrow basins would show; by what part of
# the merit it may rise, as rounding and the end's own digits do; and how many ends, the nearest first, are tried.
_DOWN, _RISE, _NEAREST = 40, 1e-6, 4
# Each of how many positions is tried first.
_COARSE = 5


@dataclass(frozen=True)
class Seen:
    """Designs that were looked at, a row each.

    Attributes:
        points: scaled variables.
        f: scaled objective; NaN where a design has no value.
        violation: sum over the requirements of what each is violated by at its worst, in its scale; infinite without
            a value.
    """

    points: Vector
    f: Vector
    violation: Vector

    @property
    def feasible(self) -> np.ndarray:
        """Whether each design meets all requirements."""
        return self.violation <= FEASIBLE

    @property
    def merit(self) -> Vector:
        """Objective and violations in one number, infinite without a value."""
        return np.where(np.isfinite(self.f), self.f + PENALTY * self.violation, np.inf)

    @property
    def strict_merit(self) -> Vector:
        """The same with which no design that breaks a requirement is better than one that meets all."""
        beyond = _BEYOND + np.minimum(self.violation, _BEYOND)
        return np.where(np.isfinite(self.f), np.where(self.feasible, self.f, beyond), np.inf)

    def of(self, which: Any) -> Seen:
        """Return some of the designs."""
        return Seen(self.points[which], self.f[which], self.violation[which])

    def without_objective(self) -> Seen:
        """Return the designs with their violation alone for a merit."""
        return Seen(self.points, np.where(np.isfinite(self.violation), 0.0, np.nan), self.violation)


def joined(parts: Sequence[Seen]) -> Seen:
    """Return the designs of all parts."""
    return Seen(*(np.concatenate([getattr(one, name) for one in parts]) for name in ("points", "f", "violation")))


class Landscape:
    """Scaled objective and requirements over the scaled variables, at given parameters."""

    def __init__(self, program: Program, p: Vector) -> None:
        """Take a program whose scales are set."""
        self.program, self.p = program, p
        self.dimensions = len(program.declared.variables)
        owner = np.array(program.owner, dtype=int)
        self.first_rows: list[int] = np.flatnonzero(np.diff(owner, prepend=-1)).tolist()
        self._scale = np.array(program.scales)[owner] if len(owner) else np.empty(0)
        # Kept where the program is scaled anew by what is found here.
        self.objective_scale = program.objective_scale
        self.vectorised = program.population.vectorised
        self.settled = program.linear_variables(p)
        self.tried = 0

    def rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the scaled objective and requirements, a row for each design."""
        self.tried += len(points)
        f, g = self.program.population(points, self.p, finer=finer, together=together)
        return f / self.objective_scale, g / self._scale

    def of_the_design(self) -> Landscape:
        """Return that of the design alone, where this is of a whole tolerance box, or this one."""
        bare = self.program.bare
        if bare is None:
            return self
        bare.prepare(self.p)
        return Landscape(bare, self.p)

    def violations(self, g: Vector) -> Vector:
        """Return by what each requirement is violated at its worst, a row for each design; infinite without a value."""
        if not self.first_rows:
            return np.zeros((len(g), 0))
        excess = np.maximum(self.program.low - g, g - self.program.high)
        worst = np.maximum.reduceat(excess, self.first_rows, axis=1)
        return np.where(np.isfinite(worst), np.maximum(worst, 0.0), np.inf)

    def __call__(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> Seen:
        """Look at designs, a row each; variables that can be are solved for, given the others."""
        if not len(points):
            return Seen(points, np.empty(0), np.empty(0))
        with np.errstate(all="ignore"):
            points, f, g = self.settled_rows(points, finer=finer, together=together)
            violation = self.violations(g).sum(axis=1)
        f = np.where(np.isfinite(f), f, np.nan)
        return Seen(points, f, np.where(np.isnan(f), np.inf, violation))

    def settled_rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector, Vector]:
        """Return designs with the variables that can be solved for so solved, their objective and requirements."""
        f, g = self.rows(points, finer=finer, together=together)
        size, low, high = self.objective_scale, self.program.low * self._scale, self.program.high * self._scale
        for variable in self.settled:
            points, f, g = variable.settled(points, f * size, g * self._scale, low, high)
            f, g = f / size, g / self._scale
        return points, f, g


# --- the straight ways between designs, which show whether they lie in one basin ----------------------------


def barriers(look: Callable[[Vector], Seen], one: Seen, others: Seen) -> NDArray[np.bool_]:
    """Return for each of some designs whether a barrier, more than a ripple, parts it from another.

    Args:
        look: designs, a row each -> what is seen of them.
        one: a design.
        others: designs.
    """
    parts = np.linspace(0.0, 1.0, _BETWEEN + 2)[1:-1]
    way = one.points + parts[:, None, None] * (others.points - one.points)
    merit = look(way.reshape(-1, way.shape[2])).merit.reshape(_BETWEEN, -1)
    higher = np.maximum(others.merit, one.merit)
    found: NDArray[np.bool_] = merit.max(axis=0) > higher + _RIPPLE * np.abs(higher)
    return found


def straight_below(landscape: Landscape, start: Vector, ends: Seen) -> int | None:
    """Return the number of an end to which the merit does nothing but fall on the way from a start, or None.

    Such a start lies in the end's basin: a descent from it would lead there.
    """
    near: list[int] = []
    distance = np.max(np.abs(ends.points - start), axis=1)
    # Of ends that are one, the lowest.
    for k in np.lexsort((ends.merit, distance.round(3))):
        if np.isfinite(ends.merit[k]) and all(np.max(np.abs(ends.points[k] - ends.points[j])) >= SAME for j in near):
            near.append(int(k))
        if len(near) == _NEAREST:
            break
    parts = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _DOWN))
    # Most ways rise at once or not at all: a few positions suffice for most that do, the others for the rest.
    for some in (parts[::_COARSE], np.delete(parts, np.s_[::_COARSE])):
        if near:
            near = [k for k, falls in zip(near, _fall(landscape, start, ends.points[near], some), strict=True) if falls]
    return near[0] if near else None


def _fall(landscape: Landscape, start: Vector, ends: Vector, parts: Vector) -> list[bool]:
    """Return for each of some ends whether the merit does nothing but fall at parts of the way from a start."""
    ways = start + parts[:, None] * (ends - start)[:, None]
    # Equal numbers of steps along a way, so that it rises by nothing that changes of these bring.
    merit = landscape(ways.reshape(-1, len(start)), together=len(parts)).merit.reshape(-1, len(parts))
    with np.errstate(invalid="ignore"):
        rise = np.max(merit[:, 1:] - np.minimum.accumulate(merit, axis=1)[:, :-1], axis=1)
        falls: list[bool] = (np.isfinite(merit).all(axis=1) & (rise <= _RISE * np.abs(merit[:, -1]))).tolist()
    return falls
