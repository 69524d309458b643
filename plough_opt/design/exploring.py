"""A search over all variables: a sample, evolution on islands, descents, and the basins that they show."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from plough_opt.design.descents import Shortfall, descend, least_violation
from plough_opt.design.effort import Effort
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import SAME, Landscape, Seen, barriers, joined, straight_below
from plough_opt.design.sampling import MANY, SEED, evolved, lines_through, lowest_around, sample

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done of it."""

# Positions along each variable through the best design, dips for each variable that are followed, and how far from that
# design a dip is another.
_ALONG, _DIPS, _BESIDE = 128, 4, 0.01
# Times that is looked closer, around how many designs, how far from them, at how many, and the gain that is one.
_CLOSER, _CLOSELY, _NEAR, _AROUND, _BETTER = 4, 2, 0.06, 256, 1e-6
# A variable nearer than this to a bound lies at it; and designs, islands and descents of a search among the others.
_AT_A_BOUND, _ON_A_FACE, _FACE_ISLANDS, _FACE_DESCENTS = 1e-6, 1024, 2, 4
# Designs that break a requirement, where few meet all, from which feasible ones are looked for.
_FEW = 4
# How far is looked around a design where few meet the requirements, in regions of any size.
_NARROWER = (0.06, 0.015, 0.004)
# An island on which all designs are this alike has converged.
_CONVERGED = 1e-7
# Points of the uniform part of a sample that are followed at most, once their basins are known.
_MOST_FOLLOWED = 256
# Basins that are expected unseen, of which evolution could find one, where it is done without.
_EXPECTED = 0.1


def silent(_stage: str, _fraction: float) -> None:
    """Report no progress."""


@dataclass(frozen=True)
class Explored:
    """The result of a search.

    Attributes:
        sample: the designs of the samples.
        bottoms: of each basin found, the lowest design, by a judgement of their own the best first.
        followed: uniform points of the sample that were followed to their basins.
        reached: basins that they came to.
        least: where no design of the sample meets the requirements nor any that was found from it, those that were
            found with the least violation, the least first.
    """

    sample: Seen
    bottoms: Seen
    followed: int
    reached: int
    least: Seen | None = None


@dataclass
class Explorer:
    """Rounds of looking for basins.

    Attributes:
        landscape: what is searched.
        start: the guess, scaled; variables that are not searched stay there until the descents.
        vary: numbers of the variables that are searched.
        judge: scaled designs, a row each -> by what they are compared, in units of the merit.
        effort: how thoroughly to look.
        progress: called with what is being done.
        seed: of the samples.
        enough: whether to end at once.
    """

    landscape: Landscape | Shortfall
    start: Vector
    vary: Sequence[int]
    judge: Callable[[Vector], Vector]
    effort: Effort
    progress: Progress = silent
    seed: int = 0
    enough: Callable[[], bool] = lambda: False
    # Whether so few designs meet the requirements that any of them is better than any other design.
    _narrow: bool = False
    # Then only designs that break the requirements by no more are descended from.
    _least_of_sample: float = np.inf
    _least: Seen | None = None
    _dense: bool = False
    _samples: list[Seen] = field(default_factory=list)
    # Ends of descents, by what they are compared, and of pairs of them whether a barrier lies between.
    _found: list[Seen] = field(default_factory=list)
    _judged: list[float] = field(default_factory=list)
    _parted: dict[tuple[int, int], bool] = field(default_factory=dict)
    # Of every followed point, the number of the descent that it led to.
    _followed: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.vary = list(self.vary)

    def explored(self) -> Explored:
        """Return what rounds of the effort see."""
        began, rounds = time.perf_counter(), 0
        while rounds == 0 or self.effort.more(rounds, self.landscape.tried, began):
            self._round(rounds)
            rounds += 1
        self.progress("telling basins apart", 0.0)
        bottoms, basin = self._basins()
        return Explored(joined(self._samples), bottoms, *self._reached(basin), self._least)

    def _round(self, number: int) -> None:
        rng = np.random.default_rng([SEED, self.seed, number])
        self.progress(f"trying {self.effort.designs} designs", 0.0)
        points, uniform = sample(len(self.vary), self.effort.designs, self.start[self.vary], rng)
        seen = self.landscape(self._whole(points))
        self._samples.append(seen)
        if not np.any(np.isfinite(seen.merit)):
            return
        few = np.count_nonzero(seen.feasible) < self.effort.population
        if few and isinstance(self.landscape, Landscape) and self.landscape.vectorised:
            met = self._met(self.landscape, points, seen, rng)
            if met is None:
                return
            points, seen = np.vstack([points, met.points[:, self.vary]]), joined([seen, met])
        self._descend(points, seen, rng, uniform, [] if number else [self.start])

    def _met(self, landscape: Landscape, points: Vector, seen: Seen, rng: np.random.Generator) -> Seen | None:
        """Return designs that meet the requirements, which hardly any design of a sample does; None without one."""
        shortfall = Shortfall(landscape)
        search = replace(
            self._another(self.start, self.vary, replace(self.effort, followed=0)),
            landscape=shortfall,
            judge=lambda y: shortfall(y).merit,
            enough=lambda: shortfall.met >= self.effort.population,
        )
        search._descend(points, seen.without_objective(), rng, further=[self.start])
        self._narrow, self._least_of_sample = True, float(seen.violation.min())
        met = shortfall.designs()
        if met is None and not np.any(seen.feasible):
            least = search._basins()[0]
            self._least = least if self._least is None else joined([self._least, least])
        return met

    def _another(self, start: Vector, vary: Sequence[int], effort: Effort) -> "Explorer":
        """Return a search of other variables, or of another effort, that has seen nothing yet."""
        return Explorer(self.landscape, start, vary, self.judge, effort, self.progress, self.seed, self.enough)

    def _descend(
        self,
        points: Vector,
        seen: Seen,
        rng: np.random.Generator,
        uniform: Sequence[int] | np.ndarray = (),
        further: Sequence[Vector] = (),
    ) -> None:
        """Descend from the lowest of designs, and from what evolution makes of them, and look around the ends.

        Args:
            points: the variables that are searched, a row for each design.
            seen: the designs.
            rng: of the evolution.
            uniform: numbers of the designs that are followed to their basins, in an order of chance.
            further: designs that are descended from, too.
        """
        effort = self.effort
        self._dense = effort.dense and not self._narrow
        lowest, downhill = lowest_around(points, self._merit(seen))
        if self._narrow:
            lowest = np.r_[lowest[seen.feasible[lowest]], lowest[~seen.feasible[lowest]][:_FEW]]
        lowest = lowest[: effort.descents]
        starts = [*seen.points[lowest], *further]
        ends: list[int] = []
        for done, start in enumerate(starts):
            if self.enough():
                return
            self.progress(f"descending from {len(starts)} low designs", done / len(starts))
            ends.append(self._end_of(start))
        known = dict(zip(lowest.tolist(), ends, strict=False))
        chance = [] if self._narrow else [int(downhill[k]) for k in uniform]
        if self._dense:
            # What was followed may settle which basins there are.
            self._follow(seen, chance, known)
        if not (self._dense and self._settled()):
            for island in range(effort.islands if len(self.vary) > 1 else 0):
                if self.enough():
                    return
                self._end_of(self._evolved(points, seen, island, rng))
        self._scan()
        self._look_closer(rng)
        if self._narrow or isinstance(self.landscape, Shortfall):
            self._search_face(rng)
        if not self._dense:
            self._follow(seen, chance, known)

    def _settled(self) -> bool:
        """Return whether designs drawn at random have shown so few basins that hardly any more are expected.

        By the rule of Boender and Rinnooy Kan: see `plough_opt.design.Search`.
        """
        if not self._followed:
            return False
        followed, reached = self._reached(self._basins()[1])
        return followed > reached + 2 and reached * (reached + 1) / (followed - reached - 2) <= _EXPECTED

    def _reached(self, basin: list[int | None]) -> tuple[int, int]:
        """Return how many designs drawn at random were followed, and to how many basins, of those of all descents."""
        reached = [basin[k] for k in self._followed if basin[k] is not None]
        return len(reached), len(set(reached))

    def _merit(self, seen: Seen) -> Vector:
        """Return by what designs are compared."""
        return seen.strict_merit if self._narrow else seen.merit

    def _promises(self, seen: Seen) -> np.ndarray:
        """Return whether it is worth while to descend from each design."""
        promising: np.ndarray = (seen.violation <= self._least_of_sample) & np.isfinite(seen.f)
        # What a dense sample has of designs beyond the requirements has been descended from.
        return promising & seen.feasible if self._dense else promising

    def _search_face(self, rng: np.random.Generator) -> None:
        """Search again among the variables that the best design does not have at a bound, the others held."""
        bottoms, _ = self._basins()
        if not len(bottoms.f) or self.enough():
            return
        best = bottoms.points[0]
        free = [k for k in self.vary if _AT_A_BOUND < best[k] < 1.0 - _AT_A_BOUND]
        if not 2 <= len(free) < len(self.vary):
            return
        self.progress("searching among the variables that are at no bound", 0.0)
        designs, islands = min(self.effort.designs, _ON_A_FACE), min(self.effort.islands, _FACE_ISLANDS)
        effort = replace(self.effort, designs=designs, islands=islands, descents=_FACE_DESCENTS, followed=0)
        face = self._another(best, free, effort)
        face._narrow, face._least_of_sample = self._narrow, self._least_of_sample
        points, _ = sample(len(free), designs, best[free], rng)
        face._descend(points, self.landscape(face._whole(points)), rng)
        self._found += face._found

    def _scan(self) -> None:
        """Descend from the dips along each variable through the best design, for which a sample may be too thin."""
        if not self.landscape.vectorised or self.enough():
            return
        bottoms, _ = self._basins()
        if not len(bottoms.f):
            return
        lines = lines_through(bottoms.points[0], _ALONG, self.vary)
        seen = self.landscape(lines)
        promising, merit = self._promises(seen), self._merit(seen)
        wall = np.pad(merit.reshape(-1, _ALONG), ((0, 0), (1, 1)), constant_values=np.inf)
        dips = np.flatnonzero(((wall[:, 1:-1] < wall[:, :-2]) & (wall[:, 1:-1] <= wall[:, 2:])).ravel())
        for k in dips[np.argsort(merit[dips], kind="stable")][: _DIPS * len(self.vary)]:
            if promising[k] and np.max(np.abs(lines[k] - bottoms.points[0])) > _BESIDE:
                self.progress("descending from dips along each variable", 0.0)
                self._end_of(lines[k])

    def _look_closer(self, rng: np.random.Generator) -> None:
        """Look around the best designs, and again around a better one: basins with ripples have their own basins."""
        if not self.landscape.vectorised or len(self.vary) < 2:
            return
        for _ in range(_CLOSER):
            if self.enough():
                return
            best, before = self._basins()[0].points[:_CLOSELY], len(self._found)
            looks = list(itertools.product(best, _NARROWER if self._narrow else (_NEAR,)))
            for number, (at, near) in enumerate(looks):
                self.progress("looking closer at the best designs", number / len(looks))
                self._look_around(at, near, rng)
            merits = [float(self._merit(one)[0]) for one in self._found]
            lowest = min(merits[:before], default=np.inf)
            if not min(merits[before:], default=np.inf) < lowest - _BETTER * abs(lowest):
                return

    def _look_around(self, at: Vector, near: float, rng: np.random.Generator) -> None:
        """Descend from the lowest designs of a box around a design."""
        points, _ = sample(len(self.vary), _AROUND, np.full(len(self.vary), 0.5), rng)
        around = np.repeat(at[None], len(points), axis=0)
        around[:, self.vary] = np.clip(at[self.vary] + near * (2.0 * points - 1.0), 0.0, 1.0)
        seen = self.landscape(around)
        promising = self._promises(seen)
        for k in lowest_around(points, self._merit(seen))[0][:_DIPS]:
            if promising[k]:
                self._end_of(around[k])

    def _follow(self, seen: Seen, ends: list[int], known: dict[int, int]) -> None:
        """Follow uniform points, in their order, to where descents from the lowest designs around them lead."""
        left = self.effort.followed
        for number, end in enumerate(ends[:_MOST_FOLLOWED]):
            if end not in known:
                if left == 0 or not np.isfinite(seen.merit[end]):
                    return
                left -= 1
                self.progress("following designs drawn at random", number / min(len(ends), _MOST_FOLLOWED))
                known[end] = self._end_of(seen.points[end])
            self._followed.append(known[end])

    def _end_of(self, start: Vector) -> int:
        """Return the number of the end to which a start leads, in a dense sample of a known one if it falls there."""
        landscape = self.landscape
        if self._found and self._dense and isinstance(landscape, Landscape) and landscape.vectorised:
            below = straight_below(landscape, start, joined(self._found))
            if below is not None:
                return below
        self._found.append(self._descended(start))
        return len(self._found) - 1

    def _descended(self, start: Vector) -> Seen:
        """Return where a descent leads; runs that are integrated one by one are left to the optimiser."""
        landscape = self.landscape
        if isinstance(landscape, Shortfall):
            return landscape.descend(start)
        if landscape.vectorised and self._narrow and not landscape(start[None]).feasible[0]:
            # Downhill lead many ways past the few designs that meet the requirements.
            met = least_violation(landscape, start)
            if not met.feasible[0]:
                return met
            start = met.points[0]
        return descend(landscape, start)

    def _whole(self, points: Vector) -> Vector:
        """Return designs whose searched variables are given, the others at the start."""
        whole = np.repeat(self.start[None], len(points), axis=0)
        whole[:, self.vary] = points
        return whole

    def _evolved(self, points: Vector, seen: Seen, island: int, rng: np.random.Generator) -> Vector:
        """Return the best design of an evolution that begins from a part of the sample."""
        effort = self.effort
        self.progress(f"evolution, island {island + 1} of {effort.islands}", island / effort.islands)
        order = np.argsort(self._merit(seen), kind="stable")
        best = evolved(
            lambda x: self._merit(self.landscape(self._whole(x))),
            points[order[island :: effort.islands][: effort.population]],
            effort.generations,
            rng,
            # Islands begin from disjoint parts of the best; every second one mutates random designs, not the best one.
            from_best=island % 2 == 0 and points.shape[1] < MANY,
            alike=_CONVERGED,
        )
        whole: Vector = self._whole(best[None])[0]
        return whole

    def _basins(self) -> tuple[Seen, list[int | None]]:
        """Return the lowest design of each basin, the best first, and the basin of each descent's end."""
        found = joined(self._found) if self._found else self._samples[0].of(slice(0, 0))
        basin: list[int | None] = [None] * len(found.f)
        sound = np.flatnonzero(found.feasible if np.any(found.feasible) else np.isfinite(found.merit))
        if len(found.f) > len(self._judged):
            self._judged += self.judge(found.points[len(self._judged) :]).tolist()
        judged = np.array(self._judged)[sound]
        bottoms: list[int] = []
        for k in sound[np.argsort(judged, kind="stable")]:
            same = self._without_barrier(found, int(k), bottoms)
            basin[k] = len(bottoms) if same is None else same
            if same is None:
                bottoms.append(int(k))
        return found.of(bottoms), basin

    def _without_barrier(self, found: Seen, k: int, bottoms: list[int]) -> int | None:
        """Return the first basin from whose bottom no barrier parts a design, or None."""
        if not bottoms:
            return None
        near = np.flatnonzero(np.max(np.abs(found.points[bottoms] - found.points[k]), axis=1) < SAME)
        if len(near):
            return int(near[0])
        if not self.landscape.vectorised:
            return None
        if new := [j for j in bottoms if (k, j) not in self._parted]:
            for j, parted in zip(new, barriers(self.landscape, found.of([k]), found.of(new)).tolist(), strict=True):
                self._parted[k, j] = self._parted[j, k] = parted
        return next((number for number, j in enumerate(bottoms) if not self._parted[k, j]), None)
