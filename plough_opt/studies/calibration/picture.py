"""The picture of a fit: measured against predicted values, residuals, and quantiles of the residuals."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from plough_opt.core.files import COLOURS
from plough_opt.core.quantities import EVERY, Quantity
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display, Unit
from plough_opt.motion.vocabulary import called
from plough_opt.studies.calibration.parts import Row

Vector = NDArray[np.float64]

_MUTED: Final = "#8A8A8A"


def figure_of(title: str, rows: Sequence[Row], origin: Origin) -> Figure:
    """Return four panels: measured against predicted values, residuals over both axes, and quantiles of residuals.

    Args:
        title: title of the picture.
        rows: the measured rows with their predictions.
        origin: origin of the fit, which gives the units of the file.
    """
    counted = [row for row in rows if math.isfinite(row.sigma) and row.sigma > 0.0]
    kinds = {row.result: _display(row, counted, origin) for row in counted}
    figure = Figure(figsize=(11, 8.4), layout="constrained")
    axes = figure.subplots(2, 2)
    _draw_fit(axes[0, 0], counted, kinds)
    _draw_residuals(axes[0, 1], counted, kinds, [row.predicted / kinds[row.result].factor for row in counted],
                    _predicted_label(kinds))  # fmt: skip
    shown, values, label = _varied(counted, origin)
    _draw_residuals(axes[1, 0], shown, kinds, values, label)
    _draw_quantiles(axes[1, 1], counted)
    figure.suptitle(title)
    return figure


def _draw_fit(axes: Axes, rows: Sequence[Row], kinds: Mapping[str, Display]) -> None:
    """Draw measured over predicted values with errors; several results are each divided by their largest value."""
    for (result, display), colour in zip(kinds.items(), cycle(COLOURS)):
        own = [row for row in rows if row.result == result]
        predicted, observed, sigma, error = (
            np.array([getattr(row, key) for row in own]) / display.factor
            for key in ("predicted", "observed", "sigma", "standard_error")
        )
        axes.errorbar(predicted, observed, yerr=1.96 * sigma, xerr=1.96 * error, fmt="o", markersize=4, linewidth=0.8,
                      color=colour, label=f"{called(result)}, n = {len(own)}")  # fmt: skip
    _draw_diagonal(axes, float(predicted[0]), "measured = predicted")
    axes.set(xlabel=_predicted_label(kinds), ylabel=_predicted_label(kinds).replace("predicted", "measured"))
    axes.set_title("bars: 95 % of the measuring error; across: of the prediction", fontsize="small")


def _draw_residuals(axes: Axes, rows: Sequence[Row], kinds: Mapping[str, Display], places: Sequence[float],
                    label: str) -> None:  # fmt: skip
    """Draw the standardised residuals over a coordinate of the rows."""
    for result, colour in zip(kinds, cycle(COLOURS)):
        own = [(place, _standardised(row)) for place, row in zip(places, rows, strict=True) if row.result == result]
        axes.plot(*zip(*own, strict=True), "o", markersize=4, color=colour, label=called(result))
    axes.axhline(0.0, color="black", linewidth=0.9)
    for size, name in ((-1.96, None), (1.96, "95 % of normal errors: ±1.96")):
        axes.axhline(size, color=_MUTED, linewidth=0.9, linestyle="--", label=name)
    axes.legend(fontsize="x-small", loc="upper right")
    axes.set(xlabel=label, ylabel="(predicted - measured) / standard error")
    axes.grid(alpha=0.25)


def _draw_quantiles(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the ordered standardised residuals over normal quantiles."""
    (theory, ordered), _ = stats.probplot([_standardised(row) for row in rows])
    axes.plot(theory, ordered, "o", markersize=4, color=COLOURS[0])
    _draw_diagonal(axes, 0.0, "normal")
    axes.set(xlabel="normal quantile", ylabel="(predicted - measured) / standard error, ordered")


def _draw_diagonal(axes: Axes, place: float, label: str) -> None:
    """Draw the diagonal of equal values, through a given point on it."""
    axes.axline((place, place), slope=1.0, color="black", linewidth=0.9, label=label)
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")


def _standardised(row: Row) -> float:
    return row.residual / row.sigma


def _display(like: Row, rows: Sequence[Row], origin: Origin) -> Display:
    """Return the unit in which a result is drawn; if there are several results, its largest value is the unit."""
    own = [abs(row.predicted) for row in rows if row.result == like.result]
    several = len({row.result for row in rows}) > 1
    return Display("", max(own)) if several else origin.display(like.result, like.unit, *own)


def _predicted_label(kinds: Mapping[str, Display]) -> str:
    if len(kinds) > 1:
        return "predicted, over the largest of its kind"
    ((result, display),) = kinds.items()
    return f"predicted {display.heading(called(result))}"


def _coordinates(row: Row) -> dict[str, float]:
    own = dict(row.conditions)
    return own if row.time is None else {"time": row.time, **own}


def _varied(rows: Sequence[Row], origin: Origin) -> tuple[Sequence[Row], list[float], str]:
    """Return the rows, a coordinate of each, and its label: time or speed if it varies, else the most varied one."""
    counts: dict[str, set[float]] = {}
    for row in rows:
        for key, value in _coordinates(row).items():
            counts.setdefault(key, set()).add(value)
    preferred = [key for key in ("time", "scene.tow_speed") if len(counts.get(key, ())) > 1]
    name = preferred[0] if preferred else max(counts, key=lambda key: len(counts[key]), default="")
    if not name:
        return rows, [float(k) for k in range(1, len(rows) + 1)], "number of the row"
    display = Display("s", 1.0) if name == "time" else origin.displays.get(name) or _usual(EVERY[name])
    shown = [row for row in rows if name in _coordinates(row)]
    return shown, [_coordinates(row)[name] / display.factor for row in shown], display.heading(called(name))


def _usual(quantity: Quantity) -> Display:
    """Return the customary unit of a quantity."""
    symbol = quantity.shown or quantity.unit
    return Display(symbol, Unit(quantity.unit).split(f"1 {symbol}")[1])
