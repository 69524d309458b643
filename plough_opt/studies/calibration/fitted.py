"""The numbers of a calibration: values, their uncertainty, residuals; intervals and candidates are computed later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.core.kinds import check_choice
from plough_opt.core.origin import Origin, versions
from plough_opt.studies.calibration.candidates import Candidate, NextMeasurement
from plough_opt.studies.calibration.cross_validation import CrossValidation
from plough_opt.studies.calibration.estimate import Data, Estimate
from plough_opt.studies.calibration.identifiability import Undetermined
from plough_opt.studies.calibration.intervals import Interval, Kind, check_level
from plough_opt.studies.calibration.loss import Loss
from plough_opt.studies.calibration.measurements import Measurements
from plough_opt.studies.calibration.model import Model
from plough_opt.studies.calibration.parts import Correlation, FittedUnknown, KnownInterval, Row
from plough_opt.studies.calibration.prediction import Rows
from plough_opt.studies.calibration.unknown import Unknown

Vector = NDArray[np.float64]


class Calibrator(Protocol):
    """The calibration that computes what a fit needs later; a fit from a file has none."""

    title: str
    measured: tuple[Measurements, ...]
    model: Model
    unknowns: tuple[Unknown, ...]
    rows: tuple[Rows, ...]
    loss: Loss

    def interval(self, data: Data, fit: Estimate, k: int, level: float, kind: Kind) -> Interval:
        """Return the confidence interval of an unknown."""

    def cross_validation(self, data: Data, fit: Estimate, folds: int | None, seed: int) -> CrossValidation:
        """Return the errors of the predictions for rows left out of the fit."""

    def next_measurements(
        self, fit: Estimate, candidates: Sequence[Candidate] | None = None
    ) -> tuple[NextMeasurement, ...]:
        """Return candidates by their gain of information."""


@dataclass(frozen=True)
class Source:
    """The calibration and the estimate behind a fit, and the results computed from them so far."""

    calibration: Calibrator
    data: Data
    estimate: Estimate
    known: dict[tuple[float, Kind], dict[str, Interval]] = field(default_factory=dict)
    ranking: list[tuple[NextMeasurement, ...]] = field(default_factory=list)


@dataclass(frozen=True, repr=False)
class Fitted:
    """A calibration: unknowns with their uncertainty, and how well the model follows the data.

    Attributes:
        title: of the calibration.
        unknowns: their values and standard errors.
        correlations_found: of the errors of determined unknowns, each pair once.
        unidentifiable: combinations that the data do not determine.
        rows: the data beside the fit.
        loss: name of the loss.
        total: sum of the losses.
        optima: sums of the losses at all distinct local optima.
        freedom: degrees of freedom, rows that count less the determined directions.
        scatter: root of the sum of squares over the degrees of freedom, of residuals over the stated sigma, or over the
            mean measured value if none is stated.
        stated: whether sigma was stated.
        status: of IPOPT.
        warnings: about the numbers.
        seconds: time taken.
        saved_intervals: those in a file.
        saved_next: the ranking in a file.
        versions: of packages, and the machine.
        origin: what made it.
    """

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
    seconds: float
    saved_intervals: tuple[KnownInterval, ...] = ()
    saved_next: tuple[NextMeasurement, ...] = ()
    versions: Mapping[str, str] = field(default_factory=versions)
    source: Source | None = field(default=None, repr=False, compare=False)
    origin: Origin = field(default=Origin(), compare=False)

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
        """Predicted less observed, SI."""
        return np.array([row.residual for row in self.rows])

    @property
    def standardised(self) -> Vector:
        """Residuals over the standard deviation of a measurement; 0 of rows of weight 0."""
        return np.array([row.residual / row.sigma if row.sigma > 0.0 else 0.0 for row in self.rows])

    def intervals(self, level: float = 0.95, kind: Kind = "profile") -> dict[str, Interval]:
        """Return the confidence interval of every unknown, SI.

        Args:
            level: confidence, between 0 and 1.
            kind: "profile": of the profile likelihood, which includes the model's curvature; "linearised": standard
                error times quantile. Quantiles are normal if sigma is stated, and Student's if it is estimated.

        Raises:
            InputError: an invalid level or kind, or one that a saved fit does not contain.
        """
        level = check_level(level)
        check_choice("kind", kind, ("profile", "linearised"))
        if self.source is None:
            held = {i.name: i.interval for i in self.saved_intervals if (i.level, i.asked) == (level, kind)}
            if len(held) < len(self.unknowns):
                raise InputError(f"this fit comes from a file, which has no {kind} intervals of level {level:g}")
            return held
        calibration, data, estimate = self.source.calibration, self.source.data, self.source.estimate
        if (level, kind) not in self.source.known:
            own = {u.name: calibration.interval(data, estimate, k, level, kind) for k, u in enumerate(self.unknowns)}
            self.source.known[level, kind] = own
        return dict(self.source.known[level, kind])

    def next_measurements(self, candidates: Sequence[Candidate] | None = None) -> tuple[NextMeasurement, ...]:
        """Return further measurements by their gain of information, the best first.

        Args:
            candidates: possible measurements; default: other wedge angles, heights, speeds and depths, a tool of known
                friction, the loosened radius, and each unknown by itself.

        Raises:
            InputError: a candidate of another type, or candidates for a fit from a file, which has only its own.
        """
        if self.source is None:
            if candidates is not None:
                raise InputError("this fit comes from a file: calibrate again to rank other candidates")
            return self.saved_next
        if candidates is not None:
            return self.source.calibration.next_measurements(self.source.estimate, candidates)
        if not self.source.ranking:
            self.source.ranking.append(self.source.calibration.next_measurements(self.source.estimate))
        return self.source.ranking[0]

    @property
    def next_measurement(self) -> NextMeasurement:
        """The candidate with the largest gain of information."""
        return self.next_measurements()[0]

    def known_intervals(self) -> tuple[float, dict[str, Interval]]:
        """Return the profile intervals that were computed last, with their level; empty if there are none."""
        known = {} if self.source is None else self.source.known
        levels = [level for level, kind in known if kind == "profile"]
        levels += [item.level for item in self.saved_intervals if item.asked == "profile"]
        return (levels[-1], self.intervals(levels[-1])) if levels else (0.0, {})

    def known_ranking(self) -> tuple[NextMeasurement, ...]:
        """Return the ranking of further measurements, empty before it is computed."""
        if self.source is None:
            return self.saved_next
        return self.source.ranking[0] if self.source.ranking else ()
