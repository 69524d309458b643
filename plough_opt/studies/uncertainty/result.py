"""Result of a robust design question beside the nominal one, and Sobol indices: the parts of a variance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plough_opt.core.checks import check_kind, shown, whole_number
from plough_opt.core.errors import InputError, printable
from plough_opt.core.expressions import ByValue
from plough_opt.core.files import COLOURS, figure_with_panels, written
from plough_opt.core.plain_data import Array, Unsaved
from plough_opt.core.quantities import QUANTITIES
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page, Part, data_frame
from plough_opt.core.units import OBJECTIVE_DIGITS
from plough_opt.design import Optimum
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.studies.uncertainty.distribution import SoilDistribution
from plough_opt.studies.uncertainty.robust import CONFIDENCE, Check, Robust, Verification, in_words, varies

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_RESAMPLES = 200


@dataclass(frozen=True, eq=False)
class SobolIndices(ByValue):
    """The Sobol indices of one result at one design.

    Attributes:
        result: name of the result.
        names: the uncertain properties; if they are correlated, "b given a" is b for a known a.
        first: first-order indices: the part of the variance that each property explains alone.
        total: total indices: the part that each explains alone and in interaction with others.
        first_low: lower ends of the confidence intervals (95 %, bootstrap) of `first`.
        first_high: upper ends of these intervals.
        total_low: lower ends of the confidence intervals of `total`.
        total_high: upper ends of these intervals.
        note: a warning, or "".

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> field = po.SoilDistribution(soil, cohesion=stats.uniform(1e4, 1e4), tool_friction=stats.uniform(0.3, 0.2))
        >>> design = po.Design()
        >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
        >>> cone = po.Cone("10 deg", height)
        >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=64)
        >>> found = po.uncertainty.sobol_indices(robust, {"height": 0.3}, samples=64)
        >>> found["draft"].names
        ('cohesion', 'tool_friction')
    """

    result: str
    names: tuple[str, ...]
    first: Array
    total: Array
    first_low: Array
    first_high: Array
    total_low: Array
    total_high: Array
    note: str

    def __str__(self) -> str:
        """Return the part of the variance that each property explains, the largest first."""
        order = np.argsort(-self.total)
        parts = [
            f"{self.names[k]} {100 * self.first[k]:.3g} % alone ({100 * self.first_low[k]:.2g} to"
            f" {100 * self.first_high[k]:.2g}), {100 * self.total[k]:.3g} % with others"
            for k in order
        ]
        return printable(f"variance of {self.result}: {'; '.join(parts)}{'. ' + self.note if self.note else ''}")


def sobol_indices(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = 1024, seed: int = 1, correlated: bool = False
) -> dict[str, SobolIndices]:
    """Return, for each result, the part of its variance that each uncertain property explains.

    Sobol indices (Sobol 1993; estimators of Saltelli et al. 2010, table 2, b and f) divide a variance among independent
    inputs. Correlated properties therefore raise an error, unless ``correlated`` accepts indices of the independent
    coordinates behind the copula (Mara and Tarantola 2012). The first property then includes all that it shares with
    the others, and each further one only the part that is independent of those before it. A result that does not vary
    has no indices, and a single property explains all of what varies. Confidence intervals are percentile intervals of
    the bootstrap (Efron 1979).

    Args:
        robust: the results.
        at: an optimum, or a design by the names of its variables and parameters.
        samples: a power of two; the response is evaluated samples * (properties + 2) times.
        seed: seed of the samples and of the bootstrap.
        correlated: whether to accept the coordinates behind the copula.

    Raises:
        InputError: the properties are correlated, the number of samples is not a power of two, or a soil has no result.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> field = po.SoilDistribution(soil, cohesion=stats.uniform(1e4, 1e4), tool_friction=stats.uniform(0.3, 0.2))
        >>> design = po.Design()
        >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
        >>> cone = po.Cone("10 deg", height)
        >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=64)
        >>> found = po.uncertainty.sobol_indices(robust, {"height": 0.3}, samples=64)
        >>> [*found]
        ['draft']
    """
    check_kind("the results", robust, Robust, "a Robust")
    field = robust.field
    if whole_number("samples", samples, 2) & (samples - 1):
        raise InputError(f"samples = {shown(samples)} must be a power of two, as the Sobol sequence needs")
    if field.correlated and not correlated:
        raise InputError(
            "Sobol indices cannot divide the variance that correlated properties share: leave the correlation out, or"
            " use correlated=True for the independent coordinates behind the copula"
        )

    results = [name for name, values in robust.values(at).items() if varies(values)]
    if not results:
        return {}
    if len(field.names) == 1:  # which explains all of it
        whole = np.ones(1)
        return {name: SobolIndices(name, field.names, whole, whole, whole, whole, whole, whole, "") for name in results}

    count, generator, answers = len(field.names), np.random.default_rng(seed), list[Array]()

    def response(uniforms: Array) -> Array:
        values = robust.values(at, field.at(uniforms.T))
        answers.append(np.stack([values[name] for name in results]))
        return answers[-1]

    stats.sobol_indices(func=response, n=samples, dists=[stats.uniform()] * count, rng=generator)
    # The third answer is that of one sample with each property from the other.
    parts = {"f_A": answers[0], "f_B": answers[1], "f_AB": np.moveaxis(answers[2].reshape(-1, samples, count), -1, 0)}

    def indices(chosen: NDArray[np.intp]) -> Array:
        found = stats.sobol_indices(func={key: part[..., chosen] for key, part in parts.items()}, n=samples)
        return np.reshape([found.first_order, found.total_order], (2, -1, count))

    # The bootstrap of SciPy's own result has no seed.
    every = np.arange(samples)
    ends = stats.bootstrap([every], indices, n_resamples=_RESAMPLES, confidence_level=CONFIDENCE, vectorized=False,
                           method="percentile", rng=generator).confidence_interval  # fmt: skip
    values = {"": indices(every), "_low": ends.low, "_high": ends.high}
    columns = {f"{kind}{side}": value[k] for side, value in values.items() for k, kind in enumerate(("first", "total"))}
    note = "the properties are correlated: each counts only as far as it is independent of those before it"
    names, note = _names(field), note if field.correlated else ""
    parts_of = ({key: column[k] for key, column in columns.items()} for k in range(len(results)))
    return {name: SobolIndices(name, names, **found, note=note) for name, found in zip(results, parts_of, strict=True)}


def _names(field: SoilDistribution) -> tuple[str, ...]:
    """Return the properties' names, each with the earlier ones that it depends on."""
    names = []
    for k, name in enumerate(field.names):
        before = [other for other, weight in zip(field.names, field.factor[k, :k], strict=False) if weight != 0.0]
        names.append(f"{name} given {' and '.join(before)}" if before else name)
    return tuple(names)


# Largest number of results in the picture.
_MOST_PANELS: Final = 4
# Number of bars in a histogram.
_BINS: Final = 60
# Part of the fresh samples that a histogram cuts off at each end.
_CUT_OFF: Final = 0.001
# Smaller parts of a variance are shown as 0.
_LEAST_PART: Final = 5e-4


@dataclass(frozen=True, repr=False, eq=False)
class RobustOptimum(Saveable):
    """The result of a robust design question.

    Attributes:
        best: the robust optimum.
        run: its run in the nominal soil.
        nominal: the optimum for the nominal soil alone.
        robust: the results over the samples, and the requested measures; None in a result that was loaded.
        fresh: verification of the robust optimum on fresh samples.
        nominal_fresh: verification of the nominal optimum on the same samples.
        indices: result -> Sobol indices of the uncertain properties at the robust optimum.
        failures: why some local optima could not be solved again with their own widths.
        requirements: name of a requirement -> its limits, and the soils in which it must hold, as text.
        origin: the question that it answers: the problem file and its changes.
    """

    best: Optimum
    run: Run
    nominal: Optimum
    robust: Annotated[Robust, Unsaved()]
    fresh: Verification
    nominal_fresh: Verification
    indices: Mapping[str, SobolIndices]
    failures: tuple[str, ...] = ()
    requirements: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    origin: Origin = field(default=Origin())
    kind = "robust optimum"

    def page(self) -> Page:
        """Return tables of the soil, of the robust and the nominal design, and of both verifications."""
        checks = [self._in_units_of_file(check) for check in self.fresh.checks]
        parts: list[Part] = [_soil_table(self.robust.field, self.origin), _design_table(self.best, self.nominal)]
        required = _limits_table(self.best, self.requirements, self.origin)
        parts += [required] if required.rows else []
        if len(self.best.local_optima) > 1:
            parts.append(self.best.optima_table("All robust optima found"))
        parts.append(_checks_table(checks, self.nominal_fresh.checks, self.fresh.samples, self.origin))
        parts += [f"* {text}" for check in checks for text in _remarks_on(check, self.origin)]
        parts += [_indices_table(self.indices)] if self.indices else []
        parts += [f"In that table {note}." for note in {result.note for result in self.indices.values()} if note]
        parts.append(f"In the robust design {in_words(checks)}.")
        failed = len(self.fresh.failures)
        notes = (*self.best.warnings, *self.failures)
        notes += (f"{failed} fresh soils have no result and are left out",) if failed else ()
        footer = (
            f"{len(self.robust.samples)} samples in one program; gap of the robust objective to a tight integration"
            f" {self.best.gap:.0e}; {self.best.seconds:.1f} s, nominal {self.nominal.seconds:.1f} s, verified in"
            f" {self.fresh.seconds:.1f} s"
        )
        heading = f"Robust design: objective {self.best.objective:.{OBJECTIVE_DIGITS}g} ({self.best.status})"
        return Page(heading, tuple(parts), notes, footer, self.origin.title)

    def also_saved(self) -> dict[str, Any]:
        """Return further saved data: the soil's distribution, the samples, checks, warnings and total time."""
        pairs = self.robust.field.correlation.items()
        return {
            "soil": self.robust.field.in_words(), "correlation": {" and ".join(pair): x for pair, x in pairs},
            "samples": len(self.robust.samples), "seed": self.robust.seed, "fresh_samples": self.fresh.samples,
            "checks": self.fresh.checks, "nominal_checks": self.nominal_fresh.checks,
            "warnings": (*self.best.warnings, *self.failures),
            "seconds": self.best.seconds + self.nominal.seconds + self.fresh.seconds,
        }  # fmt: skip

    def _in_units_of_file(self, check: Check) -> Check:
        """Return a check whose limits read as in the problem file."""
        if check.result not in self.requirements or not check.text.startswith("probability"):
            return check
        limits = self.requirements[check.result][0].replace(", ", " and ")
        return replace(check, text=f"probability of {limits}")

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw histograms of the results over fresh samples, for the robust and the nominal design.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a path that cannot be written.
        """
        names = list(dict.fromkeys(check.result for check in self.fresh.checks))[:_MOST_PANELS]
        figure, panels = figure_with_panels(len(names), 1 if len(names) < 2 else 2, (6.2, 4.0))
        heading = "over fresh samples of the soil; dashed: means"
        figure.suptitle("\n".join(part for part in (self.origin.title, heading) if part))
        for axes, name in zip(panels, names, strict=True):
            self._draw(axes, name)
        return written(figure, target)

    def _draw(self, axes: Axes, name: str) -> None:
        """Draw the histograms of a result in both designs, with means and limits."""
        unit = MEASURES[name].unit.symbol if name in MEASURES else ""
        display = self.origin.display(name, unit, *self.fresh.values[name].tolist())
        beside = f" {display.symbol}".rstrip()
        # A requirement in another unit limits a probability, and not the result itself.
        wanted = ("requirement", name, unit)
        limits = [limit for limit in self.best.limits if (limit.kind, limit.name, limit.unit) == wanted]
        low, high = (limits[0].low, limits[0].high) if limits else (None, None)
        sides = [side / display.factor for side in (low, high) if side is not None]
        least, most = np.array([-np.inf if low is None else low, np.inf if high is None else high]) / display.factor
        designs = {"nominal design": self.nominal_fresh.values[name], "robust design": self.fresh.values[name]}
        every = np.concatenate(list(designs.values())) / display.factor
        first, last = np.quantile(every, [_CUT_OFF, 1.0 - _CUT_OFF])
        first, last = min([first, *sides]), max([last, *sides])
        room = 0.04 * (last - first) or 0.5 * abs(last) or 1.0
        bins = np.linspace(first - room, last + room, _BINS + 1).tolist()
        for (design, fresh), colour in zip(designs.items(), COLOURS, strict=False):
            values = np.sort(fresh) / display.factor
            text = f"worst tenth {np.mean(values[-max(1, len(values) // 10) :]):.4g}{beside}"
            if sides:
                text = f"{100.0 * np.mean((values >= least) & (values <= most)):.1f} % within the limit"
            label = f"{design}: mean {np.mean(values):.4g}{beside}, {text}"
            weights = np.full(len(values), 100.0 / len(values))
            axes.hist(values, bins, weights=weights, color=colour, alpha=0.45, label=label)
            axes.axvline(float(np.mean(values)), color=colour, linestyle="--", linewidth=1.2)
        for side in sides:
            axes.axvline(side, color="black", linewidth=1.4, label=f"limit {side:.4g}{beside}")
        axes.set(xlabel=display.heading(called(name)), ylabel="samples [%]")
        # Leave room for the legend above the bars.
        axes.set_ylim(0.0, axes.get_ylim()[1] * (1.1 + 0.12 * (len(designs) + len(sides))))
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


def _soil_table(field: SoilDistribution, origin: Origin) -> Grid:
    """Return a table of the uncertain properties of a soil."""
    headings = "property", "nominal", "mean", "standard deviation", "correlated with"
    table = Grid.of(f"Uncertain soil: {field.soil.name}", *headings, left=headings[-1:])
    for name, (mean, spread) in field.moments.items():
        key = f"soil.{name}"
        values = (float(getattr(field.soil, name)), mean, spread)
        display = origin.display(key, QUANTITIES[key].unit, *values)
        pairs = [(pair, value) for pair, value in field.correlation.items() if name in pair]
        others = ", ".join(f"{pair[0] if pair[1] == name else pair[1]} {value:+.2g}" for pair, value in pairs)
        table.row(key, *map(display.text, values), others)
    return table


def _design_table(best: Optimum, nominal: Optimum) -> Grid:
    """Return a table of the variables in the robust and in the nominal design."""
    title = f"Design: robust objective {best.objective:.{OBJECTIVE_DIGITS}g} ({best.status})"
    table = Grid.of(title, "variable", "robust", "nominal", "bounds", "")
    for limit in best.limits:
        if limit.kind == "bound":
            values = (limit.shown.result(optimum.variables[limit.name]) for optimum in (best, nominal))
            table.row(limit.name, *values, limit.limits, "at its bound" if limit.active else "")
    return table


def _limits_table(best: Optimum, requirements: Mapping[str, tuple[str, str]], origin: Origin) -> Grid:
    """Return a table of the requirements of the robust design.

    Args:
        best: the robust design.
        requirements: name -> its limits, and the soils in which it must hold.
        origin: gives the units of the file.
    """
    title = "Requirements of the robust design"
    table = Grid.of(title, "requirement", "limits", "in", "value", "margin", "", left=("in",))
    for limit in best.limits:
        if limit.kind == "requirement" and limit.name in requirements:
            limits, soils = requirements[limit.name]
            display = origin.display(limit.name, limit.unit, limit.value)
            margin = replace(limit, display=display).margin_text()
            decides = "decides" if limit.active else ""
            table.row(limit.name, limits, soils, display.text(limit.value), margin, decides)
    return table


def _checks_table(checks: Sequence[Check], nominal: Sequence[Check], samples: int, origin: Origin) -> Grid:
    """Return a table of a design's checks on fresh samples, beside those of the nominal design."""
    title = f"Verification on {samples} fresh samples: robust design and nominal design"
    headings = "result", "measure", "the optimiser saw", "fresh samples", "95 % interval", "nominal design", ""
    table = Grid.of(title, *headings, left=("measure",), fold=("measure",))
    for check, other in zip(checks, nominal, strict=True):
        ends = [None if end is None else _value_text(origin, check, end) for end in (check.low, check.high)]
        interval = "" if None in ends else f"{ends[0]} to {ends[1]}"
        seen, fresh = (_value_text(origin, check, x) for x in (check.seen, check.fresh))
        beside = _value_text(origin, other, other.fresh)
        table.row(check.result, check.text, seen, fresh, interval, beside, check.verdict)
    return table


def _remarks_on(check: Check, origin: Origin) -> list[str]:
    """Return remarks on a measure: the number of worse soils, and the effect of its smoothing."""
    remarks = [] if check.worse is None else [f"{check.result}, {check.text}: of the fresh samples {check.note}."]
    if check.width:
        width, rounding = _value_text(origin, check, check.width, True), _value_text(origin, check, check.rounding)
        remarks.append(f"{check.result}, {check.text}: smoothed over {width}, which changes it by {rounding}.")
    return remarks


def _value_text(origin: Origin, check: Check, value: float, of_result: bool = False) -> str:
    """Return a measure's value in the unit of the file; with ``of_result`` a value of the result itself."""
    if check.text.startswith("probability") and not of_result:
        return f"{100.0 * value:.2f} %"
    unit = MEASURES[check.result].unit.symbol if check.result in MEASURES else ""
    return origin.display(check.result, unit, check.seen).text(value)


def _indices_table(indices: Mapping[str, SobolIndices]) -> Grid:
    """Return a table of the part of each result's variance that each property explains, alone and with others."""
    names = next(iter(indices.values())).names
    title = "Sobol indices of the robust design: part of each result's variance, alone / with others"
    table = Grid.of(title, "result", *names, fold=names)
    for result in indices.values():
        parts = [f"{_percent(a)} / {_percent(b)}" for a, b in zip(result.first, result.total, strict=True)]
        table.row(result.result, *parts)
    return table


def _percent(part: float) -> str:
    return "0 %" if abs(part) < _LEAST_PART else f"{100.0 * part:.1f} %"
