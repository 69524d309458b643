"""Starts for a front: the lowest designs of the basins of each objective alone, and of positions between these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plough_opt.core.errors import NotConverged
from plough_opt.design.effort import Effort, Search, effort_of, searched
from plough_opt.design.exploring import Explorer, Progress
from plough_opt.design.infeasible import feasible_from
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Seen
from plough_opt.design.sampling import SEED, evolved, lowest_around, sample
from plough_opt.design.tolerance import judgement
from plough_opt.studies.tradeoff.cloud import Cloud, FrontLandscape

# Judged values by which a bottom may be above the best and still be followed, and how many are.
_CAN_WIN, _MOST = 0.15, 3
# Of a position: low designs of the sample from which a descent begins where none evolve, else one; the population of
# an evolution by number of variables, its generations, and how alike all designs are when it has converged.
_LOW, _EACH, _GENERATIONS, _CONVERGED = 3, 6, 25, 0.01
# Two scaled designs nearer than this are one.
_SAME = 1e-3


class Searcher:
    """Looks over all variables that are searched.

    Attributes:
        cloud: what was looked at.
        vary: numbers of the variables that are searched; none where only the basin of the guess is asked for.
        designs: of a sample, in all rounds.
    """

    def __init__(self, cloud: Cloud, search: Search, progress: Progress) -> None:
        """Take a cloud, what `plough_opt.trade_off` was asked to search, and where to report.

        Raises:
            InputError: a name that is not a variable, or an invalid effort.
        """
        program = cloud.front.program
        self.cloud, self.progress = cloud, progress
        self.vary = searched(search, program.declared.variables)
        self._start = program.start()
        effort = effort_of(search, len(self.vary), program.population.runs, cloud.vectorised)
        self._effort = _shared(effort, cloud.front.count)
        self.designs = self._effort.designs * self._effort.rounds
        self._samples: dict[int, Vector] = {}

    def bottoms(self, p: Vector) -> Seen:
        """Return the lowest designs of the basins of an objective alone that can be best, the best first.

        Args:
            p: parameters that set no position.

        Raises:
            InfeasibleDesign: no design was found that meets the requirements.
            NotConverged: no design has a value.
        """
        landscape = self.cloud.landscape(p)
        judged = judgement(landscape, "tolerance")
        explored = Explorer(landscape, self._start, self.vary, judged, self.progress).explored(self._effort)
        if not np.any(np.isfinite(explored.sample.merit)):
            raise NotConverged(
                f"none of {landscape.tried} designs between the bounds has a value: tighten the bounds, or shorten the"
                " duration",
                "no value",
            )
        if not np.any(explored.bottoms.feasible):
            self.progress("looking for a design that meets the requirements", 0.0)
            y = feasible_from(landscape, explored, self._start)
            return landscape.descend(y) if landscape.vectorised else landscape(y[None])
        values = judged(explored.bottoms.points)
        limit = values.min() + _CAN_WIN * abs(values.min())
        return explored.bottoms.of([k for k in np.argsort(values, kind="stable") if values[k] <= limit][:_MOST])

    def basins_at(self, p: Vector) -> list[Vector]:
        """Return low designs at a position, a few for each round of the effort, the lowest first."""
        landscape = self.cloud.landscape(p)
        ends: list[Seen] = []
        for number in range(self._effort.rounds):
            points, rng = self._sampled(number)
            seen = landscape(self._whole(points))
            if not np.any(np.isfinite(seen.merit)):
                continue
            lowest, _ = lowest_around(points, seen.merit)
            evolves = landscape.vectorised and len(self.vary) > 1
            starts = [seen.points[k] for k in lowest[: _LOW if landscape.vectorised and not evolves else 1]]
            if evolves:
                starts.insert(0, self._evolved(landscape, points, seen.merit, rng))
            ends += [landscape.descend(y) if landscape.vectorised else landscape(y[None]) for y in starts]
        if not ends:
            return []
        found = ends[0].joined(*ends[1:])
        chosen: list[Vector] = []
        for k in np.argsort(found.merit, kind="stable"):
            if found.feasible[k] and all(np.max(np.abs(found.points[k] - other)) > _SAME for other in chosen):
                chosen.append(found.points[k])
        return chosen[: _MOST * self._effort.rounds]

    def _sampled(self, number: int) -> tuple[Vector, np.random.Generator]:
        """Return the sample of a round, which is that of `bottoms` too, and what is random after it."""
        if number not in self._samples:
            rng = np.random.default_rng([SEED, number])
            points, _ = sample(len(self.vary), self._effort.designs, self._start[list(self.vary)], rng)
            self._samples[number] = points
        return self._samples[number], np.random.default_rng([SEED, number, 1])

    def _evolved(self, landscape: FrontLandscape, points: Vector, merit: Vector, rng: np.random.Generator) -> Vector:
        """Return the best design of an evolution from the best of a sample."""
        best = np.argsort(merit, kind="stable")[: max(16, _EACH * points.shape[1])]
        found = evolved(
            lambda x: landscape(self._whole(x)).merit, points[best], _GENERATIONS, rng, from_best=True, alike=_CONVERGED
        )
        whole: Vector = self._whole(found[None])[0]
        return whole

    def _whole(self, points: Vector) -> Vector:
        """Return designs whose searched variables are given, the others at the start."""
        whole = np.repeat(self._start[None], len(points), axis=0)
        whole[:, list(self.vary)] = points
        return whole


def _shared(effort: Effort, count: int) -> Effort:
    """Return the effort of each of so many objectives; how likely further basins are is not asked of a front."""
    return replace(
        effort,
        followed=0,
        most_designs=None if effort.most_designs is None else max(1, effort.most_designs // count),
        seconds=None if effort.seconds is None else effort.seconds / count,
    )
