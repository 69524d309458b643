"""Reading CSV files whose headings give names and units, with errors that give line and column; writing CSV files."""

import csv
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, TextIO

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.files import BYTE_ORDER_MARK, read_text
from plough_opt.core.units import Unit

HEADING: Final = re.compile(r"\s*(?P<name>[\w.]+)\s*(?:\[(?P<unit>[^\]]*)\])?\s*")
"""A column's name and its unit in brackets."""

# Units customary in the field, for messages that ask for a unit.
_CUSTOMARY: Final = {"N": "kN", "rad": "deg", "m/s": "km/h", "Pa": "kPa", "N/m": "kN/m", "W": "kW"}
# Infinite numbers and NaN match too, because they get a different error message.
_NUMBER: Final = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan|inf(?:inity)?)", re.IGNORECASE)
# Beginning of a text that a spreadsheet would compute; an apostrophe before it makes it a text, and is doubled itself.
_FORMULA: Final = re.compile(r"'*[=+\-@\t\r\n＝＋－＠]")
# Most mistakes listed in one message.
_MOST_LISTED: Final = 8
# Largest file: some 300,000 rows, each of which may require a simulation.
_MOST_BYTES: Final = 10_000_000
_LONGEST_LINE: Final = 10_000


def read_rows(path: Path, what: str) -> list[tuple[int, list[str]]]:
    """Return the rows of a file with their line numbers, without comments and empty lines.

    Separators at the end of lines, and lines of separators alone, as spreadsheets write them, are ignored.

    Args:
        path: the file.
        what: name of its content in messages, such as "measurements".

    Raises:
        InputError: the file is missing, too large or not UTF-8 text.
    """
    text = read_text(path, f"a file of {what}", ".csv", _MOST_BYTES).removeprefix(BYTE_ORDER_MARK)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    for number, line in lines:
        if len(line) > _LONGEST_LINE:
            raise InputError(
                f"{path}, line {number}: it has {len(line)} characters, but at most {_LONGEST_LINE} can be read: write"
                " one row per line"
            )
    delimiter = next((mark for mark in "\t;" if lines and mark in lines[0][1].strip()), ",")
    read = ((k, next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))) for k, line in lines)
    rows = [(k, [*map(_unshielded, cells)]) for k, cells in read if any(map(str.strip, cells))]
    width = max((k for k, heading in enumerate(rows[0][1], 1) if heading.strip()), default=0) if rows else 0
    return [(k, cells if any(map(str.strip, cells[width:])) else cells[:width]) for k, cells in rows]


def write_rows(file: TextIO, rows: Iterable[Sequence[object]]) -> None:
    """Write rows as CSV. Numbers have all their digits, and a text that begins like a formula gets an apostrophe.

    `read_rows` removes the apostrophe again. It does not read every text back as it was: a cell must not contain a line
    break or begin with a blank, the first cell of a row must not begin with "#", nor a heading contain a tab or ";".
    """
    csv.writer(file, lineterminator="\n").writerows(map(_shielded, row) for row in rows)


def _unshielded(cell: str) -> str:
    """Return a cell as it was before `_shielded`."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _shielded(cell: object) -> object:
    """Return a cell that a spreadsheet shows as it is."""
    formula = isinstance(cell, str) and _FORMULA.match(cell) and not _NUMBER.fullmatch(cell)
    return f"'{cell}" if formula else cell


def readings_of(path: Path, example: str) -> tuple[str, list[str], list[tuple[int, list[str]]]]:
    """Return the location of a file's headings, the headings, and the rows below them with their line numbers.

    Args:
        path: the file.
        example: valid headings, for messages.

    Raises:
        InputError: as `read_rows`, or there are no rows below the headings.
    """
    rows = read_rows(path, "readings")
    if len(rows) < 2:
        raise InputError(f"{path}: there are no readings: name the columns in the first line, such as {example}")
    return f"{path}, line {rows[0][0]}", rows[0][1], rows[1:]


def check_rising(path: Path, lines: Sequence[int], values: NDArray[np.float64], what: str) -> None:
    """Raise InputError if values do not increase strictly from line to line; the message names the first that fails."""
    for k in np.flatnonzero(np.diff(values) <= 0.0)[:1] + 1:
        beside = f"{values[k]:g} follows {values[k - 1]:g}"
        raise InputError(f"{path}, line {lines[k]}: {what} must increase, but {beside}: sort the rows")


def factor_of(name: str, written: str | None, unit: Unit) -> float:
    """Return the factor from the unit in a column's heading to SI.

    Args:
        name: of the column.
        written: unit in the heading, or None.
        unit: expected SI unit.

    Raises:
        InputError: the unit is missing, unknown or of the wrong dimension.
    """
    written = "" if written is None or written.strip() in ("-", "1") else written.strip()
    customary = _CUSTOMARY.get(unit.symbol, unit.symbol)
    if unit.symbol and not written:
        raise InputError(f"the unit is missing: write it like '{name} [{customary}]'")
    try:
        return unit.split(f"1 {written}".strip())[1]
    except InputError:
        wrong = f"is not a unit of {unit.symbol}" if unit.symbol else "is a unit, but a pure number is expected"
        example = f"{name} [{customary}]" if unit.symbol else name
        raise InputError(f"'{written}' {wrong}: write it like '{example}'") from None


def number_of(cell: str, factor: float) -> float:
    """Return the number in a cell, converted to SI.

    Raises:
        InputError: the cell does not hold a finite number.
    """
    text = cell.strip()
    if not text:
        raise InputError("the cell is empty: a number is expected; omit the whole row if it was not measured")
    if _NUMBER.fullmatch(text) is None:
        hint = "a decimal point" if re.fullmatch(r"[+-]?\d+,\d+", text) else "it as 12.5 or 1.25e1, without its unit"
        raise InputError(f"'{short(text)}' is not a number: write {hint}")
    value = float(text) * factor
    if not math.isfinite(value):
        raise InputError(f"'{short(text)}' is not a finite number; omit the whole row if it was not measured")
    return value


def columns_of(place: str, headings: Sequence[str], units: Mapping[str, Unit]) -> list[tuple[str, float]]:
    """Return name and conversion factor to SI of every column.

    Args:
        place: file and line of the headings, for messages.
        headings: as written, each a name with its unit in brackets.
        units: known names and their SI units.

    Raises:
        InputError: a name is unknown or a unit wrong; the message lists every one.
    """
    found: list[tuple[str, float]] = []
    errors = []
    for text in headings:
        match = HEADING.fullmatch(text)
        try:
            if match is None or match["name"] not in units:
                raise InputError(f"this column is unknown: {nearest(match['name'] if match else text, units)}")
            found.append((match["name"], factor_of(match["name"], match["unit"], units[match["name"]])))
        except InputError as error:
            errors.append(f"{place}, column '{short(text.strip())}': {error}")
    raise_listed(errors)
    return found


def table_of(
    path: str | Path,
    rows: Sequence[tuple[int, Sequence[str]]],
    columns: Sequence[tuple[str, float]],
    check: Callable[[int, float, str], None],
) -> NDArray[np.float64]:
    """Return the numbers of all rows in SI, shape (rows, columns).

    Args:
        path: the file, for messages.
        rows: line number and cells of each row below the headings.
        columns: name of each column in messages, and its factor to SI.
        check: function of (column, value, cell as written) that raises InputError for an invalid value.

    Raises:
        InputError: a cell is invalid or a row has the wrong length; the message lists every one.
    """
    table, errors = [], []
    for number, cells in rows:
        place, values = f"{path}, line {number}", []
        if len(cells) != len(columns):
            errors.append(
                f"{place}: the row has {len(cells)} cells, but the header names {len(columns)} columns: give one"
                " cell per column"
            )
            continue
        for k, (cell, (name, factor)) in enumerate(zip(cells, columns, strict=True)):
            try:
                values.append(number_of(cell, factor))
                check(k, values[-1], cell.strip())
            except InputError as error:
                errors.append(f"{place}, column '{name}': {error}")
        table.append(values)
    raise_listed(errors)
    return np.array(table)


def raise_listed(errors: Sequence[str]) -> None:
    """Raise InputError if there are any mistakes; the message lists the first few."""
    if errors:
        more = [f"... and {len(errors) - _MOST_LISTED} more"] if len(errors) > _MOST_LISTED else []
        raise InputError("\n".join([*errors[:_MOST_LISTED], *more]))
