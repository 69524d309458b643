"""The tables in the store of a sweep, and checks that those of a file are as they were written.

Points are claimed in ranges. Every point below ``next`` is either stored or lies in a range of ``claims``, whose owner
renews its lease while it runs. Every row of ``points`` has a checksum of its content.
"""

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, Field, Json, ValidationError

from plough_opt.core.errors import InputError
from plough_opt.studies.sweep.database import Database, quoted

LAYOUT: Final = 2
"""Number of the layout of a store."""

State = Literal["computed", "failed", "undetermined"]
"""State of a point: with results; without them for a known reason; or without them because its workers died."""

FIXED: Final = ("point", "state", "reason", "checksum")
"""Columns of every table of points."""

# Names in tables besides quantities and results.
_RESERVED: Final = (*FIXED, "failed", "reasons", "undetermined")
_TABLES: Final = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE claims (first INTEGER PRIMARY KEY, last INTEGER NOT NULL, owner TEXT NOT NULL, expires REAL NOT NULL);
CREATE INDEX oldest ON claims (expires);
CREATE TABLE notes (kind TEXT PRIMARY KEY, text TEXT NOT NULL, first INTEGER NOT NULL, points INTEGER NOT NULL);
"""
# Conditions on rows that a sweep never writes.
_WRONG: Final = {
    "claims": "typeof(first) != 'integer' OR typeof(last) != 'integer' OR typeof(owner) != 'text' OR first < 0"
    " OR typeof(expires) != 'real' OR last <= first",
    "notes": "typeof(text) != 'text' OR typeof(first) != 'integer' OR typeof(points) != 'integer'",
}


class About(BaseModel):
    """The sweep in a store.

    Attributes:
        names: the quantities that are swept.
        results: names of the results, empty until a point has some.
        units: name -> unit, of quantities and results that have one.
        question: everything that the results depend on.
        count: number of points of the whole sweep.
        next: first point that is not claimed yet.
    """

    names: Json[tuple[str, ...]]
    results: Json[tuple[str, ...]]
    units: Json[dict[str, str]]
    question: Json[dict[str, str]]
    count: Annotated[int, Field(ge=1)]
    next: Annotated[int, Field(ge=0)]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of quantities and results."""
        return (*self.names, *self.results)


def create(
    database: Database, question: Mapping[str, str], names: Sequence[str], units: Mapping[str, str], count: int
) -> None:
    """Make the tables in an empty file."""
    for statement in filter(str.strip, _TABLES.split(";")):
        database.run(statement)
    columns = ", ".join(f"{quoted(name)} REAL NOT NULL" for name in names)
    database.run(
        "CREATE TABLE points (point INTEGER PRIMARY KEY, state TEXT NOT NULL, reason TEXT, checksum INTEGER NOT NULL,"
        f" {columns})"
    )
    values = {
        "layout": str(LAYOUT), "next": "0", "count": str(count), "names": json.dumps(list(names)), "results": "[]",
        "units": json.dumps(dict(units)), "question": json.dumps(dict(question)),
    }  # fmt: skip
    database.run_many("INSERT INTO meta VALUES (?, ?)", iter(values.items()))


def read(database: Database) -> About:
    """Return the sweep in a file.

    Raises:
        InputError: the file is not a store of this layout, or its tables are damaged.
    """
    path = database.path
    if not {"meta", "claims", "notes", "points"} <= database.tables():
        raise InputError(f"'{path}' is a database, but not the store of a sweep: name another file")
    meta = dict(database.run("SELECT key, value FROM meta"))
    if (layout := meta.get("layout")) != str(LAYOUT):
        raise InputError(
            f"the store '{path}' has layout {layout}, and this version reads {LAYOUT}: sweep into another file"
        )
    try:
        about = About.model_validate(meta)
    except ValidationError as error:
        first = error.errors()[0]
        raise damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    columns = [row[1] for row in database.run("PRAGMA table_info(points)")]
    expected = [*FIXED, *about.columns]
    if columns != expected:
        raise damaged(path, f"its table of points has the columns {', '.join(columns)}, not {', '.join(expected)}")
    for table, condition in _WRONG.items():
        if database.run(f"SELECT 1 FROM {table} WHERE {condition} LIMIT 1"):
            raise damaged(path, f"its table of {table} holds rows that a sweep never writes")
    return about


def damaged(path: Path | None, how: str) -> InputError:
    """Return the error for a damaged file."""
    return InputError(f"the store '{path}' is damaged: {how}")


def spoilt_points(database: Database, about: About) -> Iterator[int]:
    """Yield the points whose rows differ from their checksums, or that do not belong to the sweep."""
    columns = ", ".join(map(quoted, (*FIXED, *about.columns)))
    for point, state, reason, kept, *numbers in database.rows(f"SELECT {columns} FROM points ORDER BY point"):
        right = checksum(point, state, reason, numbers, len(about.names))
        if kept != right or not 0 <= point < about.count:
            yield point


def checksum(point: int, state: str, reason: str | None, numbers: Sequence[object], swept: int) -> int | None:
    """Return the CRC-32 of a row, or None for a row that a sweep cannot have written.

    It covers the number of the point and its quantities and results, 8 bytes each, little-endian; then, as UTF-8, its
    state, a line feed, and its reason. Rows without results may have been written before the results had names, so
    their empty columns are left out.

    Args:
        point: its number.
        state: its state.
        reason: why it has no results.
        numbers: quantities and results.
        swept: number of quantities among these.
    """
    if state != "computed":
        numbers, rest = numbers[:swept], numbers[swept:]
        if any(number is not None for number in rest):
            return None
    try:
        packed = struct.pack(f"<q{len(numbers)}d", point, *numbers)
        return zlib.crc32(packed + f"{state}\n{reason or ''}".encode())
    except (struct.error, UnicodeError):
        return None


def check_columns(names: Sequence[str]) -> None:
    """Raise InputError if a name is not printable, is given twice, or is reserved for the tables' own columns."""
    for name in names:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise InputError(f"{name!r} cannot name a quantity or a result: use printable text")
    folded = [name.casefold() for name in (*_RESERVED, *names)]
    for name in names:
        if folded.count(name.casefold()) > 1:
            raise InputError(
                f"'{name}' cannot name a column: there are two of that name, whatever their case"
                f" ({', '.join(_RESERVED)} are the tables' own)"
            )
