"""Pictures of a front: a curve, or a surface in space, and beside it how each variable changes along or over it."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from matplotlib.tri import Triangulation

from plough_opt.core.files import COLOURS
from plough_opt.core.plain_data import Array
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff.front import ACROSS, Axis, Front, FrontPoint

_GREY: Final = "#A8A8A8"
_DOMINATED: Final = "local optima, dominated"
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
_CONSTANT: Final = 1e-4
# Triangles with a side longer than this many times the median lie across a hole.
_LONGEST_SIDE: Final = 3.0
_LEAST_CORNERS: Final = 3
# Direction of view in space [deg]: above the plane of the first two objectives, and aside from their diagonal.
_ELEVATION: Final = 22.0
_ASIDE: Final = 20.0
# Distance of the name of an axis in space from its ticks [points], and size of the cube in its panel. With these
# nothing touches or is cut off.
_LABEL_PAD: Final = 10.0
_ZOOM: Final = 0.85
_TICKS_IN_SPACE: Final = 5


def front_figure(front: Front) -> Figure:
    """Return a figure of the front, with panels for a third objective and for the variables that change along it."""
    varying = [v for v, values in zip(front.variables, front.designs.T, strict=True)
               if np.ptp(values) > _CONSTANT * np.max(np.abs(values))]  # fmt: skip
    varying = varying or list(front.variables)
    flat = len(front.goals) == 2
    panels = [*front.goals[2:], *varying]
    columns = 1 if len(panels) <= 3 else 2
    rows = math.ceil(len(panels) / columns)
    width, height, least = _PANEL_SIZES[len(front.goals)]
    figure = Figure(figsize=(_FRONT_WIDTH + width * columns, max(least, height * rows)), layout="constrained")
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


def draw_front(axes: Axes, front: Front) -> None:
    """Draw the parts of a front, its holes, its knee, and the local optima that it dominates.

    Args:
        axes: to draw on; 3D axes for three objectives.
        front: the front.
    """
    flat = len(front.goals) == 2
    places, beaten = _places(front, front.points), _places(front, front.dominated)
    if len(beaten):
        axes.plot(*beaten.T, "x", color=_GREY, markersize=4.5, zorder=2, label=_DOMINATED)
    for number, part in enumerate(front.parts):
        of_part, colour = places[list(part)], COLOURS[number % len(COLOURS)]
        for corners in [] if flat else _triangles(of_part):
            face = {"color": colour, "alpha": 0.35, "linewidth": 0.3, "edgecolor": colour}
            axes.plot_trisurf(*of_part.T, triangles=corners, **face)  # type: ignore[attr-defined]
        label = "front" if len(front.parts) == 1 else f"front, part {number + 1}"
        axes.plot(*of_part.T, "o-" if flat else "o", color=colour, markersize=4, linewidth=1.3, zorder=4, label=label)
    if len(unconfirmed := places[[not point.confirmed for point in front.points]]):
        axes.plot(*unconfirmed.T, "o", color="white", markersize=3, zorder=9, label="unconfirmed")
    if flat:
        _finish_curve(axes, front, places, beaten)
    else:
        _finish_surface(axes, front)
    if front.knee is not None:
        axes.plot(*_places(front, (front.knee,)).T, "*", color="black", markersize=13, zorder=9, label="knee")
    axes.legend(fontsize="small", loc="best" if flat else "upper left")


def _finish_curve(axes: Axes, front: Front, places: Array, beaten: Array) -> None:
    """Draw the holes of a curve, limit its axes, and label them."""
    for number, (before, after) in enumerate(pairwise(front.parts)):
        axes.plot(*places[[before[-1], after[0]]].T, ":", color="black", linewidth=1.0, zorder=3,
                  label="hole: no efficient design" if number == 0 else None)  # fmt: skip
    _limit(axes, places, beaten)
    (left, right), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    if not any(left <= x <= right and bottom <= y <= top for x, y in beaten):
        for line in axes.get_lines():
            if line.get_label() == _DOMINATED:
                line.remove()
    axes.set(xlabel=_label(front, front.goals[0]), ylabel=_label(front, front.goals[1]))
    for along, values in zip("xy", places.T, strict=True):
        _set_ticks(axes, values, along)
    axes.grid(alpha=0.25)


def _finish_surface(axes: Axes, front: Front) -> None:
    """Label the axes of a surface, and view it from the side where the first two objectives are better."""
    for along, goal in zip("xyz", front.goals, strict=True):
        getattr(axes, f"set_{along}label")(_label(front, goal), labelpad=_LABEL_PAD)
        getattr(axes, f"{along}axis").set_major_locator(MaxNLocator(_TICKS_IN_SPACE))
    axes.set_box_aspect(None, zoom=_ZOOM)  # type: ignore[call-arg]
    first, second = (goal.sign for goal in front.goals[:2])
    azimuth = math.degrees(math.atan2(-second, -first)) + _ASIDE
    axes.view_init(elev=_ELEVATION, azim=azimuth)  # type: ignore[attr-defined]


def _limit(axes: Axes, places: Array, beaten: Array) -> None:
    """Limit the axes to the front and half its range around it, however far away dominated optima lie."""
    low, high = places.min(axis=0), places.max(axis=0)
    if not len(beaten) or not np.all(high > low):
        return
    pad, edge = 0.5 * (high - low), 0.04 * (high - low)
    every = np.vstack([places, beaten])
    least, most = np.maximum(low - pad, every.min(axis=0)) - edge, np.minimum(high + pad, every.max(axis=0)) + edge
    axes.set(xlim=(least[0], most[0]), ylim=(least[1], most[1]))


def _set_ticks(axes: Axes, values: Array, along: str) -> None:
    """Number an axis without an offset and with space between numbers, over at least 1 % of its largest value.

    Args:
        axes: on which everything is drawn already.
        values: values of the front along the axis.
        along: "x" or "y".
    """
    low, high = axes.get_xlim() if along == "x" else axes.get_ylim()
    middle, least = (low + high) / 2.0, _LEAST_CHANGE * float(np.max(np.abs(values)))
    if high - low < least:
        (axes.set_xlim if along == "x" else axes.set_ylim)(middle - least / 2.0, middle + least / 2.0)
    axis = axes.xaxis if along == "x" else axes.yaxis
    axis.set_major_locator(MaxNLocator(_TICKS))
    axis.set_major_formatter(ScalarFormatter(useOffset=False))


def _draw_along(axes: Axes, front: Front, variable: Axis) -> None:
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
    """
    if len(places) < _LEAST_CORNERS:
        return []
    low, span = places.min(axis=0), np.ptp(places, axis=0)
    flat = (places - low) / np.where(span > 0.0, span, 1.0) @ ACROSS
    if np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-6) < 2:
        return []
    corners = Triangulation(*flat.T).triangles
    sides = np.linalg.norm(flat[corners] - flat[np.roll(corners, 1, axis=1)], axis=2)
    short = np.max(sides, axis=1) < _LONGEST_SIDE * np.median(sides)
    return [corners[short]] if np.any(short) else []


def _draw_over(axes: Axes, front: Front, axis: Axis) -> None:
    """Draw a variable, or the third objective, as the colour of the points over the first two objectives."""
    values = _values(front, axis)
    places = _places(front, front.points)
    low, high = _range(axis, values, front.display(axis).factor)
    norm = LogNorm(low, high) if axis.log else Normalize(low, high)
    drawn = axes.scatter(places[:, 0], places[:, 1], c=values, norm=norm, cmap="viridis", s=22)
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
    least = 0.0
    if axis.lower is not None and axis.upper is not None:
        least = _LEAST_RANGE * (axis.upper - axis.lower) / factor
    middle, half = (high + low) / 2.0, max((0.5 + 0.5 * margin) * (high - low), least)
    return middle - half, middle + half


def _places(front: Front, points: Sequence[FrontPoint]) -> Array:
    """Return the objectives of points in the units shown, a row each."""
    factors = [front.display(goal).factor for goal in front.goals]
    return np.array([point.objectives for point in points]).reshape(-1, len(factors)) / factors


def _values(front: Front, axis: Axis) -> Array:
    """Return an objective or a variable of all points in the unit shown."""
    columns = dict(zip((*front.goals, *front.variables), (*front.objectives.T, *front.designs.T), strict=True))
    return np.asarray(columns[axis] / front.display(axis).factor)


def _label(front: Front, axis: Axis) -> str:
    return front.display(axis).heading(called(axis.name))


def _heading(front: Front, same: Sequence[Axis]) -> str:
    """Return the title, and the values of variables that are the same in every design."""
    values = [f"{called(v.name)} {front.display(v).text(front.points[0].variables[v.name], 4)}" for v in same]
    words = f"{', '.join(values)} in every design" if values else ""
    return "\n".join(part for part in (front.title, words) if part)
