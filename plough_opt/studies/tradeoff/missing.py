"""By how much designs are better than a traced front: ends, branches and basins that it misses.

All objectives are normalised and minimised, a row for each design.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plough_opt.studies.tradeoff.plane import JOINED, Array
from plough_opt.studies.tradeoff.space import ACROSS, TOGETHER

# Designs that are compared with a front at once.
_CHUNK = 20_000


def beyond_points(front: Array, designs: Array) -> Array:
    """Return by how much each design is better than every point of a front in the objective in which it is least so.

    Args:
        front: rows.
        designs: rows to compare.
    """
    found = np.empty(len(designs))
    for first in range(0, len(designs), _CHUNK):
        part = designs[first : first + _CHUNK]
        found[first : first + _CHUNK] = _behind(front, part).min(axis=1)
    return found


def _behind(front: Array, designs: Array) -> Array:
    """Return the largest objective that each point (a column) has more than each design (a row)."""
    # Objective by objective: NumPy reduces a short axis slowly.
    worst = front[:, 0] - designs[:, :1]
    for k in range(1, front.shape[1]):
        np.maximum(worst, front[:, k] - designs[:, k : k + 1], out=worst)
    return worst


def beyond_front(front: Array, designs: Array, step: float) -> Array:
    """Return the same beyond the points and the straight lines, or triangles, between neighbours among them.

    Where a surface has no triangle, at its edges and in its holes, half a step beyond the points is none beyond it: so
    far apart are the points of an edge.

    Args:
        front: efficient rows; of two objectives in order.
        designs: rows to compare, of three objectives a few thousand at most.
        step: distance of neighbours on the front.
    """
    points = beyond_points(front, designs)
    if front.shape[1] == 2:
        return np.minimum(points, _under_curve(front, designs, step))
    under = _under_surface(front, designs, step)
    return np.where(np.isfinite(under), np.minimum(points, under), points - step / 2.0)


def beating(front: Array, designs: Array) -> Array:
    """Return by how much each design is better in all objectives than the point that it beats most; below 0: none."""
    found = np.empty(len(designs))
    for first in range(0, len(designs), _CHUNK):
        part = designs[first : first + _CHUNK]
        least = front[:, 0] - part[:, :1]
        for k in range(1, front.shape[1]):
            np.minimum(least, front[:, k] - part[:, k : k + 1], out=least)
        found[first : first + _CHUNK] = least.max(axis=1)
    return found


def thinned(designs: Array, tolerance: float) -> NDArray[np.intp]:
    """Return rows of which none is better than another by less than a tolerance, and that no row dominates."""
    left = np.argsort(designs.sum(axis=1), kind="stable")
    columns = designs[left].T.copy()
    kept: list[int] = []
    while len(left):
        kept.append(int(left[0]))
        better = columns[0] < columns[0, 0] - tolerance
        for own in columns[1:]:
            better |= own < own[0] - tolerance
        left, columns = left[better], columns[:, better]
    return np.array(kept, dtype=np.intp)


def _under_curve(front: Array, designs: Array, step: float) -> Array:
    """Return how far designs lie below the lines between neighbours of a curve; infinite at its gaps and beyond it."""
    if len(front) < 2:
        return np.full(len(designs), np.inf)
    along, height = front[:, 0] - front[:, 1], front.sum(axis=1) / 2.0
    place = designs[:, 0] - designs[:, 1]
    after = np.clip(np.searchsorted(along, place), 1, len(front) - 1)
    joined = np.sum(np.abs(np.diff(front, axis=0)), axis=1) <= JOINED * step
    inside = (place >= along[0]) & (place <= along[-1]) & joined[after - 1]
    return np.where(inside, np.interp(place, along, height) - designs.sum(axis=1) / 2.0, np.inf)


def _under_surface(front: Array, designs: Array, step: float) -> Array:
    """Return how far designs lie below the triangles between neighbours of a surface; infinite at holes and beyond."""
    from scipy.spatial import Delaunay, QhullError  # slow to import, and every problem file imports this module

    found = np.full(len(designs), np.inf)
    try:
        triangles = Delaunay(front @ ACROSS)
    except (QhullError, ValueError):  # too few points, or all on a line
        return found
    corners = front[triangles.simplices]
    places = corners - corners.mean(axis=2, keepdims=True)
    sides = np.abs(places - np.roll(places, 1, axis=1)).max(axis=(1, 2))
    across = designs @ ACROSS
    own = triangles.find_simplex(across)
    inside = np.flatnonzero(own >= 0)
    inside = inside[sides[own[inside]] <= TOGETHER * step]
    turn = triangles.transform[own[inside]]
    first = np.einsum("ijk,ik->ij", turn[:, :2], across[inside] - turn[:, 2])
    weights = np.column_stack([first, 1.0 - first.sum(axis=1)])
    height = np.einsum("ij,ij->i", weights, corners[own[inside]].mean(axis=2))
    found[inside] = height - designs[inside].mean(axis=1)
    return found
