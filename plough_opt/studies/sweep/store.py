"""The store of a sweep: an SQLite file that several runs may fill at once and any may resume.

If a run dies, another takes over the ranges of points that it had claimed.
"""

import itertools
import json
import os
import platform
import time
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.studies.sweep import database
from plough_opt.studies.sweep.database import Database, State, quoted
from plough_opt.studies.sweep.work import Array, Done

# Time [s] after which the run of a claim that was not renewed counts as dead.
_LEASE: Final = 30.0
# Number of claims among which those of dead runs are looked for.
_LOOKED_AT: Final = 256
# Limit on a claim of points that are computed again: the rows that a batch simulates at once.
_MOST_AGAIN: Final = 2048
# Counts a note, and keeps its text if its point is the first of its kind.
_NOTE: Final = (
    "INSERT INTO notes VALUES (?, ?, ?, ?) ON CONFLICT (kind) DO UPDATE SET"
    " text = CASE WHEN excluded.first < first THEN excluded.text ELSE text END,"
    " first = min(first, excluded.first), points = points + excluded.points"
)
# Ends the claim of a point if all points in its range are stored.
_END_CLAIM: Final = (
    "DELETE FROM claims WHERE owner = ? AND first <= ? AND last > ? AND last - first ="
    " (SELECT count(*) FROM points WHERE point >= claims.first AND point < claims.last)"
)


class Counts(NamedTuple):
    """Numbers of points: those stored, and among them those that failed and those that are undetermined."""

    stored: int
    failed: int
    undetermined: int


class Store(Database):
    """A store, open.

    Attributes:
        empty: whether it had no tables when it was opened, and so has no `about` before `prepare`.
        about: quantities, results and question of the sweep.
    """

    about: database.About

    def __init__(self, path: str | Path | None, write: bool = True) -> None:
        """Open a file; a missing one is made if it is to be written.

        Args:
            path: of the file, or None for one that is deleted when it is closed.
            write: whether points are to be stored.

        Raises:
            InputError: a file that cannot be made or read, or that is not a store; nothing in it is changed.
        """
        super().__init__(path, write)
        self._owner = f"{platform.node()}:{os.getpid()}:{uuid.uuid4().hex}"
        try:
            self.empty = not self.tables()
            if not self.empty:
                self.about = database.read(self)
            if write and path is not None:
                self.write_ahead()
        except InputError:
            self.close()
            raise

    def prepare(self, about: database.About, retry: bool = False) -> None:
        """Enter the sweep, or compare its question with the one in the file; then check every row.

        Points that are neither stored nor under way in another run can be claimed afterwards.

        Args:
            about: the sweep.
            retry: delete the points that failed, are undetermined or are damaged, so that they are tried again.

        Raises:
            InputError: the store belongs to another question; the message lists the differences. Or damaged rows; or,
                with retry, another run fills the store.
        """
        with self.transaction():
            if not self.tables():
                database.create(self, about)
        self.about = database.read(self)
        self._check_question(about.question)
        now = time.time()
        with self.transaction():
            owners = self.run("SELECT owner, max(expires) FROM claims GROUP BY owner")
            alone = all(_dead(owner, expires, now) for owner, expires in owners)
            if not retry:
                self.verify()
            elif not alone:
                raise InputError(f"another run fills the store '{self.path}': wait for its end to try failures again")
            else:
                self.run("DELETE FROM points WHERE state != 'computed'")
                for point in list(self._spoilt()):
                    self.run("DELETE FROM points WHERE point = ?", point)
            if alone:
                self.run("DELETE FROM claims")
                self.run_many("INSERT INTO claims VALUES (?, ?, '', 0.0)", self._gaps(self._next()))

    def finish(self) -> None:
        """Check the number of points, and merge the log into the file, so that it can be read from any medium.

        Raises:
            InputError: points are missing.
        """
        self.about = database.read(self)  # another run may have entered names of results
        stored = self.counts().stored
        if stored != self.about.count:
            raise InputError(
                f"the store '{self.path}' holds {stored} of {self.about.count} points, though all of them were written:"
                " another program, or a trigger inside it, rejects or removes rows; sweep into another file"
            )
        if self.path is not None:
            self.make_whole()

    def counts(self) -> Counts:
        """Return the numbers of points that are stored, that failed, and that are undetermined."""
        row = self.run("SELECT count(*), total(state = 'failed'), total(state = 'undetermined') FROM points")[0]
        return Counts(*map(int, row))

    def claim(self, size: int) -> NDArray[np.int64] | None:
        """Claim a range of points; return the numbers of those that are not stored, or None if none are left.

        Args:
            size: limit on a range of new points; that of a dead run is claimed as it is.
        """
        while True:
            now = time.time()
            with self.transaction():
                first = self._next()
                last = min(first + size, self.about.count)
                if first < self.about.count:
                    self.run("UPDATE meta SET value = ? WHERE key = 'next'", str(last))
                elif (left := self._left_behind(now)) is not None:
                    first, last = left
                else:
                    return None
                self.run("INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?)", first, last, self._owner, now + _LEASE)
                stored = self.run("SELECT point FROM points WHERE point >= ? AND point < ?", first, last)
                missing = np.setdiff1d(np.arange(first, last), np.array([row[0] for row in stored], dtype=np.int64))
                if len(missing):
                    return missing
                self.run(_END_CLAIM, self._owner, first, first)

    def waiting(self) -> bool:
        """Return whether another run still works on points."""
        return bool(self.run("SELECT 1 FROM claims WHERE owner != ? LIMIT 1", self._owner))

    def renew(self, seconds: float = _LEASE) -> None:
        """Renew this run's lease on its claims; one of no time lets others claim its unfinished points at once."""
        expires = time.time() + seconds if seconds else 0.0
        with self.transaction():
            self.run("UPDATE claims SET expires = ? WHERE owner = ?", expires, self._owner)

    def verify(self) -> None:
        """Compare every row with its checksum.

        Raises:
            InputError: some differ.
        """
        spoilt = list(self._spoilt())
        if spoilt:
            raise database.damaged(
                self.path,
                f"{len(spoilt)} of its rows differ from their checksums, the first that of point {spoilt[0]}; the same"
                " sweep with --retry (retry=True) computes them again",
            )

    def name_results(self, results: Sequence[str]) -> None:
        """Enter the names of the results once the first point has some.

        Raises:
            InputError: names that cannot be columns, or that differ from those of earlier points.
        """
        with self.transaction():
            self.about = database.read(self)
            if not self.about.results:
                database.check_columns((*self.about.names, *results))
                for name in results:
                    self.run(f"ALTER TABLE points ADD COLUMN {quoted(name)} REAL")
                self.run("UPDATE meta SET value = ? WHERE key = 'results'", json.dumps(list(results)))
                self.about = database.read(self)
        if self.about.results != tuple(results):
            raise InputError(
                f"the results of one point are {', '.join(results)}, those of others {', '.join(self.about.results)}:"
                " return the same names, in the same order, at every point"
            )

    def keep(self, numbers: NDArray[np.int64], values: Array, done: Done, without: State = "failed") -> int:
        """Store points, all or none, and end their claim if they are the last of it; return the number of new ones.

        Args:
            numbers: of the points.
            values: of the quantities, a row for each point.
            done: their results, reasons and notes.
            without: state of the points without results.
        """
        columns = ", ".join(map(quoted, (*database.FIXED, *self.about.columns)))
        marks = ", ".join("?" * (len(database.FIXED) + len(self.about.columns)))
        rows = self._rows(numbers, values, done, without)
        with self.transaction():
            new = self.run_many(f"INSERT OR IGNORE INTO points ({columns}) VALUES ({marks})", rows)
            if new == len(numbers):
                for kind, (text, place, points) in sorted(done.notes.items()):
                    self.run(_NOTE, kind, text, int(numbers[place]), points)
            self.run(_END_CLAIM, self._owner, int(numbers[0]), int(numbers[0]))
        return new

    def notes(self) -> list[tuple[str, int]]:
        """Return the warnings, each with the number of its points, in the order of their first points."""
        return [(text, points) for text, points in self.run("SELECT text, points FROM notes ORDER BY first, kind")]

    def rows(self, *columns: str, where: State | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield columns of the points, in order, of which only a few are in memory at once.

        Args:
            columns: "point", "reason", or names of quantities and results.
            where: only points of this state.
        """
        chosen = ", ".join(map(quoted, columns))
        condition = f"WHERE state = '{where}'" if where else ""
        return self.stream(f"SELECT {chosen} FROM points {condition} ORDER BY point")

    def extreme(self, name: str, largest: bool) -> tuple[Any, ...] | None:
        """Return the least or largest value of a result, its first point and the quantities there, or None."""
        chosen = ", ".join(map(quoted, (name, "point", *self.about.names)))
        order = f"{quoted(name)} {'DESC' if largest else 'ASC'}, point"
        rows = self.run(f"SELECT {chosen} FROM points WHERE state = 'computed' ORDER BY {order} LIMIT 1")
        return rows[0] if rows else None

    def _rows(
        self, numbers: NDArray[np.int64], values: Array, done: Done, without: State
    ) -> Iterator[tuple[object, ...]]:
        """Yield rows as they are stored."""
        empty = [None] * len(self.about.results)
        # SQLite stores the negative zero as zero.
        for k, (number, row) in enumerate(zip(numbers.tolist(), (values + 0.0).tolist(), strict=True)):
            reason, cells, state = done.reasons.get(k), [*row, *empty], without
            if reason is None and done.results is not None:
                cells, state = [*row, *done.results[k].tolist()], "computed"
            # The text of any exception, which may hold surrogates that UTF-8 cannot encode.
            text = None if reason is None else reason.encode("utf-8", "backslashreplace").decode("utf-8")
            yield number, state, text, database.checksum(number, state, text, cells, len(row)), *cells

    def _spoilt(self) -> Iterator[int]:
        """Yield the points whose rows differ from their checksums, or that do not belong to the sweep."""
        for point, state, reason, kept, *numbers in self.rows(*database.FIXED, *self.about.columns):
            right = database.checksum(point, state, reason, numbers, len(self.about.names))
            if kept != right or not 0 <= point < self.about.count:
                yield point

    def _gaps(self, end: int) -> Iterator[tuple[int, int]]:
        """Yield the ranges of points before an end that are not stored."""
        first = 0
        for point, *_ in itertools.chain(self.rows("point"), [(end,)]):
            for start in range(first, point, _MOST_AGAIN):
                yield start, min(start + _MOST_AGAIN, point)
            first = point + 1

    def _next(self) -> int:
        return int(self.run("SELECT value FROM meta WHERE key = 'next'")[0][0])

    def _left_behind(self, now: float) -> tuple[int, int] | None:
        """Return the range of a dead run, if there is one among those that renewed their leases longest ago."""
        oldest = self.run("SELECT first, last, owner, expires FROM claims ORDER BY expires LIMIT ?", _LOOKED_AT)
        left = ((first, last) for first, last, owner, expires in oldest if _dead(owner, expires, now))
        return next(left, None)

    def _check_question(self, question: dict[str, str]) -> None:
        """Raise InputError if the store belongs to another question."""
        there = self.about.question
        differences = [
            f"{key}: {there.get(key, 'absent')} there, {question.get(key, 'absent')} here"
            for key in dict.fromkeys((*question, *there))
            if there.get(key) != question.get(key)
        ]
        if differences:
            more = f"; and {len(differences) - 4} more" if len(differences) > 4 else ""
            raise InputError(
                f"the store '{self.path}' belongs to another question ({'; '.join(differences[:4])}{more}): name"
                " another store, or repeat the same sweep"
            )


def _dead(owner: str, expires: float, now: float) -> bool:
    """Return whether a claim's run is dead: it has ended on this machine, or its lease has."""
    node, _, rest = owner.partition(":")
    if expires < now:
        return True
    if os.name != "posix" or node != platform.node():
        return False
    try:
        os.kill(int(rest.partition(":")[0]), 0)
    except (ValueError, OverflowError):  # a run never writes such an owner
        return True
    except OSError as error:  # a process of another user gives another error
        return isinstance(error, ProcessLookupError)
    return False
