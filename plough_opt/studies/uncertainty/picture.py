"""Picture of a result's spread over fresh samples, for several designs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from plough_opt.core.files import COLOURS

Vector = NDArray[np.float64]

_BINS = 60


@dataclass(frozen=True)
class Panel:
    """One result of the picture.

    Attributes:
        result: its name.
        label: of its axis, with its unit.
        factor: of that unit in SI units.
        at_least: lower limit in SI units, or None.
        at_most: upper limit, or None.
        unit: the unit that is shown.
    """

    result: str
    label: str
    factor: float = 1.0
    at_least: float | None = None
    at_most: float | None = None
    unit: str = ""


def plot_spread(designs: Mapping[str, Mapping[str, Vector]], panels: Sequence[Panel], title: str = "") -> Figure:
    """Draw the distributions of results over fresh samples, a colour for each design, with means and limits.

    Args:
        designs: name of a design -> result -> its values over the same fresh samples.
        panels: the results to draw.
        title: above everything; a dashed line is the mean of the design in its colour.
    """
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(6.2 * columns, 4.0 * rows), layout="constrained")
    figure.suptitle("\n".join(part for part in (title, "over fresh samples of the soil; dashed: means") if part))
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in every[len(panels) :]:
        axes.set_visible(False)
    for axes, panel in zip(every, panels, strict=False):
        _draw(axes, {name: values[panel.result] / panel.factor for name, values in designs.items()}, panel)
    return figure


def _draw(axes: Axes, values: Mapping[str, Vector], panel: Panel) -> None:
    every = np.concatenate(list(values.values()))
    low, high = np.quantile(every, [0.001, 0.999])
    sides = [limit / panel.factor for limit in (panel.at_least, panel.at_most) if limit is not None]
    low, high = min([low, *sides]), max([high, *sides])
    room = 0.04 * (high - low) or 0.5 * abs(high) or 1.0
    bins = np.linspace(low - room, high + room, _BINS + 1).tolist()
    for (name, own), colour in zip(values.items(), COLOURS, strict=False):
        axes.hist(own, bins, weights=np.full(len(own), 100.0 / len(own)), color=colour, alpha=0.45,
                  label=_legend(name, own, panel))  # fmt: skip
        axes.axvline(float(np.mean(own)), color=colour, linestyle="--", linewidth=1.2)
    for limit in sides:
        axes.axvline(limit, color="black", linewidth=1.4, label=f"limit {limit:.4g} {panel.unit}".rstrip())
    axes.set_xlabel(panel.label)
    axes.set_ylabel("samples [%]")
    # Room for the legend above the bars.
    axes.set_ylim(0.0, axes.get_ylim()[1] * (1.1 + 0.12 * (len(values) + len(sides))))
    axes.legend(loc="upper left", frameon=True, framealpha=1.0, edgecolor="none", fontsize=9)


def _legend(name: str, own: Vector, panel: Panel) -> str:
    """Return a design's name with its mean, and the part of the samples within the limits if there are any."""
    unit = f" {panel.unit}" if panel.unit else ""
    text = f"{name}: mean {np.mean(own):.4g}{unit}"
    if panel.at_least is None and panel.at_most is None:
        return f"{text}, worst tenth {np.mean(np.sort(own)[-max(1, len(own) // 10) :]):.4g}{unit}"
    low = -np.inf if panel.at_least is None else panel.at_least / panel.factor
    high = np.inf if panel.at_most is None else panel.at_most / panel.factor
    return f"{text}, {100.0 * np.mean((own >= low) & (own <= high)):.1f} % within the limit"
