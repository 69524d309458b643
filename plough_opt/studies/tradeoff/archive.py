"""Archive of a trade-off's searches, and the tracer that compares a front with it and finds what is missing.

The searches for the optimum of one objective, and for designs at a position between optima, evaluate all objectives of
each design. So whatever design they try can show what the front misses, and where to start to find it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import NotConverged
from plough_opt.core.plain_data import Array
from plough_opt.design.confirmation import NEEDLE, boxes, minimum_from
from plough_opt.design.model.ipopt import Point
from plough_opt.design.search.descent import descend
from plough_opt.design.search.effort import Search, effort_of, searched
from plough_opt.design.search.explore import Progress, explore
from plough_opt.design.search.feasible import feasible_designs, nearest_feasible
from plough_opt.design.search.landscape import SEED, Evaluations, Landscape, Violation, apart, concatenated, even_points
from plough_opt.design.search.polish import point_as_found, polished
from plough_opt.design.solving import near_optimum
from plough_opt.studies.tradeoff.front import (
    Arrangement,
    FrontCandidate,
    MissingPoint,
    lead_over_front,
    lead_over_points,
    strongest_dominators,
    thinned,
    undominated,
)
from plough_opt.studies.tradeoff.program import FrontProgram

_REMEDIES = {
    "Infeasible_Problem_Detected": "no design near the start meets the requirements",
    "Maximum_Iterations_Exceeded": "the optimiser reached its limit of iterations: start nearer, or tighten the bounds",
    "Restoration_Failed": "the optimiser could not return to feasible designs: start nearer, or loosen a requirement",
    "Invalid_Number_Detected": "the model gave no finite number somewhere between the bounds: tighten the bounds",
    "Diverging_Iterates": "the objective falls without limit: tighten the bounds of the variables that make it fall",
    "Error_In_Step_Computation": "the derivatives are too large or too small: check units and bounds",
    "Not_Enough_Degrees_Of_Freedom": "there are more equalities than variables: drop some, or widen them to ranges",
    "Search_Direction_Becomes_Too_Small": "the objective is not smooth enough here: use more integration steps",
}

# Least factor on the number of steps of a search. A share that oscillates fast on a stiff mount has errors of a few
# parts in a thousand with the steps of a search, which is much along a front; twice as many leave 1e-5.
_FINER = 2.0
# Evaluations of this many designs or more are cached, because the searches of all objectives begin with one sample.
_CACHED = 200
# Designs whose tolerance boxes are evaluated at once.
_BOXES_AT_ONCE = 100
# Relative distance above the best judged value within which the minimum of a basin is followed.
_FOLLOWED = 0.15
# Most basins that are followed for one objective.
_MOST_BASINS = 3
# Least distance of these minima.
_APART = 0.02
# Descents of a short search at a position.
_DESCENTS = 4


class Archive:
    """All designs that were tried, and the searches that try them.

    Attributes:
        front: the program.
        progress: called with what is being done and the fraction done.
        seed: of the samples.
        vary: numbers of the variables that are searched; empty if only the basin of the guess is wanted.
        tried: number of designs tried.
        vectorised: whether designs are integrated side by side.
        needles_beyond: number of needles found ahead of the front, without those that other designs dominate.
    """

    def __init__(self, front: FrontProgram, search: Search, progress: Progress, seed: int) -> None:
        """Use a program whose scales are set.

        Args:
            front: the program.
            search: as in `plough_opt.trade_off`.
            progress: called with what is being done and the fraction done.
            seed: of the samples.

        Raises:
            InputError: `search` names an unknown variable, or is not a valid effort.
        """
        self.front, self.tried, self.progress, self.seed = front, 0, progress, seed
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
            violations = self._landscape.violations(rows / program.row_scales)
            violations[:, self._position] = 0.0
            good = np.all(np.isfinite(objectives), axis=1) & (violations.sum(axis=1) <= Violation.allowed)
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
        explored = explore(landscape, self._start, self.vary, self._effort, seed=self.seed, progress=self.progress)
        ends = explored.ends
        if not len(ends.f):
            none = f"none of {landscape.designs_tried} designs between the bounds has a value"
            raise NotConverged(f"{none}: tighten the bounds, or shorten the duration", "no value")
        if not ends.feasible[0]:
            self.progress("looking for a design that meets the requirements", 0.0)
            known = concatenated([ends, explored.sample])
            met = feasible_designs(landscape, self._start, known, seed=self.seed, progress=self.progress)
            ends = concatenated([*(descend(landscape, y) for y in met.points), met])
        ends = ends.distinct(_APART, _MOST_BASINS)
        return ends.select(ends.key <= ends.key[0] + _FOLLOWED * abs(ends.key[0]))

    def near_end(self, p: Array, guess: Array) -> Array:
        """Return the end of a descent of an objective alone from a guess or the nearest feasible design."""
        landscape = FrontLandscape(self, p)
        if not self.vectorised:
            return near_optimum(landscape, guess)[1].y
        return np.asarray(descend(landscape, nearest_feasible(landscape, guess)).points[0])

    def searched_at(self, p: Array) -> list[Array]:
        """Return the best designs that a short search finds in a subproblem.

        Empty if fewer than two variables are searched, or runs are integrated one by one, which takes too long.
        """
        if not self.vectorised or len(self.vary) < 2:
            return []
        effort = replace(self._effort, descents=_DESCENTS, followed=0, looks=1)
        # `basin_minima` begins with the same sample, which is cached.
        ends = explore(FrontLandscape(self, p), self._start, self.vary, effort, seed=self.seed).ends
        return list(ends.points[: effort.rounds])

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
        Scaled variables and normalised objectives have a row for each design.
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
        self._tried[0] += len(points)
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
_ANOTHER_OPTIMUM = 0.05
# Limits of the ratio of two objectives' ranges that the weights of an anchor follow.
_LEAST_RATIO, _LARGEST_RATIO = 1e-3, 1e3
# Most rounds of sampling around the best designs, as long as each shows that the front misses something.
_MOST_ROUNDS = 4
# Standard deviations of the samples around the best designs, in parts of the variables' ranges.
_SPREADS = (0.1, 0.03, 0.01, 0.003)
# Designs in each of these samples: enough to see the dips between the ripples of a force.
_SAMPLE = 4096
# The same around missed designs without an optimum nearby, such as those at the edge of a needle.
_EDGE_SPREADS = (0.03, 0.01, 0.003, 0.001)
_EDGE_SAMPLE = 1024
# Missed designs whose tolerances are judged at once.
_JUDGED_AT_ONCE = 100
# Most rounds in which the next missed designs take the place of those that turned out to be needles.
_MOST_JUDGEMENTS = 40
# Above this number of missed designs, those that differ by less than what matters are thinned out.
_MANY = 10_000


class Tracer(ABC):
    """All candidates found, ways to find one near another, and the search for those that are missing.

    Attributes:
        step: distance of neighbouring positions, in normalised objectives.
        anchor_weights: weights of the objectives in the anchors, a row for each order of the objectives; orders that
            begin with the same objective stand together.
        matters: normalised lead of a design over the front below which it is not sought.
        spacing: least distance of missed designs that are followed at once, in normalised objectives.
        at_once: most missed designs that are followed before the archive is compared with the front again.
        comparisons: most such comparisons before new designs are sampled around the best.
        tried: starts that need not be tried again, as bytes.
    """

    step: float
    anchor_weights: Array
    matters: float
    spacing: float
    at_once: int
    comparisons: int

    def __init__(self, archive: Archive) -> None:
        """Begin without candidates, with an archive of the designs that the searches tried."""
        self.archive, self.front, self.progress = archive, archive.front, archive.progress
        self.candidates: list[FrontCandidate] = []
        self.failures: list[MissingPoint] = []
        self.tried: set[bytes] = set()
        self._ranges = np.ones(self.front.count)
        self._rounds = 0

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
            starts = [[self.archive.near_end(p, guess)] for p in alone]
            if self.front.count > 2 and self.archive.vectorised:
                # Designs that are nearly best in one objective and good in another are starts of anchors.
                rng = np.random.default_rng(SEED)
                self.archive.evaluate(even_points(len(guess), _EDGE_SAMPLE, rng))
        else:
            starts = [list(self.archive.basin_minima(p).points) for p in alone]
        # The ranges between the starts, which needles are judged by until the anchors are known.
        ends = self.archive.evaluate(np.array([designs_of[0] for designs_of in starts]))[0]
        between, least = np.ptp(ends, axis=0), _SAME_OBJECTIVES * np.maximum(np.abs(ends).max(axis=0), 1.0)
        if self.front.count > 2:
            # An objective may be as good in all starts, and yet differ between the anchors, of which there are more.
            _, tried = self.archive.feasible
            reached = self.front.span * (tried.max(axis=0, initial=-np.inf) - tried.min(axis=0, initial=np.inf))
            between = np.where(between > least, between, reached)
        self._ranges = np.maximum(between, least)
        self.front.normalise(ends.min(axis=0), self._ranges)
        designs, objectives = self.archive.feasible
        self.front.build([*chain(*starts), *designs[thinned(objectives, THINNING)]])
        return starts

    def anchors(self, p: Array, starts: Sequence[Array]) -> list[Point]:
        """Return the local optima of a subproblem without positions near starts, best first, needles last."""
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
        reason = _REMEDIES.get(point.status, "the optimiser stopped without an optimum")
        failure = MissingPoint(tuple(near.objectives.tolist()), f"{point.status}: {reason}")
        if report and failure not in self.failures:
            self.failures.append(failure)
        return None

    def no_worse_than(self, y: Array, p: Array) -> FrontCandidate | None:
        """Return the optimum of a subproblem near a design of a search, or None if there is none as good."""
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
            near = np.max(np.abs(objectives - candidate.objectives)) < _ANOTHER_OPTIMUM
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

    # --- what the front misses ---------------------------------------------------------------------------

    @abstractmethod
    def trace(self, anchors: Sequence[Sequence[Point]]) -> None:
        """Find the whole front from the local optima of each anchor's subproblem."""

    @abstractmethod
    def parameters_at(self, objectives: Array) -> Array:
        """Return the parameters of the subproblem whose position is that of normalised objectives."""

    @abstractmethod
    def follow_everywhere(self, candidate: FrontCandidate) -> None:
        """Follow the branch of a candidate wherever it leads."""

    @property
    def _samples_around(self) -> bool:
        """Whether to sample around the best designs, which takes too long if runs are integrated one by one."""
        return bool(self.archive.vary) and self.archive.vectorised

    def sample_around_best(self) -> None:
        """Add designs around the undominated ones to the archive, at first far from them and then near."""
        self.progress("sampling around the best designs", 0.0)
        self._rounds += 1
        rng = np.random.default_rng([SEED + self.archive.seed, self._rounds])
        for spread in _SPREADS:
            designs, objectives, leads = self._archive_with_leads()
            leading = np.flatnonzero(leads > 0.0)
            best = designs[leading[thinned(objectives[leading], THINNING)]]
            parents = np.vstack([best, *(candidate.point.y for candidate in self.efficient())])
            self._sample_around(parents, spread, _SAMPLE, rng)

    def _sample_around(self, designs: Array, spread: float, count: int, rng: np.random.Generator) -> None:
        """Add designs to the archive, normally distributed around some that are given."""
        parents = designs[rng.integers(len(designs), size=count)]
        self.archive.evaluate(np.clip(parents + spread * rng.standard_normal(parents.shape), 0.0, 1.0))

    def _archive_with_leads(self) -> tuple[Array, Array, Array]:
        """Return the archive's designs, their normalised objectives, and their leads over the efficient candidates."""
        designs, objectives = self.archive.feasible
        leads = self.archive.leads_over({candidate: candidate.objectives for candidate in self.efficient()})
        return designs, objectives, leads

    def candidate_beside(self, y: Array) -> FrontCandidate | None:
        """Return an optimum near a design of the archive, or None if there is none as good.

        It is sought at the position of the design, and then with each objective minimised in turn while the others are
        limited to their values at the design. The latter finds optima in narrow dips, where no design at the position
        itself is as good, and those that their position holds back.

        Args:
            y: scaled variables of the design.
        """
        front, fallback = self.front, None
        objectives = front.objectives(y)
        limited = (front.limited(k, objectives, OTHERS_WEIGHT) for k in range(front.count))
        for p in (self.parameters_at(objectives), *limited):
            candidate = self.no_worse_than(y, p)
            if candidate is not None and self.balances(candidate):
                return candidate
            fallback = fallback or candidate
        return fallback

    def follow_missed(self, *, sample: bool = True) -> None:
        """Follow the designs of the archive that the front misses, until only needles are left.

        Args:
            sample: whether to sample around the best designs first. It is done again after whatever shows that the
                front missed something.
        """
        for _ in range(_MOST_ROUNDS):
            if sample and self._samples_around:
                self.sample_around_best()
            sample = self.cross_over() | self._follow_missed_now()
            if not sample:
                return

    def cross_over(self) -> bool:
        """Start from what branches have in common; return whether that gave a candidate better than all others."""
        return False

    def follow_new(self, candidate: FrontCandidate | None, before: int) -> bool:
        """Follow the branch of a candidate if it is new.

        Args:
            candidate: the candidate, or None.
            before: number of candidates before it was found.

        Returns:
            Whether it is new and no other candidate is as good.
        """
        if candidate is None or len(self.candidates) == before:
            return False
        candidate.between = True
        best = not self.is_beaten(candidate)
        self.follow_everywhere(candidate)
        return best

    def _follow_missed_now(self) -> bool:
        """Follow the designs that the front misses now; return whether that gave a candidate better than all others."""
        improved = False
        for number in range(self.comparisons):
            missed = self.missed(self.tried)
            for k, y in enumerate(missed[: self.at_once]):
                done = (number + k / self.at_once) / self.comparisons
                self.progress("following designs that the front misses", done)
                self.tried.add(y.tobytes())
                before = len(self.candidates)
                improved |= self.follow_new(self.candidate_beside(y), before)
            if not missed:
                break
        return improved

    def is_beaten(self, candidate: FrontCandidate) -> bool:
        """Return whether some other candidate is better in one objective and, within what matters, no worse in any."""
        others = self.objectives_of([other for other in self.candidates if other is not candidate])
        no_worse = np.all(others <= candidate.objectives + MATTERS, axis=1)
        return bool(np.any(no_worse & np.any(others < candidate.objectives - MATTERS, axis=1)))

    def missed(self, excluded: set[bytes], *, sparse: bool = True) -> list[Array]:
        """Return designs of the archive that would improve the front, best first and at least `spacing` apart.

        Such a design leads the front, or dominates one of its points. There are none if only the basin of the guess is
        searched.

        Args:
            excluded: designs to leave out, as bytes. Those tried in vain would hide others near them.
            sparse: whether to add designs where the front has too few points.
        """
        if not self.archive.vary:
            return []
        designs, objectives, leads = self._archive_with_leads()
        front = self.objectives_of(self.efficient())
        left = np.flatnonzero(leads > SOUGHT)
        gain = self._gains(front, objectives, leads, left, sparse)
        best = np.empty(0, dtype=int)
        for _ in range(_MOST_JUDGEMENTS):
            left = left[gain[left] > self.matters]
            best = left[undominated(objectives[left], SOUGHT if len(left) < _MANY else self.matters)]
            best = best[[designs[k].tobytes() not in excluded for k in best]] if excluded else best
            best = best[np.argsort(-gain[best], kind="stable")][:_JUDGED_AT_ONCE]
            needles = self.archive.needles(designs[best], objectives[best])
            if not np.any(needles):
                break
            self.archive.exclude(best[needles])
            left, best = np.setdiff1d(left, best[needles]), best[~needles]
        return [designs[k] for k in apart(objectives, best, self.spacing)]

    def _gains(self, front: Array, objectives: Array, leads: Array, left: NDArray[np.intp], sparse: bool) -> Array:
        """Return how much a front would gain by each design of the archive; only those left are judged.

        Arguments are the normalised objectives of the front and of the designs, the designs' leads, and as in `missed`.
        """
        gain = np.zeros(len(objectives))
        large = left[leads[left] > self.matters]
        gain[large] = lead_over_front(front, objectives[large], self.step)
        # A design that dominates a point counts too, however little it leads the line or triangle next to that.
        strongest, by = strongest_dominators(front, objectives[left])
        better = left[strongest[by > SOUGHT]]
        gain[better] = np.maximum(gain[better], 2.0 * self.matters)
        if sparse:
            gain[left] = np.maximum(gain[left], self.uncovered(front, objectives[left]))
        return gain

    def uncovered(self, front: Array, objectives: Array) -> Array:
        """Return how far designs lie from every point where a front has too few; 0 for a curve, which has enough."""
        del front
        return np.zeros(len(objectives))

    def add_unconfirmed(self) -> None:
        """Add the missed designs without an optimum nearby, as they were simulated.

        Where an optimum is a needle, the best designs that can be made lie at its edge and are not optima.
        """
        added: set[bytes] = set()
        rng = np.random.default_rng([SEED + self.archive.seed, 0])
        for spread in _EDGE_SPREADS:
            if not (missed := self.missed(added, sparse=False)):
                return
            if self.archive.vectorised:
                self.progress("sampling around designs that are not optima", 0.0)
                self._sample_around(np.array(missed), spread, _EDGE_SAMPLE, rng)
        while missed := self.missed(added, sparse=False):
            for y in missed:
                added.add(y.tobytes())
                objectives = self.front.objectives(y)
                # The archive is integrated more roughly, and may be wrong about a design.
                if lead_over_points(self.objectives_of(self.efficient()), objectives[None])[0] > SOUGHT:
                    p = self.parameters_at(objectives)
                    point = point_as_found(self.front.program, p, y)
                    self.candidates.append(FrontCandidate(point, p, objectives, confirmed=False))
