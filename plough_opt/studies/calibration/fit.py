"""`Fit`, the result of a calibration: unknowns with intervals, rows, tables, picture and files."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, cycle
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from scipy import stats

from plough_opt.core.checks import check_choice
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import ByValue
from plough_opt.core.files import COLOURS, figure_with_panels, written
from plough_opt.core.plain_data import Array, MaybeInfinite, Unsaved
from plough_opt.core.quantities import EVERY
from plough_opt.core.saving import Origin, Saveable, versions
from plough_opt.core.tables import Grid, Page, Part, data_frame
from plough_opt.core.units import Display, Unit, display_of
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import called
from plough_opt.soil.soil import Soil
from plough_opt.studies.calibration.estimate import ERRORS, NOMINAL, Estimate, Undetermined, undetermined
from plough_opt.studies.calibration.model import Row, result_unit
from plough_opt.studies.calibration.quality import (
    Candidate,
    CrossValidation,
    Interval,
    Kind,
    NextMeasurement,
    caveats,
    check_level,
    cross_validate,
    held_out,
    interval,
    next_measurements,
)

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Largest number of rows in the table of candidates.
_MOST_CANDIDATES: Final = 6


@dataclass(frozen=True)
class FittedUnknown:
    """A fitted unknown, SI.

    Attributes:
        name: its key in a problem file.
        unit: SI unit.
        value: fitted value; if the data do not determine the unknown, one of many that fit.
        standard_error: its standard error; infinite if the data do not determine it.
        lower: its lower bound.
        upper: its upper bound.
        determined: whether the data narrow it further than its bounds.
    """

    name: str
    unit: str
    value: float
    standard_error: MaybeInfinite
    lower: float
    upper: float
    determined: bool


@dataclass(frozen=True)
class Correlation:
    """Correlation of the errors of two determined unknowns."""

    first: str
    second: str
    value: float


@dataclass(frozen=True)
class KnownInterval:
    """A computed interval of an unknown, with its level and the requested kind."""

    name: str
    level: float
    asked: Kind
    interval: Interval


@dataclass(frozen=True, eq=False)
class HeldOut(ByValue):
    """Predictions of rows that were held out of a fit, SI.

    Attributes:
        title: title of the calibration.
        fitted: number of rows that were fitted.
        values: unknown -> value fitted to these.
        rows: the rows held out; standard errors of predictions that the fitted rows do not determine are infinite.
        level: level of the prediction intervals.
        quantile: half width of an interval over the standard deviation of measurement and prediction together.
        origin: origin of the fit, which gives the units of the file.
    """

    title: str
    fitted: int
    values: Mapping[str, float]
    rows: tuple[Row, ...]
    level: float
    quantile: float
    origin: Origin

    @property
    def half_widths(self) -> Array:
        """Half widths of the prediction intervals; infinite where the fitted rows do not determine a prediction."""
        return np.array([self.quantile * math.hypot(row.sigma, row.standard_error) for row in self.rows])

    @property
    def coverage(self) -> tuple[int, int]:
        """Number of rows whose measured value lies in its prediction interval, and number of finite intervals."""
        finite = np.isfinite(self.half_widths)
        inside = np.abs([row.residual for row in self.rows]) <= self.half_widths
        return int(np.sum(inside & finite)), int(np.sum(finite))

    @property
    def rms(self) -> dict[str, float]:
        """Result -> root mean square of its errors."""
        results = dict.fromkeys(row.result for row in self.rows)
        return {name: math.sqrt(np.mean([row.residual**2 for row in self.rows if row.result == name]))
                for name in results}  # fmt: skip

    def plain(self) -> dict[str, Any]:
        """Return the predictions as plain values for JSON, SI; None stands for what is not determined."""
        halves = (half if half < math.inf else None for half in self.half_widths.tolist())
        rows = [{"place": row.place, "observed": row.observed, "predicted": row.predicted, "half_width": half}
                for row, half in zip(self.rows, halves, strict=True)]  # fmt: skip
        about = {"fitted": self.fitted, "values": dict(self.values), "level": self.level, "rms": self.rms}
        return about | {"inside": self.coverage[0], "finite": self.coverage[1], "rows": rows}

    def words(self) -> str:
        """Return errors and coverage in a sentence."""
        errors = []
        for name, rms in self.rms.items():
            like = [row for row in self.rows if row.result == name]
            mean = float(np.mean([abs(row.observed) for row in like]))
            size = self.origin.display(name, like[0].unit, mean).text(rms, 3)
            errors.append(f"{name} {size}" + (f" ({100.0 * rms / mean:.3g} % of its mean)" if mean else ""))
        inside, finite = self.coverage
        open_ended = len(self.rows) - finite
        more = f"; {open_ended} more depend on what the fitted rows do not determine" if open_ended else ""
        return (
            f"Fitted to {self.fitted} rows, RMS error of {len(self.rows)} others: {'; '.join(errors)};"
            f" {inside} of {finite} lie in their {100 * self.level:g} % prediction intervals{more}."
        )

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw measured over predicted values of the rows held out, with the errors of both.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the fitted rows determine no prediction, or the file cannot be written.
        """
        rows = [row for row in self.rows if math.isfinite(row.standard_error)]
        if not rows:
            raise InputError("the fitted rows determine none of the rows held out: hold out a smaller part")
        figure, (axes,) = figure_with_panels(1, 1, (7.2, 5.8))
        _draw_fit(axes, rows, {row.result: _display(row, rows, self.origin) for row in rows})
        figure.suptitle(f"{self.title}\nrows held out of the fit", fontsize="medium")
        return written(figure, target)


def fitted_unknowns(fit: Estimate) -> tuple[FittedUnknown, ...]:
    """Return every unknown with its standard error."""
    errors = np.where(fit.spread.determined, np.sqrt(np.diag(fit.spread.covariance)), np.inf)
    return tuple(
        FittedUnknown(u.name, u.unit, float(u.unscaled(y)), float(error * u.slope(y)), u.lower, u.upper, error < np.inf)
        for u, y, error in zip(fit.unknowns, fit.y.tolist(), errors.tolist(), strict=True)
    )


def correlations_of(fit: Estimate) -> tuple[Correlation, ...]:
    """Return the correlations of the determined unknowns."""
    errors, unknowns = np.sqrt(np.diag(fit.spread.covariance)), fit.unknowns
    return tuple(
        Correlation(unknowns[i].name, unknowns[j].name, float(fit.spread.covariance[i, j] / (errors[i] * errors[j])))
        for i, j in combinations(np.flatnonzero(errors > 0.0).tolist(), 2)
    )


def rows_of(fit: Estimate) -> tuple[Row, ...]:
    """Return every measured row with its prediction."""
    error = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", fit.slope, fit.spread.covariance, fit.slope), 0.0))
    columns = (fit.data.observed, fit.predicted, fit.deviation, error, fit.predicted - fit.data.observed)
    numbers = iter(np.column_stack(columns).tolist())
    return tuple(
        Row(m.row(k), m.result, result_unit(m.result).symbol, m.at(k), None if m.time is None else float(m.time[k]),
            *next(numbers))
        for m in fit.setup.measured for k in range(m.rows)
    )  # fmt: skip


def unknowns_table(
    unknowns: Sequence[FittedUnknown], level: float, intervals: Mapping[str, Interval], origin: Origin
) -> Grid:
    """Return a table of the unknowns with standard errors, and with intervals if some are given."""
    between = [f"{100 * level:g} % interval"] if intervals else []
    table = Grid.of("Calibrated", "unknown", "value", "standard error", *between, "bounds", "", left=("",))
    for unknown in unknowns:
        value, error, ends, notes = "not determined", "infinite", "infinite", []
        if unknown.determined:
            value, error = _text(origin, unknown, unknown.value), _text(origin, unknown, unknown.standard_error, 3)
        if interval := intervals.get(unknown.name):
            if unknown.determined:
                ends = " to ".join(_text(origin, unknown, end, 4) for end in interval)
            notes = [f"{side} end is the bound" for side in interval.clipped]
            notes += ["linearised"] if unknown.determined and interval.kind == "linearised" else []
        bounds = " to ".join(_text(origin, unknown, end, 3) for end in (unknown.lower, unknown.upper))
        table.row(unknown.name, value, error, *([ends] if between else []), bounds, "; ".join(notes))
    return table


def next_table(unknowns: Sequence[FittedUnknown], ranking: Sequence[NextMeasurement], origin: Origin) -> Grid:
    """Return a table of the best candidates with the standard errors of the unknowns after each."""
    names = [unknown.name.rpartition(".")[2] for unknown in unknowns]
    title = "What to measure next: standard errors now, and with one more measurement of the same quality"
    table = Grid.of(title, "measurement", *names, fold=("measurement",))
    table.row("now", *(_text(origin, unknown, ranking[0].errors[unknown.name][0], 3) for unknown in unknowns))
    for item in ranking[:_MOST_CANDIDATES]:
        cells = [_text(origin, unknown, item.errors[unknown.name][1], 3) for unknown in unknowns]
        table.row(item.candidate.describe(), *cells)
    return table


def _text(origin: Origin, unknown: FittedUnknown, value: float, digits: int = 5) -> str:
    """Return a value of an unknown as text, in the unit in which all its values are shown."""
    return origin.display(unknown.name, unknown.unit, unknown.value, unknown.upper).text(value, digits)


# Correlations of at least this size are reported.
_NOTABLE_CORRELATION: Final = 0.5


@dataclass(frozen=True, repr=False, eq=False)
class Fit(Saveable):
    """A calibration: unknowns with their uncertainty, and how well the model follows the data.

    Attributes:
        title: title of the calibration.
        unknowns: the unknowns with values and standard errors.
        correlations_found: correlations of the errors of determined unknowns, each pair once.
        unidentifiable: combinations of unknowns that the data do not determine.
        rows: the measured rows with their predictions.
        loss: name of the loss.
        total: sum of the losses.
        optima: sums of the losses at all distinct local optima.
        freedom: degrees of freedom: number of rows of weight above 0, minus determined directions.
        scatter: square root of the sum of squared residuals over the degrees of freedom; residuals are relative to the
            stated sigma; if no sigma is stated, to the mean measured value, or to each prediction.
        stated: whether sigma was stated.
        errors: model of the errors if it was not: "constant" or "relative".
        status: "converged", since a fit that did not converge is refused.
        warnings: warnings about the results.
        seconds: time taken [s].
        saved_intervals: intervals in a loaded file.
        saved_next: ranking of further measurements in a loaded file.
        versions: versions of packages, and the kind of machine.
        source: the estimate behind the fit; None for a loaded fit.
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
    unknowns: tuple[FittedUnknown, ...]
    correlations_found: tuple[Correlation, ...]
    unidentifiable: tuple[Undetermined, ...]
    rows: tuple[Row, ...]
    loss: str
    total: float
    optima: tuple[float, ...]
    freedom: int
    scatter: float
    stated: bool
    status: str
    warnings: tuple[str, ...]
    seconds: float = field(compare=False)
    saved_intervals: tuple[KnownInterval, ...] = ()
    saved_next: tuple[NextMeasurement, ...] = ()
    errors: str = "constant"
    versions: Mapping[str, str] = field(default_factory=versions)
    source: Annotated[Estimate | None, Unsaved()] = field(default=None, repr=False, compare=False)
    origin: Origin = field(default=Origin())

    @property
    def values(self) -> dict[str, float]:
        """Unknown -> value, SI."""
        return {unknown.name: unknown.value for unknown in self.unknowns}

    @property
    def standard_errors(self) -> dict[str, float]:
        """Unknown -> standard error, SI; infinite if the data do not determine it."""
        return {unknown.name: unknown.standard_error for unknown in self.unknowns}

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Two determined unknowns -> correlation of their errors, in either order."""
        pairs = {(c.first, c.second): c.value for c in self.correlations_found}
        return pairs | {(second, first): value for (first, second), value in pairs.items()}

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

    def intervals(self, level: float = 0.95, kind: Kind = "profile") -> dict[str, Interval]:
        """Return the confidence interval of every unknown, SI.

        Args:
            level: confidence level, between 0 and 1.
            kind: "profile": from the profile likelihood, which includes the model's curvature; "linearised": standard
                error times quantile. Quantiles are normal if sigma is stated, and Student's if it is estimated.

        Raises:
            InputError: an invalid level or kind, or intervals that a loaded fit does not contain.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> wide, narrow = (fit.intervals(level)["soil.cohesion"] for level in (0.95, 0.5))
            >>> bool(wide.lower < narrow.lower < fit.values["soil.cohesion"] < narrow.upper < wide.upper)
            True
        """
        level = check_level(level)
        check_choice("kind", kind, ("profile", "linearised"))
        asked = [known for known in self._known if (known.level, known.asked) == (level, kind)]
        if not asked:
            estimate = self._source_to(f"compute {kind} intervals of level {level:g} of")
            intervals = ((u.name, interval(estimate, k, level, kind)) for k, u in enumerate(estimate.unknowns))
            asked = [KnownInterval(name, level, kind, found) for name, found in intervals]
            self._known.extend(asked)
        return {known.name: known.interval for known in asked}

    def next_measurements(self, candidates: Sequence[Candidate] | None = None) -> tuple[NextMeasurement, ...]:
        """Return possible further measurements with their gain of information, the best first.

        Args:
            candidates: measurements to rank; default: other wedge angles, heights, speeds and depths, a tool of known
                friction, the loosened radius, and a direct measurement of each unknown.

        Raises:
            InputError: a candidate of another type, or candidates for a loaded fit, which only has a saved ranking.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> fast = po.Candidate("mean_draft", {"scene.tow_speed": 4.0})
            >>> [found.candidate == fast for found in fit.next_measurements([fast])]
            [True]
        """
        if candidates is not None:
            return next_measurements(self._source_to("rank other candidates for"), candidates)
        return self._ranking

    @property
    def next_measurement(self) -> NextMeasurement:
        """The candidate with the largest gain of information."""
        return self.next_measurements()[0]

    def cross_validation(self, folds: int | None = None, *, seed: int = 1) -> CrossValidation:
        """Return how well the model predicts rows that are left out of the fit.

        Args:
            folds: number of parts, each left out in turn; default: one for each row, 20 for over 60 rows, and 5 if the
                rows need runs.
            seed: seed of the shuffling.

        Raises:
            InputError: an invalid number of folds, or a loaded fit.
            NotConverged: a fit without some of the rows did not converge.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> found = fit.cross_validation(folds=4)
            >>> found.rms["mean_draft"] > found.rms_fitted["mean_draft"]
            True
        """
        return cross_validate(self._source_to("cross-validate"), folds, seed)

    def hold_out(self, part: float = 1 / 3, *, by: str | None = None, seed: int = 1, level: float = 0.95) -> HeldOut:
        """Fit to a part of the rows anew, and return how well this predicts the others.

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
        level = check_level(level)
        whole, held, errors = held_out(self._source_to("hold rows out of"), part, by, seed)
        rows = rows_of(whole)
        predicted = tuple(replace(rows[k], standard_error=float(e)) for k, e in zip(held, errors, strict=True))
        values = {unknown.name: unknown.value for unknown in fitted_unknowns(whole)}
        fitted = whole.data.count - len(held)
        return HeldOut(self.title, fitted, values, predicted, level, whole.quantile(level), self.origin)

    @property
    def scene(self) -> Scene:
        """The scene with the calibrated values."""
        setup = self._source_to("take the scene of").setup
        scene = setup.model.scene(self.values)
        properties = [name.removeprefix("soil.") for name in self.values if name.startswith("soil.")]
        if not properties:
            return scene
        files = ", ".join(dict.fromkeys(m.name for m in setup.measured))
        source = f"{', '.join(properties)} from {files}; {scene.soil.source}"
        return replace(scene, soil=replace(scene.soil, name=f"{scene.soil.name}, calibrated", source=source))

    @property
    def soil(self) -> Soil:
        """The soil with the calibrated values."""
        return self.scene.soil

    def page(self) -> Page:
        """Return the unknowns, the undetermined combinations, the next measurements, and the scatter about the fit.

        Intervals and the ranking of further measurements are costly, and are shown only if the fit holds them: as one
        that `complete` returned or a file holds.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> [row[0] for row in fit.page().parts[0].rows]
            ['soil.cohesion', 'soil.tool_friction', 'effects.rate_term']
        """
        profiles = [item for item in self.saved_intervals if item.asked == "profile"]
        level = profiles[-1].level if profiles else 0.0
        intervals = {item.name: item.interval for item in profiles if item.level == level}
        shown: list[Part] = [unknowns_table(self.unknowns, level, intervals, self.origin)]
        correlated = [c for c in self.correlations_found if abs(c.value) >= _NOTABLE_CORRELATION]
        for c in sorted(correlated, key=lambda c: -abs(c.value)):
            shown.append(f"Errors of {c.first} and {c.second} are correlated: {c.value:+.3f}.")
        shown += [f"Not determined: {item.words}." for item in self.unidentifiable]
        if self.saved_next:
            shown.append(next_table(self.unknowns, self.saved_next, self.origin))
        relative = "of the predicted values" if self.errors == "relative" else "of the mean measured value"
        kind = "times the stated sigma" if self.stated else relative
        shown.append(f"Scatter about the fit: {self.scatter:.3g} {kind}, {self.freedom} degrees of freedom.")
        footer = f"Converged: no step lowers the loss; {self.seconds:.2f} s"
        files = ", ".join(dict.fromkeys(row.place.partition(",")[0] for row in self.rows))
        heading = f"{len(self.unknowns)} unknowns from {len(self.rows)} rows of {files}"
        return Page(heading, tuple(shown), self.warnings, footer, self.title)

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
        """Draw measured against predicted values, the residuals, and their distribution.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a path that cannot be written.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> len(fit.plot().axes)
            4
        """
        return written(figure_of(self.title, self.rows, self.origin), target)

    def to_json(self, page: Page | None = None) -> str:
        """Return the fit as JSON, with its intervals and the ranking of measurements: see `Saveable.to_json`.

        Example:
            >>> import json
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> json.loads(fit.to_json())["kind"]
            'calibration'
        """
        complete = self if self.source is None else self.complete()
        return super(Fit, complete).to_json(page)

    def complete(self, level: float = 0.95) -> Fit:
        """Return the fit with its intervals and the ranking of measurements, which its tables then show.

        Args:
            level: level of the intervals in the tables; those of level 0.95 are always added.

        Raises:
            InputError: an invalid level, or a loaded fit that does not contain it.

        Example:
            >>> import plough_opt as po
            >>> data = po.read_measurements("problems/synthetic_draft.csv")
            >>> fit = po.calibrate(po.read_problem("problems/calibration.toml"), data)
            >>> len(fit.complete().page().parts) > len(fit.page().parts)
            True
        """
        for kind in ("linearised", "profile"):
            self.intervals(0.95, kind)
        self.intervals(level)
        # Tables show the last profile intervals.
        last = sorted(self._known, key=lambda known: (known.level, known.asked) == (level, "profile"))
        return replace(self, saved_intervals=tuple(last), saved_next=self.next_measurements())

    @cached_property
    def _known(self) -> list[KnownInterval]:
        """Intervals that were loaded, or computed so far."""
        return [*self.saved_intervals]

    @cached_property
    def _ranking(self) -> tuple[NextMeasurement, ...]:
        """The ranking of candidates that was loaded, or is computed now."""
        return self.saved_next or (() if self.source is None else next_measurements(self.source))

    def _source_to(self, verb: str) -> Estimate:
        """Return the estimate behind the fit; raise InputError that says what a loaded fit cannot do."""
        if self.source is None:
            raise InputError(f"this fit comes from a file: calibrate again to {verb} it")
        return self.source


def reported(title: str, estimate: Estimate, started: float) -> Fit:
    """Return the fit of an estimate; ``started`` is the value of `time.perf_counter` at its beginning."""
    data = estimate.setup.data.at(estimate.predicted)
    unscaled = data.weights * (estimate.predicted - estimate.data.observed)
    scatter = float(np.sqrt(np.sum(unscaled**2) / max(estimate.freedom, 1)))
    return Fit(
        title=title,
        unknowns=fitted_unknowns(estimate),
        correlations_found=correlations_of(estimate),
        unidentifiable=undetermined(estimate.unknowns, estimate.y, estimate.spread),
        rows=rows_of(estimate),
        loss=estimate.setup.problem.loss.name,
        total=estimate.best.loss,
        optima=estimate.optima,
        freedom=estimate.freedom,
        scatter=scatter if data.stated else NOMINAL * scatter,
        stated=data.stated,
        errors=ERRORS[data.relative],
        status=estimate.best.status,
        warnings=caveats(estimate),
        seconds=time.perf_counter() - started,
        source=estimate,
    )


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
    figure, (fit, over_predicted, over_varied, quantiles) = figure_with_panels(4, 2, (5.5, 4.2))
    _draw_fit(fit, counted, kinds)
    predicted = [row.predicted / kinds[row.result].factor for row in counted]
    _draw_residuals(over_predicted, counted, kinds, predicted, _predicted_label(kinds))
    shown, values, label = _varied(counted, origin)
    _draw_residuals(over_varied, shown, kinds, values, label)
    (theory, ordered), _ = stats.probplot([_standardised(row) for row in counted])
    quantiles.plot(theory, ordered, "o", markersize=4, color=COLOURS[0])
    _draw_diagonal(quantiles, 0.0, "normal")
    quantiles.set(xlabel="normal quantile", ylabel="(predicted - measured) / standard error, ordered")
    figure.suptitle(title)
    return figure


def _draw_fit(axes: Axes, rows: Sequence[Row], kinds: Mapping[str, Display]) -> None:
    """Draw measured over predicted values with errors; several results are each divided by their largest value."""
    for (result, display), colour in zip(kinds.items(), cycle(COLOURS)):
        like = [(row.predicted, row.observed, row.sigma, row.standard_error) for row in rows if row.result == result]
        predicted, observed, sigma, error = np.array(like).T / display.factor
        axes.errorbar(predicted, observed, yerr=1.96 * sigma, xerr=1.96 * error, fmt="o", markersize=4, linewidth=0.8,
                      color=colour, label=f"{called(result)}, n = {len(like)}")  # fmt: skip
    _draw_diagonal(axes, float(predicted[0]), "measured = predicted")
    axes.set(xlabel=_predicted_label(kinds), ylabel=_predicted_label(kinds).replace("predicted", "measured"))
    axes.set_title("bars: 95 % of the measuring error; across: of the prediction", fontsize="small")


def _draw_residuals(axes: Axes, rows: Sequence[Row], kinds: Mapping[str, Display], places: Sequence[float],
                    label: str) -> None:  # fmt: skip
    """Draw the standardised residuals over a coordinate of the rows."""
    for result, colour in zip(kinds, cycle(COLOURS)):
        pairs = [(place, _standardised(row)) for place, row in zip(places, rows, strict=True) if row.result == result]
        axes.plot(*zip(*pairs, strict=True), "o", markersize=4, color=colour, label=called(result))
    axes.axhline(0.0, color="black", linewidth=0.9)
    for size, name in ((-1.96, None), (1.96, "95 % of normal errors: ±1.96")):
        axes.axhline(size, color=_MUTED, linewidth=0.9, linestyle="--", label=name)
    axes.legend(fontsize="x-small", loc="upper right")
    axes.set(xlabel=label, ylabel="(predicted - measured) / standard error")
    axes.grid(alpha=0.25)


def _draw_diagonal(axes: Axes, place: float, label: str) -> None:
    """Draw the diagonal of equal values, through a given point on it."""
    axes.axline((place, place), slope=1.0, color="black", linewidth=0.9, label=label)
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")


def _standardised(row: Row) -> float:
    return row.residual / row.sigma


def _display(like: Row, rows: Sequence[Row], origin: Origin) -> Display:
    """Return the unit in which a result is drawn; if there are several results, its largest value is the unit."""
    sizes = [abs(row.predicted) for row in rows if row.result == like.result]
    several = len({row.result for row in rows}) > 1
    return Display("", max(sizes)) if several else origin.display(like.result, like.unit, *sizes)


def _predicted_label(kinds: Mapping[str, Display]) -> str:
    if len(kinds) > 1:
        return "predicted, over the largest of its kind"
    ((result, display),) = kinds.items()
    return f"predicted {display.heading(called(result))}"


def _varied(rows: Sequence[Row], origin: Origin) -> tuple[Sequence[Row], Sequence[float], str]:
    """Return the rows, a coordinate of each, and its label: time or speed if it varies, else the most varied one."""
    places = [row.conditions if row.time is None else {"time": row.time, **row.conditions} for row in rows]
    keys = dict.fromkeys(key for place in places for key in place)
    counts = {key: len({place[key] for place in places if key in place}) for key in keys}
    preferred = [key for key in ("time", "scene.tow_speed") if counts.get(key, 0) > 1]
    name = preferred[0] if preferred else max(counts, key=counts.__getitem__, default="")
    if not name:
        return rows, [float(k) for k in range(1, len(rows) + 1)], "number of the row"
    display = Display("s", 1.0)
    if name != "time":
        usual = f"1 {EVERY[name].shown or EVERY[name].unit}".rstrip()
        display = origin.displays.get(name) or display_of(usual, Unit(EVERY[name].unit))
    having = [k for k, place in enumerate(places) if name in place]
    values = [places[k][name] / display.factor for k in having]
    return [rows[k] for k in having], values, display.heading(called(name))
