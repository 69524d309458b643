"""Tracing of a front: designs of the archive that the front misses are followed, or added to it unconfirmed."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.polishing import point_as_found
from plough_opt.design.sampling import SEED
from plough_opt.studies.tradeoff.archive import Archive
from plough_opt.studies.tradeoff.candidates import MATTERS, OTHERS_WEIGHT, SOUGHT, THINNING, Candidate, Candidates
from plough_opt.studies.tradeoff.domination import (
    lead_over_front,
    lead_over_points,
    strongest_dominators,
    undominated,
)

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


class Tracer(Candidates):
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
    def parameters_at(self, objectives: Vector) -> Vector:
        """Return the parameters of the subproblem whose position is that of normalised objectives."""

    @abstractmethod
    def follow_everywhere(self, candidate: Candidate) -> None:
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
            best = designs[leading[undominated(objectives[leading], THINNING)]]
            parents = np.vstack([best, *(candidate.point.y for candidate in self.efficient())])
            self._sample_around(parents, spread, _SAMPLE, rng)

    def _sample_around(self, designs: Vector, spread: float, count: int, rng: np.random.Generator) -> None:
        """Add designs to the archive, normally distributed around some that are given."""
        parents = designs[rng.integers(len(designs), size=count)]
        self.archive.evaluate(np.clip(parents + spread * rng.standard_normal(parents.shape), 0.0, 1.0))

    def _archive_with_leads(self) -> tuple[Vector, Vector, Vector]:
        """Return the archive's designs, their normalised objectives, and their leads over the efficient candidates."""
        designs, objectives = self.archive.feasible
        leads = self.archive.leads_over({candidate: candidate.objectives for candidate in self.efficient()})
        return designs, objectives, leads

    def candidate_beside(self, y: Vector) -> Candidate | None:
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
        limited = (front.limited(k, own, OTHERS_WEIGHT) for k, own in enumerate(limits))
        for p in (self.parameters_at(objectives), *limited):
            found = self.no_worse_than(y, p)
            if found is not None and self.balances(found):
                return found
            fallback = fallback or found
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

    def follow_new(self, candidate: Candidate | None, known: int) -> bool:
        """Follow the branch of a candidate if it is new.

        Args:
            candidate: the candidate, or None.
            known: number of candidates before it was found.

        Returns:
            Whether it is new and no other candidate is as good.
        """
        if candidate is None or len(self.candidates) == known:
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
                known = len(self.candidates)
                improved |= self.follow_new(self.candidate_beside(y), known)
            if not missed:
                break
        return improved

    def is_beaten(self, candidate: Candidate) -> bool:
        """Return whether some other candidate is better in one objective and, within what matters, no worse in any."""
        others = self.objectives_of([other for other in self.candidates if other is not candidate])
        no_worse = np.all(others <= candidate.objectives + MATTERS, axis=1)
        return bool(np.any(no_worse & np.any(others < candidate.objectives - MATTERS, axis=1)))

    def missed(self, excluded: set[bytes], *, sparse: bool = True) -> list[Vector]:
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

    def _gains(self, front: Vector, objectives: Vector, leads: Vector, left: NDArray[np.intp], sparse: bool) -> Vector:
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

    def uncovered(self, front: Vector, objectives: Vector) -> Vector:
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
                    self.candidates.append(Candidate(point, p, objectives, confirmed=False))
