"""Which designs beat others, by how much designs are better than a front, and what a front dominates.

All objectives are minimised, a row for each design; they are normalised, but for `volume` and `knee`.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EQUAL = 1e-7
"""Normalised differences below are rounding of the solves."""

JOINED = 1.5
"""Steps between neighbours of a curve above this many are a gap."""

TOGETHER = 1.75
"""Steps between places within which two points of a surface belong to one part."""

ACROSS = np.array([[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]]) / np.sqrt([2.0, 6.0])
"""Two directions across (1, 1, 1), as columns."""

# Designs that are compared with a front at once.
_CHUNK = 20_000
# A knee stands out from the line, or the plane, of the best in each objective by at least this.
_STANDS_OUT = 1e-3


def undominated(designs: Array, tolerance: float = EQUAL) -> NDArray[np.intp]:
    """Return rows that no row dominates, and of which none is better than another by less than a tolerance.

    The rows with the least sums come first, and rows give way to kept ones only: of three that beat each other by
    rounding one stays.
    """
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


def in_order(objectives: Array) -> NDArray[np.intp]:
    """Return the rows of two objectives that no other row dominates, from the best in the first objective on."""
    best = undominated(objectives)
    return best[np.argsort(objectives[best, 0], kind="stable")]


def beyond_points(front: Array, designs: Array) -> Array:
    """Return by how much each design is better than every point of a front in the objective in which it is least so.

    Args:
        front: rows; without one every design is infinitely better.
        designs: rows to compare.
    """
    found = np.empty(len(designs))
    for rows, behind in _behind(front, designs, np.maximum):
        found[rows] = behind.min(axis=1, initial=np.inf)
    return found


def beating(front: Array, designs: Array) -> tuple[NDArray[np.intp], Array]:
    """Return for each point of a front the design that beats it most, and by how much in the objective least beaten."""
    most, by = np.zeros(len(front), dtype=np.intp), np.full(len(front), -np.inf)
    for rows, behind in _behind(front, designs, np.minimum):
        own = np.argmax(behind, axis=0)
        better = behind[own, np.arange(len(front))] > by
        most[better], by[better] = rows.start + own[better], behind[own, np.arange(len(front))][better]
    return most, by


def _behind(front: Array, designs: Array, extreme: np.ufunc) -> Iterator[tuple[slice, Array]]:
    """Yield some designs, and of the objectives that each point (a column) has more than each of them an extreme."""
    for first in range(0, len(designs), _CHUNK):
        part = designs[first : first + _CHUNK]
        # Objective by objective: NumPy reduces a short axis slowly.
        behind = front[:, 0] - part[:, :1]
        for k in range(1, front.shape[1]):
            extreme(behind, front[:, k] - part[:, k : k + 1], out=behind)
        yield slice(first, first + len(part)), behind


def beyond_front(front: Array, designs: Array, step: float) -> Array:
    """Return the same as `beyond_points` beyond the lines, or triangles, between neighbours, too.

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


def volume(front: Array, reference: Array) -> float:
    """Return the area, or the volume, that rows dominate up to a reference point, slice by slice.

    Args:
        front: two or three objectives of each row.
        reference: a point; rows beyond it count for nothing.
    """
    inside = front[np.all(front < reference, axis=1)]
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    if front.shape[1] == 2:
        slices = reference[0] - np.minimum.accumulate(inside[:, 0])
    else:
        slices = np.array([volume(inside[: k + 1, :2], reference[:2]) for k in range(len(inside))])
    return float(slices @ np.diff(inside[:, -1], append=reference[-1]))


def knee(front: Array) -> int | None:
    """Return the row farthest below the plane on which the best rows of each objective lie, or the nearest of them.

    Args:
        front: objectives of efficient rows.

    Returns:
        The row, or None where none is below: of two objectives the farthest below the line between both ends.
    """
    if len(front) < 3:
        return None
    low, high = front.min(axis=0), front.max(axis=0)
    sums = np.sum((front - low) / np.where(high > low, high - low, 1.0), axis=1)
    below = min(sums[k] for k in np.argmin(front, axis=0)) - sums
    best = int(np.argmax(below))
    return best if below[best] > _STANDS_OUT else None
