"""Space-filling samples of a design's variables, their local minima, and evolution from them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.model.ipopt import Vector
from plough_opt.design.search.landscape import Evaluations, Landscape

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

        points: NDArray[np.float64] = Sobol(n, rng=rng).random(count)
        return points
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
    found: NDArray[np.uint32] = (bits << np.arange(_BITS - 1, -1, -1, dtype=np.uint32)).sum(axis=-1, dtype=np.uint32)
    return found


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

# Half of the sample is stretched by this fraction of the range on either side and clipped, so that it includes bounds
# and corners.
_STRETCH = 0.15
# A point of a sample is a local minimum if it is lower than this many neighbours for each variable.
_NEIGHBOURS_PER_VARIABLE = 4
# Stands for infinity in an evolution, whose arithmetic must stay finite where designs cannot be evaluated.
_WORST = 1e30
# Default size of an evaluated sample.
_SAMPLE_SIZE = 1024


def evaluated_sample(landscape: Landscape, count: int = _SAMPLE_SIZE) -> Evaluations:
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
    points[half:] = np.clip((1.0 + 2.0 * _STRETCH) * points[half:] - _STRETCH, 0.0, 1.0)
    return np.vstack([points, start[None], np.full((1, n), 0.5)]), rng.permutation(half)


LINE_POSITIONS = 128
"""Positions on each line along a variable through a design."""

DIPS_PER_VARIABLE = 4
"""Dips on such lines, as many times the number of variables, from which descents start."""


def lines_through(y: Vector, variables: Sequence[int], radius: float = 1.0) -> Vector:
    """Return `LINE_POSITIONS` designs along each of the given variables, a row each.

    Args:
        y: a scaled design.
        variables: numbers of the variables.
        radius: length of the lines on either side of the design; they end at bounds.
    """
    lines = np.repeat(y[None], LINE_POSITIONS * len(variables), axis=0)
    for k, variable in enumerate(variables):
        lines[k * LINE_POSITIONS : (k + 1) * LINE_POSITIONS, variable] = np.linspace(
            max(y[variable] - radius, 0.0), min(y[variable] + radius, 1.0), LINE_POSITIONS
        )
    return lines


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
    count = min(_NEIGHBOURS_PER_VARIABLE * n if n > 1 else 2, len(points) - 1)
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
    lines = merit.reshape(-1, LINE_POSITIONS)
    wall = np.pad(lines, ((0, 0), (1, 1)), constant_values=np.inf)
    dips = np.flatnonzero(((wall[:, 1:-1] < wall[:, :-2]) & (wall[:, 1:-1] <= wall[:, 2:])).ravel())
    lowest_first: np.ndarray = dips[np.argsort(merit[dips], kind="stable")]
    return lowest_first[: DIPS_PER_VARIABLE * len(lines)]


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
    best: Vector = found.x
    return best
