"""`Store`: the SQLite file of a sweep, with its tables and checks of their content.

Runs claim points in ranges. Every point below ``next`` is either stored or within a range of ``claims``, whose owner
renews its lease while it runs. Every row of ``points`` has a checksum of its content. A store can be read from any
medium, even a read-only one. If a run dies, another one takes over the ranges of points that it had claimed.
"""

import contextlib
import itertools
import json
import os
import platform
import shutil
import sqlite3
import struct
import tempfile
import time
import uuid
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, Json, ValidationError

from plough_opt.core.errors import InputError
from plough_opt.core.notes import merge
from plough_opt.studies.sweep.pool import Array, Done

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


# Time [s] after which a run counts as dead if it has not renewed its lease.
_LEASE: Final = 30.0
# Number of claims, those renewed longest ago first, among which claims of dead runs are sought.
_SEARCHED: Final = 256
# Most points in one claim when missing points are computed again: as many as a batch simulates at once.
_LARGEST_GAP: Final = 2048
# Adds to the count of a note, and takes over its text, with which that of the other points is merged.
_NOTE: Final = (
    "INSERT INTO notes VALUES (?, ?, ?, ?) ON CONFLICT (kind) DO UPDATE SET text = excluded.text,"
    " first = min(first, excluded.first), points = points + excluded.points"
)
# Deletes the claim that contains a point if all points of its range are stored.
_END_CLAIM: Final = (
    "DELETE FROM claims WHERE owner = ? AND first <= ? AND last > ? AND last - first ="
    " (SELECT count(*) FROM points WHERE point >= claims.first AND point < claims.last)"
)


class Counts(NamedTuple):
    """Numbers of stored points, and of the failed and the undetermined ones among them."""

    stored: int
    failed: int
    undetermined: int


class Store(Database):
    """An open store.

    Attributes:
        empty: whether it had no tables when it was opened. Then it has no `about` before `prepare`.
        about: description of the sweep.
    """

    about: About

    def __init__(self, path: str | Path | None, write: bool = True) -> None:
        """Open a file. If it is opened to write, a missing one is created.

        Args:
            path: of the file; None for a temporary file, which is deleted when it is closed.
            write: whether points are to be stored.

        Raises:
            InputError: the file cannot be created or read, or is not a store; it is left unchanged.
        """
        super().__init__(path, write)
        self._owner = f"{platform.node()}:{os.getpid()}:{uuid.uuid4().hex}"
        try:
            self.empty = not self.tables()
            if not self.empty:
                self.about = read(self)
            if write and path is not None:
                self.write_ahead()
        except InputError:
            self.close()
            raise

    def prepare(self, about: About, retry: bool = False) -> None:
        """Enter the sweep, or compare its question with the one in the file; then check every row.

        Afterwards points can be claimed that are neither stored nor claimed by another live run.

        Args:
            about: description of the sweep.
            retry: delete the points that failed, are undetermined or are damaged, so that they are computed again.

        Raises:
            InputError: the store belongs to another question (the message lists the differences), rows are damaged, or
                another run is filling the store while ``retry`` is set.
        """
        with self.transaction():
            if not self.tables():
                create(self, about)
        self.about = read(self)
        self._check_question(about.question)
        now = time.time()
        with self.transaction():
            owners = self.run("SELECT owner, max(expires) FROM claims GROUP BY owner")
            alone = all(_dead(owner, expires, now) for owner, expires in owners)
            if not retry:
                self.verify()
            elif not alone:
                raise InputError(
                    f"another run fills the store '{self.path}': wait for its end before you retry failures"
                )
            else:
                self.run("DELETE FROM points WHERE state != 'computed'")
                for point in list(self._damaged_points()):
                    self.run("DELETE FROM points WHERE point = ?", point)
            if alone:
                self.run("DELETE FROM claims")
                self.run_many("INSERT INTO claims VALUES (?, ?, '', 0.0)", self._gaps(self._next()))

    def finish(self) -> None:
        """Check that all points are stored, and merge the log into the file, so that any medium can hold it.

        Raises:
            InputError: points are missing.
        """
        self.about = read(self)  # another run may have entered the names of results
        stored = self.counts().stored
        if stored != self.about.count:
            raise InputError(
                f"the store '{self.path}' holds {stored} of {self.about.count} points, though all of them were written:"
                " another program, or a trigger inside it, rejects or removes rows; sweep into another file"
            )
        if self.path is not None:
            self.make_whole()

    def counts(self) -> Counts:
        """Return the numbers of stored, failed and undetermined points."""
        row = self.run("SELECT count(*), total(state = 'failed'), total(state = 'undetermined') FROM points")[0]
        return Counts(*map(int, row))

    def claim(self, size: int) -> NDArray[np.int64] | None:
        """Claim a range and return the numbers of its points that are not stored; None if no points are left.

        Args:
            size: limit on the number of points in a new range; the range of a dead run is claimed as it is.
        """
        while True:
            now = time.time()
            with self.transaction():
                first = self._next()
                last = min(first + size, self.about.count)
                if first < self.about.count:
                    self.run("UPDATE meta SET value = ? WHERE key = 'next'", str(last))
                elif (abandoned := self._abandoned(now)) is not None:
                    first, last = abandoned
                else:
                    return None
                self.run("INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?)", first, last, self._owner, now + _LEASE)
                stored = self.run("SELECT point FROM points WHERE point >= ? AND point < ?", first, last)
                missing = np.setdiff1d(np.arange(first, last), np.array([row[0] for row in stored], dtype=np.int64))
                if len(missing):
                    return missing
                self.run(_END_CLAIM, self._owner, first, first)

    def waiting(self) -> bool:
        """Return whether another run has claims."""
        return bool(self.run("SELECT 1 FROM claims WHERE owner != ? LIMIT 1", self._owner))

    def renew(self, seconds: float = _LEASE) -> None:
        """Renew the lease on this run's claims. After a lease of 0 s others may take over the claims at once."""
        expires = time.time() + seconds if seconds else 0.0
        with self.transaction():
            self.run("UPDATE claims SET expires = ? WHERE owner = ?", expires, self._owner)

    def verify(self) -> None:
        """Compare every row with its checksum.

        Raises:
            InputError: rows differ from their checksums.
        """
        if spoilt := list(self._damaged_points()):
            raise damaged(
                self.path,
                f"{len(spoilt)} of its rows differ from their checksums, the first one at point {spoilt[0]}; the same"
                " sweep with --retry (retry=True) computes them again",
            )

    def name_results(self, results: Sequence[str]) -> None:
        """Enter the names of the results when the first point has some.

        Raises:
            InputError: a name cannot be a column, or the names differ from those of earlier points.
        """
        with self.transaction():
            self.about = read(self)
            if not self.about.results:
                check_columns((*self.about.names, *results))
                for name in results:
                    self.run(f"ALTER TABLE points ADD COLUMN {quoted(name)} REAL")
                self.run("UPDATE meta SET value = ? WHERE key = 'results'", json.dumps(list(results)))
                self.about = read(self)
        if self.about.results != tuple(results):
            raise InputError(
                f"the results of one point are {', '.join(results)}, those of others {', '.join(self.about.results)}:"
                " return the same names, in the same order, at every point"
            )

    def keep(self, numbers: NDArray[np.int64], values: Array, done: Done, without: State = "failed") -> int:
        """Store points, all or none of them, and end their claim if it is complete.

        Args:
            numbers: of the points.
            values: of the quantities, a row for each point.
            done: results, reasons and notes of the points.
            without: state of the points without results.

        Returns:
            The number of points that were not stored before.
        """
        columns = ", ".join(map(quoted, (*FIXED, *self.about.columns)))
        marks = ", ".join("?" * (len(FIXED) + len(self.about.columns)))
        rows = self._rows(numbers, values, done, without)
        with self.transaction():
            new = self.run_many(f"INSERT OR IGNORE INTO points ({columns}) VALUES ({marks})", rows)
            if new == len(numbers):
                notes = dict(self.run("SELECT kind, text FROM notes"))
                for text, place, points in done.notes.values():
                    kind = merge(notes, text)
                    self.run(_NOTE, kind, notes[kind], int(numbers[place]), points)
            self.run(_END_CLAIM, self._owner, int(numbers[0]), int(numbers[0]))
        return new

    def notes(self) -> list[tuple[str, int]]:
        """Return (text, number of points) of each warning, in the order of their first points."""
        return [(text, points) for text, points in self.run("SELECT text, points FROM notes ORDER BY first, kind")]

    def rows(self, *columns: str, where: State | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of the points, in order, with only a few of them in memory at once.

        Args:
            columns: columns of a row: names of quantities and results, "point", "state", "reason" or "checksum".
            where: state of the points; None for all.
        """
        chosen = ", ".join(map(quoted, columns))
        condition = f"WHERE state = '{where}'" if where else ""
        return self.stream(f"SELECT {chosen} FROM points {condition} ORDER BY point")

    def extreme(self, name: str, largest: bool) -> tuple[Any, ...] | None:
        """Return (least or largest value of a result, its first point, the quantities there ...), or None."""
        chosen = ", ".join(map(quoted, (name, "point", *self.about.names)))
        order = f"{quoted(name)} {'DESC' if largest else 'ASC'}, point"
        rows = self.run(f"SELECT {chosen} FROM points WHERE state = 'computed' ORDER BY {order} LIMIT 1")
        return rows[0] if rows else None

    def _rows(
        self, numbers: NDArray[np.int64], values: Array, done: Done, without: State
    ) -> Iterator[tuple[object, ...]]:
        """Yield the rows to store."""
        empty = [None] * len(self.about.results)
        # SQLite stores negative zero as zero; adding zero makes the checksum agree.
        for k, (number, row) in enumerate(zip(numbers.tolist(), (values + 0.0).tolist(), strict=True)):
            reason, cells, state = done.reasons.get(k), [*row, *empty], without
            if reason is None and done.results is not None:
                cells, state = [*row, *done.results[k].tolist()], "computed"
            # Texts of exceptions may hold surrogates, which UTF-8 cannot encode.
            text = None if reason is None else reason.encode("utf-8", "backslashreplace").decode("utf-8")
            yield number, state, text, checksum(number, state, text, cells, len(row)), *cells

    def _damaged_points(self) -> Iterator[int]:
        """Yield the points whose rows differ from their checksums or do not belong to the sweep."""
        for point, state, reason, stored, *numbers in self.rows(*FIXED, *self.about.columns):
            expected = checksum(point, state, reason, numbers, len(self.about.names))
            if stored != expected or not 0 <= point < self.about.count:
                yield point

    def _gaps(self, end: int) -> Iterator[tuple[int, int]]:
        """Yield the ranges of missing points before an end."""
        first = 0
        for point, *_ in itertools.chain(self.rows("point"), [(end,)]):
            for start in range(first, point, _LARGEST_GAP):
                yield start, min(start + _LARGEST_GAP, point)
            first = point + 1

    def _next(self) -> int:
        return int(self.run("SELECT value FROM meta WHERE key = 'next'")[0][0])

    def _abandoned(self, now: float) -> tuple[int, int] | None:
        """Return a range that a dead run claimed, if one is found among the claims renewed longest ago."""
        oldest = self.run("SELECT first, last, owner, expires FROM claims ORDER BY expires LIMIT ?", _SEARCHED)
        abandoned = ((first, last) for first, last, owner, expires in oldest if _dead(owner, expires, now))
        return next(abandoned, None)

    def _check_question(self, question: dict[str, str]) -> None:
        """Raise InputError if the store holds a sweep with another question."""
        there = self.about.question
        differences = [
            f"{key}: {there.get(key, 'absent')} there, {question.get(key, 'absent')} here"
            for key in dict.fromkeys((*question, *there))
            if there.get(key) != question.get(key)
        ]
        if differences:
            more = f"; and {len(differences) - 4} more" if len(differences) > 4 else ""
            raise InputError(
                f"the store '{self.path}' belongs to another sweep ({'; '.join(differences[:4])}{more}): name another"
                " store, or repeat the same sweep"
            )


def _dead(owner: str, expires: float, now: float) -> bool:
    """Return whether the run that owns a claim is dead: its lease has ended, or its process on this machine has."""
    node, _, rest = owner.partition(":")
    if expires < now:
        return True
    if os.name != "posix" or node != platform.node():
        return False
    try:
        os.kill(int(rest.partition(":")[0]), 0)
    except (ValueError, OverflowError):  # no run writes such an owner
        return True
    except OSError as error:  # another error means that the process exists but belongs to another user
        return isinstance(error, ProcessLookupError)
    return False
