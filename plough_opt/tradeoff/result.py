"""What a trade-off found: points, parts, holes, rates, sentences and files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

import numpy as np

from plough_opt.results import SCHEMA, Saved, read_saved, versions, write_text
from plough_opt.tradeoff import plane
from plough_opt.tradeoff.certificate import FrontPoint
from plough_opt.tradeoff.goal import Axis
from plough_opt.tradeoff.tracing import Failure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = plane.Array


@dataclass(frozen=True)
class Hole:
    """Where the front is interrupted: no feasible design there that another does not dominate.

    Attributes:
        start: objectives at which a part ends.
        end: objectives at which the next part begins.
        settled: False where the optimiser failed within, so that designs may be missing.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    settled: bool = True


@dataclass(frozen=True)
class TradeOff:
    """A front of designs, from the best in the first objective to the best in the second.

    Attributes:
        title: of the question.
        goals: the two objectives.
        variables: the design's variables.
        points: certified efficient designs.
        dominated: certified local optima that some design beats in both objectives.
        failures: positions without a certified design, and why.
        parts: numbers of the points of each connected part.
        holes: between the parts.
        notes: what a reader of the numbers must know.
        seconds: time taken.
        versions: of packages, and the machine.
    """

    title: str
    goals: tuple[Axis, Axis]
    variables: tuple[Axis, ...]
    points: tuple[FrontPoint, ...]
    dominated: tuple[FrontPoint, ...]
    failures: tuple[Failure, ...]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[Hole, ...]
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    versions: Mapping[str, str] = field(default_factory=versions)

    @property
    def objectives(self) -> Array:
        """Both objectives of every point, shape (n, 2), in their units."""
        return np.array([point.objectives for point in self.points])

    @property
    def designs(self) -> Array:
        """Every point's variables, shape (n, number of variables), SI units."""
        return np.array([[point.variables[v.name] for v in self.variables] for point in self.points])

    @property
    def rates(self) -> Array:
        """Change of the second objective per change of the first along the front at every point; NaN without one."""
        return np.array([np.nan if point.rate is None else point.rate for point in self.points])

    @property
    def knee(self) -> FrontPoint | None:
        """The point farthest on the good side of the line between the front's ends; None where none is."""
        found = plane.knee(self._minimised())
        return None if found is None else self.points[found]

    def hypervolume(self, reference: Sequence[float] | None = None) -> float:
        """Return the area that the front dominates, in the product of both units.

        Args:
            reference: both objectives at the far corner; default the worst of each on the front.
        """
        front = self._minimised()
        corner = front.max(axis=0) if reference is None else np.asarray(reference, dtype=float) * self._signs()
        return plane.area(front, corner)

    def cost(self, number: int) -> float | None:
        """Return by how many per cent the second objective gets worse for 1 % of the first at a point; None without.

        Args:
            number: of the point.
        """
        point = self.points[number]
        if point.rate is None or not all(point.objectives):
            return None
        return abs(point.rate * point.objectives[0] / point.objectives[1])

    def in_words(self, number: int) -> str:
        """Return what a little more of the first objective costs of the second at a point.

        Args:
            number: of the point.
        """
        first, second = self.goals
        at, cost = self.points[number].objectives, self.cost(number)
        place = f"at {_value(at[0], first)} and {_value(at[1], second)}"
        if cost is None:
            return f"{place}: no finite rate"
        more, costs = ("more" if first.maximise else "less"), ("less" if second.maximise else "more")
        return f"{place}: 1 % {more} {first.name} costs {cost:.3g} % {costs} {second.name}"

    def _signs(self) -> Array:
        return np.array([goal.sign for goal in self.goals])

    def _minimised(self) -> Array:
        return self.objectives * self._signs()

    # --- pictures and files --------------------------------------------------------------------------------

    @overload
    def plot(self, target: Axes) -> Axes: ...

    @overload
    def plot(self, target: str | Path | None = None) -> Figure: ...

    def plot(self, target: str | Path | Axes | None = None) -> Figure | Axes:
        """Draw the front beside how each variable moves along it; on given axes the front alone.

        Args:
            target: file to write (.png, .svg, .pdf), axes to draw on, or None.

        Raises:
            InputError: a file name without a known ending, or a place that cannot be written.
        """
        from plough_opt.picture_files import save
        from plough_opt.tradeoff.picture import Drawing, draw_front, figure_of

        own = {name: getattr(self, name) for name in Drawing.__dataclass_fields__}
        if target is not None and not isinstance(target, str | Path):
            draw_front(target, Drawing(**own))
            return target
        figure = figure_of(Drawing(**own))
        if target is not None:
            save(figure, target)
        return figure

    def to_json(self) -> str:
        """Return the front as JSON text with versions and a schema number."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return SavedTradeOff(layout=SCHEMA, **own).to_json()

    def save(self, path: str | Path) -> Path:
        """Write the front as JSON, making its folder.

        Raises:
            InputError: the place cannot be written.
        """
        return write_text(path, "front", self.to_json() + "\n")

    def to_csv(self, path: str | Path) -> Path:
        """Write a table of all points, SI units, the efficient ones first.

        Raises:
            InputError: the place cannot be written.
        """
        text = StringIO()
        table = csv.writer(text, lineterminator="\n")
        margins = list(self.points[0].margins)
        table.writerow(["status", "part", *(_heading(axis) for axis in (*self.goals, *self.variables)), "rate",
                        *(f"margin of {name}" for name in margins), "active", "branch", "residual", "gap"])  # fmt: skip
        part_of = {k: number for number, part in enumerate(self.parts, start=1) for k in part}
        rows = [("front", part_of[k], point) for k, point in enumerate(self.points)]
        for status, part, point in (*rows, *(("dominated", "", point) for point in self.dominated)):
            values = [*point.objectives, *(point.variables[v.name] for v in self.variables)]
            rate = "" if point.rate is None else repr(point.rate)
            table.writerow([status, part, *map(repr, values), rate, *(repr(point.margins[name]) for name in margins),
                            "; ".join(point.active), point.branch, repr(point.residual), repr(point.gap)])  # fmt: skip
        return write_text(path, "table", text.getvalue())

    @classmethod
    def load(cls, path: str | Path) -> TradeOff:
        """Read a front that `save` wrote.

        Raises:
            InputError: no such file, or not a front of this layout.
        """
        saved = read_saved(path, "front", "a front", SavedTradeOff.model_validate_json)
        return cls(**{name: getattr(saved, name) for name in cls.__dataclass_fields__})


class SavedTradeOff(Saved):
    """A front as JSON: SI units."""

    kind: Literal["trade-off"] = "trade-off"
    goals: tuple[Axis, Axis]
    variables: tuple[Axis, ...]
    points: tuple[FrontPoint, ...]
    dominated: tuple[FrontPoint, ...]
    failures: tuple[Failure, ...]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[Hole, ...]
    notes: tuple[str, ...]
    seconds: float


def _value(value: float, axis: Axis) -> str:
    return f"{axis.name} {value:.5g} {axis.unit}".rstrip()


def _heading(axis: Axis) -> str:
    return f"{axis.name} [{axis.unit}]" if axis.unit else axis.name
