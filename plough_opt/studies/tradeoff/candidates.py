"""Candidates for a front: local optima of each objective alone and at positions between, each recorded once."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import comb

import numpy as np

from plough_opt.design.basin import near_optimum
from plough_opt.design.exploring import Progress
from plough_opt.design.ipopt import REMEDIES, Point, Vector
from plough_opt.design.polishing import minimum_from, point_as_found, polished
from plough_opt.studies.tradeoff.archive import Archive, FrontLandscape
from plough_opt.studies.tradeoff.domination import undominated
from plough_opt.studies.tradeoff.front import Failure

OTHERS_WEIGHT = 1e-4
"""Weight of the other objectives in an anchor. They decide what the anchor's own objective leaves open."""

MATTERS = 1e-3
"""Normalised difference of objectives that matters: a design that is better by less is just as good."""

SOUGHT = 5e-4
"""Normalised lead of a design above which it is sought. It is half of `MATTERS`, because runs and ranges that judge the
front differ a little from those that trace it."""

THINNING = 1e-2
"""Normalised difference to which designs are thinned before the program is written for them, or others sampled around
them."""

NOT_WORSE = 1e-5
"""Relative excess of an optimum's scaled objective over its start's that the rough integration of a search explains."""

# Two optima closer than this, in normalised objectives and in scaled variables, are the same.
_SAME_OBJECTIVES = 1e-6
_SAME_DESIGN = 1e-4
# Largest change of normalised objectives when an optimum is solved exactly; a larger one leads to another optimum.
_SAME_OPTIMUM = 0.05
# Limits of the ratio of two objectives' ranges that the weights of an anchor follow.
_LEAST_RATIO, _LARGEST_RATIO = 1e-3, 1e3
# Each further order of a prediction must correct it by less than this fraction of the correction before.
_SHRINKS = 0.5


@dataclass(eq=False)
class Candidate:
    """A local optimum on some branch, or a simulated design that is just as good; equal to itself alone.

    Attributes:
        point: as the optimiser left it.
        p: parameters of the subproblem that it solves.
        objectives: normalised.
        exact: whether it was solved with exact slopes.
        followed: numbers of the objectives that were reduced when its branch was followed from here.
        between: whether it was sought because the front missed a design, so that it lies between positions.
        inner_neighbour: for an end, an optimum a little inside the front, where multipliers are unique, and its p.
        needle: whether it is a needle; None until that is judged.
        confirmed: whether it is an optimum; otherwise it is a design of a search, near which no optimum was found.
    """

    point: Point
    p: Vector
    objectives: Vector
    exact: bool = False
    followed: set[int] = field(default_factory=set)
    between: bool = False
    inner_neighbour: tuple[Point, Vector] | None = None
    needle: bool | None = None
    confirmed: bool = True


def extrapolated(points: Sequence[Vector]) -> Vector:
    """Return the design to which equally spaced designs lead, within the bounds.

    It is the next value of the polynomial through the last of them. The degree rises as long as each further design
    corrects the prediction by much less than the one before.
    """
    predicted, correction = points[-1], np.inf
    for count in range(2, len(points) + 1):
        weights = np.array([(-1.0) ** (k + 1) * comb(count, k) for k in range(count, 0, -1)])
        better = weights @ np.array(points[-count:])
        size = float(np.max(np.abs(better - predicted)))
        if size > _SHRINKS * correction:
            break
        predicted, correction = better, size
    return np.clip(predicted, 0.0, 1.0)


@dataclass(frozen=True)
class Arrangement:
    """Candidates arranged as a front.

    Attributes:
        efficient: candidates that no other dominates.
        shown: those of them that are not crowded, in order.
        parts: for each connected part the numbers of its shown candidates.
        holes: numbers of the two shown candidates on either side of each hole.
    """

    efficient: list[Candidate]
    shown: list[Candidate]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


class Candidates(ABC):
    """All candidates found, and ways to find one near another.

    Attributes:
        step: distance of neighbouring positions, in normalised objectives.
        anchor_weights: weights of the objectives in the anchors, a row for each order of the objectives; orders that
            begin with the same objective stand together.
    """

    step: float
    anchor_weights: Vector

    def __init__(self, archive: Archive, progress: Progress) -> None:
        """Begin without a candidate.

        Args:
            archive: designs that the searches tried.
            progress: called with what is being done and the fraction done.
        """
        self.archive, self.front, self.progress = archive, archive.front, progress
        self.candidates: list[Candidate] = []
        self.failures: list[Failure] = []
        self._ranges = np.ones(self.front.count)

    # --- anchors -----------------------------------------------------------------------------------------

    def anchor_parameters(self) -> list[Vector]:
        """Return the parameters of the subproblem of each anchor.

        The largest weight is kept. Each other one is multiplied by the ratio of that objective's range to its own
        objective's, so that a small weight stays small compared with an objective that hardly changes.
        """
        sizes = (self._ranges[int(np.argmax(weights))] / self._ranges for weights in self.anchor_weights)
        return [
            self.front.weighted(weights * np.clip(size, _LEAST_RATIO, _LARGEST_RATIO))
            for weights, size in zip(self.anchor_weights, sizes, strict=True)
        ]

    @abstractmethod
    def all_anchors(self, starts: Sequence[Sequence[Vector]]) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem, from starts for each objective alone."""

    def begin(self) -> list[list[Vector]]:
        """Return starts for each objective alone, and write the program with the steps that these need.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no design has a value.
        """
        # The first of the anchors that begin with the same objective stands for that objective alone.
        alone = self.anchor_parameters()[:: len(self.anchor_weights) // self.front.count]
        if not self.archive.vary:
            self.progress("solving from the guess", 0.0)
            guess = self.front.program.start()
            starts = [[near_optimum(FrontLandscape(self.archive, p), guess)[1].y] for p in alone]
        else:
            starts = [list(self.archive.basin_minima(p).points) for p in alone]
        # The ranges between the starts, which needles are judged by until the anchors are known.
        ends = self.archive.evaluate(np.array([own[0] for own in starts]))[0]
        sizes = np.maximum(np.abs(ends).max(axis=0), 1.0)
        self._ranges = np.maximum(np.ptp(ends, axis=0), _SAME_OBJECTIVES * sizes)
        self.front.normalise(ends.min(axis=0), self._ranges)
        designs, objectives = self.archive.feasible
        self.front.build([y for own in starts for y in own] + list(designs[undominated(objectives, THINNING)]))
        return starts

    def anchors(self, p: Vector, starts: Sequence[Vector]) -> list[Point]:
        """Return the local optima near starts, best first, needles last.

        Args:
            p: parameters of a subproblem without position constraints.
            starts: scaled designs.
        """
        found = [minimum_from(self.front.program, p, self._polished(p, y)) for y in starts]
        solved = [point for point in found if point.solved]
        objectives = np.array([self.front.objectives(point.y) for point in solved]).reshape(-1, self.front.count)
        needles = self.archive.needles(np.array([point.y for point in solved]), objectives)
        return [solved[k] for k in sorted(range(len(solved)), key=lambda k: (bool(needles[k]), solved[k].f))]

    def _polished(self, p: Vector, y: Vector) -> Point:
        """Return the local optimum near a design of a search, never a worse one."""
        start = point_as_found(self.front.program, p, y)
        point = self.front.solve(start, y, p)
        return point if self._no_worse(point, start) else polished(self.front.program, p, y)

    # --- solving -----------------------------------------------------------------------------------------

    @staticmethod
    def _no_worse(point: Point, start: Point) -> bool:
        """Return whether a point is an optimum and as good as its start, up to the error of a search."""
        return point.solved and point.f <= start.f + NOT_WORSE * max(abs(start.f), 1.0)

    def solve(self, near: Candidate, start: Vector, p: Vector, *, report: bool = True) -> Candidate | None:
        """Return the optimum of a subproblem near a start, or None if there is none.

        Args:
            near: candidate with whose multipliers to begin.
            start: scaled variables.
            p: parameters of the subproblem.
            report: whether a failure is recorded.
        """
        point = self.front.solve(near.point, start, p)
        if point.solved:
            return self.candidate_of(p, point)
        if report:
            reason = REMEDIES.get(point.status, "the optimiser stopped without an optimum")
            failure = Failure(tuple(near.objectives.tolist()), f"{point.status}: {reason}")
            if failure not in self.failures:
                self.failures.append(failure)
        return None

    def no_worse_than(self, y: Vector, p: Vector) -> Candidate | None:
        """Return the optimum of a subproblem near a design of a search, or None if there is none as good.

        Args:
            y: scaled variables of the design.
            p: parameters of the subproblem.
        """
        start = point_as_found(self.front.program, p, y)
        near = min(self.candidates, key=lambda other: float(np.max(np.abs(other.point.y - y))), default=None)
        point = self.front.solve(start if near is None else near.point, y, p)
        return self.candidate_of(p, point) if self._no_worse(point, start) else None

    def candidate_of(self, p: Vector, point: Point) -> Candidate:
        """Return the candidate to record for an optimum at a position; subclasses may take one on the edge instead."""
        return self.recorded(point, p)

    def recorded(self, point: Point, p: Vector) -> Candidate:
        """Return the candidate of an optimum: a new one, or the earlier one if the same design was found before."""
        objectives = self.front.objectives(point.y)
        known = self.objectives_of(self.candidates)
        for k in np.flatnonzero(np.max(np.abs(known - objectives), axis=1) < _SAME_OBJECTIVES):
            if np.max(np.abs(self.candidates[k].point.y - point.y)) < _SAME_DESIGN:
                return self.candidates[k]
        self.candidates.append(Candidate(point, p, objectives))
        return self.candidates[-1]

    def solve_exactly(self, candidates: Sequence[Candidate], *, again: bool = False) -> None:
        """Solve candidates with exact slopes.

        Args:
            candidates: the candidates, of which unconfirmed ones and those solved exactly before are skipped.
            again: solve only those solved exactly before, because the program now takes more integration steps.
        """
        chosen = [candidate for candidate in candidates if candidate.confirmed and candidate.exact == again]
        for number, one in enumerate(chosen):
            self.progress("solving to the last digits", number / len(chosen))
            point = self.front.solve(one.point, one.point.y, one.p, exact=True)
            objectives = self.front.objectives(point.y, exact=True)
            # Slopes by differences may stop in a flat valley that has no optimum; exact ones then lead far away.
            near = np.max(np.abs(objectives - one.objectives)) < _SAME_OPTIMUM
            if point.solved and near and np.all(objectives <= one.objectives + MATTERS):
                one.point, one.exact, one.objectives = point, True, objectives

    # --- what makes up the front -------------------------------------------------------------------------

    def without_needles(self) -> list[Candidate]:
        """Return the candidates that a workshop can make."""
        fresh = [candidate for candidate in self.candidates if candidate.needle is None]
        if fresh:
            designs = np.array([candidate.point.y for candidate in fresh])
            needles = self.archive.needles(designs, self.objectives_of(fresh))
            for candidate, needle in zip(fresh, needles, strict=True):
                candidate.needle = bool(needle)
        return [candidate for candidate in self.candidates if not candidate.needle]

    def balances(self, candidate: Candidate) -> bool:
        """Return whether every objective has a positive weight at a candidate.

        A position constraint can hold an optimum where it would rather have more of an objective. Such an optimum is
        not on the front.
        """
        return not candidate.confirmed or bool(np.all(self.front.weights_at(candidate.point, candidate.p) > 0.0))

    @abstractmethod
    def arrange(self, candidates: Sequence[Candidate]) -> Arrangement:
        """Return candidates arranged as a front."""

    @abstractmethod
    def efficient(self) -> list[Candidate]:
        """Return the candidates that no other dominates; those of two objectives in order."""

    def objectives_of(self, candidates: Sequence[Candidate]) -> Vector:
        """Return the normalised objectives of candidates, a row each."""
        return np.array([candidate.objectives for candidate in candidates]).reshape(-1, self.front.count)
