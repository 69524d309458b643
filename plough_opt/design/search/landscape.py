"""The scaled objective and requirement violations over all variables, as a search evaluates them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.optimality import difference_quotients
from plough_opt.design.model.population import LinearVariable
from plough_opt.design.model.program import Program

FINER = 2.0
"""Factor on a sample's number of steps, used for descents and comparisons, which need more accuracy."""

LEAST_GAIN = 1e-6
"""Relative gain of the merit that justifies another look at the best designs."""


class Violation:
    """Which violations of the requirements a search allows, and what they weigh."""

    allowed: Final = 1e-6  # sum of the scaled violations of a design that a search counts as feasible
    allowed_in_answer: Final = 5e-10  # the same for a design that is returned as an answer
    weight: Final = 100.0  # in the merit: it must outweigh any gain in the scaled objective, which is of order 1
    # Base merit of an infeasible design: above every scaled objective, yet small enough not to swallow the digits of
    # the violation that is added to it.
    infeasible: Final = 1e8


class Basins:
    """What tells designs, basins and needles apart."""

    same: Final = 1e-3  # Two scaled designs count as the same if no variable differs by more than this.
    # A rise of the merit by this fraction is a barrier between basins; a lower one is a ripple.
    barrier: Final = 1e-3
    # An optimum is a needle, which no workshop can hit, if its median is above its own objective by this fraction: of
    # the objective's magnitude, and at least of a quarter of its typical size over all designs.
    needle: Final = 0.05


@dataclass(frozen=True)
class Evaluations:
    """Designs with their objectives and violations, a row for each design.

    Attributes:
        points: scaled variables.
        f: scaled objective; NaN where the design cannot be evaluated.
        violation: sum over the requirements of each one's largest scaled violation; infinite where the design cannot be
            evaluated.
    """

    points: Vector
    f: Vector
    violation: Vector

    @classmethod
    def none(cls, dimensions: int) -> Evaluations:
        """Return no design, with a number of variables."""
        return cls(np.empty((0, dimensions)), np.empty(0), np.empty(0))

    @property
    def feasible(self) -> np.ndarray:
        """Whether each design meets all requirements."""
        return self.violation <= Violation.allowed

    @property
    def merit(self) -> Vector:
        """Objective plus penalty for violations; infinite where the design cannot be evaluated."""
        return np.where(np.isfinite(self.f), self.f + Violation.weight * self.violation, np.inf)

    @property
    def strict_merit(self) -> Vector:
        """A merit that ranks every feasible design before every infeasible one."""
        infeasible = Violation.infeasible + np.minimum(self.violation, Violation.infeasible)
        return np.where(np.isfinite(self.f), np.where(self.feasible, self.f, infeasible), np.inf)

    def select(self, which: Any) -> Evaluations:
        """Return the designs at an index, a slice or a mask."""
        return Evaluations(self.points[which], self.f[which], self.violation[which])

    def without_objective(self) -> Evaluations:
        """Return the designs with an objective of 0, so that the violation alone makes the merit."""
        return Evaluations(self.points, np.where(np.isfinite(self.violation), 0.0, np.nan), self.violation)


def concatenated(parts: Sequence[Evaluations]) -> Evaluations:
    """Return the designs of all parts in one object."""
    columns = ([getattr(part, name) for part in parts] for name in ("points", "f", "violation"))
    return Evaluations(*map(np.concatenate, columns))


def apart(
    points: Vector, order: Iterable[int], least: float, most: int | None = None, kept: Iterable[int] = ()
) -> list[int]:
    """Return the first points in an order that differ by a least distance in some variable, at most ``most`` of them.

    Args:
        points: a row for each point.
        order: numbers of points.
        least: the distance.
        most: number of points; None for all.
        kept: numbers of points that are returned too, whatever their distance from each other.
    """
    chosen = [*map(int, kept)]
    for k in order:
        if np.all(np.max(np.abs(points[chosen] - points[k]), axis=1) >= least):
            chosen.append(int(k))
        if len(chosen) == most:
            break
    return chosen


class Landscape:
    """Scaled objective and requirements over the scaled variables, at given parameters.

    Attributes:
        program: the design's program.
        p: parameters.
        held: numbers of variables that are never eliminated, because their values are given.
        dimensions: number of variables.
        objective_scale: of the objective. It stays the same if the program is rescaled later.
        vectorised: whether all runs of many designs are integrated together.
        designs_tried: number of designs evaluated so far.
    """

    def __init__(self, program: Program, p: Vector, held: Sequence[int] = ()) -> None:
        """Create the landscape of a program whose scales are set; ``held`` are numbers of variables to keep."""
        self.program, self.p, self.held = program, p, held
        self.dimensions = len(program.declared.variables)
        self._scale, self.objective_scale = program.row_scales, program.objective_scale
        self.vectorised = program.population.vectorised
        self.designs_tried = 0

    @cached_property
    def eliminated(self) -> list[LinearVariable]:
        """Variables that are solved for, given the others, instead of being searched."""
        return [one for one in self.program.linear_variables(self.p) if one.number not in self.held]

    @np.errstate(all="ignore")
    def rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the scaled objective and requirements, a row for each design.

        Args:
            points: scaled variables, a row for each design.
            finer: factor on the number of integration steps.
            together: this many consecutive designs are integrated with equal numbers of steps.
        """
        self.designs_tried += len(points)
        f, g = self.program.population(points, self.p, finer=finer, together=together)
        return f / self.objective_scale, g / self._scale

    def quotients(self, y: Vector) -> tuple[Vector, Vector, Vector] | None:
        """Return `difference_quotients` at a design; None without a value, or if runs are integrated one by one."""
        if not self.vectorised:
            return None
        with np.errstate(all="ignore"):
            return difference_quotients(lambda points: self.rows(points, finer=FINER, together=len(points)), y)

    def violations(self, g: Vector) -> Vector:
        """Return each requirement's largest violation, a row for each design; infinite where g is not finite."""
        worst = -self.program.least_margins(g)
        return np.where(np.isfinite(worst), np.maximum(worst, 0.0), np.inf)

    def __call__(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> Evaluations:
        """Evaluate designs, a row each, with the eliminated variables solved for; see `rows` for the arguments."""
        if not len(points):
            return Evaluations(points, np.empty(0), np.empty(0))
        with np.errstate(all="ignore"):
            points, f, g = self.rows_after_elimination(points, finer=finer, together=together)
            violation = self.violations(g).sum(axis=1)
        f = np.where(np.isfinite(f), f, np.nan)
        return Evaluations(points, f, np.where(np.isnan(f), np.inf, violation))

    def rows_after_elimination(
        self, points: Vector, *, finer: float = 1.0, together: int = 1
    ) -> tuple[Vector, Vector, Vector]:
        """Return designs with the eliminated variables solved for, and their scaled objective and requirements."""
        f, g = self.rows(points, finer=finer, together=together)
        f_scale, low, high = self.objective_scale, self.program.low * self._scale, self.program.high * self._scale
        for variable in self.eliminated:
            points, f, g = variable.solved(points, f * f_scale, g * self._scale, low, high)
            f, g = f / f_scale, g / self._scale
        return points, f, g


# --- straight lines between designs: they show whether two designs lie in one basin --------------------------


class _StraightLines:
    """Positions on straight lines between designs, and how far the merit may rise along them."""

    barrier_positions: Final = 24  # at which a barrier between two designs is looked for
    # Along a descent path. They are denser towards both ends, where narrow basins would show.
    path_positions: Final = 40
    stride: Final = 5  # Every fifth of these is evaluated first.
    # Fraction of the merit by which it may rise along such a path, because of rounding and the accuracy of the end.
    path_rise: Final = 1e-6
    nearest_ends: Final = 4  # Only paths to this many are examined.


def barriers(evaluate: Callable[[Vector], Evaluations], one: Evaluations, others: Evaluations) -> NDArray[np.bool_]:
    """Return for each of several designs whether a barrier, more than a ripple, separates it from one design.

    Args:
        evaluate: designs, a row each -> their evaluations.
        one: the one design.
        others: the other designs.
    """
    fractions = np.linspace(0.0, 1.0, _StraightLines.barrier_positions + 2)[1:-1]
    lines = one.points + fractions[:, None, None] * (others.points - one.points)
    merit = evaluate(lines.reshape(-1, lines.shape[2])).merit.reshape(_StraightLines.barrier_positions, -1)
    higher = np.maximum(others.merit, one.merit)
    return np.asarray(merit.max(axis=0) > higher + Basins.barrier * np.abs(higher))


def end_straight_downhill(landscape: Landscape, start: Vector, ends: Evaluations) -> int | None:
    """Return the number of an end such that the merit only falls on the straight line to it; None without one.

    The start then lies in that end's basin, so that a descent from it is unnecessary. Without this a search with up to
    three variables takes 1.6 times as long, as of the reference problem.
    """
    distance = np.max(np.abs(ends.points - start), axis=1)
    # Rounding the distance puts ends of the same basin side by side: of these the lowest is taken.
    order = np.lexsort((ends.merit, distance.round(3)))
    near = apart(ends.points, order[np.isfinite(ends.merit[order])], Basins.same, _StraightLines.nearest_ends)
    fractions = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _StraightLines.path_positions))
    # Most paths rise early or not at all: a few positions rule out most of those that rise.
    for some in (fractions[:: _StraightLines.stride], np.delete(fractions, np.s_[:: _StraightLines.stride])):
        if near:
            falling = _only_fall(landscape, start, ends.points[near], some)
            near = [k for k, falls in zip(near, falling, strict=True) if falls]
    return near[0] if near else None


def _only_fall(landscape: Landscape, start: Vector, ends: Vector, fractions: Vector) -> NDArray[np.bool_]:
    """Return for each end whether the merit only falls over these fractions of the line from the start."""
    lines = start + fractions[:, None] * (ends - start)[:, None]
    # Equal numbers of steps along a line: a change of the number would look like a rise.
    merit = landscape(lines.reshape(-1, len(start)), together=len(fractions)).merit.reshape(-1, len(fractions))
    with np.errstate(invalid="ignore"):
        small = largest_rise(merit) <= _StraightLines.path_rise * np.abs(merit[:, -1])
    return np.asarray(np.isfinite(merit).all(axis=1) & small)


def largest_rise(merit: Vector) -> Vector:
    """Return how far the merit rises above its lowest value before, at most, along each line (the last axis)."""
    with np.errstate(invalid="ignore"):  # a rise from infinity counts as NaN
        return np.asarray(np.max(merit - np.minimum.accumulate(merit, axis=-1), axis=-1))


# For dimensions 2 and above: degree, inner coefficients and first direction numbers of the primitive polynomials. From
# Joe and Kuo (2008), "Constructing Sobol sequences with better two-dimensional projections", file new-joe-kuo-6.
_POLYNOMIALS = (
    (1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)), (4, 1, (1, 1, 3, 3)), (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)), (5, 4, (1, 1, 5, 5, 5)), (5, 7, (1, 1, 7, 11, 19)), (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
)  # fmt: skip
# Bits of a coordinate, as in SciPy.
_BITS = 30

MOST_DIMENSIONS = 1 + len(_POLYNOMIALS)
"""Dimensions whose direction numbers are listed here; for more of them SciPy is used."""


def sobol_points(n: int, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the first points of a Sobol sequence, scrambled by a random matrix and shift, a row each.

    They equal those of `scipy.stats.qmc.Sobol`, without importing scipy.stats, which takes 0.6 s.

    Args:
        n: number of dimensions.
        count: number of points. They are evenly spread if it is a power of two.
        rng: random numbers for the scrambling.
    """
    if n > MOST_DIMENSIONS:
        from scipy.stats.qmc import Sobol  # slow to import

        return np.asarray(Sobol(n, rng=rng).random(count))
    (rng,) = rng.spawn(1)
    shift = _as_numbers(rng.integers(2, size=(n, _BITS), dtype=np.uint32)[:, ::-1])
    mixing = np.tril(rng.integers(2, size=(n, _BITS, _BITS), dtype=np.uint32), -1) | np.eye(_BITS, dtype=np.uint32)
    # Bits of the direction numbers, highest first: (dimension, bit, direction).
    bits = (_directions(n)[:, None, :] >> np.arange(_BITS - 1, -1, -1, dtype=np.uint32)[None, :, None]) & 1
    directions = _as_numbers((mixing @ bits % 2).transpose(0, 2, 1))
    found = shift[None]
    # In Gray-code order each doubling appends the mirrored points so far, shifted by the next direction.
    for k in range(max(count - 1, 0).bit_length()):
        found = np.concatenate([found, found[::-1] ^ directions[:, k]])
    return found[:count] / 2.0**_BITS


def _as_numbers(bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the numbers whose bits, highest first, lie along the last axis."""
    return np.asarray((bits << np.arange(_BITS - 1, -1, -1, dtype=np.uint32)).sum(axis=-1, dtype=np.uint32))


def _directions(n: int) -> NDArray[np.uint32]:
    """Return the direction numbers of a Sobol sequence, a row for each dimension."""
    found = np.ones((n, _BITS), dtype=np.uint64)
    for row, (degree, inner, first) in zip(found[1:], _POLYNOMIALS, strict=False):
        row[:degree] = first
        for k in range(degree, _BITS):
            row[k] = row[k - degree] ^ (row[k - degree] << np.uint64(degree))
            for j in range(1, degree):
                if inner >> (degree - 1 - j) & 1:
                    row[k] ^= row[k - j] << np.uint64(j)
    return (found << np.arange(_BITS - 1, -1, -1, dtype=np.uint64)).astype(np.uint32)


SEED = 2008
"""Seed of every sample and evolution, so that the same problem has the same answer."""

MANY_VARIABLES = 6
"""With at least this many variables, an evolution that mutates its best design misses basins."""

# Stands for infinity in an evolution, whose arithmetic must stay finite where designs cannot be evaluated.
_WORST = 1e30


class _Sample:
    """Extent of a sample, and of what counts as a local minimum in it."""

    size: Final = 1024  # by default
    # Half of it is stretched by this fraction of the range on either side and clipped, so that it includes bounds and
    # corners.
    stretch: Final = 0.15
    neighbours: Final = 4  # for each variable; a local minimum is lower than all of them


def evaluated_sample(landscape: Landscape, count: int = _Sample.size) -> Evaluations:
    """Return a sample of a landscape over all its variables; its size must be a power of two."""
    middle = np.full(landscape.dimensions, 0.5)
    points, _ = sample(landscape.dimensions, count, middle, np.random.default_rng(SEED))
    return landscape(points)


def sample(n: int, count: int, start: Vector, rng: np.random.Generator) -> tuple[Vector, np.ndarray]:
    """Return points between 0 and 1, the start and the middle among them, and the shuffled numbers of the uniform ones.

    Args:
        n: number of variables.
        count: number of points besides the start and, with several variables, the middle; a power of two.
        start: the start.
        rng: random numbers.
    """
    if n == 1:
        # With one variable a grid is the most even sample.
        grid = np.linspace(0.0, 1.0, count)[:, None]
        return np.vstack([grid, start[None]]), rng.permutation(count)
    points = sobol_points(n, count, rng)
    half = count // 2
    points[half:] = np.clip((1.0 + 2.0 * _Sample.stretch) * points[half:] - _Sample.stretch, 0.0, 1.0)
    return np.vstack([points, start[None], np.full((1, n), 0.5)]), rng.permutation(half)


class _AlongVariables:
    """Extent of a look along each variable through a design."""

    positions: Final = 128  # on each line
    dips: Final = 4  # from which descents start, as many times the number of variables


def with_variables(y: Vector, variables: Sequence[int], points: Any) -> Vector:
    """Return copies of a scaled design with some variables, by number, at other points, a row each."""
    designs = np.repeat(y[None], len(points), axis=0)
    designs[:, variables] = points
    return designs


def lines_through(y: Vector, variables: Sequence[int], radius: float = 1.0) -> Vector:
    """Return designs along each of the given variables, equally many on each line, a row each.

    Args:
        y: a scaled design.
        variables: numbers of the variables.
        radius: length of the lines on either side of the design; they end at bounds.
    """
    lines = np.tile(y, (len(variables), _AlongVariables.positions, 1))
    for line, k in zip(lines, variables, strict=True):
        line[:, k] = np.linspace(max(y[k] - radius, 0.0), min(y[k] + radius, 1.0), _AlongVariables.positions)
    return lines.reshape(-1, len(y))


def local_minima(points: Vector, merit: Vector) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the points that are lower than their neighbours, lowest first, and where each point leads.

    Args:
        points: a row for each point.
        merit: of each point.

    Returns:
        The local minima; and for each point the local minimum that repeated steps to the lowest neighbour reach.
    """
    from scipy.spatial import KDTree  # slow to import

    n = points.shape[1]
    count = min(_Sample.neighbours * n if n > 1 else 2, len(points) - 1)
    _, around = KDTree(points).query(points, k=count + 1)
    around = np.hstack([np.arange(len(points))[:, None], around])
    ends = around[np.arange(len(points)), np.argmin(merit[around], axis=1)]
    # Following the pointers twice doubles the number of steps, until every point has arrived.
    while not np.array_equal(following := ends[ends], ends):
        ends = following
    lowest = np.unique(ends)
    return lowest[np.argsort(merit[lowest], kind="stable")], ends


def dips_along(merit: Vector) -> np.ndarray:
    """Return the numbers of the lowest positions that are lower than both neighbours on their line, lowest first.

    Args:
        merit: of each position, line after line.
    """
    lines = merit.reshape(-1, _AlongVariables.positions)
    wall = np.pad(lines, ((0, 0), (1, 1)), constant_values=np.inf)
    dips = np.flatnonzero(((wall[:, 1:-1] < wall[:, :-2]) & (wall[:, 1:-1] <= wall[:, 2:])).ravel())
    return np.asarray(dips[np.argsort(merit[dips], kind="stable")][: _AlongVariables.dips * len(lines)])


def evolved(
    merit: Callable[[Vector], Vector],
    points: Vector,
    generations: int,
    rng: np.random.Generator,
    *,
    from_best: bool,
    alike: float,
    stop: Callable[[], bool] = lambda: False,
) -> Vector:
    """Return the best point between 0 and 1 that SciPy's differential evolution finds.

    Args:
        merit: points, a row each -> the values to minimise; infinite where a point cannot be evaluated.
        points: the first population, a row each.
        generations: most generations.
        rng: random numbers.
        from_best: whether to mutate the best point, which is faster, or random ones, which misses fewer basins.
        alike: the evolution ends when the merits' relative scatter is below this.
        stop: returns True to end it after a generation.
    """
    from scipy.optimize import differential_evolution  # slow to import

    found: Any = differential_evolution(
        lambda x: np.minimum(merit(x.T), _WORST),
        [(0.0, 1.0)] * points.shape[1],
        strategy="best1bin" if from_best else "rand1bin",
        init=points,
        maxiter=generations,
        tol=alike,
        recombination=0.9,
        rng=rng,
        polish=False,
        updating="deferred",
        vectorized=True,
        callback=lambda intermediate_result: stop(),  # noqa: ARG005, SciPy passes it by this name
    )
    return np.asarray(found.x)
