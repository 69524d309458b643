"""The result of a calibration: `Fit`, with intervals, tables, pictures and files."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_choice
from plough_opt.core.errors import InputError
from plough_opt.core.plain_data import Unsaved
from plough_opt.core.saving import Origin, Saveable, versions
from plough_opt.core.tables import Page, Part, data_frame
from plough_opt.motion.scene import Scene
from plough_opt.soil.soil import Soil
from plough_opt.studies.calibration import parts
from plough_opt.studies.calibration.candidates import Candidate, NextMeasurement, next_measurements
from plough_opt.studies.calibration.estimate import Estimate, Interval, Kind, check_level, interval
from plough_opt.studies.calibration.identifiability import Undetermined, undetermined
from plough_opt.studies.calibration.quality import CrossValidation, caveats, cross_validate
from plough_opt.studies.calibration.setup import ERRORS, NOMINAL

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]

# Correlations of at least this size are reported.
_NOTABLE_CORRELATION: Final = 0.5


@dataclass(frozen=True, repr=False)
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
        status: status of the solver.
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
    unknowns: tuple[parts.FittedUnknown, ...]
    correlations_found: tuple[parts.Correlation, ...]
    unidentifiable: tuple[Undetermined, ...]
    rows: tuple[parts.Row, ...]
    loss: str
    total: float
    optima: tuple[float, ...]
    freedom: int
    scatter: float
    stated: bool
    status: str
    warnings: tuple[str, ...]
    seconds: float = field(compare=False)
    saved_intervals: tuple[parts.KnownInterval, ...] = ()
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
    def observed(self) -> Vector:
        """Measured values, SI."""
        return np.array([row.observed for row in self.rows])

    @property
    def predicted(self) -> Vector:
        """Fitted values, SI."""
        return np.array([row.predicted for row in self.rows])

    @property
    def residuals(self) -> Vector:
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
        """
        level = check_level(level)
        check_choice("kind", kind, ("profile", "linearised"))
        if (level, kind) not in self._intervals:
            estimate = self._source_to(f"compute {kind} intervals of level {level:g} of")
            intervals = {u.name: interval(estimate, k, level, kind) for k, u in enumerate(estimate.unknowns)}
            self._intervals[level, kind] = intervals
        return dict(self._intervals[level, kind])

    def next_measurements(self, candidates: Sequence[Candidate] | None = None) -> tuple[NextMeasurement, ...]:
        """Return possible further measurements with their gain of information, the best first.

        Args:
            candidates: measurements to rank; default: other wedge angles, heights, speeds and depths, a tool of known
                friction, the loosened radius, and a direct measurement of each unknown.

        Raises:
            InputError: a candidate of another type, or candidates for a loaded fit, which only has a saved ranking.
        """
        if candidates is not None:
            return next_measurements(self._source_to("rank other candidates for"), candidates)
        if not self._ranking and self.source is not None:
            self._ranking.extend(next_measurements(self.source))
        return tuple(self._ranking)

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
        """
        return cross_validate(self._source_to("cross-validate"), folds, seed)

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
        """
        profiles = [item for item in self.saved_intervals if item.asked == "profile"]
        level = profiles[-1].level if profiles else 0.0
        intervals = {item.name: item.interval for item in profiles if item.level == level}
        shown: list[Part] = [parts.unknowns_table(self.unknowns, level, intervals, self.origin)]
        correlated = [c for c in self.correlations_found if abs(c.value) >= _NOTABLE_CORRELATION]
        for c in sorted(correlated, key=lambda c: -abs(c.value)):
            shown.append(f"Errors of {c.first} and {c.second} are correlated: {c.value:+.3f}.")
        shown += [f"Not determined: {item.words}." for item in self.unidentifiable]
        if self.saved_next:
            shown.append(parts.next_table(self.unknowns, self.saved_next, self.origin))
        relative = "of the predicted values" if self.errors == "relative" else "of the mean measured value"
        kind = "times the stated sigma" if self.stated else relative
        shown.append(f"Scatter about the fit: {self.scatter:.3g} {kind}, {self.freedom} degrees of freedom.")
        footer = f"Converged: no step lowers the loss ({self.status}); {self.seconds:.2f} s"
        files = ", ".join(dict.fromkeys(row.place.partition(",")[0] for row in self.rows))
        heading = f"{len(self.unknowns)} unknowns from {len(self.rows)} rows of {files}"
        return Page(heading, tuple(shown), self.warnings, footer, self.title)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each measured row with its prediction, SI; a column holds the units.

        Raises:
            InputError: pandas is not installed.
        """
        names = ("place", "result", "unit", "observed", "predicted", "residual", "sigma", "standard_error")
        frame = data_frame({name: [getattr(row, name) for row in self.rows] for name in names}, {})
        frame.attrs["units"] = {row.result: row.unit for row in self.rows}
        return frame

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw measured against predicted values, the residuals, and their distribution.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a path that cannot be written.
        """
        from plough_opt.core.files import save_figure
        from plough_opt.studies.calibration.picture import figure_of

        figure = figure_of(self.title, self.rows, self.origin)
        if target is not None:
            save_figure(figure, target)
        return figure

    def to_json(self, page: Page | None = None) -> str:
        """Return the fit as JSON, with its intervals and the ranking of measurements: see `Saveable.to_json`."""
        complete = self if self.source is None else self.complete()
        return super(Fit, complete).to_json(page)

    def complete(self, level: float = 0.95) -> Fit:
        """Return the fit with its intervals and the ranking of measurements, which its tables then show.

        Args:
            level: level of the intervals in the tables; those of level 0.95 are always added.

        Raises:
            InputError: an invalid level, or a loaded fit that does not contain it.
        """
        for kind in ("linearised", "profile"):
            self.intervals(0.95, kind)
        asked = self.intervals(level)
        computed = {**self._intervals}
        computed[level, "profile"] = computed.pop((level, "profile"), asked)
        intervals = tuple(
            parts.KnownInterval(name, level, kind, interval)
            for (level, kind), by_name in computed.items()
            for name, interval in by_name.items()
        )
        return replace(self, saved_intervals=intervals, saved_next=self.next_measurements())

    @cached_property
    def _intervals(self) -> dict[tuple[float, Kind], dict[str, Interval]]:
        """(level, kind) -> intervals that were loaded, or computed so far."""
        known: dict[tuple[float, Kind], dict[str, Interval]] = {}
        for item in self.saved_intervals:
            known.setdefault((item.level, item.asked), {})[item.name] = item.interval
        return known

    @cached_property
    def _ranking(self) -> list[NextMeasurement]:
        """The ranking of candidates that was loaded, or computed; empty before."""
        return list(self.saved_next)

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
        unknowns=parts.fitted_unknowns(estimate),
        correlations_found=parts.correlations_of(estimate),
        unidentifiable=undetermined(estimate.unknowns, estimate.y, estimate.spread),
        rows=parts.rows_of(estimate),
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
