"""A front as a picture: the objectives, and how each variable moves along them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import NDArray

from plough_opt.core.files import COLOURS
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff.certificate import FrontPoint
from plough_opt.studies.tradeoff.goal import Axis

MUTED: Final = "#A8A8A8"
_BEATEN: Final = "local optima, dominated"
# Of the front itself [inch].
_WIDTH: Final = 7.0
# Of a variable's bounds.
_LEAST_RANGE: Final = 0.02
# Of an objective's value: an axis shows no less, and no more ticks than fit beside each other.
_LEAST_CHANGE: Final = 0.01
_TICKS: Final = 6
# Of a variable's size: what changes less along a front is the optimiser's rounding.
_CONSTANT: Final = 1e-4


@dataclass(frozen=True)
class Drawing:
    """The parts of a front that are drawn.

    Attributes:
        title: above everything.
        goals: the objectives.
        variables: a panel each.
        points: efficient designs in order.
        dominated: local optima that are not.
        parts: numbers of the points of each connected part.
        knee: a point that stands out, or None.
        displays: name of an objective or a variable -> unit in which it is drawn.
    """

    title: str
    goals: tuple[Axis, ...]
    variables: tuple[Axis, ...]
    points: tuple[FrontPoint, ...]
    dominated: tuple[FrontPoint, ...]
    parts: tuple[tuple[int, ...], ...]
    knee: FrontPoint | None
    displays: Mapping[str, Display] = field(default_factory=dict)

    def display(self, axis: Axis) -> Display:
        """Return the unit in which an objective or a variable is drawn."""
        return self.displays.get(axis.name) or Display(axis.unit, 1.0)

    def label(self, axis: Axis) -> str:
        """Return an objective's or a variable's name and unit."""
        return self.display(axis).heading(called(axis.name))

    @property
    def varying(self) -> tuple[Axis, ...]:
        """The variables that change along the front, or all where none does."""
        columns = {v: np.array([point.variables[v.name] for point in self.points]) for v in self.variables}
        found = (v for v, own in columns.items() if np.ptp(own) > _CONSTANT * np.max(np.abs(own)))
        return tuple(found) or self.variables

    @property
    def heading(self) -> str:
        """Heading: the title, and the variables that are the same in every design."""
        same = [v for v in self.variables if v not in self.varying]
        values = (self.display(v).text(self.points[0].variables[v.name], 4) for v in same)
        words = ", ".join(f"{called(v.name)} {value}" for v, value in zip(same, values, strict=True))
        return "\n".join(part for part in (self.title, f"{words} in every design" if words else "") if part)


def figure_of(front: Drawing) -> Figure:
    """Return the front beside a panel for each variable."""

    def place(left: SubFigure) -> None:
        draw_front(left.subplots(), front)

    figure, panels = beside_panels(front, front.varying, (3.6, 1.75), 5.2, place, _draw_variable)
    for axes in panels[-1]:
        axes.set_xlabel(front.label(front.goals[0]))
        _plain(axes, places_of(front.points, front)[:, 0], "x")
    return figure


def beside_panels(
    front: Drawing,
    axes_of: Sequence[Axis],
    size: tuple[float, float],
    least: float,
    place: Callable[[SubFigure], None],
    draw: Callable[[Axes, Drawing, Axis], None],
    **shared: bool,
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure with the front and a panel for each variable on its right, and the panels.

    Args:
        front: what is drawn.
        axes_of: what has a panel.
        size: width and height of a panel [inch].
        least: height of the figure [inch].
        place: draws the front itself.
        draw: draws a variable on its panel.
        shared: further arguments of ``subplots``.
    """
    count = len(axes_of)
    columns = 1 if count <= 3 else 2
    rows = math.ceil(count / columns)
    width = size[0] * columns
    figure = Figure(figsize=(_WIDTH + width, max(least, size[1] * rows)), layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(_WIDTH, width))[0]
    place(left)
    panels = right.subplots(rows, columns, sharex=True, squeeze=False, **shared)
    for k, axes in enumerate(panels.T.ravel()):
        if k < count:
            draw(axes, front, axes_of[k])
        else:
            axes.set_axis_off()
    if front.heading:
        figure.suptitle(front.heading)
    return figure, panels


def draw_front(axes: Axes, front: Drawing) -> None:
    """Draw the parts of a front, its holes, its knee, and the local optima that it dominates."""
    first, second = front.goals
    beaten = places_of(front.dominated, front)
    if len(beaten):
        axes.plot(beaten[:, 0], beaten[:, 1], "x", color=MUTED, markersize=4.5, zorder=2,
                  label=_BEATEN)  # fmt: skip
    places = places_of(front.points, front)
    for number, part in enumerate(front.parts):
        own = places[list(part)]
        label = "front" if len(front.parts) == 1 else f"front, part {number + 1}"
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(own[:, 0], own[:, 1], "o-", color=colour, markersize=4, linewidth=1.3, zorder=4,
                  label=label)  # fmt: skip
    if len(open_ones := places[[not point.confirmed for point in front.points]]):
        axes.plot(open_ones[:, 0], open_ones[:, 1], "o", color="white", markersize=3, zorder=5, label="unconfirmed")
    for number, (before, after) in enumerate(zip(front.parts, front.parts[1:], strict=False)):
        ends = places[[before[-1], after[0]]]
        axes.plot(ends[:, 0], ends[:, 1], ":", color="black", linewidth=1.0, zorder=3,
                  label="hole: no efficient design" if number == 0 else None)  # fmt: skip
    if front.knee is not None:
        knee = places_of((front.knee,), front)[0]
        axes.plot(knee[0], knee[1], "*", color="black", markersize=13, zorder=5, label="knee")
    _limit(axes, places, beaten)
    (left, right), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    if not any(left <= x <= right and bottom <= y <= top for x, y in beaten):
        for line in axes.get_lines():
            if line.get_label() == _BEATEN:
                line.remove()
    axes.set(xlabel=front.label(first), ylabel=front.label(second))
    for along, values in zip("xy", places.T, strict=True):
        _plain(axes, values, along)
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")


def _limit(axes: Axes, places: np.ndarray, beaten: np.ndarray) -> None:
    """Show the front with half its range around it, however far dominated optima lie."""
    low, high = places.min(axis=0), places.max(axis=0)
    if not len(beaten) or not np.all(high > low):
        return
    pad = 0.5 * (high - low)
    least, most = (f(np.vstack([places, beaten]), axis=0) for f in (np.min, np.max))
    edge = 0.04 * (high - low)
    axes.set_xlim(max(low[0] - pad[0], least[0]) - edge[0], min(high[0] + pad[0], most[0]) + edge[0])
    axes.set_ylim(max(low[1] - pad[1], least[1]) - edge[1], min(high[1] + pad[1], most[1]) + edge[1])


def _plain(axes: Axes, values: np.ndarray, along: str) -> None:
    """Show whole numbers that do not touch along an axis, and what hardly changes as hardly changing.

    Args:
        axes: on which everything is drawn.
        values: the front's along it.
        along: "x" or "y".
    """
    low, high = axes.get_xlim() if along == "x" else axes.get_ylim()
    middle, least = (low + high) / 2.0, _LEAST_CHANGE * float(np.max(np.abs(values)))
    if high - low < least:
        (axes.set_xlim if along == "x" else axes.set_ylim)(middle - least / 2.0, middle + least / 2.0)
    axis = axes.xaxis if along == "x" else axes.yaxis
    axis.set_major_locator(MaxNLocator(_TICKS))
    axis.set_major_formatter(ScalarFormatter(useOffset=False))


def _draw_variable(axes: Axes, front: Drawing, variable: Axis) -> None:
    """Draw a variable along the first objective, its bounds where it comes near them."""
    factor = front.display(variable).factor
    values = np.array([point.variables[variable.name] for point in front.points]) / factor
    places = places_of(front.points, front)[:, 0]
    for number, part in enumerate(front.parts):
        own = list(part)
        axes.plot(places[own], values[own], "o-", color=COLOURS[number % len(COLOURS)], markersize=2.5, linewidth=1.2)
    if variable.log:
        axes.set_yscale("log")
    elif variable.lower is not None and variable.upper is not None:
        axes.set_ylim(*range_of(variable, values, factor, margin=0.1))
    low, high = axes.get_ylim()
    for bound in (variable.lower, variable.upper):
        if bound is not None and low < bound / factor < high:
            axes.axhline(bound / factor, color="black", linestyle="--", linewidth=0.8)
            axes.annotate("bound", (1.0, bound / factor), (-3, 2), xycoords=axes.get_yaxis_transform(), ha="right",
                          textcoords="offset points", fontsize="x-small")  # fmt: skip
    axes.set_ylabel(front.label(variable), fontsize="small")
    axes.grid(alpha=0.25)


def range_of(variable: Axis, values: np.ndarray, factor: float, margin: float = 0.0) -> tuple[float, float]:
    """Return the range in which a variable is drawn: what hardly moves is drawn as hardly moving.

    Args:
        variable: with its bounds.
        values: along the front, in the unit in which they are drawn.
        factor: that unit's size.
        margin: part of the range that is left free.
    """
    low, high = float(values.min()), float(values.max())
    if variable.log:
        return (low, high) if high > (1.0 + _LEAST_RANGE) * low else (low / 1.1, high * 1.1)
    least = 0.0
    if variable.lower is not None and variable.upper is not None:
        least = _LEAST_RANGE * (variable.upper - variable.lower) / factor
    middle, half = (high + low) / 2.0, max((0.5 + 0.5 * margin) * (high - low), least)
    return middle - half, middle + half


def places_of(points: Sequence[FrontPoint], front: Drawing) -> np.ndarray:
    """Return the objectives of points in the units in which they are drawn, a row each."""
    factors = [front.display(goal).factor for goal in front.goals]
    return np.array([point.objectives for point in points]).reshape(-1, len(factors)) / factors
