"""The result of a comparison: a table, a picture, and words on why the models differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from plough_opt.studies.crosscheck.rows import ModelDraft

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

_KM_PER_H = 3.6


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
            table.add_column(f"{_KM_PER_H * speed:.3g} km/h", justify="right")
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
        from plough_opt.studies.crosscheck.picture import figure_of

        speeds = [_KM_PER_H * speed for speed in self.speeds]
        figure = figure_of(self.own, self.others, speeds, self.depths, self.scene)
        if path is not None:
            save_figure(figure, path)
        return figure


def _kilo(force: float) -> str:
    return f"{force / 1e3:.3g}" if math.isfinite(force) else "-"


def _at(row: ModelDraft) -> str:
    return "" if row.depth is None else f" at {row.depth:.3g} m"


def _family(row: ModelDraft) -> str:
    return row.model.split(",")[0]
