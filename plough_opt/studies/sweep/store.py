"""The store of a sweep: an SQLite file that several runs may fill at once and any may resume.

If a run dies, another takes over the ranges of points that it had claimed.
"""

import itertools
import json
import os
import platform
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.studies.sweep import layout
from plough_opt.studies.sweep.database import Database, quoted
from plough_opt.studies.sweep.layout import FIXED, State
from plough_opt.studies.sweep.work import Array

# Time [s] after which the run of a claim that was not renewed counts as dead.
_LEASE: Final = 30.0
# Number of claims among which those of dead runs are looked for.
_LOOKED_AT: Final = 256
# Limit on a claim of points that are computed again: the rows that a batch simulates at once.
_MOST_AGAIN: Final = 2048
Note = tuple[str, str, int, int]
"""Kind and text of a warning, its first point and the number of its points."""


class Store:
    """A store, open.

    Attributes:
        path: of the file, or None for one that is deleted when it is closed.
        about: quantities, results and question of the sweep.
    """

    about: layout.About

    def __init__(self, path: str | Path | None, write: bool = True) -> None:
        """Open a file; a missing one is made if it is to be written.

        Raises:
            InputError: a file that cannot be made or read, or that is not a store; nothing in it is changed.
        """
        self._database = Database(path, write)
        self._owner = f"{platform.node()}:{os.getpid()}:{uuid.uuid4().hex}"
        self.path = self._database.path
        try:
            if self._database.tables():
                self.read()
            elif not write:
                raise InputError(f"'{self.path}' is empty, and not the store of a sweep")
            if write and path is not None:
                self._database.write_ahead()
        except InputError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def prepare(self, question: Mapping[str, str], names: Sequence[str], units: Mapping[str, str], count: int) -> None:
        """Enter the sweep's question, or compare it with the one in the file.

        Args:
            question: everything that the results depend on.
            names: the quantities that are swept.
            units: name -> unit, of quantities and results that have one.
            count: number of points.

        Raises:
            InputError: the store belongs to another question; the message lists the differences.
        """
        with self._database.transaction():
            if not self._database.tables():
                layout.create(self._database, question, names, units, count)
        self.read()
        self._check_question(dict(question))

    def read(self) -> None:
        """Read `about` from the file.

        Raises:
            InputError: the file is not a store of this layout, or damaged.
        """
        self.about = layout.read(self._database)

    def finish(self) -> None:
        """Check the number of points, and merge the log into the file, so that it can be read from any medium.

        Raises:
            InputError: points are missing.
        """
        stored = self.stored()[0]
        if stored != self.about.count:
            raise InputError(
                f"the store '{self.path}' holds {stored} of {self.about.count} points, though all of them were written:"
                " another program, or a trigger inside it, rejects or removes rows; sweep into another file"
            )
        if self.path is not None:
            self._database.make_whole()

    def stored(self) -> tuple[int, int, int]:
        """Return the numbers of points that are stored, that failed, and that are undetermined."""
        counts = self._run("SELECT count(*), total(state = 'failed'), total(state = 'undetermined') FROM points")[0]
        return int(counts[0]), int(counts[1]), int(counts[2])

    def claim(self, size: int) -> tuple[int, int] | None:
        """Claim a range of points; return the first and one beyond the last, or None if none are left.

        Args:
            size: limit on a range of new points; that of a dead run is claimed as it is.
        """
        now = time.time()
        with self._database.transaction():
            first = self._next()
            last = min(first + size, self.about.count)
            if first < self.about.count:
                self._run("UPDATE meta SET value = ? WHERE key = 'next'", str(last))
            else:
                # Dead runs are those that renewed their leases longest ago.
                oldest = self._run(
                    "SELECT first, last, owner, expires FROM claims ORDER BY expires LIMIT ?", _LOOKED_AT
                )
                left = [row for row in oldest if _dead(row[2], row[3], now)]
                if not left:
                    return None
                first, last = left[0][:2]
            self._run("INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?)", first, last, self._owner, now + _LEASE)
        return first, last

    def waiting(self) -> bool:
        """Return whether another run still works on points."""
        return bool(self._run("SELECT 1 FROM claims WHERE owner != ? LIMIT 1", self._owner))

    def missing(self, first: int, last: int) -> NDArray[np.int64]:
        """Return the numbers of the points of a range that are not stored."""
        rows = self._run("SELECT point FROM points WHERE point >= ? AND point < ?", first, last)
        return np.setdiff1d(np.arange(first, last), np.array([row[0] for row in rows], dtype=np.int64))

    def renew(self) -> None:
        """Renew this run's lease on its claims."""
        with self._database.transaction():
            self._run("UPDATE claims SET expires = ? WHERE owner = ?", time.time() + _LEASE, self._owner)

    def release(self) -> None:
        """End this run's lease, so that others can claim its unfinished points."""
        with self._database.transaction():
            self._run("UPDATE claims SET expires = 0.0 WHERE owner = ?", self._owner)

    def reopen(self, retry: bool) -> None:
        """Check every row, and make points claimable that are neither stored nor under way in another run.

        Args:
            retry: delete the points that failed, are undetermined or are damaged, so that they are tried again.

        Raises:
            InputError: damaged rows; or, with retry, another run fills the store.
        """
        now = time.time()
        with self._database.transaction():
            owners = self._run("SELECT owner, max(expires) FROM claims GROUP BY owner")
            alone = all(_dead(owner, expires, now) for owner, expires in owners)
            if retry:
                if not alone:
                    raise InputError(
                        f"another run fills the store '{self.path}': wait for its end to try failures again"
                    )
                self._run("DELETE FROM points WHERE state != 'computed'")
                for point in list(layout.spoilt_points(self._database, self.about)):
                    self._run("DELETE FROM points WHERE point = ?", point)
            else:
                self.verify()
            if alone:
                self._run("DELETE FROM claims")
                gaps = self._gaps(self._next())
                self._database.run_many("INSERT INTO claims VALUES (?, ?, '', 0.0)", gaps)

    def verify(self) -> None:
        """Compare every row with its checksum.

        Raises:
            InputError: some differ.
        """
        spoilt = list(layout.spoilt_points(self._database, self.about))
        if spoilt:
            raise layout.damaged(
                self.path,
                f"{len(spoilt)} of its rows differ from their checksums, the first that of point {spoilt[0]}; the same"
                " sweep with --retry (retry=True) computes them again",
            )

    def name_results(self, results: Sequence[str]) -> None:
        """Enter the names of the results once the first point has some.

        Raises:
            InputError: names that cannot be columns, or that differ from those of earlier points.
        """
        with self._database.transaction():
            known = tuple(json.loads(self._run("SELECT value FROM meta WHERE key = 'results'")[0][0]))
            if not known:
                layout.check_columns((*self.about.names, *results))
                for name in results:
                    self._run(f"ALTER TABLE points ADD COLUMN {quoted(name)} REAL")
                self._run("UPDATE meta SET value = ? WHERE key = 'results'", json.dumps(list(results)))
                known = tuple(results)
        self.read()
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
        without: State = "failed",
    ) -> int:
        """Store points, all or none; return the number of new ones.

        Args:
            numbers: of the points.
            values: of the quantities, a row each.
            results: a row for each point, or None if all of them failed before any succeeded.
            reasons: place among these points -> why it has no results.
            notes: warnings about them.
            finished: first point of the claim that they complete.
            without: state of the points without results.
        """
        columns = self._all_columns()
        marks = ", ".join("?" * (len(FIXED) + len(self.about.columns)))
        rows = self._rows(numbers, values, results, reasons, without)
        with self._database.transaction():
            new = self._database.run_many(f"INSERT OR IGNORE INTO points ({columns}) VALUES ({marks})", rows)
            if new == len(numbers):
                for note in notes:
                    self._add_note(note)
            if finished is not None:
                self._run("DELETE FROM claims WHERE first = ? AND owner = ?", finished, self._owner)
        return new

    def notes(self) -> list[Note]:
        """Return the warnings, in the order of their first points."""
        return [
            (kind, text, first, points)
            for kind, text, first, points in self._run("SELECT kind, text, first, points FROM notes ORDER BY 3, 1")
        ]

    def rows(self, *columns: str, where: State | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield columns of the points, in order, of which only a few are in memory at once.

        Args:
            columns: "point", "reason", or names of quantities and results.
            where: only points of this state.
        """
        chosen = ", ".join(map(quoted, columns))
        condition = f"WHERE state = '{where}'" if where else ""
        return self._database.rows(f"SELECT {chosen} FROM points {condition} ORDER BY point")

    def extreme(self, name: str, largest: bool) -> tuple[Any, ...] | None:
        """Return the least or largest value of a result, its first point and the quantities there, or None."""
        chosen = ", ".join(map(quoted, (name, "point", *self.about.names)))
        order = f"{quoted(name)} {'DESC' if largest else 'ASC'}, point"
        rows = self._run(f"SELECT {chosen} FROM points WHERE state = 'computed' ORDER BY {order} LIMIT 1")
        return rows[0] if rows else None

    def _rows(
        self, numbers: NDArray[np.int64], values: Array, results: Array | None, reasons: Mapping[int, str], state: State
    ) -> Iterator[tuple[object, ...]]:
        """Yield rows as they are stored."""
        empty = [None] * len(self.about.results)
        # SQLite stores the negative zero as zero.
        for k, (number, row) in enumerate(zip(numbers.tolist(), (values + 0.0).tolist(), strict=True)):
            reason = reasons.get(k)
            if reason is None and results is not None:
                numbers_of = [*row, *results[k].tolist()]
                own: State = "computed"
            else:
                numbers_of, own = [*row, *empty], state
            # The text of any exception, which may hold surrogates that UTF-8 cannot encode.
            text = None if reason is None else reason.encode("utf-8", "backslashreplace").decode("utf-8")
            yield number, own, text, layout.checksum(number, own, text, numbers_of, len(row)), *numbers_of

    def _gaps(self, end: int) -> Iterator[tuple[int, int]]:
        """Yield the ranges of points before an end that are not stored."""
        first = 0
        for point, *_ in itertools.chain(self.rows("point"), [(end,)]):
            for start in range(first, point, _MOST_AGAIN):
                yield start, min(start + _MOST_AGAIN, point)
            first = point + 1

    def _next(self) -> int:
        return int(self._run("SELECT value FROM meta WHERE key = 'next'")[0][0])

    def _all_columns(self) -> str:
        return ", ".join(map(quoted, (*FIXED, *self.about.columns)))

    def _add_note(self, note: Note) -> None:
        """Count a note, and keep its text if its point is the first of its kind."""
        self._run(
            "INSERT INTO notes VALUES (?, ?, ?, ?) ON CONFLICT (kind) DO UPDATE SET"
            " text = CASE WHEN excluded.first < first THEN excluded.text ELSE text END,"
            " first = min(first, excluded.first), points = points + excluded.points",
            *note,
        )

    def _check_question(self, question: dict[str, str]) -> None:
        """Raise InputError if the store belongs to another question."""
        differences = [
            f"{key}: {self.about.question.get(key, 'absent')} there, {question.get(key, 'absent')} here"
            for key in dict.fromkeys((*question, *self.about.question))
            if self.about.question.get(key) != question.get(key)
        ]
        if differences:
            more = f"; and {len(differences) - 4} more" if len(differences) > 4 else ""
            raise InputError(
                f"the store '{self.path}' belongs to another question ({'; '.join(differences[:4])}{more}): name"
                " another store, or repeat the same sweep"
            )

    def _run(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        return self._database.run(statement, *values)


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
