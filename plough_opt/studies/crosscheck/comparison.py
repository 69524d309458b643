"""The result of a comparison: a table, a picture in colours that the colour-blind can tell apart, and words."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from plough_opt.core.files import COLOURS

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table

KM_PER_H: Final = 3.6
"""Kilometres per hour in a metre per second."""

_MARKERS = "os^vDPX"
# Spread of drafts beyond which the lower ones could not be told apart on a linear axis.
_WIDE = 8.0
_REFUSED = ": outside its domain"
# Letters of a title by inch of the picture, beside its legend.
_LETTERS = 9


@dataclass(frozen=True)
class ModelDraft:
    """Drafts of one model at the speeds of a comparison.

    Attributes:
        model: its name.
        depth: working depth [m], or None of a model that knows none.
        drafts: draft at each speed [N]; NaN outside the model's domain.
        refusal: why there are NaNs, or "".
        source: where its equations come from.
        standing: what of it is not verified.
        band: part of a draft by which its source lets it err either way.
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
        """Growth of the draft from the lowest to the highest speed, relative [-]; NaN where one has no value."""
        return self.drafts[-1] / self.drafts[0] - 1.0 if self.drafts[0] else math.nan


@dataclass(frozen=True)
class Comparison:
    """Drafts of several models at the same speeds, this one's first.

    None of them is a measurement, and that two agree validates neither.

    Attributes:
        scene: what was compared, in words.
        speeds: [m/s], rising.
        own: quasi-static mean draft of the scene by this toolkit's model.
        others: the other models, those that know a depth once for each depth.
        estimates: what the scene does not say and how it was estimated; a sentence each.
        reasons: why the models differ; a sentence each.
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
        """A sentence for each model that has no value at some speed."""
        rows = (self.own, *self.others)
        return tuple(dict.fromkeys(f"{row.model}{_at(row)}: {row.refusal}" for row in rows if row.refusal))

    @property
    def standings(self) -> tuple[str, ...]:
        """The parts of each model that are not verified, with its source."""
        return tuple(dict.fromkeys(f"{_family(row)}: {row.standing} ({row.source})" for row in self.others))

    def ratios(self, row: ModelDraft) -> tuple[float, ...]:
        """Return a model's drafts over this toolkit's at the same speeds [-]; NaN where either has none."""
        pairs = zip(row.drafts, self.own.drafts, strict=True)
        return tuple(theirs / ours if ours else math.nan for theirs, ours in pairs)

    def table(self) -> Table:
        """Return drafts in kN and, in brackets, their ratios to this model's."""
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
        """Draw draft over speed, a panel for each depth; write it to a file if one is named.

        Raises:
            InputError: a file of no known picture format, or one that cannot be written.
        """
        from plough_opt.core.files import save_figure

        speeds = [KM_PER_H * speed for speed in self.speeds]
        figure = _figure_of(self.own, self.others, speeds, self.depths, self.scene)
        if path is not None:
            save_figure(figure, path)
        return figure


def _kilo(force: float) -> str:
    return f"{force / 1e3:.3g}" if math.isfinite(force) else "-"


def _at(row: ModelDraft) -> str:
    return "" if row.depth is None else f" at {row.depth:.3g} m"


def _family(row: ModelDraft) -> str:
    return row.model.split(",")[0]


def _figure_of(
    own: ModelDraft, others: Sequence[ModelDraft], speeds: Sequence[float], depths: Sequence[float], title: str = ""
) -> Figure:
    """Return the picture; speeds in km/h. A model has one colour and one marker in every panel."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

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
