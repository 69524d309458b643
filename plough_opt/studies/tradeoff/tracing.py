"""Following a front of two objectives: from every optimum of either alone, position by position, both ways."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import comb

import numpy as np

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.studies.tradeoff.plane import efficient, gaps, needed, spread
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.reaching import Reaching
from plough_opt.studies.tradeoff.samples import OTHERS, SOUGHT, Order, Sample
from plough_opt.studies.tradeoff.searching import Searcher

# A position farther from its limit is held by none: the branch has ended.
_ENDED = 1e-6
# Beside an efficient point by so much, so that it does not dominate the end of the other part.
_BESIDE = 1e-6
# Steps from an end, where more limits meet than decide the design, to where its rate is taken.
_INWARD = 0.01
# A branch that ends at a position farther in a scaled variable than this from where it led has become another one.
_SMOOTH = 0.1
# Designs beside the last two from which the next one is foretold.
_REMEMBERED = 2
_SHRINKS = 0.5
_GIVE_UP = 2
_ROUNDS = 6
# Decimals of the normalised objectives by which gaps are told apart.
_PLACES = 4
# Differences of the normalised objectives at which basins are searched.
_SEARCHED = (-0.5, 0.0, 0.5)


class Tracer(Reaching):
    """The local optima of a front of two objectives."""

    matters = SOUGHT

    def __init__(self, front: FrontProgram, searcher: Searcher, positions: int, progress: Progress) -> None:
        """Take the program, what searches over its variables, and the number of positions."""
        super().__init__(front, searcher, progress)
        self._grid = np.linspace(-1.0, 1.0, positions)
        self.step = 2.0 / (positions - 1)

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Follow every branch from every optimum both ways, and look into what gaps are left.

        Args:
            anchors: all local optima of either objective alone.
        """
        level, orders = self.level_of_anchors, self.orders()
        starts = [(self.kept(point, p, level), 1 - k) for k, p in enumerate(orders) for point in anchors[k]]
        for number, (sample, objective) in enumerate(starts):
            self.progress(f"following branch {number + 1} of {len(starts)}", number / len(starts))
            self.follow(sample, objective)
        self._search_inside()
        self.reach_all()
        self._fill_gaps()
        self.reach_all(look=False)

    def orders(self) -> list[Vector]:
        """Return the parameters for either objective alone."""
        return [self.in_ranges(np.array(weights)) for weights in ((1.0, OTHERS), (OTHERS, 1.0))]

    alone = orders

    def all_anchors(self, starts: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return the local optima for each of `orders` beside its starts."""
        return [self.anchors(p, own) for p, own in zip(self.orders(), starts, strict=True)]

    # --- following ---------------------------------------------------------------------------------------

    def follow(self, sample: Sample, objective: int) -> None:
        """Follow a branch towards less of an objective, one position after the other, until it ends.

        The limit on the other objective loosens on the way, so that each optimum is a feasible start for the next.
        """
        passed: list[Vector] = []
        failed, first = 0, sample
        sample.swept.add(objective)
        for position in self._grid[self._grid > self._difference(sample, objective) - _ENDED]:
            start = extrapolated([*passed, sample.point.y])
            found = self.solve(sample, start, self._beside(objective, float(position)))
            if isinstance(found, Point):
                failed, passed = failed + 1, []
                if failed == _GIVE_UP:
                    return
                continue
            failed, passed = 0, [*passed[-_REMEMBERED:], sample.point.y]
            sample = found
            if objective in sample.swept and sample is not first:
                return
            sample.swept.add(objective)
            if np.max(np.abs(found.point.y - start)) < _SMOOTH:
                # Back from here it leads to where it came from.
                sample.swept.add(1 - objective)
            if position - self._difference(sample, objective) > _ENDED:
                return

    def _beside(self, objective: int, difference: float) -> Vector:
        return self.front.beside(objective, {1 - objective: difference})

    @staticmethod
    def _difference(sample: Sample, objective: int) -> float:
        return float(sample.at[1 - objective] - sample.at[objective])

    # --- searching ---------------------------------------------------------------------------------------

    def position(self, at: Vector) -> Vector:
        """Return the parameters that ask for the front's design at the place of normalised objectives."""
        return self._beside(1, float(at[0] - at[1]))

    def follow_all(self, sample: Sample) -> None:
        """Follow a branch both ways."""
        for objective in (1, 0):
            if objective not in sample.swept:
                self.follow(sample, objective)

    def _search_inside(self) -> None:
        """Search basins at some positions, and follow what is new from there both ways."""
        for number, difference in enumerate(_SEARCHED if self.searcher.vary else ()):
            self.progress(f"searching between the anchors, {number + 1} of {len(_SEARCHED)}", number / len(_SEARCHED))
            self._search_at(difference)

    def _search_at(self, difference: float) -> None:
        p = self._beside(1, float(self._grid[np.argmin(np.abs(self._grid - difference))]))
        for y in self.searcher.basins_at(p):
            sample = self.sample_at(p, y)
            if not isinstance(sample, Point):
                self.follow_all(sample)

    # --- gaps --------------------------------------------------------------------------------------------

    def ordered(self) -> list[Sample]:
        """Return the samples that no other dominates, in order."""
        sound = self.sound()
        return [sound[k] for k in efficient(np.array([sample.at for sample in sound]))]

    def order(self, samples: Sequence[Sample]) -> Order:
        """Return how samples make up a front: its points in order, its parts, and the gaps between them."""
        at, step = np.array([sample.at for sample in samples]), self.step
        order = efficient(at)
        own = order[needed(at[order], [samples[k].extra for k in order], step)]
        kept = own[spread(at[own], step)]
        breaks = gaps(at[kept], step)
        bounds = [0, *(k + 1 for k in breaks), len(kept)]
        return Order(
            frozenset(order.tolist()),
            tuple(kept.tolist()),
            tuple(tuple(range(i, j)) for i, j in pairwise(bounds)),
            tuple((k, k + 1) for k in breaks),
        )

    def _fill_gaps(self) -> None:
        """Look for efficient designs in every gap, and find where the parts beside it end."""
        tried: set[bytes] = set()
        for number in range(_ROUNDS):
            front = self.ordered()
            found = gaps(np.array([sample.at for sample in front]), self.step)
            places = {k: np.round([front[k].at, front[k + 1].at], _PLACES).tobytes() for k in found}
            fresh = [k for k in found if places[k] not in tried]
            if not fresh:
                return
            self.progress("looking into gaps", number / _ROUNDS)
            for k in fresh:
                tried.add(places[k])
                self._look_between(front[k], front[k + 1])

    def _look_between(self, left: Sample, right: Sample) -> None:
        """Follow the branches on both sides of a gap into it, to the last design that the other does not dominate."""
        for sample, objective in ((left, 1), (right, 0)):
            if objective not in sample.swept:
                self.follow(sample, objective)
        if self.searcher.vary:
            self._search_at(float(np.mean([self._difference(sample, 1) for sample in (left, right)])))
        end = self._end(left, 1, float(right.at[0]) - _BESIDE)
        self._end(right, 0, float((end or left).at[1]) - _BESIDE)

    def _end(self, sample: Sample, objective: int, limit: float) -> Sample | None:
        """Return the design of a branch with least of an objective, the other one limited."""
        p = self.front.below(objective, {1 - objective: limit})
        found = self.solve(sample, sample.point.y, p, reported=False)
        return None if isinstance(found, Point) else found

    # --- finishing ---------------------------------------------------------------------------------------

    def look_inward(self) -> None:
        """Give the ends of a front a neighbour on it: at an end its own multipliers are not unique."""
        front = self.ordered()
        for number, sample in enumerate(front):
            if self.front.holds(sample.point):
                continue
            objective = 0 if number == len(front) - 1 else 1
            p = self._beside(objective, self._difference(sample, objective) + _INWARD * self.step)
            point = self.front.solve(sample.point, sample.point.y, p, sample.level)
            at = self.front.normalised(self.front.objectives(point.y, sample.level))
            near = np.sum(np.abs(at - sample.at)) < self.step
            if point.solved and near and self.front.holds(point):
                sample.inward = (point, p)


def extrapolated(points: Sequence[Vector]) -> Vector:
    """Return where equally spaced designs lead, between the bounds.

    That is the next value of the polynomial through so many of them that each further one corrects it by less.
    """
    found, correction = points[-1], np.inf
    for count in range(2, len(points) + 1):
        weights = np.array([(-1.0) ** (k + 1) * comb(count, k) for k in range(count, 0, -1)])
        better = weights @ np.array(points[-count:])
        size = float(np.max(np.abs(better - found)))
        if size > _SHRINKS * correction:
            break
        found, correction = better, size
    return np.clip(found, 0.0, 1.0)
