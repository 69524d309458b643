"""What a sweep found."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.core.kinds import path_of, shown
from plough_opt.studies.sweep import tables
from plough_opt.studies.sweep.layout import State
from plough_opt.studies.sweep.store import Store


@dataclass(frozen=True)
class Failure:
    """A point without results.

    Attributes:
        point: its number.
        values: of the quantities there, SI.
        reason: why.
    """

    point: int
    values: dict[str, float]
    reason: str


@dataclass(frozen=True)
class Extreme:
    """A least or largest result.

    Attributes:
        value: of the result.
        point: number of the first point that has it.
        values: of the quantities there, SI.
    """

    value: float
    point: int
    values: dict[str, float]


class Sweep:
    """The points of a sweep with their results, read from the store when they are asked for.

    Attributes:
        already: how many points were stored before this run began.
    """

    def __init__(self, store: Store, already: int = 0) -> None:
        self._store = store
        self.already = already
        weakref.finalize(self, store.close)

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Read a store, finished or not.

        Raises:
            InputError: no such file, or no store of this layout.
        """
        path = path_of("the store", path)
        if not path.is_file():
            raise InputError(f"there is no store {shown(str(path), 200)}")
        store = Store(path, write=False)
        try:
            store.verify()
            return cls(store, store.stored()[0])
        except BaseException:
            store.close()
            raise

    def close(self) -> None:
        """Close the store; without a file of its own its results are gone."""
        self._store.close()

    def __enter__(self) -> Sweep:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._store.stored()[0]

    @property
    def path(self) -> Path | None:
        """File of the store."""
        return self._store.path

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that were swept."""
        return self._store.names

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results."""
        return self._store.results

    @property
    def units(self) -> dict[str, str]:
        """Name -> SI unit, of quantities and results that have one."""
        return self._store.units

    @property
    def question(self) -> dict[str, str]:
        """Everything that the results depend on, as text."""
        return self._store.question

    @property
    def complete(self) -> bool:
        """Whether every point is stored."""
        return len(self) == self._store.count

    @property
    def failed(self) -> int:
        """Number of points that failed: without results, for a reason of their own."""
        return self._store.stored()[1]

    @property
    def table(self) -> NDArray[np.void]:
        """A structured array: ``point``, quantities and results, SI; NaN where a point has none."""
        kind = np.dtype([("point", "i8"), *((name, "f8") for name in self._store.columns)])
        # As floats NumPy reads None as NaN.
        return np.fromiter(self._store.rows("point", *self._store.columns), dtype=kind)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a quantity or a result at every point, NaN where it has none."""
        if name not in self._store.columns:
            raise InputError(f"'{name}' is no column: there are {', '.join(self._store.columns)}")
        return np.array([row[0] for row in self._store.rows(name)], dtype=float)

    @property
    def failures(self) -> Iterator[Failure]:
        """The points that failed, in their order."""
        return self._without_results("failed")

    @property
    def undetermined(self) -> Iterator[Failure]:
        """The points at which nothing is known, because every worker died that tried them, in their order."""
        return self._without_results("undetermined")

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the numbers must know, each kind once with the numbers of its first point."""
        count = len(self)
        # Points whose rows were lost or damaged have been counted twice.
        return tuple(f"at {min(points, count)} of {count} points: {text}" for _, text, _, points in self._store.notes())

    def extreme(self, name: str, *, largest: bool = False) -> Extreme | None:
        """Return the least or the largest value of a result, or None where no point has any."""
        if name not in self.results:
            raise InputError(f"'{name}' is no result: there are {', '.join(self.results)}")
        found: tuple[Any, ...] | None = self._store.extreme(name, largest)
        if found is None:
            return None
        value, point, *values = found
        return Extreme(value, point, dict(zip(self.names, values, strict=True)))

    def to_csv(self, path: str | Path) -> Path:
        """Write a table of all points; see `plough_opt.studies.sweep.tables.write_csv`."""
        return tables.write_csv(self._store, path)

    def to_npz(self, path: str | Path) -> Path:
        """Write an array for each column; see `plough_opt.studies.sweep.tables.write_npz`."""
        return tables.write_npz(self._store, path)

    def _without_results(self, state: State) -> Iterator[Failure]:
        for point, reason, *values in self._store.rows("point", "reason", *self.names, where=state):
            yield Failure(point, dict(zip(self.names, values, strict=True)), reason)
