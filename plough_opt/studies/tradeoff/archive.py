"""Archive of a trade-off's searches, with which a front is compared, and the candidates found from it.

The searches for the optimum of one objective, and for designs at a position between optima, evaluate all objectives of
each design. So whatever design they try can show what the front misses, and where to start to find it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import comb

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import NotConverged
from plough_opt.core.plain_data import Array
from plough_opt.design.confirmation import boxes, minimum_from, ranking_criterion
from plough_opt.design.model.ipopt import REMEDIES, Point
from plough_opt.design.search.effort import Search, effort_of, searched
from plough_opt.design.search.explore import Explorer, Progress
from plough_opt.design.search.landscape import FEASIBLE, NEEDLE, SEED, Evaluations, Landscape, evolved, sample
from plough_opt.design.search.local import descend, point_as_found, polished
from plough_opt.design.search.near import feasible_from, near_optimum
from plough_opt.studies.tradeoff.front import MissingPoint, lead_over_points, thinned
from plough_opt.studies.tradeoff.program import FrontProgram

# Least factor on the number of steps of a search. A share that oscillates fast on a stiff mount has errors of a few
# parts in a thousand with the steps of a search, which is much along a front; twice as many leave 1e-5.
_FINER = 2.0
# Evaluations of this many designs or more are cached, because the searches of all objectives begin with one sample.
_CACHED = 200
# Designs whose tolerance boxes are evaluated at once.
_BOXES_AT_ONCE = 100
# Relative distance above the best judged value within which the minimum of a basin is followed.
_CAN_WIN = 0.15
# Most basins that are followed for one objective.
_MOST_BASINS = 3
# Evolution at a position: designs for each variable, generations, and the spread of designs that counts as converged.
_DESIGNS_EACH = 6
_GENERATIONS = 25
_CONVERGED = 0.01


class Archive:
    """All designs that were tried, and the searches that try them.

    Attributes:
        front: the program.
        seed: of the samples.
        vary: numbers of the variables that are searched; empty if only the basin of the guess is wanted.
        tried: number of designs tried.
        vectorised: whether designs are integrated side by side.
        needles_beyond: number of needles found ahead of the front, without those that other designs dominate.
    """

    def __init__(self, front: FrontProgram, search: Search, progress: Progress, seed: int = 0) -> None:
        """Use a program whose scales are set.

        Args:
            front: the program.
            search: as in `plough_opt.trade_off`.
            progress: called with what is being done and the fraction done.
            seed: of the samples.

        Raises:
            InputError: `search` names an unknown variable, or is not a valid effort.
        """
        self.front, self.tried, self._progress, self.seed = front, 0, progress, seed
        program = front.program
        self._landscape = Landscape(program, front.neutral_parameters())
        self.vectorised = self._landscape.vectorised
        self._position = program.owner[front.position_rows[0]]
        # Scaled variables and scaled objectives of the designs that meet the requirements, in parts.
        self._good = [(np.empty((0, self._landscape.dimensions)), np.empty((0, front.count)))]
        self._samples: dict[bytes, tuple[Array, Array]] = {}
        self._medians: dict[bytes, Array] = {}
        # Lead of each design over all optima that it was compared with, and these.
        self._leads = np.empty(0)
        self._compared: dict[Hashable, Array] = {}
        self.needles_beyond = 0
        self.vary = searched(search, program.declared.variables)
        self._start = program.start()
        effort = effort_of(search, len(self.vary), program.population.runs, self.vectorised)
        # The objectives share the effort. How likely further basins are is not reported, so none are followed for that.
        self._effort = replace(
            effort,
            followed=0,
            most_designs=None if effort.most_designs is None else max(1, effort.most_designs // front.count),
            seconds=None if effort.seconds is None else effort.seconds / front.count,
        )

    # --- designs -----------------------------------------------------------------------------------------

    def evaluate(self, points: Array, *, finer: float = 1.0, together: int = 1) -> tuple[Array, Array]:
        """Return scaled objectives and all rows of requirements, in their units, a row for each design.

        Args:
            points: scaled variables, a row for each design.
            finer: factor on the number of steps of the runs; at least 2 is taken.
            together: this many consecutive designs are integrated with equal numbers of steps; with more than 1 designs
                are not archived.
        """
        finer = max(finer, _FINER)
        key = points.tobytes() if len(points) >= _CACHED and finer == _FINER and together == 1 else b""
        if key in self._samples:
            return self._samples[key]
        results = self.front.evaluate(points, finer, together)
        self.tried += len(points)
        if key:
            self._samples[key] = results
        if together == 1:
            self._archive(points, *results)
        return results

    def _archive(self, points: Array, objectives: Array, rows: Array) -> None:
        """Add the designs that have a value and meet the design's own requirements."""
        program = self.front.program
        with np.errstate(all="ignore"):
            violations = self._landscape.violations(rows / np.array(program.scales)[np.array(program.owner)])
            violations[:, self._position] = 0.0
            good = np.all(np.isfinite(objectives), axis=1) & (violations.sum(axis=1) <= FEASIBLE)
        self._good.append((points[good], objectives[good]))

    @property
    def feasible(self) -> tuple[Array, Array]:
        """Scaled variables and normalised objectives of all designs that meet the requirements, a row each."""
        if len(self._good) > 1:
            designs, objectives = zip(*self._good, strict=True)
            self._good = [(np.concatenate(designs), np.concatenate(objectives))]
        designs_of_all, objectives_of_all = self._good[0]
        return designs_of_all, self.front.normalised(objectives_of_all)

    def leads_over(self, optima: Mapping[Hashable, Array]) -> Array:
        """Return the lead of each feasible design over all optima, this time's and those of earlier calls.

        Leads are those of `lead_over_points`: infinite without an optimum, and -infinite for excluded designs.

        Args:
            optima: key that identifies an optimum -> its normalised objectives.
        """
        _, objectives = self.feasible
        fresh = {key: place for key, place in optima.items() if key not in self._compared}
        self._compared |= fresh
        compared = len(self._leads)
        if fresh:
            over_fresh = lead_over_points(np.array(list(fresh.values())), objectives[:compared])
            self._leads = np.minimum(self._leads, over_fresh)
        every = np.array(list(self._compared.values())).reshape(-1, self.front.count)
        self._leads = np.r_[self._leads, lead_over_points(every, objectives[compared:])]
        return self._leads

    def exclude(self, needles: NDArray[np.intp]) -> None:
        """Give feasible designs, by their numbers, a lead of -infinity from now on, and count them as needles."""
        self._leads[needles] = -np.inf
        self.needles_beyond += len(needles)

    # --- searches ----------------------------------------------------------------------------------------

    def basin_minima(self, p: Array) -> Evaluations:
        """Return the lowest design of each basin of an objective alone that may hold the best one, best first.

        Args:
            p: parameters of a subproblem without position constraints.

        Raises:
            InfeasibleDesign: no design was found that meets the requirements.
            NotConverged: no design has a value.
        """
        landscape = FrontLandscape(self, p)
        judged = ranking_criterion(landscape, "tolerance")
        explorer = Explorer(landscape, self._start, self.vary, judged, self._effort, self._progress, self.seed)
        explored = explorer.explore()
        if not np.any(np.isfinite(explored.sample.merit)):
            none = f"none of {landscape.designs_tried} designs between the bounds has a value"
            raise NotConverged(f"{none}: tighten the bounds, or shorten the duration", "no value")
        if not np.any(explored.minima.feasible):
            self._progress("looking for a design that meets the requirements", 0.0)
            return descend(landscape, feasible_from(landscape, explored, self._start))
        values = judged(explored.minima.points)
        limit = values.min() + _CAN_WIN * abs(values.min())
        best_first = np.argsort(values, kind="stable")
        return explored.minima.select([k for k in best_first if values[k] <= limit][:_MOST_BASINS])

    def evolved_at(self, p: Array) -> list[Array]:
        """Return the designs that evolution finds in a subproblem, one for each round of the effort.

        Empty if fewer than two variables are searched, or runs are integrated one by one, which takes too long.
        """
        landscape, varied, ends = FrontLandscape(self, p), list(self.vary), []
        if not self.vectorised or len(varied) < 2:
            return []

        def whole(points: Array) -> Array:
            designs = np.repeat(self._start[None], len(points), axis=0)
            designs[:, varied] = points
            return designs

        def merit(points: Array) -> Array:
            return landscape(whole(points)).merit

        for number in range(self._effort.rounds):
            # `basin_minima` begins with the same sample, which is cached.
            rng = np.random.default_rng([SEED + self.seed, number])
            points, _ = sample(len(varied), self._effort.designs, self._start[varied], rng)
            merits = merit(points)
            if np.any(np.isfinite(merits)):
                best = points[np.argsort(merits, kind="stable")[: _DESIGNS_EACH * len(varied)]]
                rng = np.random.default_rng([SEED + self.seed, number, 1])
                end = evolved(merit, best, _GENERATIONS, rng, from_best=True, alike=_CONVERGED)
                ends.append(whole(end[None])[0])
        return ends

    # --- tolerances --------------------------------------------------------------------------------------

    def medians(self, points: Array) -> Array | None:
        """Return the medians of the scaled objectives over the tolerances of each design, a row each.

        A median is infinite if half of the designs in the tolerance box have no value.

        Returns:
            The medians; None if runs are integrated one by one, which takes too long.
        """
        if not self.vectorised:
            return None
        keys = [point.tobytes() for point in points]
        fresh = [k for k, key in enumerate(keys) if key not in self._medians]
        for first in range(0, len(fresh), _BOXES_AT_ONCE):
            part = fresh[first : first + _BOXES_AT_ONCE]
            around = boxes(self.front.program.declared.variables, points[part])
            results = self.front.evaluate(around, 1.0, 1)[0]
            self.tried += len(around)
            results = np.where(np.isfinite(results), results, np.inf).reshape(len(part), -1, self.front.count)
            self._medians |= {keys[k]: median for k, median in zip(part, np.median(results, axis=1), strict=True)}
        return np.array([self._medians[key] for key in keys]).reshape(-1, self.front.count)

    def needles(self, points: Array, objectives: Array) -> NDArray[np.bool_]:
        """Return which designs are needles: optima too narrow for a workshop to hit.

        The median of some objective over the tolerances of a needle is worse than its own value by more than 5 % of
        that and of the objective's range over the front. If runs are integrated one by one, none is called a needle.

        Args:
            points: scaled variables, a row for each design.
            objectives: normalised objectives, a row for each design.
        """
        medians = self.medians(points)
        if medians is None:
            return np.zeros(len(points), dtype=bool)
        scaled = self.front.scaled(objectives)
        return np.asarray(np.any(medians - scaled > NEEDLE * np.maximum(np.abs(scaled), self.front.span), axis=1))


class FrontLandscape(Landscape):
    """Landscape of one subproblem, whose designs enter the archive with all their objectives."""

    def __init__(self, archive: Archive, p: Array) -> None:
        """Use an archive, and the parameters of a subproblem."""
        super().__init__(archive.front.program, p)
        self._archive, self._subproblem = archive, archive.front.subproblem(p)

    def rows(self, points: Array, *, finer: float = 1.0, together: int = 1) -> tuple[Array, Array]:
        """Return the scaled objective and requirements of the subproblem, a row for each design."""
        self.designs_tried += len(points)
        objectives, g = self._archive.evaluate(points, finer=finer, together=together)
        weights, normals, limits = self._subproblem
        g = g.copy()
        g[:, self._archive.front.position_rows] = objectives @ normals.T - limits
        return weights[0] + objectives @ weights[1:], g / self._scale


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
class FrontCandidate:
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
    p: Array
    objectives: Array
    exact: bool = False
    followed: set[int] = field(default_factory=set)
    between: bool = False
    inner_neighbour: tuple[Point, Array] | None = None
    needle: bool | None = None
    confirmed: bool = True


def extrapolated(points: Sequence[Array]) -> Array:
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

    efficient: list[FrontCandidate]
    shown: list[FrontCandidate]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


class FrontCandidates(ABC):
    """All candidates found, and ways to find one near another.

    Attributes:
        step: distance of neighbouring positions, in normalised objectives.
        anchor_weights: weights of the objectives in the anchors, a row for each order of the objectives; orders that
            begin with the same objective stand together.
    """

    step: float
    anchor_weights: Array

    def __init__(self, archive: Archive, progress: Progress) -> None:
        """Begin without a candidate.

        Args:
            archive: designs that the searches tried.
            progress: called with what is being done and the fraction done.
        """
        self.archive, self.front, self.progress = archive, archive.front, progress
        self.candidates: list[FrontCandidate] = []
        self.failures: list[MissingPoint] = []
        self._ranges = np.ones(self.front.count)

    # --- anchors -----------------------------------------------------------------------------------------

    def anchor_parameters(self) -> list[Array]:
        """Return the parameters of the subproblem of each anchor.

        The largest weight is kept. Each other one is multiplied by the ratio of that objective's range to its own
        objective's, so that a small weight stays small compared with an objective that hardly changes.
        """
        ratios = self._ranges[np.argmax(self.anchor_weights, axis=1)][:, None] / self._ranges
        return [*map(self.front.weighted, self.anchor_weights * np.clip(ratios, _LEAST_RATIO, _LARGEST_RATIO))]

    @abstractmethod
    def all_anchors(self, starts: Sequence[Sequence[Array]]) -> list[list[Point]]:
        """Return the local optima of each anchor's subproblem, from starts for each objective alone."""

    def begin(self) -> list[list[Array]]:
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
        ends = self.archive.evaluate(np.array([designs_of[0] for designs_of in starts]))[0]
        sizes = np.maximum(np.abs(ends).max(axis=0), 1.0)
        self._ranges = np.maximum(np.ptp(ends, axis=0), _SAME_OBJECTIVES * sizes)
        self.front.normalise(ends.min(axis=0), self._ranges)
        designs, objectives = self.archive.feasible
        self.front.build([*chain(*starts), *designs[thinned(objectives, THINNING)]])
        return starts

    def anchors(self, p: Array, starts: Sequence[Array]) -> list[Point]:
        """Return the local optima near starts, best first, needles last.

        Args:
            p: parameters of a subproblem without position constraints.
            starts: scaled designs.
        """
        points = [minimum_from(self.front.program, p, self._polished(p, y)) for y in starts]
        solved = [point for point in points if point.solved]
        objectives = np.array([self.front.objectives(point.y) for point in solved]).reshape(-1, self.front.count)
        needles = self.archive.needles(np.array([point.y for point in solved]), objectives)
        return [solved[k] for k in sorted(range(len(solved)), key=lambda k: (bool(needles[k]), solved[k].f))]

    def _polished(self, p: Array, y: Array) -> Point:
        """Return the local optimum near a design of a search, never a worse one."""
        start = point_as_found(self.front.program, p, y)
        point = self.front.solve(start, y, p)
        return point if self._no_worse(point, start) else polished(self.front.program, p, y)

    # --- solving -----------------------------------------------------------------------------------------

    @staticmethod
    def _no_worse(point: Point, start: Point) -> bool:
        """Return whether a point is an optimum and as good as its start, up to the error of a search."""
        return point.solved and point.f <= start.f + NOT_WORSE * max(abs(start.f), 1.0)

    def solve(self, near: FrontCandidate, start: Array, p: Array, *, report: bool = True) -> FrontCandidate | None:
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
        reason = REMEDIES.get(point.status, "the optimiser stopped without an optimum")
        failure = MissingPoint(tuple(near.objectives.tolist()), f"{point.status}: {reason}")
        if report and failure not in self.failures:
            self.failures.append(failure)
        return None

    def no_worse_than(self, y: Array, p: Array) -> FrontCandidate | None:
        """Return the optimum of a subproblem near a design of a search, or None if there is none as good.

        Args:
            y: scaled variables of the design.
            p: parameters of the subproblem.
        """
        start = point_as_found(self.front.program, p, y)
        near = min(self.candidates, key=lambda other: float(np.max(np.abs(other.point.y - y))), default=None)
        point = self.front.solve(start if near is None else near.point, y, p)
        return self.candidate_of(p, point) if self._no_worse(point, start) else None

    def candidate_of(self, p: Array, point: Point) -> FrontCandidate:
        """Return the candidate to record for an optimum at a position; subclasses may take one on the edge instead."""
        return self.recorded(point, p)

    def recorded(self, point: Point, p: Array) -> FrontCandidate:
        """Return the candidate of an optimum: a new one, or the earlier one if the same design was found before."""
        objectives = self.front.objectives(point.y)
        recorded = self.objectives_of(self.candidates)
        for k in np.flatnonzero(np.max(np.abs(recorded - objectives), axis=1) < _SAME_OBJECTIVES):
            if np.max(np.abs(self.candidates[k].point.y - point.y)) < _SAME_DESIGN:
                return self.candidates[k]
        self.candidates.append(FrontCandidate(point, p, objectives))
        return self.candidates[-1]

    def solve_exactly(self, candidates: Sequence[FrontCandidate], *, again: bool = False) -> None:
        """Solve candidates with exact slopes.

        Args:
            candidates: the candidates, of which unconfirmed ones and those solved exactly before are skipped.
            again: solve only those solved exactly before, because the program now takes more integration steps.
        """
        chosen = [candidate for candidate in candidates if candidate.confirmed and candidate.exact == again]
        for number, candidate in enumerate(chosen):
            self.progress("solving to the last digits", number / len(chosen))
            point = self.front.solve(candidate.point, candidate.point.y, candidate.p, exact=True)
            objectives = self.front.objectives(point.y, exact=True)
            # Slopes by differences may stop in a flat valley that has no optimum; exact ones then lead far away.
            near = np.max(np.abs(objectives - candidate.objectives)) < _SAME_OPTIMUM
            if point.solved and near and np.all(objectives <= candidate.objectives + MATTERS):
                candidate.point, candidate.exact, candidate.objectives = point, True, objectives

    # --- what makes up the front -------------------------------------------------------------------------

    def without_needles(self) -> list[FrontCandidate]:
        """Return the candidates that a workshop can make."""
        fresh = [candidate for candidate in self.candidates if candidate.needle is None]
        if fresh:
            designs = np.array([candidate.point.y for candidate in fresh])
            needles = self.archive.needles(designs, self.objectives_of(fresh))
            for candidate, needle in zip(fresh, needles, strict=True):
                candidate.needle = bool(needle)
        return [candidate for candidate in self.candidates if not candidate.needle]

    def balances(self, candidate: FrontCandidate) -> bool:
        """Return whether every objective has a positive weight at a candidate.

        A position constraint can hold an optimum where it would rather have more of an objective. Such an optimum is
        not on the front.
        """
        return not candidate.confirmed or bool(np.all(self.front.weights_at(candidate.point, candidate.p) > 0.0))

    @abstractmethod
    def arrange(self, candidates: Sequence[FrontCandidate]) -> Arrangement:
        """Return candidates arranged as a front."""

    @abstractmethod
    def efficient(self) -> list[FrontCandidate]:
        """Return the candidates that no other dominates; those of two objectives in order."""

    def objectives_of(self, candidates: Sequence[FrontCandidate]) -> Array:
        """Return the normalised objectives of candidates, a row each."""
        return np.array([candidate.objectives for candidate in candidates]).reshape(-1, self.front.count)
