"""Archive of a trade-off's searches: every design that they try, with all its objectives.

The search for the optimum of one objective evaluates the others, too. So whatever design it tries can show what the
front misses, and where to start to find it.
"""

from dataclasses import replace

import numpy as np

from plough_opt.core.errors import NotConverged
from plough_opt.core.plain_data import Array
from plough_opt.design.search.descent import descend
from plough_opt.design.search.effort import Search, effort_of, searched
from plough_opt.design.search.explore import Progress, explore
from plough_opt.design.search.feasible import feasible_designs, nearest_feasible
from plough_opt.design.search.landscape import SEED, Landscape, Violation, concatenated, even_points
from plough_opt.design.solving import near_optimum
from plough_opt.studies.tradeoff.front import leads, undominated
from plough_opt.studies.tradeoff.program import FrontProgram

MATTERS = 1e-3
"""Normalised difference of objectives that matters: a design that is better by less is just as good."""

# Factor on the number of steps of a search. A share that oscillates fast on a stiff mount has errors of a few parts in
# a thousand with the steps of a search, which is much along a front; twice as many leave 1e-5.
_FINER = 2.0
# Evaluations of this many designs or more are cached, because the searches of all objectives begin with one sample.
_CACHED = 200
# The lowest designs of an objective's search that are followed: how many, the least distance between them, and how far
# they may lie above the best, as a part of it.
_MOST_BASINS, _APART, _FOLLOWED = 3, 0.02, 0.15
# Normalised difference to which the best designs are thinned before others are compared with them or sampled around.
_THINNED = 1e-2
# Standard deviations of the samples around the best designs, in parts of the variables' ranges, and designs in each:
# enough to see the dips between the ripples of a force.
_SPREADS, _SAMPLE = (0.1, 0.03, 0.01, 0.003), 4096


class Archive:
    """All designs that were tried, and the searches that try them.

    Attributes:
        front: the program.
        progress: called with what is being done and the fraction done.
        tried: number of designs tried.
        vectorised: whether designs are integrated side by side.
        vary: numbers of the variables that are searched; empty if only the basin of the guess is wanted.
        rich: whether it shows how far the front reaches: not if runs are integrated one by one, nor near a guess.
    """

    def __init__(self, front: FrontProgram, search: Search, progress: Progress, seed: int) -> None:
        """Use a program whose scales are set; the other arguments are those of `plough_opt.trade_off`.

        Raises:
            InputError: `search` names an unknown variable, or is not a valid effort.
        """
        self.front, self.progress, self._seed, self.tried = front, progress, seed, 0
        self._rounds = self._pruned = 0
        program = front.program
        self._landscape = Landscape(program, front.neutral_parameters())
        self.vectorised = self._landscape.vectorised
        # Scaled variables and scaled objectives of the designs that meet the requirements.
        self._designs, self._objectives = np.empty((0, self._landscape.dimensions)), np.empty((0, front.count))
        self._samples: dict[bytes, tuple[Array, Array]] = {}
        self.vary = searched(search, program.declared.variables)
        self.rich = bool(self.vary) and self.vectorised
        effort = effort_of(search, len(self.vary), program.population.runs, self.vectorised)
        self._effort = replace(  # the objectives share it
            effort,
            most_designs=None if effort.most_designs is None else max(1, effort.most_designs // front.count),
            seconds=None if effort.seconds is None else effort.seconds / front.count,
        )

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
        objectives, rows = self.front.evaluate(points, finer, together)
        self.tried += len(points)
        if key:
            self._samples[key] = objectives, rows
        if together == 1:
            with np.errstate(all="ignore"):
                violations = self._landscape.violations(rows / self.front.program.row_scales)
                violations[:, self.front.program.owner[self.front.position_rows[0]]] = 0.0
                good = np.all(np.isfinite(objectives), axis=1) & (violations.sum(axis=1) <= Violation.allowed)
            self._designs = np.vstack([self._designs, points[good]])
            self._objectives = np.vstack([self._objectives, objectives[good]])
        return objectives, rows

    def best(self) -> tuple[Array, Array]:
        """Return the designs that no other clearly dominates: scaled variables and normalised objectives, a row each.

        All others are forgotten.
        """
        objectives = self.front.normalised(self._objectives)
        if len(objectives) == self._pruned:
            return self._designs, objectives
        good = leads(objectives[undominated(objectives, _THINNED)], objectives) > -MATTERS
        self._designs, self._objectives = self._designs[good], self._objectives[good]
        self._pruned = len(self._designs)
        return self._designs, objectives[good]

    def thinned(self) -> Array:
        """Return the scaled variables of the best designs, thinned to a moderate number."""
        designs, objectives = self.best()
        return designs[undominated(objectives, _THINNED)]

    # --- searches ----------------------------------------------------------------------------------------

    def lowest(self, p: Array) -> Array:
        """Return the lowest design of each basin of an objective alone that may hold the best one, best first.

        If only the basin of the guess is wanted, it is the end of a descent from the guess or the nearest feasible
        design.

        Args:
            p: parameters of a subproblem without position constraints.

        Raises:
            InfeasibleDesign: no design was found that meets the requirements.
            NotConverged: no design has a value.
        """
        landscape, start = _FrontLandscape(self, p), self.front.program.start()
        if not self.vary:
            if not self.vectorised:
                return near_optimum(landscape, start)[1].y[None]
            return descend(landscape, nearest_feasible(landscape, start)).points
        explored = explore(landscape, start, self.vary, self._effort, seed=self._seed, progress=self.progress)
        ends = explored.ends
        if not len(ends.f):
            none = f"none of {landscape.designs_tried} designs between the bounds has a value"
            raise NotConverged(f"{none}: tighten the bounds, or shorten the duration", "no value")
        if not ends.feasible[0]:
            self.progress("looking for a design that meets the requirements", 0.0)
            seen = concatenated([ends, explored.sample])
            met = feasible_designs(landscape, start, seen, seed=self._seed, progress=self.progress)
            ends = concatenated([*(descend(landscape, y) for y in met.points), met])
        ends = ends.distinct(_APART, _MOST_BASINS)
        return np.asarray(ends.points[ends.key <= ends.key[0] + _FOLLOWED * abs(ends.key[0])])

    def searched_at(self, p: Array) -> list[Array]:
        """Return the best designs that a short search finds in a subproblem.

        It begins with the sample of the other searches. There are none with a single variable, which that sample shows.
        """
        if not self.rich or len(self.vary) < 2:
            return []
        effort = replace(self._effort, rounds=1, most_designs=None, seconds=None, descents=12, followed=0, looks=3)
        landscape = _FrontLandscape(self, p)
        ends = explore(landscape, self.front.program.start(), self.vary, effort, seed=self._seed).ends
        return list(ends.points[:2])

    def sample_evenly(self) -> None:
        """Try some designs between all bounds."""
        self.evaluate(even_points(self._landscape.dimensions, 1024, np.random.default_rng(SEED)))

    def sample_around_best(self, others: Array) -> None:
        """Try designs around the best ones, and around others, at first far from them and then near."""
        self.progress("sampling around the best designs", 0.0)
        self._rounds += 1
        rng = np.random.default_rng([SEED + self._seed, self._rounds])
        for spread in _SPREADS:
            parents = np.vstack([self.thinned(), others])
            parents = parents[rng.integers(len(parents), size=_SAMPLE)]
            self.evaluate(np.clip(parents + spread * rng.standard_normal(parents.shape), 0.0, 1.0))


class _FrontLandscape(Landscape):
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
