"""Pictures of error against time: one panel for each question, on logarithmic axes.

Colours are those of Okabe and Ito (2008), which colour-blind readers can distinguish. Each method has its own marker.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

from plough_opt.core.files import COLOURS

_BLUE, _RED, _GREEN, _PINK, _ORANGE, _SKY, _GREY = COLOURS
_STYLES: Final[dict[str, tuple[str, str]]] = {
    "auto": ("#000000", "*"),
    "auto, compiled": ("#777777", "*"),
    "dop853": (_BLUE, "o"),
    "dop853, compiled": ("#000088", "o"),
    "erk": (_RED, "s"),
    "rosenbrock": (_GREEN, "^"),
    "cvodes": (_PINK, "v"),
    "idas": (_SKY, "D"),
    "collocation": (_ORANGE, "P"),
    "rk": (_GREY, "X"),
}
_MODELS: Final = {"quasi-static": "h", "linearised": "<", "harmonic balance": ">", "lasting orbit": "p"}
_SHAPES: Final = "D^v<>PXhp"
_FLOOR, _FRONT = "#DDDDDD", "#F0C808"
# Number of characters of a name above which the legend has one column.
_LONG_NAME: Final = 20
# Ratio of the times at the ends of an axis -> digits to number on an axis that spans less.
_DIGITS: Final = {6.0: (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0), 60.0: (1.0, 2.0, 5.0)}
# Smaller errors are drawn at this one, since 0 has no place on a logarithmic axis.
_LEAST: Final = 1e-19


Points = Sequence[tuple[float, float]]
"""Time [s] and relative error [-] of each entry."""


@dataclass(frozen=True)
class Panel:
    """Contents of a panel.

    Attributes:
        title: title of the panel.
        methods: name of a method -> its entries.
        front: efficient entries, from the fastest to the most exact.
        default: the default, or nothing.
        floor: relative error of the reference itself [-].
        wanted: wanted relative error [-].
    """

    title: str
    methods: Mapping[str, Points]
    front: Points
    default: Points
    floor: float
    wanted: float


def style_of(method: str, number: int) -> dict[str, Any]:
    """Return colour and marker of a method; for a method without a fixed style, those of a number."""
    if method in _STYLES:
        color, marker = _STYLES[method]
        return {"color": color, "marker": marker, "markersize": 9 if marker == "*" else 5.5}
    if method in _MODELS:
        return {"color": "#444444", "marker": _MODELS[method], "markersize": 7, "markerfacecolor": "white"}
    color, marker = COLOURS[number % len(COLOURS)], _SHAPES[number % len(_SHAPES)]
    # Hollow, so that it does not look like a method with a fixed style.
    return {"color": color, "marker": marker, "markersize": 6, "markerfacecolor": "white"}


def draw(axes: Axes, panel: Panel) -> dict[str, Line2D]:
    """Draw a panel; return the lines of its methods by name, for a legend."""
    lines: dict[str, Line2D] = {}
    front = [(seconds, max(error, panel.floor, _LEAST)) for seconds, error in panel.front]
    axes.step(*zip(*front, strict=True), where="post", color=_FRONT, linewidth=6.0, alpha=0.75, zorder=1,
              solid_capstyle="round", label="efficient front")  # fmt: skip
    for number, (method, points) in enumerate(panel.methods.items()):
        own = sorted(points, key=lambda point: -point[1])
        times, errors = [seconds for seconds, _ in own], [max(error, _LEAST) for _, error in own]
        (lines[method],) = axes.plot(times, errors, linewidth=1.0, zorder=3, label=method, **style_of(method, number))
    for seconds, error in panel.default:
        axes.plot(seconds, max(error, _LEAST), "o", markersize=15, markerfacecolor="none", markeredgecolor="black",
                  markeredgewidth=1.1, zorder=4)  # fmt: skip
    _dress(axes, panel)
    return lines


class _Times(LogLocator):
    """Ticks of a logarithmic axis. Powers of ten alone would leave a short axis a single number."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the ticks between two limits, or a little beyond."""
        digits = next((own for ratio, own in _DIGITS.items() if vmax < ratio * vmin), (1.0,))
        self.set_params(subs=digits)
        return super().tick_values(vmin, vmax)


def _dress(axes: Axes, panel: Panel) -> None:
    """Set scales, limits and labels, and draw the reference's own error and the wanted error."""
    axes.set(xscale="log", yscale="log", title=panel.title, xlabel="time of one use", ylabel="relative error")
    errors = [max(error, _LEAST) for points in panel.methods.values() for _, error in points]
    low = 10.0 ** math.floor(math.log10(min(panel.floor, *errors)) - 0.7)
    high = 10.0 ** math.ceil(math.log10(max(panel.wanted, *errors)) + 0.3)
    axes.set_ylim(low, high)
    axes.axhspan(_LEAST**2, panel.floor, facecolor=_FLOOR, edgecolor="#999999", hatch="///", linewidth=0.0, zorder=0)
    axes.axhline(panel.wanted, color="black", linestyle=(0, (4, 3)), linewidth=1.0, zorder=2)
    axes.xaxis.set_major_locator(_Times(numticks=8))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.grid(alpha=0.25)


def legend(target: Axes | Figure, lines: dict[str, Line2D], **where: Any) -> None:
    """Add a legend for methods, front, wanted error, default, and the reference's own error."""
    handles: list[Any] = [
        *lines.values(),
        Line2D([], [], color=_FRONT, linewidth=6.0, alpha=0.75, label="efficient front"),
        Line2D([], [], color="black", linestyle=(0, (4, 3)), linewidth=1.0, label="wanted error"),
        Line2D([], [], linestyle="none", marker="o", markersize=13, markerfacecolor="none", markeredgecolor="black",
               label="the default"),
        Line2D([], [], color="#999999", linewidth=8.0, alpha=0.6, label="below the reference's own error"),
    ]  # fmt: skip
    target.legend(handles=handles, **where)


def figure_of(panels: Sequence[Panel], title: str = "") -> Figure:
    """Return a figure with a panel for each question, and a legend: below two panels, or else in its own panel."""
    columns = 2
    below = len(panels) == columns
    rows = math.ceil((len(panels) + (0 if below else 1)) / columns)
    figure = Figure(figsize=(5.4 * columns, 4.1 * rows + (1.1 if below else 0.0)), layout="constrained")
    places = list(figure.subplots(rows, columns).ravel())
    lines: dict[str, Line2D] = {}
    for axes, panel in zip(places, panels, strict=False):
        lines |= draw(axes, panel)
    for axes in places[len(panels) :]:
        axes.set_axis_off()
    longest = max(map(len, lines), default=0)
    ncols = 1 if longest > _LONG_NAME else 2
    if below:
        legend(figure, lines, loc="outside lower center", fontsize="small", ncols=2 * ncols, frameon=False)
    else:
        legend(places[len(panels)], lines, loc="center", fontsize="small", ncols=ncols, frameon=False)
    if title:
        figure.suptitle(title)
    return figure
