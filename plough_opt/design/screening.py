"""Which combinations of catalogue values can be best: a look at all of them, and a closer one at the lowest."""

from dataclasses import dataclass

import numpy as np

from plough_opt.design.descents import descend, least_violation
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Evaluations, Landscape, concatenated
from plough_opt.design.sampling import MANY_VARIABLES, SEED, evolved, local_minima, sobol_points

# Designs at which all combinations together are looked at, beside those with the other variables held; and for each
# combination at least and at most.
_LOOKS, _FEWEST, _MOST = 2**16, 2, 128
# Combinations that are looked at more closely, and those from which descents begin.
_CLOSER, _DESCENDED = 256, 30
# Designs around each one's best in a closer look, and how far around, in parts of the range, round by round.
_AROUND, _RADII = 16, (0.25, 0.12, 0.06, 0.03, 0.015)
# Descents of all combinations together, and of each at most.
_DESCENTS, _OF_EACH = 60, 8
# Combinations that evolve, if their merit is so near the best, in parts of it; designs for each free variable, times,
# and how alike all of them are when they have converged.
_EVOLVED, _CAN_WIN, _MEMBERS, _GENERATIONS, _CONVERGED = 8, 0.15, 12, 50, 1e-6
# What a violation weighs where a combination that does not yet meet the requirements shall stay in view.
_LIGHTLY = 1.0


@dataclass(frozen=True)
class Promising:
    """A combination that can be best.

    Attributes:
        number: its row among the combinations.
        start: scaled design from which to optimise it.
        merit: its merit there.
    """

    number: int
    start: Vector
    merit: float


def promising(
    landscape: Landscape, optimum: Vector, fixed: list[int], combinations: Vector, kept: list[int]
) -> list[Promising]:
    """Return the combinations that can be best, the lowest first.

    All are looked at with the other variables held at an optimum and at a sample of these, the lowest of them in
    shrinking boxes around their best design; from that and others of its own, descents begin.

    Args:
        landscape: of the design; vectorised.
        optimum: scaled.
        fixed: numbers of the variables in the catalogue.
        combinations: scaled values of these, a row for each combination.
        kept: rows that are never dropped, such as the optimum's neighbours.
    """
    view = _View(landscape, optimum, fixed, combinations)
    if not view.free:
        seen = landscape(view.designs(np.arange(len(combinations)), np.empty((len(combinations), 0))))
        best = _lowest(seen, _DESCENDED, kept)
        return _ordered([Promising(int(k), seen.points[k], float(seen.merit[k])) for k in best])
    numbers, samples = view.sampled(kept)
    count = max(2, min(_OF_EACH, _DESCENTS // len(numbers)))
    looks = dict(zip(numbers.tolist(), samples, strict=True))
    found = _ordered([view.descended(k, own, count) for k, own in looks.items()])
    if len(view.free) == 1:
        return found
    # Of several variables a sample may miss the best basin of a combination that can win.
    limit = found[0].merit + _CAN_WIN * abs(found[0].merit)
    last = [view.evolved(one, looks[one.number]) for one in found[:_EVOLVED] if one.merit <= limit]
    return _ordered([*last, *found[len(last) :]])


class _View:
    """The combinations and the variables that are free beside them."""

    def __init__(self, landscape: Landscape, optimum: Vector, fixed: list[int], combinations: Vector) -> None:
        self._landscape, self._optimum, self._fixed, self._combinations = landscape, optimum, fixed, combinations
        self.free = [k for k in range(len(optimum)) if k not in fixed]
        self._rng = np.random.default_rng([SEED, len(combinations)])

    def designs(self, numbers: np.ndarray, free: Vector) -> Vector:
        """Return designs of combinations by number, the free variables given, a row each."""
        found = np.empty((len(numbers), len(self._optimum)))
        found[:, self._fixed] = self._combinations[numbers]
        found[:, self.free] = free
        return found

    def sampled(self, kept: list[int]) -> tuple[np.ndarray, list[Evaluations]]:
        """Return the lowest combinations, and the designs of each that were looked at, that of the optimum first."""
        count, n = len(self._combinations), len(self.free)
        numbers = np.arange(count)
        held = self._landscape(self.designs(numbers, np.tile(self._optimum[self.free], (count, 1))))
        each = int(np.clip(_LOOKS // count, _FEWEST, _MOST))
        points = sobol_points(n, count * each, self._rng)
        # Neighbouring points of the sequence fill the space evenly: each combination has its own.
        seen = self._landscape(self.designs(np.repeat(numbers, each), points))
        best = _best_of_each(held, seen, each)
        numbers = _lowest(best, _CLOSER, kept)
        best = best.select(numbers)
        for k, radius in enumerate(_RADII):
            best = self._closer(numbers, best, radius)
            left = _lowest(best, max(_DESCENDED, _CLOSER >> (k + 1)), np.flatnonzero(np.isin(numbers, kept)).tolist())
            numbers, best = numbers[left], best.select(left)
        own = [
            concatenated([held.select([k]), best.select([j]), seen.select(slice(k * each, (k + 1) * each))])
            for j, k in enumerate(numbers)
        ]
        return numbers, own

    def _closer(self, numbers: np.ndarray, best: Evaluations, radius: float) -> Evaluations:
        """Return the lowest designs of combinations in boxes around the lowest so far."""
        count, n = len(numbers), len(self.free)
        offsets = self._rng.uniform(-radius, radius, (count * _AROUND, n))
        points = np.clip(np.repeat(best.points[:, self.free], _AROUND, axis=0) + offsets, 0.0, 1.0)
        return _best_of_each(best, self._landscape(self.designs(np.repeat(numbers, _AROUND), points)), _AROUND)

    def descended(self, number: int, seen: Evaluations, count: int) -> Promising:
        """Return where descents from a combination's lowest designs lead, its own values held."""
        starts = [0, 1]
        if len(seen.f) > 4 * _AROUND:
            lowest, _ = local_minima(seen.points[:, self.free], seen.merit)
            starts += [int(k) for k in lowest if k > 1]
        # Without a value there is no slope to follow.
        starts = [k for k in starts if np.isfinite(seen.merit[k])][:count]
        ends = [self._end(seen.points[k]) for k in starts] or [seen.select([0])]
        best = min(ends, key=lambda one: float(one.merit[0]))
        return Promising(number, best.points[0], float(best.merit[0]))

    def evolved(self, known: Promising, seen: Evaluations) -> Promising:
        """Return where an evolution leads from a combination's lowest designs, if that is lower."""
        n = len(self.free)
        lowest = np.argsort(seen.merit, kind="stable")[: _MEMBERS * n]
        start = np.vstack([known.start[self.free], seen.points[lowest][:, self.free]])
        if len(start) < _MEMBERS * n:
            start = np.vstack([start, self._rng.random((_MEMBERS * n - len(start), n))])

        def merit(x: Vector) -> Vector:
            return self._landscape(self.designs(np.full(len(x), known.number), x)).merit

        best = evolved(merit, start, _GENERATIONS, self._rng, from_best=n < MANY_VARIABLES, alike=_CONVERGED)
        end = self._end(self.designs(np.array([known.number]), best[None])[0])
        merit_there = float(end.merit[0])
        return Promising(known.number, end.points[0], merit_there) if merit_there < known.merit else known

    def _end(self, start: Vector) -> Evaluations:
        box = np.zeros(len(start)), np.ones(len(start))
        for side in box:
            side[self._fixed] = start[self._fixed]
        end = descend(self._landscape, start, box)
        if end.feasible[0]:
            return end
        nearer = least_violation(self._landscape, end.points[0], box)
        if nearer.feasible[0]:
            return descend(self._landscape, nearer.points[0], box)
        return min((end, nearer), key=lambda one: float(one.merit[0]))


def _best_of_each(first: Evaluations, others: Evaluations, each: int) -> Evaluations:
    """Return the lowest design of each combination: of one and of ``each`` others."""
    count = len(first.f)
    merit = np.column_stack([first.merit, others.merit.reshape(count, each)])
    which = np.argmin(merit, axis=1)
    every = concatenated([first, others])
    return every.select(np.where(which == 0, np.arange(count), count + np.arange(count) * each + which - 1))


def _lowest(seen: Evaluations, count: int, kept: list[int]) -> np.ndarray:
    """Return which combinations are lowest: half by their merit, half where a violation weighs lightly."""
    if len(seen.f) <= count:
        return np.arange(len(seen.f))
    with np.errstate(invalid="ignore"):
        lightly = np.where(np.isfinite(seen.f), seen.f + _LIGHTLY * seen.violation, np.inf)
    strict, loose = (np.argsort(value, kind="stable").tolist() for value in (seen.merit, lightly))
    half = count // 2
    chosen = list(dict.fromkeys([*kept, *strict[:half], *loose[: count - half]]))
    # The two halves are often the same.
    return np.array(list(dict.fromkeys([*chosen, *strict[: count + len(kept)]]))[: max(count, len(chosen))])


def _ordered(found: list[Promising]) -> list[Promising]:
    return sorted(found, key=lambda one: (one.merit, one.number))
