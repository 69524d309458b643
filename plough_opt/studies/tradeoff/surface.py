"""Following a front of three objectives: from node to neighbouring node of a lattice, branch by branch."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.curvature import minimum_from
from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.reaching import Reaching
from plough_opt.studies.tradeoff.samples import Order, Sample
from plough_opt.studies.tradeoff.searching import Searcher
from plough_opt.studies.tradeoff.space import (
    Node,
    between,
    covering,
    lattice,
    nearest,
    neighbours,
    off,
    parts_of,
    positions,
    triangle,
    uncrowded,
    undominated,
)

# Weight of the other objectives at the edges of the front, which limits on them and the best of one leave open. A tail
# that gains less than so much of what it gives away is left out.
_OTHERS = 0.01
# Of the objectives of an anchor: of the one it is best in, of another and of the last, in all six orders.
IN_TURN = np.array(list(permutations((1.0, 1e-3, 1e-6))))[[0, 1, 2, 4, 3, 5]]
# Of a range: what is worse than the best by so much is nearly the best.
_NEARLY = 0.02
# Farthest that the lattice reaches beyond the triangle of utopia, in its sides.
_BEYOND = 1.0
# Steps between a node and a design that lies beside it.
_BESIDE = 1.0
# Nearer is at the node.
_EXACT = 1e-3
_ROUNDS = 4
# Decimals by which places are told apart.
_PLACES = 4
# Of six anchors none has to stay where it lies beside another.
_LAST = np.full(6, 1)
# Steps between points that are not on positions.
_ROOM = 0.7
# Steps, in the objectives: no efficient design that was found is farther from a point, and none that was seen and can
# be made from what was found. In a flat triangle of the lattice none is farther than two thirds from a corner.
_COVERED = 0.67
# Nodes at which basins are searched, as fractions of the triangle's corners.
_SEARCHED = ((1 / 3, 1 / 3, 1 / 3), (0.5, 0.5, 0.0), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5))


class SurfaceTracer(Reaching):
    """The local optima of a front of three objectives.

    Attributes:
        step: distance of neighbouring positions in the normalised objectives.
        matters: more than of a curve, for triangles lie beside what is curved between its points.
    """

    matters = 5e-3

    def __init__(self, front: FrontProgram, searcher: Searcher, count: int, progress: Progress) -> None:
        """Take the program, what searches over its variables, and the least number of positions in the triangle."""
        super().__init__(front, searcher, progress)
        self._steps = positions(count)
        self.step = 1.0 / self._steps
        self._inside = set(triangle(self._steps))
        self._at: dict[Node, list[Sample]] = {}

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Follow every branch over the lattice from every optimum of an objective alone, and refine the edges.

        Args:
            anchors: all local optima for each order of the objectives, as `orders` has them.
        """
        orders = self.orders()
        level = self.level_of_anchors
        ends = [self.kept(point, p, level) for p, points in zip(orders, anchors, strict=True) for point in points]
        self._start_in_the_middle(ends)
        for number, sample in enumerate(ends):
            self.progress(f"following branch {number + 1} of {len(ends)}", number / len(ends))
            self._flood(sample, nearest(sample.at, self._steps))
        for number, corner in enumerate(_SEARCHED if self.searcher.vary else ()):
            self.progress(f"searching between the anchors, {number + 1} of {len(_SEARCHED)}", number / len(_SEARCHED))
            self._search_at(nearest(np.array(corner), self._steps))
        self._fill_gaps()
        self.reach_all()
        self._refine_edges()
        self._bridge()
        self.reach_all(look=False)

    def _start_in_the_middle(self, ends: Sequence[Sample]) -> None:
        """Follow branches from the middle of the triangle: at an end of a front slopes may vanish that lead inside."""
        middle = nearest(np.full(3, 1.0 / 3.0), self._steps)
        p = self._question(middle)
        self.progress("solving in the middle", 0.0)
        y = self.cloud.best_at(p)
        if y is not None:
            found = self.sample_at(p, y)
            if not isinstance(found, Point):
                self._flood(found, middle)
                return
        starts = [self.front.program.start(), np.mean([sample.point.y for sample in ends], axis=0)]
        for start in starts:
            if (point := self.front.levels[-1].solve(start, p)).solved:
                found = self.solve(Sample(point, p, ends[0].at, coarsest=self.coarsest), point.y, p)
                if not isinstance(found, Point) and self._is_at(found, middle):
                    self._flood(found, middle)
                    return

    def orders(self) -> list[Vector]:
        """Return the parameters for each objective alone, with either other one next: six questions.

        An optimum of one objective that leaves the others open is not an anchor: it does not bound them.
        """
        return [self.in_ranges(weights) for weights in IN_TURN]

    def alone(self) -> list[Vector]:
        """Return the first of either two orders that begin with the same objective."""
        return self.orders()[::2]

    def all_anchors(self, bottoms: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return local optima for each of `orders`, beside the bottoms of its first objective."""
        orders, found = self.orders(), list[list[Point]]()
        for number, own in enumerate(bottoms):
            points, beside = self.anchors(orders[2 * number], own), orders[2 * number + 1]
            if not points:
                return [*found, [], []]
            starts = [*self._toward(IN_TURN[2 * number + 1]), *own]
            others = [self.front.solve(points[0], y, beside, self.coarsest) for y in starts]
            others += [self.front.solve(point, point.y, beside, self.coarsest) for point in points]
            others = [
                self._to_the_last_digit(minimum_from(self.front.program, beside, point), beside)
                for point in others
                if point.solved
            ]
            found += [points, sorted(others, key=lambda point: point.f)]
        return found

    def _toward(self, weights: Vector) -> list[Vector]:
        """Return the design of the cloud that is nearly the best in the first of the objectives, and best in the next.

        Args:
            weights: of the objectives; the larger, the earlier.
        """
        first, second, _ = np.argsort(-weights)
        y, scaled = self.cloud.feasible
        at = self.front.normalised(scaled)
        near = np.flatnonzero(at[:, first] <= at[:, first].min(initial=np.inf) + _NEARLY)
        return [y[near[np.argmin(at[near, second])]]] if len(near) else []

    # --- following ---------------------------------------------------------------------------------------

    def _question(self, node: Node) -> Vector:
        """Return the parameters at a node."""
        return self._question_at(np.array(node) * self.step / 2.0)

    def _question_at(self, place: Vector) -> Vector:
        """Return the parameters at a place: the objective farthest beyond its corner's side is minimised."""
        objective = int(np.argmin(place))
        return self.front.beside(objective, {k: float(place[k] - place[objective]) for k in range(3) if k != objective})

    def _flood(self, sample: Sample, node: Node, *, reported: bool = True, beaten: bool = True) -> None:
        """Follow a branch from a node over all nodes that it reaches.

        Args:
            sample: on the branch.
            node: to begin at.
            reported: whether failures are reported.
            beaten: whether to go on where others beat the branch, which it may come out of.
        """
        visited: dict[Node, Sample] = {}
        waiting: deque[tuple[Sample, Node]] = deque([(sample, node)])
        seen = {node}
        while waiting:
            near, node = waiting.popleft()
            found = self._step_to(node, near, self._extrapolated(visited, near, node), reported=reported)
            if found is None:
                continue
            visited[node] = found
            if not beaten and self.is_beaten(found):
                continue
            held = self._is_at(found, node)
            if held or (node in self._inside and self._is_beside(found, node)):
                for fresh in neighbours(node):
                    if fresh not in seen and (fresh in self._inside or (held and self._near(fresh))):
                        seen.add(fresh)
                        waiting.append((found, fresh))

    def _step_to(self, node: Node, near: Sample, start: Vector, *, reported: bool = True) -> Sample | None:
        """Return a new local optimum at a node, None where there is none or another branch has found it."""
        found = self._sample_at(np.array(node) * self.step / 2.0, near, start, reported=reported)
        others = self._at.setdefault(node, [])
        if found is None or any(found is other for other in others):
            return None
        others.append(found)
        return found

    def _sample_at(self, place: Vector, near: Sample, start: Vector, *, reported: bool = True) -> Sample | None:
        """Return a local optimum at a place, or at the edge of the front that the place lies beyond."""
        p = self._question_at(place)
        point, level = self.optimum(near.point, start, p, near.coarsest, patient=False)
        if not point.solved:
            if reported:
                self.fail(near, point)
            return None
        return self.at_the_edge(p, point, level)

    def at_the_edge(self, p: Vector, point: Point, level: int) -> Sample:
        """Return the sample of an optimum at a position; where the position does not hold it, that of the edge."""
        if not self.front.holds(point):
            objective = int(np.argmax(self.front.asked(p)[0][1:]))
            p, point, level = self._improved(objective, p, point, level)
        return self.kept(point, p, level)

    def _improved(self, objective: int, p: Vector, point: Point, level: int) -> tuple[Vector, Point, int]:
        """Return an efficient design at the edge of the front, no worse than an optimum beyond it.

        The objective that is minimised there may leave the others open.
        """
        at = self.front.normalised(self.front.objectives(point.y, level))
        limits = {k: float(at[k]) for k in range(3) if k != objective}
        better = self.front.below(objective, limits, _OTHERS)
        found, found_level = self.optimum(point, point.y, better, level, patient=False)
        return (better, found, found_level) if found.solved else (p, point, level)

    def _is_at(self, sample: Sample, node: Node) -> bool:
        """Return whether a local optimum of a node is on the front at that very position."""
        return self.is_efficient(sample) and off(sample.at, node, self._steps) < _EXACT

    def _is_beside(self, sample: Sample, node: Node) -> bool:
        """Return whether a local optimum lies within a step of a node."""
        return off(sample.at, node, self._steps) < _BESIDE

    def _near(self, node: Node) -> bool:
        return min(node) >= -2 * _BEYOND * self._steps

    @staticmethod
    def _extrapolated(visited: dict[Node, Sample], near: Sample, node: Node) -> Vector:
        """Return where the branch leads from the node behind the neighbour, or the neighbour."""
        for middle in neighbours(node):
            if visited.get(middle) is near:
                i, j, k = (2 * a - b for a, b in zip(middle, node, strict=True))
                if (behind := visited.get((i, j, k))) is not None:
                    return np.clip(2.0 * near.point.y - behind.point.y, 0.0, 1.0)
        return near.point.y

    def position(self, at: Vector) -> Vector:
        """Return the parameters that ask for the front's design at the place of normalised objectives."""
        return self._question_at(at - np.mean(at) + 1.0 / 3.0)

    def uncovered(self, own: Vector, at: Vector) -> NDArray[np.bool_]:
        """Return which designs lie far from every point, and at a place where none was sought.

        A surface that is a narrow band has few nodes, or none.
        """
        apart = np.max(np.abs(at[:, None] - own[None]), axis=2).min(axis=1) > _COVERED * self.step
        places, sought = (rows - rows.mean(axis=1, keepdims=True) for rows in (at, own))
        away = np.max(np.abs(places[:, None] - sought[None]), axis=2).min(axis=1) > self.step / 2.0
        return np.asarray(apart & away)

    def follow_all(self, sample: Sample) -> None:
        """Follow a branch from the node nearest to a sample."""
        # Where it comes out from behind others, the cloud has it again.
        self._flood(sample, nearest(sample.at, self._steps), reported=False, beaten=False)

    def _search_at(self, node: Node) -> None:
        """Search basins at a node, and follow what is new from there."""
        p, here = self._question(node), self._at.setdefault(node, [])
        for y in self.searcher.basins_at(p):
            sample = self.sample_at(p, y)
            if not isinstance(sample, Point) and not any(sample is other for other in here):
                self._flood(sample, node)

    # --- gaps --------------------------------------------------------------------------------------------

    def _on_front(self) -> dict[Node, Sample]:
        """Return the nodes at which there is an efficient design, with it."""
        best = self.efficient_ones()
        return {node: sample for node, own in self._at.items() for sample in own
                if id(sample) in best and self._is_at(sample, node)}  # fmt: skip

    def _fill_gaps(self) -> None:
        """Look for efficient designs at nodes that have none, from every neighbour that has one."""
        tried: set[tuple[Node, Node]] = set()
        for number in range(_ROUNDS):
            front = self._on_front()
            fresh = [(node, other) for node in front for other in neighbours(node)
                     if other not in front and other in self._inside]  # fmt: skip
            fresh = [pair for pair in fresh if pair not in tried]
            for k, (node, other) in enumerate(fresh):
                self.progress(f"looking into gaps, round {number + 1}", k / len(fresh))
                tried.add((node, other))
                start = self._extrapolated(front, front[node], other)
                if not any(self._is_at(sample, other) for sample in self._at.get(other, ())):
                    self._step_to(other, front[node], start, reported=False)
            if not fresh:
                return

    def _refine_edges(self) -> None:
        """Halve the steps where a part of the front ends."""
        front = self._on_front()
        edges = {between(node, other): sample for node, sample in front.items() for other in neighbours(node)
                 if other in self._at and other not in front}  # fmt: skip
        for number, (node, sample) in enumerate(edges.items()):
            self.progress("refining the edges", number / len(edges))
            self._step_to(node, sample, sample.point.y, reported=False)

    def _bridge(self) -> None:
        """Look half-way between the parts of the front: a narrow strip between them may have no node."""
        tried: set[bytes] = set()
        for _ in range(_ROUNDS):
            front = self.ordered()
            _, holes = parts_of(np.array([sample.at for sample in front]), self.step)
            for pair in holes:
                ends = [front[k] for k in pair]
                middle = np.mean([sample.at for sample in ends], axis=0)
                place = middle - np.mean(middle) + 1.0 / 3.0
                if np.round(place, _PLACES).tobytes() not in tried:
                    tried.add(np.round(place, _PLACES).tobytes())
                    for sample in ends:
                        self._sample_at(place, sample, sample.point.y, reported=False)

    def efficient_ones(self) -> set[int]:
        """Return the identities of the samples that no other dominates."""
        own = [sample for sample in self.sound() if self.is_efficient(sample)]
        return {id(own[k]) for k in undominated(np.array([sample.at for sample in own]).reshape(-1, 3))}

    def order(self, samples: Sequence[Sample]) -> Order:
        """Return how samples make up a front, from the best in the first objective on."""
        at, step = np.array([sample.at for sample in samples]), self.step
        own = np.flatnonzero([self.is_efficient(sample) for sample in samples])
        order = own[undominated(at[own])]
        parts, ends = parts_of(at[order], step)
        anchors = np.argmin(at[order] @ IN_TURN.T, axis=0)
        rank = lattice(at[order], self._steps)
        apart = anchors[uncrowded(at[order[anchors]], _LAST, _ROOM * step)]
        rank[[*apart, *(row for pair in ends for row in pair)]] = 0
        kept = covering(at[order], uncrowded(at[order], rank, _ROOM * step), _COVERED * step)
        kept = kept[np.lexsort(at[order[kept]].T[::-1])]
        number = {int(row): k for k, row in enumerate(kept)}
        return Order(
            frozenset(order.tolist()),
            tuple(order[kept].tolist()),
            tuple(tuple(sorted(number[row] for row in part if row in number)) for part in parts),
            tuple((number[a], number[b]) for a, b in ends),
        )

    def ordered(self) -> list[Sample]:
        """Return the samples that no other dominates."""
        best = self.efficient_ones()
        return [sample for sample in self.found if id(sample) in best]

    def look_inward(self) -> None:
        """Keep edge points unchanged; their weights already give the trade-off rates."""
