"""Following a front of two objectives: from every optimum of either alone, position by position, both ways."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.studies.tradeoff.archive import Archive
from plough_opt.studies.tradeoff.candidates import OTHERS, SOUGHT, Candidate, Order, ahead
from plough_opt.studies.tradeoff.domination import in_order
from plough_opt.studies.tradeoff.positions import gaps, needed, spread
from plough_opt.studies.tradeoff.tracer import Tracer

# A position farther from its limit is held by none: the branch has ended.
_ENDED = 1e-6
# Beside an efficient point by so much, so that it does not dominate the end of the other part.
_BESIDE = 1e-6
# Steps from an end, where more limits meet than decide the design, to where its rate is taken.
_INWARD = 0.01
# A branch that ends at a position farther in a scaled variable than this from where it led has become another one.
_SMOOTH = 0.1
# Positions without an optimum, one after the other, after which a branch is left.
_GIVE_UP = 2
_ROUNDS = 6
# Decimals of the normalised objectives by which gaps are distinguished.
_PLACES = 4
# Differences of the normalised objectives at which basins are searched.
_SEARCHED = (-0.5, 0.0, 0.5)


class CurveTracer(Tracer):
    """The candidates for a front of two objectives."""

    turns = np.array([[1.0, OTHERS], [OTHERS, 1.0]])
    matters = SOUGHT
    at_once, rounds = 6, 12

    def __init__(self, archive: Archive, positions: int, progress: Progress) -> None:
        """Take what looks at the designs of a front's program, and the number of positions."""
        super().__init__(archive, progress)
        self._grid = np.linspace(-1.0, 1.0, positions)
        self.step = 2.0 / (positions - 1)
        self.spacing = self.step / 2.0

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Follow every branch from every optimum both ways, and look into what gaps are left.

        Args:
            anchors: all local optima of either objective alone.
        """
        starts = [(self.kept(point, p), 1 - k) for k, p in enumerate(self.orders()) for point in anchors[k]]
        for number, (one, objective) in enumerate(starts):
            self.progress(f"following branch {number + 1} of {len(starts)}", number / len(starts))
            self.follow(one, objective)
        self._search_inside()
        self.reach_all()
        self._fill_gaps()
        self.reach_all(look=False)

    def all_anchors(self, starts: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return the local optima for each of `orders` beside its starts."""
        return [self.anchors(p, own) for p, own in zip(self.orders(), starts, strict=True)]

    # --- following ---------------------------------------------------------------------------------------

    def follow(self, one: Candidate, objective: int) -> None:
        """Follow a branch towards less of an objective, one position after the other, until it ends.

        The limit on the other objective loosens on the way, so that each optimum is a feasible start for the next.
        """
        behind: Candidate | None = None
        failed, first = 0, one
        one.swept.add(objective)
        for position in self._grid[self._grid > self._difference(one, objective) - _ENDED]:
            start = ahead(behind, one)
            found = self.solve(one, start, self._beside(objective, float(position)))
            if found is None:
                failed, behind = failed + 1, None
                if failed == _GIVE_UP:
                    return
                continue
            failed, behind, one = 0, one, found
            if objective in one.swept and one is not first:
                return
            one.swept.add(objective)
            if np.max(np.abs(found.point.y - start)) < _SMOOTH:
                # Back from here it leads to where it came from.
                one.swept.add(1 - objective)
            if position - self._difference(one, objective) > _ENDED:
                return

    def _search_inside(self) -> None:
        """Search basins at some positions, and follow what is new from there both ways."""
        for number, difference in enumerate(_SEARCHED if self.archive.vary else ()):
            self.progress(f"searching between the anchors, {number + 1} of {len(_SEARCHED)}", number / len(_SEARCHED))
            self._search_at(difference)

    def _search_at(self, difference: float) -> None:
        p = self._beside(1, difference)
        for y in self.archive.evolved_at(p):
            known = len(self.found)
            self.follow_new(self.best_from(p, y), known)

    def follow_all(self, one: Candidate) -> None:
        """Follow a branch both ways."""
        for objective in (1, 0):
            if objective not in one.swept:
                self.follow(one, objective)

    def position(self, at: Vector) -> Vector:
        """Return the parameters that ask for the front's design at the place of normalised objectives."""
        return self._beside(1, float(at[0] - at[1]))

    def _beside(self, objective: int, difference: float) -> Vector:
        return self.front.limited(objective, {1 - objective: difference}, beside=True)

    @staticmethod
    def _difference(one: Candidate, objective: int) -> float:
        return float(one.at[1 - objective] - one.at[objective])

    # --- gaps --------------------------------------------------------------------------------------------

    def ordered(self) -> list[Candidate]:
        """Return the candidates that no other dominates, in order."""
        sound = self.sound()
        return [sound[k] for k in in_order(self.places(sound))]

    def order(self, candidates: Sequence[Candidate]) -> Order:
        """Return how candidates make up a front: its points in order, its parts, and the gaps between them."""
        at, step = self.places(candidates), self.step
        best = in_order(at)
        own = best[needed(at[best], [candidates[k].extra for k in best], step)]
        kept = own[spread(at[own], step)]
        breaks = gaps(at[kept], step)
        bounds = [0, *(k + 1 for k in breaks), len(kept)]
        return Order(
            [candidates[k] for k in best],
            [candidates[k] for k in kept],
            tuple(tuple(range(i, j)) for i, j in pairwise(bounds)),
            tuple((k, k + 1) for k in breaks),
        )

    def _fill_gaps(self) -> None:
        """Follow the branches beside every gap into it, to the last design that the other does not dominate."""
        tried: set[bytes] = set()
        for number in range(_ROUNDS):
            front = self.ordered()
            places = self.places(front)
            ends = {np.round(places[k : k + 2], _PLACES).tobytes(): k for k in gaps(places, self.step)}
            fresh = [(front[k], front[k + 1]) for key, k in ends.items() if key not in tried]
            tried.update(ends)
            self.progress("looking into gaps", number / _ROUNDS)
            for left, right in fresh:
                for one, objective in ((left, 1), (right, 0)):
                    if objective not in one.swept:
                        self.follow(one, objective)
                if self.archive.vary:
                    self._search_at(float(np.mean([self._difference(one, 1) for one in (left, right)])))
                end = self._end(left, 1, float(right.at[0]) - _BESIDE)
                self._end(right, 0, float((end or left).at[1]) - _BESIDE)
            if not fresh:
                return

    def _end(self, one: Candidate, objective: int, limit: float) -> Candidate | None:
        """Return the design of a branch with least of an objective, the other one limited."""
        return self.solve(one, one.point.y, self.front.limited(objective, {1 - objective: limit}), report=False)

    # --- finishing ---------------------------------------------------------------------------------------

    def look_inward(self) -> None:
        """Give the ends of a front a neighbour on it: at an end its own multipliers are not unique."""
        front = self.ordered()
        for number, one in enumerate(front):
            if self.front.holds(one.point):
                continue
            objective = 0 if number == len(front) - 1 else 1
            p = self._beside(objective, self._difference(one, objective) + _INWARD * self.step)
            point = self.front.solve(one.point, one.point.y, p, exact=one.exact)
            near = np.sum(np.abs(self.front.objectives(point.y, exact=one.exact) - one.at)) < self.step
            if point.solved and near and self.front.holds(point):
                one.inward = (point, p)
