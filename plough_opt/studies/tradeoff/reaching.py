"""Local optima wherever the cloud has designs that a front misses: ends, branches and basins."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.polishing import as_it_is
from plough_opt.design.sampling import SEED
from plough_opt.studies.tradeoff.missing import beating, beyond_front, beyond_points, thinned
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.samples import (
    MATTERS,
    MOST_JUDGED,
    NOT_WORSE,
    OTHERS,
    ROUGHLY,
    SOUGHT,
    Sample,
    Samples,
)
from plough_opt.studies.tradeoff.searching import Searcher

# Rounds of following missed designs, and how many in each.
_ROUNDS, _AT_ONCE = 12, 6
# Times that is looked beside the front while that shows what it misses.
_LOOKS = 4
# How far from the best designs others are looked at, in parts of the variables' ranges.
_SPREADS = 0.1, 0.03, 0.01, 0.003
# At how many others: between the ripples of a force they must see the dips.
_BESIDE = 4096
# The same of missed designs that are not optima, as those at the edge of a needle are.
_EDGE_SPREADS, _BESIDE_EDGE = (0.03, 0.01, 0.003, 0.001), 1024


class Reaching(Samples):
    """All local optima found, and how to find those that are missing.

    Attributes:
        matters: of the range of an objective: a design that the front misses by less is not sought.
    """

    matters: float

    def __init__(self, front: FrontProgram, searcher: Searcher, progress: Progress) -> None:
        """Take the program, and what searches over its variables."""
        super().__init__(front, searcher, progress)
        self._pricks: set[int] = set()
        self._tried: set[bytes] = set()
        self._looks = 0
        # Of each design of the cloud by how much it is better than all samples that it was held against, and these.
        self._beyond = np.empty(0)
        self._against: dict[int, Vector] = {}

    @abstractmethod
    def position(self, at: Vector) -> Vector:
        """Return the parameters that ask for the front's design at the place of normalised objectives."""

    @abstractmethod
    def follow_all(self, sample: Sample) -> None:
        """Follow the branch of a sample wherever it leads."""

    def _look_beside(self) -> None:
        """Look at designs about those of the cloud that no other beats, at first far and then near."""
        self._looks += 1
        rng = np.random.default_rng([SEED, self._looks])
        for spread in _SPREADS:
            y, at, beyond = self._held_against_samples()
            open_ones = np.flatnonzero(beyond > 0.0)
            best = y[open_ones[thinned(at[open_ones], ROUGHLY)]]
            best = np.vstack([best, *(sample.point.y for sample in self.ordered())])
            self._look_around(best, spread, _BESIDE, rng)

    def _look_around(self, best: Vector, spread: float, count: int, rng: np.random.Generator) -> None:
        """Look at so many designs about some, as far from them as a spread says."""
        parents = best[rng.integers(len(best), size=count)]
        self.cloud.look(np.clip(parents + spread * rng.standard_normal(parents.shape), 0.0, 1.0))

    def _held_against_samples(self) -> tuple[Vector, Vector, Vector]:
        """Return the cloud's designs, their normalised objectives, and by how much each is better than all samples.

        Samples that others dominate, and needles, do not count. Designs and samples only join.
        """
        y, scaled = self.cloud.feasible
        at = self.front.normalised(scaled)
        fresh = {id(sample): sample.at for sample in self.ordered() if id(sample) not in self._against}
        known = len(self._beyond)
        if fresh and known:
            rows = np.array(list(fresh.values()))
            self._beyond = np.minimum(self._beyond, beyond_points(rows, at[:known]))
        self._against |= fresh
        if len(at) > known:
            rows = np.array(list(self._against.values()))
            self._beyond = np.r_[self._beyond, beyond_points(rows, at[known:])]
        return y, at, self._beyond

    def uncovered(self, _own: Vector, at: Vector) -> NDArray[np.bool_]:
        """Return which designs lie where the front has too few points; a curve has enough."""
        return np.zeros(len(at), dtype=bool)

    def sample_at(self, p: Vector, y: Vector) -> Sample | Point:
        """Return the local optimum beside a design at a position, no worse than it, or where the optimiser stopped."""
        begins = as_it_is(self.front.program, p, y)
        near = min(self.found, key=lambda sample: float(np.max(np.abs(sample.point.y - y))))
        point, level = self.optimum(near.point, y, p, near.coarsest, patient=False)
        if not point.solved or point.f > begins.f + NOT_WORSE * max(abs(begins.f), 1.0):
            point, level = self._to_the_last_digit(self._polished(p, y), p), self.level_of_anchors
        return self.at_the_edge(p, point, level) if point.solved else point

    def sample_beside(self, y: Vector) -> Sample | Point:
        """Return the local optimum beside a design that the front misses, or where the optimiser stopped.

        It is sought at the design's own place, as the program itself has it: a search integrates otherwise, and at the
        bottom of a narrow dip nothing lies at a place that is better by a hair. In such a dip less of one objective, or
        of another, is found where the others stay as they are; so it is where the place holds an optimum back.
        """
        front, held = self.front, None
        near = min(self.found, key=lambda sample: float(np.max(np.abs(sample.point.y - y))))
        at = front.normalised(front.objectives(y, near.coarsest))
        others = [{j: float(at[j]) for j in range(front.count) if j != k} for k in range(front.count)]
        asked = [self.position(at), *(front.below(k, limits, OTHERS) for k, limits in enumerate(others))]
        for p in asked:
            begins = as_it_is(front.program, p, y)
            point, level = self.optimum(near.point, y, p, near.coarsest, patient=False)
            if point.solved and point.f <= begins.f + NOT_WORSE * max(abs(begins.f), 1.0):
                found = self.at_the_edge(p, point, level)
                if self.is_efficient(found):
                    return found
                held = held or found
        return held or self.sample_at(asked[0], y)

    def at_the_edge(self, p: Vector, point: Point, level: int) -> Sample:
        """Return the sample of an optimum at a position; where the position does not hold it, that of the edge."""
        return self.kept(point, p, level)

    def reach_all(self, *, look: bool = True) -> None:
        """Follow the designs that the cloud has beyond the front, until none is left that is not a needle.

        Args:
            look: whether to look beside the front first; where that shows what the front misses, it is done again.
        """
        for _ in range(_LOOKS):
            if look and self.searcher.vary and self.cloud.vectorised:
                self.progress("looking beside the best designs", 0.0)
                self._look_beside()
            look = self._follow_missed()
            if not look:
                return

    def _follow_missed(self) -> bool:
        """Follow the designs that the front misses now; return whether any led to what no sample was as good as."""
        found_any = False
        for number in range(_ROUNDS):
            missed = self.missed(self._tried)
            for k, y in enumerate(missed[:_AT_ONCE]):
                self.progress("following designs that the front misses", (number + k / _AT_ONCE) / _ROUNDS)
                self._tried.add(y.tobytes())
                known = len(self.found)
                found = self.sample_beside(y)
                if not isinstance(found, Point) and len(self.found) > known:
                    found.extra = True
                    found_any = found_any or not self.is_beaten(found)
                    self.follow_all(found)
            if not missed:
                break
        return found_any

    def is_beaten(self, sample: Sample) -> bool:
        """Return whether some other sample is as good in all objectives to what matters, and better in one."""
        others = np.array([other.at for other in self.found if other is not sample]).reshape(-1, len(sample.at))
        better = np.all(others <= sample.at + MATTERS, axis=1) & np.any(others < sample.at - MATTERS, axis=1)
        return bool(np.any(better))

    def missed(self, known: set[bytes]) -> list[Vector]:
        """Return designs by which the front could be better, where it was to be searched, none beside another.

        They are better than the front, beat one of its points, or lie where it has too few.

        Args:
            known: designs that are left out, as bytes: those that were tried in vain would hide others beside them.
        """
        if not self.searcher.vary:
            return []
        y, at, beyond = self._held_against_samples()
        own = np.array([sample.at for sample in self.ordered()])
        left, best, gain = np.flatnonzero(beyond > SOUGHT), np.empty(0, dtype=int), np.empty(0)
        left = np.setdiff1d(left, list(self._pricks))
        while len(left):
            best = left[thinned(at[left], self.matters)]
            gain = beyond_front(own, at[best], self.step)
            few = self.uncovered(own, at[best])
            gain[few] = np.maximum(gain[few], 2.0 * self.matters)
            best, gain = self._with_beating(own, at, left, best, gain)
            order = np.argsort(-gain, kind="stable")
            order = order[gain[order] > self.matters][:MOST_JUDGED]
            best, gain = best[order], gain[order]
            needles = self.cloud.needles(y[best], self.front.scaled(at[best]))
            if not np.any(needles):
                break
            self._pricks |= {int(k) for k in best[needles]}
            left, best = np.setdiff1d(left, best[needles]), best[:0]
        chosen: list[int] = []
        for k in best:
            if y[k].tobytes() in known:
                continue
            if all(np.max(np.abs(at[k] - at[i])) > self.step / 2.0 for i in chosen):
                chosen.append(int(k))
        return [y[k] for k in chosen]

    def _with_beating(
        self, own: Vector, at: Vector, left: NDArray[np.intp], best: NDArray[np.intp], gain: Vector
    ) -> tuple[NDArray[np.intp], Vector]:
        """Return designs and their gains, and with them those that are better than a point in all objectives."""
        much = beating(own, at[left])
        better = left[much > SOUGHT]
        better = better[thinned(at[better], SOUGHT)]
        fresh = np.setdiff1d(better, best)
        gain[np.isin(best, better)] = np.maximum(gain[np.isin(best, better)], 2.0 * self.matters)
        return np.r_[best, fresh], np.r_[gain, np.full(len(fresh), 2.0 * self.matters)]

    @property
    def needles_beyond(self) -> int:
        """How many needles were seen beyond the front, those that others beat apart."""
        return len(self._pricks)

    def add_unconfirmed(self) -> None:
        """Add the missed designs beside which no optimum was found, as they were seen.

        The best that can be made may be no optimum: where an optimum is a needle, such designs lie at its edge.
        """
        added: set[bytes] = set()
        rng = np.random.default_rng([SEED, 0])
        for spread in _EDGE_SPREADS:
            if not (missed := self.missed(added)):
                return
            if self.cloud.vectorised:
                self.progress("looking beside designs that are not optima", 0.0)
                self._look_around(np.array(missed), spread, _BESIDE_EDGE, rng)
        while missed := self.missed(added):
            for y in missed:
                added.add(y.tobytes())
                at = self.front.normalised(self.front.objectives(y, self.coarsest))
                # A search integrates more roughly, and may have been wrong about it.
                if beyond_points(np.array([own.at for own in self.ordered()]), at[None])[0] > SOUGHT:
                    p = self.position(at)
                    self.found.append(Sample(as_it_is(self.front.program, p, y), p, at, self.coarsest, confirmed=False))
