"""Local optima of a trade-off: those of each objective alone, and others from neighbours, kept once each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from plough_opt.design.basin import near_optimum
from plough_opt.design.curvature import minimum_from
from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import REMEDIES, Point, Vector
from plough_opt.design.polishing import as_it_is, polished
from plough_opt.motion.scene import Scene
from plough_opt.studies.tradeoff.cloud import Cloud
from plough_opt.studies.tradeoff.missing import thinned
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.searching import Searcher

# Weight of the other objectives in an anchor: what is indifferent to one objective is decided by the others.
OTHERS = 1e-4
MATTERS = 1e-3
"""Of the range of an objective: a design that is better by less is no better."""

SOUGHT = 5e-4
"""The same for what is followed: half of it, for the front is judged in ranges, and by runs, that differ a little."""

ROUGHLY = 1e-2
"""Of ranges: designs are thinned to so much for which the program is written, or beside which others are looked at."""

NOT_WORSE = 1e-5
"""Of the scaled objective: an optimum above its start by less is no worse, for searches integrate roughly."""

MOST_JUDGED = 100
"""Designs that are held against their tolerances at once."""

# Two optima nearer than this, in normalised objectives and in scaled variables, are one.
_SAME_OBJECTIVES = 1e-6
_SAME_DESIGN = 1e-4
# An optimum with its last digits is no further from where it was without them.
_BESIDE = 0.05
# Ratios of ranges that weights follow.
_RATIOS = 1e-3, 1e3
# Times that an anchor is sought anew from a better design, of how many such designs, and what is rounding.
_OVERLOOKED, _MOST_SEEN, _ROUNDING = 3, 1000, 1e-5


@dataclass
class Sample:
    """A local optimum on some branch.

    Attributes:
        point: as the optimiser left it.
        p: parameters of the program that it is an optimum of.
        at: normalised objectives.
        level: of the program that found it.
        coarsest: level that suits its neighbours.
        swept: objectives in whose direction its branch has been followed from here.
        extra: whether it was sought for a design that the front missed, and lies between positions.
        inward: at an end, an optimum and its parameters a little along the front, where the multipliers are unique.
        scenes: of its runs, with numbers, and how long each runs [s], once it is certified.
        needle: whether no workshop can hit it; None until that is asked.
        confirmed: whether it is an optimum; else a design that the search saw, beside which none was found.
    """

    point: Point
    p: Vector
    at: Vector
    level: int = 0
    coarsest: int = 0
    swept: set[int] = field(default_factory=set)
    extra: bool = False
    inward: tuple[Point, Vector] | None = None
    scenes: list[tuple[Scene, float]] = field(default_factory=list)
    needle: bool | None = None
    confirmed: bool = True


@dataclass(frozen=True)
class Order:
    """Rows of a front.

    Attributes:
        efficient: those that no other dominates.
        kept: those of them that do not crowd, in order.
        parts: numbers of kept rows.
        holes: pairs of kept rows between which there is none.
    """

    efficient: frozenset[int]
    kept: tuple[int, ...]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Failure:
    """A position without a certified design.

    Attributes:
        objectives: normalised objectives of the neighbour from which it was sought.
        reason: why it failed.
    """

    objectives: tuple[float, ...]
    reason: str


class Samples(ABC):
    """All local optima found, and how to find one beside another.

    Attributes:
        step: distance of neighbouring positions in the normalised objectives.
    """

    step: float

    def __init__(self, front: FrontProgram, searcher: Searcher, progress: Progress) -> None:
        """Take the program, and what searches over its variables."""
        self.front = front
        self.searcher = searcher
        self.cloud: Cloud = searcher.cloud
        self.progress = progress
        self.found: list[Sample] = []
        self.failures: list[Failure] = []
        self._ranges = np.ones(front.count)

    @property
    def coarsest(self) -> int:
        """The number of the level with the fewest steps, or with slopes by differences."""
        return len(self.front.levels) - 1

    @property
    def level_of_anchors(self) -> int:
        """The number of the level that has solved the optima of objectives alone."""
        return self.coarsest if self.front.by_differences(self.coarsest) else 0

    # --- anchors -----------------------------------------------------------------------------------------

    @abstractmethod
    def alone(self) -> list[Vector]:
        """Return the parameters for each objective alone."""

    def in_ranges(self, weights: Vector) -> Vector:
        """Return the parameters for weights of the objectives on their ranges, that of the heaviest on its size.

        Without that, what little another objective weighs may be more than the range of one that hardly changes.
        """
        first = int(np.argmax(weights))
        return self.front.weighted(weights * np.clip(self._ranges[first] / self._ranges, *_RATIOS))

    def begin(self) -> list[list[Vector]]:
        """Return starts for each objective alone, and write the program with the steps that these need.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no design has a value.
        """
        if not self.searcher.vary:
            self.progress("solving from the guess", 0.0)
            program = self.front.program
            starts = [[near_optimum(self.cloud.landscape(p), program.start()).y] for p in self.alone()]
        else:
            starts = [list(self.searcher.bottoms(p).points) for p in self.alone()]
        self._normalise_roughly([own[0] for own in starts])
        self.front.build([y for own in starts for y in own] + self._best_seen())
        return starts

    def _normalise_roughly(self, ends: Sequence[Vector]) -> None:
        """Normalise by the starts, so that needles can be recognised."""
        at = self.cloud.look(np.array(ends))[0]
        low, high = at.min(axis=0), at.max(axis=0)
        self._ranges = np.maximum(high - low, _SAME_OBJECTIVES * np.maximum(np.abs(at).max(axis=0), 1.0))
        self.front.normalise(low, self._ranges)

    def _best_seen(self) -> list[Vector]:
        """Return the designs of the cloud that no other beats by more than a hundredth of a range."""
        y, scaled = self.cloud.feasible
        return list(y[thinned(self.front.normalised(scaled), ROUGHLY)])

    def anchors(self, p: Vector, starts: Sequence[Vector]) -> list[Point]:
        """Return the local optima beside starts, needles last, of the others the best first.

        Args:
            p: parameters that set no position.
            starts: scaled designs.
        """
        points = self._needles_last([self._anchor(p, y) for y in starts])
        for _ in range(_OVERLOOKED if self.searcher.vary else 0):
            better = self._better_seen(p, points[0]) if points else None
            if better is None or not (found := self._anchor(p, better)).solved or found.f >= points[0].f:
                break
            points = self._needles_last([*points, found])
        return points

    def _anchor(self, p: Vector, y: Vector) -> Point:
        """Return the local optimum beside a design."""
        point = minimum_from(self.front.program, p, self._polished(p, y))
        return self._to_the_last_digit(point, p) if point.solved else point

    def _needles_last(self, points: Sequence[Point]) -> list[Point]:
        """Return what is solved, needles last, of the others the best first."""
        solved = [point for point in points if point.solved]
        if not solved:
            return []
        objectives = np.array([self.front.objectives(point.y) for point in solved])
        needles = self.cloud.needles(np.array([point.y for point in solved]), objectives)
        return [solved[k] for k in sorted(range(len(solved)), key=lambda k: (bool(needles[k]), solved[k].f))]

    def _better_seen(self, p: Vector, best: Point) -> Vector | None:
        """Return the best design of the cloud that is better than an anchor and no needle, or None."""
        y, scaled = self.cloud.feasible
        weights = self.front.asked(p)[0]
        values = weights[0] + scaled @ weights[1:]
        margin = max(MATTERS * float(np.min(self._ranges)), _ROUNDING * abs(best.f))
        better = np.flatnonzero(values < best.f * self.front.program.objective_scale - margin)
        better = better[np.argsort(values[better], kind="stable")][:_MOST_SEEN]
        for first in range(0, len(better), MOST_JUDGED):
            part = better[first : first + MOST_JUDGED]
            sound = part[~self.cloud.needles(y[part], scaled[part])]
            if len(sound):
                return np.asarray(y[sound[0]])
        return None

    def _polished(self, p: Vector, y: Vector) -> Point:
        """Return the local optimum beside a design that a search found; never a worse one."""
        begins = as_it_is(self.front.program, p, y)
        if self.front.by_differences(self.coarsest):
            point = self.front.solve(begins, y, p, self.coarsest, patient=False)
            if point.solved and point.f <= begins.f + NOT_WORSE * max(abs(begins.f), 1.0):
                return point
        return polished(self.front.program, p, y)

    def _to_the_last_digit(self, point: Point, p: Vector) -> Point:
        """Return an optimum solved to rounding, where that can be had beside it.

        Where slopes are differences, only what makes up the front is solved so, once that is known.
        """
        if self.front.by_differences(self.coarsest):
            return point
        again = self.front.solve(point, point.y, p, patient=False)
        beside = np.max(np.abs(again.y - point.y)) < _BESIDE and again.f <= point.f + NOT_WORSE * abs(point.f)
        return again if again.solved and beside else point

    # --- solving -----------------------------------------------------------------------------------------

    def solve(self, near: Sample, start: Vector, p: Vector, *, reported: bool = True) -> Sample | Point:
        """Return the optimum near a start as a sample, or where the optimiser stopped.

        Args:
            near: the sample whose multipliers and steps it starts with.
            start: scaled variables.
            p: parameters.
            reported: whether a failure is reported.
        """
        point, level = self.optimum(near.point, start, p, near.coarsest)
        if point.solved:
            return self.kept(point, p, level)
        if reported:
            self.fail(near, point)
        return point

    def optimum(self, at: Point, start: Vector, p: Vector, level: int, *, patient: bool = True) -> tuple[Point, int]:
        """Return the optimum near a start, integrated as finely as it needs, and the level that does so.

        Args:
            at: a neighbour, for its multipliers.
            start: scaled variables.
            p: parameters.
            level: to begin with.
            patient: as in `FrontProgram.solve`.
        """
        point = self.front.solve(at, start, p, level, patient=patient)
        while point.solved and level > 0 and not self.front.accurate(point.y, level):
            level -= 1
            point = self.front.solve(point, point.y, p, level)
        return point, level

    def kept(self, point: Point, p: Vector, level: int = 0) -> Sample:
        """Return a point's sample: an earlier one where the same design was found before."""
        at = self.front.normalised(self.front.objectives(point.y, level))
        places = np.array([other.at for other in self.found]).reshape(-1, len(at))
        for k in np.flatnonzero(np.max(np.abs(places - at), axis=1) < _SAME_OBJECTIVES):
            if np.max(np.abs(self.found[k].point.y - point.y)) < _SAME_DESIGN:
                return self.found[k]
        self.found.append(Sample(point, p, at, level, self.front.level_for(point.y)))
        return self.found[-1]

    def to_the_last_digits(self, samples: Sequence[Sample]) -> None:
        """Solve samples with exact slopes."""
        samples = [one for one in samples if one.confirmed and self.front.by_differences(one.level)]
        for number, sample in enumerate(samples):
            self.progress("solving to the last digits", number / len(samples))
            chosen = self.front.level_for(sample.point.y, exact=True)
            level = self.front.levels[chosen]
            # Along a flat valley, where differences have an end that is none, corrections lead nowhere.
            for way in (level.correct, level.follow):
                again = way(sample.point, sample.point.y, sample.p)
                at = self.front.normalised(self.front.objectives(again.y, chosen))
                if again.solved and np.max(np.abs(at - sample.at)) < _BESIDE and np.all(at <= sample.at + MATTERS):
                    sample.point, sample.level, sample.at = again, chosen, at
                    break

    def solve_again(self) -> None:
        """Solve samples anew, from where they are, with all steps: the program has become finer."""
        for sample in self.found:
            if self.front.by_differences(sample.level):
                continue
            again = self.front.solve(sample.point, sample.point.y, sample.p)
            if again.solved:
                sample.point, sample.level = again, 0
                sample.at = self.front.normalised(self.front.objectives(again.y))

    def fail(self, near: Sample, point: Point) -> None:
        """Keep that the optimiser failed beside a sample, and why."""
        reason = REMEDIES.get(point.status, "the optimiser stopped without an optimum")
        failure = Failure(tuple(near.at.tolist()), f"{point.status}: {reason}")
        if failure not in self.failures:
            self.failures.append(failure)

    # --- searching ---------------------------------------------------------------------------------------

    def sound(self) -> list[Sample]:
        """Return the samples that are not needles, which beat no design that can be made; all where all are."""
        fresh = [sample for sample in self.found if sample.needle is None]
        if fresh:
            scaled = self.front.scaled(np.array([sample.at for sample in fresh]))
            needles = self.cloud.needles(np.array([sample.point.y for sample in fresh]), scaled)
            for sample, needle in zip(fresh, needles, strict=True):
                sample.needle = bool(needle)
        return [sample for sample in self.found if not sample.needle] or self.found

    def is_efficient(self, sample: Sample) -> bool:
        """Return whether no objective would rather be worse: a local optimum may be held back by its position."""
        return not sample.confirmed or bool(np.all(self.front.slopes(sample.point, sample.p) > 0.0))

    @abstractmethod
    def order(self, samples: Sequence[Sample]) -> Order:
        """Return how samples make up a front."""

    def chosen(self) -> list[Sample]:
        """Return the samples that make up the front so far."""
        sound = self.sound()
        return [sound[k] for k in self.order(sound).kept]

    @abstractmethod
    def ordered(self) -> list[Sample]:
        """Return the samples that no other dominates, of two objectives in order."""
