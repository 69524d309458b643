"""The SQLite file of a sweep: opened to write or, on any medium, to read; its tables, and checks of their content.

Points are claimed in ranges. Every point below ``next`` is either stored or lies in a range of ``claims``, whose owner
renews its lease while it runs. Every row of ``points`` has a checksum of its content.
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
# How long [s] to wait for another run's transaction.
_BUSY: Final = 60.0


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


class Database:
    """An SQLite file, open.

    Attributes:
        path: of the file, or None for one that is deleted when it is closed.
    """

    def __init__(self, path: str | Path | None, write: bool) -> None:
        """Open a file; a missing one is made if it is to be written.

        Raises:
            InputError: a file that cannot be made or read.
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
        """Execute a statement; return all its rows.

        Raises:
            InputError: the file cannot be used, or is damaged.
        """
        with self._naming_errors():
            return self._connection.execute(statement, values).fetchall()

    def run_many(self, statement: str, rows: Iterator[tuple[object, ...]]) -> int:
        """Execute a statement for each row; return the number of rows that it changed."""
        with self._naming_errors():
            return int(self._connection.executemany(statement, rows).rowcount)

    def stream(self, statement: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query, of which only a few are in memory at once."""
        with self._naming_errors():
            yield from self._connection.execute(statement)

    def tables(self) -> set[str]:
        """Return the names of the tables."""
        return {row[0] for row in self.run("SELECT name FROM sqlite_master WHERE type = 'table'")}

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit everything done inside, or nothing if it fails; other processes wait."""
        if self._connection.in_transaction:  # Ctrl-C came just before the last one was under way, or committed
            self.run("ROLLBACK")
        self.run("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            # A full disk may have ended the transaction already.
            with contextlib.suppress(InputError):
                self.run("ROLLBACK")
            raise
        self.run("COMMIT")

    def write_ahead(self) -> None:
        """Allow others to read while one writes; several runs may call this at the same moment."""
        with self._naming_errors():
            for trial in range(100):
                try:
                    self._connection.execute("PRAGMA journal_mode = WAL")
                    break
                except sqlite3.OperationalError as error:
                    if "locked" not in str(error) or trial == 99:
                        raise
                    time.sleep(0.05)
        # If the process dies nothing is lost; a power cut may lose the last transactions, but damages nothing.
        self.run("PRAGMA synchronous = NORMAL")

    def make_whole(self) -> None:
        """Move everything into the one file, which can then be read from any medium, unless others have it open."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA busy_timeout = 0")
            self._connection.execute("PRAGMA journal_mode = DELETE")

    @contextlib.contextmanager
    def _naming_errors(self) -> Iterator[None]:
        """Raise errors inside as InputError with the name of the file."""
        try:
            yield
        except (sqlite3.Error, OverflowError) as error:
            raise InputError(f"the store '{self.path}' cannot be used: {error}") from None
        except OSError as error:
            raise InputError(f"the store '{self.path}' cannot be written: {error.strerror}") from None

    def _to_write(self) -> sqlite3.Connection:
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        # With an empty name SQLite makes a temporary file that is deleted with the connection.
        # The store may be closed by any thread, that in which a result is collected as garbage.
        return sqlite3.connect(self.path or "", timeout=_BUSY, isolation_level=None, check_same_thread=False)

    def _to_read(self) -> sqlite3.Connection:
        """Open without writing anything, so that the medium may be read-only."""
        assert self.path is not None
        here = self.path.resolve()
        try:
            return _reader(here, "mode=ro")
        except sqlite3.OperationalError:
            log = here.with_name(f"{here.name}-wal")
            if not log.exists() or not log.stat().st_size:
                return _reader(here, "immutable=1")
        # A killed run has left a log beside the file, and SQLite must write to merge the two.
        self._folder = tempfile.TemporaryDirectory()
        for part in (here, log):
            shutil.copy(part, self._folder.name)
        return _reader(Path(self._folder.name, here.name), "mode=rw")


def _reader(path: Path, mode: str) -> sqlite3.Connection:
    """Return a connection to a file, after a query that fails if the file cannot be read."""
    place = f"{path.as_uri()}?{mode}"
    connection = sqlite3.connect(place, uri=True, timeout=_BUSY, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
    except BaseException:
        connection.close()
        raise
    return connection


def create(database: Database, about: About) -> None:
    """Make the tables of a sweep in an empty file."""
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


def quoted(name: str) -> str:
    """Return a name as a quoted identifier of SQL."""
    return '"' + name.replace('"', '""') + '"'
