"""Tracing of a front: of two objectives from every optimum of either, of three from node to node of a lattice.

All objectives are normalised and minimised. On a curve each objective is 0 at its own optimum and 1 at the optimum of
the other one. Between neighbouring positions of a connected curve, the sum of both changes is always the same.

A surface is solved at the nodes that it covers, in one of two ways. If runs are integrated side by side, the archive is
rich: each node is solved from the best design seen near it (`_solve_from_archive`). Otherwise the front is followed
from a solved node to its neighbours, and from those to theirs, as a flood spreads (`_flood`). Then nodes in gaps are
tried from every side.

A surface is projected along (1, 1, 1). The objectives minus their mean are the location of a design on the plane of
utopia (Messac and Mattson 2004), and the positions are the nodes of a lattice on that plane. If neither of two designs
dominates the other, their heights above the plane differ by no more than their locations.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.plain_data import Array
from plough_opt.design.confirmation import minimum_from
from plough_opt.design.model.ipopt import Point
from plough_opt.design.search.landscape import apart
from plough_opt.studies.tradeoff.archive import MATTERS, OTHERS_WEIGHT, SOUGHT, Archive, Tracer
from plough_opt.studies.tradeoff.front import (
    Arrangement,
    FrontCandidate,
    covering,
    extrapolated,
    gaps,
    lead_over_points,
    locations,
    parts_of,
    uncrowded_on_curve,
    undominated,
    undominated_in_order,
    without_needless,
)

# An optimum farther from its position is not held by it: the branch has ended.
_OFF_POSITION = 1e-6
# Margin by which the end of one part is sought beside an efficient point, so that the point does not dominate it.
_CLEARANCE = 1e-6
# Steps from an end of the front to its inner neighbour.
_INWARD = 0.01
# Largest difference, in a scaled variable, of a solve from its prediction on the same branch.
_SAME_BRANCH = 0.1
# Optima behind the current one from which the next is predicted.
_REMEMBERED = 2
# Positions in a row without an optimum after which a branch is given up.
_GIVE_UP = 2
# Neighbours on the front that differ by more than this in a scaled variable lie on different branches.
_OTHER_BRANCH = 0.1
# Most rounds of looking into gaps.
_GAP_ROUNDS = 6
# Decimals of normalised objectives by which gaps are recognised again.
_GAP_DECIMALS = 4
# Positions, between -1 and 1, at which evolution searches for further branches.
_SEARCHED_POSITIONS = (-0.5, 0.0, 0.5)


class CurveTracer(Tracer):
    """Tracer of a front of two objectives.

    A position is the difference of both normalised objectives: -1 at one anchor and 1 at the other.
    """

    anchor_weights = np.array([[1.0, OTHERS_WEIGHT], [OTHERS_WEIGHT, 1.0]])
    matters = SOUGHT
    at_once, comparisons = 6, 12

    def __init__(self, archive: Archive, positions: int) -> None:
        """Spread this many positions evenly, the two anchors included."""
        super().__init__(archive)
        self._positions = np.linspace(-1.0, 1.0, positions)
        self.step = 2.0 / (positions - 1)
        self.spacing = self.step / 2.0

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Follow every branch from every optimum both ways, then what the archive shows, then into the gaps.

        Args:
            anchors: all local optima of either objective alone.
        """
        parameters = self.anchor_parameters()
        starts = [(self.recorded(point, p), 1 - k) for k, p in enumerate(parameters) for point in anchors[k]]
        for number, (candidate, objective) in enumerate(starts):
            self.progress(f"following branch {number + 1} of {len(starts)}", number / len(starts))
            self.follow(candidate, objective)
        for number, position in enumerate(_SEARCHED_POSITIONS if self.archive.vary else ()):
            self.progress("searching between the anchors", number / len(_SEARCHED_POSITIONS))
            self._search_at(position)
        self.follow_missed()
        self._fill_gaps()
        self.follow_missed(sample=False)

    def all_anchors(self, starts: Sequence[Sequence[Array]]) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem near its starts."""
        return [self.anchors(p, near) for p, near in zip(self.anchor_parameters(), starts, strict=True)]

    # --- following a branch ------------------------------------------------------------------------------

    def follow(self, candidate: FrontCandidate, objective: int) -> None:
        """Follow a branch towards less of an objective, one position after another, until it ends.

        The limit on the other objective loosens on the way, so that each optimum is a feasible start for the next.

        Args:
            candidate: on the branch.
            objective: number of the objective to reduce.
        """
        behind: list[Array] = []
        failed, first = 0, candidate
        candidate.followed.add(objective)
        ahead = self._positions[self._positions > self._position_of(candidate, objective) - _OFF_POSITION]
        for position in ahead:
            start = extrapolated([*behind, candidate.point.y])
            p = self._parameters_for(objective, float(position))
            # A failure at the candidate's own position is not recorded: that position has the candidate.
            moves = position - self._position_of(candidate, objective) > _OFF_POSITION
            optimum = self.solve(candidate, start, p, report=bool(moves))
            if optimum is None:
                failed, behind = failed + 1, []
                if failed == _GIVE_UP:
                    return
                continue
            failed, behind = 0, [*behind, candidate.point.y][-_REMEMBERED:]
            candidate = optimum
            if objective in candidate.followed and candidate is not first:
                return
            candidate.followed.add(objective)
            if np.max(np.abs(optimum.point.y - start)) < _SAME_BRANCH:
                # The way back from here is the way that led here.
                candidate.followed.add(1 - objective)
            if position - self._position_of(candidate, objective) > _OFF_POSITION:
                return

    def _search_at(self, position: float) -> None:
        """Search for further branches at a position, and follow those that are new both ways."""
        p = self._parameters_for(1, position)
        for y in self.archive.searched_at(p):
            before = len(self.candidates)
            self.follow_new(self.no_worse_than(y, p), before)

    def follow_everywhere(self, candidate: FrontCandidate) -> None:
        """Follow a branch both ways."""
        for objective in (1, 0):
            if objective not in candidate.followed:
                self.follow(candidate, objective)

    def cross_over(self) -> bool:
        """Start from points of the front with one variable taken from a neighbour on another branch.

        Where branches differ in one variable and the objectives ripple in another, the search may have seen the best
        ripple of a branch on the other branch only.

        Returns:
            Whether that gave a candidate better than all others.
        """
        improved, front = False, self.efficient()
        for candidate, neighbour in chain.from_iterable((pair, pair[::-1]) for pair in pairwise(front)):
            p = self.parameters_at(candidate.objectives)
            for j in np.flatnonzero(np.abs(neighbour.point.y - candidate.point.y) > _OTHER_BRANCH):
                start = candidate.point.y.copy()
                start[j] = neighbour.point.y[j]
                if start.tobytes() not in self.tried:
                    self.tried.add(start.tobytes())
                    before = len(self.candidates)
                    improved |= self.follow_new(self.solve(neighbour, start, p, report=False), before)
        return improved

    def parameters_at(self, objectives: Array) -> Array:
        """Return the parameters of the subproblem whose position is that of normalised objectives."""
        return self._parameters_for(1, float(objectives[0] - objectives[1]))

    def _parameters_for(self, objective: int, position: float) -> Array:
        """Return the parameters that minimise an objective with a limit on the other one's excess over it."""
        return self.front.limited(objective, np.full(2, position), relative=True)

    @staticmethod
    def _position_of(candidate: FrontCandidate, objective: int) -> float:
        """Return by how much the other objective of a candidate exceeds this one."""
        return float(candidate.objectives[1 - objective] - candidate.objectives[objective])

    # --- gaps --------------------------------------------------------------------------------------------

    def efficient(self) -> list[FrontCandidate]:
        """Return the candidates that no other dominates, from the best in the first objective to the worst."""
        sound = self.without_needles()
        return [sound[k] for k in undominated_in_order(self.objectives_of(sound))]

    def arrange(self, candidates: Sequence[FrontCandidate]) -> Arrangement:
        """Return candidates arranged as a front: its points in order, its parts, and the gaps between them."""
        objectives, step = self.objectives_of(candidates), self.step
        best = undominated_in_order(objectives)
        needed = best[without_needless(objectives[best], [candidates[k].between for k in best], step)]
        shown = needed[uncrowded_on_curve(objectives[needed], step)]
        breaks = gaps(objectives[shown], step)
        bounds = [0, *(k + 1 for k in breaks), len(shown)]
        return Arrangement(
            [candidates[k] for k in best],
            [candidates[k] for k in shown],
            tuple(tuple(range(i, j)) for i, j in pairwise(bounds)),
            tuple((k, k + 1) for k in breaks),
        )

    def _fill_gaps(self) -> None:
        """Follow the branches on either side of every gap into it, as far as the other side does not dominate them."""
        tried: set[bytes] = set()
        for number in range(_GAP_ROUNDS):
            front = self.efficient()
            objectives = self.objectives_of(front)
            sides = {np.round(objectives[k : k + 2], _GAP_DECIMALS).tobytes(): k for k in gaps(objectives, self.step)}
            fresh = [(front[k], front[k + 1]) for key, k in sides.items() if key not in tried]
            tried.update(sides)
            self.progress("following the front into gaps", number / _GAP_ROUNDS)
            for left, right in fresh:
                for candidate, objective in ((left, 1), (right, 0)):
                    if objective not in candidate.followed:
                        self.follow(candidate, objective)
                if self.archive.vary:
                    self._search_at(float(np.mean([self._position_of(side, 1) for side in (left, right)])))
                end = self._end(left, 1, float(right.objectives[0]) - _CLEARANCE)
                self._end(right, 0, float((end or left).objectives[1]) - _CLEARANCE)
            if not fresh:
                return

    def _end(self, candidate: FrontCandidate, objective: int, limit: float) -> FrontCandidate | None:
        """Return the design of a branch with the least of an objective while the other one is limited."""
        p = self.front.limited(objective, np.full(2, limit))
        return self.solve(candidate, candidate.point.y, p, report=False)

    # --- finishing ---------------------------------------------------------------------------------------

    def find_inner_neighbours(self) -> None:
        """Give the ends of the front a neighbour on it, for their rates: multipliers at an end are not unique."""
        front = self.efficient()
        for number, candidate in enumerate(front):
            if self.front.position_decides(candidate.point):
                continue
            objective = 0 if number == len(front) - 1 else 1
            p = self._parameters_for(objective, self._position_of(candidate, objective) + _INWARD * self.step)
            point = self.front.solve(candidate.point, candidate.point.y, p, exact=candidate.exact)
            moved = np.sum(np.abs(self.front.objectives(point.y, exact=candidate.exact) - candidate.objectives))
            if point.solved and moved < self.step and self.front.position_decides(point):
                candidate.inner_neighbour = (point, p)


# --- three objectives ---

Node = tuple[int, int, int]
"""A node of a lattice on the plane of utopia, in steps; its three numbers have the same sum at every node."""


@dataclass(frozen=True)
class Lattice:
    """Nodes on the plane of utopia.

    Attributes:
        steps: number of steps along a side of the triangle between the three objectives' own optima.
    """

    steps: int

    def triangle(self) -> set[Node]:
        """Return the nodes in the triangle."""
        return {(i, j, self.steps - i - j) for i in range(self.steps + 1) for j in range(self.steps + 1 - i)}

    def locations(self, objectives: Array) -> Array:
        """Return the locations of normalised objectives on the plane, in steps, a row each."""
        return np.asarray((locations(objectives) + 1.0 / 3.0) * self.steps)

    def nearest(self, objectives: Array) -> NDArray[np.intp]:
        """Return the node nearest to each row of normalised objectives."""
        places = self.locations(objectives)
        nodes = np.round(places).astype(int)
        # Rounding may miss the common sum by one. The entry that was rounded most makes up for it.
        rows = np.arange(len(nodes))
        nodes[rows, np.argmax(np.abs(places - nodes), axis=1)] += self.steps - nodes.sum(axis=1)
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


# Weight of the other objectives at the edges of the front, where limits on them leave the minimised one open. A tail of
# the front that gains less than this part of what it gives away is left out.
_EDGE_WEIGHT = 0.01
# Weights of an anchor: of the objective it is best in, of another, and of the last. Each order of the three is an
# anchor, because the optima of one objective alone may leave the others open, and do not bound the front then. The two
# orders that begin with the same objective stand together.
_ANCHOR_WEIGHTS = np.array(list(permutations((1.0, 1e-3, 1e-6))))[[0, 1, 2, 4, 3, 5]]
# Normalised distance from the best within which designs compete for the start of an anchor of two objectives.
_NEARLY_BEST = 0.02
# Distance that the lattice extends beyond the triangle of utopia, in sides of the triangle.
_EXTENSION = 1.0
# An optimum closer to its node than this many steps is at the node.
_AT_NODE = 1e-3
# An optimum closer to its node than this many steps leads to the neighbours of that node.
_NEAR_NODE = 1.0
# Least distance, in steps, of a shown point that is not at a node from other points. A front that covers few nodes has
# its points closer together, down to a tenth of a step, so that as many are shown as were asked for.
_ROOMS = tuple(0.7 * 0.95**k for k in range(39))
# Largest distance, in steps and in any objective, of an efficient design from the nearest shown point. In a flat
# triangle of the lattice no place is farther than two thirds of a step from a corner.
_COVERED = 0.67


class SurfaceTracer(Tracer):
    """Tracer of a front of three objectives.

    Attributes:
        matters: as of `Tracer`; larger than for a curve, because flat triangles between points of a curved surface lie
            beside it.
    """

    anchor_weights = _ANCHOR_WEIGHTS
    matters = 5e-3
    at_once, comparisons = 20, 4

    def __init__(self, archive: Archive, count: int) -> None:
        """Lay a lattice over the triangle between the anchors, with at least `count` nodes in the triangle."""
        super().__init__(archive)
        self._count = count
        # The coarsest one with that many.
        self._lattice = Lattice(next(n for n in range(2, count + 2) if (n + 1) * (n + 2) // 2 >= count))
        self.step = 1.0 / self._lattice.steps
        self.spacing = _COVERED * self.step
        # Nodes to solve in any case. Those beyond are solved only where a flood reaches them.
        self._wanted = self._lattice.triangle()
        self._found_at: dict[Node, list[FrontCandidate]] = {}

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Find the designs at all nodes that the front reaches, and what lies between and beyond them.

        Args:
            anchors: local optima of each anchor's subproblem, in the order of `anchor_parameters`.
        """
        parameters = self.anchor_parameters()
        ends = [self.recorded(point, p) for p, points in zip(parameters, anchors, strict=True) for point in points]
        if self._samples_around:
            self.sample_around_best()
            self._solve_from_archive()
        else:
            self._flood_from_middle(ends)
            for number, end in enumerate(ends):
                self.progress(f"following branch {number + 1} of {len(ends)}", number / len(ends))
                self._flood(end, self._lattice.nearest_node(end.objectives))
        self._fill_gaps()
        self.follow_missed()

    # --- anchors -----------------------------------------------------------------------------------------

    def all_anchors(self, starts: Sequence[Sequence[Array]]) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem.

        Args:
            starts: scaled designs for each objective alone.
        """
        parameters, anchors = self.anchor_parameters(), list[list[Point]]()
        for number, near in enumerate(starts):
            # Two anchors begin with this objective. The optima of the first are starts for the second.
            first, second = 2 * number, 2 * number + 1
            optima = self.anchors(parameters[first], near)
            if not optima:
                return [*anchors, [], []]
            p = parameters[second]
            designs = [*self._start_between(_ANCHOR_WEIGHTS[second]), *near]
            points = [self.front.solve(optima[0], y, p) for y in designs]
            points += [self.front.solve(optimum, optimum.y, p) for optimum in optima]
            points = [minimum_from(self.front.program, p, point) for point in points if point.solved]
            anchors += [optima, sorted(points, key=lambda point: point.f)]
        return anchors

    def _start_between(self, weights: Array) -> list[Array]:
        """Return the archive's best design in the second objective of those nearly best in the first, if there is any.

        Args:
            weights: of an anchor, whose largest is that of the first objective.
        """
        first, second, _ = np.argsort(-weights)
        designs, objectives = self.archive.feasible
        best = objectives[:, first].min(initial=np.inf)
        near = np.flatnonzero(objectives[:, first] <= best + _NEARLY_BEST)
        return [designs[near[np.argmin(objectives[near, second])]]] if len(near) else []

    # --- positions ---------------------------------------------------------------------------------------

    def parameters_at(self, objectives: Array) -> Array:
        """Return the parameters of the subproblem whose position is that of normalised objectives.

        The smallest objective is minimised, with limits on the excess of the other two over it.
        """
        smallest = int(np.argmin(objectives))
        return self.front.limited(smallest, objectives - objectives[smallest], relative=True)

    def _parameters_at_node(self, node: Node) -> Array:
        return self.parameters_at(np.array(node) * self.step)

    def _distance(self, candidate: FrontCandidate, node: Node) -> float:
        """Return the distance of a candidate from a node, in steps."""
        return float(self._lattice.distance(candidate.objectives[None], node)[0])

    def _is_at(self, candidate: FrontCandidate, node: Node) -> bool:
        """Return whether an optimum lies at a node and no objective is held back there."""
        return self.balances(candidate) and self._distance(candidate, node) < _AT_NODE

    def candidate_of(self, p: Array, point: Point) -> FrontCandidate:
        """Return the candidate to record for an optimum at a position.

        On the edge of the front the position constraints are not all active. The objective minimised there may leave
        the others open, so the optimum is solved again with a small weight on these.

        Args:
            p: parameters of the position.
            point: its optimum.
        """
        if not self.front.position_decides(point):
            weights, _, _ = self.front.subproblem(p)
            minimised = int(np.argmax(weights[1:]))
            at_edge = self.front.limited(minimised, self.front.objectives(point.y), _EDGE_WEIGHT)
            on_edge = self.front.solve(point, point.y, at_edge)
            if on_edge.solved:
                p, point = at_edge, on_edge
        return self.recorded(point, p)

    # --- solving at nodes --------------------------------------------------------------------------------

    def _record_at(self, node: Node, candidate: FrontCandidate | None) -> bool:
        """Record a candidate as found at a node; return whether it is new there."""
        recorded = self._found_at.setdefault(node, [])
        if candidate is None or candidate in recorded:
            return False
        recorded.append(candidate)
        return True

    def _solve_from_archive(self) -> None:
        """Solve each node from the nearest design of the archive that no other clearly dominates.

        Nodes without such a design are given up: the front does not reach them.
        """
        designs, objectives = self.archive.feasible
        nodes = self._lattice.nearest(objectives)

        # Comparing every design with every other would take too long. The one with the least sum at each node will do.
        by_sum = np.argsort(objectives.sum(axis=1), kind="stable")
        _, first = np.unique(nodes[by_sum], axis=0, return_index=True)
        lowest = objectives[by_sum[first]]
        best = np.flatnonzero(lead_over_points(lowest, objectives) > -MATTERS)

        # Take the best design nearest to each node, unless it is a needle.
        by_distance = np.argsort(self._lattice.distance(objectives[best], nodes[best]), kind="stable")
        best = best[by_distance]
        _, first = np.unique(nodes[best], axis=0, return_index=True)
        nearest = best[first]
        nearest = nearest[~self.archive.needles(designs[nearest], objectives[nearest])]

        starts = [((i, j, k), y) for (i, j, k), y in zip(nodes[nearest].tolist(), designs[nearest], strict=True)]
        self._wanted &= {node for node, _ in starts}
        for number, (node, start) in enumerate(starts):
            self.progress("solving from the best designs seen", number / len(starts))
            self._record_at(node, self.no_worse_than(start, self._parameters_at_node(node)))

    def _flood_from_middle(self, ends: Sequence[FrontCandidate]) -> None:
        """Follow the front from the middle of the triangle, since slopes that lead inwards may vanish at its ends."""
        middle = self._lattice.nearest_node(np.full(3, 1.0 / 3.0))
        p = self._parameters_at_node(middle)
        self.progress("solving in the middle", 0.0)
        starts = [self.front.program.start(), np.mean([end.point.y for end in ends], axis=0)]
        for start in starts:
            candidate = self.solve(ends[0], start, p, report=False)
            if candidate is not None and self._is_at(candidate, middle):
                self._flood(candidate, middle)
                return

    def _flood(self, candidate: FrontCandidate, node: Node, *, report: bool = True) -> None:
        """Follow a branch from a node to its neighbours, from those to theirs, and so on until it ends everywhere.

        Args:
            candidate: on the branch.
            node: where to begin.
            report: whether to record failures. If not, the flood also stops at dominated candidates; else it passes
                them, because the branch may become efficient again.
        """
        solved: dict[Node, FrontCandidate] = {}
        waiting = deque([(candidate, candidate.point.y, node)])
        queued = {node}
        while waiting:
            neighbour, start, node = waiting.popleft()
            reached = self.solve(neighbour, start, self._parameters_at_node(node), report=report)
            if reached is None or not self._record_at(node, reached):
                continue
            solved[node] = reached
            if not report and self.is_beaten(reached):
                continue
            at_node = self._is_at(reached, node)
            if not (at_node or (node in self._wanted and self._distance(reached, node) < _NEAR_NODE)):
                continue
            for following in neighbours(node):
                extends = at_node and not self._samples_around and min(following) >= -_EXTENSION * self._lattice.steps
                if following not in queued and (following in self._wanted or extends):
                    queued.add(following)
                    # The node opposite to the following one, if it is solved, shows in which direction designs change.
                    i, j, k = (2 * here - there for here, there in zip(node, following, strict=True))
                    behind = [solved[i, j, k].point.y] if (i, j, k) in solved else []
                    waiting.append((reached, extrapolated([*behind, reached.point.y]), following))

    def follow_everywhere(self, candidate: FrontCandidate) -> None:
        """Follow a branch from the node nearest to a candidate, unless the archive is rich enough to show all of it."""
        if not self._samples_around:
            self._flood(candidate, self._lattice.nearest_node(candidate.objectives), report=False)

    def _fill_gaps(self) -> None:
        """Follow the front to nodes that have no efficient design, from every neighbour that has one."""
        best = set(self.efficient())
        found = ((node, candidate) for node, candidates in self._found_at.items() for candidate in candidates)
        front = [(node, candidate) for node, candidate in found if candidate in best and self._is_at(candidate, node)]
        for number, (node, candidate) in enumerate(front):
            self.progress("following the front into gaps", number / len(front))
            for other in neighbours(node):
                there = self._found_at.get(other, ())
                if other in self._wanted and not any(self._is_at(one, other) for one in there):
                    self._flood(candidate, other, report=False)

    # --- what makes up the front -------------------------------------------------------------------------

    def uncovered(self, front: Array, objectives: Array) -> Array:
        """Return how far designs lie from every point of the front where it has too few points, else 0.

        Those are designs far from every point and at a location on the plane where there is none. A surface that is a
        narrow band leaves such places because it passes few nodes of the lattice, or none.
        """
        from scipy.spatial import KDTree  # slow to import

        if not len(front):
            return np.full(len(objectives), np.inf)
        nearest, _ = KDTree(front).query(objectives, p=np.inf)
        far = nearest > _COVERED * self.step
        far[far] = KDTree(locations(front)).query(locations(objectives[far]), p=np.inf)[0] > self.step / 2.0
        return np.where(far, nearest, 0.0)

    def efficient(self) -> list[FrontCandidate]:
        """Return the candidates that no other dominates."""
        balanced = [candidate for candidate in self.without_needles() if self.balances(candidate)]
        return [balanced[k] for k in sorted(undominated(self.objectives_of(balanced)))]

    def arrange(self, candidates: Sequence[FrontCandidate]) -> Arrangement:
        """Return candidates arranged as a front, from the best in the first objective to the worst.

        Shown are the ends of holes, anchors, points at nodes, and as many others as fit between or are needed so that
        no efficient candidate is far from a shown one, and that the wanted number of points is shown.
        """
        objectives, step = self.objectives_of(candidates), self.step
        balanced = np.flatnonzero([self.balances(candidate) for candidate in candidates])
        order = np.sort(balanced[undominated(objectives[balanced])])
        if not len(order):
            return Arrangement([], [], (), ())
        places = objectives[order]
        parts, hole_ends = parts_of(places, step)
        for room in _ROOMS:
            shown = covering(places, self._uncrowded(places, hole_ends, room * step), _COVERED * step)
            if len(shown) >= self._count:
                break
        shown = shown[np.lexsort(places[shown].T[::-1])]
        number = {int(row): k for k, row in enumerate(shown)}
        return Arrangement(
            [candidates[k] for k in order],
            [candidates[k] for k in order[shown]],
            tuple(tuple(sorted(number[row] for row in part if row in number)) for part in parts),
            tuple((number[a], number[b]) for a, b in hole_ends),
        )

    def _uncrowded(self, objectives: Array, hole_ends: Sequence[tuple[int, int]], room: float) -> NDArray[np.intp]:
        """Return the rows of efficient points that have room: first ends and anchors, then nodes, then the others."""
        places = locations(objectives)
        stays = self._lattice.distance(objectives, self._lattice.nearest(objectives)) <= _AT_NODE
        # An anchor close to another anchor need not stay.
        anchors = apart(places, np.argmin(objectives @ _ANCHOR_WEIGHTS.T, axis=0), room)
        stays[[*anchors, *chain(*hole_ends)]] = True
        stay = np.flatnonzero(stays)
        far = [
            k
            for k in np.flatnonzero(~stays).tolist()
            if np.all(np.max(np.abs(places[stay] - places[k]), axis=1) >= room)
        ]
        return np.sort(np.array([*stay, *apart(places, far, room)], dtype=np.intp))

    def find_inner_neighbours(self) -> None:
        """Keep the points on edges as they are; their multipliers already give the rates."""
