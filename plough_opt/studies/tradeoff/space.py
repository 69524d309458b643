"""The space of three normalised objectives, all minimised: a lattice of positions, domination, parts, volume.

A front is seen along (1, 1, 1): the objectives less their mean are its place on the plane of utopia (Messac and Mattson
2004). Where neither of two designs dominates the other, their heights above it differ by no more than their places.
"""

from collections.abc import Iterator
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from plough_opt.studies.tradeoff.domination import TOGETHER, Array
from plough_opt.studies.tradeoff.plane import area

Node = tuple[int, int, int]
"""A position on the plane of utopia, in half steps; the three add up to the same everywhere."""

# Steps; of points that the tight integration gives their objectives.
_EXACT = 1e-3


def positions(count: int) -> int:
    """Return how many steps a side of the triangle needs to hold so many positions."""
    return next(n for n in range(2, count + 2) if (n + 1) * (n + 2) // 2 >= count)


def triangle(steps: int) -> Iterator[Node]:
    """Yield the nodes between the three corners of utopia, whole steps apart."""
    for i in range(steps + 1):
        for j in range(steps + 1 - i):
            yield 2 * i, 2 * j, 2 * (steps - i - j)


def neighbours(node: Node) -> Iterator[Node]:
    """Yield the six nodes a step away."""
    for a, b, c in permutations((2, -2, 0)):
        yield node[0] + a, node[1] + b, node[2] + c


def nearest(at: Array, steps: int) -> Node:
    """Return the node nearest to the place of normalised objectives."""
    i, j, k = nearest_nodes(at[None], steps)[0].tolist()
    return i, j, k


def nearest_nodes(objectives: Array, steps: int) -> NDArray[np.intp]:
    """Return the same for many rows, a node each."""
    places = (objectives - np.mean(objectives, axis=1, keepdims=True) + 1.0 / 3.0) * steps
    whole = np.round(places).astype(int)
    # Rounding may miss the sum by one: the entry that was rounded most makes up for it.
    rows = np.arange(len(whole))
    whole[rows, np.argmax(np.abs(places - whole), axis=1)] += steps - whole.sum(axis=1)
    return np.asarray(2 * whole, dtype=np.intp)


def off(at: Array, node: Node, steps: int) -> float:
    """Return how many steps the place of normalised objectives is from a node."""
    place = (at - np.mean(at) + 1.0 / 3.0) * steps
    return float(np.max(np.abs(place - np.array(node) / 2.0)))


def lattice(objectives: Array, steps: int) -> NDArray[np.intp]:
    """Return 0 for rows at nodes that are whole steps apart, 1 for rows half-way between two, 2 for others."""
    places = (objectives - np.mean(objectives, axis=1, keepdims=True) + 1.0 / 3.0) * steps
    halves = np.max(np.abs(2.0 * places - np.round(2.0 * places)), axis=1) < _EXACT
    wholes = np.max(np.abs(places - np.round(places)), axis=1) < _EXACT
    return np.where(wholes, 0, np.where(halves, 1, 2))


def distances(objectives: Array) -> Array:
    """Return the distances between the places of all rows: the largest difference of their objectives less the mean."""
    places = objectives - np.mean(objectives, axis=1, keepdims=True)
    return np.asarray(np.max(np.abs(places[:, None, :] - places[None, :, :]), axis=2))


def parts_of(objectives: Array, step: float) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """Return the connected parts of a front, the largest first, and the nearest rows across the holes between them.

    Args:
        objectives: normalised objectives of efficient rows.
        step: between positions.
    """
    from scipy.sparse import csr_array  # slow to import, and every problem file imports this module
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    apart = distances(objectives)
    count, label = connected_components(csr_array(apart <= TOGETHER * step), directed=False)
    parts = sorted(([int(k) for k in np.flatnonzero(label == c)] for c in range(count)), key=len, reverse=True)
    between_parts, ends = np.zeros((count, count)), {}
    for a in range(count):
        for b in range(a + 1, count):
            own = apart[np.ix_(parts[a], parts[b])]
            i, j = np.unravel_index(np.argmin(own), own.shape)
            between_parts[a, b] = own[i, j]
            ends[a, b] = parts[a][i], parts[b][j]
    joined = minimum_spanning_tree(csr_array(between_parts)).tocoo()
    return parts, [ends[int(a), int(b)] for a, b in zip(joined.row, joined.col, strict=True)]


def uncrowded(objectives: Array, rank: NDArray[np.intp], room: float) -> NDArray[np.intp]:
    """Return rows of which none of a higher rank is nearer to another than a distance.

    Args:
        objectives: normalised objectives.
        rank: rows of rank 0 all stay; the others give way to any of a lower rank, then to each other.
        room: the distance.
    """
    apart = distances(objectives)
    kept: list[int] = []
    for k in np.argsort(rank, kind="stable"):
        if rank[k] == 0 or not kept or np.min(apart[k, kept]) >= room:
            kept.append(int(k))
    return np.array(sorted(kept), dtype=np.intp)


def covering(objectives: Array, kept: NDArray[np.intp], room: float) -> NDArray[np.intp]:
    """Return kept rows, and others until none is farther from them in some objective than a distance.

    Args:
        objectives: normalised objectives.
        kept: rows.
        room: the distance.
    """
    found = [int(k) for k in kept]
    apart = np.max(np.abs(objectives[:, None] - objectives[found][None]), axis=2).min(axis=1)
    while np.max(apart) > room:
        found.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.max(np.abs(objectives - objectives[found[-1]]), axis=1))
    return np.array(sorted(found), dtype=np.intp)


def volume(front: Array, reference: Array) -> float:
    """Return the volume that a front dominates up to a reference point, slice by slice.

    Args:
        front: three objectives of each row, all minimised.
        reference: a point; rows beyond it count for nothing.
    """
    inside = front[np.all(front < reference, axis=1)]
    inside = inside[np.argsort(inside[:, 2], kind="stable")]
    heights = np.r_[inside[:, 2], reference[2]]
    total = 0.0
    for k in range(len(inside)):
        if heights[k + 1] > heights[k]:
            total += area(inside[: k + 1, :2], reference[:2]) * float(heights[k + 1] - heights[k])
    return total
