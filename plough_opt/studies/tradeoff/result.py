"""Result of a trade-off: the front with its tables, pictures and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from plough_opt.core.errors import listed
from plough_opt.core.files import write_file, written
from plough_opt.core.saving import Saveable
from plough_opt.core.tables import Column, Grid, Page, data_frame, write_rows
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff.front import Axis, Front, FrontPoint

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class TradeOff(Saveable, Front):
    """Front of designs, from the best in the first objective to the worst: a curve for two, a surface for three.

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
        """Return the front as a report: a table by parts, holes, costs at the knee, and positions without a design.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> len(front.page().parts[0].rows)
            5
        """
        everywhere = [name for name in self.points[0].active if all(name in point.active for point in self.points)]
        parts: list[Grid | str] = [_table(self, everywhere)]
        for hole in self.holes:
            start, end = (listed(self.cells(place)) for place in (hole.start, hole.end))
            doubt = "" if hole.settled else "; the optimiser failed inside, so designs may be missing"
            parts.append(f"Hole: no efficient design between {start}, and {end}{doubt}.")
        if self.knee is not None:
            number = self.points.index(self.knee)
            costs = "; ".join(self.in_words(number, of, by).partition(": ")[2] for of, by in self.pairs)
            parts.append(f"Knee (bold), at {listed(self.cells(self.knee.objectives))}: {costs}.")
        if everywhere:
            parts.append(f"Limits that decide every design: {', '.join(map(called, everywhere))}.")
        parts += [self.search] if self.search else []
        failures: dict[str, list[str]] = {}
        for failure in self.failures:
            # IPOPT's status stands before the colon.
            reason = failure.reason.partition(": ")[2] or failure.reason
            failures.setdefault(reason, []).append(listed(self.cells(failure.objectives)))
        parts += [f"No certified design near {'; '.join(places)}: {reason}." for reason, places in failures.items()]
        gap = max(point.gap for point in self.points)
        residual = max((point.residual for point in self.points if point.confirmed), default=0.0)
        footer = (
            f"{len(self.dominated)} further local optima are dominated, {len(self.needles)} are needles; first-order"
            f" conditions met to {residual:.0e}, gap to a tight integration {gap:.0e}; {self.seconds:.1f} s,"
            f" {self.building:.1f} s of them for building"
        )
        names = ", ".join(called(goal.name) for goal in self.goals)
        return Page(f"Front of {len(self.points)} designs: {names}", tuple(parts), self.notes, footer, self.title)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each point: part, objectives and variables in SI units; ``attrs["units"]`` has the units.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> front.to_dataframe()["radius"].round(6).tolist()
            [0.05, 0.114575, 0.166228, 0.210555, 0.25]
        """
        axes = (*self.goals, *self.variables)
        columns: dict[str, Any] = {"part": self.part_of}
        columns |= zip((axis.name for axis in axes), (*self.objectives.T, *self.designs.T), strict=True)
        return data_frame(columns, {axis.name: axis.unit for axis in axes})

    @overload
    def plot(self, target: Axes) -> Axes: ...

    @overload
    def plot(self, target: str | Path | None = None) -> Figure: ...

    def plot(self, target: str | Path | Axes | None = None) -> Figure | Axes:
        """Draw the front, and beside it how each variable changes along it; on given axes draw the front alone.

        Args:
            target: file to write (.png, .svg, .pdf), axes to draw on (3D axes for three objectives), or None.

        Raises:
            InputError: the file has no known picture format, or cannot be written.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> front.plot().axes[0].get_xlabel()
            'draft [kN]'
        """
        from plough_opt.studies.tradeoff.picture import draw_front, front_figure

        if target is not None and not isinstance(target, str | Path):
            draw_front(target, self)
            return target
        return written(front_figure(self), target)

    def to_csv(self, path: str | Path) -> Path:
        """Write a table of all points in SI units, the efficient ones first.

        Raises:
            InputError: the file cannot be written.

        Example:
            >>> import tempfile
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     print(len(front.to_csv(f"{folder}/front.csv").read_text().splitlines()))
            6
        """
        margins = list(self.points[0].margins)
        names = [goal.name for goal in self.goals]
        rates = ["rate"] if len(self.pairs) == 1 else [f"{names[of]} per {names[by]}" for of, by in self.pairs]
        table: list[list[object]] = [
            ["status", "part", *(_heading(axis) for axis in (*self.goals, *self.variables)), *rates,
             *(f"margin of {name}" for name in margins), "active", "branch", "residual", "gap"]
        ]  # fmt: skip
        rows: list[tuple[str, object, FrontPoint]] = [
            ("front" if point.confirmed else "unconfirmed", part, point)
            for part, point in zip(self.part_of, self.points, strict=True)
        ]
        for status, part, point in (*rows, *(("dominated", "", point) for point in self.dominated)):
            values = [*point.objectives, *(point.variables[v.name] for v in self.variables)]
            every = [point.rate_of(of, by) for of, by in self.pairs]
            rates = ["" if rate is None else repr(rate) for rate in every]
            table.append([status, part, *map(repr, values), *rates, *(repr(point.margins[name]) for name in margins),
                          "; ".join(point.active), point.branch, repr(point.residual), repr(point.gap)])  # fmt: skip
        text = StringIO()
        write_rows(text, table)
        return write_file(path, "table", text.getvalue())


def _heading(axis: Axis) -> str:
    return f"{axis.name} [{axis.unit}]" if axis.unit else axis.name


def _table(front: Front, everywhere: Sequence[str]) -> Grid:
    """Return the table of a front, with its knee in bold.

    Args:
        front: the front.
        everywhere: limits that are active in every design, and so are left out of the rows.
    """
    pairs, knee = front.pairs, front.knee
    more = [f"{'more' if goal.maximise else 'less'} {called(goal.name)}" for goal in front.goals]
    heads = ["1 % costs"] if len(pairs) == 1 else [f"cost ({letter})" for letter in "abc"]
    lines = [f"{head}: of {called(front.goals[of].name)} for 1 % {more[by]}"
             for head, (of, by) in zip(heads, pairs, strict=True)]  # fmt: skip
    limits = list(dict.fromkeys(name for point in front.points for name in point.active if name not in everywhere))
    if limits:
        lines.append("limits: " + ", ".join(f"{k} {called(name)}" for k, name in enumerate(limits, start=1)))
    axes = (*front.goals, *front.variables)
    displays = [front.display(axis) for axis in axes]
    headings = [display.heading(called(axis.name)) for axis, display in zip(axes, displays, strict=True)]
    # The table of a surface fits into 120 characters if each word of a heading has a line.
    between = " " if len(pairs) == 1 else "\n"
    columns = [
        Column(text.replace(" ", between), fold=True) for text in (*headings, *(f"{head} [%]" for head in heads))
    ]
    branches = any(point.branch for point in front.points)
    unconfirmed = not all(point.confirmed for point in front.points)
    columns += [Column("branch", left=True, fold=True)] if branches else []
    columns += [Column("status", left=True, fold=True)] if unconfirmed else []
    columns += [Column("limits", left=True)] if limits else []
    table = Grid(tuple(columns), caption="\n".join(lines))
    for part in front.parts:
        for k in part:
            point = front.points[k]
            values = [*point.objectives, *(point.variables[v.name] for v in front.variables)]
            cells = [display.number(float(value)) for value, display in zip(values, displays, strict=True)]
            cells += ["" if (cost := front.cost(k, *pair)) is None else f"{cost:.3g}" for pair in pairs]
            cells += [point.branch] if branches else []
            cells += ["" if point.confirmed else "unconfirmed"] if unconfirmed else []
            decided = " ".join(str(number) for number, name in enumerate(limits, start=1) if name in point.active)
            cells += [decided] if limits else []
            table.row(*cells, bold=point is knee, end=k == part[-1])
    return table
