"""Archive of a trade-off's searches: every design tried, with all its objectives, to hold the front against.

The searches for the optimum of one objective, and for designs at a position between optima, evaluate all objectives of
each design. So whatever design they try can show what the front misses, and where to start to find it.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import NotConverged
from plough_opt.design.descents import descend
from plough_opt.design.effort import Search, effort_of, searched
from plough_opt.design.exploring import Explorer, Progress
from plough_opt.design.infeasible import feasible_from
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import FEASIBLE, Evaluations, Landscape
from plough_opt.design.sampling import SEED, evolved, sample
from plough_opt.design.tolerance import NEEDLE, boxes, ranking_criterion
from plough_opt.studies.tradeoff.domination import lead_over_points
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
        # Scaled variables and scaled objectives of the designs that meet the requirements, and those not yet appended.
        self._designs = np.empty((0, self._landscape.dimensions))
        self._objectives = np.empty((0, front.count))
        self._fresh: list[tuple[Vector, Vector]] = []
        self._samples: dict[bytes, tuple[Vector, Vector]] = {}
        self._medians: dict[bytes, Vector] = {}
        # Lead of each design over all optima that it was compared with, and these.
        self._leads = np.empty(0)
        self._compared: dict[Hashable, Vector] = {}
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

    def evaluate(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
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
        found = self.front.evaluate(points, finer, together)
        self.tried += len(points)
        if key:
            self._samples[key] = found
        if together == 1:
            self._archive(points, *found)
        return found

    def _archive(self, points: Vector, objectives: Vector, rows: Vector) -> None:
        """Add the designs that have a value and meet the design's own requirements."""
        program = self.front.program
        with np.errstate(all="ignore"):
            violations = self._landscape.violations(rows / np.array(program.scales)[np.array(program.owner)])
            violations[:, self._position] = 0.0
            good = np.all(np.isfinite(objectives), axis=1) & (violations.sum(axis=1) <= FEASIBLE)
        self._fresh.append((points[good], objectives[good]))

    @property
    def feasible(self) -> tuple[Vector, Vector]:
        """Scaled variables and normalised objectives of all designs that meet the requirements, a row each."""
        if self._fresh:
            designs, objectives = zip(*self._fresh, strict=True)
            self._designs = np.concatenate([self._designs, *designs])
            self._objectives = np.concatenate([self._objectives, *objectives])
            self._fresh = []
        return self._designs, self.front.normalised(self._objectives)

    def leads_over(self, optima: Mapping[Hashable, Vector]) -> Vector:
        """Return the lead of each feasible design over all optima, this time's and those of earlier calls.

        Leads are those of `lead_over_points`: infinite without an optimum, and -infinite for excluded designs.

        Args:
            optima: key that identifies an optimum -> its normalised objectives.
        """
        _, objectives = self.feasible
        fresh = {key: place for key, place in optima.items() if key not in self._compared}
        self._compared |= fresh
        known = len(self._leads)
        if fresh:
            over_fresh = lead_over_points(np.array(list(fresh.values())), objectives[:known])
            self._leads = np.minimum(self._leads, over_fresh)
        every = np.array(list(self._compared.values())).reshape(-1, self.front.count)
        self._leads = np.r_[self._leads, lead_over_points(every, objectives[known:])]
        return self._leads

    def exclude(self, needles: NDArray[np.intp]) -> None:
        """Give feasible designs, by their numbers, a lead of -infinity from now on, and count them as needles."""
        self._leads[needles] = -np.inf
        self.needles_beyond += len(needles)

    # --- searches ----------------------------------------------------------------------------------------

    def basin_minima(self, p: Vector) -> Evaluations:
        """Return the lowest design of each basin of an objective alone that may hold the best one, best first.

        Args:
            p: parameters of a subproblem without position constraints.

        Raises:
            InfeasibleDesign: no design was found that meets the requirements.
            NotConverged: no design has a value.
        """
        landscape = FrontLandscape(self, p)
        judged = ranking_criterion(landscape, "tolerance")
        explored = Explorer(
            landscape, self._start, self.vary, judged, self._effort, self._progress, self.seed
        ).explore()
        if not np.any(np.isfinite(explored.sample.merit)):
            raise NotConverged(
                f"none of {landscape.designs_tried} designs between the bounds has a value: tighten the bounds, or"
                " shorten the duration",
                "no value",
            )
        if not np.any(explored.minima.feasible):
            self._progress("looking for a design that meets the requirements", 0.0)
            y = feasible_from(landscape, explored, self._start)
            return descend(landscape, y)
        values = judged(explored.minima.points)
        limit = values.min() + _CAN_WIN * abs(values.min())
        best_first = np.argsort(values, kind="stable")
        return explored.minima.select([k for k in best_first if values[k] <= limit][:_MOST_BASINS])

    def evolved_at(self, p: Vector) -> list[Vector]:
        """Return the designs that evolution finds in a subproblem, one for each round of the effort.

        Empty if fewer than two variables are searched, or runs are integrated one by one, which takes too long.
        """
        landscape, own, found = FrontLandscape(self, p), list(self.vary), []
        if not self.vectorised or len(own) < 2:
            return []

        def whole(points: Vector) -> Vector:
            designs = np.repeat(self._start[None], len(points), axis=0)
            designs[:, own] = points
            return designs

        def merit(points: Vector) -> Vector:
            return landscape(whole(points)).merit

        for number in range(self._effort.rounds):
            # `basin_minima` begins with the same sample, which is cached.
            points, _ = sample(
                len(own), self._effort.designs, self._start[own], np.random.default_rng([SEED + self.seed, number])
            )
            merits = merit(points)
            if np.any(np.isfinite(merits)):
                best = points[np.argsort(merits, kind="stable")[: _DESIGNS_EACH * len(own)]]
                rng = np.random.default_rng([SEED + self.seed, number, 1])
                end = evolved(merit, best, _GENERATIONS, rng, from_best=True, alike=_CONVERGED)
                found.append(whole(end[None])[0])
        return found

    # --- tolerances --------------------------------------------------------------------------------------

    def medians(self, points: Vector) -> Vector | None:
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
            found = self.front.evaluate(around, 1.0, 1)[0]
            self.tried += len(around)
            found = np.where(np.isfinite(found), found, np.inf).reshape(len(part), -1, self.front.count)
            self._medians |= {keys[k]: median for k, median in zip(part, np.median(found, axis=1), strict=True)}
        return np.array([self._medians[key] for key in keys]).reshape(-1, self.front.count)

    def needles(self, points: Vector, objectives: Vector) -> NDArray[np.bool_]:
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
        own = self.front.scaled(objectives)
        needles: NDArray[np.bool_] = np.any(medians - own > NEEDLE * np.maximum(np.abs(own), self.front.span), axis=1)
        return needles


class FrontLandscape(Landscape):
    """Landscape of one subproblem, whose designs enter the archive with all their objectives."""

    def __init__(self, archive: Archive, p: Vector) -> None:
        """Use an archive, and the parameters of a subproblem."""
        super().__init__(archive.front.program, p)
        self._archive, self._subproblem = archive, archive.front.subproblem(p)

    def rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the scaled objective and requirements of the subproblem, a row for each design."""
        self.designs_tried += len(points)
        objectives, g = self._archive.evaluate(points, finer=finer, together=together)
        weights, normals, limits = self._subproblem
        g = g.copy()
        g[:, self._archive.front.position_rows] = objectives @ normals.T - limits
        return weights[0] + objectives @ weights[1:], g / self._scale
