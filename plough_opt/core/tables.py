"""Tables of results as text, in notebooks and on the command line, and CSV files, with errors by line and column."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TextIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, nearest, printable, short
from plough_opt.core.files import BYTE_ORDER_MARK, draw, read_text, write_file
from plough_opt.core.process import optional
from plough_opt.core.units import Unit

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.table import Table

# A column's name, and its unit in brackets.
_HEADING: Final = re.compile(
    r"\s*(?P<name>[\w.]+(?:[\s-]+[\w.]+)*)\s*(?:(?:\[(?P<unit>[^\]]*)\]|\((?P<round>[^)]*)\)))?\s*"
)
# A number with a decimal comma.
_COMMA: Final = re.compile(r"\s*[+-]?(?:[0-9]+,[0-9]*|,[0-9]+)(?:e[+-]?[0-9]+)?\s*", re.IGNORECASE)
# Units customary in the field, for messages that ask for a unit.
_CUSTOMARY: Final = {"N": "kN", "rad": "deg", "m/s": "km/h", "Pa": "kPa", "N/m": "kN/m", "W": "kW"}
# Infinite numbers and NaN match too, because they get a different error message.
_NUMBER: Final = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan|inf(?:inity)?)", re.IGNORECASE)
# Beginning of a text that a spreadsheet would compute, or that `read_rows` would skip; an apostrophe before it makes it
# a text, and is doubled itself.
_FORMULA: Final = re.compile(r"'*[=+\-@\t\r\n＝＋－＠# ]")
# Characters that end a cell or a row in some files, where they are not in quotation marks.
_SEPARATOR: Final = re.compile(r"[;\t\r\n]")
# Most mistakes listed in one message.
_MOST_LISTED: Final = 8
# Largest file: some 300,000 rows, each of which may require a simulation.
_MOST_BYTES: Final = 10_000_000


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        heading: text above the column.
        left: whether cells are aligned left.
        fold: whether cells may be broken within a word on a narrow screen; other columns break between words.
        mark: whether cells are highlighted, because they report something unusual.
    """

    heading: str = ""
    left: bool = False
    fold: bool = False
    mark: bool = False


@dataclass
class Grid:
    """A table of texts.

    Attributes:
        columns: from left to right.
        title: text above the table.
        caption: text below the table.
        rows: cells of each row.
        bold: numbers of the rows in bold.
        ends: numbers of the rows followed by a rule.
    """

    columns: tuple[Column, ...]
    title: str = ""
    caption: str = ""
    rows: list[tuple[str, ...]] = field(default_factory=list)
    bold: list[int] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Raise ValueError if a row does not have one cell per column."""
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"a row has {len(row)} cells, but the table has {len(self.columns)} columns")

    @classmethod
    def of(cls, title: str, *headings: str, left: Sequence[str] = (), fold: Sequence[str] = ()) -> Grid:
        """Return an empty table; cells of a column without a heading are highlighted, unless it is the first.

        Args:
            title: text above the table.
            headings: of the columns; the first column is aligned left.
            left: headings of further columns that are aligned left.
            fold: headings of columns that may be broken within a word.
        """
        columns = (Column(h, k == 0 or h in left, h in fold, k > 0 and not h) for k, h in enumerate(headings))
        return cls(tuple(columns), title)

    @classmethod
    def pairs(cls, title: str, *rows: tuple[str, str]) -> Grid:
        """Return a table of names and values without headings."""
        return cls((Column(left=True), Column()), title, rows=[*rows])

    def row(self, *cells: str, bold: bool = False, end: bool = False) -> None:
        """Add a row."""
        self.bold += [len(self.rows)] * bold
        self.ends += [len(self.rows)] * end
        self.rows.append(cells)

    @property
    def headed(self) -> bool:
        """Whether any column has a heading."""
        return any(column.heading for column in self.columns)

    def _lines(self) -> tuple[list[str], list[list[str]]]:
        """Return the headings, none if all are empty, and the cells of all rows as they are shown."""
        headings = [printable(column.heading) for column in self.columns]
        return headings if self.headed else [], [[*map(printable, row)] for row in self.rows]

    def __str__(self) -> str:
        """Return the table as plain text."""
        headings, rows = self._lines()
        lines = [tuple(" ".join(text.split()) for text in headings)] if headings else []
        for row in rows:
            # A cell with several lines takes as many rows of text.
            lines += itertools.zip_longest(*(cell.splitlines() or [""] for cell in row), fillvalue="")
        aligned = []
        for column, cells in zip(self.columns, zip(*lines, strict=True), strict=False):
            side, width = "<" if column.left else ">", max(map(len, cells))
            aligned.append([f"{cell:{side}{width}}" for cell in cells])
        text = "\n".join(f"  {'  '.join(cells)}".rstrip() for cells in zip(*aligned, strict=True))
        return "\n".join(part for part in (printable(self.title), text, printable(self.caption)) if part)

    def __rich__(self) -> Table:
        """Return the table for a terminal."""
        from rich.table import Table
        from rich.text import Text

        headings, rows = self._lines()
        title, caption = (
            Text(printable(text), f"table.{what}") if text else None
            for text, what in ((self.title, "title"), (self.caption, "caption"))
        )
        table = Table(title=title, caption=caption, show_header=bool(headings))
        for column in self.columns:
            side: Literal["left", "right"] = "left" if column.left else "right"
            overflow: Literal["fold", "ellipsis"] = "fold" if column.fold else "ellipsis"
            heading = Text(printable(column.heading))
            table.add_column(heading, justify=side, overflow=overflow, style="yellow" if column.mark else "")
        for k, row in enumerate(rows):
            table.add_row(*map(Text, row), style="bold" if k in self.bold else None, end_section=k in self.ends)
        return table

    def html(self) -> str:
        """Return the table as HTML."""
        headings, rows = self._lines()

        def row(cells: Sequence[str], tag: str, style: str = "") -> str:
            sides = ["left" if column.left else "right" for column in self.columns]
            inner = (f'<{tag} style="text-align: {s}">{_escaped(x)}</{tag}>' for x, s in zip(cells, sides, strict=True))
            return f"<tr{style}>{''.join(inner)}</tr>"

        bold = ' style="font-weight: bold"'
        lines = [row(headings, "th")] if headings else []
        lines += [row(cells, "td", bold * (k in self.bold)) for k, cells in enumerate(rows)]
        title = f'<caption style="text-align: left">{_escaped(self.title)}</caption>' if self.title else ""
        below = f"<p>{_escaped(self.caption)}</p>" if self.caption else ""
        return f"<table>{title}{''.join(lines)}</table>{below}"


def _escaped(text: str) -> str:
    """Return a text as HTML, with its lines."""
    return escape(printable(text)).replace("\n", "<br>")


Part: TypeAlias = Grid | str


@dataclass(frozen=True)
class Page:
    """A result as shown to the user.

    Attributes:
        heading: one line that says what was found.
        parts: tables and sentences, in order.
        notes: remarks that readers of the numbers must know, each without its full stop.
        footer: how far the numbers can be trusted.
        title: title of the question, shown first.
    """

    heading: str
    parts: tuple[Part, ...] = ()
    notes: tuple[str, ...] = ()
    footer: str = ""
    title: str = ""

    def __str__(self) -> str:
        """Return the page as plain text."""
        notes = (f"Note: {text}." for text in dict.fromkeys(self.notes))
        parts = (self.title, self.heading, *map(str, self.parts), *notes, self.footer)
        return "\n".join(printable(part) for part in parts if part)

    def html(self, picture: str = "") -> str:
        """Return the page as HTML, with a picture after its tables."""
        parts = (part.html() if isinstance(part, Grid) else f"<p>{_escaped(part)}</p>" for part in self.parts)
        notes = "".join(f"<li>{_escaped(text)}.</li>" for text in dict.fromkeys(self.notes))
        heading = f"<p>{_escaped(self.heading)}</p>" if self.title else ""
        footer = f"<p>{_escaped(self.footer)}</p>" if self.footer else ""
        return (
            f"<div><p><b>{_escaped(self.title or self.heading)}</b></p>{heading}{''.join(parts)}{picture}"
            f"{f'<ul>{notes}</ul>' if notes else ''}{footer}</div>"
        )


class Readable(ABC):
    """A result that prints as tables, and shows them and its picture in a notebook.

    Subclasses define `page`, and `plot` if they have a picture.
    """

    @abstractmethod
    def page(self) -> Page:
        """Return tables and text that present the result."""

    def shown_page(self) -> Page:
        """Return the page; for a result read from a file, the page as it was saved."""
        return getattr(self, "_shown", None) or self.page()

    def __str__(self) -> str:
        """Return the page as plain text."""
        return str(self.shown_page())

    def __repr__(self) -> str:
        """Return one line that says what was found, because all numbers would fill pages."""
        return f"<{type(self).__name__}: {printable(self.shown_page().heading)}>"

    def _repr_html_(self) -> str:
        """Return tables and picture as HTML for a notebook; a result that has nothing to draw shows its tables."""
        image = ""
        if plot := getattr(self, "plot", None):
            with suppress(InputError):
                image = _image(plot())
        return self.shown_page().html(image)


def _image(figure: Figure) -> str:
    """Return a picture as an HTML image that holds its own data, so that no separate file is needed."""
    from base64 import b64encode
    from io import BytesIO

    file = BytesIO()
    draw(figure, file, format="png", dpi=80)
    return f'<img alt="picture of the result" src="data:image/png;base64,{b64encode(file.getvalue()).decode()}">'


def data_frame(columns: Mapping[str, Any], units: Mapping[str, str]) -> pandas.DataFrame:
    """Return columns as a pandas DataFrame with units in ``attrs["units"]``.

    Args:
        columns: name of each column -> its values.
        units: name of a column, or what a row is about -> its unit, "" for a pure number.

    Raises:
        InputError: pandas is not installed.
    """
    frame: pandas.DataFrame = optional("pandas").DataFrame(dict(columns))
    frame.attrs["units"] = dict(units)
    return frame


def read_rows(path: Path, what: str) -> list[tuple[int, list[str]]]:
    """Return the rows of a file with their line numbers, without comments and empty lines.

    Separators at the end of lines, and lines of separators alone, as spreadsheets write them, are ignored. Where
    semicolons separate the cells, a decimal comma is read as a decimal point.

    Args:
        path: the file.
        what: name of its content in messages, such as "measurements".

    Raises:
        InputError: the file is missing, too large or not UTF-8 text, or has both decimal commas and decimal points.
    """
    text = read_text(path, f"a file of {what}", ".csv", _MOST_BYTES).removeprefix(BYTE_ORDER_MARK)
    lines = [*io.StringIO(text, newline="")]
    heading = next((line for line in lines if line.strip() and not line.startswith("#")), "").strip()
    delimiter = next((mark for mark in "\t;" if mark in re.sub(r'"[^"]*"?', "", heading)), ",")
    rows: list[tuple[int, list[str]]] = []
    first = 1  # line of the row that is read next
    uncommented = ("\n" if line.startswith("#") and k == first else line for k, line in enumerate(lines, 1))
    reader = csv.reader(uncommented, delimiter=delimiter, skipinitialspace=True, strict=True)
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                rows.append((first, [*map(_unshielded, cells)]))
            first = reader.line_num + 1
    except csv.Error:
        raise InputError(f"{path}, line {first}: a quotation mark begins a cell that does not end: close it") from None
    rows = _with_points(path, rows) if delimiter == ";" else rows
    width = max((k for k, name in enumerate(rows[0][1], 1) if name.strip()), default=0) if rows else 0
    return [(k, cells if any(map(str.strip, cells[width:])) else cells[:width]) for k, cells in rows]


def _with_points(path: Path, rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Return the rows with decimal points in place of decimal commas."""
    written = [(k, cell) for k, cells in rows for cell in cells]
    comma = next((k for k, cell in written if _COMMA.fullmatch(cell)), None)
    point = next((k for k, cell in written if "." in cell and _NUMBER.fullmatch(cell.strip())), None)
    if comma is not None and point is not None:
        raise InputError(
            f"{path}: line {comma} has a decimal comma and line {point} a decimal point: use one of the two, and no"
            " separator of thousands"
        )
    return [(k, [x.replace(",", ".") if _COMMA.fullmatch(x) else x for x in cells]) for k, cells in rows]


def write_rows(file: TextIO, rows: Iterable[Sequence[object]]) -> None:
    """Write rows as CSV. Numbers have all their digits, and a text that begins like a formula gets an apostrophe.

    So does one that begins with a blank or with "#", as comments do. `read_rows` removes the apostrophe again, and
    reads every row back that is not blank. A row with a separator or a line break is written in quotation marks.
    """
    plain = csv.writer(file, lineterminator="\n")
    quoted = csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL)
    for row in rows:
        odd = any(isinstance(cell, str) and _SEPARATOR.search(cell) for cell in row)
        (quoted if odd else plain).writerow(map(_shielded, row))


def write_table(path: str | Path, rows: Iterable[Sequence[object]]) -> Path:
    """Write rows into a CSV file by `write_rows`.

    Raises:
        InputError: the file cannot be written.
    """
    text = io.StringIO(newline="")
    write_rows(text, rows)
    return write_file(path, "table", text.getvalue())


def write_frame(path: str | Path, frame: pandas.DataFrame) -> Path:
    """Write a data frame with the units of its columns in their headings, as CSV or, by its ending, as a workbook.

    Raises:
        InputError: the file cannot be written, or it is a workbook and openpyxl is not installed.
    """
    units = frame.attrs.get("units", {})
    headings: list[Any] = [f"{name} [{units[name]}]" if units.get(name) else str(name) for name in frame.columns]
    cells: list[list[Any]] = frame.to_numpy(dtype=object).tolist()
    rows = [headings, *([None if isinstance(x, float) and math.isnan(x) else x for x in row] for row in cells)]
    if Path(path).suffix.lower() == ".xlsx":
        book = optional("openpyxl").Workbook()
        for row in rows:
            book.active.append([_shielded(cell) for cell in row])
        return write_file(path, "table", book.save)
    return write_table(path, rows)


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
        hint = "write it as 12.5 or 1.25e1, without its unit"
        if _COMMA.fullmatch(text):
            hint = "write a decimal point for the comma, or separate the columns by semicolons"
        raise InputError(f"'{short(text)}' is not a number: {hint}")
    value = float(text) * factor
    if not math.isfinite(value):
        raise InputError(f"'{short(text)}' is not a finite number; omit the whole row if it was not measured")
    return value


def heading_of(text: str, names: Iterable[str]) -> tuple[str, str | None]:
    """Return the name and the unit of a column, such as "cone_index" and "kPa" of "Cone Index [kPa]".

    Args:
        text: the heading: a name, in capitals or not, its words joined by "_", "-" or blanks, and a unit in brackets or
            after an underscore.
        names: valid names; of any other name only the blanks are changed.
    """
    match = _HEADING.fullmatch(text)
    if match is None:
        return text.strip(), None
    spelt = {name.lower(): name for name in names}
    joined, unit = re.sub(r"[\s-]+", "_", match["name"]), match["unit"] or match["round"]
    stem, _, last = joined.rpartition("_")
    if unit is None and joined.lower() not in spelt and stem.lower() in spelt:
        joined, unit = stem, last
    return spelt.get(joined.lower(), joined), unit


def columns_of(place: str, headings: Sequence[str], units: Mapping[str, Unit]) -> list[tuple[str, float]]:
    """Return name and conversion factor to SI of every column.

    Args:
        place: file and line of the headings, for messages.
        headings: as written, each a name with its unit in brackets.
        units: known names and their SI units.

    Raises:
        InputError: a name is unknown or a unit wrong; the message lists every one.
    """
    columns: list[tuple[str, float]] = []
    errors = []
    for text in headings:
        name, unit = heading_of(text, units)
        try:
            if name not in units:
                raise InputError(f"this column is unknown: {nearest(name, units)}")
            columns.append((name, factor_of(name, unit, units[name])))
        except InputError as error:
            errors.append(f"{place}, column '{short(text.strip())}': {error}")
    raise_listed(errors)
    return columns


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
            commas = ", and separate cells by semicolons if commas are decimal" if len(cells) > len(columns) else ""
            errors.append(
                f"{place}: the row has {len(cells)} cells, but the header names {len(columns)} columns: give one"
                f" cell per column{commas}"
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


def raise_listed(errors: Sequence[str], most: int = _MOST_LISTED, further: int = 0) -> None:
    """Raise InputError if there are any mistakes.

    Args:
        errors: sentences on mistakes, of which the message lists the first few.
        most: number of mistakes to list.
        further: number of mistakes besides these.
    """
    if errors:
        rest = len(errors[most:]) + further
        raise InputError("\n".join([*errors[:most], *([f"... and {rest} more"] if rest else [])]))
