"""`Store`: the SQLite file of a sweep, its tables, and checks of their content.

One run at a time writes a store, and any run may continue it; others may read it meanwhile. A store can be read from
any medium, even a read-only one.
"""

import contextlib
import json
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, Json, ValidationError

from plough_opt.core.errors import InputError, merge
from plough_opt.core.plain_data import Array
from plough_opt.studies.sweep.pool import Done

LAYOUT: Final = 3
"""Version of the tables of a store."""

State = Literal["computed", "failed", "undetermined"]
"""State of a point: with results, without them for a known reason, or without them because its workers died."""

# Columns that every table of points has.
_FIXED: Final = ("point", "state", "reason")
RESERVED: Final = (*_FIXED, "failed", "reasons", "undetermined")
"""Names that quantities and results cannot have, because tables use them."""

_TABLES: Final = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE notes (kind TEXT PRIMARY KEY, text TEXT NOT NULL, first INTEGER NOT NULL, points INTEGER NOT NULL)",
    "CREATE TABLE points (point INTEGER PRIMARY KEY, state TEXT NOT NULL, reason TEXT, {columns})",
)
# Adds to the count of a note, and takes over its text, with which that of the other points is merged.
_NOTE: Final = (
    "INSERT INTO notes VALUES (?, ?, ?, ?) ON CONFLICT (kind) DO UPDATE SET text = excluded.text,"
    " first = min(first, excluded.first), points = points + excluded.points"
)
# Time [s] to wait for a reader that has locked the file.
_BUSY: Final = 60.0
# Numbers of points that are looked up at once when missing ones are sought: as many as the largest task has.
_LOOKED_UP: Final = 4096


class About(BaseModel):
    """Description of the sweep in a store.

    Attributes:
        names: the quantities that are swept.
        results: names of the results, empty until the first point has some.
        units: name -> unit, of quantities and results that have one.
        question: everything that the results depend on, as texts.
        count: number of points of the whole sweep.
    """

    names: Json[tuple[str, ...]]
    results: Json[tuple[str, ...]]
    units: Json[dict[str, str]]
    question: Json[dict[str, str]]
    count: Annotated[int, Field(ge=1)]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of quantities and results."""
        return (*self.names, *self.results)


class Counts(NamedTuple):
    """Numbers of stored points, and of the failed and the undetermined ones among them."""

    stored: int
    failed: int
    undetermined: int


class Store:
    """An open store.

    Attributes:
        path: of the file; None for a temporary file, which is deleted when it is closed.
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
            InputError: the file cannot be created or read, another run writes it, or it is not a store; it is left
                unchanged.
        """
        self.path = None if path is None else Path(path)
        self._next = 0  # number of the first point that is not claimed yet
        self._open = contextlib.ExitStack()
        self._writing = self._open.enter_context(contextlib.ExitStack())
        with closed_on_error(self):
            with self._naming_errors():
                self._connection = self._to_write() if write else self._to_read()
            self._open.callback(self._connection.close)
            self.empty = not self._tables()
            if not self.empty:
                self.about = self._read_about()
            if write and path is not None:
                self.run("PRAGMA journal_mode = WAL")  # others can read while this run writes
                # Nothing is lost if the process dies. A power cut may lose the last transactions but damages nothing.
                self.run("PRAGMA synchronous = NORMAL")

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    # --- filling -----------------------------------------------------------------------------------------

    def prepare(self, about: About, retry: bool = False) -> None:
        """Enter the sweep, or compare its question with the one in the file.

        Args:
            about: description of the sweep.
            retry: delete the points that failed or are undetermined, so that they are computed again.

        Raises:
            InputError: the store belongs to another question; the message lists the differences.
        """
        if self.empty:
            with self._transaction():
                columns = ", ".join(f"{_quoted(name)} REAL NOT NULL" for name in about.names)
                for statement in _TABLES:
                    self.run(statement.format(columns=columns))
                for key, value in {"layout": LAYOUT, **about.model_dump(round_trip=True)}.items():
                    self.run("INSERT INTO meta VALUES (?, ?)", key, str(value))
            self.about = self._read_about()
        self._check_question(about.question)
        if retry:
            with self._transaction():
                self.run("DELETE FROM points WHERE state != 'computed'")

    def claim(self, size: int) -> NDArray[np.int64] | None:
        """Return the numbers of at most so many points that are neither stored nor claimed; None if there are none."""
        while self._next < self.about.count:
            first, last = self._next, min(self._next + _LOOKED_UP, self.about.count)
            stored = self.run("SELECT point FROM points WHERE point >= ? AND point < ?", first, last)
            missing = np.setdiff1d(np.arange(first, last), np.array(stored, dtype=np.int64).ravel())[:size]
            self._next = int(missing[-1]) + 1 if len(missing) else last
            if len(missing):
                return missing
        return None

    def name_results(self, results: Sequence[str]) -> None:
        """Enter the names of the results when the first point has some.

        Raises:
            InputError: a name cannot be a column, or the names differ from those of earlier points.
        """
        if not self.about.results:
            check_columns((*self.about.names, *results))
            with self._transaction():
                for name in results:
                    self.run(f"ALTER TABLE points ADD COLUMN {_quoted(name)} REAL")
                self.run("UPDATE meta SET value = ? WHERE key = 'results'", json.dumps(list(results)))
            self.about = self._read_about()
        if self.about.results != tuple(results):
            raise InputError(
                f"the results of one point are {', '.join(results)}, those of others {', '.join(self.about.results)}:"
                " return the same names, in the same order, at every point"
            )

    def keep(self, numbers: NDArray[np.int64], values: Array, done: Done, without: State = "failed") -> None:
        """Store points, all or none of them.

        Args:
            numbers: of the points.
            values: of the quantities, a row for each point.
            done: results, reasons and notes of the points.
            without: state of the points without results.
        """
        columns = (*_FIXED, *self.about.columns)
        insert = f"INSERT INTO points ({', '.join(map(_quoted, columns))}) VALUES ({', '.join('?' * len(columns))})"
        with self._transaction():
            with self._naming_errors():
                self._connection.executemany(insert, self._rows(numbers, values, done, without))
            notes = dict(self.run("SELECT kind, text FROM notes"))
            for text, place, points in done.notes.values():
                kind = merge(notes, text)
                self.run(_NOTE, kind, notes[kind], int(numbers[place]), points)

    def finish(self) -> None:
        """Check that all points are stored, and merge the log into the file, so that any medium can hold it.

        Raises:
            InputError: points are missing.
        """
        stored = self.counts().stored
        if stored != self.about.count:
            raise InputError(
                f"the store '{self.path}' holds {stored} of {self.about.count} points, though all of them were written:"
                " another program, or a trigger inside it, rejects or removes rows; sweep into another file"
            )
        if self.path is not None:
            with contextlib.suppress(sqlite3.Error):  # others have it open
                self._connection.execute("PRAGMA busy_timeout = 0")
                self._connection.execute("PRAGMA journal_mode = DELETE")
        self._writing.close()

    # --- reading -----------------------------------------------------------------------------------------

    def counts(self) -> Counts:
        """Return the numbers of stored, failed and undetermined points."""
        row = self.run("SELECT count(*), total(state = 'failed'), total(state = 'undetermined') FROM points")[0]
        return Counts(*map(int, row))

    def notes(self) -> list[tuple[str, int]]:
        """Return (text, number of points) of each warning, in the order of their first points."""
        return [(text, points) for text, points in self.run("SELECT text, points FROM notes ORDER BY first, kind")]

    def rows(self, *columns: str, where: State | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of the points, in order, with only a few of them in memory at once.

        Args:
            columns: columns of a row: names of quantities and results, "point", "state" or "reason".
            where: state of the points; None for all.
        """
        condition = f"WHERE state = '{where}'" if where else ""
        with self._naming_errors():
            chosen = ", ".join(map(_quoted, columns))
            yield from self._connection.execute(f"SELECT {chosen} FROM points {condition} ORDER BY point")

    def extreme(self, name: str, largest: bool) -> tuple[Any, ...] | None:
        """Return (least or largest value of a result, its first point, the quantities there ...), or None."""
        chosen = ", ".join(map(_quoted, (name, "point", *self.about.names)))
        order = f"{_quoted(name)} {'DESC' if largest else 'ASC'}, point"
        rows = self.run(f"SELECT {chosen} FROM points WHERE state = 'computed' ORDER BY {order} LIMIT 1")
        return rows[0] if rows else None

    def _rows(
        self, numbers: NDArray[np.int64], values: Array, done: Done, without: State
    ) -> Iterator[tuple[object, ...]]:
        """Yield the rows to store."""
        empty = [None] * len(self.about.results)
        for k, (number, row) in enumerate(zip(numbers.tolist(), values.tolist(), strict=True)):
            reason, cells, state = done.reasons.get(k), [*row, *empty], without
            if reason is None and done.results is not None:
                cells, state = [*row, *done.results[k].tolist()], "computed"
            # Texts of exceptions may hold surrogates, which UTF-8 cannot encode.
            text = None if reason is None else reason.encode("utf-8", "backslashreplace").decode("utf-8")
            yield number, state, text, *cells

    # --- checks ------------------------------------------------------------------------------------------

    def _read_about(self) -> About:
        """Return the description of the sweep in the file.

        Raises:
            InputError: the file is not a store of this layout, or its tables are damaged.
        """
        if not {"meta", "notes", "points"} <= self._tables():
            raise InputError(f"'{self.path}' is a database, but not the store of a sweep: name another file")
        meta = dict(self.run("SELECT key, value FROM meta"))
        if (layout := meta.get("layout")) != str(LAYOUT):
            other = f"the store '{self.path}' has layout {layout}, but this version reads layout {LAYOUT}"
            raise InputError(f"{other}: sweep into another file")
        try:
            about = About.model_validate(meta)
            check_columns(about.columns)
        except ValidationError as error:
            first = error.errors()[0]
            raise self._damaged(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        except InputError as error:
            raise self._damaged(str(error)) from None
        columns = [row[1] for row in self.run("PRAGMA table_info(points)")]
        expected = [*_FIXED, *about.columns]
        if columns != expected:
            raise self._damaged(f"its table of points has the columns {', '.join(columns)}, not {', '.join(expected)}")
        for table, wrong in _wrong_rows(about).items():
            if self.run(f"SELECT 1 FROM {table} WHERE {' OR '.join(wrong)} LIMIT 1"):
                raise self._damaged(f"its table of {table} holds rows that no sweep writes: sweep into another file")
        return about

    def _check_question(self, question: dict[str, str]) -> None:
        """Raise InputError if the store holds a sweep with another question."""
        there = self.about.question
        pairs = {key: (there.get(key, "absent"), question.get(key, "absent")) for key in (question | there)}
        differences = [f"{key}: {old} there, {new} here" for key, (old, new) in pairs.items() if old != new]
        if differences:
            more = f"; and {len(differences) - 4} more" if len(differences) > 4 else ""
            raise InputError(
                f"the store '{self.path}' belongs to another sweep ({'; '.join(differences[:4])}{more}): name another"
                " store, or repeat the same sweep"
            )

    def _damaged(self, how: str) -> InputError:
        return InputError(f"the store '{self.path}' is damaged: {how}")

    # --- access to the file ------------------------------------------------------------------------------

    def run(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        """Execute a statement and return all its rows.

        Raises:
            InputError: the file cannot be used or is damaged.
        """
        with self._naming_errors():
            return self._connection.execute(statement, values).fetchall()

    def _tables(self) -> set[str]:
        return {row[0] for row in self.run("SELECT name FROM sqlite_master WHERE type = 'table'")}

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        """Commit everything done inside, or nothing if that raises."""
        if self._connection.in_transaction:  # Ctrl-C interrupted the last one before its first statement or its commit
            self.run("ROLLBACK")
        self.run("BEGIN IMMEDIATE")
        with self._naming_errors(), self._connection:
            yield

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
        if self.path is None:
            return _connected("")  # SQLite creates a temporary file that is deleted with the connection
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._lock(self.path.with_name(f"{self.path.name}-writer"))
        return _connected(self.path)

    def _lock(self, place: Path) -> None:
        """Lock an empty database beside the file, which SQLite unlocks when this process ends, however it ends.

        Raises:
            InputError: another run has locked it.
        """
        lock = _connected(place, timeout=0.0)
        self._writing.callback(lock.close)
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY:
                raise
            busy = f"another run fills the store '{self.path}'"
            raise InputError(f"{busy}: wait for its end, or read what it has stored (po.Sweep.load)") from None
        self._writing.callback(_remove, place)

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
        folder = self._open.enter_context(tempfile.TemporaryDirectory())
        for part in (here, log):
            shutil.copy(part, folder)
        return _reader(Path(folder, here.name), "mode=rw")


@contextlib.contextmanager
def closed_on_error(opened: Store | sqlite3.Connection) -> Iterator[None]:
    """Close a store or a connection if what is done inside raises an error."""
    try:
        yield
    except BaseException:
        opened.close()
        raise


def _remove(place: Path) -> None:
    with contextlib.suppress(OSError):  # Windows does not remove open files; the next run then locks this one
        place.unlink()


def _connected(place: str | Path, timeout: float = _BUSY, uri: bool = False) -> sqlite3.Connection:
    # Garbage collection may close a store in any thread.
    return sqlite3.connect(place, uri=uri, timeout=timeout, isolation_level=None, check_same_thread=False)


def _reader(path: Path, mode: str) -> sqlite3.Connection:
    """Return a connection to a file, after a query that raises an error if the file cannot be read."""
    connection = _connected(f"{path.as_uri()}?{mode}", uri=True)
    with closed_on_error(connection):
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
    return connection


def _wrong_rows(about: About) -> dict[str, list[str]]:
    """Return for tables the conditions that are true only of rows that no sweep has written."""
    kind = "CASE state WHEN 'computed' THEN 'real' ELSE 'null' END"
    results = [f"typeof({_quoted(name)}) != {kind}" for name in about.results]
    quantities = [f"typeof({_quoted(name)}) != 'real'" for name in about.names]
    states = ", ".join(map(repr, get_args(State)))
    return {
        "notes": ["typeof(text) != 'text'", "typeof(first) != 'integer'", "typeof(points) != 'integer'"],
        "points": [
            f"point NOT BETWEEN 0 AND {about.count - 1}", f"state NOT IN ({states})",
            "typeof(reason) NOT IN ('text', 'null')", *quantities, *results,
        ],
    }  # fmt: skip


def check_columns(names: Sequence[str]) -> None:
    """Raise InputError if a name is not printable, repeated, or reserved; case is ignored."""
    for name in names:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise InputError(f"{name!r} cannot name a quantity or a result: use printable text")
    folded = [name.casefold() for name in (*RESERVED, *names)]
    for name in names:
        if folded.count(name.casefold()) > 1:
            twice = f"'{name}' cannot name a column: in upper or lower case it is used twice"
            raise InputError(f"{twice}, or reserved ({', '.join(RESERVED)}); rename it")


def _quoted(name: str) -> str:
    """Return a name as a quoted SQL identifier."""
    return '"' + name.replace('"', '""') + '"'
