"""A front: its objectives, its designs with their certificates, parts, holes, rates and costs in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from plough_opt.core.checks import NOT_NUMBERS, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, is_casadi
from plough_opt.core.saving import Origin, versions
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff import domination
from plough_opt.studies.tradeoff.domination import Array

# Scaled by objective and limits: with larger residuals a point is not an optimum, with larger violations not a design.
_RESIDUAL = 1e-6
_VIOLATED = 1e-6
# Relative curvatures above are none, or the rounding of none.
_BENDS_DOWN = -1e-6
# Rates are given for this change of an objective, which a front must span.
_ONE_PER_CENT = 0.01


@dataclass(frozen=True)
class Goal:
    """One objective of a trade-off.

    Attributes:
        name: what reports call it.
        expression: scalar CasADi expression of the design's variables.
        unit: its unit, for reports.
        maximise: whether more of it is better.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> po.Goal("draft", 5e4 * height**2, unit="N").sign
        1.0
    """

    name: str
    expression: Column = field(repr=False)
    unit: str = ""
    maximise: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(
                f"an objective's name = {shown(self.name)} must be a text that says what it is, as 'draft'"
            )
        if not is_casadi(self.expression) or isinstance(self.expression, ca.SX):
            raise InputError(f"the objective '{self.name}' is not an expression of a design's variables")
        if self.expression.numel() != 1:
            raise InputError(
                f"the objective '{self.name}' must be one number, not {self.expression.numel()}: sum or average it"
            )

    @property
    def sign(self) -> float:
        """1 for what is minimised, -1 for what is maximised."""
        return -1.0 if self.maximise else 1.0


@dataclass(frozen=True)
class Axis:
    """An objective or a variable, as reports and pictures need it.

    Attributes:
        name: as declared.
        unit: SI unit.
        maximise: whether more is better; False for a variable.
        log: whether a variable is scaled by its logarithm.
        lower: lower bound of a variable, None for an objective.
        upper: upper bound of a variable, None for an objective.
    """

    name: str
    unit: str
    maximise: bool = False
    log: bool = False
    lower: float | None = None
    upper: float | None = None

    @property
    def sign(self) -> float:
        """1 for what is minimised, -1 for what is maximised."""
        return -1.0 if self.maximise else 1.0


@dataclass(frozen=True)
class FrontPoint:
    """A design on the front, or one that others dominate: a local optimum of the one objective beside the other.

    Attributes:
        objectives: all, by the tightly integrated model, in their units.
        variables: name -> value, SI units.
        margins: name of each requirement -> distance of its worst value from its limit, positive inside, in its unit.
        active: names of the requirements and variables whose limits decide the design.
        rate: of two objectives, change of the second per change of the first along the front, in their units; None of
            a design that stands alone or is not on the front.
        branch: of a design on the front, under a strength wave, "soft" or "stiff", by the natural frequency beside the
            wave's; else "".
        residual: of the first-order conditions, scaled.
        violation: largest violation of a requirement by the tightly integrated model, relative to its limit.
        gap: largest relative difference of the optimiser's objectives from the tightly integrated ones.
        curvature: least one of the Lagrangian where limits leave a direction, relative to the largest and roughly
            integrated; None where they leave none, and of a design that others dominate.
        weights: of the objectives per their units, by the multipliers: along the front changes so weighted add up to
            nothing. None of a design that stands alone.
        medians: of each objective over the design's tolerances, as a search integrates; None where runs are integrated
            one by one, which takes too long.
        needle: whether the median of some objective is worse than its own by more than 5 % of it and of its range over
            the front: no workshop can hit such a design.
        confirmed: whether it is certified as a local optimum; False of a design that is simulated and meets all
            requirements, and beside which the optimiser found no optimum that can be made.
    """

    objectives: tuple[float, ...]
    variables: dict[str, float]
    margins: dict[str, float]
    active: tuple[str, ...]
    rate: float | None
    branch: str
    residual: float
    violation: float
    gap: float
    curvature: float | None = None
    weights: tuple[float, ...] | None = None
    medians: tuple[float, ...] | None = None
    needle: bool = False
    confirmed: bool = True

    @property
    def doubt(self) -> str:
        """Why this does not belong to a front; empty where it does."""
        if self.confirmed and not self.residual <= _RESIDUAL:
            return f"the first-order conditions are met to {self.residual:.1e} only"
        if self.confirmed and self.curvature is not None and not self.curvature >= _BENDS_DOWN:
            return f"it is not a minimum: in a direction that no limit holds the curvature is {self.curvature:.1e}"
        if not self.violation <= _VIOLATED:
            return f"integrated tightly it violates a requirement by a relative {self.violation:.1e}"
        return ""

    def rate_of(self, of: int, by: int) -> float | None:
        """Return the change of an objective per change of another along the front; None without one."""
        if self.weights is None or not self.weights[of]:
            return None
        return -self.weights[by] / self.weights[of]


@dataclass(frozen=True)
class Failure:
    """A position without a certified design.

    Attributes:
        objectives: of the neighbour from which it was sought.
        reason: why it failed.
    """

    objectives: tuple[float, ...]
    reason: str


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
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of objectives: the number of the one that gives way, and of the one that gains."""
        count = len(self.goals)
        return [(of, by) for by in range(count) for of in range(by + 1, count)]

    @property
    def part_of(self) -> list[int]:
        """The part of every point, from 1 on."""
        found = {k: number for number, part in enumerate(self.parts, start=1) for k in part}
        return [found[k] for k in range(len(self.points))]

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
        whole = all(isinstance(k, int | np.integer) and not isinstance(k, bool) for k in (number, of, by))
        if not (whole and -len(self.points) <= number < len(self.points)):
            raise InputError(f"number = {shown(number)} must be that of a point, from 0 to {len(self.points) - 1}")
        if of == by or not {of, by} <= set(range(len(self.goals))):
            raise InputError(
                f"of = {shown(of)} and by = {shown(by)} must be two different objectives,"
                f" from 0 to {len(self.goals) - 1}"
            )
        return self.points[number].rate_of(of, by)

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
        cost, at = self.cost(number, of, by), self.points[number].objectives
        gains, gives = self.goals[by], self.goals[of]
        values = [f"{called(goal.name)} {cell}" for goal, cell in zip(self.goals, self.cells(at), strict=True)]
        place = f"at {', '.join(values[:-1])} and {values[-1]}"
        if cost is None and len(self.points) > 1 and self._change(by) < _ONE_PER_CENT:
            return f"{place}: the whole front changes {called(gains.name)} by {100.0 * self._change(by):.2g} % only"
        if cost is None:
            return f"{place}: no finite rate"
        more, costs = ("more" if gains.maximise else "less"), ("less" if gives.maximise else "more")
        return f"{place}: 1 % {more} {called(gains.name)} costs {cost:.3g} % {costs} {called(gives.name)}"

    @property
    def knee(self) -> FrontPoint | None:
        """The point farthest on the good side of the line, or the plane, of the front's ends; None where none is."""
        found = domination.knee(self.objectives * self._signs)
        return None if found is None else self.points[found]

    def hypervolume(self, reference: Sequence[float] | None = None) -> float:
        """Return the area, or the volume, that the front dominates, in the product of the objectives' units.

        Args:
            reference: the objectives at the far corner; default the worst of each on the front.

        Raises:
            InputError: another number of objectives.
        """
        front = self.objectives * self._signs
        if reference is None:
            return domination.volume(front, front.max(axis=0))
        try:
            corner = np.asarray(reference, dtype=float)
        except NOT_NUMBERS:
            corner = np.empty(0)
        if corner.shape != (len(self.goals),) or not np.all(np.isfinite(corner)):
            raise InputError(f"reference = {shown(reference)} must be {len(self.goals)} objectives, finite numbers")
        return domination.volume(front, corner * self._signs)

    @property
    def _signs(self) -> Array:
        """-1 for each objective that is maximised."""
        return np.array([goal.sign for goal in self.goals])

    def _change(self, objective: int) -> float:
        """Return by what part of its largest value an objective changes along the front."""
        values = self.objectives[:, objective]
        return float(np.ptp(values) / max(float(np.max(np.abs(values))), np.finfo(float).tiny))
