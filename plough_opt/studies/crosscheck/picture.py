"""Draft over speed by every model: one panel for each depth, in colours that the colour-blind can tell apart."""

import math
import textwrap
from collections.abc import Mapping, Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from plough_opt.core.files import COLOURS
from plough_opt.studies.crosscheck.rows import ModelDraft

_MARKERS = "os^vDPX"
# Spread of drafts beyond which the lower ones could not be told apart on a linear axis.
_WIDE = 8.0
_REFUSED = ": outside its domain"
# Letters of a title by inch of the picture, beside its legend.
_LETTERS = 9


def figure_of(
    own: ModelDraft, others: Sequence[ModelDraft], speeds: Sequence[float], depths: Sequence[float], title: str = ""
) -> Figure:
    """Return the picture; speeds in km/h. A model has one colour and one marker in every panel."""
    numbers = {name: k for k, name in enumerate(dict.fromkeys(row.model for row in others))}
    panels = depths or (None,)
    figure = Figure(figsize=(5.2 * len(panels) + 3.6, 5.0), layout="constrained")
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, depth in zip(grid, panels, strict=True):
        rows = [row for row in others if row.depth in (depth, None)]
        _draw(axes, own, rows, speeds, numbers)
        axes.set_title("" if depth is None else f"working depth {depth:.3g} m")
    drafts = [d for row in (own, *others) for d in row.drafts if math.isfinite(d) and d > 0.0]
    if drafts and max(drafts) > _WIDE * min(drafts):
        grid[0].set_yscale("log")
        plain = FuncFormatter(lambda value, _: f"{value:g}")
        grid[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        grid[0].yaxis.set_major_formatter(plain)
        grid[0].yaxis.set_minor_formatter(NullFormatter())
    else:
        grid[0].set_ylim(bottom=0.0)
    grid[0].set_ylabel("mean draft [kN]")
    # A model may have values at one depth alone: its name says so where it has none at all.
    found: dict[str, tuple[Artist, str]] = {}
    for axes in grid:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            model = name.removesuffix(_REFUSED)
            if model not in found or found[model][1].endswith(_REFUSED):
                found[model] = (handle, name)
    handles, names = zip(*found.values(), strict=True)
    figure.legend(handles, names, loc="outside right upper", fontsize="small")
    if title:
        figure.suptitle(
            textwrap.fill(title, int(_LETTERS * figure.get_figwidth())), x=0.01, ha="left", fontsize="medium"
        )
    return figure


def _draw(axes: Axes, own: ModelDraft, rows: Sequence[ModelDraft], speeds: Sequence[float],
          numbers: Mapping[str, int]) -> None:  # fmt: skip
    axes.plot(speeds, [draft / 1e3 for draft in own.drafts], color="black", linewidth=2.2, label=own.model)
    for row in rows:
        k = numbers[row.model]
        # The marker moves on where colours begin anew.
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
    """Return a model's name for the legend, which says too where it has no value at all."""
    return row.model + (_REFUSED if all(map(math.isnan, row.drafts)) else "")
