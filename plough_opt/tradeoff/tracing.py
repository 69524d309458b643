"""Following a front: from every optimum of either objective alone, position by position, in both directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from plough_opt.design.curvature import minimum_from
from plough_opt.design.ipopt import REMEDIES, Point, Vector
from plough_opt.design.search import Progress, global_search
from plough_opt.design.solving import first_optimum
from plough_opt.tradeoff.plane import efficient, gaps
from plough_opt.tradeoff.program import FrontProgram

# Weight of the other objective in an anchor: what is indifferent to one objective is decided by the other.
_OTHER = 1e-4
# Two optima nearer than this, in normalised objectives and in scaled variables, are one.
_SAME_OBJECTIVES = 1e-6
_SAME_DESIGN = 1e-4
# A position farther from its limit is held by none: the branch has ended.
_ENDED = 1e-6
# Beside an efficient point by so much, so that it does not dominate the end of the other part.
_BESIDE = 1e-6
# Steps from an end, where more limits meet than decide the design, to where its rate is taken.
_INWARD = 0.01
_GIVE_UP = 2
_ROUNDS = 6
# Differences of the normalised objectives at which all local optima are searched.
_SEARCHED = (-0.5, 0.0, 0.5)


@dataclass
class Sample:
    """A local optimum on some branch.

    Attributes:
        point: as IPOPT left it.
        p: parameters of the program that it is an optimum of.
        at: normalised objectives.
        swept: objectives in whose direction its branch has been followed from here.
        inward: at an end, an optimum and its parameters a little along the front, where the multipliers are unique.
    """

    point: Point
    p: Vector
    at: Vector
    swept: set[int] = field(default_factory=set)
    inward: tuple[Point, Vector] | None = None


@dataclass(frozen=True)
class Failure:
    """A position without a certified design.

    Attributes:
        objectives: normalised objectives of the neighbour from which it was sought.
        reason: why it failed.
    """

    objectives: tuple[float, float]
    reason: str


class Tracer:
    """All local optima found, and how to find more."""

    def __init__(self, front: FrontProgram, scanned: Sequence[int], positions: int, progress: Progress) -> None:
        """Take the program, the variables to scan, and the number of positions."""
        self._front = front
        self._program = front.program
        self._scanned = scanned
        self._told = progress
        self._grid = np.linspace(-1.0, 1.0, positions)
        self.step = 2.0 / (positions - 1)
        self.samples: list[Sample] = []
        self.failures: list[Failure] = []

    # --- anchors -----------------------------------------------------------------------------------------

    def anchors(self, objective: int) -> list[Point]:
        """Return all local optima of an objective alone, best first.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no optimum was found.
        """
        p = self._front.alone(objective, _OTHER)
        first = minimum_from(self._program, p, first_optimum(self._program, p))
        return global_search(self._program, p, first, self._scanned, self._told)[0]

    def keep_anchors(self, objective: int, points: Sequence[Point]) -> list[Sample]:
        """Add the optima of an objective alone."""
        p = self._front.alone(objective, _OTHER)
        return [self._kept(point, p) for point in points]

    # --- following ---------------------------------------------------------------------------------------

    def follow(self, sample: Sample, objective: int) -> None:
        """Follow a branch towards less of an objective, one position after the other, until it ends.

        The limit on the other objective loosens on the way, so that each optimum is a feasible start for the next.
        """
        before: Vector | None = None
        failed, first = 0, sample
        sample.swept.add(objective)
        difference = float(sample.at[1 - objective] - sample.at[objective])
        for position in self._grid[self._grid > difference - _ENDED]:
            start = sample.point.y if before is None else np.clip(2.0 * sample.point.y - before, 0.0, 1.0)
            p = self._front.beside(objective, float(position))
            point = self._front.solve(sample.point, start, p)
            if not point.solved:
                self._fail(sample, point)
                failed, before = failed + 1, None
                if failed == _GIVE_UP:
                    return
                continue
            failed, before = 0, sample.point.y
            sample = self._kept(point, p)
            if objective in sample.swept and sample is not first:
                return
            sample.swept.add(objective)
            if position - (sample.at[1 - objective] - sample.at[objective]) > _ENDED:
                return

    def _fail(self, near: Sample, point: Point) -> None:
        reason = REMEDIES.get(point.status, "the optimiser stopped without an optimum")
        failure = Failure((float(near.at[0]), float(near.at[1])), f"{point.status}: {reason}")
        if failure not in self.failures:
            self.failures.append(failure)

    def _kept(self, point: Point, p: Vector) -> Sample:
        """Return a point's sample: an earlier one where the same design was found before."""
        at = self._front.normalised(self._front.objectives(point.y))
        for other in self.samples:
            close = np.max(np.abs(other.at - at)) < _SAME_OBJECTIVES
            if close and np.max(np.abs(other.point.y - point.y)) < _SAME_DESIGN:
                return other
        self.samples.append(Sample(point, p, at))
        return self.samples[-1]

    # --- searching ---------------------------------------------------------------------------------------

    def search_inside(self) -> None:
        """Search all local optima at some positions, and follow what is new from there both ways."""
        for number, difference in enumerate(_SEARCHED if self._scanned else ()):
            self._told(f"searching between the anchors, {number + 1} of {len(_SEARCHED)}", number / len(_SEARCHED))
            self._search_at(difference)

    def _search_at(self, difference: float) -> None:
        difference = float(self._grid[np.argmin(np.abs(self._grid - difference))])
        near = min(self.samples, key=lambda sample: abs(sample.at[0] - sample.at[1] - difference))
        p = self._front.beside(1, difference)
        first = self._front.solve(near.point, near.point.y, p)
        if not first.solved:
            self._fail(near, first)
            return
        for point in global_search(self._program, p, first, self._scanned, _silent)[0]:
            sample = self._kept(point, p)
            for objective in (1, 0):
                if objective not in sample.swept:
                    self.follow(sample, objective)

    # --- gaps --------------------------------------------------------------------------------------------

    def front(self) -> list[Sample]:
        """Return the samples that no other dominates, in order."""
        return [self.samples[k] for k in efficient(np.array([sample.at for sample in self.samples]))]

    def fill_gaps(self) -> None:
        """Look for efficient designs in every gap, and find where the parts beside it end."""
        tried: set[tuple[int, int]] = set()
        for number in range(_ROUNDS):
            front = self.front()
            found = gaps(np.array([sample.at for sample in front]), self.step)
            fresh = [k for k in found if (id(front[k]), id(front[k + 1])) not in tried]
            if not fresh:
                return
            self._told("looking into gaps", number / _ROUNDS)
            for k in fresh:
                tried.add((id(front[k]), id(front[k + 1])))
                self._look_between(front[k], front[k + 1])

    def _look_between(self, left: Sample, right: Sample) -> None:
        """Follow the branches on both sides of a gap into it, to the last design that the other does not dominate."""
        for sample, objective in ((left, 1), (right, 0)):
            if objective not in sample.swept:
                self.follow(sample, objective)
        if self._scanned:
            self._search_at(float(np.mean([s.at[0] - s.at[1] for s in (left, right)])))
        end = self._end(left, 1, float(right.at[0]) - _BESIDE)
        self._end(right, 0, float((end or left).at[1]) - _BESIDE)

    def _end(self, sample: Sample, objective: int, limit: float) -> Sample | None:
        """Return the design of a branch with least of an objective, the other one limited."""
        p = self._front.below(objective, limit)
        point = self._front.solve(sample.point, sample.point.y, p)
        return self._kept(point, p) if point.solved else None

    # --- finishing ---------------------------------------------------------------------------------------

    def solve_again(self) -> None:
        """Solve every sample anew, from where it is: the program has become finer."""
        for sample in self.samples:
            again = self._front.solve(sample.point, sample.point.y, sample.p)
            if again.solved:
                sample.point, sample.at = again, self._front.normalised(self._front.objectives(again.y))

    def look_inward(self) -> None:
        """Give the ends of a front a neighbour on it: at an end its own multipliers are not unique."""
        front = self.front()
        for number, sample in enumerate(front):
            if self._front.holds(sample.point):
                continue
            objective = 0 if number == len(front) - 1 else 1
            difference = float(sample.at[1 - objective] - sample.at[objective])
            p = self._front.beside(objective, difference + _INWARD * self.step)
            point = self._front.solve(sample.point, sample.point.y, p)
            at = self._front.normalised(self._front.objectives(point.y))
            near = np.sum(np.abs(at - sample.at)) < self.step
            if point.solved and near and self._front.holds(point):
                sample.inward = (point, p)


def _silent(_stage: str, _fraction: float) -> None:
    """Report nothing."""
