"""Following a front of three objectives: from node to neighbouring node of a lattice, as far as it reaches."""

from collections import deque
from collections.abc import Sequence
from itertools import permutations

import numpy as np

from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.polishing import minimum_from
from plough_opt.studies.tradeoff.archive import Archive
from plough_opt.studies.tradeoff.candidates import MATTERS, Candidate, Order, ahead
from plough_opt.studies.tradeoff.domination import beyond_points, undominated
from plough_opt.studies.tradeoff.positions import Lattice, Node, covering, neighbours, parts_of, uncrowded
from plough_opt.studies.tradeoff.tracer import Tracer

# Weight of the other objectives at the edges of the front, which limits on them and the best of one leave open. A tail
# that gains less than so much of what it gives away is left out.
_OTHERS = 0.01
# Weights of the objectives of an anchor: of the one it is best in, of another and of the last, in all six orders. An
# optimum of one objective that leaves the others open is not an anchor: it does not bound them.
_TURNS = np.array(list(permutations((1.0, 1e-3, 1e-6))))[[0, 1, 2, 4, 3, 5]]
# Of a range: what is worse than the best by less is nearly the best.
_NEARLY = 0.02
# Farthest that the lattice reaches beyond the triangle of utopia, in its sides.
_BEYOND = 1.0
# Steps between a node and a design that lies beside it.
_BESIDE = 1.0
# Nearer is at the node.
_EXACT = 1e-3
# Steps between points that are not on positions.
_ROOM = 0.7
# Steps, in the objectives: no efficient design that was found is farther from a point, and none that was seen and can
# be made from what was found. In a flat triangle of the lattice none is farther than two thirds from a corner.
_COVERED = 0.67


class SurfaceTracer(Tracer):
    """The candidates for a front of three objectives.

    Attributes:
        matters: more than of a curve, for triangles lie beside what is curved between its points.
    """

    turns = _TURNS
    matters = 5e-3
    at_once, rounds = 20, 4

    def __init__(self, archive: Archive, count: int, progress: Progress) -> None:
        """Take what looks at the designs of a front's program, and the least number of positions in the triangle."""
        super().__init__(archive, progress)
        self._lattice = Lattice.with_nodes(count)
        self.step = 1.0 / self._lattice.steps
        self.spacing = _COVERED * self.step
        self._inside = self._lattice.triangle()
        self._at: dict[Node, list[Candidate]] = {}

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Find the designs at all nodes of the lattice that the front reaches, and what lies between and beyond them.

        Args:
            anchors: all local optima for each order of the objectives, as `orders` has them.
        """
        ends = [self.kept(point, p) for p, points in zip(self.orders(), anchors, strict=True) for point in points]
        if self._looks_beside:
            self.look_beside()
            self._start_everywhere()
        else:
            self._start_in_the_middle(ends)
            for number, one in enumerate(ends):
                self.progress(f"following branch {number + 1} of {len(ends)}", number / len(ends))
                self._flood(one, self._lattice.node_at(one.at))
        self._fill_gaps()
        self.reach_all()

    def _start_everywhere(self) -> None:
        """Solve at each node from the design of the archive nearest to it, of those that hardly any other beats.

        Compared are the designs with the least sums beside each node, which are few.
        """
        y, at = self.archive.feasible
        nodes = self._lattice.nearest(at)
        lowest = np.argsort(at.sum(axis=1), kind="stable")
        _, first = np.unique(nodes[lowest], axis=0, return_index=True)
        best = np.flatnonzero(beyond_points(at[lowest[first]], at) > -MATTERS)
        best = best[np.argsort(self._lattice.off(at[best], nodes[best]), kind="stable")]
        _, first = np.unique(nodes[best], axis=0, return_index=True)
        best = best[first][~self.archive.needles(y[best[first]], at[best[first]])]
        starts = [((int(i), int(j), int(k)), y[own]) for (i, j, k), own in zip(nodes[best], best, strict=True)]
        self._inside &= {node for node, _ in starts}
        for number, (node, start) in enumerate(starts):
            self.progress("solving from the best designs seen", number / len(starts))
            self._new_at(node, self.best_from(self._question(node), start))

    def _start_in_the_middle(self, ends: Sequence[Candidate]) -> None:
        """Follow branches from the middle of the triangle: at an end of a front slopes may vanish that lead inside."""
        middle = self._lattice.node_at(np.full(3, 1.0 / 3.0))
        p = self._question(middle)
        self.progress("solving in the middle", 0.0)
        starts = [self.front.program.start(), np.mean([one.point.y for one in ends], axis=0)]
        for start in starts:
            found = self.solve(ends[0], start, p, report=False)
            if found is not None and self._is_at(found, middle):
                self._flood(found, middle)
                return

    def all_anchors(self, bottoms: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return local optima for each of `orders`, beside the bottoms of its first objective."""
        orders, found = self.orders(), list[list[Point]]()
        for number, own in enumerate(bottoms):
            points, beside = self.anchors(orders[2 * number], own), orders[2 * number + 1]
            if not points:
                return [*found, [], []]
            starts = [*self._toward(_TURNS[2 * number + 1]), *own]
            others = [self.front.solve(points[0], y, beside) for y in starts]
            others += [self.front.solve(point, point.y, beside) for point in points]
            others = [minimum_from(self.front.program, beside, point) for point in others if point.solved]
            found += [points, sorted(others, key=lambda point: point.f)]
        return found

    def _toward(self, weights: Vector) -> list[Vector]:
        """Return the design of the archive that is nearly the best in the first objective, and best in the next.

        Args:
            weights: of the objectives; the larger, the earlier.
        """
        first, second, _ = np.argsort(-weights)
        y, at = self.archive.feasible
        near = np.flatnonzero(at[:, first] <= at[:, first].min(initial=np.inf) + _NEARLY)
        return [y[near[np.argmin(at[near, second])]]] if len(near) else []

    # --- following ---------------------------------------------------------------------------------------

    def _question(self, node: Node) -> Vector:
        """Return the parameters at a node."""
        return self.position(np.array(node) * self.step)

    def position(self, at: Vector) -> Vector:
        """Return the parameters that ask for the front's design at the place of normalised objectives.

        The objective farthest beyond its corner's side is minimised.
        """
        objective = int(np.argmin(at))
        limits = {k: float(at[k] - at[objective]) for k in range(3) if k != objective}
        return self.front.limited(objective, limits, beside=True)

    def _off(self, one: Candidate, node: Node) -> float:
        """Return how many steps a candidate is from a node."""
        return float(self._lattice.off(one.at[None], node)[0])

    def _is_at(self, one: Candidate, node: Node) -> bool:
        """Return whether a local optimum of a node is on the front at that very position."""
        return self.is_efficient(one) and self._off(one, node) < _EXACT

    def _new_at(self, node: Node, found: Candidate | None) -> bool:
        """Keep what was found at a node; return whether it is something that was not known there."""
        known = self._at.setdefault(node, [])
        if found is None or found in known:
            return False
        known.append(found)
        return True

    def _flood(self, one: Candidate, node: Node, *, report: bool = True) -> None:
        """Follow a branch from a node over all nodes that it reaches.

        Args:
            one: on the branch.
            node: to begin at.
            report: whether failures are reported, and whether to go on where others beat the branch, which it may come
                out of.
        """
        visited: dict[Node, Candidate] = {}
        waiting = deque([(one, one.point.y, node)])
        seen = {node}
        while waiting:
            near, start, node = waiting.popleft()
            found = self.solve(near, start, self._question(node), report=report)
            if found is None or not self._new_at(node, found):
                continue
            visited[node] = found
            if not report and self.is_beaten(found):
                continue
            held = self._is_at(found, node)
            if not (held or (node in self._inside and self._off(found, node) < _BESIDE)):
                continue
            for fresh in neighbours(node):
                beyond = held and not self._looks_beside and min(fresh) >= -_BEYOND * self._lattice.steps
                if fresh not in seen and (fresh in self._inside or beyond):
                    seen.add(fresh)
                    i, j, k = (2 * a - b for a, b in zip(node, fresh, strict=True))
                    waiting.append((found, ahead(visited.get((i, j, k)), found), fresh))

    def at_the_edge(self, p: Vector, point: Point) -> Candidate:
        """Return the candidate of an optimum at a position; where the position does not hold it, that of the edge.

        The objective that is minimised there may leave the others open.
        """
        if not self.front.holds(point):
            objective = int(np.argmax(self.front.question(p)[0][1:]))
            at = self.front.objectives(point.y)
            better = self.front.limited(objective, {k: float(at[k]) for k in range(3) if k != objective}, _OTHERS)
            found = self.front.solve(point, point.y, better)
            if found.solved:
                p, point = better, found
        return self.kept(point, p)

    def uncovered(self, own: Vector, at: Vector) -> Vector:
        """Return how far designs lie from every point, if that is far, and at a place where none was sought; else 0.

        A surface that is a narrow band has few nodes, or none.
        """
        from scipy.spatial import KDTree  # slow to import

        if not len(own):
            return np.full(len(at), np.inf)
        apart, _ = KDTree(own).query(at, p=np.inf)
        far = apart > _COVERED * self.step
        places, sought = (rows - rows.mean(axis=1, keepdims=True) for rows in (at[far], own))
        far[far] = KDTree(sought).query(places, p=np.inf)[0] > self.step / 2.0
        return np.where(far, apart, 0.0)

    def follow_all(self, one: Candidate) -> None:
        """Follow a branch from the node nearest to a candidate, where the archive has too few designs to lead on."""
        if not self._looks_beside:
            self._flood(one, self._lattice.node_at(one.at), report=False)

    def _fill_gaps(self) -> None:
        """Follow the front to nodes that have no efficient design, from every neighbour that has one."""
        best = set(self.ordered())
        front = [(node, one) for node, own in self._at.items() for one in own
                 if one in best and self._is_at(one, node)]  # fmt: skip
        for number, (node, one) in enumerate(front):
            self.progress("looking into gaps", number / len(front))
            for other in neighbours(node):
                if other in self._inside and not any(self._is_at(own, other) for own in self._at.get(other, ())):
                    self._flood(one, other, report=False)

    # --- what makes up the front -------------------------------------------------------------------------

    def ordered(self) -> list[Candidate]:
        """Return the candidates that no other dominates."""
        own = [one for one in self.sound() if self.is_efficient(one)]
        return [own[k] for k in sorted(undominated(self.places(own)))]

    def order(self, candidates: Sequence[Candidate]) -> Order:
        """Return how candidates make up a front, from the best in the first objective on."""
        at, step = self.places(candidates), self.step
        own = np.flatnonzero([self.is_efficient(one) for one in candidates])
        order = np.sort(own[undominated(at[own])])
        if not len(order):
            return Order([], [], (), ())
        parts, ends = parts_of(at[order], step)
        anchors = np.argmin(at[order] @ _TURNS.T, axis=0)
        rank = (self._lattice.off(at[order], self._lattice.nearest(at[order])) > _EXACT).astype(int)
        # Of the anchors none has to stay where it lies beside another.
        apart = anchors[uncrowded(at[order[anchors]], np.ones_like(anchors), _ROOM * step)]
        rank[[*apart, *(row for pair in ends for row in pair)]] = 0
        kept = covering(at[order], uncrowded(at[order], rank, _ROOM * step), _COVERED * step)
        kept = kept[np.lexsort(at[order[kept]].T[::-1])]
        number = {int(row): k for k, row in enumerate(kept)}
        return Order(
            [candidates[k] for k in order],
            [candidates[k] for k in order[kept]],
            tuple(tuple(sorted(number[row] for row in part if row in number)) for part in parts),
            tuple((number[a], number[b]) for a, b in ends),
        )

    def look_inward(self) -> None:
        """Keep edge points unchanged; their weights already give the trade-off rates."""
