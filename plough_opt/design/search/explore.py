"""The search over all variables: a sample, descents from its lowest designs, and looks around their ends."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_callable
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.search.descent import descend
from plough_opt.design.search.effort import Effort, TimeLimit
from plough_opt.design.search.landscape import (
    SAME,
    SEED,
    Evaluations,
    Landscape,
    concatenated,
    even_points,
    only_falls,
    with_variables,
)

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction of it done."""


def silent(_stage: str, _fraction: float) -> None:
    """Report no progress."""


def notifier(progress: Progress | None) -> Progress:
    """Check a callback of progress and return it, or `silent` for None."""
    if progress is None:
        return silent
    check_callable("progress", progress, "of what is being done and the fraction done")
    return progress


# Half of a sample is stretched by this on either side and clipped, so that it includes bounds and corners.
_STRETCH: Final = 0.15
# Designs along each variable through the two best ends.
_POSITIONS: Final = 128
# With up to so many variables a sample is dense: there is no descent from a design from which the objective falls
# all the way to a known end, up to a fraction that is rounding and the accuracy of the end.
_DENSE: Final = 3


@dataclass(frozen=True)
class Explored:
    """The result of a search.

    Attributes:
        sample: the designs of the samples.
        ends: the different ends of descents, best first.
        followed: number of uniform sample points that were followed downhill to an end.
        reached: number of different ends to which these lead.
    """

    sample: Evaluations
    ends: Evaluations
    followed: int = 0
    reached: int = 0


def explore(
    landscape: Landscape,
    start: Vector,
    variables: Sequence[int],
    effort: Effort,
    *,
    seed: int = 0,
    known: Vector | None = None,
    held: Sequence[int] = (),
    progress: Progress = silent,
    limit: TimeLimit | None = None,
) -> Explored:
    """Return the result of as many rounds as the effort demands.

    Args:
        landscape: the landscape that is searched.
        start: the scaled guess. Variables that are not searched stay there until the descents.
        variables: numbers of the variables that are searched.
        effort: how thoroughly to search.
        seed: of the samples.
        known: further designs to descend from, a row each.
        held: numbers of variables that also descents hold at the start.
        progress: called with what is being done and the fraction of it done.
        limit: of the processor time.
    """
    search = _Search(landscape, start, list(variables), held, progress, limit or TimeLimit("near"))
    began, rounds = time.perf_counter(), 0
    while rounds == 0 or effort.more(rounds, landscape.designs_tried, began):
        rng = np.random.default_rng([SEED, seed, rounds])
        search.sample_and_descend(effort, rng, () if rounds or known is None else known)
        search.look_around_ends(effort.looks, rng)
        rounds += 1
    return search.explored()


class _Search:
    """The designs that a search tried so far, and the next ones to try."""

    def __init__(
        self,
        landscape: Landscape,
        start: Vector,
        variables: list[int],
        held: Sequence[int],
        progress: Progress,
        limit: TimeLimit,
    ) -> None:
        self._landscape, self._start, self._variables = landscape, start, variables
        self._progress, self._limit = progress, limit
        self._low, self._high = np.zeros(len(start)), np.ones(len(start))
        self._low[list(held)] = self._high[list(held)] = start[list(held)]
        self._samples: list[Evaluations] = []
        self._ends: list[Evaluations] = []
        # Designs that uniform points of the sample lead to, as the numbers of the ends of descents from there.
        self._followed: list[int] = []

    def sample_and_descend(self, effort: Effort, rng: np.random.Generator, known: Sequence[Vector] | Vector) -> None:
        """Sample the searched variables, and descend from the lowest local minima and from designs that are known."""
        count = effort.designs
        self._progress(f"trying {count} designs", 0.0)
        n = len(self._variables)
        points = np.linspace(0.0, 1.0, count)[:, None] if n == 1 else even_points(n, count, rng)
        if n > 1:
            points[1::2] = np.clip((1.0 + 2.0 * _STRETCH) * points[1::2] - _STRETCH, 0.0, 1.0)
        designs = np.vstack([with_variables(self._start, self._variables, points), self._start, *known])
        sampled = self._evaluated(designs)
        self._samples.append(sampled)
        key = sampled.key
        lowest, downhill = local_minima(sampled.points[:, self._variables], key)
        lowest = lowest[np.isfinite(key[lowest])]
        first = len(self._ends)
        guesses = [k for k in range(count, len(key)) if np.isfinite(key[k]) and not first]
        # Uniform designs show how many basins there are: they are followed in their order.
        uniform = [k for k in downhill[: min(count, len(key)) : 1 if n == 1 else 2].tolist() if np.isfinite(key[k])]
        followed = list(dict.fromkeys(uniform))[: effort.followed]
        chosen = list(dict.fromkeys([*lowest[: effort.descents].tolist(), *guesses, *followed]))
        end_of = dict(zip(chosen, self._descend(sampled.points[chosen], "descents from low designs"), strict=False))
        self._followed += [end_of[k] for k in itertools.takewhile(end_of.__contains__, uniform)]

    def look_around_ends(self, looks: int, rng: np.random.Generator) -> None:
        """Search around the best ends, and again around a better one: ripples hide it.

        Differences of ends lead from one ripple to another; a box and lines along each variable show what a sample of
        all variables is too sparse to show.
        """
        vain = 0
        for number in range(looks if self._landscape.vectorised and self._ends else 0):
            if self._limit.passed("a closer look at the best designs"):
                return
            self._progress("looking closer at the best designs", number / looks)
            best = concatenated(self._ends).distinct(SAME, 24)
            if not len(best.f):
                return
            tried = self._landscape(np.clip(self._around(best.points, rng), self._low, self._high))
            lowest, _ = local_minima(tried.points[:, self._variables], tried.key)
            lowest = lowest[np.isfinite(tried.key[lowest])]
            new = np.max(np.abs(best.points - tried.points[lowest, None]), axis=2).min(axis=1) > SAME
            new |= tried.key[lowest] < best.key[0]
            self._descend(tried.points[lowest[new][:8]], "further descents")
            size = abs(best.f[0]) if best.feasible[0] else best.violation[0]
            # A smaller part of the objective does not justify another look.
            vain = 0 if min(end.key[0] for end in self._ends) < best.key[0] - 1e-6 * size else vain + 1
            if vain == 2:
                return

    def _around(self, ends: Vector, rng: np.random.Generator) -> Vector:
        """Return designs around ends, which are given best first."""
        some, count, n = self._variables, 512, len(self._variables)
        lines = np.tile(ends[:2, None, None], (n, _POSITIONS, 1))
        lines[:, range(n), :, some] = np.linspace(0.0, 1.0, _POSITIONS)
        if n == 1:
            return lines.reshape(-1, ends.shape[1])
        a = ends[rng.integers(max(1, len(ends) // 4), size=count)]
        b, c = ends[rng.integers(len(ends), size=(2, count))]
        moved = a + rng.uniform(0.4, 1.0, (count, 1)) * (b - c) + 0.01 * rng.standard_normal(a.shape)
        whole = ends[0] + (ends[:, None] - ends).reshape(-1, ends.shape[1])
        whole = whole[rng.permutation(len(whole))[:count]]
        box = ends[rng.integers(min(2, len(ends)), size=count)]
        # Boxes around the two best ends, the largest of them and others smaller by up to two decades.
        radii = 0.05 * 10.0 ** rng.uniform(-2.0, 0.0, (count, 1))
        box[:, some] += radii * rng.uniform(-1.0, 1.0, (count, n))
        return np.vstack([lines.reshape(-1, ends.shape[1]), moved, whole, box])

    def _evaluated(self, designs: Vector) -> Evaluations:
        """Return the evaluated designs, as many as there is time for."""
        # Between two looks at the clock; integrated one by one, designs can take half a minute.
        block = 2048 if self._landscape.vectorised else 32
        parts = [self._landscape(designs[:block])]
        for begin in range(block, len(designs), block):
            if self._limit.passed(f"part of the sample of {len(designs)} designs"):
                break
            parts.append(self._landscape(designs[begin : begin + block]))
        return concatenated(parts)

    def _descend(self, starts: Vector, doing: str) -> list[int]:
        """Add the ends of descents from starts, and return the number of the end of each."""
        numbers = np.full(len(starts), -1)
        if len(self._variables) <= _DENSE and self._landscape.vectorised:
            for number, end in enumerate(self._ends):
                self._mark_falling(starts, numbers, number, end.points[0])
        for done, start in enumerate(starts):
            if numbers[done] >= 0:
                continue
            if self._ends and self._limit.passed(doing):
                return list(map(int, numbers[:done]))
            self._progress(doing, done / len(starts))
            numbers[done] = len(self._ends)
            self._ends.append(descend(self._landscape, start, (self._low, self._high)))
            if len(self._variables) <= _DENSE and self._landscape.vectorised:
                self._mark_falling(starts, numbers, len(self._ends) - 1, self._ends[-1].points[0])
        return list(map(int, numbers))

    def _mark_falling(self, starts: Vector, numbers: NDArray[np.intp], number: int, end: Vector) -> None:
        """Note an end for those of the starts left from which the objective only falls all the way to it."""
        left = np.flatnonzero(numbers < 0)
        if len(left):
            numbers[left[only_falls(self._landscape, starts[left], end, 1e-6)]] = number

    def explored(self) -> Explored:
        """Return the result."""
        sample = concatenated(self._samples)
        if not self._ends:
            return Explored(sample, sample.select(slice(0)))
        every = concatenated(self._ends)
        ends = every.distinct(SAME)
        near = np.max(np.abs(every.points[self._followed, None] - ends.points), axis=2) < SAME
        reached = np.flatnonzero(np.any(near, axis=0))
        return Explored(sample, ends, int(np.sum(np.any(near, axis=1))), len(reached))


def local_minima(points: Vector, key: Vector) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the numbers of the points that are lower than their neighbours, lowest first, and where each point leads.

    Args:
        points: a row for each point.
        key: of each point.

    Returns:
        The local minima; and for each point the local minimum that repeated steps to the lowest neighbour reach.
    """
    from scipy.spatial import KDTree  # slow to import

    n = points.shape[1]
    # A local minimum of a sample is lower than so many neighbours.
    count = min(4 * n if n > 1 else 2, len(points) - 1)
    _, around = KDTree(points).query(points, k=count + 1)
    around = np.hstack([np.arange(len(points))[:, None], around.reshape(len(points), -1)])
    ends = around[np.arange(len(points)), np.argmin(key[around], axis=1)]
    # Following the pointers twice doubles the number of steps, until every point has arrived.
    while not np.array_equal(following := ends[ends], ends):
        ends = following
    lowest = np.unique(ends)
    return lowest[np.argsort(key[lowest], kind="stable")], ends
