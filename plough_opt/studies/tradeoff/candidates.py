"""Candidates for a front: local optima of each objective alone and beside others, kept once each."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from plough_opt.design.basin import near_optimum
from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import REMEDIES, Point, Vector
from plough_opt.design.polishing import minimum_from, point_as_found, polished
from plough_opt.studies.tradeoff.archive import Archive, FrontLandscape
from plough_opt.studies.tradeoff.domination import undominated
from plough_opt.studies.tradeoff.front import Failure

# Weight of the other objectives in an anchor: what is indifferent to one objective is decided by the others.
OTHERS = 1e-4
MATTERS = 1e-3
"""Of the range of an objective: a design that is better by less is as good."""

SOUGHT = 5e-4
"""The same for what is followed: half of it, for the front is judged in ranges, and by runs, that differ a little."""

ROUGHLY = 1e-2
"""Of ranges: designs are thinned to so much for which the program is written, or beside which others are looked at."""

NOT_WORSE = 1e-5
"""Of the scaled objective: an optimum above its start by less is as good, for searches integrate roughly."""

# Two optima nearer than this, in normalised objectives and in scaled variables, are one.
_SAME_OBJECTIVES = 1e-6
_SAME_DESIGN = 1e-4
# An optimum with its last digits is no further from where it was without them.
_BESIDE = 0.05
# Ratios of ranges that weights follow.
_RATIOS = 1e-3, 1e3


@dataclass(eq=False)
class Candidate:
    """A local optimum on some branch, or a design that is as good; each is equal to itself alone.

    Attributes:
        point: as the optimiser left it.
        p: parameters of the program that it is an optimum of.
        at: normalised objectives.
        exact: whether it was solved with exact slopes.
        swept: objectives in whose direction its branch has been followed from here.
        extra: whether it was sought for a design that the front missed, and lies between positions.
        inward: at an end, an optimum and its parameters a little along the front, where the multipliers are unique.
        needle: whether no workshop can hit it; None until that is judged.
        confirmed: whether it is an optimum; else a design that the search saw, beside which none was found.
    """

    point: Point
    p: Vector
    at: Vector
    exact: bool = False
    swept: set[int] = field(default_factory=set)
    extra: bool = False
    inward: tuple[Point, Vector] | None = None
    needle: bool | None = None
    confirmed: bool = True


def ahead(behind: Candidate | None, one: Candidate) -> Vector:
    """Return the design as far ahead of a candidate as another lies behind it, between the bounds."""
    before = one if behind is None else behind
    return np.clip(2.0 * one.point.y - before.point.y, 0.0, 1.0)


@dataclass(frozen=True)
class Order:
    """How candidates make up a front.

    Attributes:
        efficient: those that no other dominates.
        kept: those of them that do not crowd, in order.
        parts: numbers of the kept ones in each part.
        holes: numbers of two kept ones between which there is none.
    """

    efficient: list[Candidate]
    kept: list[Candidate]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


class Candidates(ABC):
    """All candidates found, and how to find one beside another.

    Attributes:
        step: distance of neighbouring positions in the normalised objectives.
        turns: weights of the objectives in an anchor, a row for each order of the objectives; those orders that begin
            with the same one stand together.
    """

    step: float
    turns: Vector

    def __init__(self, archive: Archive, progress: Progress) -> None:
        """Take what looks at the designs of a front's program."""
        self.archive, self.front, self.progress = archive, archive.front, progress
        self.found: list[Candidate] = []
        self.failures: list[Failure] = []
        self._ranges = np.ones(self.front.count)

    # --- anchors -----------------------------------------------------------------------------------------

    def orders(self) -> list[Vector]:
        """Return the parameters for each order of the objectives.

        Weights are on the objectives' ranges, that of the heaviest on its size: without that, what little another
        objective weighs may be more than the range of one that hardly changes.
        """
        sizes = (self._ranges[int(np.argmax(weights))] / self._ranges for weights in self.turns)
        return [self.front.weighted(w * np.clip(size, *_RATIOS)) for w, size in zip(self.turns, sizes, strict=True)]

    def alone(self) -> list[Vector]:
        """Return the parameters for each objective alone."""
        return self.orders()[:: len(self.turns) // self.front.count]

    @abstractmethod
    def all_anchors(self, starts: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return the local optima for each of `orders` beside starts for each objective alone."""

    def begin(self) -> list[list[Vector]]:
        """Return starts for each objective alone, and write the program with the steps that these need.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no design has a value.
        """
        if not self.archive.vary:
            self.progress("solving from the guess", 0.0)
            program = self.front.program
            starts = [[near_optimum(FrontLandscape(self.archive, p), program.start()).y] for p in self.alone()]
        else:
            starts = [list(self.archive.bottoms(p).points) for p in self.alone()]
        # Ranges between the starts tell needles from others.
        ends = self.archive.look(np.array([own[0] for own in starts]))[0]
        sizes = np.maximum(np.abs(ends).max(axis=0), 1.0)
        self._ranges = np.maximum(np.ptp(ends, axis=0), _SAME_OBJECTIVES * sizes)
        self.front.normalise(ends.min(axis=0), self._ranges)
        y, at = self.archive.feasible
        self.front.build([y for own in starts for y in own] + list(y[undominated(at, ROUGHLY)]))
        return starts

    def anchors(self, p: Vector, starts: Sequence[Vector]) -> list[Point]:
        """Return the local optima beside starts, needles last, of the others the best first.

        Args:
            p: parameters that set no position.
            starts: scaled designs.
        """
        found = [minimum_from(self.front.program, p, self._polished(p, y)) for y in starts]
        solved = [point for point in found if point.solved]
        at = np.array([self.front.objectives(point.y) for point in solved]).reshape(-1, self.front.count)
        needles = self.archive.needles(np.array([point.y for point in solved]), at)
        return [solved[k] for k in sorted(range(len(solved)), key=lambda k: (bool(needles[k]), solved[k].f))]

    def _polished(self, p: Vector, y: Vector) -> Point:
        """Return the local optimum beside a design that a search found; never a worse one."""
        begins = point_as_found(self.front.program, p, y)
        point = self.front.solve(begins, y, p)
        return point if self._no_worse(point, begins) else polished(self.front.program, p, y)

    # --- solving -----------------------------------------------------------------------------------------

    @staticmethod
    def _no_worse(point: Point, begins: Point) -> bool:
        """Return whether a point is an optimum and as good as the design that it was sought beside."""
        return point.solved and point.f <= begins.f + NOT_WORSE * max(abs(begins.f), 1.0)

    def solve(self, near: Candidate, start: Vector, p: Vector, *, report: bool = True) -> Candidate | None:
        """Return the optimum near a start, or None where there is none.

        Args:
            near: the candidate whose multipliers it starts with.
            start: scaled variables.
            p: parameters.
            report: whether a failure is reported.
        """
        point = self.front.solve(near.point, start, p)
        if point.solved:
            return self.at_the_edge(p, point)
        if report:
            reason = REMEDIES.get(point.status, "the optimiser stopped without an optimum")
            failure = Failure(tuple(near.at.tolist()), f"{point.status}: {reason}")
            if failure not in self.failures:
                self.failures.append(failure)
        return None

    def best_from(self, p: Vector, y: Vector) -> Candidate | None:
        """Return the local optimum that parameters ask for beside a design, None where there is none as good."""
        begins = point_as_found(self.front.program, p, y)
        near = min(self.found, key=lambda other: float(np.max(np.abs(other.point.y - y))), default=None)
        point = self.front.solve(begins if near is None else near.point, y, p)
        return self.at_the_edge(p, point) if self._no_worse(point, begins) else None

    def at_the_edge(self, p: Vector, point: Point) -> Candidate:
        """Return the candidate of an optimum at a position; where the position does not hold it, that of the edge."""
        return self.kept(point, p)

    def kept(self, point: Point, p: Vector) -> Candidate:
        """Return a point's candidate: an earlier one where the same design was found before."""
        at = self.front.objectives(point.y)
        places = np.array([other.at for other in self.found]).reshape(-1, len(at))
        for k in np.flatnonzero(np.max(np.abs(places - at), axis=1) < _SAME_OBJECTIVES):
            if np.max(np.abs(self.found[k].point.y - point.y)) < _SAME_DESIGN:
                return self.found[k]
        self.found.append(Candidate(point, p, at))
        return self.found[-1]

    def to_the_last_digits(self, candidates: Sequence[Candidate], *, again: bool = False) -> None:
        """Solve candidates with exact slopes; ``again`` those that were before, for the program has become finer."""
        wanted = [one for one in candidates if one.confirmed and one.exact == again]
        for number, one in enumerate(wanted):
            self.progress("solving to the last digits", number / len(wanted))
            point = self.front.solve(one.point, one.point.y, one.p, exact=True)
            at = self.front.objectives(point.y, exact=True)
            # Along a flat valley, where differences have an end that is none, corrections lead elsewhere.
            if point.solved and np.max(np.abs(at - one.at)) < _BESIDE and np.all(at <= one.at + MATTERS):
                one.point, one.exact, one.at = point, True, at

    # --- what makes up the front -------------------------------------------------------------------------

    def sound(self) -> list[Candidate]:
        """Return the candidates that are not needles, which beat no design that can be made."""
        fresh = [one for one in self.found if one.needle is None]
        if fresh:
            needles = self.archive.needles(np.array([one.point.y for one in fresh]), self.places(fresh))
            for one, needle in zip(fresh, needles, strict=True):
                one.needle = bool(needle)
        return [one for one in self.found if not one.needle]

    def is_efficient(self, one: Candidate) -> bool:
        """Return whether no objective would rather be worse: a local optimum may be held back by its position."""
        return not one.confirmed or bool(np.all(self.front.slopes(one.point, one.p) > 0.0))

    @abstractmethod
    def order(self, candidates: Sequence[Candidate]) -> Order:
        """Return how candidates make up a front."""

    @abstractmethod
    def ordered(self) -> list[Candidate]:
        """Return the candidates that no other dominates, of two objectives in order."""

    def places(self, candidates: Sequence[Candidate]) -> Vector:
        """Return the normalised objectives of candidates, a row each."""
        return np.array([one.at for one in candidates]).reshape(-1, self.front.count)
