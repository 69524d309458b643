"""The parts of a fit as plain data (unknowns, correlations, rows), and tables of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from plough_opt.core.plain_data import MaybeInfinite
from plough_opt.core.saving import Origin
from plough_opt.core.tables import Grid
from plough_opt.studies.calibration.candidates import NextMeasurement
from plough_opt.studies.calibration.estimate import Estimate, Interval, Kind
from plough_opt.studies.calibration.measurements import result_unit

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
class Row:
    """A measured row with its prediction, SI.

    Attributes:
        place: file and line, or set and row.
        result: the measured result.
        unit: its unit.
        conditions: conditions of the row by key.
        time: time since the start of the run [s], or None.
        observed: measured value.
        predicted: fitted value.
        sigma: standard deviation of the measurement, stated or estimated; infinite for a row of weight 0.
        standard_error: standard error of the prediction, from the errors of the determined unknowns.
        residual: predicted minus observed value.
    """

    place: str
    result: str
    unit: str
    conditions: Mapping[str, float]
    time: float | None
    observed: float
    predicted: float
    sigma: MaybeInfinite
    standard_error: MaybeInfinite
    residual: float


@dataclass(frozen=True)
class KnownInterval:
    """A computed interval of an unknown, with its level and the requested kind."""

    name: str
    level: float
    asked: Kind
    interval: Interval


def fitted_unknowns(fit: Estimate) -> tuple[FittedUnknown, ...]:
    """Return every unknown with its standard error."""
    errors = np.where(fit.spread.determined, np.sqrt(np.diag(fit.spread.covariance)), np.inf)
    return tuple(
        FittedUnknown(u.name, u.unit, float(u.value(y)), float(error * u.slope(y)), u.lower, u.upper, error < np.inf)
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
