"""The search over all variables: sampling, evolution on islands, descents, and the basins they reveal."""

import itertools
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np

from plough_opt.core.checks import check_callable
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.search.effort import Effort, TimeLimit, expected_unseen
from plough_opt.design.search.landscape import (
    LEAST_GAIN,
    MANY_VARIABLES,
    SEED,
    Basins,
    Evaluations,
    Landscape,
    apart,
    barriers,
    concatenated,
    dips_along,
    end_straight_downhill,
    evolved,
    lines_through,
    local_minima,
    sample,
    with_variables,
)
from plough_opt.design.search.local import Shortfall, descend, least_violation

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction of it done."""


class _Round:
    """Bounds of the parts of a round that the effort does not set."""

    block: Final = 2048  # designs between two looks at the clock if they are integrated side by side
    one_by_one: Final = 32  # the same if they are integrated one by one, which can take half a minute
    infeasible_starts: Final = 4  # of descents where feasible designs are rare
    converged: Final = 1e-7  # An island has converged when its merits scatter by less than this fraction.
    most_followed: Final = 256  # points of the uniform part of a sample, to basins that may be known already
    few_unseen: Final = 0.1  # With fewer expected unseen basins, the evolution, which might find one, is skipped.


class _CloserLook:
    """Extent of the search in boxes around the best designs. Lengths are fractions of the range."""

    rounds: Final = 4
    violation_rounds: Final = 16  # as long as it falls; the last per mille may take many
    centres: Final = 2  # designs that get a box
    sample: Final = 256
    radii: Final = (0.06,)  # half width of a box
    radii_if_rare: Final = (0.06, 0.015, 0.004)  # The region of rare feasible designs may have any size.
    descents: Final = 4  # from each box
    another_dip: Final = 0.01  # A dip farther than this part of a line from the design on it counts as another one.
    ends: Final = 64  # lowest ends of descents whose differences are steps to other ripples
    translations: Final = 3  # rounds of such steps: a better ripple may lie several away
    moves: Final = 12  # descents from designs after such a step
    digits: Final = 4  # of such steps: ends of the same descent differ in later digits


def silent(_stage: str, _fraction: float) -> None:
    """Report no progress."""


def notifier(progress: Progress | None) -> Progress:
    """Check a callback of progress and return it, or `silent` for None."""
    if progress is None:
        return silent
    check_callable("progress", progress, "of what is being done and the fraction done")
    return progress


class _OutOfTime(Exception):
    """No further descent may begin."""


@dataclass(frozen=True)
class Explored:
    """The result of a search.

    Attributes:
        sample: the designs of the samples.
        minima: the lowest design of each basin, best first by the search's criterion.
        followed: number of uniform sample points that were followed to their basins.
        reached: number of different basins in which these ended.
        least_violating: for each round without a feasible design, those with the least violation, least first.
    """

    sample: Evaluations
    minima: Evaluations
    followed: int
    reached: int
    least_violating: Evaluations


@dataclass
class Explorer:
    """Rounds of a search for basins.

    Attributes:
        landscape: the landscape that is searched.
        start: the scaled guess. Variables that are not searched stay there until the descents.
        variables: numbers of the variables that are searched.
        effort: how thoroughly to search.
        progress: called with what is being done and the fraction of it done.
        seed: of the samples.
        stop: returns True to end the search after its first descents.
        limit: of the processor time.
        shortfall: of the landscape, to search for the least violation instead of the best design.
    """

    landscape: Landscape
    start: Vector
    variables: Sequence[int]
    effort: Effort
    progress: Progress = silent
    seed: int = 0
    stop: Callable[[], bool] = lambda: False
    limit: TimeLimit = field(default_factory=partial(TimeLimit, "near"))
    shortfall: Shortfall | None = None
    # Whether feasible designs are so rare that any of them ranks before all others.
    _feasible_rare: bool = field(init=False, default=False)
    # Descents start only from designs with at most this violation.
    _most_violation: float = field(init=False, default=np.inf)
    _least_violating: Evaluations = field(init=False)
    _dense: bool = field(init=False, default=False)
    _samples: list[Evaluations] = field(init=False, default_factory=list)
    # Ends of descents, the criterion at each, and for pairs of them whether a barrier separates them.
    _ends: Evaluations = field(init=False)
    _ranks: list[float] = field(init=False, default_factory=list)
    _separated: dict[tuple[int, int], bool] = field(init=False, default_factory=dict)
    # For each followed point the number of the end it led to.
    _followed: list[int] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.variables = list(self.variables)
        self._ends = self._least_violating = Evaluations.none(self.landscape.dimensions)
        self._evaluate: Callable[[Vector], Evaluations] = self.shortfall or self.landscape

    def explore(self) -> Explored:
        """Return the result of as many rounds as the effort demands."""
        began, rounds = time.perf_counter(), 0
        while rounds == 0 or self.effort.more(rounds, self.landscape.designs_tried, began):
            self._round(rounds)
            rounds += 1
        self.progress("distinguishing basins", 0.0)
        minima, basin = self._basins()
        return Explored(concatenated(self._samples), minima, *self._follow_counts(basin), self._least_violating)

    def _round(self, number: int) -> None:
        rng = np.random.default_rng([SEED, self.seed, number])
        self.progress(f"trying {self.effort.designs} designs", 0.0)
        points, uniform = sample(len(self.variables), self.effort.designs, self.start[self.variables], rng)
        sampled = self._sampled(points)
        points, uniform = points[: len(sampled.f)], uniform[uniform < len(sampled.f)]
        self._samples.append(sampled)
        if not np.any(np.isfinite(sampled.merit)):
            return
        rare = np.count_nonzero(sampled.feasible) < self.effort.rare
        if rare and self.landscape.vectorised:
            feasible = self._rare_feasible_designs(points, sampled, rng)
            if feasible is None:
                return
            points = np.vstack([points, feasible.points[:, self.variables]])
            sampled = concatenated([sampled, feasible])
        with suppress(_OutOfTime):
            self._search(points, sampled, rng, uniform, [] if number else [self.start])

    def _sampled(self, points: Vector) -> Evaluations:
        """Return the designs of a sample, as many as there is time for."""
        block = _Round.block if self.landscape.vectorised else _Round.one_by_one
        parts = []
        for begin in range(0, len(points), block):
            if begin and self.limit.passed(f"part of the sample of {len(points)} designs"):
                break
            parts.append(self.landscape(self._full_designs(points[begin : begin + block])))
        return concatenated(parts)

    def _rare_feasible_designs(
        self, points: Vector, sampled: Evaluations, rng: np.random.Generator
    ) -> Evaluations | None:
        """Return feasible designs from a search for the least violation, or None if it finds none."""
        shortfall = Shortfall(self.landscape)
        search = replace(
            self,
            effort=replace(self.effort, dense=False),  # Every descent may come across feasible designs.
            stop=lambda: shortfall.feasible_seen >= self.effort.population,
            shortfall=shortfall,
        )
        with suppress(_OutOfTime):
            search._search(points, sampled.without_objective(), rng, further=[self.start])
        self._feasible_rare, self._most_violation = True, float(sampled.violation.min())
        feasible = shortfall.feasible_designs()
        if feasible is None:
            self._least_violating = concatenated([self._least_violating, search._basins()[0]])
        return feasible

    def _search(
        self,
        points: Vector,
        sampled: Evaluations,
        rng: np.random.Generator,
        uniform: Sequence[int] | np.ndarray = (),
        further: Sequence[Vector] = (),
    ) -> None:
        """Descend from the lowest sampled designs and from what evolution makes of them, then search around the ends.

        Args:
            points: the searched variables of the sampled designs, a row each.
            sampled: the sampled designs.
            rng: random numbers for the evolution and the boxes around the best designs.
            uniform: numbers of the designs that are followed to their basins, in random order.
            further: further designs to descend from.
        """
        effort = self.effort
        self._dense = effort.dense and not self._feasible_rare
        lowest, downhill = local_minima(points, self._merit(sampled))
        if self._feasible_rare:
            feasible = sampled.feasible[lowest]
            lowest = np.r_[lowest[feasible], lowest[~feasible][: _Round.infeasible_starts]]
        lowest = lowest[: effort.descents]
        starts = [*sampled.points[lowest], *further]
        ends: list[int] = []
        for done, start in enumerate(starts):
            if done and self.limit.passed("descents from low designs"):
                break
            self.progress(f"descending from {len(starts)} low designs", done / len(starts))
            ends.append(self._end_from(start))
        known = dict(zip(lowest.tolist(), ends, strict=False))
        random_starts = [] if self._feasible_rare else [int(downhill[k]) for k in uniform]
        if self._dense:
            # The basins that these reach may make the evolution unnecessary.
            self._follow(sampled, random_starts, known)
        unseen = expected_unseen(*self._follow_counts(self._basins()[1])) if self._dense and self._followed else None
        if unseen is None or unseen > _Round.few_unseen:
            for island in range(effort.islands if len(self.variables) > 1 else 0):
                if self.stop() or self.limit.passed("evolution"):
                    break
                self._end_from(self._evolved(points, sampled, island, rng))
        self._look_closer(rng)
        if not self._dense:
            self._follow(sampled, random_starts, known)

    def _follow_counts(self, basin: list[int | None]) -> tuple[int, int]:
        """Return the number of designs followed and of the basins they reached, given the basin of each end."""
        reached = [basin[k] for k in self._followed if basin[k] is not None]
        return len(reached), len(set(reached))

    def _merit(self, designs: Evaluations) -> Vector:
        """Return the merit by which designs are compared in this search."""
        return designs.strict_merit if self._feasible_rare else designs.merit

    def _worth_descending(self, designs: Evaluations) -> np.ndarray:
        """Return whether a descent from each design is worth its time."""
        promising = (designs.violation <= self._most_violation) & np.isfinite(designs.f)
        # A dense sample has led to the ends that infeasible designs lead to.
        return np.asarray(promising & designs.feasible if self._dense else promising)

    def _descend_from_dips(self, centre: Vector, radius: float = 1.0) -> None:
        """Descend from dips along each variable through a design: a sample may be too sparse to show them.

        A share on a mount under a strength wave may have three optima; nothing else finds the third.
        """
        lines = lines_through(centre, self.variables, radius)
        evaluated = self._evaluate(lines)
        promising, dips = self._worth_descending(evaluated), dips_along(self._merit(evaluated))
        for k in dips:
            if promising[k] and np.max(np.abs(lines[k] - centre)) > _CloserLook.another_dip * min(2.0 * radius, 1.0):
                self.progress("descending from dips along each variable", 0.0)
                self._end_from(lines[k])

    def _look_closer(self, rng: np.random.Generator) -> None:
        """Search lines through the best design, then boxes around it, and again around a better one: ripples hide it.

        Without boxes and translations ripples of five variables over a small feasible region end in a higher one, and
        without lines through the boxes one of 2,024 random cases.
        """
        if not self.landscape.vectorised or self.stop() or not len((minima := self._basins()[0]).f):
            return
        if self.limit.passed("a closer look at the best designs"):
            return
        self._descend_from_dips(minima.points[0])
        if len(self.variables) < 2:
            return
        for _ in range(_CloserLook.violation_rounds if self.shortfall else _CloserLook.rounds):
            if self.stop() or self.limit.passed("a closer look at the best designs"):
                return
            centres, before = self._basins()[0].points[: _CloserLook.centres], len(self._ends.f)
            radii = _CloserLook.radii_if_rare if self.shortfall or self._feasible_rare else _CloserLook.radii
            boxes = list(itertools.product(centres, radii))
            for number, (centre, radius) in enumerate(boxes):
                self.progress("looking closer at the best designs", number / len(boxes))
                self._descend_inside(centre, radius, rng)
                self._descend_from_dips(centre, radius)
            for _ in range(_CloserLook.translations):
                self._descend_from_translations()
            merit = self._merit(self._ends)
            lowest = np.min(merit[:before])
            if not np.min(merit[before:], initial=np.inf) < lowest - LEAST_GAIN * abs(lowest):
                return

    def _descend_inside(self, centre: Vector, radius: float, rng: np.random.Generator) -> None:
        """Descend from the lowest sampled designs of a box around a design."""
        points, _ = sample(len(self.variables), _CloserLook.sample, np.full(len(self.variables), 0.5), rng)
        inside = np.clip(centre[self.variables] + radius * (2.0 * points - 1.0), 0.0, 1.0)
        designs = with_variables(centre, self.variables, inside)
        evaluated = self._evaluate(designs)
        promising = self._worth_descending(evaluated)
        for k in local_minima(points, self._merit(evaluated))[0][: _CloserLook.descents]:
            if promising[k]:
                self._end_from(designs[k])

    def _descend_from_translations(self) -> None:
        """Descend from the best end moved by differences of ends: ripples repeat, and several variables change at once.

        A box holds hardly any sample in the ripple next to the best one if that differs in several variables.
        """
        merit = self._merit(self._ends)
        order = apart(self._ends.points, np.argsort(merit, kind="stable"), Basins.same, _CloserLook.ends)
        lowest, highest = self._ends.points[order], merit[order[-1]]
        moved = np.clip(lowest[0] + (lowest[:, None] - lowest).reshape(-1, lowest.shape[1]), 0.0, 1.0)
        moved = moved[np.unique(moved.round(_CloserLook.digits), axis=0, return_index=True)[1]]
        near = np.max(np.abs(moved[:, None] - lowest), axis=2).min(axis=1) < Basins.same
        tried = self._evaluate(moved[~near])
        promising, merit = self._worth_descending(tried), self._merit(tried)
        for k in np.argsort(merit, kind="stable")[: _CloserLook.moves]:
            if promising[k] and merit[k] <= highest:
                self._end_from(tried.points[k])

    def _follow(self, sampled: Evaluations, starts: list[int], known: dict[int, int]) -> None:
        """Record the end to which each random start leads.

        Args:
            sampled: the sampled designs.
            starts: for each uniform point, in random order, the number of the local minimum below it in the sample.
            known: ends of descents by the number of their start; new ones are added.
        """
        left, doing = self.effort.followed, "following designs drawn at random"
        for number, start in enumerate(starts[: _Round.most_followed]):
            if start not in known:
                if left == 0 or not np.isfinite(sampled.merit[start]) or self.limit.passed(doing):
                    return
                left -= 1
                self.progress(doing, number / min(len(starts), _Round.most_followed))
                known[start] = self._end_from(sampled.points[start])
            self._followed.append(known[start])

    def _end_from(self, start: Vector) -> int:
        """Return the number of the end of a descent; with a dense sample a known end if the way to it only falls."""
        if len(self._ends.f) and self.limit.passed("further descents"):
            raise _OutOfTime
        landscape = self.landscape
        if len(self._ends.f) and self._dense and landscape.vectorised:
            known = end_straight_downhill(landscape, start, self._ends)
            if known is not None:
                return known
        self._ends = concatenated([self._ends, self._descended(start)])
        return len(self._ends.f) - 1

    def _descended(self, start: Vector) -> Evaluations:
        """Return the end of a descent. If runs are integrated one by one it is the start: the optimiser descends."""
        landscape = self.landscape
        if self.shortfall:
            return self.shortfall.descend(start)
        if landscape.vectorised and self._feasible_rare and not landscape(start[None]).feasible[0]:
            # A descent of the merit would pass by the few feasible designs.
            feasible = least_violation(landscape, start)
            if not feasible.feasible[0]:
                return feasible
            start = feasible.points[0]
        return descend(landscape, start)

    def _full_designs(self, points: Vector) -> Vector:
        """Return designs with the searched variables at these points and the others at the start."""
        return with_variables(self.start, self.variables, points)

    def _evolved(self, points: Vector, sampled: Evaluations, island: int, rng: np.random.Generator) -> Vector:
        """Return the best design of an evolution that starts from a part of the sample."""
        effort = self.effort
        self.progress(f"evolution, island {island + 1} of {effort.islands}", island / effort.islands)
        order = np.argsort(self._merit(sampled), kind="stable")
        best = evolved(
            lambda x: self._merit(self._evaluate(self._full_designs(x))),
            # Each island takes its own part of the best designs.
            points[order[island :: effort.islands][: effort.population]],
            effort.generations,
            rng,
            # Every second island mutates random designs instead of the best one.
            from_best=island % 2 == 0 and points.shape[1] < MANY_VARIABLES,
            alike=_Round.converged,
            stop=lambda: self.limit.passed("further generations of the evolution"),
        )
        return np.asarray(self._full_designs(best[None])[0])

    def _basins(self) -> tuple[Evaluations, list[int | None]]:
        """Return the lowest design of each basin, best first, and the basin of each end; None for an end left out.

        If any end is feasible, infeasible ones are left out.
        """
        ends = self._ends
        basin: list[int | None] = [None] * len(ends.f)
        valid = np.flatnonzero(ends.feasible if np.any(ends.feasible) else np.isfinite(ends.merit))
        if len(ends.f) > len(self._ranks):
            self._ranks += ends.merit[len(self._ranks) :].tolist()
        ranks, merit = np.array(self._ranks), ends.merit
        minima: list[int] = []
        lowest: list[int] = []
        for k in valid[np.argsort(ranks[valid], kind="stable")].tolist():
            same = self._basin_of(ends, k, minima)
            basin[k] = len(minima) if same is None else same
            if same is None:
                minima.append(k)
                lowest.append(k)
            elif merit[k] < merit[lowest[same]] and ranks[k] <= ranks[minima[same]] + Basins.needle * abs(ranks[k]):
                # The medians of a basin's ripples differ by chance, but for a needle's.
                lowest[same] = k
        return ends.select(lowest), basin

    def _basin_of(self, ends: Evaluations, k: int, minima: list[int]) -> int | None:
        """Return the number of the first minimum that no barrier separates from end k, or None."""
        if not minima:
            return None
        near = np.flatnonzero(np.max(np.abs(ends.points[minima] - ends.points[k]), axis=1) < Basins.same)
        if len(near):
            return int(near[0])
        if not self.landscape.vectorised:
            return None
        if new := [j for j in minima if (k, j) not in self._separated]:
            separated = barriers(self._evaluate, ends.select([k]), ends.select(new)).tolist()
            for j, barrier in zip(new, separated, strict=True):
                self._separated[k, j] = self._separated[j, k] = barrier
        return next((number for number, j in enumerate(minima) if not self._separated[k, j]), None)
