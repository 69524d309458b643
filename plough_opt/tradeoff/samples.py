"""Local optima of a trade-off: kept once each, and searched where a scan shows basins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from plough_opt.design.basin import first_optimum
from plough_opt.design.curvature import minimum_from
from plough_opt.design.ipopt import REMEDIES, Point, Vector
from plough_opt.design.search import SCAN_POINTS, Progress
from plough_opt.scene import Scene
from plough_opt.tradeoff.program import FrontProgram

# Weight of the other objectives in an anchor: what is indifferent to one objective is decided by the others.
OTHERS = 1e-4
# Two optima nearer than this, in normalised objectives and in scaled variables, are one.
_SAME_OBJECTIVES = 1e-6
_SAME_DESIGN = 1e-4
# Scaled designs nearer than this, but for the scanned variable, share a scan.
_SAME_GEOMETRY = 1e-3
# A violated requirement must outweigh any gain in the scaled objective, which is of order 1.
_PENALTY = 100.0
_ROUNDS = 3
_FEASIBLE = 1e-6
# A basin within so many tried positions of a known optimum is that optimum's.
_KNOWN = 2.0 / (SCAN_POINTS - 1)
# Roughly integrated optima nearer than this are one.
_ROUGHLY = 1e-2
_PLACES = np.linspace(0.0, 1.0, SCAN_POINTS)


@dataclass
class Sample:
    """A local optimum on some branch.

    Attributes:
        point: as the optimiser left it.
        p: parameters of the program that it is an optimum of.
        at: normalised objectives.
        level: of the program that found it.
        coarsest: level that suits its neighbours.
        swept: objectives in whose direction its branch has been followed from here.
        inward: at an end, an optimum and its parameters a little along the front, where the multipliers are unique.
        scenes: of its runs, with numbers, and how long each runs [s], once it is certified.
    """

    point: Point
    p: Vector
    at: Vector
    level: int = 0
    coarsest: int = 0
    swept: set[int] = field(default_factory=set)
    inward: tuple[Point, Vector] | None = None
    scenes: list[tuple[Scene, float]] = field(default_factory=list)


@dataclass(frozen=True)
class Failure:
    """A position without a certified design.

    Attributes:
        objectives: normalised objectives of the neighbour from which it was sought.
        reason: why it failed.
    """

    objectives: tuple[float, ...]
    reason: str


class Samples:
    """All local optima found, and how to find more."""

    def __init__(self, front: FrontProgram, scanned: Sequence[int], progress: Progress) -> None:
        """Take the program and the variables to scan."""
        self.front = front
        self.scanned = scanned
        self.told = progress
        self.found: list[Sample] = []
        self.failures: list[Failure] = []
        self._scans: list[tuple[int, Vector, Vector, Vector]] = []

    def anchors(self, p: Vector) -> list[Point]:
        """Return all local optima at parameters that set no position, best first.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no optimum was found.
        """
        return self.all_optima(p, [self.from_guess(p)])

    def from_guess(self, p: Vector) -> Point:
        """Return the local optimum to which the guess leads at parameters that set no position.

        Raises:
            InfeasibleDesign: no design meets the requirements.
            NotConverged: no optimum was found.
        """
        program = self.front.program
        self.told("solving from the guess", 0.0)
        first = self.front.levels[-1].solve(program.start(), p)
        if first.solved:
            first = self.front.solve(first, first.y, p)
        if not first.solved:
            first = first_optimum(program, p)
        return minimum_from(program, p, first)

    # --- solving -----------------------------------------------------------------------------------------

    def solve(self, near: Sample, start: Vector, p: Vector, *, told: bool = True) -> Sample | Point:
        """Return the optimum near a start as a sample, or where the optimiser stopped.

        Args:
            near: the sample whose multipliers and steps it starts with.
            start: scaled variables.
            p: parameters.
            told: whether a failure is reported.
        """
        point, level = self.optimum(near.point, start, p, near.coarsest)
        if point.solved:
            return self.kept(point, p, level)
        if told:
            self.fail(near, point)
        return point

    def optimum(self, at: Point, start: Vector, p: Vector, level: int, *, patient: bool = True) -> tuple[Point, int]:
        """Return the optimum near a start, integrated as finely as it needs, and the level that does so.

        Args:
            at: a neighbour, for its multipliers.
            start: scaled variables.
            p: parameters.
            level: to begin with.
            patient: as in `FrontProgram.solve`.
        """
        point = self.front.solve(at, start, p, level, patient=patient)
        while point.solved and level > 0 and not self.front.accurate(point.y, level):
            level -= 1
            point = self.front.solve(point, point.y, p, level)
        return point, level

    def kept(self, point: Point, p: Vector, level: int = 0) -> Sample:
        """Return a point's sample: an earlier one where the same design was found before."""
        at = self.front.normalised(self.front.objectives(point.y, level))
        places = np.array([other.at for other in self.found]).reshape(-1, len(at))
        for k in np.flatnonzero(np.max(np.abs(places - at), axis=1) < _SAME_OBJECTIVES):
            if np.max(np.abs(self.found[k].point.y - point.y)) < _SAME_DESIGN:
                return self.found[k]
        self.found.append(Sample(point, p, at, level, self.front.level_for(point.y)))
        return self.found[-1]

    def solve_again(self, samples: Sequence[Sample]) -> None:
        """Solve samples anew, from where they are, with all steps: the program has become finer."""
        for sample in samples:
            again = self.front.solve(sample.point, sample.point.y, sample.p)
            if again.solved:
                sample.point, sample.level = again, 0
                sample.at = self.front.normalised(self.front.objectives(again.y))

    def fail(self, near: Sample, point: Point) -> None:
        """Keep that the optimiser failed beside a sample, and why."""
        reason = REMEDIES.get(point.status, "the optimiser stopped without an optimum")
        failure = Failure(tuple(near.at.tolist()), f"{point.status}: {reason}")
        if failure not in self.failures:
            self.failures.append(failure)

    # --- searching ---------------------------------------------------------------------------------------

    def all_optima(self, p: Vector, known: Sequence[Point]) -> list[Point]:
        """Return all distinct local optima at parameters that scans lead to, best first.

        Args:
            p: parameters.
            known: local optima there, the first of which has the geometry of the first scan.
        """
        optima = [point for point in known if point.solved]
        for variable in self.scanned:
            visited: list[Vector] = []
            for _ in range(_ROUNDS):
                rests = [np.delete(point.y, variable) for point in optima]
                fresh = [k for k, rest in enumerate(rests)
                         if all(np.max(np.abs(rest - v), initial=0.0) > _ROUGHLY for v in visited)]  # fmt: skip
                if not fresh:
                    break
                visited.append(rests[fresh[0]])
                self._polish(p, optima, variable, optima[fresh[0]].y)
        return sorted(optima, key=lambda point: point.f)

    def _polish(self, p: Vector, optima: list[Point], variable: int, y: Vector) -> None:
        """Add the optima in the basins along a variable that are not among the known ones."""
        program, front = self.front.program, self.front
        rough = front.levels[-1]
        for start, feasible in self._basins(p, variable, y):
            if any(abs(point.y[variable] - start[variable]) < _KNOWN for point in optima):
                continue
            point = rough.correct(optima[0], start, p)
            if not (point.solved and abs(point.y[variable] - start[variable]) < _KNOWN):
                point = rough.solve(start, p, near=True)
            if feasible and not (point.solved and abs(point.y[variable] - start[variable]) < _KNOWN):
                # Without curvatures its first steps may be too long for a narrow basin.
                point = rough.solve(start, p, near=True, exact=True)
            if not point.solved or any(np.max(np.abs(point.y - other.y)) < _ROUGHLY for other in optima):
                continue
            point = minimum_from(program, p, front.solve(point, point.y, p))
            if point.solved and not any(np.max(np.abs(point.y - other.y)) < _SAME_DESIGN for other in optima):
                optima.append(point)

    def _basins(self, p: Vector, variable: int, y: Vector) -> list[tuple[Vector, bool]]:
        """Return a start in each basin along a variable, the most promising first, and whether it is feasible."""
        objectives, rows = self._scan(variable, y)
        program, (weights, normals, limits) = self.front.program, self.front.asked(p)
        beyond = np.maximum(program.low - rows, rows - program.high)
        beyond[:, self.front.rows] = objectives @ normals.T - limits
        violation = np.max(beyond, axis=1, initial=0.0)
        merit = weights[0] + objectives @ weights[1:] + _PENALTY * violation
        merit[~np.isfinite(merit)] = np.inf
        left, right = np.r_[np.inf, merit[:-1]], np.r_[merit[1:], np.inf]
        basins = np.flatnonzero((merit < left) & (merit <= right) & np.isfinite(merit))
        starts = np.repeat(y[None, :], len(basins), axis=0)
        starts[:, variable] = _PLACES[basins]
        order = np.argsort(merit[basins])
        return [(starts[k], bool(violation[basins[k]] <= _FEASIBLE)) for k in order]

    def _scan(self, variable: int, y: Vector) -> tuple[Vector, Vector]:
        """Return, roughly, scaled objectives and requirements along a variable, a row for each position."""
        rest = np.delete(y, variable)
        for known, place, objectives, rows in self._scans:
            if known == variable and np.max(np.abs(place - rest), initial=0.0) < _SAME_GEOMETRY:
                return objectives, rows
        self.told(f"scanning {self.front.program.declared.variables[variable].name}", 0.0)
        points = np.repeat(y[None, :], SCAN_POINTS, axis=0)
        points[:, variable] = _PLACES
        found = [self.front.roughly(point) for point in points]
        objectives, rows = (np.array(column) for column in zip(*found, strict=True))
        self._scans.append((variable, rest, objectives, rows))
        return objectives, rows
