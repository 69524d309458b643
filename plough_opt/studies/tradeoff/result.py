"""Result of a trade-off: the front with its tables, files and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np

from plough_opt.core.checks import array_of, shown
from plough_opt.core.errors import InputError, listed
from plough_opt.core.files import COLOURS, figure_of_size, written
from plough_opt.core.plain_data import Array
from plough_opt.core.saving import Origin, Saveable, versions
from plough_opt.core.tables import Column, Grid, Page, data_frame, write_table
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff.front import ACROSS, Axis, FrontPoint, Hole, MissingPoint, knee, volume

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Change of an objective for which costs are given; a front must span it.
_ONE_PER_CENT: Final = 0.01


@dataclass(frozen=True, repr=False, eq=False)
class TradeOff(Saveable):
    """Front of designs, from the best in the first objective to the worst: a curve for two, a surface for three.

    Attributes:
        title: title of the design question.
        goals: the objectives.
        variables: the design's variables.
        points: designs that no other design found dominates: certified optima, and designs marked as unconfirmed.
        dominated: certified local optima that some design beats in all objectives.
        failures: positions without a certified design, and the reasons.
        parts: numbers of the points in each connected part.
        holes: interruptions between the parts.
        notes: sentences that a reader of the numbers must know.
        search: a sentence on what was searched.
        needles: certified local optima that no workshop can hit; they are not part of the front.
        seconds: time taken [s].
        building: part of `seconds` spent on building the program; small if it was built before.
        versions: versions of packages, and the machine.
        origin: the question that the front answers.

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

    title: str
    goals: tuple[Axis, ...]
    variables: tuple[Axis, ...]
    points: tuple[FrontPoint, ...]
    dominated: tuple[FrontPoint, ...]
    failures: tuple[MissingPoint, ...]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[Hole, ...]
    notes: tuple[str, ...] = ()
    search: str = ""
    needles: tuple[FrontPoint, ...] = ()
    seconds: float = 0.0
    building: float = 0.0
    versions: Mapping[str, str] = field(default_factory=versions)
    origin: Origin = field(default=Origin())

    def cells(self, values: Sequence[float]) -> list[str]:
        """Return objectives as text, each in the unit of the design question.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> front.cells([2500.0, 0.1])
            ['2.5 kN', '100 mm']
        """
        return [self.display(goal).text(x) for goal, x in zip(self.goals, values, strict=True)]

    def display(self, axis: Axis) -> Display:
        """Return the unit in which an objective or a variable is shown; all that share an SI unit share it.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> front.display(front.goals[0]).text(2500.0)
            '2.5 kN'
        """
        alike = {other.name: float(np.max(np.abs(x))) for other, x in self.columns if other.unit == axis.unit}
        return self.origin.displays.get(axis.name) or self.origin.common(axis.unit, alike)

    @property
    def objectives(self) -> Array:
        """Objectives of all points, shape (n, 2) or (n, 3), in their units."""
        return np.array([point.objectives for point in self.points])

    @property
    def designs(self) -> Array:
        """Variables of all points, shape (n, number of variables), SI units."""
        return np.array([[point.variables[v.name] for v in self.variables] for point in self.points])

    @property
    def columns(self) -> list[tuple[Axis, Array]]:
        """Each objective and each variable with its values at all points, SI."""
        return [*zip((*self.goals, *self.variables), (*self.objectives.T, *self.designs.T), strict=True)]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of objectives: number of the one that gets worse, and of the one that gains."""
        count = len(self.goals)
        return [(of, by) for by in range(count) for of in range(by + 1, count)]

    @property
    def part_of(self) -> list[int]:
        """Number of each point's part, counted from 1."""
        numbers = {k: number for number, part in enumerate(self.parts, start=1) for k in part}
        return [numbers[k] for k in range(len(self.points))]

    @property
    def rates(self) -> Array:
        """Change of the second objective per change of the first along the front at each point; NaN if not finite.

        A third objective is held constant. `rate` gives the other pairs.
        """
        return np.array([np.nan if (rate := self.rate(k)) is None else rate for k in range(len(self.points))])

    def rate(self, number: int, of: int = 1, by: int = 0) -> float | None:
        """Return the change of one objective per change of another along the front, a third one held constant.

        Args:
            number: number of the point.
            of: number of the objective that responds; default the second.
            by: number of the objective that changes; default the first.

        Returns:
            The rate in the objectives' units; None if there is no finite one.

        Raises:
            InputError: `number` is not a point, or `of` and `by` are not two different objectives.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> f, r = front.objectives[2]
            >>> round(float(front.rate(2) * 2.0 * f / r), 6)  # of the root
            1.0
        """
        whole = all(isinstance(k, int | np.integer) and not isinstance(k, bool) for k in (number, of, by))
        if not (whole and -len(self.points) <= number < len(self.points)):
            raise InputError(f"number = {shown(number)} must be that of a point, from 0 to {len(self.points) - 1}")
        if of == by or not {of, by} <= set(range(len(self.goals))):
            last = len(self.goals) - 1
            raise InputError(
                f"of = {shown(of)} and by = {shown(by)} must be two different objectives, from 0 to {last}"
            )
        return self.points[number].rate_of(of, by)

    def cost(self, number: int, of: int = 1, by: int = 0) -> float | None:
        """Return by how many per cent one objective gets worse if another gains 1 % at a point.

        Args:
            number: number of the point.
            of: number of the objective that gets worse; default the second.
            by: number of the objective that gains; default the first.

        Returns:
            Per cent; None if there is no rate, one objective is 0, or the other changes by less than 1 % along the
            whole front.

        Raises:
            InputError: as for `rate`.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> round(front.cost(2), 6)  # the radius is proportional to the root of the draft
            0.5
        """
        rate, objectives = self.rate(number, of, by), self.points[number].objectives
        if rate is None or not (objectives[of] and objectives[by]) or self._change(by) < _ONE_PER_CENT:
            return None
        return abs(rate * objectives[by] / objectives[of])

    def in_words(self, number: int, of: int = 1, by: int = 0) -> str:
        """Return a sentence on what a gain in one objective costs in another at a point.

        Args:
            number: number of the point.
            of: number of the objective that gets worse; default the second.
            by: number of the objective that gains; default the first.

        Raises:
            InputError: as for `rate`.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> front.in_words(2)
            'at draft 5.5263 kN and radius 166.23 mm: 1 % less draft costs 0.5 % less radius'
        """
        cost, at = self.cost(number, of, by), self.points[number].objectives
        gains, gives = self.goals[by], self.goals[of]
        values = [f"{called(goal.name)} {cell}" for goal, cell in zip(self.goals, self.cells(at), strict=True)]
        place = f"at {listed(values)}"
        if cost is None and len(self.points) > 1 and self._change(by) < _ONE_PER_CENT:
            return f"{place}: the whole front changes {called(gains.name)} by only {100.0 * self._change(by):.2g} %"
        if cost is None:
            return f"{place}: no finite rate"
        more, costs = ("more" if gains.maximise else "less"), ("less" if gives.maximise else "more")
        return f"{place}: 1 % {more} {called(gains.name)} costs {cost:.3g} % {costs} {called(gives.name)}"

    @property
    def knee(self) -> FrontPoint | None:
        """Point farthest on the good side of the line or plane through the front's ends; None if none is there."""
        row = knee(self.objectives * self._signs)
        return None if row is None else self.points[row]

    def hypervolume(self, reference: Sequence[float] | None = None) -> float:
        """Return the area or volume that the front dominates, in the product of the objectives' units.

        Args:
            reference: objectives at the far corner; default the worst value of each on the front.

        Raises:
            InputError: `reference` is not one finite number for each objective.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> draft = po.Goal("draft", 5e4 * height**2, "N")
            >>> radius = po.Goal("radius", height / 2.0, "m", maximise=True)
            >>> front = po.trade_off(design, draft, radius, points=5, search="local")
            >>> 0.0 < front.hypervolume() < (12500.0 - 500.0) * (0.25 - 0.05)
            True
        """
        front = self.objectives * self._signs
        if reference is None:
            return volume(front, front.max(axis=0))
        shape = (len(self.goals),)
        wrong = f"reference = {{}} must be {len(self.goals)} objectives, finite numbers"
        corner = array_of(reference, wrong, lambda array: array.shape == shape and np.all(np.isfinite(array)))
        return volume(front, corner * self._signs)

    @property
    def _signs(self) -> Array:
        """-1 for each objective that is maximised."""
        return np.array([goal.sign for goal in self.goals])

    def _change(self, objective: int) -> float:
        """Return the range of an objective along the front, relative to its largest value."""
        values = self.objectives[:, objective]
        return float(np.ptp(values) / max(float(np.max(np.abs(values))), np.finfo(float).tiny))

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
        columns: dict[str, Any] = {axis.name: values for axis, values in self.columns}
        return data_frame({"part": self.part_of, **columns}, {axis.name: axis.unit for axis, _ in self.columns})

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
        margins, names = list(self.points[0].margins), [goal.name for goal in self.goals]
        columns = (Display(axis.unit, 1.0).heading(axis.name) for axis in (*self.goals, *self.variables))
        rates = ["rate"] if len(self.pairs) == 1 else [f"{names[of]} per {names[by]}" for of, by in self.pairs]
        limits = (f"margin of {name}" for name in margins)
        table: list[list[object]] = [
            ["status", "part", *columns, *rates, *limits, "active", "branch", "residual", "gap"]
        ]
        shown = [("front" if point.confirmed else "unconfirmed", str(part), point)
                 for part, point in zip(self.part_of, self.points, strict=True)]  # fmt: skip
        for status, part, point in (*shown, *(("dominated", "", point) for point in self.dominated)):
            numbers = (*point.objectives, *(point.variables[v.name] for v in self.variables))
            slopes = (point.rate_of(*pair) for pair in self.pairs)
            last = (*(point.margins[name] for name in margins), "; ".join(point.active), point.branch)
            table.append([status, part, *numbers, *slopes, *last, point.residual, point.gap])
        return write_table(path, table)


def _table(front: TradeOff, everywhere: Sequence[str]) -> Grid:
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
    # The table of a surface fits into 120 characters if each word of a heading has a line.
    between = " " if len(pairs) == 1 else "\n"
    columns: list[tuple[Column, list[str]]] = []
    for axis, values in front.columns:
        display = front.display(axis)
        heading = display.heading(called(axis.name)).replace(" ", between)
        columns.append((Column(heading, fold=True), [f"{x / display.factor:.5g}" for x in values.tolist()]))
    for head, pair in zip(heads, pairs, strict=True):
        costs = (front.cost(k, *pair) for k in range(len(front.points)))
        texts = ["" if cost is None else f"{cost:.3g}" for cost in costs]
        columns.append((Column(f"{head} [%]".replace(" ", between), fold=True), texts))
    numbers = [[str(k) for k, name in enumerate(limits, start=1) if name in point.active] for point in front.points]
    optional = (
        (Column("branch", left=True, fold=True), [point.branch for point in front.points]),
        (Column("status", left=True, fold=True), ["" if p.confirmed else "unconfirmed" for p in front.points]),
        (Column("limits", left=True), [*map(" ".join, numbers)]),
    )
    headings, cells = zip(*columns, *(column for column in optional if any(column[1])), strict=True)
    table, rows = Grid(headings, caption="\n".join(lines)), [*zip(*cells, strict=True)]
    for part in front.parts:
        for k in part:
            table.row(*rows[k], bold=front.points[k] is knee, end=k == part[-1])
    return table


# --- the picture: a curve, or a surface in space, and how each variable changes along or over it ---

_GREY: Final = "#A8A8A8"
# Width of the panel of the front [inch].
_FRONT_WIDTH: Final = 7.0
# By number of objectives: width and height of a variable's panel, and least height of the figure [inch].
_PANEL_SIZES: Final = {2: (3.6, 1.75, 5.2), 3: (4.2, 2.1, 5.6)}
# Least half range of a variable's axis as a fraction of the range between its bounds; on a logarithmic scale the
# margin beyond its values as a fraction of these. A variable that hardly changes then looks as if it hardly changes.
_LEAST_RANGE: Final = 0.02
# Least range of an objective's axis, relative to its value.
_LEAST_CHANGE: Final = 0.01
# Most ticks of an axis, so that their numbers do not touch.
_TICKS: Final = 6
# Relative range of a variable along the front below which it is constant except for the optimiser's rounding.
_UNCHANGED: Final = 1e-4
# Triangles with a side longer than this many times the median lie across a hole.
_LONGEST_SIDE: Final = 3.0
# Direction of view in space [deg]: above the plane of the first two objectives, and aside from their diagonal.
_ELEVATION: Final = 22.0
_ASIDE: Final = 20.0
# Distance of the name of an axis in space from its ticks [points], and size of the cube in its panel. With these
# nothing touches or is cut off.
_LABEL_PAD: Final = 10.0
_ZOOM: Final = 0.85
_TICKS_IN_SPACE: Final = 5


def front_figure(front: TradeOff) -> Figure:
    """Return a figure of the front, with panels for a third objective and for the variables that change along it."""
    varying = [v for v, values in zip(front.variables, front.designs.T, strict=True)
               if np.ptp(values) > _UNCHANGED * np.max(np.abs(values))]  # fmt: skip
    varying = varying or list(front.variables)
    flat = len(front.goals) == 2
    panels = [*front.goals[2:], *varying]
    columns = 1 if len(panels) <= 3 else 2
    rows = math.ceil(len(panels) / columns)
    width, height, least = _PANEL_SIZES[len(front.goals)]
    figure = figure_of_size(_FRONT_WIDTH + width * columns, max(least, height * rows))
    left, right = figure.subfigures(ncols=2, squeeze=False, width_ratios=(_FRONT_WIDTH, width * columns))[0]
    draw_front(left.add_subplot(projection=None if flat else "3d"), front)
    every = right.subplots(rows, columns, sharex=True, sharey=not flat, squeeze=False)
    for axes, axis in zip(every.T.ravel(), panels, strict=False):
        (_draw_along if flat else _draw_over)(axes, front, axis)
    for axes in every.T.ravel()[len(panels) :]:
        axes.set_axis_off()
    for axes in every[-1]:
        axes.set_xlabel(_label(front, front.goals[0]), fontsize=None if flat else "small")
        if flat:
            _set_ticks(axes, _places(front, front.points)[:, 0], "x")
    for axes in [] if flat else every[:, 0]:
        axes.set_ylabel(_label(front, front.goals[1]), fontsize="small")
    if heading := _heading(front, [v for v in front.variables if v not in varying]):
        figure.suptitle(heading)
    return figure


def draw_front(axes: Axes, front: TradeOff) -> None:
    """Draw the parts of a front, its holes, its knee, and the local optima that it dominates.

    Args:
        axes: to draw on; 3D axes for three objectives.
        front: the front.
    """
    flat = len(front.goals) == 2
    places, beaten = _places(front, front.points), _places(front, front.dominated)
    if flat:
        # However far away dominated optima lie, the front fills most of the picture.
        low, high = places.min(axis=0), places.max(axis=0)
        room = np.where(high > low, high - low, np.inf)
        beaten = beaten[np.all(np.abs(beaten - (low + high) / 2.0) <= room, axis=1)]
    if len(beaten):
        axes.plot(*beaten.T, "x", color=_GREY, markersize=4.5, zorder=2, label="local optima, dominated")
    for number, part in enumerate(front.parts):
        of_part, colour = places[list(part)], COLOURS[number % len(COLOURS)]
        for corners in [] if flat else _triangles(front._signs * of_part):
            face = {"color": colour, "alpha": 0.35, "linewidth": 0.3, "edgecolor": colour}
            axes.plot_trisurf(*of_part.T, triangles=corners, **face)  # type: ignore[attr-defined]
        label = "front" if len(front.parts) == 1 else f"front, part {number + 1}"
        axes.plot(*of_part.T, "o-" if flat else "o", color=colour, markersize=4, linewidth=1.3, zorder=4, label=label)
    if len(unconfirmed := places[[not point.confirmed for point in front.points]]):
        axes.plot(*unconfirmed.T, "o", color="white", markersize=3, zorder=9, label="unconfirmed")
    if flat:
        _finish_curve(axes, front, places)
    else:
        _finish_surface(axes, front)
    if front.knee is not None:
        axes.plot(*_places(front, (front.knee,)).T, "*", color="black", markersize=13, zorder=9, label="knee")
    axes.legend(fontsize="small", loc="best" if flat else "upper left")


def _finish_curve(axes: Axes, front: TradeOff, places: Array) -> None:
    """Draw the holes of a curve, and label its axes."""
    for number, (before, after) in enumerate(pairwise(front.parts)):
        axes.plot(*places[[before[-1], after[0]]].T, ":", color="black", linewidth=1.0, zorder=3,
                  label="hole: no efficient design" if number == 0 else None)  # fmt: skip
    axes.set(xlabel=_label(front, front.goals[0]), ylabel=_label(front, front.goals[1]))
    for along, values in zip("xy", places.T, strict=True):
        _set_ticks(axes, values, along)
    axes.grid(alpha=0.25)


def _finish_surface(axes: Axes, front: TradeOff) -> None:
    """Label the axes of a surface, and view it from the side where the first two objectives are better."""
    from matplotlib.ticker import MaxNLocator

    for along, goal in zip("xyz", front.goals, strict=True):
        getattr(axes, f"set_{along}label")(_label(front, goal), labelpad=_LABEL_PAD)
        getattr(axes, f"{along}axis").set_major_locator(MaxNLocator(_TICKS_IN_SPACE))
    axes.set_box_aspect(None, zoom=_ZOOM)  # type: ignore[call-arg]
    first, second = (goal.sign for goal in front.goals[:2])
    azimuth = math.degrees(math.atan2(-second, -first)) + _ASIDE
    axes.view_init(elev=_ELEVATION, azim=azimuth)  # type: ignore[attr-defined]


def _set_ticks(axes: Axes, values: Array, along: str) -> None:
    """Number an axis without an offset and with space between numbers, over at least 1 % of its largest value.

    Args:
        axes: on which everything is drawn already.
        values: values of the front along the axis.
        along: "x" or "y".
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    axis = axes.xaxis if along == "x" else axes.yaxis
    (low, high), least = axis.get_view_interval(), _LEAST_CHANGE * float(np.max(np.abs(values)))
    if high - low < least:
        axes.set(**{f"{along}lim": ((low + high - least) / 2.0, (low + high + least) / 2.0)})
    axis.set_major_locator(MaxNLocator(_TICKS))
    axis.set_major_formatter(ScalarFormatter(useOffset=False))


def _draw_along(axes: Axes, front: TradeOff, variable: Axis) -> None:
    """Draw a variable over the first objective, with those of its bounds that lie in the range shown."""
    values, factor = _values(front, variable), front.display(variable).factor
    places = _places(front, front.points)[:, 0]
    for number, part in enumerate(front.parts):
        rows = list(part)
        axes.plot(places[rows], values[rows], "o-", color=COLOURS[number % len(COLOURS)], markersize=2.5, linewidth=1.2)
    if variable.log:
        axes.set_yscale("log")
    else:
        axes.set_ylim(*_range(variable, values, factor, margin=0.1))
    low, high = axes.get_ylim()
    for bound in (variable.lower, variable.upper):
        if bound is not None and low < bound / factor < high:
            axes.axhline(bound / factor, color="black", linestyle="--", linewidth=0.8)
            axes.annotate("bound", (1.0, bound / factor), (-3, 2), xycoords=axes.get_yaxis_transform(), ha="right",
                          textcoords="offset points", fontsize="x-small")  # fmt: skip
    axes.set_ylabel(_label(front, variable), fontsize="small")
    axes.grid(alpha=0.25)


def _triangles(places: Array) -> list[np.ndarray]:
    """Return the corners of the triangles between the points of a part, as a list of one array, or of none for a line.

    The points are triangulated in a projection along the diagonal (1, 1, 1), in which no part of a front hides another.
    One or two points lie on a line too.
    """
    from matplotlib.tri import Triangulation

    low, span = places.min(axis=0), np.ptp(places, axis=0)
    flat = (places - low) / np.where(span > 0.0, span, 1.0) @ ACROSS
    if np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-6) < 2:
        return []
    corners = Triangulation(*flat.T).triangles
    sides = np.linalg.norm(flat[corners] - flat[np.roll(corners, 1, axis=1)], axis=2)
    short = np.max(sides, axis=1) < _LONGEST_SIDE * np.median(sides)
    return [corners[short]] if np.any(short) else []


def _draw_over(axes: Axes, front: TradeOff, axis: Axis) -> None:
    """Draw a variable, or the third objective, as the colour of the points over the first two objectives."""
    values = _values(front, axis)
    places = _places(front, front.points)
    low, high = _range(axis, values, front.display(axis).factor)
    scale = "log" if axis.log else "linear"
    drawn = axes.scatter(places[:, 0], places[:, 1], c=values, norm=scale, vmin=low, vmax=high, cmap="viridis", s=22)
    figure = axes.get_figure()
    assert figure is not None  # panels are drawn on one
    bar = figure.colorbar(drawn, ax=axes, pad=0.02)
    bar.set_label(_label(front, axis), fontsize="small")
    bar.ax.tick_params(labelsize="small")
    axes.grid(alpha=0.25)


def _range(axis: Axis, values: Array, factor: float, margin: float = 0.0) -> tuple[float, float]:
    """Return the range of an axis for a variable; if the variable hardly changes, the range is wider than that.

    Args:
        axis: variable with its bounds.
        values: values along the front, in the unit shown.
        factor: size of that unit.
        margin: part of the range to leave free.
    """
    low, high = float(values.min()), float(values.max())
    if axis.log:
        return low / (1.0 + _LEAST_RANGE), high * (1.0 + _LEAST_RANGE)
    least = _LEAST_RANGE * ((axis.upper or 0.0) - (axis.lower or 0.0)) / factor  # an objective has no bounds
    middle, half = (high + low) / 2.0, max((0.5 + 0.5 * margin) * (high - low), least)
    return middle - half, middle + half


def _places(front: TradeOff, points: Sequence[FrontPoint]) -> Array:
    """Return the objectives of points in the units shown, a row each."""
    factors = [front.display(goal).factor for goal in front.goals]
    return np.array([point.objectives for point in points]).reshape(-1, len(factors)) / factors


def _values(front: TradeOff, axis: Axis) -> Array:
    """Return an objective or a variable of all points in the unit shown."""
    return np.asarray(dict(front.columns)[axis] / front.display(axis).factor)


def _label(front: TradeOff, axis: Axis) -> str:
    return front.display(axis).heading(called(axis.name))


def _heading(front: TradeOff, same: Sequence[Axis]) -> str:
    """Return the title, and the values of variables that are the same in every design."""
    values = [f"{called(v.name)} {front.display(v).text(front.points[0].variables[v.name], 4)}" for v in same]
    words = f"{', '.join(values)} in every design" if values else ""
    return "\n".join(part for part in (front.title, words) if part)
