"""A robust optimum beside the nominal one, both verified on fresh samples of the soil."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from plough_opt.core.files import save_figure
from plough_opt.core.kept import Keepable, Origin
from plough_opt.core.tables import Grid, Page, Part, data_frame
from plough_opt.design import Optimum
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.studies.uncertainty.robust import Robust
from plough_opt.studies.uncertainty.table import (
    checks_table,
    design_table,
    indices_table,
    limits_table,
    remarks_on,
    soil_table,
)
from plough_opt.studies.uncertainty.variance import SobolIndices
from plough_opt.studies.uncertainty.verification import Check, Verification, in_words

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

# Results that hardly vary make no picture.
_MOST_PANELS: Final = 4


@dataclass(frozen=True, repr=False)
class RobustOptimum(Keepable):
    """The result of a robust design question.

    Attributes:
        best: the robust optimum.
        run: its run in the nominal soil.
        nominal: the optimum for the nominal soil alone.
        robust: the results over the samples, and the requested measures.
        fresh: the checks of the robust optimum by fresh samples.
        nominal_fresh: the checks of the nominal one by the same samples.
        indices: the part of each result's variance, at the robust optimum, by uncertain property.
        failures: reasons why some starts led to no robust optimum.
        requirements: name -> its limits in words, and in which soils it keeps them.
        origin: what made it.
    """

    best: Optimum
    run: Run
    nominal: Optimum
    robust: Robust
    fresh: Verification
    nominal_fresh: Verification
    indices: Mapping[str, SobolIndices]
    failures: tuple[str, ...] = ()
    requirements: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    origin: Origin = field(default=Origin(), compare=False)
    kind = "robust optimum"
    unkept = frozenset({"robust"})

    def page(self) -> Page:
        """Return the soil, the robust design beside the nominal one, and the fresh samples of both."""
        checks = [self._written(check) for check in self.fresh.checks]
        parts: list[Part] = [soil_table(self.robust.field, self.origin), design_table(self.best, self.nominal)]
        required = limits_table(self.best, self.requirements, self.origin)
        parts += [required] if required.rows else []
        if len(self.best.local_optima) > 1:
            optima = Grid.of("All robust optima found", "", "objective", *self.best.variables)
            for one in self.best.local_optima:
                cells = (self.best.display(name).text(value, 6) for name, value in one.variables.items())
                optima.row(one.name, f"{one.objective:.9g}", *cells)
            parts.append(optima)
        parts.append(checks_table(checks, self.nominal_fresh.checks, self.fresh.samples, self.origin))
        parts += [f"* {text}" for check in checks for text in remarks_on(check, self.origin)]
        if self.indices:
            parts.append(indices_table(self.indices))
        if note := next((own.note for own in self.indices.values() if own.note), ""):
            parts.append(f"In that table {note}.")
        parts.append(f"In the robust design {in_words(checks)}.")
        lost = len(self.fresh.failures)
        notes = (*self.best.warnings, *self.failures)
        notes += (f"{lost} fresh soils have no result and are left out",) if lost else ()
        footer = (
            f"{len(self.robust.samples)} samples in one program; robust objective re-integrated tightly: gap"
            f" {self.best.gap:.0e}; {self.best.seconds:.1f} s, nominal {self.nominal.seconds:.1f} s, verified in"
            f" {self.fresh.seconds:.1f} s"
        )
        heading = f"Robust design: objective {self.best.objective:.9g} ({self.best.status})"
        return Page(heading, tuple(parts), notes, footer, self.origin.title)

    def also_kept(self) -> dict[str, Any]:
        """Return the soil's distribution in words, and what the question drew and found."""
        if self.robust is None:
            return {}
        pairs = self.robust.field.correlation.items()
        return {
            "soil": self.robust.field.in_words(), "correlation": {" and ".join(pair): x for pair, x in pairs},
            "samples": len(self.robust.samples), "seed": self.robust.seed, "fresh_samples": self.fresh.samples,
            "checks": self.fresh.checks, "nominal_checks": self.nominal_fresh.checks,
            "warnings": (*self.best.warnings, *self.failures),
            "seconds": self.best.seconds + self.nominal.seconds + self.fresh.seconds,
        }  # fmt: skip

    def _written(self, check: Check) -> Check:
        """Return a check whose limits are written as the question writes them."""
        if check.result not in self.requirements or not check.text.startswith("probability"):
            return check
        limits = self.requirements[check.result][0].replace(", ", " and ")
        return replace(check, text=f"probability of {limits}")

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw how the results spread over fresh samples, in the robust design and in the nominal one.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a place that cannot be written.
        """
        from plough_opt.studies.uncertainty.picture import Panel, plot_spread

        limits = {limit.name: limit for limit in self.best.limits if limit.kind == "requirement"}
        panels = []
        for name in dict.fromkeys(check.result for check in self.fresh.checks):
            unit = MEASURES[name].unit.symbol if name in MEASURES else ""
            display = self.origin.display(name, unit, *self.fresh.values[name].tolist())
            # A limited probability has its limit in the share of the samples, and not in the result.
            own = limits.get(name) if name in limits and limits[name].unit == unit else None
            low, high = (None, None) if own is None else (own.low, own.high)
            panels.append(Panel(name, display.heading(called(name)), display.factor, low, high, display.symbol))
        values = {"nominal design": self.nominal_fresh.values, "robust design": self.fresh.values}
        figure = plot_spread(values, panels[:_MOST_PANELS], self.origin.title)
        if target is not None:
            save_figure(figure, target)
        return figure

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each variable: robust and nominal value, SI; ``attrs["units"]`` has their units by name.

        Raises:
            InputError: pandas is not installed.
        """
        names = [*self.best.variables]
        columns = {"variable": names, "robust": [*self.best.variables.values()]}
        frame = data_frame(columns | {"nominal": [self.nominal.variables[name] for name in names]}, {})
        frame.attrs["units"] = {limit.name: limit.unit for limit in self.best.limits if limit.kind == "bound"}
        return frame
