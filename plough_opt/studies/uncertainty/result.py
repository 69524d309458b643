"""`RobustOptimum`: the robust design of a problem file beside the nominal one, both verified on fresh soils."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from plough_opt.core.files import COLOURS, figure_with_panels, written
from plough_opt.core.quantities import QUANTITIES
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page, Part, data_frame
from plough_opt.core.units import OBJECTIVE_DIGITS
from plough_opt.design import Optimum
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.studies.uncertainty.robust import Check, Verification

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Number of results in the picture and of bars in a histogram, and the part of the soils that it cuts off at each end.
_MOST_PANELS: Final = 4
_BINS: Final = 60
_CUT_OFF: Final = 0.001


@dataclass(frozen=True, repr=False, eq=False)
class RobustOptimum(Saveable):
    """The result of a robust design question.

    Attributes:
        best: the robust optimum, with its run in the nominal soil.
        nominal: the optimum for the nominal soil alone.
        soil: uncertain property -> nominal value, mean and standard deviation, SI.
        correlation: "one and other" property -> correlation of their normal scores.
        samples: number of soils that the optimiser used.
        fresh: verification of the robust optimum on fresh soils.
        nominal_fresh: verification of the nominal optimum on the same soils.
        origin: the question that it answers: the problem file and its changes.
    """

    best: Optimum
    nominal: Optimum
    soil: Mapping[str, tuple[float, float, float]]
    correlation: Mapping[str, float]
    samples: int
    fresh: Verification
    nominal_fresh: Verification
    origin: Origin = field(default=Origin())
    kind = "robust optimum"

    def page(self) -> Page:
        """Return tables of the soil, of the robust and the nominal design, and of both verifications."""
        headings = "property", "nominal", "mean", "standard deviation", "correlation"
        soil = Grid.of("Uncertain soil", *headings, left=headings[-1:])
        for name, values in self.soil.items():
            display = self.origin.display(f"soil.{name}", QUANTITIES[f"soil.{name}"].unit, *values)
            pairs = (f"{pair} {value:+.2g}" for pair, value in self.correlation.items() if pair.startswith(f"{name} "))
            soil.row(f"soil.{name}", *map(display.text, values), ", ".join(pairs))
        designs = Grid.of("Robust and nominal design", "variable", "robust", "nominal", "bounds", "")
        for one in self.best.limits:
            if one.kind == "bound":
                pair = (one.shown.result(optimum.variables[one.name]) for optimum in (self.best, self.nominal))
                designs.row(one.name, *pair, one.limits, "at its bound" if one.active else "")
        parts: list[Part] = [soil, designs, *self.best.design_tables()[1:]]
        if len(self.best.local_optima) > 1:
            parts.append(self.best.optima_table("All robust optima found"))
        doubtful = [f"{own.result} ({own.text}: {own.verdict})" for own in self.fresh.checks if not own.confirmed]
        verdict = f"do not confirm {', '.join(doubtful)}" if doubtful else "confirm every measure"
        parts += [self._checks(), f"In the robust design fresh soils {verdict}."]
        gap = f"{self.samples} soils in one program; gap of the robust objective to a tight run {self.best.gap:.0e}"
        times = (
            f"{name} {own.seconds:.1f} s" for name, own in (("nominal", self.nominal), ("verified in", self.fresh))
        )
        failed = [f"{self.fresh.failures} fresh soils have no result and are left out"] * (self.fresh.failures > 0)
        heading = f"Robust design: objective {self.best.objective:.{OBJECTIVE_DIGITS}g} ({self.best.status})"
        footer = f"{gap}; {self.best.seconds:.1f} s, {', '.join(times)}"
        return Page(heading, tuple(parts), (*self.best.warnings, *failed), footer, self.origin.title)

    def _checks(self) -> Grid:
        """Return a table of the checks on fresh soils, beside those of the nominal design."""
        title = f"Verification on {self.fresh.samples} fresh soils: robust design and nominal design"
        headings = "result", "measure", "wanted", "fresh soils", "95 % interval", "nominal design", ""
        table = Grid.of(title, *headings, left=("measure",), fold=("measure",))
        for check, other in zip(self.fresh.checks, self.nominal_fresh.checks, strict=True):
            wanted, fresh, low, high, beside = (
                self._text(check, x) for x in (check.wanted, check.fresh, check.low, check.high, other.fresh)
            )
            table.row(check.result, check.text, wanted, fresh, f"{low} to {high}", beside, check.verdict)
        return table

    def _text(self, check: Check, value: float) -> str:
        """Return the value of a measure in the unit of the file."""
        if check.probability:
            return f"{100.0 * value:.2f} %"
        unit = MEASURES[check.result].unit.symbol if check.result in MEASURES else ""
        return self.origin.display(check.result, unit, check.fresh).text(value)

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw histograms of the results over fresh soils, for the robust and the nominal design.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a path that cannot be written.
        """
        names = list(dict.fromkeys(check.result for check in self.fresh.checks))[:_MOST_PANELS]
        figure, panels = figure_with_panels(len(names), 1 if len(names) < 2 else 2, (6.2, 4.0))
        heading = "over fresh soils; dashed: means"
        figure.suptitle("\n".join(part for part in (self.origin.title, heading) if part))
        for axes, name in zip(panels, names, strict=True):
            self._draw(axes, name)
        return written(figure, target)

    def _draw(self, axes: Axes, name: str) -> None:
        """Draw the histograms of a result in both designs, with means and limits."""
        unit = MEASURES[name].unit.symbol if name in MEASURES else ""
        display = self.origin.display(name, unit, *self.fresh.values[name].tolist())
        beside = f" {display.symbol}".rstrip()
        ends = self.origin.limits.get(name, (None, None))
        limits = [end / display.factor for end in ends if end is not None]
        low, high = (s * np.inf if end is None else end / display.factor for s, end in zip((-1, 1), ends, strict=True))
        designs = {"nominal design": self.nominal_fresh, "robust design": self.fresh}
        values = {design: own.values[name] / display.factor for design, own in designs.items()}
        first, last = np.quantile(np.concatenate([*values.values()]), [_CUT_OFF, 1.0 - _CUT_OFF])
        first, last = min([first, *limits]), max([last, *limits])
        room = 0.04 * (last - first) or 0.5 * abs(last) or 1.0
        bins = np.linspace(first - room, last + room, _BINS + 1).tolist()
        for (design, own), colour in zip(values.items(), COLOURS, strict=False):
            part = 100.0 * np.mean((own >= low) & (own <= high))
            label = f"{design}: mean {np.mean(own):.4g}{beside}{f', {part:.1f} % within the limit' if limits else ''}"
            weights = np.full(len(own), 100.0 / len(own))
            axes.hist(own, bins, weights=weights, color=colour, alpha=0.45, label=label)
            axes.axvline(float(np.mean(own)), color=colour, linestyle="--", linewidth=1.2)
        for limit in limits:
            axes.axvline(limit, color="black", linewidth=1.4, label=f"limit {limit:.4g}{beside}")
        axes.set(xlabel=display.heading(called(name)), ylabel="soils [%]")
        # Leave room for the legend above the bars.
        axes.set_ylim(0.0, axes.get_ylim()[1] * (1.1 + 0.12 * (len(designs) + len(limits))))
        axes.legend(loc="upper left", framealpha=1.0, edgecolor="none", fontsize=9)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each variable with robust and nominal value, SI; ``attrs["units"]`` has the units by name.

        Raises:
            InputError: pandas is not installed.
        """
        robust, nominal = self.best.variables, self.nominal.variables
        columns = {"variable": [*robust], "robust": [*robust.values()], "nominal": [nominal[name] for name in robust]}
        units = {limit.name: limit.unit for limit in self.best.limits if limit.kind == "bound"}
        return data_frame(columns, units)
