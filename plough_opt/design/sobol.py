"""Scrambled Sobol points: those of `scipy.stats.qmc.Sobol`, without its import of all of scipy.stats."""

import numpy as np
from numpy.typing import NDArray

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
