"""Tracing of a front: followed from the optima of each objective, then from the designs that it misses.

All objectives are normalised and minimised. A front is projected along (1, 1) or (1, 1, 1): the objectives minus their
mean are the location of a design on the line or plane of utopia (Messac and Mattson 2004). Positions are the nodes of a
lattice there, between the anchors, which are the optima of one objective each. A curve is followed along its line, a
surface from each node to its neighbours, from those to theirs, as a flood spreads.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, permutations

import numpy as np

from plough_opt.core.plain_data import Array
from plough_opt.design.confirmation import minimum_from
from plough_opt.design.model.ipopt import Point
from plough_opt.design.model.optimality import Zero
from plough_opt.design.search.landscape import apart
from plough_opt.design.search.polish import point_as_found, polished
from plough_opt.studies.tradeoff.archive import MATTERS, Archive
from plough_opt.studies.tradeoff.front import GAP, MissingPoint, leads, locations, parts_of, undominated

Node = tuple[int, ...]
"""A node of the lattice, in steps; its numbers have the same sum at every node."""

_REMEDIES = {
    "Infeasible_Problem_Detected": "no design near the start meets the requirements",
    "Maximum_Iterations_Exceeded": "the optimiser reached its limit of iterations",
    "Invalid_Number_Detected": "the model gave no finite number somewhere between the bounds: tighten the bounds",
    "Search_Direction_Becomes_Too_Small": "the objective is not smooth enough here: use more integration steps",
}

# Weights of an anchor, by number of objectives: of the one it is best in, of another, and of the last. The small ones
# decide what the first leaves open. Each order is an anchor, because only together they bound a surface.
_WEIGHTS = {2: (1.0, 1e-4), 3: (1.0, 1e-3, 1e-6)}
# Limits of the ratio of two objectives' ranges that these weights follow.
_RATIOS = 1e-3, 1e3
# Weight of the other objectives at the edges of a surface, where limits on them leave the minimised one open. A tail of
# the front that gains less than this part of what it gives away is left out.
_EDGE_WEIGHT = 0.01
# Normalised distance from the best within which designs compete for the start of another anchor.
_NEARLY_BEST = 0.02
# Relative excess of an optimum's scaled objective over its start's that the rough integration of a search explains.
_NOT_WORSE = 1e-5
# Two optima closer than this, in normalised objectives and in scaled variables, are the same.
_SAME_OBJECTIVES, _SAME_DESIGN = 1e-6, 1e-4
# Largest change of normalised objectives when an optimum is solved exactly; a larger one leads to another optimum.
_ANOTHER_OPTIMUM = 0.05
# An optimum closer to its node than this many steps is at the node.
_AT_NODE = 1e-3
# Normalised lead of a design above which it is sought. It is half of what matters, because runs and ranges that judge
# the front differ a little from those that trace it.
_SOUGHT = 5e-4
# Missed designs that are followed before the archive is compared with the front again, and most such comparisons.
_AT_ONCE, _COMPARISONS = {2: 8, 3: 20}, {2: 12, 3: 4}
# Rounds of sampling around the best designs, as long as each shows that the front missed something.
_ROUNDS = 2
# Steps from an end of a curve to where its multipliers are unique.
_INWARD = 0.01
# Rounds of locating the ends of holes. Margin beside a point of the next part, so that this does not dominate the end.
_END_ROUNDS, _CLEARANCE = 4, 1e-6
# Distances between shown points, in steps: above the first no other point comes between them if enough are shown, above
# the second if not.
_COVERED, _CROWDED = 0.67, 0.1
# A curve shows a bend that the line between neighbours cuts off by more than this many squares of a step; a front that
# is bent evenly stays below a quarter.
_BEND = 2.0


@dataclass(eq=False)
class Candidate:
    """A local optimum on some branch; equal to itself alone.

    Attributes:
        point: as the optimiser left it.
        p: parameters of the subproblem that it solves.
        objectives: normalised.
        exact: whether it was solved with exact slopes.
    """

    point: Point
    p: Array
    objectives: Array
    exact: bool = False


@dataclass(frozen=True)
class Arrangement:
    """Candidates arranged as a front.

    Attributes:
        efficient: candidates that no other dominates, from the best in the first objective on.
        shown: as many of them as show the front evenly.
        parts: for each connected part the numbers of its shown candidates.
        holes: numbers of the two shown candidates on either side of each hole.
    """

    efficient: list[Candidate]
    shown: list[Candidate]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


class Tracer:
    """All candidates, ways to find one near another, and the search for those that are missing.

    Attributes:
        archive: of the designs that the searches tried.
        candidates: all local optima.
        failures: positions without one.
    """

    def __init__(self, archive: Archive, count: int) -> None:
        """Lay a lattice with at least ``count`` nodes between the anchors."""
        self.archive, self.front, self.progress = archive, archive.front, archive.progress
        self.candidates: list[Candidate] = []
        self.failures: list[MissingPoint] = []
        n = self.front.count
        self._count = count
        self._steps = count - 1 if n == 2 else next(k for k in range(2, count) if (k + 1) * (k + 2) // 2 >= count)
        self.step = 1.0 / self._steps
        self._orders = [*permutations(range(n))]
        # Of the anchors, a row each.
        self._weights = np.array([[_WEIGHTS[n][order.index(k)] for k in range(n)] for order in self._orders])
        self._ranges = np.ones(n)
        self._passed: dict[Node, list[Candidate]] = {}
        self._tried: set[bytes] = set()

    # --- anchors -----------------------------------------------------------------------------------------

    def anchor_parameters(self) -> list[Array]:
        """Return the parameters of the subproblem of each anchor, in the order of the objective that it is best in.

        Each weight but the largest is multiplied by the ratio of the first objective's range to its own, so that a
        small weight stays small compared with an objective that hardly changes.
        """
        ratios = np.array([self._ranges[order[0]] / self._ranges for order in self._orders])
        return [*map(self.front.weighted, self._weights * np.clip(ratios, *_RATIOS))]

    def anchors(self) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem, best first, after a search for each objective alone.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no design has a value.
        """
        archive, front, n = self.archive, self.front, self.front.count
        starts = [archive.lowest(p) for p in self.anchor_parameters()[:: len(self._orders) // n]]
        if n > 2 and not archive.vary and archive.vectorised:
            archive.sample_evenly()  # designs nearly best in one objective and good in another are starts of anchors
        ends = archive.evaluate(np.array([points[0] for points in starts]))[0]
        between, sizes = np.ptp(ends, axis=0), np.maximum(np.abs(ends).max(axis=0), 1.0)
        # Of three objectives, one may be as good in all starts, and yet differ between the anchors.
        least = _SAME_OBJECTIVES * sizes
        self._ranges = np.where(between > least, between, least if n == 2 else sizes)
        front.normalise(ends.min(axis=0), self._ranges)
        front.build([*np.vstack(starts), *archive.thinned()])
        optima: list[list[Point]] = []
        for order, p in zip(self._orders, self.anchor_parameters(), strict=True):
            # The optimum of the anchor before it with the same first objective.
            before = [points[0].y for k, points in enumerate(optima) if points and self._orders[k][0] == order[0]]
            points = [self._polished(p, y) for y in (*self._between(order), *starts[order[0]], *before)]
            points = [minimum_from(front.program, p, point) for point in points if point.solved]
            optima.append(sorted((point for point in points if point.solved), key=lambda point: point.f))
        return optima

    def _between(self, order: Sequence[int]) -> list[Array]:
        """Return the archive's best design in a second objective of those nearly best in a first, if there is any."""
        designs, objectives = self.archive.best()
        first, second = objectives[:, order[0]], objectives[:, order[1]]
        near = np.flatnonzero(first <= first.min(initial=np.inf) + _NEARLY_BEST)
        return [designs[near[np.argmin(second[near])]]] if len(near) and len(order) > 2 else []

    def _polished(self, p: Array, y: Array) -> Point:
        """Return the local optimum near a design of a search, never a worse one."""
        start = point_as_found(self.front.program, p, y)
        point = self.front.solve(start, y, p)
        return point if _no_worse(point, start) else polished(self.front.program, p, y)

    # --- candidates --------------------------------------------------------------------------------------

    def candidate_of(self, point: Point, p: Array) -> Candidate:
        """Return the candidate of an optimum: a new one, or the earlier one if the same design was found before.

        On the edge of a surface the position constraints are not all active. The objective minimised there may leave
        the others open, so the optimum is solved again with a small weight on these.
        """
        front = self.front
        if front.count > 2 and not front.position_decides(point) and np.any(front.subproblem(p)[1]):
            minimised = int(np.argmax(front.subproblem(p)[0][1:]))
            at_edge = front.limited(minimised, front.objectives(point.y), _EDGE_WEIGHT)
            on_edge = front.solve(point, point.y, at_edge)
            if on_edge.solved:
                p, point = at_edge, on_edge
        objectives = front.objectives(point.y)
        recorded = self.objectives_of(self.candidates)
        for k in np.flatnonzero(np.max(np.abs(recorded - objectives), axis=1) < _SAME_OBJECTIVES):
            if np.max(np.abs(self.candidates[k].point.y - point.y)) < _SAME_DESIGN:
                return self.candidates[k]
        self.candidates.append(Candidate(point, p, objectives))
        return self.candidates[-1]

    def solve_exactly(self, candidates: Sequence[Candidate], *, again: bool = False) -> None:
        """Solve candidates with exact slopes.

        Args:
            candidates: the candidates, of which those solved exactly before are skipped.
            again: solve only those solved exactly before, because the program now takes more integration steps.
        """
        chosen = [candidate for candidate in candidates if candidate.exact == again]
        for number, candidate in enumerate(chosen):
            self.progress("solving to the last digits", number / len(chosen))
            point = self.front.solve(candidate.point, candidate.point.y, candidate.p, exact=True)
            objectives = self.front.objectives(point.y, exact=True)
            # Slopes by differences may stop in a flat valley that has no optimum; exact ones then lead far away.
            near = np.max(np.abs(objectives - candidate.objectives)) < _ANOTHER_OPTIMUM
            if point.solved and near and np.all(objectives <= candidate.objectives + MATTERS):
                candidate.point, candidate.exact, candidate.objectives = point, True, objectives

    def objectives_of(self, candidates: Sequence[Candidate]) -> Array:
        """Return the normalised objectives of candidates, a row each."""
        return np.array([candidate.objectives for candidate in candidates]).reshape(-1, self.front.count)

    def efficient(self, candidates: Sequence[Candidate] | None = None) -> list[Candidate]:
        """Return the candidates, by default all, that no other dominates, from the best in the first objective on.

        A position on a surface can hold an optimum where it would rather have more of an objective. Such an optimum is
        not on the front.
        """
        sound = self.candidates if candidates is None else candidates
        if self.front.count > 2:
            sound = [candidate for candidate in sound if self._balances(candidate)]
        objectives = self.objectives_of(sound)
        best = undominated(objectives)
        return [sound[k] for k in best[np.lexsort(objectives[best].T[::-1])]]

    def _balances(self, candidate: Candidate) -> bool:
        """Return whether no objective has a negative weight at a candidate."""
        return bool(np.all(self.front.weights_at(candidate.point, candidate.p) > -Zero.multiplier))

    def is_beaten(self, candidate: Candidate) -> bool:
        """Return whether some other candidate is better in one objective and, within what matters, no worse in any."""
        others = self.objectives_of([other for other in self.candidates if other is not candidate])
        no_worse = np.all(others <= candidate.objectives + MATTERS, axis=1)
        return bool(np.any(no_worse & np.any(others < candidate.objectives - MATTERS, axis=1)))

    # --- following ---------------------------------------------------------------------------------------

    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Find the whole front from the local optima of each anchor's subproblem."""
        ends = [self.candidate_of(point, p)
                for p, points in zip(self.anchor_parameters(), anchors, strict=True) for point in points]  # fmt: skip
        if self._sampled:
            self.archive.sample_around_best(np.array([end.point.y for end in ends]))
            self._solve_at_nodes()
        else:
            for number, end in enumerate(ends):
                self.progress(f"following branch {number + 1} of {len(ends)}", number / len(ends))
                self._follow(end)
        if self.front.count == 2:
            for k in (1, 2, 3):
                self.progress("searching between the anchors", k / 4)
                middle = np.array([k / 4, 1.0 - k / 4])
                self._follow_beside(self.archive.searched_at(self._parameters_at(middle)))
        elif not self._sampled:
            # Slopes that lead inwards may vanish at the ends.
            middle = np.mean([end.point.y for end in ends], axis=0)
            self._follow(ends[0], self._nearest(np.zeros((1, 3)))[0], middle)
        for _ in range(_ROUNDS if self.archive.rich else 1):
            if self.archive.rich:
                self.archive.sample_around_best(np.array([own.point.y for own in self.efficient()]))
            if not self._follow_missed():
                break
        if self.front.count == 2:
            self._locate_ends()
            self._follow_missed()

    @property
    def _sampled(self) -> bool:
        """Whether the archive shows all of a surface: its nodes are solved from there, and not one from another."""
        return self.front.count > 2 and self.archive.rich

    def _solve_at_nodes(self) -> None:
        """Solve each node of a surface from the archive's best design nearest to it."""
        designs, objectives = self.archive.best()
        nodes, nearest = self._nearest(objectives), dict[Node, int]()
        off = np.abs(self._places(objectives) - np.array(nodes)).max(axis=1)
        for k in np.argsort(off, kind="stable").tolist():
            nearest.setdefault(nodes[k], k)
        for number, k in enumerate(nearest.values()):
            self.progress("solving from the best designs seen", number / len(nearest))
            self._beside(designs[k])

    def _nearest(self, objectives: Array) -> list[Node]:
        """Return the node nearest to each row of normalised objectives."""
        places = self._places(objectives)
        nodes = np.round(places).astype(int)
        # Rounding may miss the common sum by one. The entry that was rounded most makes up for it.
        nodes[range(len(nodes)), np.argmax(np.abs(places - nodes), axis=1)] += self._steps - nodes.sum(axis=1)
        return [tuple(node) for node in nodes.tolist()]

    def _places(self, objectives: Array) -> Array:
        """Return the locations of normalised objectives, a row each, in steps like nodes."""
        return np.asarray((locations(objectives) + 1.0 / self.front.count) * self._steps)

    def _off(self, candidate: Candidate, node: Node) -> float:
        """Return the distance of a candidate from a node, in steps."""
        return float(np.max(np.abs(self._places(candidate.objectives[None])[0] - node)))

    def _parameters_at(self, position: Array, falling: int | None = None) -> Array:
        """Return the parameters of the subproblem at the position of normalised objectives.

        One objective is minimised, by default the smallest, with limits on the excess of the others over it.
        """
        minimised = int(np.argmin(position)) if falling is None else falling
        return self.front.limited(minimised, position - position[minimised], relative=True)

    def _follow(self, candidate: Candidate, node: Node | None = None, start: Array | None = None) -> None:
        """Follow a branch from a node, by default the nearest, to its neighbours until it ends everywhere.

        On a curve the objective that falls on the way is minimised: the limit on the other one loosens, and each
        optimum is a feasible start for the next. Dominated candidates are passed, because the branch may become
        efficient again. A surface is only followed to nodes without an efficient design.
        """
        curve = self.front.count == 2
        node = self._nearest(candidate.objectives[None])[0] if node is None else node
        taken = set() if curve else self._taken()
        solved: dict[Node, Candidate] = {}
        waiting: deque[tuple[Candidate, Array, Node, int | None]] = deque()
        waiting.append((candidate, candidate.point.y if start is None else start, node, None))
        queued = {node}
        while waiting:
            before, y, node, falling = waiting.popleft()
            if falling is None and self._off(before, node) <= _AT_NODE:
                reached: Candidate | None = before
            else:
                p = self._parameters_at(np.array(node) * self.step, falling)
                reached = self._solve(before, y, p, report=falling is not None)
            if reached is None or (reached is not before and reached in self._passed.setdefault(node, [])):
                continue
            self._passed.setdefault(node, []).append(reached)
            solved[node] = reached
            if self._off(reached, node) > (_AT_NODE if curve else 1.0) or (not curve and self.is_beaten(reached)):
                continue
            for way in sorted({*permutations((1, -1, *(0 for _ in range(self.front.count - 2))))}):
                following = tuple(a + b for a, b in zip(node, way, strict=True))
                if following in queued or following in taken or self._outside(following):
                    continue
                queued.add(following)
                behind = solved.get(tuple(a - b for a, b in zip(node, way, strict=True)))
                y = reached.point.y if behind is None else np.clip(2.0 * reached.point.y - behind.point.y, 0.0, 1.0)
                waiting.append((reached, y, following, way.index(-1) if curve else None))

    def _outside(self, node: Node) -> bool:
        """Return whether a node lies beyond the ends of a curve, or farther than a side beyond a surface's anchors."""
        return min(node) < (0 if self.front.count == 2 else -self._steps)

    def _taken(self) -> set[Node]:
        """Return the nodes that have an efficient candidate."""
        objectives = self.objectives_of(self.efficient())
        nodes = self._nearest(objectives)
        off = np.abs(self._places(objectives) - np.array(nodes).reshape(objectives.shape)).max(axis=1, initial=0.0)
        return {node for node, far in zip(nodes, off.tolist(), strict=True) if far <= _AT_NODE}

    def _solve(self, near: Candidate, start: Array, p: Array, *, report: bool = False) -> Candidate | None:
        """Return the optimum of a subproblem near a start, or None if there is none.

        Args:
            near: candidate with whose multipliers to begin.
            start: scaled variables.
            p: parameters of the subproblem.
            report: whether a failure is recorded.
        """
        point = self.front.solve(near.point, start, p)
        if point.solved:
            return self.candidate_of(point, p)
        reason = _REMEDIES.get(point.status, "the optimiser stopped without an optimum")
        failure = MissingPoint(tuple(near.objectives.tolist()), f"{point.status}: {reason}")
        if report and failure not in self.failures:
            self.failures.append(failure)
        return None

    # --- what the front misses ---------------------------------------------------------------------------

    def _follow_missed(self) -> bool:
        """Follow the designs of the archive that the front misses; return whether that improved it."""
        improved = False
        for number in range(_COMPARISONS[self.front.count]):
            missed = self._missed()
            for k, y in enumerate(missed):
                self.progress("following designs that the front misses", (number + k / len(missed)) / 12)
                self._tried.add(y.tobytes())
                improved |= self._follow_beside([y])
            if not missed:
                break
        return improved

    def _follow_beside(self, designs: Sequence[Array]) -> bool:
        """Follow the new optima near some designs; return whether one of them improved the front."""
        improved = False
        for y in designs:
            before = len(self.candidates)
            candidate = self._beside(y)
            if candidate is not None and len(self.candidates) > before:
                improved |= not self.is_beaten(candidate)
                if not self._sampled:
                    self._follow(candidate)
        return improved

    def _missed(self) -> list[Array]:
        """Return designs of the archive that would improve the front most, half a step apart.

        Such a design dominates a point, or leads all points and, on a curve, the lines between neighbours. A surface
        misses what is farther than a step from all its points. Nothing is missed if only the guess's basin is searched.
        """
        if not self.archive.vary:
            return []
        (designs, objectives), front = self.archive.best(), self.objectives_of(self.efficient())
        lead = leads(front, objectives)
        leading = lead > _SOUGHT
        designs, objectives, lead = designs[leading], objectives[leading], lead[leading]
        beats = np.max([(point - objectives).min(axis=1) for point in front], axis=0, initial=-np.inf)
        if self.front.count == 2:
            gain = np.minimum(lead, self._below_curve(front, objectives))
        else:
            far = np.min([np.abs(point - objectives).max(axis=1) for point in front], axis=0, initial=np.inf)
            gain = np.where(far > self.step, far, 0.0)
        gain = np.maximum(gain, np.where(beats > _SOUGHT, 2.0 * _SOUGHT, 0.0))
        left = np.flatnonzero(gain > _SOUGHT)
        best = left[undominated(objectives[left], _SOUGHT)]
        best = best[[designs[k].tobytes() not in self._tried for k in best]] if len(best) else best
        best = best[np.argsort(-gain[best], kind="stable")]
        return [designs[k] for k in apart(objectives, best, self.step / 2.0, _AT_ONCE[self.front.count])]

    def _below_curve(self, front: Array, designs: Array) -> Array:
        """Return how far designs lie below the lines between neighbours; infinite in gaps and beyond the ends."""
        if len(front) < 2:
            return np.full(len(designs), np.inf)
        along, height, location = front[:, 0] - front[:, 1], front.mean(axis=1), designs[:, 0] - designs[:, 1]
        after = np.clip(np.searchsorted(along, location), 1, len(front) - 1)
        joined = np.diff(along) <= 2.0 * GAP[2] * self.step
        inside = (location >= along[0]) & (location <= along[-1]) & joined[after - 1]
        return np.where(inside, np.interp(location, along, height) - designs.mean(axis=1), np.inf)

    def _beside(self, y: Array) -> Candidate | None:
        """Return an optimum near a design of the archive, or None if there is none as good.

        It is sought at the nearest node of a surface that has no design, at the position of the design itself, and
        then with each objective minimised in turn while the others are limited to their values at the design. The
        latter finds optima in narrow dips, and those that their position holds back.
        """
        front, fallback = self.front, None
        objectives = front.objectives(y)
        node = self._nearest(objectives[None])[0]
        limits = [front.limited(k, objectives, _WEIGHTS[2][1]) for k in range(front.count)]
        near = min(self.candidates, key=lambda other: float(np.max(np.abs(other.point.y - y)))).point
        if front.count > 2 and node not in self._taken():
            p = self._parameters_at(np.array(node) * self.step)
            point = front.solve(near, y, p)
            if point.solved and np.any(front.objectives(point.y) < objectives + MATTERS):
                candidate = self.candidate_of(point, p)
                if self._balances(candidate):
                    return candidate
        for p in (self._parameters_at(objectives), *limits):
            point = front.solve(near, y, p)
            if not _no_worse(point, point_as_found(front.program, p, y)):
                continue
            candidate = self.candidate_of(point, p)
            if self._balances(candidate):
                return candidate
            fallback = fallback or candidate
        return fallback

    def _locate_ends(self) -> None:
        """Locate where the parts of a curve end: at a minimum, or where the next part begins to dominate it."""
        tried: set[tuple[int, int]] = set()
        for _ in range(_END_ROUNDS):
            best = self.efficient()
            wide = [(best[a], best[b]) for a, b in parts_of(self.objectives_of(best), self.step)[1]]
            fresh = [pair for pair in wide if (id(pair[0]), id(pair[1])) not in tried]
            for left, right in fresh:
                tried.add((id(left), id(right)))
                for side in (left, right):
                    self._follow(side)
                end = self._end(left, 1, float(right.objectives[0]) - _CLEARANCE)
                self._end(right, 0, float((end or left).objectives[1]) - _CLEARANCE)
            if not fresh:
                return

    def _end(self, candidate: Candidate, objective: int, limit: float) -> Candidate | None:
        """Return the design of a branch with the least of an objective while the other one is limited."""
        return self._solve(candidate, candidate.point.y, self.front.limited(objective, np.full(2, limit)))

    def weights_at(self, candidate: Candidate) -> Array | None:
        """Return the weights with which the normalised objectives' gradients balance at a candidate.

        At an end of a curve the position does not decide, and multipliers are not unique; those a little inside count.

        Returns:
            The weights, which add up to 1; None if there are none, or the last objective has none.
        """
        front, point, p = self.front, candidate.point, candidate.p
        for falling in (0, 1) if front.count == 2 and len(self.candidates) > 1 else ():
            if front.position_decides(point):
                break
            inside = candidate.objectives + _INWARD * self.step * np.where(np.arange(2) == falling, -1.0, 1.0)
            p = self._parameters_at(inside, falling)
            point = front.solve(candidate.point, candidate.point.y, p, exact=candidate.exact)
        weights = front.weights_at(point, p) * front.span
        if not front.position_decides(point) or np.any(weights < -Zero.multiplier) or not weights[-1] > Zero.multiplier:
            return None
        return np.asarray(weights / np.sum(weights))

    # --- what is shown -----------------------------------------------------------------------------------

    def arrange(self, candidates: Sequence[Candidate]) -> Arrangement:
        """Return candidates arranged as a front.

        Shown are the ends of holes, anchors, points at nodes, and as many others as are needed so that no efficient
        candidate is far from a shown one, and that a surface has the wanted number of points.
        """
        best = self.efficient(candidates)
        if not best:
            return Arrangement([], [], (), ())
        objectives = self.objectives_of(best)
        parts, holes = parts_of(objectives, self.step)
        shown = self._spread(objectives, [*chain(*holes)])
        number = {row: k for k, row in enumerate(shown)}
        return Arrangement(
            best,
            [best[k] for k in shown],
            tuple(tuple(number[row] for row in part if row in number) for part in parts),
            tuple((number[a], number[b]) for a, b in holes),
        )

    def _spread(self, objectives: Array, ends: Sequence[int]) -> list[int]:
        """Return the rows of efficient candidates to show: ends, those at nodes, anchors, and the farthest from these.

        Rows are added until every other one is near; on a curve only in gaps between neighbours, and at bends.
        """
        places = locations(objectives) if objectives.shape[1] == 2 else objectives
        far: Array = np.full(len(objectives), np.inf)
        shown: list[int] = []

        def show(k: int) -> None:
            nonlocal far
            shown.append(k)
            far = np.minimum(far, np.max(np.abs(places - places[k]), axis=1))

        anchors = np.argmin(objectives @ self._weights.T, axis=0).tolist()
        off = np.abs(self._places(objectives) - np.array(self._nearest(objectives))).max(axis=1)
        for k in dict.fromkeys((*ends, *np.flatnonzero(off <= _AT_NODE).tolist(), *anchors)):
            if k in ends or far[k] > _CROWDED * self.step:
                show(k)
        while np.any(beyond := far > self._room(objectives, shown) * self.step):
            show(int(np.argmax(np.where(beyond, far, 0.0))))
        return sorted(shown)

    def _room(self, objectives: Array, shown: Sequence[int]) -> Array:
        """Return how far from the shown ones each row of efficient candidates must lie to be shown, too, in steps."""
        if self.front.count > 2:
            return np.full(len(objectives), _CROWDED if len(shown) < self._count else _COVERED)
        # In a gap, or at a bend that the line between neighbours cuts off.
        cut = self._below_curve(objectives[np.sort(shown)], objectives) > _BEND * self.step**2
        return np.where(cut, _CROWDED, np.inf)


def _no_worse(point: Point, start: Point) -> bool:
    """Return whether a point is an optimum and as good as its start, up to the error of a search."""
    return point.solved and point.f <= start.f + _NOT_WORSE * max(abs(start.f), 1.0)
