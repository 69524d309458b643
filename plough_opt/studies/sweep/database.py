"""The SQLite file of a sweep: access to it, its tables, and checks of their content.

Runs claim points in ranges. Every point below ``next`` is either stored or within a range of ``claims``, whose owner
renews its lease while it runs. Every row of ``points`` has a checksum of its content. A store can be read from any
medium, even a read-only one.
"""

import contextlib
import shutil
import sqlite3
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, Field, Json, ValidationError

from plough_opt.core.errors import InputError

LAYOUT: Final = 2
"""Version of the tables of a store."""

State = Literal["computed", "failed", "undetermined"]
"""State of a point: with results, without them for a known reason, or without them because its workers died."""

FIXED: Final = ("point", "state", "reason", "checksum")
"""Columns that every table of points has."""

# Names that quantities and results cannot have, because tables use them.
_RESERVED: Final = (*FIXED, "failed", "reasons", "undetermined")
_TABLES: Final = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE claims (first INTEGER PRIMARY KEY, last INTEGER NOT NULL, owner TEXT NOT NULL, expires REAL NOT NULL);
CREATE INDEX oldest ON claims (expires);
CREATE TABLE notes (kind TEXT PRIMARY KEY, text TEXT NOT NULL, first INTEGER NOT NULL, points INTEGER NOT NULL);
"""
# Table -> condition that is true only of rows that no sweep has written.
_WRONG: Final = {
    "claims": "typeof(first) != 'integer' OR typeof(last) != 'integer' OR typeof(owner) != 'text' OR first < 0"
    " OR typeof(expires) != 'real' OR last <= first",
    "notes": "typeof(text) != 'text' OR typeof(first) != 'integer' OR typeof(points) != 'integer'",
}
# Time [s] to wait for the transaction of another run.
_BUSY: Final = 60.0


class About(BaseModel):
    """Description of the sweep in a store.

    Attributes:
        names: the quantities that are swept.
        results: names of the results, empty until the first point has some.
        units: name -> unit, of quantities and results that have one.
        question: everything that the results depend on, as texts.
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


class Database:
    """An open SQLite file.

    Attributes:
        path: of the file; None for a temporary file, which is deleted when it is closed.
    """

    def __init__(self, path: str | Path | None, write: bool) -> None:
        """Open a file. If it is opened to write, a missing one is created.

        Raises:
            InputError: the file cannot be created or read.
        """
        self.path = None if path is None else Path(path)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        with self._naming_errors():
            self._connection = self._to_write() if write else self._to_read()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()
        if self._folder is not None:
            self._folder.cleanup()

    def run(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        """Execute a statement and return all its rows.

        Raises:
            InputError: the file cannot be used or is damaged.
        """
        with self._naming_errors():
            return self._connection.execute(statement, values).fetchall()

    def run_many(self, statement: str, rows: Iterator[tuple[object, ...]]) -> int:
        """Execute a statement for each row of values and return the number of rows that it changed."""
        with self._naming_errors():
            return int(self._connection.executemany(statement, rows).rowcount)

    def stream(self, statement: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query, with only a few of them in memory at once."""
        with self._naming_errors():
            yield from self._connection.execute(statement)

    def tables(self) -> set[str]:
        """Return the names of the tables."""
        return {row[0] for row in self.run("SELECT name FROM sqlite_master WHERE type = 'table'")}

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit everything done inside, or nothing if that raises; meanwhile other processes wait."""
        if self._connection.in_transaction:  # Ctrl-C interrupted the last one before its first statement or its commit
            self.run("ROLLBACK")
        self.run("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            # A full disk may already have ended the transaction.
            with contextlib.suppress(InputError):
                self.run("ROLLBACK")
            raise
        self.run("COMMIT")

    def write_ahead(self) -> None:
        """Let others read while one run writes; several runs may call this at the same moment."""
        end = time.monotonic() + _BUSY
        with self._naming_errors():
            while True:
                try:
                    self._connection.execute("PRAGMA journal_mode = WAL")
                    break
                except sqlite3.OperationalError as error:
                    if "locked" not in str(error) or time.monotonic() > end:
                        raise
                    time.sleep(0.05)
        # Nothing is lost if the process dies. A power cut may lose the last transactions but damages nothing.
        self.run("PRAGMA synchronous = NORMAL")

    def make_whole(self) -> None:
        """Move the log into the file, which can then be read from any medium, unless others have it open."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA busy_timeout = 0")
            self._connection.execute("PRAGMA journal_mode = DELETE")

    @contextlib.contextmanager
    def _naming_errors(self) -> Iterator[None]:
        """Turn errors inside into InputError with the name of the file."""
        try:
            yield
        except (sqlite3.Error, OverflowError) as error:
            raise InputError(f"the store '{self.path}' cannot be used: {error}") from None
        except OSError as error:
            raise InputError(f"the store '{self.path}' cannot be written: {error.strerror}") from None

    def _to_write(self) -> sqlite3.Connection:
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        # For an empty name SQLite creates a temporary file that is deleted with the connection. Garbage collection may
        # close the store in any thread.
        return sqlite3.connect(self.path or "", timeout=_BUSY, isolation_level=None, check_same_thread=False)

    def _to_read(self) -> sqlite3.Connection:
        """Open the file without writing anything, because the medium may be read-only."""
        assert self.path is not None
        here = self.path.resolve()
        try:
            return _reader(here, "mode=ro")
        except sqlite3.OperationalError:
            log = here.with_name(f"{here.name}-wal")
            if not log.exists() or not log.stat().st_size:
                return _reader(here, "immutable=1")
        # A killed run left a log beside the file. SQLite must write to merge the two, so it works on copies.
        self._folder = tempfile.TemporaryDirectory()
        for part in (here, log):
            shutil.copy(part, self._folder.name)
        return _reader(Path(self._folder.name, here.name), "mode=rw")


def _reader(path: Path, mode: str) -> sqlite3.Connection:
    """Return a connection to a file, after a query that raises an error if the file cannot be read."""
    place = f"{path.as_uri()}?{mode}"
    connection = sqlite3.connect(place, uri=True, timeout=_BUSY, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
    except BaseException:
        connection.close()
        raise
    return connection


def create(database: Database, about: About) -> None:
    """Create the tables of a sweep in an empty file."""
    for statement in filter(str.strip, _TABLES.split(";")):
        database.run(statement)
    columns = ", ".join(f"{quoted(name)} REAL NOT NULL" for name in about.names)
    database.run(
        "CREATE TABLE points (point INTEGER PRIMARY KEY, state TEXT NOT NULL, reason TEXT, checksum INTEGER NOT NULL,"
        f" {columns})"
    )
    meta = {"layout": LAYOUT, **about.model_dump(round_trip=True)}
    database.run_many("INSERT INTO meta VALUES (?, ?)", ((key, str(value)) for key, value in meta.items()))


def read(database: Database) -> About:
    """Return the description of the sweep in a file.

    Raises:
        InputError: the file is not a store of this layout, or its tables are damaged.
    """
    path = database.path
    if not {"meta", "claims", "notes", "points"} <= database.tables():
        raise InputError(f"'{path}' is a database, but not the store of a sweep: name another file")
    meta = dict(database.run("SELECT key, value FROM meta"))
    if (layout := meta.get("layout")) != str(LAYOUT):
        raise InputError(
            f"the store '{path}' has layout {layout}, but this version reads layout {LAYOUT}: sweep into another file"
        )
    try:
        about = About.model_validate(meta)
    except ValidationError as error:
        first = error.errors()[0]
        raise damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    try:
        check_columns(about.columns)
    except InputError as error:
        raise damaged(path, str(error)) from None
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


def checksum(point: int, state: str, reason: str | None, numbers: Sequence[object], swept: int) -> int | None:
    """Return the CRC-32 of a row, or None if a sweep cannot have written the row.

    It covers the number of the point, its quantities and its results, 8 bytes each, little-endian; then, as UTF-8, its
    state, a line feed and its reason. The empty columns of a row without results are left out, because the row may have
    been written before the results had names.

    Args:
        point: number of the point.
        state: its state.
        reason: why it has no results, or None.
        numbers: its quantities and results.
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
    """Raise InputError if a name is not printable, repeated, or reserved; case is ignored."""
    for name in names:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise InputError(f"{name!r} cannot name a quantity or a result: use printable text")
    folded = [name.casefold() for name in (*_RESERVED, *names)]
    for name in names:
        if folded.count(name.casefold()) > 1:
            raise InputError(
                f"'{name}' cannot name a column: in upper or lower case it is used twice, or reserved"
                f" ({', '.join(_RESERVED)}); rename it"
            )


def quoted(name: str) -> str:
    """Return a name as a quoted SQL identifier."""
    return '"' + name.replace('"', '""') + '"'
