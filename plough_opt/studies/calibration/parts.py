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
class Found:
    """An unknown that was fitted, SI.

    Attributes:
        name: its key in a problem file.
        unit: SI unit.
        value: at the fit; of an unknown that is not determined, one of many.
        standard_error: infinite where the data do not determine it.
        lower: bound that was given.
        upper: bound that was given.
        determined: whether the data tell more of it than its bounds do.
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
        result: what was measured.
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
    """An interval that was computed, with its level and the kind that was asked for."""

    name: str
    level: float
    asked: Kind
    interval: Interval


def found_of(unknowns: Sequence[Unknown], errors: Vector, found: Estimate) -> tuple[Found, ...]:
    """Return every unknown with its standard error."""
    determined = found.spread.determined
    return tuple(
        Found(
            u.name,
            u.unit,
            float(u.value(float(found.y[k]))),
            float(errors[k] * u.slope(float(found.y[k]))) if determined[k] else np.inf,
            u.lower,
            u.upper,
            bool(determined[k]),
        )
        for k, u in enumerate(unknowns)
    )


def correlations_of(unknowns: Sequence[Unknown], errors: Vector, found: Estimate) -> tuple[Correlation, ...]:
    """Return the correlations of the determined unknowns."""
    spread = found.spread
    known = [k for k in range(len(unknowns)) if spread.determined[k] and errors[k] > 0.0]
    return tuple(
        Correlation(unknowns[i].name, unknowns[j].name, float(spread.covariance[i, j] / (errors[i] * errors[j])))
        for at, i in enumerate(known)
        for j in known[at + 1 :]
    )


def rows_of(measured: Sequence[Measurements], data: Data, found: Estimate) -> tuple[Row, ...]:
    """Return every measured row beside the fit."""
    deviation = np.divide(found.variance**0.5, found.weights, out=np.full(len(found.weights), np.inf),
                          where=found.weights > 0.0)  # fmt: skip
    error = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", found.slope, found.spread.covariance, found.slope), 0.0))
    rows, first = [], 0
    for m in measured:
        for k in range(m.rows):
            i = first + k
            rows.append(Row(
                place=m.row(k), result=m.result, unit=result_unit(m.result).symbol, conditions=m.at(k),
                time=None if m.time is None else float(m.time[k]), observed=float(data.observed[i]),
                predicted=float(found.predicted[i]), sigma=float(deviation[i]), standard_error=float(error[i]),
                residual=float(found.predicted[i] - data.observed[i]),
            ))  # fmt: skip
        first += m.rows
    return tuple(rows)
