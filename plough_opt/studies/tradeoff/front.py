"""A front of designs: points, parts, holes, rates and costs in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from plough_opt.core.checks import NOT_NUMBERS, shown
from plough_opt.core.errors import InputError
from plough_opt.core.kept import Origin, versions
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff import plane, space
from plough_opt.studies.tradeoff.candidates import Failure
from plough_opt.studies.tradeoff.certificate import FrontPoint
from plough_opt.studies.tradeoff.domination import Array
from plough_opt.studies.tradeoff.goal import Axis

# Rates are given for this change of an objective, which a front must span.
_ONE_PER_CENT = 0.01


@dataclass(frozen=True)
class Hole:
    """Where the front is interrupted: no feasible design there that another does not dominate.

    Attributes:
        start: objectives at which a part ends.
        end: objectives at which the next part begins.
        settled: False where the optimiser failed within, so that designs may be missing.
    """

    start: tuple[float, ...]
    end: tuple[float, ...]
    settled: bool = True


@dataclass(frozen=True, repr=False)
class Front:
    """A front of designs, from the best in the first objective on: a curve between two, a surface between three.

    Attributes:
        title: of the question.
        goals: the objectives.
        variables: the design's variables.
        points: designs that no other dominates which was found: certified optima, and what is named as unconfirmed.
        dominated: certified local optima that some design beats in all objectives.
        failures: positions without a certified design, and why.
        parts: numbers of the points of each connected part.
        holes: between the parts.
        notes: what a reader of the numbers must know.
        search: what was looked at, in a sentence.
        needles: certified local optima that no workshop can hit, which are left out of the front.
        seconds: time taken.
        building: part of it that building the program took; little for one that was built before.
        versions: of packages, and the machine.
        origin: what made it.
    """

    title: str
    goals: tuple[Axis, ...]
    variables: tuple[Axis, ...]
    points: tuple[FrontPoint, ...]
    dominated: tuple[FrontPoint, ...]
    failures: tuple[Failure, ...]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[Hole, ...]
    notes: tuple[str, ...] = ()
    search: str = ""
    needles: tuple[FrontPoint, ...] = ()
    seconds: float = 0.0
    building: float = 0.0
    versions: Mapping[str, str] = field(default_factory=versions)
    origin: Origin = field(default=Origin(), compare=False)

    def cells(self, values: Sequence[float]) -> list[str]:
        """Return objectives as text, each in the unit of the question."""
        return [self.display(goal).text(x) for goal, x in zip(self.goals, values, strict=True)]

    def display(self, axis: Axis) -> Display:
        """Return the unit in which an objective or a variable is shown: one for all that have its SI unit."""
        columns = zip((*self.goals, *self.variables), (*self.objectives.T, *self.designs.T), strict=True)
        alike = {own.name: float(np.max(np.abs(values))) for own, values in columns if own.unit == axis.unit}
        return self.origin.displays.get(axis.name) or self.origin.common(axis.unit, alike)

    @property
    def objectives(self) -> Array:
        """The objectives of every point, shape (n, 2) or (n, 3), in their units."""
        return np.array([point.objectives for point in self.points])

    @property
    def designs(self) -> Array:
        """Every point's variables, shape (n, number of variables), SI units."""
        return np.array([[point.variables[v.name] for v in self.variables] for point in self.points])

    @property
    def rates(self) -> Array:
        """Change of the second objective per change of the first along the front at every point; NaN without one.

        Of three objectives the third is kept; `rate` has the other pairs.
        """
        return np.array([np.nan if (rate := self.rate(k)) is None else rate for k in range(len(self.points))])

    def rate(self, number: int, of: int = 1, by: int = 0) -> float | None:
        """Return the change of an objective per change of another along the front, a third one kept; None without.

        Args:
            number: of the point.
            of: number of the objective that gives way.
            by: number of the objective that changes.

        Raises:
            InputError: a point or an objective that there is not, or an objective by itself.
        """
        self._check(number, of, by)
        return rate_of(self.points[number], of, by)

    @property
    def knee(self) -> FrontPoint | None:
        """The point farthest on the good side of the line, or the plane, of the front's ends; None where none is."""
        found = plane.knee(self._minimised())
        return None if found is None else self.points[found]

    def hypervolume(self, reference: Sequence[float] | None = None) -> float:
        """Return the area, or the volume, that the front dominates, in the product of the objectives' units.

        Args:
            reference: the objectives at the far corner; default the worst of each on the front.

        Raises:
            InputError: another number of objectives.
        """
        front = self._minimised()
        corner = front.max(axis=0) if reference is None else self._corner(reference) * self._signs()
        return plane.area(front, corner) if len(self.goals) == 2 else space.volume(front, corner)

    def cost(self, number: int, of: int = 1, by: int = 0) -> float | None:
        """Return by how many per cent an objective gets worse for 1 % of another at a point.

        None where there is no rate, or where the whole front does not change the other one by 1 %.

        Args:
            number: of the point.
            of: number of the objective that gives way; default the second.
            by: number of the objective that gains; default the first.

        Raises:
            InputError: as `rate`.
        """
        self._check(number, of, by)
        rate, objectives = self.rate(number, of, by), self.points[number].objectives
        if rate is None or not (objectives[of] and objectives[by]) or self._change(by) < _ONE_PER_CENT:
            return None
        return abs(rate * objectives[by] / objectives[of])

    def in_words(self, number: int, of: int = 1, by: int = 0) -> str:
        """Return what a little more of one objective costs of another at a point.

        Args:
            number: of the point.
            of: number of the objective that gives way; default the second.
            by: number of the objective that gains; default the first.

        Raises:
            InputError: as `rate`.
        """
        self._check(number, of, by)
        gains, gives = self.goals[by], self.goals[of]
        at, cost = self.points[number].objectives, self.cost(number, of, by)
        values = [f"{called(goal.name)} {cell}" for goal, cell in zip(self.goals, self.cells(at), strict=True)]
        place = f"at {', '.join(values[:-1])} and {values[-1]}"
        if cost is None and len(self.points) > 1 and self._change(by) < _ONE_PER_CENT:
            return f"{place}: the whole front changes {called(gains.name)} by {100.0 * self._change(by):.2g} % only"
        if cost is None:
            return f"{place}: no finite rate"
        more, costs = ("more" if gains.maximise else "less"), ("less" if gives.maximise else "more")
        return f"{place}: 1 % {more} {called(gains.name)} costs {cost:.3g} % {costs} {called(gives.name)}"

    def _check(self, number: int, of: int, by: int) -> None:
        """Refuse numbers that are none of a point, or of two objectives."""
        whole = all(isinstance(k, int | np.integer) and not isinstance(k, bool) for k in (number, of, by))
        if not (whole and -len(self.points) <= number < len(self.points)):
            raise InputError(f"number = {shown(number)} must be that of a point, from 0 to {len(self.points) - 1}")
        if of == by or not {of, by} <= set(range(len(self.goals))):
            raise InputError(
                f"of = {shown(of)} and by = {shown(by)} must be two different objectives,"
                f" from 0 to {len(self.goals) - 1}"
            )

    def _change(self, objective: int) -> float:
        """Return by what part of its largest value an objective changes along the front."""
        values = self.objectives[:, objective]
        return float(np.ptp(values) / max(float(np.max(np.abs(values))), np.finfo(float).tiny))

    def _corner(self, reference: Sequence[float]) -> Array:
        try:
            found = np.asarray(reference, dtype=float)
        except NOT_NUMBERS:
            found = np.empty(0)
        if found.shape != (len(self.goals),) or not np.all(np.isfinite(found)):
            raise InputError(f"reference = {shown(reference)} must be {len(self.goals)} objectives, finite numbers")
        return found

    def _signs(self) -> Array:
        return np.array([goal.sign for goal in self.goals])

    def _minimised(self) -> Array:
        return self.objectives * self._signs()


def rate_of(point: FrontPoint, of: int, by: int) -> float | None:
    """Return the change of an objective per change of another along the front at a point; None without one."""
    if point.weights is None or not point.weights[of]:
        return None
    return -point.weights[by] / point.weights[of]
