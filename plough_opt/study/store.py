"""The store of a sweep: an SQLite file that several runs may fill at once and any may resume.

Points are claimed in ranges. Every point below ``next`` is either stored or lies in a range of ``claims``, whose owner
renews it while it lives; the ranges of a run that died are taken over by the next that looks.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sqlite3
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.errors import InputError
from plough_opt.study.work import Array

LAYOUT: Final = 1
"""Number of the layout of a store."""

# A claim that was not renewed for so long [s] is that of a dead run.
_LEASE: Final = 30.0
# How long [s] to wait for another run's transaction.
_BUSY: Final = 60.0
# Claims among which one of a dead run is looked for.
_LOOKED_AT: Final = 256
_FIXED: Final = ("point", "reason")
_TABLES: Final = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE claims (first INTEGER PRIMARY KEY, last INTEGER NOT NULL, owner TEXT NOT NULL, expires REAL NOT NULL);
CREATE INDEX oldest ON claims (expires);
CREATE TABLE notes (kind TEXT PRIMARY KEY, text TEXT NOT NULL, first INTEGER NOT NULL, points INTEGER NOT NULL);
"""
Note = tuple[str, str, int, int]
"""Kind, text, first point and number of points of something that a reader must know."""


class Store:
    """A store, open.

    Attributes:
        path: of the file, or None for one that is deleted when it is closed.
        names: the quantities that are swept.
        results: names of the results, empty until a point has some.
    """

    def __init__(self, path: str | Path | None) -> None:
        """Open a file, or make it.

        Raises:
            InputError: a file that cannot be made or is no SQLite file.
        """
        self.path = None if path is None else Path(path)
        self._owner = f"{platform.node()}:{os.getpid()}:{uuid.uuid4().hex}"
        self.names: tuple[str, ...] = ()
        self.results: tuple[str, ...] = ()
        with self._telling():
            if self.path is not None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            # An empty name is SQLite's for a file that nobody else sees and that goes with the connection.
            # Whichever thread lets go of a result closes its store.
            self._connection = sqlite3.connect(
                self.path or "", timeout=_BUSY, isolation_level=None, check_same_thread=False
            )
            try:
                if self.path is not None:
                    self._refuse_foreign()
                    self._to_write_ahead()
                # The end of the process loses nothing; a power cut may lose the last transactions, and spoils nothing.
                self._run("PRAGMA synchronous = NORMAL")
            except (sqlite3.Error, InputError):
                self._connection.close()
                raise

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def prepare(self, question: Mapping[str, str], names: Sequence[str], units: Mapping[str, str], count: int) -> None:
        """Enter what is asked, or compare it with what the file holds.

        Args:
            question: everything that the results depend on.
            names: the quantities that are swept.
            units: name -> unit, of quantities and results that have one.
            count: number of points.

        Raises:
            InputError: the store belongs to another question; the message says what differs.
        """
        with self._transaction():
            if not self._tables():
                for statement in filter(str.strip, _TABLES.split(";")):
                    self._run(statement)
                columns = ", ".join(f"{_quoted(name)} REAL NOT NULL" for name in names)
                self._run(f"CREATE TABLE points (point INTEGER PRIMARY KEY, reason TEXT, {columns})")
                values = {
                    "layout": str(LAYOUT), "next": "0", "count": str(count), "names": json.dumps(list(names)),
                    "results": "[]", "units": json.dumps(dict(units)), "question": json.dumps(dict(question)),
                }  # fmt: skip
                self._connection.executemany("INSERT INTO meta VALUES (?, ?)", values.items())
            else:
                self._refuse_another(dict(question))
        self.read()

    def read(self) -> None:
        """Take over what the file says about itself.

        Raises:
            InputError: the file is no store of this layout.
        """
        with self._telling():
            if not self._tables() or self._meta("layout") != str(LAYOUT):
                raise InputError(f"'{self.path}' is no store of a sweep of this version")
            self.names = tuple(json.loads(self._meta("names")))
            self.results = tuple(json.loads(self._meta("results")))

    @property
    def count(self) -> int:
        """Number of points of the whole sweep."""
        return int(self._meta("count"))

    @property
    def question(self) -> dict[str, str]:
        """What was asked."""
        return dict(json.loads(self._meta("question")))

    @property
    def units(self) -> dict[str, str]:
        """Name -> unit."""
        return dict(json.loads(self._meta("units")))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of quantities and results."""
        return (*self.names, *self.results)

    def stored(self) -> tuple[int, int]:
        """Return how many points are stored, and how many of them failed."""
        found = self._run("SELECT count(*), count(reason) FROM points").fetchone()
        return int(found[0]), int(found[1])

    def claim(self, size: int) -> tuple[int, int] | None:
        """Return a range of points that no run works on yet, first and one beyond the last, or None.

        Args:
            size: most points of a range of new ones; one that a dead run left has its own size.
        """
        now = time.time()
        with self._transaction():
            first, count = int(self._meta("next")), self.count
            last = min(first + size, count)
            if first < count:
                self._run("UPDATE meta SET value = ? WHERE key = 'next'", str(last))
            else:
                # Whoever is dead renewed longest ago.
                oldest = self._run(
                    "SELECT first, last, owner, expires FROM claims ORDER BY expires LIMIT ?", _LOOKED_AT
                )
                left = [row for row in oldest.fetchall() if _dead(row[2], row[3], now)]
                if not left:
                    return None
                first, last = left[0][:2]
            self._run("INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?)", first, last, self._owner, now + _LEASE)
        return first, last

    def waiting(self) -> bool:
        """Return whether another run still works on points."""
        return self._run("SELECT 1 FROM claims WHERE owner != ? LIMIT 1", self._owner).fetchone() is not None

    def missing(self, first: int, last: int) -> NDArray[np.int64]:
        """Return the numbers of the points of a range that are not stored."""
        rows = self._run("SELECT point FROM points WHERE point >= ? AND point < ?", first, last)
        return np.setdiff1d(np.arange(first, last), np.array([row[0] for row in rows], dtype=np.int64))

    def renew(self) -> None:
        """Tell other runs that this one lives."""
        with self._transaction():
            self._run("UPDATE claims SET expires = ? WHERE owner = ?", time.time() + _LEASE, self._owner)

    def release(self) -> None:
        """Leave what this run claimed and did not finish to others."""
        with self._transaction():
            self._run("UPDATE claims SET expires = 0 WHERE owner = ?", self._owner)

    def reopen_failures(self) -> int:
        """Forget the points that failed, so that they are tried again; return how many they were.

        Raises:
            InputError: another run fills the store, and may have them under way.
        """
        now = time.time()
        with self._transaction():
            owners = self._run("SELECT owner, max(expires) FROM claims GROUP BY owner").fetchall()
            if not all(_dead(owner, expires, now) for owner, expires in owners):
                raise InputError(f"another run fills the store '{self.path}': wait for its end to try failures again")
            self._run(
                "INSERT OR IGNORE INTO claims SELECT point, point + 1, '', 0 FROM points WHERE reason IS NOT NULL"
            )
            return int(self._run("DELETE FROM points WHERE reason IS NOT NULL").rowcount)

    def name_results(self, results: Sequence[str]) -> None:
        """Enter the names of the results when the first point has some.

        Raises:
            InputError: names that cannot be columns, or other ones than those of the points before.
        """
        with self._transaction():
            known = tuple(json.loads(self._meta("results")))
            if not known:
                check_columns((*self.names, *results))
                for name in results:
                    self._run(f"ALTER TABLE points ADD COLUMN {_quoted(name)} REAL")
                self._run("UPDATE meta SET value = ? WHERE key = 'results'", json.dumps(list(results)))
                known = tuple(results)
        self.results = known
        if known != tuple(results):
            raise InputError(
                f"the results of one point are {', '.join(results)}, those of others {', '.join(known)}: return the"
                " same names, in the same order, at every point"
            )

    def keep(
        self,
        numbers: NDArray[np.int64],
        values: Array,
        results: Array | None,
        reasons: Mapping[int, str],
        notes: Sequence[Note] = (),
        finished: int | None = None,
    ) -> int:
        """Store points, at once; return how many of them were new.

        Args:
            numbers: of the points.
            values: of the quantities, a row each.
            results: a row for each point, or None where all of them failed before any succeeded.
            reasons: place among these points -> why it failed.
            notes: what a reader must know of them.
            finished: first point of the claim that they complete.
        """
        width = len(self.results) if results is not None else 0
        marks = ", ".join("?" * (2 + len(self.names) + width))
        columns = ", ".join(map(_quoted, (*_FIXED, *self.names, *self.results[:width])))
        empty = [None] * width
        rows = (
            (number, reasons.get(k), *row, *(empty if k in reasons or results is None else results[k].tolist()))
            for k, (number, row) in enumerate(zip(numbers.tolist(), values.tolist(), strict=True))
        )
        with self._transaction():
            new = self._connection.executemany(
                f"INSERT OR IGNORE INTO points ({columns}) VALUES ({marks})", rows
            ).rowcount
            if new == len(numbers):
                for note in notes:
                    self._add_note(note)
            if finished is not None:
                self._run("DELETE FROM claims WHERE first = ? AND owner = ?", finished, self._owner)
        return int(new)

    def notes(self) -> list[Note]:
        """Return what a reader must know, in the order of the first points."""
        return list(self._run("SELECT kind, text, first, points FROM notes ORDER BY first, kind"))

    def rows(self, *columns: str, where: str = "1") -> Iterator[tuple[Any, ...]]:
        """Yield columns of the points, in their order, without holding more than a few.

        Args:
            columns: "point", "reason", or names of quantities and results.
            where: SQL condition.
        """
        chosen = ", ".join(map(_quoted, columns))
        with self._telling():
            yield from self._run(f"SELECT {chosen} FROM points WHERE {where} ORDER BY point")

    def extreme(self, name: str, largest: bool) -> tuple[Any, ...] | None:
        """Return the least or largest value of a result, its first point and the quantities there, or None."""
        chosen = ", ".join(map(_quoted, (name, "point", *self.names)))
        order = f"{_quoted(name)} {'DESC' if largest else 'ASC'}, point"
        found = self._run(f"SELECT {chosen} FROM points WHERE reason IS NULL ORDER BY {order} LIMIT 1").fetchone()
        return None if found is None else tuple(found)

    def _add_note(self, note: Note) -> None:
        """Count a note; the first point's text stands for its kind."""
        self._run(
            "INSERT INTO notes VALUES (?, ?, ?, ?) ON CONFLICT (kind) DO UPDATE SET"
            " text = CASE WHEN excluded.first < first THEN excluded.text ELSE text END,"
            " first = min(first, excluded.first), points = points + excluded.points",
            *note,
        )

    def _refuse_another(self, question: dict[str, str]) -> None:
        """Refuse a store of another question."""
        self.read()
        before = self.question
        differences = [
            f"{key}: {before.get(key, 'absent')} there, {question.get(key, 'absent')} here"
            for key in dict.fromkeys((*question, *before))
            if before.get(key) != question.get(key)
        ]
        if differences:
            more = f"; and {len(differences) - 4} more" if len(differences) > 4 else ""
            raise InputError(
                f"the store '{self.path}' belongs to another question ({'; '.join(differences[:4])}{more}): name"
                " another store, or ask what was asked before"
            )

    def _refuse_foreign(self) -> None:
        """Refuse another program's database before anything in it is changed."""
        if (there := self._tables()) and not {"meta", "claims", "points"} <= there:
            raise InputError(f"'{self.path}' is a database, but no store of a sweep: name another file")

    def _tables(self) -> set[str]:
        return {row[0] for row in self._run("SELECT name FROM sqlite_master WHERE type = 'table'")}

    def _meta(self, key: str) -> str:
        found = self._run("SELECT value FROM meta WHERE key = ?", key).fetchone()
        return "" if found is None else str(found[0])

    def _run(self, statement: str, *values: object) -> sqlite3.Cursor:
        with self._telling():
            return self._connection.execute(statement, values)

    def _to_write_ahead(self) -> None:
        """Let others read while one writes; several runs may ask for it at the same moment."""
        for trial in range(100):
            try:
                self._connection.execute("PRAGMA journal_mode = WAL")
                return
            except sqlite3.OperationalError as error:
                if "locked" not in str(error) or trial == 99:
                    raise
                time.sleep(0.05)

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        """Do everything inside or nothing; others wait."""
        with self._telling():
            self._run("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                self._run("ROLLBACK")
                raise
            self._run("COMMIT")

    @contextlib.contextmanager
    def _telling(self) -> Iterator[None]:
        """Say which store it is that fails."""
        try:
            yield
        except (sqlite3.Error, json.JSONDecodeError) as error:
            raise InputError(f"the store '{self.path}' cannot be used: {error}") from None
        except OSError as error:
            raise InputError(f"the store '{self.path}' cannot be written: {error.strerror}") from None


def check_columns(names: Sequence[str]) -> None:
    """Refuse names that cannot stand side by side in a table.

    Raises:
        InputError: an empty name, the same one twice, or one that the table needs itself.
    """
    for name in names:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise InputError(f"{name!r} cannot name a quantity or a result: take printable text")
    folded = [name.casefold() for name in (*_FIXED, *names)]
    for name in names:
        if folded.count(name.casefold()) > 1:
            raise InputError(
                f"'{name}' cannot name a column: there are two of that name, whatever their case (point and reason are"
                " the table's own)"
            )


def _dead(owner: str, expires: float, now: float) -> bool:
    """Return whether a claim's run is dead: known so on the same machine, or silent for long."""
    node, _, rest = owner.partition(":")
    if expires < now:
        return True
    if os.name != "posix" or node != platform.node():
        return False
    try:
        os.kill(int(rest.partition(":")[0]), 0)
    except OSError as error:  # a process of another user is none that is dead
        return isinstance(error, ProcessLookupError)
    return False


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
