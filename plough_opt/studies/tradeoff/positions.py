"""Positions on a front: where designs are sought, which of those found are shown, and where the front has gaps.

All objectives are normalised and minimised. Those of a curve are 0 at their own optimum and 1 at the other's; on a
connected one the sum of the changes of both between neighbours on evenly spread positions is the same everywhere.

A surface is seen along (1, 1, 1): the objectives less their mean are a design's place on the plane of utopia (Messac
and Mattson 2004), where the positions are the nodes of a lattice. Where neither of two designs dominates the other,
their heights above that plane differ by no more than their places.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Self

import numpy as np
from numpy.typing import NDArray

from plough_opt.studies.tradeoff.domination import JOINED, TOGETHER, Array

# Neighbours on a curve nearer than this many steps are one point twice.
_NEAR = 0.1

Node = tuple[int, int, int]
"""A position on the plane of utopia, in steps; the three add up to the same everywhere."""


# --- curves ---------------------------------------------------------------------------------------------------


def gaps(front: Array, step: float) -> list[int]:
    """Return after which rows of a front a gap follows.

    Args:
        front: normalised objectives of efficient rows in order.
        step: distance of neighbours, the sum of both changes.
    """
    distance = np.sum(np.abs(np.diff(front, axis=0)), axis=1)
    return [int(k) for k in np.flatnonzero(distance > JOINED * step)]


def spread(front: Array, step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those that crowd beside another; the ends of its parts stay.

    Args:
        front: normalised objectives of efficient rows in order.
        step: distance of neighbours, the sum of both changes.
    """
    ends = {k + 1 for k in gaps(front, step)}
    kept: list[int] = []
    for k in range(len(front)):
        if kept and np.sum(np.abs(front[k] - front[kept[-1]])) < _NEAR * step:
            last = k == len(front) - 1 or k + 1 in ends
            if not last or kept[-1] == 0 or kept[-1] in ends:
                continue
            kept.pop()
        kept.append(k)
    return np.array(kept, dtype=np.intp)


def needed(front: Array, extra: Sequence[bool], step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those between positions that no gap would follow.

    Args:
        front: normalised objectives of efficient rows in order.
        extra: whether a row lies between positions.
        step: distance of neighbours, the sum of both changes.
    """
    kept: list[int] = []
    for k in range(len(front)):
        ends = kept and k + 1 < len(front)
        if extra[k] and ends and np.sum(np.abs(front[k + 1] - front[kept[-1]])) <= JOINED * step:
            continue
        kept.append(k)
    return np.array(kept, dtype=np.intp)


# --- surfaces -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lattice:
    """Nodes on the plane of utopia.

    Attributes:
        steps: on a side of the triangle between the three objectives' own optima.
    """

    steps: int

    @classmethod
    def with_nodes(cls, count: int) -> Self:
        """Return the coarsest lattice that has so many nodes in the triangle."""
        return cls(next(n for n in range(2, count + 2) if (n + 1) * (n + 2) // 2 >= count))

    def triangle(self) -> set[Node]:
        """Return the nodes in the triangle."""
        return {(i, j, self.steps - i - j) for i in range(self.steps + 1) for j in range(self.steps + 1 - i)}

    def places(self, objectives: Array) -> Array:
        """Return the places of normalised objectives, a row each, in steps."""
        return np.asarray((objectives - np.mean(objectives, axis=1, keepdims=True) + 1.0 / 3.0) * self.steps)

    def nearest(self, objectives: Array) -> NDArray[np.intp]:
        """Return the nodes nearest to the places of normalised objectives, a row each."""
        places = self.places(objectives)
        whole = np.round(places).astype(int)
        # Rounding may miss the sum by one: the entry that was rounded most makes up for it.
        rows = np.arange(len(whole))
        whole[rows, np.argmax(np.abs(places - whole), axis=1)] += self.steps - whole.sum(axis=1)
        return np.asarray(whole, dtype=np.intp)

    def node_at(self, at: Array) -> Node:
        """Return the node nearest to the place of one row."""
        i, j, k = self.nearest(at[None])[0].tolist()
        return i, j, k

    def off(self, objectives: Array, nodes: NDArray[np.intp] | Node) -> Array:
        """Return how many steps the places of normalised objectives are from nodes, one for each row or for all."""
        return np.asarray(np.max(np.abs(self.places(objectives) - nodes), axis=1))


def neighbours(node: Node) -> list[Node]:
    """Return the six nodes a step away."""
    i, j, k = node
    return [(i + a, j + b, k + c) for a, b, c in permutations((1, -1, 0))]


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
