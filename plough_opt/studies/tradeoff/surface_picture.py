"""A front of three objectives as a picture: the surface, and how each variable moves over it."""

import math
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from plough_opt.core.files import COLOURS
from plough_opt.studies.tradeoff.domination import ACROSS
from plough_opt.studies.tradeoff.goal import Axis
from plough_opt.studies.tradeoff.picture import MUTED, Drawing, beside_panels, places_of, range_of

# Triangles with a side longer than so many times the usual one lie across a hole.
_LONGEST: Final = 3.0
_LEAST_CORNERS: Final = 3
# Of the view [deg].
_ABOVE: Final = 22.0
_ASIDE: Final = 20.0
# Between ticks and the name of an axis [points], and of the cube in its panel, so that nothing touches or is cut.
_ROOM: Final = 10.0
_ZOOM: Final = 0.85
_TICKS: Final = 5


def surface_figure(front: Drawing) -> Figure:
    """Return the surface beside panels over two objectives: of the third, and of each variable that varies."""

    def place(left: SubFigure) -> None:
        draw_surface(left.add_subplot(projection="3d"), front)

    figure, panels = beside_panels(
        front, (front.goals[2], *front.varying), (4.2, 2.1), 5.6, place, _draw_variable, sharey=True
    )
    for axes in panels[-1]:
        axes.set_xlabel(front.label(front.goals[0]), fontsize="small")
    for axes in panels[:, 0]:
        axes.set_ylabel(front.label(front.goals[1]), fontsize="small")
    return figure


def draw_surface(axes: Axes, front: Drawing) -> None:
    """Draw the parts of a surface, its knee, and the local optima that it dominates, on axes in space."""
    places = places_of(front.points, front)
    beaten = places_of(front.dominated, front)
    for number, part in enumerate(front.parts):
        own, colour = places[list(part)], COLOURS[number % len(COLOURS)]
        for corners in _triangles(own):
            axes.plot_trisurf(*own.T, triangles=corners, color=colour, alpha=0.35, linewidth=0.3, edgecolor=colour)  # type: ignore[attr-defined]
        label = "front" if len(front.parts) == 1 else f"front, part {number + 1}"
        axes.plot(*own.T, "o", color=colour, markersize=4, label=label)
    if len(open_ones := places[[not point.confirmed for point in front.points]]):
        axes.plot(*open_ones.T, "o", color="white", markersize=2.5, label="unconfirmed", zorder=9)
    if len(beaten):
        axes.plot(*beaten.T, "x", color=MUTED, markersize=4.5, label="local optima, dominated")
    if front.knee is not None:
        axes.plot(*places_of((front.knee,), front).T, "*", color="black", markersize=13, label="knee", zorder=9)
    for along, goal in zip("xyz", front.goals, strict=True):
        getattr(axes, f"set_{along}label")(front.label(goal), labelpad=_ROOM)
        getattr(axes, f"{along}axis").set_major_locator(MaxNLocator(_TICKS))
    axes.set_box_aspect(None, zoom=_ZOOM)  # type: ignore[call-arg]
    # From the side on which both of the first objectives are better, that is, before the surface.
    first, second = (goal.sign for goal in front.goals[:2])
    axes.view_init(elev=_ABOVE, azim=math.degrees(math.atan2(-second, -first)) + _ASIDE)  # type: ignore[attr-defined]
    axes.legend(fontsize="small", loc="upper left")


def _triangles(places: np.ndarray) -> list[np.ndarray]:
    """Return the corners of the triangles between a part's points, in a list that is empty for a part that is a line.

    They are seen along the diagonal on which all objectives grow, from which no part of a front hides another.
    """
    if len(places) < _LEAST_CORNERS:
        return []
    low, span = places.min(axis=0), np.ptp(places, axis=0)
    scaled = (places - low) / np.where(span > 0.0, span, 1.0)
    flat = scaled @ ACROSS
    if np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-6) < 2:
        return []
    corners = Triangulation(*flat.T).triangles
    sides = np.linalg.norm(flat[corners] - flat[np.roll(corners, 1, axis=1)], axis=2)
    short = np.max(sides, axis=1) < _LONGEST * np.median(sides)
    return [corners[short]] if np.any(short) else []


def _draw_variable(axes: Axes, front: Drawing, variable: Axis) -> None:
    """Draw a variable, or the third objective, as the colour of the points over the first two objectives."""
    factor = front.display(variable).factor
    if variable in front.goals:
        values = places_of(front.points, front)[:, front.goals.index(variable)]
    else:
        values = np.array([point.variables[variable.name] for point in front.points]) / factor
    places = places_of(front.points, front)
    low, high = range_of(variable, values, factor)
    norm = LogNorm(low, high) if variable.log else Normalize(low, high)
    drawn = axes.scatter(places[:, 0], places[:, 1], c=values, norm=norm, cmap="viridis", s=22)
    figure = axes.get_figure()
    assert figure is not None  # panels are drawn on one
    bar = figure.colorbar(drawn, ax=axes, pad=0.02)
    bar.set_label(front.label(variable), fontsize="small")
    bar.ax.tick_params(labelsize="small")
    axes.grid(alpha=0.25)
