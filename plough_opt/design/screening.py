"""Screening of all combinations of catalogue values for those that can be best."""

from dataclasses import dataclass

import numpy as np

from plough_opt.design.descents import descend, least_violation
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Evaluations, Landscape, concatenated
from plough_opt.design.sampling import (
    MANY_VARIABLES,
    SEED,
    dips_along,
    evolved,
    lines_through,
    local_minima,
    sobol_points,
)

# The first sample of the free variables.
_SAMPLE = 2**16  # designs of all combinations together
_FEWEST_EACH = 2
_MOST_EACH = 128

# Shrinking boxes around the best designs of the lowest combinations.
_ZOOM_COMBINATIONS = 256  # in the first round; their number is halved from round to round
_ZOOM_SAMPLE = 16  # designs in a box
_ZOOM_RADII = (0.25, 0.12, 0.06, 0.03, 0.015)  # half widths by round, as fractions of the range

# Descents from the lowest combinations.
_DESCENT_COMBINATIONS = 30
_DESCENTS = 60  # of all combinations together
_MOST_DESCENTS_EACH = 8

# Evolution of the combinations that can still win.
_EVOLVED = 8  # combinations at most
_CAN_WIN = 0.15  # Their merit is within this fraction of the best.
_DESIGNS_PER_VARIABLE = 12
_GENERATIONS = 50
_CONVERGED = 1e-6  # The evolution ends when the merits scatter by less than this fraction.

# Positions on the line along each free variable through the lowest designs of these combinations, the dips on it from
# which descents start, the number of looks along the lines, and the relative gain that justifies another one.
_LINE_POSITIONS = 128
_DIPS_PER_VARIABLE = 4
_MOST_LOOKS = 4
_GAIN = 1e-6

# Weight of a violation in the second ranking, which keeps slightly infeasible combinations in the competition.
_LOW_PENALTY = 1.0


@dataclass(frozen=True)
class Promising:
    """A combination that can be best.

    Attributes:
        number: its row among the combinations.
        start: the design, evaluated, from which to optimise the free variables.
    """

    number: int
    start: Evaluations

    @property
    def merit(self) -> float:
        """Merit of the start; every feasible one is below any that is not."""
        return float(self.start.strict_merit[0])


def promising(
    landscape: Landscape, optimum: Vector, fixed: list[int], combinations: Vector, kept: list[int], seed: int = 0
) -> list[Promising]:
    """Return the combinations that can be best, lowest merit first and infeasible ones last.

    All are evaluated with the free variables at the optimum and at a sample. The lowest are sampled again in shrinking
    boxes around their best design, and from the lowest designs of the remaining ones descents start.

    Args:
        landscape: of the design; vectorised.
        optimum: the scaled optimum.
        fixed: numbers of the variables with a catalogue.
        combinations: scaled values of these variables, a row for each combination.
        kept: rows that are never dropped, such as the optimum's neighbours.
        seed: of the samples.
    """
    screen = _Screen(landscape, optimum, fixed, combinations, seed)
    if not screen.free:
        evaluated = landscape(screen.designs(np.arange(len(combinations)), np.empty((len(combinations), 0))))
        best = _lowest(evaluated, _DESCENT_COMBINATIONS, kept)
        return _ordered([Promising(int(k), evaluated.select([k])) for k in best])
    numbers, samples = screen.sampled(kept)
    descents = max(2, min(_MOST_DESCENTS_EACH, _DESCENTS // len(numbers)))
    sample_by_number = dict(zip(numbers.tolist(), samples, strict=True))
    found = _ordered([screen.descended(k, own, descents) for k, own in sample_by_number.items()])
    if len(screen.free) == 1:
        return found
    # With several free variables a sample may miss the best basin of a combination that can win.
    limit = found[0].merit + _CAN_WIN * abs(found[0].merit)
    last = [screen.evolved(one, sample_by_number[one.number]) for one in found[:_EVOLVED] if one.merit <= limit]
    return _ordered([*last, *found[len(last) :]])


class _Screen:
    """Evaluates combinations over the variables that have no catalogue."""

    def __init__(
        self, landscape: Landscape, optimum: Vector, fixed: list[int], combinations: Vector, seed: int
    ) -> None:
        self._landscape, self._optimum, self._fixed, self._combinations = landscape, optimum, fixed, combinations
        self.free = [k for k in range(len(optimum)) if k not in fixed]
        self._rng = np.random.default_rng([SEED + seed, len(combinations)])

    def designs(self, numbers: np.ndarray, free: Vector) -> Vector:
        """Return the designs that join combinations, by number, with values of the free variables, a row each."""
        found = np.empty((len(numbers), len(self._optimum)))
        found[:, self._fixed] = self._combinations[numbers]
        found[:, self.free] = free
        return found

    def sampled(self, kept: list[int]) -> tuple[np.ndarray, list[Evaluations]]:
        """Return the lowest combinations and the evaluated designs of each.

        The designs of a combination are the one at the optimum, the best one found, and its part of the sample.
        """
        count, n = len(self._combinations), len(self.free)
        numbers = np.arange(count)
        at_optimum = self._landscape(self.designs(numbers, np.tile(self._optimum[self.free], (count, 1))))
        each = int(np.clip(_SAMPLE // count, _FEWEST_EACH, _MOST_EACH))
        points = sobol_points(n, count * each, self._rng)
        # Consecutive points of the sequence fill the space evenly, so each combination takes a block of them.
        sample = self._landscape(self.designs(np.repeat(numbers, each), points))
        best = _best_of_each(at_optimum, sample, each)
        numbers = _lowest(best, _ZOOM_COMBINATIONS, kept)
        best = best.select(numbers)
        for k, radius in enumerate(_ZOOM_RADII):
            best = self._zoomed(numbers, best, radius)
            remaining = max(_DESCENT_COMBINATIONS, _ZOOM_COMBINATIONS >> (k + 1))
            left = _lowest(best, remaining, np.flatnonzero(np.isin(numbers, kept)).tolist())
            numbers, best = numbers[left], best.select(left)
        own = [
            concatenated([at_optimum.select([k]), best.select([j]), sample.select(slice(k * each, (k + 1) * each))])
            for j, k in enumerate(numbers)
        ]
        return numbers, own

    def _zoomed(self, numbers: np.ndarray, best: Evaluations, radius: float) -> Evaluations:
        """Return the lowest design of each combination after sampling a box around its lowest so far."""
        count, n = len(numbers), len(self.free)
        offsets = self._rng.uniform(-radius, radius, (count * _ZOOM_SAMPLE, n))
        points = np.clip(np.repeat(best.points[:, self.free], _ZOOM_SAMPLE, axis=0) + offsets, 0.0, 1.0)
        return _best_of_each(
            best, self._landscape(self.designs(np.repeat(numbers, _ZOOM_SAMPLE), points)), _ZOOM_SAMPLE
        )

    def descended(self, number: int, designs: Evaluations, count: int) -> Promising:
        """Return the best end of descents from a combination's lowest designs, with the combination's values held."""
        # The designs at the optimum and the best one found; then the local minima of the sample.
        starts = [0, 1]
        if len(designs.f) > 4 * _ZOOM_SAMPLE:
            lowest, _ = local_minima(designs.points[:, self.free], designs.merit)
            starts += [int(k) for k in lowest if k > 1]
        # A design that cannot be evaluated has no slope to follow.
        starts = [k for k in starts if np.isfinite(designs.merit[k])][:count]
        ends = [self._end(designs.points[k]) for k in starts] or [designs.select([0])]
        return min((Promising(number, end) for end in ends), key=lambda one: one.merit)

    def evolved(self, known: Promising, designs: Evaluations) -> Promising:
        """Return the end of an evolution from a combination's lowest designs if it is lower than the known start."""
        n = len(self.free)
        size = _DESIGNS_PER_VARIABLE * n
        lowest = np.argsort(designs.merit, kind="stable")[:size]
        start = np.vstack([known.start.points[:, self.free], designs.points[lowest][:, self.free]])
        if len(start) < size:
            start = np.vstack([start, self._rng.random((size - len(start), n))])

        def merit(x: Vector) -> Vector:
            return self._landscape(self.designs(np.full(len(x), known.number), x)).merit

        best = evolved(merit, start, _GENERATIONS, self._rng, from_best=n < MANY_VARIABLES, alike=_CONVERGED)
        end = Promising(known.number, self._end(self.designs(np.array([known.number]), best[None])[0]))
        return self._along_each_variable(min(known, end, key=lambda one: one.merit))

    def _along_each_variable(self, one: Promising) -> Promising:
        """Return the lowest end of descents from dips along each free variable, which a sparse sample misses."""
        for _ in range(_MOST_LOOKS):
            lines = lines_through(one.start.points[0], _LINE_POSITIONS, self.free)
            dips = dips_along(self._landscape(lines).merit, _LINE_POSITIONS)[: _DIPS_PER_VARIABLE * len(self.free)]
            ends = [Promising(one.number, self._end(lines[k])) for k in dips]
            best = min([one, *ends], key=lambda end: end.merit)
            if not best.merit < one.merit - _GAIN * abs(one.merit):
                break
            one = best
        return one

    def _end(self, start: Vector) -> Evaluations:
        """Return the end of a descent in the free variables, feasible if a least-violation search leads there."""
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
    """Return the lowest design of each combination, out of its first design and ``each`` others."""
    count = len(first.f)
    merit = np.column_stack([first.merit, others.merit.reshape(count, each)])
    which = np.argmin(merit, axis=1)
    every = concatenated([first, others])
    return every.select(np.where(which == 0, np.arange(count), count + np.arange(count) * each + which - 1))


def _lowest(best: Evaluations, count: int, kept: list[int]) -> np.ndarray:
    """Return the numbers of the lowest combinations: half by merit, half with a low penalty, and those to keep."""
    if len(best.f) <= count:
        return np.arange(len(best.f))
    with np.errstate(invalid="ignore"):
        low_penalty = np.where(np.isfinite(best.f), best.f + _LOW_PENALTY * best.violation, np.inf)
    strict, loose = (np.argsort(value, kind="stable").tolist() for value in (best.merit, low_penalty))
    half = count // 2
    chosen = list(dict.fromkeys([*kept, *strict[:half], *loose[: count - half]]))
    # The two halves often overlap: fill up by merit.
    return np.array(list(dict.fromkeys([*chosen, *strict[: count + len(kept)]]))[: max(count, len(chosen))])


def _ordered(found: list[Promising]) -> list[Promising]:
    return sorted(found, key=lambda one: (one.merit, one.number))
