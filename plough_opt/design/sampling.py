"""A space-filling sample of a design's variables, the basins that show in it, and evolution from it."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Landscape, Seen

# Degree, inner coefficients and first direction numbers of the primitive polynomials of dimensions 2 and more: Joe and
# Kuo (2008), "Constructing Sobol sequences with better two-dimensional projections", file new-joe-kuo-6.
_POLYNOMIALS = (
    (1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)), (4, 1, (1, 1, 3, 3)), (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)), (5, 4, (1, 1, 5, 5, 5)), (5, 7, (1, 1, 7, 11, 19)), (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
)  # fmt: skip
_BITS = 30

MOST_DIMENSIONS = 1 + len(_POLYNOMIALS)
"""Dimensions whose direction numbers are here; of more, SciPy has them."""


def sobol_points(n: int, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the first points of a Sobol sequence, scrambled at random by a matrix and a shift, a row each.

    They are those of `scipy.stats.qmc.Sobol`, without its import of all of scipy.stats.

    Args:
        n: dimensions.
        count: number of points; evenly spread where it is a power of two.
        rng: what scrambles them.
    """
    if n > MOST_DIMENSIONS:
        from scipy.stats.qmc import Sobol  # slow to import

        points: NDArray[np.float64] = Sobol(n, rng=rng).random(count)
        return points
    (rng,) = rng.spawn(1)
    shift = _as_numbers(rng.integers(2, size=(n, _BITS), dtype=np.uint32)[:, ::-1])
    mixing = np.tril(rng.integers(2, size=(n, _BITS, _BITS), dtype=np.uint32), -1) | np.eye(_BITS, dtype=np.uint32)
    # Bits of the directions, the highest first: (dimension, bit, direction).
    bits = (_directions(n)[:, None, :] >> np.arange(_BITS - 1, -1, -1, dtype=np.uint32)[None, :, None]) & 1
    directions = _as_numbers((mixing @ bits % 2).transpose(0, 2, 1))
    found = shift[None]
    # In Gray's order a point and the next differ by one direction: that is each half mirrored, and shifted by one.
    for k in range(max(count - 1, 0).bit_length()):
        found = np.concatenate([found, found[::-1] ^ directions[:, k]])
    return found[:count] / 2.0**_BITS


def _as_numbers(bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return numbers of bits along the last axis, the highest first."""
    found: NDArray[np.uint32] = (bits << np.arange(_BITS - 1, -1, -1, dtype=np.uint32)).sum(axis=-1, dtype=np.uint32)
    return found


def _directions(n: int) -> NDArray[np.uint32]:
    """Return the direction numbers, a row for each dimension."""
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
"""Of every sample and evolution: the same question has the same answer."""

MANY = 6
"""From so many variables on an evolution that mutates its best design misses basins."""

# Half of the sample is stretched by so much on either side and clipped, so that bounds and corners are sampled.
_STRETCH = 0.15
# Neighbours of a point in the sample, for each variable, which decide whether it is a local minimum.
_NEIGHBOURS = 4
# Keeps the arithmetic of an evolution finite where designs have no value.
_WORST = 1e30
# Designs of a sample that looks for one that meets the requirements.
_LOOK = 1024


def sample_of(landscape: Landscape, count: int = _LOOK) -> Seen:
    """Return a look at all designs of a landscape, by a number of them that is a power of two."""
    middle = np.full(landscape.dimensions, 0.5)
    points, _ = sample(landscape.dimensions, count, middle, np.random.default_rng(SEED))
    return landscape(points)


def sample(n: int, count: int, start: Vector, rng: np.random.Generator) -> tuple[Vector, np.ndarray]:
    """Return points between 0 and 1, the start and the middle among them, and which of them are uniform."""
    if n == 1:
        # In one variable nothing is more even than a grid.
        grid = np.linspace(0.0, 1.0, count)[:, None]
        return np.vstack([grid, start[None]]), rng.permutation(count)
    points = sobol_points(n, count, rng)
    half = count // 2
    points[half:] = np.clip((1.0 + 2.0 * _STRETCH) * points[half:] - _STRETCH, 0.0, 1.0)
    return np.vstack([points, start[None], np.full((1, n), 0.5)]), rng.permutation(half)


def lines_through(y: Vector, count: int, variables: Sequence[int] | None = None) -> Vector:
    """Return so many designs along each of some variables through a design, by default all; a row each."""
    vary = range(len(y)) if variables is None else variables
    lines = np.repeat(y[None], count * len(vary), axis=0)
    for k, variable in enumerate(vary):
        lines[k * count : (k + 1) * count, variable] = np.linspace(0.0, 1.0, count)
    return lines


def lowest_around(points: Vector, merit: Vector) -> tuple[np.ndarray, np.ndarray]:
    """Return the points that are lower than their neighbours, the lowest first, and where downhill steps end.

    Args:
        points: a row each.
        merit: of each.
    """
    from scipy.spatial import KDTree  # slow to import

    n = points.shape[1]
    count = min(_NEIGHBOURS * n if n > 1 else 2, len(points) - 1)
    _, around = KDTree(points).query(points, k=count + 1)
    around = np.hstack([np.arange(len(points))[:, None], around])
    ends = around[np.arange(len(points)), np.argmin(merit[around], axis=1)]
    # A step from each point at a time doubles the way until all have arrived.
    while not np.array_equal(following := ends[ends], ends):
        ends = following
    lowest = np.unique(ends)
    return lowest[np.argsort(merit[lowest], kind="stable")], ends


def evolved(
    merit: Callable[[Vector], Vector],
    points: Vector,
    generations: int,
    rng: np.random.Generator,
    *,
    from_best: bool,
    alike: float,
) -> Vector:
    """Return the best point between 0 and 1 to which SciPy's differential evolution leads.

    Args:
        merit: points, a row each -> what is to be least; infinite without a value.
        points: from which it begins, a row each.
        generations: after how many to end.
        rng: what is random in it.
        from_best: whether the best design is mutated, which is faster, or any of them, which misses less.
        alike: relative scatter of the merits below which all points count as one.
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
    )
    best: Vector = found.x
    return best
