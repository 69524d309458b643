"""Parts of a fit: unknowns, correlations and rows, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plough_opt.studies.calibration.estimate import Data, Estimate
from plough_opt.studies.calibration.intervals import Interval, Kind
from plough_opt.studies.calibration.measurements import Measurements, result_unit
from plough_opt.studies.calibration.unknown import Unknown

Vector = NDArray[np.float64]


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


def fitted_unknowns(unknowns: Sequence[Unknown], errors: Vector, fit: Estimate) -> tuple[FittedUnknown, ...]:
    """Return every unknown with its standard error."""
    determined = fit.spread.determined
    return tuple(
        FittedUnknown(
            u.name,
            u.unit,
            float(u.value(float(fit.y[k]))),
            float(errors[k] * u.slope(float(fit.y[k]))) if determined[k] else np.inf,
            u.lower,
            u.upper,
            bool(determined[k]),
        )
        for k, u in enumerate(unknowns)
    )


def correlations_of(unknowns: Sequence[Unknown], errors: Vector, fit: Estimate) -> tuple[Correlation, ...]:
    """Return the correlations of the determined unknowns."""
    spread = fit.spread
    known = [k for k in range(len(unknowns)) if spread.determined[k] and errors[k] > 0.0]
    return tuple(
        Correlation(unknowns[i].name, unknowns[j].name, float(spread.covariance[i, j] / (errors[i] * errors[j])))
        for at, i in enumerate(known)
        for j in known[at + 1 :]
    )


def rows_of(measured: Sequence[Measurements], data: Data, fit: Estimate) -> tuple[Row, ...]:
    """Return every measured row beside the fit."""
    deviation = np.divide(fit.variance**0.5, fit.weights, out=np.full(len(fit.weights), np.inf),
                          where=fit.weights > 0.0)  # fmt: skip
    error = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", fit.slope, fit.spread.covariance, fit.slope), 0.0))
    rows, first = [], 0
    for m in measured:
        for k in range(m.rows):
            i = first + k
            rows.append(Row(
                place=m.row(k), result=m.result, unit=result_unit(m.result).symbol, conditions=m.at(k),
                time=None if m.time is None else float(m.time[k]), observed=float(data.observed[i]),
                predicted=float(fit.predicted[i]), sigma=float(deviation[i]), standard_error=float(error[i]),
                residual=float(fit.predicted[i] - data.observed[i]),
            ))  # fmt: skip
        first += m.rows
    return tuple(rows)
