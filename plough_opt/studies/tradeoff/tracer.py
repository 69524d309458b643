"""Follow ends, branches and basins of the archive that a front misses, or add them to it as they are."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.polishing import point_as_found
from plough_opt.design.sampling import SEED
from plough_opt.studies.tradeoff.archive import Archive
from plough_opt.studies.tradeoff.candidates import MATTERS, OTHERS, ROUGHLY, SOUGHT, Candidate, Candidates
from plough_opt.studies.tradeoff.domination import beating, beyond_front, beyond_points, undominated

# Times that is looked beside the front while that shows what it misses.
_LOOKS = 4
# How far from the best designs others are looked at, in parts of the variables' ranges, and at how many: between the
# ripples of a force they must see the dips.
_SPREADS, _BESIDE = (0.1, 0.03, 0.01, 0.003), 4096
# The same of missed designs that are not optima, as those at the edge of a needle are.
_EDGE_SPREADS, _BESIDE_EDGE = (0.03, 0.01, 0.003, 0.001), 1024
# Missed designs that are held against their tolerances at once, and how often others take the place of needles.
_MOST_JUDGED, _JUDGEMENTS = 100, 40
# Of more missed designs none is better than another by less than what matters.
_MANY = 10_000


class Tracer(Candidates):
    """Candidates, and how to find those that are missing.

    Attributes:
        matters: of the range of an objective: a design that the front misses by less is not sought.
        spacing: distance of missed designs that are followed at once, in normalised objectives.
        at_once: missed designs that are followed before the front is compared with the archive again.
        rounds: how often that is done before further designs beside the front are looked at.
    """

    matters: float
    spacing: float
    at_once: int
    rounds: int

    def __init__(self, archive: Archive, progress: Progress) -> None:
        """Take what looks at the designs of a front's program."""
        super().__init__(archive, progress)
        self._tried: set[bytes] = set()
        self._looks = 0

    @abstractmethod
    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Find the whole front from the local optima of each objective alone."""

    @abstractmethod
    def position(self, at: Vector) -> Vector:
        """Return the parameters that ask for the front's design at the place of normalised objectives."""

    @abstractmethod
    def follow_all(self, one: Candidate) -> None:
        """Follow the branch of a candidate wherever it leads."""

    @property
    def _looks_beside(self) -> bool:
        """Whether designs beside those of the archive are looked at, which few can be where runs go one by one."""
        return bool(self.archive.vary) and self.archive.vectorised

    def look_beside(self) -> None:
        """Look at designs about those of the archive that no other beats, at first far and then near."""
        self.progress("looking beside the best designs", 0.0)
        self._looks += 1
        rng = np.random.default_rng([SEED, self._looks])
        for spread in _SPREADS:
            y, at, beyond = self._held_against()
            open_ones = np.flatnonzero(beyond > 0.0)
            best = y[open_ones[undominated(at[open_ones], ROUGHLY)]]
            self._look_around(np.vstack([best, *(one.point.y for one in self.ordered())]), spread, _BESIDE, rng)

    def _look_around(self, best: Vector, spread: float, count: int, rng: np.random.Generator) -> None:
        """Look at so many designs about some, as far from them as a spread says."""
        parents = best[rng.integers(len(best), size=count)]
        self.archive.look(np.clip(parents + spread * rng.standard_normal(parents.shape), 0.0, 1.0))

    def _held_against(self) -> tuple[Vector, Vector, Vector]:
        """Return the archive's designs, their normalised objectives, and by how much each is better than all found.

        Candidates that others dominate, and needles, do not count.
        """
        y, at = self.archive.feasible
        return y, at, self.archive.beyond({one: one.at for one in self.ordered()})

    def uncovered(self, _own: Vector, at: Vector) -> Vector:
        """Return how far designs lie from the front's points where it has too few, else 0; a curve has enough."""
        return np.zeros(len(at))

    def candidate_beside(self, y: Vector) -> Candidate | None:
        """Return the local optimum beside a design that the front misses, None without one.

        It is sought at the design's own place, as the program itself has it: a search integrates otherwise, and at the
        bottom of a narrow dip nothing lies at a place that is better by a hair. In such a dip less of one objective, or
        of another, is found where the others stay as they are; so it is where the place holds an optimum back.
        """
        front, held = self.front, None
        at = front.objectives(y)
        others = [{j: float(at[j]) for j in range(front.count) if j != k} for k in range(front.count)]
        for p in (self.position(at), *(front.limited(k, limits, OTHERS) for k, limits in enumerate(others))):
            found = self.best_from(p, y)
            if found is not None and self.is_efficient(found):
                return found
            held = held or found
        return held

    def reach_all(self, *, look: bool = True) -> None:
        """Follow the designs that the archive has beyond the front, until none is left that is not a needle.

        Args:
            look: whether to look beside the front first; where that shows what the front misses, it is done again.
        """
        for _ in range(_LOOKS):
            if look and self._looks_beside:
                self.look_beside()
            look = self._follow_missed()
            if not look:
                return

    def follow_new(self, found: Candidate | None, known: int) -> bool:
        """Follow the branch of a candidate that was not known; return whether none other is as good as it.

        Args:
            found: the candidate.
            known: number of candidates before it was found.
        """
        if found is None or len(self.found) == known:
            return False
        found.extra = True
        best = not self.is_beaten(found)
        self.follow_all(found)
        return best

    def _follow_missed(self) -> bool:
        """Follow the designs that the front misses now; return whether any led to what no candidate was as good as."""
        found_any = False
        for number in range(self.rounds):
            missed = self.missed(self._tried)
            for k, y in enumerate(missed[: self.at_once]):
                self.progress("following designs that the front misses", (number + k / self.at_once) / self.rounds)
                self._tried.add(y.tobytes())
                known = len(self.found)
                found_any |= self.follow_new(self.candidate_beside(y), known)
            if not missed:
                break
        return found_any

    def is_beaten(self, one: Candidate) -> bool:
        """Return whether some other candidate is as good in all objectives to what matters, and better in one."""
        others = self.places([other for other in self.found if other is not one])
        better = np.all(others <= one.at + MATTERS, axis=1) & np.any(others < one.at - MATTERS, axis=1)
        return bool(np.any(better))

    def missed(self, known: set[bytes], *, sparse: bool = True) -> list[Vector]:
        """Return designs by which the front could be better, where it was to be searched, none beside another.

        They are better than the front, or beat one of its points.

        Args:
            known: designs that are left out, as bytes: those that were tried in vain would hide others beside them.
            sparse: whether to add those that lie where the front has too few points.
        """
        if not self.archive.vary:
            return []
        y, at, beyond = self._held_against()
        own = self.places(self.ordered())
        left = np.flatnonzero(beyond > SOUGHT)
        gain = self._gains(own, at, beyond, left, sparse)
        best = np.empty(0, dtype=int)
        for _ in range(_JUDGEMENTS):
            # At first many designs are wanted, of which a rough choice does.
            left = left[gain[left] > self.matters]
            best = left[undominated(at[left], SOUGHT if len(left) < _MANY else self.matters)]
            best = best[[y[k].tobytes() not in known for k in best]] if known else best
            best = best[np.argsort(-gain[best], kind="stable")][:_MOST_JUDGED]
            needles = self.archive.needles(y[best], at[best])
            if not np.any(needles):
                break
            self.archive.leave_out(best[needles])
            left, best = np.setdiff1d(left, best[needles]), best[~needles]
        chosen: list[int] = []
        for k in best:
            if all(np.max(np.abs(at[k] - at[i])) > self.spacing for i in chosen):
                chosen.append(int(k))
        return [y[k] for k in chosen]

    def _gains(self, own: Vector, at: Vector, beyond: Vector, left: NDArray[np.intp], sparse: bool) -> Vector:
        """Return by how much the front would gain by each of the designs that are left; of others nothing."""
        gain = np.zeros(len(at))
        large = left[beyond[left] > self.matters]
        gain[large] = beyond_front(own, at[large], self.step)
        # What beats a point counts, too, by however little the line beside that is better.
        most, by = beating(own, at[left])
        better = left[most[by > SOUGHT]]
        gain[better] = np.maximum(gain[better], 2.0 * self.matters)
        if sparse:
            gain[left] = np.maximum(gain[left], self.uncovered(own, at[left]))
        return gain

    def add_unconfirmed(self) -> None:
        """Add the missed designs beside which no optimum was found, as they were seen.

        The best that can be made may be no optimum: where an optimum is a needle, such designs lie at its edge.
        """
        added: set[bytes] = set()
        rng = np.random.default_rng([SEED, 0])
        for spread in _EDGE_SPREADS:
            if not (missed := self.missed(added, sparse=False)):
                return
            if self.archive.vectorised:
                self.progress("looking beside designs that are not optima", 0.0)
                self._look_around(np.array(missed), spread, _BESIDE_EDGE, rng)
        while missed := self.missed(added, sparse=False):
            for y in missed:
                added.add(y.tobytes())
                at = self.front.objectives(y)
                # A search integrates more roughly, and may have been wrong about it.
                if beyond_points(self.places(self.ordered()), at[None])[0] > SOUGHT:
                    p = self.position(at)
                    self.found.append(Candidate(point_as_found(self.front.program, p, y), p, at, confirmed=False))
