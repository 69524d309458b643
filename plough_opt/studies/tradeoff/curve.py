"""Tracing of a front of two objectives: from every optimum of either alone, position by position, both ways."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.studies.tradeoff.archive import Archive
from plough_opt.studies.tradeoff.candidates import OTHERS_WEIGHT, SOUGHT, Arrangement, Candidate, extrapolated
from plough_opt.studies.tradeoff.domination import undominated_in_order
from plough_opt.studies.tradeoff.positions import gaps, uncrowded_on_curve, without_needless
from plough_opt.studies.tradeoff.tracer import Tracer

# An optimum farther from its position is not held by it: the branch has ended.
_OFF_POSITION = 1e-6
# Margin by which the end of one part is sought beside an efficient point, so that the point does not dominate it.
_CLEARANCE = 1e-6
# Steps from an end of the front to its inner neighbour.
_INWARD = 0.01
# Largest difference, in a scaled variable, of a solve from its prediction on the same branch.
_SAME_BRANCH = 0.1
# Optima behind the current one from which the next is predicted.
_REMEMBERED = 2
# Positions in a row without an optimum after which a branch is given up.
_GIVE_UP = 2
# Neighbours on the front that differ by more than this in a scaled variable lie on different branches.
_OTHER_BRANCH = 0.1
# Most rounds of looking into gaps.
_GAP_ROUNDS = 6
# Decimals of normalised objectives by which gaps are recognised again.
_GAP_DECIMALS = 4
# Positions, between -1 and 1, at which evolution searches for further branches.
_SEARCHED_POSITIONS = (-0.5, 0.0, 0.5)


class CurveTracer(Tracer):
    """Tracer of a front of two objectives.

    A position is the difference of both normalised objectives: -1 at one anchor and 1 at the other.
    """

    anchor_weights = np.array([[1.0, OTHERS_WEIGHT], [OTHERS_WEIGHT, 1.0]])
    matters = SOUGHT
    at_once, comparisons = 6, 12

    def __init__(self, archive: Archive, positions: int, progress: Progress) -> None:
        """Spread positions evenly between the anchors.

        Args:
            archive: designs that the searches tried.
            positions: their number, the anchors included.
            progress: called with what is being done and the fraction done.
        """
        super().__init__(archive, progress)
        self._positions = np.linspace(-1.0, 1.0, positions)
        self.step = 2.0 / (positions - 1)
        self.spacing = self.step / 2.0

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Follow every branch from every optimum both ways, then what the archive shows, then into the gaps.

        Args:
            anchors: all local optima of either objective alone.
        """
        parameters = self.anchor_parameters()
        starts = [(self.recorded(point, p), 1 - k) for k, p in enumerate(parameters) for point in anchors[k]]
        for number, (candidate, objective) in enumerate(starts):
            self.progress(f"following branch {number + 1} of {len(starts)}", number / len(starts))
            self.follow(candidate, objective)
        self._search_between_anchors()
        self.follow_missed()
        self._fill_gaps()
        self.follow_missed(sample=False)

    def all_anchors(self, starts: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem near its starts."""
        return [self.anchors(p, own) for p, own in zip(self.anchor_parameters(), starts, strict=True)]

    # --- following a branch ------------------------------------------------------------------------------

    def follow(self, candidate: Candidate, objective: int) -> None:
        """Follow a branch towards less of an objective, one position after another, until it ends.

        The limit on the other objective loosens on the way, so that each optimum is a feasible start for the next.

        Args:
            candidate: on the branch.
            objective: number of the objective to reduce.
        """
        behind: list[Vector] = []
        failed, first = 0, candidate
        candidate.followed.add(objective)
        ahead = self._positions[self._positions > self._position_of(candidate, objective) - _OFF_POSITION]
        for position in ahead:
            start = extrapolated([*behind, candidate.point.y])
            p = self._parameters_for(objective, float(position))
            # A failure at the candidate's own position is not recorded: that position has the candidate.
            moves = position - self._position_of(candidate, objective) > _OFF_POSITION
            found = self.solve(candidate, start, p, report=bool(moves))
            if found is None:
                failed, behind = failed + 1, []
                if failed == _GIVE_UP:
                    return
                continue
            failed, behind = 0, [*behind, candidate.point.y][-_REMEMBERED:]
            candidate = found
            if objective in candidate.followed and candidate is not first:
                return
            candidate.followed.add(objective)
            if np.max(np.abs(found.point.y - start)) < _SAME_BRANCH:
                # The way back from here is the way that led here.
                candidate.followed.add(1 - objective)
            if position - self._position_of(candidate, objective) > _OFF_POSITION:
                return

    def _search_between_anchors(self) -> None:
        """Search for further branches at some positions, and follow those that are new both ways."""
        positions = _SEARCHED_POSITIONS if self.archive.vary else ()
        for number, position in enumerate(positions):
            self.progress(f"searching between the anchors, {number + 1} of {len(positions)}", number / len(positions))
            self._search_at(position)

    def _search_at(self, position: float) -> None:
        p = self._parameters_for(1, position)
        for y in self.archive.evolved_at(p):
            known = len(self.candidates)
            self.follow_new(self.no_worse_than(y, p), known)

    def follow_everywhere(self, candidate: Candidate) -> None:
        """Follow a branch both ways."""
        for objective in (1, 0):
            if objective not in candidate.followed:
                self.follow(candidate, objective)

    def cross_over(self) -> bool:
        """Start from points of the front with one variable taken from a neighbour on another branch.

        Where branches differ in one variable and the objectives ripple in another, the search may have seen the best
        ripple of a branch on the other branch only.

        Returns:
            Whether that gave a candidate better than all others.
        """
        improved = False
        for pair in pairwise(self.efficient()):
            for candidate, neighbour in (pair, pair[::-1]):
                p = self.parameters_at(candidate.objectives)
                for j in np.flatnonzero(np.abs(neighbour.point.y - candidate.point.y) > _OTHER_BRANCH):
                    start = candidate.point.y.copy()
                    start[j] = neighbour.point.y[j]
                    if start.tobytes() not in self.tried:
                        self.tried.add(start.tobytes())
                        known = len(self.candidates)
                        found = self.solve(neighbour, start, p, report=False)
                        improved |= self.follow_new(found, known)
        return improved

    def parameters_at(self, objectives: Vector) -> Vector:
        """Return the parameters of the subproblem whose position is that of normalised objectives."""
        return self._parameters_for(1, float(objectives[0] - objectives[1]))

    def _parameters_for(self, objective: int, position: float) -> Vector:
        """Return the parameters that minimise an objective with a limit on the other one's excess over it."""
        return self.front.limited(objective, {1 - objective: position}, relative=True)

    @staticmethod
    def _position_of(candidate: Candidate, objective: int) -> float:
        """Return by how much the other objective of a candidate exceeds this one."""
        return float(candidate.objectives[1 - objective] - candidate.objectives[objective])

    # --- gaps --------------------------------------------------------------------------------------------

    def efficient(self) -> list[Candidate]:
        """Return the candidates that no other dominates, from the best in the first objective to the worst."""
        sound = self.without_needles()
        return [sound[k] for k in undominated_in_order(self.objectives_of(sound))]

    def arrange(self, candidates: Sequence[Candidate]) -> Arrangement:
        """Return candidates arranged as a front: its points in order, its parts, and the gaps between them."""
        objectives, step = self.objectives_of(candidates), self.step
        best = undominated_in_order(objectives)
        own = best[without_needless(objectives[best], [candidates[k].between for k in best], step)]
        shown = own[uncrowded_on_curve(objectives[own], step)]
        breaks = gaps(objectives[shown], step)
        bounds = [0, *(k + 1 for k in breaks), len(shown)]
        return Arrangement(
            [candidates[k] for k in best],
            [candidates[k] for k in shown],
            tuple(tuple(range(i, j)) for i, j in pairwise(bounds)),
            tuple((k, k + 1) for k in breaks),
        )

    def _fill_gaps(self) -> None:
        """Follow the branches on either side of every gap into it, as far as the other side does not dominate them."""
        tried: set[bytes] = set()
        for number in range(_GAP_ROUNDS):
            front = self.efficient()
            objectives = self.objectives_of(front)
            sides = {np.round(objectives[k : k + 2], _GAP_DECIMALS).tobytes(): k for k in gaps(objectives, self.step)}
            fresh = [(front[k], front[k + 1]) for key, k in sides.items() if key not in tried]
            tried.update(sides)
            self.progress("following the front into gaps", number / _GAP_ROUNDS)
            for left, right in fresh:
                for candidate, objective in ((left, 1), (right, 0)):
                    if objective not in candidate.followed:
                        self.follow(candidate, objective)
                if self.archive.vary:
                    self._search_at(float(np.mean([self._position_of(side, 1) for side in (left, right)])))
                end = self._end(left, 1, float(right.objectives[0]) - _CLEARANCE)
                self._end(right, 0, float((end or left).objectives[1]) - _CLEARANCE)
            if not fresh:
                return

    def _end(self, candidate: Candidate, objective: int, limit: float) -> Candidate | None:
        """Return the design of a branch with the least of an objective while the other one is limited."""
        p = self.front.limited(objective, {1 - objective: limit})
        return self.solve(candidate, candidate.point.y, p, report=False)

    # --- finishing ---------------------------------------------------------------------------------------

    def find_inner_neighbours(self) -> None:
        """Give the ends of the front a neighbour on it, for their rates: multipliers at an end are not unique."""
        front = self.efficient()
        for number, one in enumerate(front):
            if self.front.position_decides(one.point):
                continue
            objective = 0 if number == len(front) - 1 else 1
            p = self._parameters_for(objective, self._position_of(one, objective) + _INWARD * self.step)
            point = self.front.solve(one.point, one.point.y, p, exact=one.exact)
            moved = np.sum(np.abs(self.front.objectives(point.y, exact=one.exact) - one.objectives))
            if point.solved and moved < self.step and self.front.position_decides(point):
                one.inner_neighbour = (point, p)
