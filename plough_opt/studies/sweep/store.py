"""The store of a sweep: an SQLite file that several runs may fill at once and any may resume.

The ranges of points that a run has claimed and left, because it died, are taken over by the next that looks.
"""

from __future__ import annotations

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

# A claim that was not renewed for so long [s] is that of a dead run.
_LEASE: Final = 30.0
# Claims among which one of a dead run is looked for.
_LOOKED_AT: Final = 256
# Most points of a claim of points that are to be computed again: as many rows as a batch takes at once.
_MOST_AGAIN: Final = 2048
Note = tuple[str, str, int, int]
"""Kind, text, first point and number of points of something that a reader must know."""


class Store:
    """A store, open.

    Attributes:
        path: of the file, or None for one that is deleted when it is closed.
    """

    def __init__(self, path: str | Path | None, write: bool = True) -> None:
        """Open a file, and make it where it is to be written and is not there.

        Raises:
            InputError: a file that cannot be made or read, or that is no store; nothing in it is changed.
        """
        self._database = Database(path, write)
        self._owner = f"{platform.node()}:{os.getpid()}:{uuid.uuid4().hex}"
        self.path = self._database.path
        try:
            if self._database.tables():
                self.read()
            elif not write:
                raise InputError(f"'{self.path}' is empty, and no store of a sweep")
            if write and path is not None:
                self._database.write_ahead()
        except InputError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._database.close()

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
        with self._database.transaction():
            if not self._database.tables():
                layout.create(self._database, question, names, units, count)
        self.read()
        self._refuse_another(dict(question))

    def read(self) -> None:
        """Take over what the file says about itself.

        Raises:
            InputError: the file is no store of this layout, or damaged.
        """
        self._about = layout.read(self._database)

    def finish(self) -> None:
        """Count the points, and make the file whole: one that can be read from any medium.

        Raises:
            InputError: points are missing.
        """
        stored = self.stored()[0]
        if stored != self.count:
            raise InputError(
                f"the store '{self.path}' holds {stored} of {self.count} points, though all of them were handed to it:"
                " another program, or a trigger inside it, refuses or removes rows; sweep into another file"
            )
        if self.path is not None:
            self._database.make_whole()

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that are swept."""
        return self._about.names

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results, empty until a point has some."""
        return self._about.results

    @property
    def units(self) -> dict[str, str]:
        """Name -> unit, of quantities and results that have one."""
        return dict(self._about.units)

    @property
    def question(self) -> dict[str, str]:
        """Everything that the results depend on."""
        return dict(self._about.question)

    @property
    def count(self) -> int:
        """Number of points of the whole sweep."""
        return self._about.count

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of quantities and results."""
        return (*self.names, *self.results)

    def stored(self) -> tuple[int, int, int]:
        """Return how many points are stored, how many of them failed, and how many are undetermined."""
        found = self._run("SELECT count(*), total(state = 'failed'), total(state = 'undetermined') FROM points")[0]
        return int(found[0]), int(found[1]), int(found[2])

    def claim(self, size: int) -> tuple[int, int] | None:
        """Return a range of points that no run works on yet, first and one beyond the last, or None.

        Args:
            size: most points of a range of new ones; one that a dead run left has its own size.
        """
        now = time.time()
        with self._database.transaction():
            first = self._next()
            last = min(first + size, self.count)
            if first < self.count:
                self._run("UPDATE meta SET value = ? WHERE key = 'next'", str(last))
            else:
                # Whoever is dead renewed longest ago.
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
        """Tell other runs that this one lives."""
        with self._database.transaction():
            self._run("UPDATE claims SET expires = ? WHERE owner = ?", time.time() + _LEASE, self._owner)

    def release(self) -> None:
        """Leave what this run claimed and did not finish to others."""
        with self._database.transaction():
            self._run("UPDATE claims SET expires = 0.0 WHERE owner = ?", self._owner)

    def reopen(self, retry: bool) -> None:
        """Look at every row, and leave to be claimed what is not stored and no run works on.

        Args:
            retry: forget the points that failed, that are undetermined, or that are damaged, so that they are tried
                again.

        Raises:
            InputError: damaged rows; or another run fills the store, and may have under way what is to be tried again.
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
                for point in list(layout.spoilt_points(self._database, self._about)):
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
        spoilt = list(layout.spoilt_points(self._database, self._about))
        if spoilt:
            raise layout.damaged(
                self.path,
                f"{len(spoilt)} of its rows differ from their checksums, the first that of point {spoilt[0]}; the same"
                " sweep computes them again where it is asked to try failures again (--retry, retry=True)",
            )

    def name_results(self, results: Sequence[str]) -> None:
        """Enter the names of the results when the first point has some.

        Raises:
            InputError: names that cannot be columns, or other ones than those of the points before.
        """
        with self._database.transaction():
            known = tuple(json.loads(self._run("SELECT value FROM meta WHERE key = 'results'")[0][0]))
            if not known:
                layout.check_columns((*self.names, *results))
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
        """Store points, at once; return how many of them were new.

        Args:
            numbers: of the points.
            values: of the quantities, a row each.
            results: a row for each point, or None where all of them failed before any succeeded.
            reasons: place among these points -> why it has no results.
            notes: what a reader must know of them.
            finished: first point of the claim that they complete.
            without: what points without results are.
        """
        columns = self._all_columns()
        marks = ", ".join("?" * (len(FIXED) + len(self.columns)))
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
        """Return what a reader must know, in the order of the first points."""
        return [
            (kind, text, first, points)
            for kind, text, first, points in self._run("SELECT kind, text, first, points FROM notes ORDER BY 3, 1")
        ]

    def rows(self, *columns: str, where: State | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield columns of the points, in their order, without holding more than a few.

        Args:
            columns: "point", "reason", or names of quantities and results.
            where: only points of this state.
        """
        chosen = ", ".join(map(quoted, columns))
        condition = f"WHERE state = '{where}'" if where else ""
        return self._database.rows(f"SELECT {chosen} FROM points {condition} ORDER BY point")

    def extreme(self, name: str, largest: bool) -> tuple[Any, ...] | None:
        """Return the least or largest value of a result, its first point and the quantities there, or None."""
        chosen = ", ".join(map(quoted, (name, "point", *self.names)))
        order = f"{quoted(name)} {'DESC' if largest else 'ASC'}, point"
        found = self._run(f"SELECT {chosen} FROM points WHERE state = 'computed' ORDER BY {order} LIMIT 1")
        return found[0] if found else None

    def _rows(
        self, numbers: NDArray[np.int64], values: Array, results: Array | None, reasons: Mapping[int, str], state: State
    ) -> Iterator[tuple[object, ...]]:
        """Yield rows as they are stored."""
        empty = [None] * len(self.results)
        # SQLite stores the negative zero as zero.
        for k, (number, row) in enumerate(zip(numbers.tolist(), (values + 0.0).tolist(), strict=True)):
            reason = reasons.get(k)
            if reason is None and results is not None:
                numbers_of = [*row, *results[k].tolist()]
                own: State = "computed"
            else:
                numbers_of, own = [*row, *empty], state
            # Whatever an exception said; not every text of Python's can be stored.
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
        return ", ".join(map(quoted, (*FIXED, *self.columns)))

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
        differences = [
            f"{key}: {self.question.get(key, 'absent')} there, {question.get(key, 'absent')} here"
            for key in dict.fromkeys((*question, *self.question))
            if self.question.get(key) != question.get(key)
        ]
        if differences:
            more = f"; and {len(differences) - 4} more" if len(differences) > 4 else ""
            raise InputError(
                f"the store '{self.path}' belongs to another question ({'; '.join(differences[:4])}{more}): name"
                " another store, or ask what was asked before"
            )

    def _run(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        return self._database.run(statement, *values)


def _dead(owner: str, expires: float, now: float) -> bool:
    """Return whether a claim's run is dead: known so on the same machine, or silent for long."""
    node, _, rest = owner.partition(":")
    if expires < now:
        return True
    if os.name != "posix" or node != platform.node():
        return False
    try:
        os.kill(int(rest.partition(":")[0]), 0)
    except (ValueError, OverflowError):  # no run writes such an owner
        return True
    except OSError as error:  # a process of another user is none that is dead
        return isinstance(error, ProcessLookupError)
    return False
