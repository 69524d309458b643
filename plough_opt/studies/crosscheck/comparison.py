"""The result of a comparison of draft models, as a table, a picture and sentences."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from plough_opt.core.files import COLOURS, save_figure

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table

KM_PER_H: Final = 3.6
"""Kilometres per hour in a metre per second."""

_MARKERS = "os^vDPX"
# Ratio of the largest to the smallest draft beyond which the axis is logarithmic, to separate the small ones.
_LARGEST_LINEAR_RATIO = 8.0
_REFUSED = ": outside its domain"
# Characters of a title per inch of the picture's width.
_CHARACTERS_PER_INCH = 9


@dataclass(frozen=True)
class ModelDraft:
    """Drafts of one model at the speeds of a comparison.

    Attributes:
        model: name of the model.
        depth: working depth [m], or None for a model without one.
        drafts: draft at each speed [N]; NaN outside the model's domain.
        refusal: reason for NaNs, or "".
        source: source of its equations.
        standing: clause that says which parts are not verified.
        band: fraction of a draft by which it may be wrong in either direction according to its source.
    """

    model: str
    depth: float | None
    drafts: tuple[float, ...]
    refusal: str
    source: str
    standing: str
    band: float = 0.0

    @property
    def rise(self) -> float:
        """Relative growth of the draft from the lowest to the highest speed [-]; NaN if either draft is NaN."""
        return self.drafts[-1] / self.drafts[0] - 1.0 if self.drafts[0] else math.nan


@dataclass(frozen=True)
class Comparison:
    """Drafts of several models at the same speeds, beginning with this toolkit's model.

    They are not measurements, and agreement of two models validates neither.

    Attributes:
        scene: description of the scene.
        speeds: speeds [m/s], increasing.
        own: quasi-static mean draft of the scene by this toolkit's model.
        others: the other models; those with a working depth occur once for each depth.
        estimates: sentences that say which values the scene does not give, and how they were estimated.
        reasons: sentences that say why the models differ.
    """

    scene: str
    speeds: tuple[float, ...]
    own: ModelDraft
    others: tuple[ModelDraft, ...]
    estimates: tuple[str, ...]
    reasons: tuple[str, ...]

    @property
    def depths(self) -> tuple[float, ...]:
        """The working depths [m]."""
        return tuple(dict.fromkeys(row.depth for row in self.others if row.depth is not None))

    @property
    def refusals(self) -> tuple[str, ...]:
        """Sentences about models that do not have a value at every speed."""
        rows = (self.own, *self.others)
        return tuple(dict.fromkeys(f"{row.model}{_at(row)}: {row.refusal}" for row in rows if row.refusal))

    @property
    def standings(self) -> tuple[str, ...]:
        """Parts of each model that are not verified, with its source."""
        return tuple(dict.fromkeys(f"{_family(row)}: {row.standing} ({row.source})" for row in self.others))

    def ratios(self, row: ModelDraft) -> tuple[float, ...]:
        """Return the ratios of a model's drafts to this toolkit's at the same speeds [-]; NaN if either is NaN."""
        pairs = zip(row.drafts, self.own.drafts, strict=True)
        return tuple(theirs / ours if ours else math.nan for theirs, ours in pairs)

    def table(self) -> Table:
        """Return a table of drafts in kN and, in brackets, their ratios to this model's."""
        from rich.table import Table

        table = Table(title="Mean draft in kN, ratio to this model's: calculated, not measured")
        table.add_column("model")
        table.add_column("depth", justify="right")
        for speed in self.speeds:
            table.add_column(f"{KM_PER_H * speed:.3g} km/h", justify="right")
        table.add_row(self.own.model, "none", *map(_kilo, self.own.drafts), end_section=True)
        for row in self.others:
            cells = (
                f"{_kilo(draft)} ({ratio:.2f})" if math.isfinite(ratio) else _kilo(draft)
                for draft, ratio in zip(row.drafts, self.ratios(row), strict=True)
            )
            table.add_row(row.model, "none" if row.depth is None else f"{row.depth:.3g} m", *cells)
            if row.band:
                ends = ([_kilo(draft * (1.0 + sign * row.band)) for sign in (-1, 1)] for draft in row.drafts)
                table.add_row(f"  its band of ±{100.0 * row.band:.0f} %", "", *map(" to ".join, ends))
        return table

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw draft over speed, one panel per depth, and write the picture to a file if a path is given.

        Raises:
            InputError: the file's ending is not a picture format, or the file cannot be written.
        """
        figure = _figure_of(self)
        if path is not None:
            save_figure(figure, path)
        return figure


def _kilo(force: float) -> str:
    return f"{force / 1e3:.3g}" if math.isfinite(force) else "-"


def _at(row: ModelDraft) -> str:
    return "" if row.depth is None else f" at {row.depth:.3g} m"


def _family(row: ModelDraft) -> str:
    return row.model.split(",")[0]


def _figure_of(found: Comparison) -> Figure:
    """Return the picture. A model has the same colour and marker in every panel."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    panels = found.depths or (None,)
    figure = Figure(figsize=(5.2 * len(panels) + 3.6, 5.0), layout="constrained")
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, depth in zip(grid, panels, strict=True):
        _draw(axes, found, depth)
        axes.set_title("" if depth is None else f"working depth {depth:.3g} m")
    drafts = [d for row in (found.own, *found.others) for d in row.drafts if math.isfinite(d) and d > 0.0]
    if drafts and max(drafts) > _LARGEST_LINEAR_RATIO * min(drafts):
        grid[0].set_yscale("log")
        grid[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        grid[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        grid[0].yaxis.set_minor_formatter(NullFormatter())
    else:
        grid[0].set_ylim(bottom=0.0)
    grid[0].set_ylabel("mean draft [kN]")
    # A model may have values at one depth only; it is marked as refused only if it has none at any depth.
    shown: dict[str, tuple[Artist, str]] = {}
    for axes in grid:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            model = name.removesuffix(_REFUSED)
            if model not in shown or shown[model][1].endswith(_REFUSED):
                shown[model] = (handle, name)
    handles, names = zip(*shown.values(), strict=True)
    figure.legend(handles, names, loc="outside right upper", fontsize="small")
    title = textwrap.fill(found.scene, int(_CHARACTERS_PER_INCH * figure.get_figwidth()))
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def _draw(axes: Axes, found: Comparison, depth: float | None) -> None:
    """Draw the models at a depth, and those without one."""
    speeds, models = [KM_PER_H * speed for speed in found.speeds], list(dict.fromkeys(r.model for r in found.others))
    axes.plot(speeds, [draft / 1e3 for draft in found.own.drafts], color="black", linewidth=2.2, label=found.own.model)
    for row in (row for row in found.others if row.depth in (depth, None)):
        k = models.index(row.model)
        # Markers shift by one each time the colours repeat.
        marker = _MARKERS[(k + k // len(COLOURS)) % len(_MARKERS)]
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(speeds, [draft / 1e3 for draft in row.drafts], color=colour, marker=marker,
                  markersize=5, linewidth=1.2, label=_named(row))  # fmt: skip
        if row.band:
            low, high = ([part * draft / 1e3 for draft in row.drafts] for part in (1.0 - row.band, 1.0 + row.band))
            label = f"band of ±{100.0 * row.band:.0f} %"
            axes.fill_between(speeds, low, high, color=colour, alpha=0.12, lw=0.0, label=label)
    axes.set_xlabel("speed [km/h]")
    axes.grid(visible=True, alpha=0.3)


def _named(row: ModelDraft) -> str:
    """Return a model's name for the legend, marked if its drafts are NaN at all speeds."""
    return row.model + (_REFUSED if all(map(math.isnan, row.drafts)) else "")
