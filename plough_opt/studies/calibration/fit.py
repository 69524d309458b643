"""`Fit`, the result of a calibration: unknowns with intervals, rows, tables, picture and files; rows held out of it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import cycle, permutations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_named, plain_number, whole_number
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.expressions import as_number
from plough_opt.core.files import COLOURS, figure_with_panels, written
from plough_opt.core.plain_data import Array, IntervalEnd, MaybeInfinite, Unsaved
from plough_opt.core.quantities import EVERY
from plough_opt.core.saving import Origin, Saveable, versions
from plough_opt.core.tables import Grid, Page, Part, data_frame
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import called
from plough_opt.soil.soil import Soil
from plough_opt.studies.calibration.least_squares import NOMINAL, Solution, quantile
from plough_opt.studies.calibration.measurements import RECORD, Measurements
from plough_opt.studies.calibration.model import Model, Unknown
from plough_opt.studies.calibration.remarks import Undetermined, undetermined, warnings_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


LOSSES: Final = ("squares", "soft_l1")
ERRORS: Final = ("constant", "relative")


@dataclass(frozen=True, repr=False, eq=False)
class Fit(Saveable):
    """A calibration: unknowns with their uncertainty, and how well the model follows the data.

    Attributes:
        title: title of the calibration.
        unknowns: the unknowns with their bounds.
        values: unknown -> value, SI; if the data do not determine the unknown, one of many that fit.
        standard_errors: unknown -> standard error, SI; infinite if the data do not narrow it further than its bounds.
        correlation: correlations of the errors of the unknowns (p, p); 0 for undetermined ones.
        unidentifiable: combinations of unknowns that the data do not determine.
        rows: the measured rows with their predictions; after `hold_out` those that were held out.
        loss: name of the loss.
        optima: sums of the losses at all distinct local optima, the best first.
        fitted: number of rows that were fitted: of weight above 0, and not held out.
        freedom: degrees of freedom: number of rows of weight above 0, minus determined directions.
        scatter: square root of the sum of squared residuals over the degrees of freedom; residuals are relative to the
            stated sigma; if no sigma is stated, to the mean measured value, or to each prediction.
        errors: "stated" by sigma; or their model: "constant", or "relative" to the predictions.
        warnings: warnings about the results.
        seconds: time taken [s].
        level: confidence level of the intervals in tables.
        saved_intervals: level -> unknown -> interval, as far as they were computed.
        versions: versions of packages, and the kind of machine.
        source: what the fit was computed from; None for a loaded fit.
        origin: the question that the fit answers.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
        >>> fit = po.calibrate(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
        >>> list(fit.values)
        ['soil.cohesion']
    """

    kind = "calibration"

    title: str
    unknowns: tuple[Unknown, ...]
    values: Mapping[str, float]
    standard_errors: Mapping[str, MaybeInfinite]
    correlation: Array
    unidentifiable: tuple[Undetermined, ...]
    rows: tuple[Row, ...]
    loss: str
    optima: tuple[float, ...]
    fitted: int
    freedom: int
    scatter: float
    errors: str
    warnings: tuple[str, ...]
    seconds: float = field(compare=False)
    level: float = 0.95
    saved_intervals: dict[str, Mapping[str, Interval]] = field(default_factory=dict, compare=False)
    versions: Mapping[str, str] = field(default_factory=versions)
    source: Annotated[Source | None, Unsaved()] = field(default=None, compare=False)
    origin: Origin = field(default=Origin())

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Two determined unknowns -> correlation of their errors, in either order."""
        determined = [k for k, name in enumerate(self.values) if self.standard_errors[name] < math.inf]
        names = [*self.values]
        return {(names[i], names[j]): float(self.correlation[i, j]) for i, j in permutations(determined, 2)}

    @property
    def observed(self) -> Array:
        """Measured values, SI."""
        return np.array([row.observed for row in self.rows])

    @property
    def predicted(self) -> Array:
        """Fitted values, SI."""
        return np.array([row.predicted for row in self.rows])

    @property
    def residuals(self) -> Array:
        """Predicted minus observed values, SI."""
        return np.array([row.residual for row in self.rows])

    def intervals(self, level: float = 0.95) -> Mapping[str, Interval]:
        """Return the confidence interval of every unknown, SI, from the profile likelihood.

        It includes the model's curvature. Quantiles are normal if sigma is stated, and Student's if it is estimated.

        Args:
            level: confidence level, between 0 and 1.

        Raises:
            InputError: an invalid level, or intervals that a loaded fit does not contain.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> wide, narrow = (fit.intervals(level)["soil.cohesion"] for level in (0.95, 0.5))
            >>> bool(wide.lower < narrow.lower < fit.values["soil.cohesion"] < narrow.upper < wide.upper)
            True
        """
        name = str(plain_number("level", level, above=0.0, below=1.0, why="0.95 is usual"))
        if name not in self.saved_intervals:
            fit = self._source_to(f"compute intervals of level {level:g} of").solution
            self.saved_intervals[name] = {u.name: _interval(fit, u, k, level) for k, u in enumerate(self.unknowns)}
        return self.saved_intervals[name]

    def hold_out(self, part: float = 1 / 3, *, by: str | None = None, seed: int = 1, level: float = 0.95) -> Fit:
        """Fit to a part of the rows anew, and return this fit with the predictions of the others as its rows.

        Args:
            part: part of the rows that is held out, between 0 and 1.
            by: key of a column, such as "share.wedge_angle": whole groups of rows with one value in it are held out,
                and rows without this column are fitted. Default: single rows, at random; of a record the last ones.
            seed: seed of the choice.
            level: level of the prediction intervals, between 0 and 1.

        Raises:
            InputError: a part that leaves too few rows, no such column, or a loaded fit.
            NotConverged: the fit to the other rows did not converge.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> fit.hold_out(1 / 3, by="scene.tow_speed").fitted
            16
        """
        level = plain_number("level", level, above=0.0, below=1.0, why="0.95 is usual")
        source = self._source_to("hold rows out of")
        held, asked = source.chosen(part, by, seed), source.solution.asked
        counted = asked.counted.copy()
        counted[held] = False
        if np.sum(counted) < asked.least_rows:
            few = f"leaves fewer than the {asked.least_rows} that {len(self.unknowns)} unknowns need"
            raise InputError(f"holding out {len(held)} rows {few}: hold out a smaller part, or measure more")
        # The other rows choose their own starts, so that nothing of the rows held out enters.
        fit = replace(source, solution=replace(asked, counted=counted).fitted(starts=4)).fit(time.perf_counter())
        title, rows = f"{self.title}: rows held out", tuple(fit.rows[k] for k in held)
        return replace(fit, title=title, rows=rows, level=level, origin=self.origin)

    @property
    def half_widths(self) -> Array:
        """Half widths of the prediction intervals of the rows; infinite where the fit does not determine them."""
        known = self.errors == "stated" and self.loss == "squares"
        spread = np.hypot([row.sigma for row in self.rows], [row.standard_error for row in self.rows])
        return np.asarray(quantile(self.level, math.inf if known else self.freedom) * spread)

    @property
    def coverage(self) -> tuple[int, int]:
        """Number of rows whose measured value lies in its prediction interval, and number of finite intervals."""
        finite = np.isfinite(self.half_widths)
        return int(np.sum((np.abs(self.residuals) <= self.half_widths) & finite)), int(np.sum(finite))

    @property
    def rms(self) -> dict[str, float]:
        """Result -> root mean square of its errors."""
        results = np.array([row.result for row in self.rows])
        names = dict.fromkeys(results.tolist())
        return {name: float(np.sqrt(np.mean(self.residuals[results == name] ** 2))) for name in names}

    def words(self) -> str:
        """Return errors and coverage of the rows, those that `hold_out` held out, in a sentence.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> fit.hold_out(1 / 3).words().partition(",")[0]
            'Fitted to 16 rows'
        """
        errors = []
        for name, rms in self.rms.items():
            like = [row for row in self.rows if row.result == name]
            mean = float(np.mean([abs(row.observed) for row in like]))
            size = self.origin.display(name, like[0].unit, mean).text(rms, 3)
            errors.append(f"{name} {size} ({100.0 * rms / mean:.3g} % of its mean)" if mean else f"{name} {size}")
        (inside, finite), count = self.coverage, len(self.rows)
        sizes = f"Fitted to {self.fitted} rows, RMS error of {count} others: {'; '.join(errors)}"
        hits = f"{inside} of {finite} lie in their {100 * self.level:g} % prediction intervals"
        more = f"; {count - finite} more depend on what the fitted rows do not determine" if finite < count else ""
        return f"{sizes}; {hits}{more}."

    def also_saved(self) -> dict[str, Any]:
        """Return the errors of the rows, and how many lie in their prediction intervals."""
        return {"rms": self.rms, "inside": self.coverage[0], "finite": self.coverage[1]}

    @property
    def scene(self) -> Scene:
        """The scene with the calibrated values."""
        source = self._source_to("take the scene of")
        scene = source.model.scene(self.values)
        files = ", ".join(dict.fromkeys(m.name for m in source.sets))
        origin = f"{', '.join(self.values)} from {files}; {scene.soil.source}"
        return replace(scene, soil=replace(scene.soil, name=f"{scene.soil.name}, calibrated", source=origin))

    @property
    def soil(self) -> Soil:
        """The soil with the calibrated values."""
        return self.scene.soil

    def page(self) -> Page:
        """Return the unknowns with their intervals, the undetermined combinations, and the scatter about the fit.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> [row[0] for row in fit.page().parts[0].rows]
            ['soil.cohesion', 'soil.tool_friction', 'effects.rate_term']
        """
        pairs = sorted(self.correlations.items(), key=lambda pair: -abs(pair[1]))[::2]
        correlated = [f"Errors of {first} and {second} are correlated: {size:+.3f}."
                      for (first, second), size in pairs if abs(size) >= 0.5]  # fmt: skip
        relative = "of the predicted values" if self.errors == "relative" else "of the mean measured value"
        kind = "times the stated sigma" if self.errors == "stated" else relative
        scatter = f"Scatter about the fit: {self.scatter:.3g} {kind}, {self.freedom} degrees of freedom."
        open_ended = [f"Not determined: {item.words}." for item in self.unidentifiable]
        shown: list[Part] = [self._table(), *correlated, *open_ended, scatter]
        files = ", ".join(dict.fromkeys(row.place.partition(",")[0] for row in self.rows))
        heading = f"{len(self.unknowns)} unknowns from {len(self.rows)} rows of {files}"
        footer = f"Converged: no step lowers the loss; {self.seconds:.2f} s"
        return Page(heading, tuple(shown), self.warnings, footer, self.title)

    def _table(self) -> Grid:
        """Return the unknowns with standard errors and intervals."""
        heading = f"{100 * self.level:g} % interval"
        table = Grid.of("Calibrated", "unknown", "value", "standard error", heading, "bounds", "", left=("",))
        for u in self.unknowns:
            value, error, own = self.values[u.name], self.standard_errors[u.name], self.intervals(self.level)[u.name]
            text = self.origin.display(u.name, u.unit, value, u.upper).text
            cells, bounds = ("not determined", "infinite", "infinite"), f"{text(u.lower, 3)} to {text(u.upper, 3)}"
            if error < math.inf:
                cells = text(value), text(error, 3), f"{text(own.lower, 4)} to {text(own.upper, 4)}"
            notes = [f"{side} end is the bound" for side in own.clipped] + ["linearised"] * (own.kind != "profile")
            table.row(u.name, *cells, bounds, "; ".join(notes))
        return table

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each measured row with its prediction, SI; a column holds the units.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> len(fit.to_dataframe())
            24
        """
        names = ("place", "result", "unit", "observed", "predicted", "residual", "sigma", "standard_error")
        columns = {name: [getattr(row, name) for row in self.rows] for name in names}
        return data_frame(columns, {row.result: row.unit for row in self.rows})

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw measured against predicted values, and the residuals over what varies most.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a path that cannot be written.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> len(fit.plot().axes)
            2
        """
        return written(_drawn(self.title, self.rows, self.origin), target)

    def to_json(self, page: Page | None = None) -> str:
        """Return the fit as JSON, with its intervals: see `Saveable.to_json`.

        Example:
            >>> import json
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> json.loads(fit.to_json())["kind"]
            'calibration'
        """
        for level in (0.95, self.level) if self.source is not None else ():
            self.intervals(level)
        return super().to_json(page)

    def _source_to(self, verb: str) -> Source:
        """Return what the fit was computed from; raise InputError that says what a loaded fit cannot do."""
        if self.source is None:
            raise InputError(f"this fit comes from a file: calibrate again to {verb} it")
        return self.source


@dataclass(frozen=True)
class Interval:
    """A confidence interval of one unknown, SI.

    Attributes:
        lower: its lower end; minus infinity if the data do not determine the unknown.
        upper: its upper end.
        clipped: which ends ("lower", "upper") are bounds of the unknown, because the data do not exclude the bounds.
        kind: "profile"; or "linearised", the value plus and minus quantile times standard error, if the interval is too
            short for the two to differ, or if the profile could not be computed.
    """

    lower: IntervalEnd
    upper: IntervalEnd
    clipped: tuple[str, ...] = ()
    kind: str = "profile"

    def __contains__(self, value: float) -> bool:
        return self.lower <= value <= self.upper

    def __iter__(self) -> Iterator[float]:
        return iter((self.lower, self.upper))


def _interval(fit: Solution, unknown: Unknown, k: int, level: float) -> Interval:
    """Return the interval of unknown number k."""
    if fit.errors[k] == np.inf:
        return Interval(-np.inf, np.inf)
    reach, y, kind = quantile(level, fit.student) * float(fit.errors[k]), float(fit.y[k]), "linearised"
    low, high = y - reach, y + reach
    if reach > 1e-6:  # the loss is quadratic over a shorter interval
        with suppress(NotConverged):
            (low, high), kind = fit.profile(k, level), "profile"
    at_lower, at_upper = low <= 1e-6, high >= 1.0 - 1e-6
    lower = unknown.lower if at_lower else float(unknown.unscaled(low))
    upper = unknown.upper if at_upper else float(unknown.unscaled(high))
    return Interval(lower, upper, ("lower",) * at_lower + ("upper",) * at_upper, kind)


@dataclass(frozen=True)
class Row:
    """A measured row with its prediction, SI.

    Attributes:
        place: file and line, or set and row.
        result: the measured result.
        unit: its unit.
        conditions: conditions of the row by key; of a record also its "time" [s].
        observed: measured value.
        predicted: fitted value.
        sigma: standard deviation of the measurement, stated or estimated; infinite for a row of weight 0.
        standard_error: standard error of the prediction; infinite where it depends on what the data do not determine.
        residual: predicted minus observed value.
    """

    place: str
    result: str
    unit: str
    conditions: Mapping[str, float]
    observed: float
    predicted: float
    sigma: MaybeInfinite
    standard_error: MaybeInfinite
    residual: float


@dataclass(frozen=True)
class Source:
    """What a fit was computed from: title, model, sets of measurements, and the solution."""

    title: str
    model: Model
    sets: tuple[Measurements, ...]
    solution: Solution

    @property
    def values(self) -> dict[str, float]:
        """Unknown -> fitted value, SI."""
        return {name: float(as_number(value)) for name, value in self.model.values(self.solution.y).items()}

    def fit(self, started: float) -> Fit:
        """Return the fit; ``started`` is the value of `time.perf_counter` at its beginning."""
        solution, unknowns = self.solution, self.model.unknowns
        problem, slopes = solution.asked, [u.slope(float(y)) for u, y in zip(unknowns, solution.y, strict=True)]
        unscaled = problem.over(solution.predicted).weights * (solution.predicted - problem.observed)
        scatter = float(np.sqrt(np.sum(unscaled**2) / max(solution.freedom, 1)))
        return Fit(
            title=self.title,
            unknowns=unknowns,
            values=self.values,
            standard_errors={u.name: float(e * s) for u, e, s in zip(unknowns, solution.errors, slopes, strict=True)},
            correlation=solution.covariance / np.outer(solution.errors, solution.errors),
            unidentifiable=tuple(undetermined(unknowns, solution)),
            rows=self._rows(),
            loss=LOSSES[problem.robust],
            optima=solution.optima,
            fitted=int(np.sum(problem.counted)),
            freedom=solution.freedom,
            scatter=scatter if problem.stated else NOMINAL * scatter,
            errors="stated" if problem.stated else ERRORS[problem.relative],
            warnings=tuple(warnings_of(solution, self.sets, self.model)),
            seconds=time.perf_counter() - started,
            source=self,
        )

    def _rows(self) -> tuple[Row, ...]:
        """Return every measured row with its prediction."""
        fit, observed, rows = self.solution, self.solution.problem.observed, list[Row]()
        columns = [observed, fit.predicted, fit.sigma, fit.prediction_errors(), fit.predicted - observed]
        numbers = np.column_stack(columns).tolist()
        for m in self.sets:
            for k in range(len(m.values)):
                places = m.at(k) | ({} if m.time is None else {"time": float(m.time[k])})
                rows.append(Row(m.row(k), m.result, m.unit.symbol, places, *numbers[len(rows)]))
        return tuple(rows)

    def chosen(self, part: float, by: str | None, seed: int) -> NDArray[np.intp]:
        """Return the numbers of the rows to hold out: none of weight 0, and none that measures an unknown directly.

        Raises:
            InputError: no such column, or an invalid part.
        """
        share = plain_number("the part of the rows to hold out", part, above=0.0, below=1.0, why="1/3 is usual")
        direct = np.concatenate([np.full(len(m.values), m.direct) for m in self.sets])
        rows = np.flatnonzero(~direct & self.solution.asked.counted)
        groups: Array = rows.astype(float)
        if by is not None:
            check_named(
                "{} is not a column of the data", by, dict.fromkeys(key for m in self.sets for key in m.conditions)
            )
            without = [np.full(len(m.values), np.nan) for m in self.sets]
            groups = np.concatenate([m.conditions.get(by, x) for m, x in zip(self.sets, without, strict=True)])[rows]
        order = np.unique(groups[np.isfinite(groups)])
        # Of a record the last rows are held out, because errors of neighbours are correlated.
        if by is not None or all(m.result != RECORD for m in self.sets):
            order = np.random.default_rng(whole_number("seed", seed)).permutation(order)
        return rows[np.isin(groups, order[-max(1, round(share * len(order))) :])]


def _drawn(title: str, rows: Sequence[Row], origin: Origin) -> Figure:
    """Draw measured against predicted values with errors, and standardised residuals over what varies.

    Several results are each divided by their largest value.
    """
    rows = [row for row in rows if math.isfinite(row.sigma)]
    figure, (fit, over) = figure_with_panels(2, 2, (5.5, 4.2))
    results, (places, label), heading = (
        [row.result for row in rows],
        _varied(rows, origin),
        "value, over the largest of its kind",
    )
    numbers = np.array([(r.predicted, r.observed, r.standard_error, r.sigma) for r in rows])
    numbers[~np.isfinite(numbers)] = 0.0
    for result, colour in zip(dict.fromkeys(results), cycle(COLOURS)):
        like = np.array([name == result for name in results])
        size = float(np.max(np.abs(numbers[like, 0])))
        if len({*results}) == 1:
            unit = origin.display(result, rows[0].unit, size)
            size, heading = unit.factor, unit.heading(called(result))
        x, y, xerr, yerr = numbers[like].T
        style: dict[str, Any] = {"fmt": "o", "markersize": 4, "linewidth": 0.8, "color": colour}
        style["label"] = f"{called(result)}, n = {len(x)}"
        fit.errorbar(x / size, y / size, xerr=1.96 * xerr / size, yerr=1.96 * yerr / size, **style)
        over.errorbar(places[like], (x - y) / yerr, **style)
    fit.axline((1.0, 1.0), slope=1.0, color="black", linewidth=0.9, label="measured = predicted")
    fit.set(xlabel=f"predicted {heading}", ylabel=f"measured {heading}", title="bars: 95 % of the errors of both")
    for line in (-1.96, 0.0, 1.96):
        over.axhline(line, color="gray", linewidth=0.9, linestyle="--" if line else "-")
    over.set(xlabel=label, ylabel="(predicted - measured) / standard error", title="dashes: 95 % of normal errors")
    for axes in (fit, over):
        axes.grid(alpha=0.25)
        axes.legend(fontsize="small")
    figure.suptitle(title)
    return figure


def _varied(rows: Sequence[Row], origin: Origin) -> tuple[Array, str]:
    """Return a coordinate of each row, and its label: time or speed if it varies, else the most varied condition."""
    keys = dict.fromkeys(key for row in rows for key in row.conditions)
    counts = {key: len({row.conditions.get(key) for row in rows}) for key in keys}
    preferred = [key for key in ("time", "scene.tow_speed") if counts.get(key, 0) > 1]
    name = next(iter(preferred), max(counts, key=counts.__getitem__, default=""))
    if not name:
        return np.arange(1.0, len(rows) + 1.0), "number of the row"
    values = np.array([row.conditions.get(name, math.nan) for row in rows])
    display = origin.display(name, "s" if name == "time" else EVERY[name].unit, *values[np.isfinite(values)].tolist())
    return values / display.factor, display.heading(called(name))
