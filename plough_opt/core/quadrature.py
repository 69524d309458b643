"""Gauss-Legendre quadrature, as numbers for a graph."""

from functools import lru_cache

import numpy as np


@lru_cache(maxsize=64)
def gauss_legendre(order: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return nodes and weights on the interval from 0 to 1; exact for polynomials up to degree 2 order - 1.

    Args:
        order: number of nodes, at least 1.
    """
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return tuple((nodes / 2.0 + 0.5).tolist()), tuple((weights / 2.0).tolist())
