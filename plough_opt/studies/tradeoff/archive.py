"""Designs of a front's searches: starts for it, and every design with all its objectives, to hold it against."""

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
from plough_opt.studies.tradeoff.domination import beyond_points
from plough_opt.studies.tradeoff.program import FrontProgram

# Factor on the steps of a search. Where a share oscillates fast on a stiff mount, those leave an error of a few parts
# in a thousand, which along a front is much; twice as many leave 1e-5.
_FINER = 2.0
# Looks at so many designs and more are kept whole: searches of several objectives begin with the same sample.
_A_SAMPLE = 200
# Designs that are held against their tolerances at once.
_MOST_JUDGED = 100
# Judged values by which a bottom may be above the best and still be followed, and how many are.
_CAN_WIN, _MOST = 0.15, 3
# Of an evolution at a position: designs for each variable, generations, and how alike all are when it has converged.
_EACH, _GENERATIONS, _CONVERGED = 6, 25, 0.01


class Archive:
    """All designs that were looked at, and the searches that look.

    Attributes:
        front: the program.
        vary: numbers of the variables that are searched; none where only the basin of the guess is wanted.
        tried: number of designs.
        vectorised: whether designs are looked at side by side.
        needles_beyond: number of needles that were seen beyond the front, those that others beat apart.
    """

    def __init__(self, front: FrontProgram, search: Search, progress: Progress) -> None:
        """Take a program whose scales are set, the `search` of `plough_opt.trade_off`, and where to report.

        Raises:
            InputError: a name that is not a variable, or an invalid effort.
        """
        self.front, self.tried, self._progress = front, 0, progress
        program = front.program
        self._bare = Landscape(program, front.nowhere())
        self.vectorised = self._bare.vectorised
        self._position = program.owner[front.rows[0]]
        # Scaled variables and objectives of the designs that meet the requirements.
        self._designs = np.empty((0, self._bare.dimensions))
        self._objectives = np.empty((0, front.count))
        self._fresh: list[tuple[Vector, Vector]] = []
        self._samples: dict[bytes, tuple[Vector, Vector]] = {}
        self._medians: dict[bytes, Vector] = {}
        # Of each design by how much it is better than all optima that it was held against, and these.
        self._beyond = np.empty(0)
        self._against: dict[Hashable, Vector] = {}
        self.needles_beyond = 0
        self.vary = searched(search, program.declared.variables)
        self._start = program.start()
        effort = effort_of(search, len(self.vary), program.population.runs, self.vectorised)
        # Objectives share it; a front does not say how likely further basins are.
        self._effort = replace(
            effort,
            followed=0,
            most_designs=None if effort.most_designs is None else max(1, effort.most_designs // front.count),
            seconds=None if effort.seconds is None else effort.seconds / front.count,
        )

    # --- looking -----------------------------------------------------------------------------------------

    def look(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return scaled objectives and all rows of requirements, in their units, of designs, a row for each.

        Args:
            points: scaled variables.
            finer: factor on the steps of the runs; less than 2 is 2.
            together: designs whose runs take equal numbers of steps.
        """
        finer = max(finer, _FINER)
        key = points.tobytes() if len(points) >= _A_SAMPLE and finer == _FINER and together == 1 else b""
        if key in self._samples:
            return self._samples[key]
        found = self.front.look(points, finer, together)
        self.tried += len(points)
        if key:
            self._samples[key] = found
        if together == 1:
            self._keep(points, *found)
        return found

    def _keep(self, points: Vector, objectives: Vector, rows: Vector) -> None:
        """Keep the designs that have a value and meet the design's own requirements."""
        program = self.front.program
        with np.errstate(all="ignore"):
            each = self._bare.violations(rows / np.array(program.scales)[np.array(program.owner)])
            each[:, self._position] = 0.0
            good = np.all(np.isfinite(objectives), axis=1) & (each.sum(axis=1) <= FEASIBLE)
        self._fresh.append((points[good], objectives[good]))

    @property
    def feasible(self) -> tuple[Vector, Vector]:
        """Scaled variables, and normalised objectives, of all designs that meet the requirements."""
        if self._fresh:
            designs, objectives = zip(*self._fresh, strict=True)
            self._designs = np.concatenate([self._designs, *designs])
            self._objectives = np.concatenate([self._objectives, *objectives])
            self._fresh = []
        return self._designs, self.front.normalised(self._objectives)

    def beyond(self, optima: Mapping[Hashable, Vector]) -> Vector:
        """Return by how much each feasible design is better than all optima; infinite without one, less for needles.

        Args:
            optima: what stands for each -> its normalised objectives: of those that it was held against before none is
                taken away.
        """
        _, at = self.feasible
        fresh = {key: place for key, place in optima.items() if key not in self._against}
        self._against |= fresh
        known = len(self._beyond)
        if fresh:
            self._beyond = np.minimum(self._beyond, beyond_points(np.array(list(fresh.values())), at[:known]))
        every = np.array(list(self._against.values())).reshape(-1, self.front.count)
        self._beyond = np.r_[self._beyond, beyond_points(every, at[known:])]
        return self._beyond

    def leave_out(self, needles: NDArray[np.intp]) -> None:
        """Let feasible designs, by their numbers, be better than no optimum from now on."""
        self._beyond[needles] = -np.inf
        self.needles_beyond += len(needles)

    # --- starts ------------------------------------------------------------------------------------------

    def bottoms(self, p: Vector) -> Evaluations:
        """Return the lowest designs of the basins of an objective alone that can be best, the best first.

        Args:
            p: parameters that set no position.

        Raises:
            InfeasibleDesign: no design was found that meets the requirements.
            NotConverged: no design has a value.
        """
        landscape = FrontLandscape(self, p)
        judged = ranking_criterion(landscape, "tolerance")
        explored = Explorer(landscape, self._start, self.vary, judged, self._effort, self._progress).explore()
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
        return explored.minima.select([k for k in np.argsort(values, kind="stable") if values[k] <= limit][:_MOST])

    def evolved_at(self, p: Vector) -> list[Vector]:
        """Return the designs to which evolutions from samples lead at a position, one for each round of the effort."""
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
            # That of `bottoms`, which is known.
            points, _ = sample(len(own), self._effort.designs, self._start[own], np.random.default_rng([SEED, number]))
            merits = merit(points)
            if np.any(np.isfinite(merits)):
                best = points[np.argsort(merits, kind="stable")[: _EACH * len(own)]]
                rng = np.random.default_rng([SEED, number, 1])
                end = evolved(merit, best, _GENERATIONS, rng, from_best=True, alike=_CONVERGED)
                found.append(whole(end[None])[0])
        return found

    # --- designs as they are made --------------------------------------------------------------------------

    def medians(self, points: Vector) -> Vector | None:
        """Return the median of each scaled objective over the tolerances of designs, a row for each.

        Half of the designs without a value make it infinite; None where runs are integrated one by one, which takes
        too long.
        """
        if not self.vectorised:
            return None
        keys = [point.tobytes() for point in points]
        fresh = [k for k, key in enumerate(keys) if key not in self._medians]
        for first in range(0, len(fresh), _MOST_JUDGED):
            part = fresh[first : first + _MOST_JUDGED]
            around = boxes(self.front.program.declared.variables, points[part])
            found = self.front.look(around, 1.0, 1)[0]
            self.tried += len(around)
            found = np.where(np.isfinite(found), found, np.inf).reshape(len(part), -1, self.front.count)
            self._medians |= {keys[k]: median for k, median in zip(part, np.median(found, axis=1), strict=True)}
        return np.array([self._medians[key] for key in keys]).reshape(-1, self.front.count)

    def needles(self, points: Vector, at: Vector) -> NDArray[np.bool_]:
        """Return which designs no workshop can hit, none where that takes too long to look at.

        They are those whose median of some objective over the tolerances is above its own by more than 5 % of it and
        of its range over the front: less changes no decision.

        Args:
            points: scaled variables, a row for each.
            at: their normalised objectives.
        """
        medians = self.medians(points)
        if medians is None:
            return np.zeros(len(points), dtype=bool)
        own = self.front.scaled(at)
        needles: NDArray[np.bool_] = np.any(medians - own > NEEDLE * np.maximum(np.abs(own), self.front.span), axis=1)
        return needles


class FrontLandscape(Landscape):
    """A question of the front's program over the scaled variables, its designs kept with all their objectives."""

    def __init__(self, archive: Archive, p: Vector) -> None:
        """Take the archive that keeps the designs, and the parameters of the question."""
        super().__init__(archive.front.program, p)
        self._archive, self._question = archive, archive.front.question(p)

    def rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the scaled objective and requirements, a row for each design."""
        self.designs_tried += len(points)
        objectives, g = self._archive.look(points, finer=finer, together=together)
        weights, normals, limits = self._question
        g = g.copy()
        g[:, self._archive.front.rows] = objectives @ normals.T - limits
        return weights[0] + objectives @ weights[1:], g / self._scale
