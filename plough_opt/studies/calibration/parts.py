"""Parts of a fit: unknowns, correlations and rows, as plain data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from plough_opt.studies.calibration.estimate import Estimate
from plough_opt.studies.calibration.intervals import Interval, Kind
from plough_opt.studies.calibration.measurements import Measurements, result_unit
from plough_opt.studies.calibration.unknown import Unknown


@dataclass(frozen=True)
class FittedUnknown:
    """A fitted unknown, SI.

    Attributes:
        name: its key in a problem file.
        unit: SI unit.
        value: at the fit; if the unknown is not determined, one of many that fit.
        standard_error: infinite if the data do not determine it.
        lower: its lower bound.
        upper: its upper bound.
        determined: whether the data narrow it further than its bounds.
    """

    name: str
    unit: str
    value: float
    standard_error: float
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
class Row:
    """A measured row beside the fit, SI.

    Attributes:
        place: file and line, or set and row.
        result: the measured result.
        unit: its unit.
        conditions: of the row.
        time: since the start of the run [s], or None.
        observed: measured value.
        predicted: by the fit.
        sigma: standard deviation of the measurement, stated or estimated; infinite of a row of weight 0.
        standard_error: of the prediction, from the errors of the determined unknowns.
        residual: predicted less observed.
    """

    place: str
    result: str
    unit: str
    conditions: Mapping[str, float]
    time: float | None
    observed: float
    predicted: float
    sigma: float
    standard_error: float
    residual: float


@dataclass(frozen=True)
class KnownInterval:
    """A computed interval, with its level and the kind that was requested."""

    name: str
    level: float
    asked: Kind
    interval: Interval


def fitted_unknowns(unknowns: Sequence[Unknown], fit: Estimate) -> tuple[FittedUnknown, ...]:
    """Return every unknown with its standard error."""
    errors = np.where(fit.spread.determined, np.sqrt(np.diag(fit.spread.covariance)), np.inf)
    return tuple(
        FittedUnknown(u.name, u.unit, float(u.value(y)), float(error * u.slope(y)), u.lower, u.upper, error < np.inf)
        for u, y, error in zip(unknowns, fit.y.tolist(), errors.tolist(), strict=True)
    )


def correlations_of(unknowns: Sequence[Unknown], fit: Estimate) -> tuple[Correlation, ...]:
    """Return the correlations of the determined unknowns."""
    errors = np.sqrt(np.diag(fit.spread.covariance))
    return tuple(
        Correlation(unknowns[i].name, unknowns[j].name, float(fit.spread.covariance[i, j] / (errors[i] * errors[j])))
        for i, j in combinations(np.flatnonzero(errors > 0.0).tolist(), 2)
    )


def rows_of(measured: Sequence[Measurements], fit: Estimate) -> tuple[Row, ...]:
    """Return every measured row beside the fit."""
    error = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", fit.slope, fit.spread.covariance, fit.slope), 0.0))
    columns = (fit.data.observed, fit.predicted, fit.deviation, error, fit.predicted - fit.data.observed)
    numbers = iter(np.column_stack(columns).tolist())
    return tuple(
        Row(m.row(k), m.result, result_unit(m.result).symbol, m.at(k), None if m.time is None else float(m.time[k]),
            *next(numbers))
        for m in measured for k in range(m.rows)
    )  # fmt: skip
