"""Tracing of a front from every optimum of either objective alone, position by position, both ways.

All objectives are normalised and minimised. On a curve each objective is 0 at its own optimum and 1 at the optimum of
the other one. Between neighbouring positions of a connected curve, the sum of both changes is always the same.
"""

from abc import abstractmethod
from collections.abc import Sequence
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.plain_data import Array
from plough_opt.design.model.ipopt import Point
from plough_opt.design.search.explore import Progress
from plough_opt.design.search.landscape import SEED
from plough_opt.design.search.local import point_as_found
from plough_opt.studies.tradeoff.archive import (
    MATTERS,
    OTHERS_WEIGHT,
    SOUGHT,
    THINNING,
    Archive,
    Arrangement,
    FrontCandidate,
    FrontCandidates,
    extrapolated,
)
from plough_opt.studies.tradeoff.front import (
    CURVE_GAP,
    lead_over_front,
    lead_over_points,
    strongest_dominators,
    thinned,
    undominated,
    undominated_in_order,
)

# Neighbours on a curve closer than this many steps are shown as one point.
_CROWDED = 0.1


def gaps(front: Array, step: float) -> list[int]:
    """Return the rows of a front that are followed by a gap.

    Args:
        front: normalised objectives of efficient rows, in order.
        step: distance of neighbours, the sum of both changes.
    """
    distance = np.sum(np.abs(np.diff(front, axis=0)), axis=1)
    return [int(k) for k in np.flatnonzero(distance > CURVE_GAP * step)]


def uncrowded_on_curve(front: Array, step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those too close to another; the ends of its parts stay.

    Args:
        front: normalised objectives of efficient rows, in order.
        step: distance of neighbours, the sum of both changes.
    """
    begins = {0, *(k + 1 for k in gaps(front, step))}
    chosen: list[int] = []
    for k in range(len(front)):
        if chosen and np.sum(np.abs(front[k] - front[chosen[-1]])) < _CROWDED * step:
            if k + 1 not in {*begins, len(front)} or chosen[-1] in begins:
                continue
            chosen.pop()
        chosen.append(k)
    return np.array(chosen, dtype=np.intp)


def without_needless(front: Array, between: Sequence[bool], step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those between two positions that have no gap between them.

    Args:
        front: normalised objectives of efficient rows, in order.
        between: for each row whether it lies between positions.
        step: distance of neighbours, the sum of both changes.
    """
    chosen: list[int] = []
    for k in range(len(front)):
        inside = chosen and k + 1 < len(front)
        if between[k] and inside and np.sum(np.abs(front[k + 1] - front[chosen[-1]])) <= CURVE_GAP * step:
            continue
        chosen.append(k)
    return np.array(chosen, dtype=np.intp)


# Most rounds of sampling around the best designs, as long as each shows that the front misses something.
_MOST_ROUNDS = 4
# Standard deviations of the samples around the best designs, in parts of the variables' ranges.
_SPREADS = (0.1, 0.03, 0.01, 0.003)
# Designs in each of these samples: enough to see the dips between the ripples of a force.
_SAMPLE = 4096
# The same around missed designs without an optimum nearby, such as those at the edge of a needle.
_EDGE_SPREADS = (0.03, 0.01, 0.003, 0.001)
_EDGE_SAMPLE = 1024
# Missed designs whose tolerances are judged at once.
_JUDGED_AT_ONCE = 100
# Most rounds in which the next missed designs take the place of those that turned out to be needles.
_MOST_JUDGEMENTS = 40
# Above this number of missed designs, those that differ by less than what matters are thinned out.
_MANY = 10_000


class Tracer(FrontCandidates):
    """Candidates of a front, and the search for those that are missing.

    Attributes:
        matters: normalised lead of a design over the front below which it is not sought.
        spacing: least distance of missed designs that are followed at once, in normalised objectives.
        at_once: most missed designs that are followed before the archive is compared with the front again.
        comparisons: most such comparisons before new designs are sampled around the best.
        tried: starts that need not be tried again, as bytes.
    """

    matters: float
    spacing: float
    at_once: int
    comparisons: int

    def __init__(self, archive: Archive, progress: Progress) -> None:
        """Begin without a candidate.

        Args:
            archive: designs that the searches tried.
            progress: called with what is being done and the fraction done.
        """
        super().__init__(archive, progress)
        self.tried: set[bytes] = set()
        self._rounds = 0

    @abstractmethod
    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Find the whole front from the local optima of each anchor's subproblem."""

    @abstractmethod
    def parameters_at(self, objectives: Array) -> Array:
        """Return the parameters of the subproblem whose position is that of normalised objectives."""

    @abstractmethod
    def follow_everywhere(self, candidate: FrontCandidate) -> None:
        """Follow the branch of a candidate wherever it leads."""

    @property
    def _samples_around(self) -> bool:
        """Whether to sample around the best designs, which takes too long if runs are integrated one by one."""
        return bool(self.archive.vary) and self.archive.vectorised

    def sample_around_best(self) -> None:
        """Add designs around the undominated ones to the archive, at first far from them and then near."""
        self.progress("sampling around the best designs", 0.0)
        self._rounds += 1
        rng = np.random.default_rng([SEED + self.archive.seed, self._rounds])
        for spread in _SPREADS:
            designs, objectives, leads = self._archive_with_leads()
            leading = np.flatnonzero(leads > 0.0)
            best = designs[leading[thinned(objectives[leading], THINNING)]]
            parents = np.vstack([best, *(candidate.point.y for candidate in self.efficient())])
            self._sample_around(parents, spread, _SAMPLE, rng)

    def _sample_around(self, designs: Array, spread: float, count: int, rng: np.random.Generator) -> None:
        """Add designs to the archive, normally distributed around some that are given."""
        parents = designs[rng.integers(len(designs), size=count)]
        self.archive.evaluate(np.clip(parents + spread * rng.standard_normal(parents.shape), 0.0, 1.0))

    def _archive_with_leads(self) -> tuple[Array, Array, Array]:
        """Return the archive's designs, their normalised objectives, and their leads over the efficient candidates."""
        designs, objectives = self.archive.feasible
        leads = self.archive.leads_over({candidate: candidate.objectives for candidate in self.efficient()})
        return designs, objectives, leads

    def candidate_beside(self, y: Array) -> FrontCandidate | None:
        """Return an optimum near a design of the archive, or None if there is none as good.

        It is sought at the position of the design, and then with each objective minimised in turn while the others are
        limited to their values at the design. The latter finds optima in narrow dips, where no design at the position
        itself is as good, and those that their position holds back.

        Args:
            y: scaled variables of the design.
        """
        front, fallback = self.front, None
        objectives = front.objectives(y)
        limits = [{j: float(objectives[j]) for j in range(front.count) if j != k} for k in range(front.count)]
        limited = (front.limited(k, limit, OTHERS_WEIGHT) for k, limit in enumerate(limits))
        for p in (self.parameters_at(objectives), *limited):
            candidate = self.no_worse_than(y, p)
            if candidate is not None and self.balances(candidate):
                return candidate
            fallback = fallback or candidate
        return fallback

    def follow_missed(self, *, sample: bool = True) -> None:
        """Follow the designs of the archive that the front misses, until only needles are left.

        Args:
            sample: whether to sample around the best designs first. It is done again after whatever shows that the
                front missed something.
        """
        for _ in range(_MOST_ROUNDS):
            if sample and self._samples_around:
                self.sample_around_best()
            sample = self.cross_over() | self._follow_missed_now()
            if not sample:
                return

    def cross_over(self) -> bool:
        """Start from what branches have in common; return whether that gave a candidate better than all others."""
        return False

    def follow_new(self, candidate: FrontCandidate | None, before: int) -> bool:
        """Follow the branch of a candidate if it is new.

        Args:
            candidate: the candidate, or None.
            before: number of candidates before it was found.

        Returns:
            Whether it is new and no other candidate is as good.
        """
        if candidate is None or len(self.candidates) == before:
            return False
        candidate.between = True
        best = not self.is_beaten(candidate)
        self.follow_everywhere(candidate)
        return best

    def _follow_missed_now(self) -> bool:
        """Follow the designs that the front misses now; return whether that gave a candidate better than all others."""
        improved = False
        for number in range(self.comparisons):
            missed = self.missed(self.tried)
            for k, y in enumerate(missed[: self.at_once]):
                done = (number + k / self.at_once) / self.comparisons
                self.progress("following designs that the front misses", done)
                self.tried.add(y.tobytes())
                before = len(self.candidates)
                improved |= self.follow_new(self.candidate_beside(y), before)
            if not missed:
                break
        return improved

    def is_beaten(self, candidate: FrontCandidate) -> bool:
        """Return whether some other candidate is better in one objective and, within what matters, no worse in any."""
        others = self.objectives_of([other for other in self.candidates if other is not candidate])
        no_worse = np.all(others <= candidate.objectives + MATTERS, axis=1)
        return bool(np.any(no_worse & np.any(others < candidate.objectives - MATTERS, axis=1)))

    def missed(self, excluded: set[bytes], *, sparse: bool = True) -> list[Array]:
        """Return designs of the archive that would improve the front, best first and at least `spacing` apart.

        Such a design leads the front, or dominates one of its points. There are none if only the basin of the guess is
        searched.

        Args:
            excluded: designs to leave out, as bytes. Those tried in vain would hide others near them.
            sparse: whether to add designs where the front has too few points.
        """
        if not self.archive.vary:
            return []
        designs, objectives, leads = self._archive_with_leads()
        front = self.objectives_of(self.efficient())
        left = np.flatnonzero(leads > SOUGHT)
        gain = self._gains(front, objectives, leads, left, sparse)
        best = np.empty(0, dtype=int)
        for _ in range(_MOST_JUDGEMENTS):
            left = left[gain[left] > self.matters]
            best = left[undominated(objectives[left], SOUGHT if len(left) < _MANY else self.matters)]
            best = best[[designs[k].tobytes() not in excluded for k in best]] if excluded else best
            best = best[np.argsort(-gain[best], kind="stable")][:_JUDGED_AT_ONCE]
            needles = self.archive.needles(designs[best], objectives[best])
            if not np.any(needles):
                break
            self.archive.exclude(best[needles])
            left, best = np.setdiff1d(left, best[needles]), best[~needles]
        chosen: list[int] = []
        for k in best:
            if all(np.max(np.abs(objectives[k] - objectives[i])) > self.spacing for i in chosen):
                chosen.append(int(k))
        return [designs[k] for k in chosen]

    def _gains(self, front: Array, objectives: Array, leads: Array, left: NDArray[np.intp], sparse: bool) -> Array:
        """Return how much the front would gain by each design of the archive.

        Args:
            front: normalised objectives of its points.
            objectives: normalised objectives of the archive's designs.
            leads: of these over the front's points.
            left: numbers of the designs to judge; the others gain nothing.
            sparse: as in `missed`.
        """
        gain = np.zeros(len(objectives))
        large = left[leads[left] > self.matters]
        gain[large] = lead_over_front(front, objectives[large], self.step)
        # A design that dominates a point counts too, however little it leads the line or triangle next to that.
        strongest, by = strongest_dominators(front, objectives[left])
        better = left[strongest[by > SOUGHT]]
        gain[better] = np.maximum(gain[better], 2.0 * self.matters)
        if sparse:
            gain[left] = np.maximum(gain[left], self.uncovered(front, objectives[left]))
        return gain

    def uncovered(self, front: Array, objectives: Array) -> Array:
        """Return how far designs lie from every point where a front has too few; 0 for a curve, which has enough."""
        del front
        return np.zeros(len(objectives))

    def add_unconfirmed(self) -> None:
        """Add the missed designs without an optimum nearby, as they were simulated.

        Where an optimum is a needle, the best designs that can be made lie at its edge and are not optima.
        """
        added: set[bytes] = set()
        rng = np.random.default_rng([SEED + self.archive.seed, 0])
        for spread in _EDGE_SPREADS:
            if not (missed := self.missed(added, sparse=False)):
                return
            if self.archive.vectorised:
                self.progress("sampling around designs that are not optima", 0.0)
                self._sample_around(np.array(missed), spread, _EDGE_SAMPLE, rng)
        while missed := self.missed(added, sparse=False):
            for y in missed:
                added.add(y.tobytes())
                objectives = self.front.objectives(y)
                # The archive is integrated more roughly, and may be wrong about a design.
                if lead_over_points(self.objectives_of(self.efficient()), objectives[None])[0] > SOUGHT:
                    p = self.parameters_at(objectives)
                    point = point_as_found(self.front.program, p, y)
                    self.candidates.append(FrontCandidate(point, p, objectives, confirmed=False))


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
        for number, position in enumerate(_SEARCHED_POSITIONS if self.archive.vary else ()):
            self.progress("searching between the anchors", number / len(_SEARCHED_POSITIONS))
            self._search_at(position)
        self.follow_missed()
        self._fill_gaps()
        self.follow_missed(sample=False)

    def all_anchors(self, starts: Sequence[Sequence[Array]]) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem near its starts."""
        return [self.anchors(p, near) for p, near in zip(self.anchor_parameters(), starts, strict=True)]

    # --- following a branch ------------------------------------------------------------------------------

    def follow(self, candidate: FrontCandidate, objective: int) -> None:
        """Follow a branch towards less of an objective, one position after another, until it ends.

        The limit on the other objective loosens on the way, so that each optimum is a feasible start for the next.

        Args:
            candidate: on the branch.
            objective: number of the objective to reduce.
        """
        behind: list[Array] = []
        failed, first = 0, candidate
        candidate.followed.add(objective)
        ahead = self._positions[self._positions > self._position_of(candidate, objective) - _OFF_POSITION]
        for position in ahead:
            start = extrapolated([*behind, candidate.point.y])
            p = self._parameters_for(objective, float(position))
            # A failure at the candidate's own position is not recorded: that position has the candidate.
            moves = position - self._position_of(candidate, objective) > _OFF_POSITION
            optimum = self.solve(candidate, start, p, report=bool(moves))
            if optimum is None:
                failed, behind = failed + 1, []
                if failed == _GIVE_UP:
                    return
                continue
            failed, behind = 0, [*behind, candidate.point.y][-_REMEMBERED:]
            candidate = optimum
            if objective in candidate.followed and candidate is not first:
                return
            candidate.followed.add(objective)
            if np.max(np.abs(optimum.point.y - start)) < _SAME_BRANCH:
                # The way back from here is the way that led here.
                candidate.followed.add(1 - objective)
            if position - self._position_of(candidate, objective) > _OFF_POSITION:
                return

    def _search_at(self, position: float) -> None:
        """Search for further branches at a position, and follow those that are new both ways."""
        p = self._parameters_for(1, position)
        for y in self.archive.evolved_at(p):
            before = len(self.candidates)
            self.follow_new(self.no_worse_than(y, p), before)

    def follow_everywhere(self, candidate: FrontCandidate) -> None:
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
        improved, front = False, self.efficient()
        for candidate, neighbour in chain.from_iterable((pair, pair[::-1]) for pair in pairwise(front)):
            p = self.parameters_at(candidate.objectives)
            for j in np.flatnonzero(np.abs(neighbour.point.y - candidate.point.y) > _OTHER_BRANCH):
                start = candidate.point.y.copy()
                start[j] = neighbour.point.y[j]
                if start.tobytes() not in self.tried:
                    self.tried.add(start.tobytes())
                    before = len(self.candidates)
                    improved |= self.follow_new(self.solve(neighbour, start, p, report=False), before)
        return improved

    def parameters_at(self, objectives: Array) -> Array:
        """Return the parameters of the subproblem whose position is that of normalised objectives."""
        return self._parameters_for(1, float(objectives[0] - objectives[1]))

    def _parameters_for(self, objective: int, position: float) -> Array:
        """Return the parameters that minimise an objective with a limit on the other one's excess over it."""
        return self.front.limited(objective, {1 - objective: position}, relative=True)

    @staticmethod
    def _position_of(candidate: FrontCandidate, objective: int) -> float:
        """Return by how much the other objective of a candidate exceeds this one."""
        return float(candidate.objectives[1 - objective] - candidate.objectives[objective])

    # --- gaps --------------------------------------------------------------------------------------------

    def efficient(self) -> list[FrontCandidate]:
        """Return the candidates that no other dominates, from the best in the first objective to the worst."""
        sound = self.without_needles()
        return [sound[k] for k in undominated_in_order(self.objectives_of(sound))]

    def arrange(self, candidates: Sequence[FrontCandidate]) -> Arrangement:
        """Return candidates arranged as a front: its points in order, its parts, and the gaps between them."""
        objectives, step = self.objectives_of(candidates), self.step
        best = undominated_in_order(objectives)
        needed = best[without_needless(objectives[best], [candidates[k].between for k in best], step)]
        shown = needed[uncrowded_on_curve(objectives[needed], step)]
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

    def _end(self, candidate: FrontCandidate, objective: int, limit: float) -> FrontCandidate | None:
        """Return the design of a branch with the least of an objective while the other one is limited."""
        p = self.front.limited(objective, {1 - objective: limit})
        return self.solve(candidate, candidate.point.y, p, report=False)

    # --- finishing ---------------------------------------------------------------------------------------

    def find_inner_neighbours(self) -> None:
        """Give the ends of the front a neighbour on it, for their rates: multipliers at an end are not unique."""
        front = self.efficient()
        for number, candidate in enumerate(front):
            if self.front.position_decides(candidate.point):
                continue
            objective = 0 if number == len(front) - 1 else 1
            p = self._parameters_for(objective, self._position_of(candidate, objective) + _INWARD * self.step)
            point = self.front.solve(candidate.point, candidate.point.y, p, exact=candidate.exact)
            moved = np.sum(np.abs(self.front.objectives(point.y, exact=candidate.exact) - candidate.objectives))
            if point.solved and moved < self.step and self.front.position_decides(point):
                candidate.inner_neighbour = (point, p)
