"""Measurements from a CSV file: names and units in its header, every mistake listed with its line and column."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plough_opt.calibration.measurements import RECORD, RESULTS, Measurements
from plough_opt.errors import InputError, nearest, short
from plough_opt.problem_file.measures import MEASURES
from plough_opt.problem_file.schema import quantities
from plough_opt.problem_file.units import Unit

_HEADING: Final = re.compile(r"\s*(?P<name>[\w.]+)\s*(?:\[(?P<unit>[^\]]*)\])?\s*")
# Units in which fields are measured, for the message that asks for one.
_CUSTOMARY: Final = {"N": "kN", "rad": "deg", "m/s": "km/h", "Pa": "kPa", "N/m": "kN/m", "W": "kW"}
# Also what is no finite number, for a message of its own.
_NUMBER: Final = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan|inf(?:inity)?)", re.IGNORECASE)
_MOST_LISTED: Final = 8
# What a file may be: some 300,000 rows, each of which is a run of the model.
_MOST_BYTES: Final = 10_000_000
_LONGEST_LINE: Final = 10_000


@dataclass(frozen=True)
class _Column:
    """A column: its heading as written, its name, and the factor to SI; of sigma in per cent, of the measured value."""

    heading: str
    name: str
    factor: float
    relative: bool = False


def read_measurements(path: str | Path) -> Measurements:
    """Read one measured result from a CSV file.

    The first line that is neither empty nor begins with ``#`` names the columns with their units, as
    ``scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]``: conditions by their keys in a
    problem file, one measured result, and if wanted ``sigma`` (its standard deviation, in its unit or in ``%``) or
    ``weight``; with ``mount_force`` a column ``time``. Cells are numbers with a decimal point; between them are commas,
    semicolons or tabs.

    Raises:
        InputError: no such file, or a column or cell that cannot be; the message lists each with line, column, what
            was expected and the nearest valid name.
    """
    path = Path(path)
    rows = _rows(path)
    if not rows:
        raise InputError(f"{path}: the file is empty: write a first line that names the columns, as {_example()}")
    line, headings = rows[0]
    columns = _columns(str(path), line, headings)
    if len(rows) == 1:
        raise InputError(f"{path}, line {line}: there is no row below the header: add what was measured")
    table, errors = [], []
    for number, cells in rows[1:]:
        values, wrong = _values(f"{path}, line {number}", cells, columns)
        table.append(values)
        errors += wrong
    _raise(errors)
    return _measurements(str(path), columns, np.array(table), [number for number, _ in rows[1:]])


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows with their line numbers, without comments and empty lines."""
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
        text = content.decode("utf-8-sig")
    except FileNotFoundError:
        there = sorted(p.name for p in path.parent.glob("*.csv")) if path.parent.is_dir() else []
        hint = nearest(path.name, there) if there else "in that folder is no .csv file"
        raise InputError(f"there is no file '{path}': {hint}") from None
    except IsADirectoryError:
        raise InputError(f"'{path}' is a folder: name a file of measurements in it") from None
    except UnicodeDecodeError:
        raise InputError(f"'{path}' cannot be read as text: it is not UTF-8") from None
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from None
    if len(content) > _MOST_BYTES:
        raise InputError(f"'{path}' is too long: at most {_MOST_BYTES // 1_000_000} MB of measurements can be read")
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    for number, line in lines:
        if len(line) > _LONGEST_LINE:
            raise InputError(
                f"{path}, line {number}: it has {len(line)} characters, and at most {_LONGEST_LINE} can be read: write"
                " a row in each line"
            )
    delimiter = next((mark for mark in "\t;" if lines and mark in lines[0][1]), ",")
    return [(k, next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))) for k, line in lines]


def _columns(name: str, line: int, headings: Sequence[str]) -> list[_Column]:
    """Return the columns that a header names, or refuse it."""
    place = f"{name}, line {line}"
    found: list[_Column] = []
    errors: list[str] = []
    measured = [m["name"] for text in headings if (m := _HEADING.fullmatch(text)) and m["name"] in RESULTS]
    for text in headings:
        try:
            found.append(_column(text, measured[0] if measured else None))
        except InputError as error:
            errors.append(f"{place}, column '{short(text.strip())}': {error}")
    names = [column.name for column in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    errors += [f"{place}, column '{key}': it stands there twice: leave one of the two out" for key in twice]
    if not measured:
        errors.append(
            f"{place}: no column holds a measured result: one of {', '.join(RESULTS)} is needed, as {_example()}"
        )
    if len(set(measured)) > 1:
        errors.append(f"{place}: {' and '.join(measured)} are measured: write a file for each, and give all of them")
    if measured == [RECORD] and "time" not in names and not errors:
        errors.append(f"{place}: {RECORD} is measured over time: a column 'time [s]' is missing")
    if "time" in names and measured and measured != [RECORD]:
        errors.append(f"{place}, column 'time': {measured[0]} is one value for a run; a time goes with {RECORD}")
    if "sigma" in names and "weight" in names:
        errors.append(f"{place}: sigma and weight exclude each other: sigma says more")
    _raise(errors)
    return found


def _column(text: str, measured: str | None) -> _Column:
    """Return the column that a heading names."""
    match = _HEADING.fullmatch(text)
    if match is None:
        raise InputError("a name and its unit are expected, like 'scene.tow_speed [km/h]'")
    name, written = match["name"], match["unit"]
    if name == "sigma" and written is not None and written.strip() == "%":
        return _Column(text.strip(), name, 0.01, relative=True)
    unit = _unit_of(name, measured)
    written = "" if written is None or written.strip() in ("-", "1") else written.strip()
    if unit.symbol and not written:
        raise InputError(f"the unit is missing: write it like '{name} [{_CUSTOMARY.get(unit.symbol, unit.symbol)}]'")
    try:
        factor = unit.split(f"1 {written}".strip())[1]
    except InputError:
        wrong = f"is not a unit of {unit.symbol}" if unit.symbol else "is a unit, and a pure number is expected"
        raise InputError(f"'{written}' {wrong}: write it like '{_heading(name, unit)}'") from None
    return _Column(text.strip(), name, factor)


def _unit_of(name: str, measured: str | None) -> Unit:
    known = quantities()
    if name == "sigma":
        return MEASURES[measured].unit if measured else Unit("")
    if name == "weight":
        return Unit("")
    if name == "time":
        return Unit("s")
    if name in RESULTS:
        return MEASURES[name].unit
    if name not in known:
        raise InputError(f"no such column is known: {nearest(name, [*known, *RESULTS, 'sigma', 'weight', 'time'])}")
    return known[name]


def _heading(name: str, unit: Unit) -> str:
    symbol = _CUSTOMARY.get(unit.symbol, unit.symbol)
    return f"{name} [{symbol}]" if symbol else name


def _values(place: str, cells: Sequence[str], columns: Sequence[_Column]) -> tuple[list[float], list[str]]:
    """Return a row's numbers in SI, and what is wrong with it."""
    if len(cells) != len(columns):
        return [math.nan] * len(columns), [
            f"{place}: the number of cells is {len(cells)}, and the header names {len(columns)} columns: give each one"
        ]
    values, errors = [], []
    for cell, column in zip(cells, columns, strict=True):
        value = math.nan
        try:
            value = _number(cell, column.factor)
            if column.name == "sigma" and value <= 0.0:
                raise InputError(f"{cell.strip()} must be above 0: it is a standard deviation")
            if column.name in ("weight", "time") and value < 0.0:
                raise InputError(f"{cell.strip()} must be at least 0")
        except InputError as error:
            errors.append(f"{place}, column '{column.heading}': {error}")
        values.append(value)
    return values, errors


def _number(cell: str, factor: float) -> float:
    """Return a cell's number in SI."""
    text = cell.strip()
    if not text:
        raise InputError("the cell is empty: a number is expected; leave the whole row out if it was not measured")
    if _NUMBER.fullmatch(text) is None:
        hint = "a decimal point" if re.fullmatch(r"[+-]?\d+,\d+", text) else "it as 12.5 or 1.25e1, without its unit"
        raise InputError(f"'{short(text)}' is not a number: write {hint}")
    value = float(text) * factor
    if not math.isfinite(value):
        raise InputError(f"'{short(text)}' is not a finite number; leave the whole row out if it was not measured")
    return value


def _measurements(name: str, columns: Sequence[_Column], table: np.ndarray, lines: Sequence[int]) -> Measurements:
    values = {column.name: table[:, k] for k, column in enumerate(columns)}
    result = next(key for key in values if key in RESULTS)
    sigma = values.pop("sigma", None)
    if sigma is not None and any(column.relative for column in columns):
        with np.errstate(over="ignore"):  # what is infinite is refused with its row
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


def _raise(errors: Sequence[str]) -> None:
    if errors:
        more = [f"... and {len(errors) - _MOST_LISTED} more"] if len(errors) > _MOST_LISTED else []
        raise InputError("\n".join([*errors[:_MOST_LISTED], *more]))
