"""Result of a trade-off: its front with tables, pictures and files."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from plough_opt.core.files import write_file
from plough_opt.core.kept import Keepable
from plough_opt.core.tables import Page, data_frame
from plough_opt.studies.tradeoff.front import Front, rate_of
from plough_opt.studies.tradeoff.goal import Axis
from plough_opt.studies.tradeoff.table import front_page

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class TradeOff(Keepable, Front):
    """A front of designs, from the best in the first objective on: a curve between two, a surface between three.

    Its attributes are those of `Front`.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> draft = po.Goal("draft", 5e4 * height**2, "N")
        >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
        >>> front = po.trade_off(design, draft, radius, points=5, search="local")
        >>> len(front.points)
        5
    """

    kind = "trade-off"

    def page(self) -> Page:
        """Return the front as a table by parts, its holes, what a little more costs, and what has no result."""
        return front_page(self)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each point: part, objectives and variables, SI; ``attrs["units"]`` has the units.

        Raises:
            InputError: pandas is not installed.
        """
        part_of = {k: number for number, part in enumerate(self.parts, start=1) for k in part}
        columns: dict[str, Any] = {"part": [part_of[k] for k in range(len(self.points))]}
        columns |= {goal.name: self.objectives[:, k] for k, goal in enumerate(self.goals)}
        columns |= {v.name: self.designs[:, k] for k, v in enumerate(self.variables)}
        return data_frame(columns, {axis.name: axis.unit for axis in (*self.goals, *self.variables)})

    @overload
    def plot(self, target: Axes) -> Axes: ...

    @overload
    def plot(self, target: str | Path | None = None) -> Figure: ...

    def plot(self, target: str | Path | Axes | None = None) -> Figure | Axes:
        """Draw the front beside how each variable moves along it; on given axes the front alone.

        Args:
            target: file to write (.png, .svg, .pdf), axes to draw on (of three objectives in space), or None.

        Raises:
            InputError: a file name without a known ending, or a place that cannot be written.
        """
        from plough_opt.core.files import save_figure
        from plough_opt.studies.tradeoff.picture import Drawing, draw_front, figure_of
        from plough_opt.studies.tradeoff.surface_picture import draw_surface, surface_figure

        own = {name: getattr(self, name) for name in Drawing.__dataclass_fields__ if name != "displays"}
        drawing = Drawing(**own, displays={axis.name: self.display(axis) for axis in (*self.goals, *self.variables)})
        flat = len(self.goals) == 2
        if target is not None and not isinstance(target, str | Path):
            (draw_front if flat else draw_surface)(target, drawing)
            return target
        figure = (figure_of if flat else surface_figure)(drawing)
        if target is not None:
            save_figure(figure, target)
        return figure

    def to_csv(self, path: str | Path) -> Path:
        """Write a table of all points, SI units, the efficient ones first.

        Raises:
            InputError: the place cannot be written.
        """
        text = StringIO()
        table = csv.writer(text, lineterminator="\n")
        margins = list(self.points[0].margins)
        pairs = [(of, by) for by in range(len(self.goals)) for of in range(by + 1, len(self.goals))]
        rates = (
            ["rate"] if len(pairs) == 1 else [f"{self.goals[of].name} per {self.goals[by].name}" for of, by in pairs]
        )
        table.writerow(["status", "part", *(_heading(axis) for axis in (*self.goals, *self.variables)), *rates,
                        *(f"margin of {name}" for name in margins), "active", "branch", "residual", "gap"])  # fmt: skip
        part_of = {k: number for number, part in enumerate(self.parts, start=1) for k in part}
        status_of = {True: "front", False: "unconfirmed"}
        rows = [(status_of[point.confirmed], part_of[k], point) for k, point in enumerate(self.points)]
        for status, part, point in (*rows, *(("dominated", "", point) for point in self.dominated)):
            values = [*point.objectives, *(point.variables[v.name] for v in self.variables)]
            found = [rate_of(point, of, by) for of, by in pairs]
            rates = ["" if rate is None else repr(rate) for rate in found]
            table.writerow([status, part, *map(repr, values), *rates, *(repr(point.margins[name]) for name in margins),
                            "; ".join(point.active), point.branch, repr(point.residual), repr(point.gap)])  # fmt: skip
        return write_file(path, "table", text.getvalue())


def _heading(axis: Axis) -> str:
    return f"{axis.name} [{axis.unit}]" if axis.unit else axis.name
