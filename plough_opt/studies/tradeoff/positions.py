"""Positions on a front: where designs are sought, which of those found are shown, and where the front has gaps.

All objectives are normalised and minimised. On a curve each objective is 0 at its own optimum and 1 at the optimum of
the other one. Between neighbouring positions of a connected curve, the sum of both changes is always the same.

A surface is projected along (1, 1, 1). The objectives minus their mean are the location of a design on the plane of
utopia (Messac and Mattson 2004), and the positions are the nodes of a lattice on that plane. If neither of two designs
dominates the other, their heights above the plane differ by no more than their locations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Self

import numpy as np
from numpy.typing import NDArray

from plough_opt.studies.tradeoff.domination import CURVE_GAP, SURFACE_GAP, Array

# Neighbours on a curve closer than this many steps are shown as one point.
_CROWDED = 0.1

Node = tuple[int, int, int]
"""A node of a lattice on the plane of utopia, in steps; its three numbers have the same sum at every node."""


# --- curves ---------------------------------------------------------------------------------------------------


def gaps(front: Array, step: float) -> list[int]:
    """Return the rows of a front that are followed by a gap.

    Args:
        front: normalised objectives of efficient rows, in order.
        step: distance of neighbours, the sum of both changes.
    """
    distance = np.sum(np.abs(np.diff(front, axis=0)), axis=1)
    return [int(k) for k in np.flatnonzero(distance > CURVE_GAP * step)]


def uncrowded_on_curve(front: Array, step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those too close to another; the ends of its parts stay.

    Args:
        front: normalised objectives of efficient rows, in order.
        step: distance of neighbours, the sum of both changes.
    """
    ends = {k + 1 for k in gaps(front, step)}
    chosen: list[int] = []
    for k in range(len(front)):
        if chosen and np.sum(np.abs(front[k] - front[chosen[-1]])) < _CROWDED * step:
            last = k == len(front) - 1 or k + 1 in ends
            if not last or chosen[-1] == 0 or chosen[-1] in ends:
                continue
            chosen.pop()
        chosen.append(k)
    return np.array(chosen, dtype=np.intp)


def without_needless(front: Array, between: Sequence[bool], step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those between two positions that have no gap between them.

    Args:
        front: normalised objectives of efficient rows, in order.
        between: for each row whether it lies between positions.
        step: distance of neighbours, the sum of both changes.
    """
    chosen: list[int] = []
    for k in range(len(front)):
        inside = chosen and k + 1 < len(front)
        if between[k] and inside and np.sum(np.abs(front[k + 1] - front[chosen[-1]])) <= CURVE_GAP * step:
            continue
        chosen.append(k)
    return np.array(chosen, dtype=np.intp)


# --- surfaces -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lattice:
    """Nodes on the plane of utopia.

    Attributes:
        steps: number of steps along a side of the triangle between the three objectives' own optima.
    """

    steps: int

    @classmethod
    def with_nodes(cls, count: int) -> Self:
        """Return the coarsest lattice with at least this many nodes in the triangle."""
        return cls(next(n for n in range(2, count + 2) if (n + 1) * (n + 2) // 2 >= count))

    def triangle(self) -> set[Node]:
        """Return the nodes in the triangle."""
        return {(i, j, self.steps - i - j) for i in range(self.steps + 1) for j in range(self.steps + 1 - i)}

    def locations(self, objectives: Array) -> Array:
        """Return the locations of normalised objectives on the plane, in steps, a row each."""
        return np.asarray((objectives - np.mean(objectives, axis=1, keepdims=True) + 1.0 / 3.0) * self.steps)

    def nearest(self, objectives: Array) -> NDArray[np.intp]:
        """Return the node nearest to each row of normalised objectives."""
        locations = self.locations(objectives)
        nodes = np.round(locations).astype(int)
        # Rounding may miss the common sum by one. The entry that was rounded most makes up for it.
        rows = np.arange(len(nodes))
        nodes[rows, np.argmax(np.abs(locations - nodes), axis=1)] += self.steps - nodes.sum(axis=1)
        return np.asarray(nodes, dtype=np.intp)

    def nearest_node(self, objectives: Array) -> Node:
        """Return the node nearest to the normalised objectives of one design."""
        i, j, k = self.nearest(objectives[None])[0].tolist()
        return i, j, k

    def distance(self, objectives: Array, nodes: NDArray[np.intp] | Node) -> Array:
        """Return the distance of each row of normalised objectives from its node, or from one node, in steps."""
        return np.asarray(np.max(np.abs(self.locations(objectives) - nodes), axis=1))


def neighbours(node: Node) -> list[Node]:
    """Return the six nodes one step away."""
    i, j, k = node
    return [(i + a, j + b, k + c) for a, b, c in permutations((1, -1, 0))]


def distances(objectives: Array) -> Array:
    """Return the distances between the locations of all rows, as the largest difference in any objective."""
    locations = objectives - np.mean(objectives, axis=1, keepdims=True)
    return np.asarray(np.max(np.abs(locations[:, None, :] - locations[None, :, :]), axis=2))


def parts_of(objectives: Array, step: float) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """Return the connected parts of a surface, the largest first, and for each hole the two rows nearest across it.

    Holes are those of the shortest tree that connects all parts.

    Args:
        objectives: normalised objectives of efficient rows.
        step: distance of neighbouring positions.
    """
    from scipy.sparse import csr_array  # slow to import, and every problem file imports this module
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    apart = distances(objectives)
    count, label = connected_components(csr_array(apart <= SURFACE_GAP * step), directed=False)
    parts = sorted(([int(k) for k in np.flatnonzero(label == c)] for c in range(count)), key=len, reverse=True)
    between_parts, ends = np.zeros((count, count)), {}
    for a in range(count):
        for b in range(a + 1, count):
            own = apart[np.ix_(parts[a], parts[b])]
            i, j = np.unravel_index(np.argmin(own), own.shape)
            between_parts[a, b] = own[i, j]
            ends[a, b] = parts[a][i], parts[b][j]
    tree = minimum_spanning_tree(csr_array(between_parts)).tocoo()
    return parts, [ends[int(a), int(b)] for a, b in zip(tree.row, tree.col, strict=True)]


def uncrowded_on_surface(objectives: Array, rank: NDArray[np.intp], room: float) -> NDArray[np.intp]:
    """Return the rows without those that lie too close to another row of the same or a lower rank.

    Args:
        objectives: normalised objectives.
        rank: of each row; rows of rank 0 all stay.
        room: least distance of a row of rank 1 or more from the others that stay.
    """
    apart = distances(objectives)
    chosen: list[int] = []
    for k in np.argsort(rank, kind="stable"):
        if rank[k] == 0 or not chosen or np.min(apart[k, chosen]) >= room:
            chosen.append(int(k))
    return np.array(sorted(chosen), dtype=np.intp)


def covering(objectives: Array, chosen: NDArray[np.intp], room: float) -> NDArray[np.intp]:
    """Return the chosen rows, with others added until every row lies near one of them.

    Args:
        objectives: normalised objectives.
        chosen: rows to begin with.
        room: largest distance of a row from the nearest chosen one, in any objective.
    """
    rows = [int(k) for k in chosen]
    apart = np.max(np.abs(objectives[:, None] - objectives[rows][None]), axis=2).min(axis=1)
    while np.max(apart) > room:
        rows.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.max(np.abs(objectives - objectives[rows[-1]]), axis=1))
    return np.array(sorted(rows), dtype=np.intp)
