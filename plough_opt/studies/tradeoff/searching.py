"""Starts for a front: the lowest designs of the basins of each objective alone, and of positions between these."""

from dataclasses import replace

import numpy as np

from plough_opt.core.errors import NotConverged
from plough_opt.design.descents import descend
from plough_opt.design.effort import Search, effort_of, searched
from plough_opt.design.exploring import Explorer, Progress
from plough_opt.design.infeasible import feasible_from
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Seen
from plough_opt.design.sampling import SEED, evolved, sample
from plough_opt.design.tolerance import judgement
from plough_opt.studies.tradeoff.archive import Archive

# Judged values by which a bottom may be above the best and still be followed, and how many are.
_CAN_WIN, _MOST = 0.15, 3
# Of an evolution at a position: designs for each variable, generations, and how alike all are when it has converged.
_EACH, _GENERATIONS, _CONVERGED = 6, 25, 0.01


class Searcher:
    """Looks over all variables that are searched.

    Attributes:
        archive: what was looked at.
        vary: numbers of the variables that are searched; none where only the basin of the guess is asked for.
    """

    def __init__(self, archive: Archive, search: Search, progress: Progress) -> None:
        """Take an archive, what `plough_opt.trade_off` was asked to search, and where to report.

        Raises:
            InputError: a name that is not a variable, or an invalid effort.
        """
        program, count = archive.front.program, archive.front.count
        self.archive, self._progress = archive, progress
        self.vary = searched(search, program.declared.variables)
        self._start = program.start()
        effort = effort_of(search, len(self.vary), program.population.runs, archive.vectorised)
        # Objectives share it; how likely further basins are is not asked of a front.
        self._effort = replace(
            effort,
            followed=0,
            most_designs=None if effort.most_designs is None else max(1, effort.most_designs // count),
            seconds=None if effort.seconds is None else effort.seconds / count,
        )

    def bottoms(self, p: Vector) -> Seen:
        """Return the lowest designs of the basins of an objective alone that can be best, the best first.

        Args:
            p: parameters that set no position.

        Raises:
            InfeasibleDesign: no design was found that meets the requirements.
            NotConverged: no design has a value.
        """
        landscape = self.archive.landscape(p)
        judged = judgement(landscape, "tolerance")
        explored = Explorer(landscape, self._start, self.vary, judged, self._effort, self._progress).explored()
        if not np.any(np.isfinite(explored.sample.merit)):
            raise NotConverged(
                f"none of {landscape.tried} designs between the bounds has a value: tighten the bounds, or shorten the"
                " duration",
                "no value",
            )
        if not np.any(explored.bottoms.feasible):
            self._progress("looking for a design that meets the requirements", 0.0)
            y = feasible_from(landscape, explored, self._start)
            return descend(landscape, y)
        values = judged(explored.bottoms.points)
        limit = values.min() + _CAN_WIN * abs(values.min())
        return explored.bottoms.of([k for k in np.argsort(values, kind="stable") if values[k] <= limit][:_MOST])

    def evolved_at(self, p: Vector) -> list[Vector]:
        """Return the designs to which evolutions from samples lead at a position, one for each round of the effort."""
        landscape, own = self.archive.landscape(p), list(self.vary)
        if not landscape.vectorised or len(own) < 2:
            return []

        def whole(points: Vector) -> Vector:
            designs = np.repeat(self._start[None], len(points), axis=0)
            designs[:, own] = points
            return designs

        found = []
        for number in range(self._effort.rounds):
            # That of `bottoms`, which is known.
            points, _ = sample(len(own), self._effort.designs, self._start[own], np.random.default_rng([SEED, number]))
            merit = landscape(whole(points)).merit
            best = np.argsort(merit, kind="stable")[: max(16, _EACH * len(own))]
            if np.any(np.isfinite(merit)):
                rng = np.random.default_rng([SEED, number, 1])
                end = evolved(
                    lambda x: landscape(whole(x)).merit,
                    points[best],
                    _GENERATIONS,
                    rng,
                    from_best=True,
                    alike=_CONVERGED,
                )
                found.append(whole(end[None])[0])
        return found
