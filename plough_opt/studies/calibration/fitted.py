"""What a calibration found: values, their uncertainty, residuals; what is computed later, when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.core.kinds import check_choice
from plough_opt.core.origin import Origin
from plough_opt.exchange.results import versions
from plough_opt.studies.calibration.candidates import Candidate, NextMeasurement
from plough_opt.studies.calibration.cross_validation import CrossValidation
from plough_opt.studies.calibration.estimate import Data, Estimate
from plough_opt.studies.calibration.identifiability import Undetermined
from plough_opt.studies.calibration.intervals import Interval, Kind, check_level
from plough_opt.studies.calibration.loss import Loss
from plough_opt.studies.calibration.measurements import Measurements
from plough_opt.studies.calibration.model import Model
from plough_opt.studies.calibration.parts import Correlation, Found, KnownInterval, Row
from plough_opt.studies.calibration.prediction import Rows
from plough_opt.studies.calibration.unknown import Unknown

if TYPE_CHECKING:
    pass

Vector = NDArray[np.float64]


class Live(Protocol):
    """The calibration behind a fit, as long as it is not one from a file."""

    title: str
    measured: tuple[Measurements, ...]
    model: Model
    unknowns: tuple[Unknown, ...]
    rows: tuple[Rows, ...]
    loss: Loss

    def interval(self, data: Data, found: Estimate, k: int, level: float, kind: Kind) -> Interval:
        """Return the confidence interval of an unknown."""

    def cross_validation(self, data: Data, found: Estimate, folds: int | None, seed: int) -> CrossValidation:
        """Return how well rows are predicted that took no part."""

    def next_measurements(
        self, found: Estimate, candidates: Sequence[Candidate] | None = None
    ) -> tuple[NextMeasurement, ...]:
        """Return candidates by what they would tell."""


@dataclass(frozen=True)
class Source:
    """What a fit asks for what is not computed yet."""

    calibration: Live
    data: Data
    found: Estimate
    known: dict[tuple[float, Kind], dict[str, Interval]] = field(default_factory=dict)
    ranking: list[tuple[NextMeasurement, ...]] = field(default_factory=list)


@dataclass(frozen=True, repr=False)
class Fitted:
    """A calibration: unknowns with their uncertainty, and how well the model follows the data.

    Attributes:
        title: of the calibration.
        unknowns: what was found.
        correlations_found: of the errors of determined unknowns, each pair once.
        unidentifiable: combinations that the data do not determine.
        rows: the data beside the fit.
        loss: name of the loss.
        total: sum of the losses.
        optima: sums of the losses at all distinct local optima.
        freedom: degrees of freedom, rows that count less the determined directions.
        scatter: root of the sum of squares over the degrees of freedom, of residuals over stated sigma; where none is
            stated, relative to the mean measured value.
        stated: whether sigma was stated.
        status: IPOPT's word.
        warnings: what a reader of the numbers must know.
        seconds: time taken.
        saved_intervals: those that a file holds.
        saved_next: the ranking that a file holds.
        versions: of packages, and the machine.
        origin: what made it.
    """

    title: str
    unknowns: tuple[Found, ...]
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
        return {found.name: found.value for found in self.unknowns}

    @property
    def standard_errors(self) -> dict[str, float]:
        """Unknown -> standard error, SI; infinite where the data do not determine it."""
        return {found.name: found.standard_error for found in self.unknowns}

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
            kind: "profile": of the profile likelihood, which follows the model's curvature; "linearised": standard
                error times quantile. Normal quantiles where sigma is stated, Student's where it is estimated.

        Raises:
            InputError: a level or a kind that cannot be, or one that a saved fit does not hold.
        """
        level = check_level(level)
        check_choice("kind", kind, ("profile", "linearised"))
        if self.source is None:
            held = {i.name: i.interval for i in self.saved_intervals if (i.level, i.asked) == (level, kind)}
            if len(held) < len(self.unknowns):
                raise InputError(f"this fit comes from a file, which holds no {kind} intervals of level {level:g}")
            return held
        live, data, found = self.source.calibration, self.source.data, self.source.found
        if (level, kind) not in self.source.known:
            own = {u.name: live.interval(data, found, k, level, kind) for k, u in enumerate(self.unknowns)}
            self.source.known[level, kind] = own
        return dict(self.source.known[level, kind])

    def next_measurements(self, candidates: Sequence[Candidate] | None = None) -> tuple[NextMeasurement, ...]:
        """Return what further measurements would tell, the best first.

        Args:
            candidates: what could be measured; default: other wedge angles, heights, speeds and depths, a tool of known
                friction, the loosened radius, and each unknown by itself.

        Raises:
            InputError: a candidate that is none, or a fit from a file, which only knows its own ranking.
        """
        if self.source is None:
            if candidates is not None:
                raise InputError("this fit comes from a file: calibrate again to rank other candidates")
            return self.saved_next
        if candidates is not None:
            return self.source.calibration.next_measurements(self.source.found, candidates)
        if not self.source.ranking:
            self.source.ranking.append(self.source.calibration.next_measurements(self.source.found))
        return self.source.ranking[0]

    @property
    def next_measurement(self) -> NextMeasurement:
        """The candidate that would tell most."""
        return self.next_measurements()[0]

    def known_intervals(self) -> tuple[float, dict[str, Interval]]:
        """Return the profile intervals that are computed last, with their level; none where none are."""
        known = {} if self.source is None else self.source.known
        levels = [level for level, kind in known if kind == "profile"]
        levels += [item.level for item in self.saved_intervals if item.asked == "profile"]
        return (levels[-1], self.intervals(levels[-1])) if levels else (0.0, {})

    def known_ranking(self) -> tuple[NextMeasurement, ...]:
        """Return the ranking of further measurements, empty before it is asked for."""
        if self.source is None:
            return self.saved_next
        return self.source.ranking[0] if self.source.ranking else ()
