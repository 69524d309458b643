"""Measurements from a CSV file: names and units in its header, every mistake listed with its line and column."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from plough_opt.core.checks import path_of
from plough_opt.core.csv_rows import HEADING, factor_of, raise_listed, read_rows, table_of
from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.quantities import quantities
from plough_opt.core.units import Unit
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.studies.calibration.measurements import RECORD, Measurements, measurable


@dataclass(frozen=True)
class _Column:
    """A column: its heading as written, its name, and the factor to SI, for a relative sigma to the measured value."""

    heading: str
    name: str
    factor: float
    relative: bool = False


def read_measurements(path: str | Path) -> Measurements:
    """Read one measured result from a CSV file.

    The first line that is neither empty nor begins with ``#`` names the columns with their units, as
    ``scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]``: conditions by their keys in a
    problem file, one measured result, and optionally ``sigma`` (its standard deviation, in its unit or in ``%``) or
    ``weight``; ``mount_force`` needs a column ``time``. Cells are numbers with a decimal point, separated by commas,
    semicolons or tabs.

    Raises:
        InputError: no such file, or an invalid column or cell; the message lists each with line, column, the expected
            value and the nearest valid name.

    Example:
        >>> import plough_opt as po
        >>> po.read_measurements("problems/synthetic_draft.csv").result
        'mean_draft'
    """
    path = path_of("the file of measurements", path)
    rows = read_rows(path, "measurements")
    if not rows:
        raise InputError(f"{path}: the file is empty: write a first line that names the columns, as {_example()}")
    line, headings = rows[0]
    columns = _columns(str(path), line, headings)
    if len(rows) == 1:
        raise InputError(f"{path}, line {line}: there is no row below the header: add the measured values")
    named = [(column.heading, column.factor) for column in columns]
    table = table_of(path, rows[1:], named, lambda k, value, cell: _check(columns[k].name, value, cell))
    return _measurements(str(path), columns, table, [number for number, _ in rows[1:]])


def _columns(name: str, line: int, headings: Sequence[str]) -> list[_Column]:
    """Return the columns that a header names.

    Raises:
        InputError: an invalid column, or columns that do not belong together; every one is listed.
    """
    place = f"{name}, line {line}"
    found: list[_Column] = []
    errors: list[str] = []
    measured = [m["name"] for text in headings if (m := HEADING.fullmatch(text)) and m["name"] in measurable()]
    for text in headings:
        try:
            found.append(_column(text, measured[0] if measured else None))
        except InputError as error:
            errors.append(f"{place}, column '{short(text.strip())}': {error}")
    names = [column.name for column in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    errors += [f"{place}, column '{key}': it is given twice: leave one of the two out" for key in twice]
    if not measured:
        errors.append(
            f"{place}: no column holds a measured result: one of {', '.join(measurable())} is needed, as {_example()}"
        )
    if len(set(measured)) > 1:
        errors.append(f"{place}: {' and '.join(measured)} are measured: write a file for each, and give all of them")
    if measured == [RECORD] and "time" not in names and not errors:
        errors.append(f"{place}: {RECORD} is measured over time: a column 'time [s]' is missing")
    if "time" in names and measured and measured != [RECORD]:
        errors.append(f"{place}, column 'time': {measured[0]} is one value for a run; a time goes with {RECORD}")
    if "sigma" in names and "weight" in names:
        errors.append(f"{place}: sigma and weight exclude each other: keep sigma, which includes the weight")
    raise_listed(errors)
    return found


def _column(text: str, measured: str | None) -> _Column:
    """Return the column that a heading names."""
    match = HEADING.fullmatch(text)
    if match is None:
        raise InputError("a name and its unit are expected, like 'scene.tow_speed [km/h]'")
    name, written = match["name"], match["unit"]
    if name == "sigma" and written is not None and written.strip() == "%":
        return _Column(text.strip(), name, 0.01, relative=True)
    unit = _unit_of(name, measured)
    return _Column(text.strip(), name, factor_of(name, written, unit))


def _unit_of(name: str, measured: str | None) -> Unit:
    known = quantities()
    if name == "sigma":
        return MEASURES[measured].unit if measured else Unit("")
    if name == "weight":
        return Unit("")
    if name == "time":
        return Unit("s")
    if name in measurable():
        return MEASURES[name].unit
    if name not in known:
        names = [*known, *measurable(), "sigma", "weight", "time"]
        raise InputError(f"no such column is known: {nearest(name, names)}")
    return known[name]


def _check(name: str, value: float, cell: str) -> None:
    """Raise InputError if a number is outside its column's domain."""
    if name == "sigma" and value <= 0.0:
        raise InputError(f"{cell} must be above 0: it is a standard deviation")
    if name in ("weight", "time") and value < 0.0:
        raise InputError(f"{cell} must be at least 0")


def _measurements(name: str, columns: Sequence[_Column], table: np.ndarray, lines: Sequence[int]) -> Measurements:
    values = {column.name: table[:, k] for k, column in enumerate(columns)}
    result = next(key for key in values if key in measurable())
    sigma = values.pop("sigma", None)
    if sigma is not None and any(column.relative for column in columns):
        with np.errstate(over="ignore"):  # `Measurements` refuses an infinite number with its row
            sigma = sigma * np.abs(values[result])
    return Measurements(
        result,
        values.pop(result),
        time=values.pop("time", None),
        sigma=sigma,
        weights=values.pop("weight", None),
        conditions=values,
        name=name,
        lines=lines,
    )


def _example() -> str:
    return "'scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]'"
