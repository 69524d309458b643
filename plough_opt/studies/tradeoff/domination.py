"""Domination between designs: who dominates whom, how far designs lead a front, and what volume a front dominates.

All objectives are minimised, with a row for each design. They are normalised, except in `volume` and `knee`.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EQUAL = 1e-7
"""Smaller differences of normalised objectives are rounding of the solves."""

CURVE_GAP = 1.5
"""Two points of a curve that are neighbours and farther apart than this many steps have a gap between them."""

SURFACE_GAP = 1.75
"""Two points of a surface farther apart than this many steps on the plane of utopia are not neighbours."""

ACROSS = np.array([[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]]) / np.sqrt([2.0, 6.0])
"""Two orthonormal directions across (1, 1, 1), as columns."""

# Designs compared with a front at once, which bounds the memory that takes.
_CHUNK = 20_000
# A knee lies at least this far below the line, or the plane, through the best point of each objective.
_LEAST_KNEE = 1e-3


def undominated(designs: Array, tolerance: float = EQUAL) -> NDArray[np.intp]:
    """Return the rows that no other row dominates; of rows that differ by less than a tolerance only one stays.

    Rows are taken by rising sum, and each is compared only with those that stay. So one stays of three rows that
    dominate each other in a circle by rounding.

    Args:
        designs: objectives, a row for each design.
        tolerance: a row must be better than each that stays by more than this in some objective.
    """
    left = np.argsort(designs.sum(axis=1), kind="stable")
    columns = designs[left].T.copy()
    chosen: list[int] = []
    while len(left):
        chosen.append(int(left[0]))
        better = columns[0] < columns[0, 0] - tolerance
        for own in columns[1:]:
            better |= own < own[0] - tolerance
        left, columns = left[better], columns[:, better]
    return np.array(chosen, dtype=np.intp)


def undominated_in_order(objectives: Array) -> NDArray[np.intp]:
    """Return the undominated rows of two objectives, from the best in the first objective to the worst."""
    best = undominated(objectives)
    return best[np.argsort(objectives[best, 0], kind="stable")]


def lead_over_points(front: Array, designs: Array) -> Array:
    """Return how far each design leads a front: positive if no point of the front dominates it.

    A design leads a point by the largest amount by which it is better in any objective, and a front by the least of
    its leads over the points.

    Args:
        front: points, a row each; the lead over an empty front is infinite.
        designs: rows to compare.
    """
    leads = np.empty(len(designs))
    for rows, gains in _gains(front, designs, np.maximum):
        leads[rows] = gains.min(axis=1, initial=np.inf)
    return leads


def strongest_dominators(front: Array, designs: Array) -> tuple[NDArray[np.intp], Array]:
    """Return for each point of a front the design that dominates it most, and by how much.

    A design dominates a point by the least amount by which it is better in any objective, which is negative if it does
    not dominate it.
    """
    strongest, by = np.zeros(len(front), dtype=np.intp), np.full(len(front), -np.inf)
    for rows, gains in _gains(front, designs, np.minimum):
        own = np.argmax(gains, axis=0)
        best = gains[own, np.arange(len(front))]
        better = best > by
        strongest[better], by[better] = rows.start + own[better], best[better]
    return strongest, by


def _gains(front: Array, designs: Array, extreme: np.ufunc) -> Iterator[tuple[slice, Array]]:
    """Yield, for one chunk of designs after another, an extreme over the objectives of their gains over each point.

    Args:
        front: points, which become columns.
        designs: rows.
        extreme: ``np.maximum`` or ``np.minimum``.
    """
    for first in range(0, len(designs), _CHUNK):
        part = designs[first : first + _CHUNK]
        # One objective at a time, because NumPy reduces a short axis slowly.
        gains = front[:, 0] - part[:, :1]
        for k in range(1, front.shape[1]):
            extreme(gains, front[:, k] - part[:, k : k + 1], out=gains)
        yield slice(first, first + len(part)), gains


def lead_over_front(front: Array, designs: Array, step: float) -> Array:
    """Return how far each design leads the points of a front and the lines or triangles between neighbouring points.

    Beyond the edges of a surface and in its holes there are no triangles. There the lead over the points is reduced by
    half a step, because points on an edge lie about that far from any place beside it.

    Args:
        front: efficient rows; of two objectives in order.
        designs: rows to compare, of three objectives a few thousand at most.
        step: distance of neighbours on the front.
    """
    over_points = lead_over_points(front, designs)
    if front.shape[1] == 2:
        return np.minimum(over_points, _depth_below_curve(front, designs, step))
    below = _depth_below_surface(front, designs, step)
    return np.where(np.isfinite(below), np.minimum(over_points, below), over_points - step / 2.0)


def _depth_below_curve(front: Array, designs: Array, step: float) -> Array:
    """Return how far designs lie below the lines between neighbours of a curve, along (1, 1).

    Infinite in gaps of the curve and beyond its ends.
    """
    if len(front) < 2:
        return np.full(len(designs), np.inf)
    along, height = front[:, 0] - front[:, 1], front.sum(axis=1) / 2.0
    location = designs[:, 0] - designs[:, 1]
    after = np.clip(np.searchsorted(along, location), 1, len(front) - 1)
    joined = np.sum(np.abs(np.diff(front, axis=0)), axis=1) <= CURVE_GAP * step
    inside = (location >= along[0]) & (location <= along[-1]) & joined[after - 1]
    return np.where(inside, np.interp(location, along, height) - designs.sum(axis=1) / 2.0, np.inf)


def _depth_below_surface(front: Array, designs: Array, step: float) -> Array:
    """Return how far designs lie below the triangles between neighbours of a surface, along (1, 1, 1).

    Infinite in holes of the surface and beyond its edges.
    """
    from scipy.spatial import Delaunay, QhullError  # slow to import, and every problem file imports this module

    depth = np.full(len(designs), np.inf)
    try:
        triangles = Delaunay(front @ ACROSS)
    except (QhullError, ValueError):  # too few points, or all on a line
        return depth
    corners = front[triangles.simplices]
    locations = corners - corners.mean(axis=2, keepdims=True)
    sides = np.abs(locations - np.roll(locations, 1, axis=1)).max(axis=(1, 2))
    across = designs @ ACROSS
    own = triangles.find_simplex(across)
    inside = np.flatnonzero(own >= 0)
    inside = inside[sides[own[inside]] <= SURFACE_GAP * step]
    # Barycentric coordinates in the design's own triangle give the height of the triangle below or above it.
    transform = triangles.transform[own[inside]]
    first_two = np.einsum("ijk,ik->ij", transform[:, :2], across[inside] - transform[:, 2])
    weights = np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])
    height = np.einsum("ij,ij->i", weights, corners[own[inside]].mean(axis=2))
    depth[inside] = height - designs[inside].mean(axis=1)
    return depth


def volume(front: Array, reference: Array) -> float:
    """Return the area, or the volume, between a front and a reference point, slice by slice.

    Args:
        front: two or three objectives of each row.
        reference: the far corner; rows that do not dominate it count for nothing.
    """
    inside = front[np.all(front < reference, axis=1)]
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    if front.shape[1] == 2:
        slices = reference[0] - np.minimum.accumulate(inside[:, 0])
    else:
        slices = np.array([volume(inside[: k + 1, :2], reference[:2]) for k in range(len(inside))])
    return float(slices @ np.diff(inside[:, -1], append=reference[-1]))


def knee(front: Array) -> int | None:
    """Return the row farthest below the line, or the plane, through the best row of each objective.

    Objectives count in units of their ranges. If the best rows differ in the sum of these, the plane is that of the
    least sum.

    Args:
        front: objectives of efficient rows.

    Returns:
        The row, or None if no row lies clearly below.
    """
    if len(front) < 3:
        return None
    low, high = front.min(axis=0), front.max(axis=0)
    sums = np.sum((front - low) / np.where(high > low, high - low, 1.0), axis=1)
    below = min(sums[k] for k in np.argmin(front, axis=0)) - sums
    best = int(np.argmax(below))
    return best if below[best] > _LEAST_KNEE else None
