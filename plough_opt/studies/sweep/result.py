"""`Sweep`: the result of a sweep, read from its store on demand, with tables that need not fit into memory."""

from __future__ import annotations

import itertools
import re
import weakref
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from plough_opt.core.checks import path_of, shown
from plough_opt.core.errors import InputError, counted
from plough_opt.core.files import COLOURS, CONSTANT, figure_with_panels, scale_of, write_file, written
from plough_opt.core.plain_data import Array, json_text
from plough_opt.core.process import optional
from plough_opt.core.saving import Origin
from plough_opt.core.tables import Grid, Page, Part, Readable, data_frame, write_table
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import called
from plough_opt.studies.sweep.store import RESERVED, State, Store, closed_on_error

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# States of points without results.
_LOST: Final[tuple[State, ...]] = ("failed", "undetermined")
# Failures that a printed table quotes.
_QUOTED: Final = 3
# Failures that a JSON text lists.
_LISTED: Final = 1000
# Results, and of a large sweep swept quantities, that one picture shows: with more panels none is legible.
_MOST_ROWS: Final = 6
_MOST_COLUMNS: Final = 4
# Points that are drawn one by one: more would hide each other, and take longer than all else.
_MOST_DOTS: Final = 2000
# Cells across a panel of densities.
_CELLS: Final = 40
# Rows of an array that are written at once.
_AT_ONCE: Final = 16384


@dataclass(frozen=True)
class PointWithoutResults:
    """A point without results.

    Attributes:
        point: number of the point.
        values: of the quantities there, SI.
        reason: why it has no results.
    """

    point: int
    values: dict[str, float]
    reason: str


@dataclass(frozen=True)
class Extreme:
    """The least or largest value of a result.

    Attributes:
        value: the value.
        point: number of the first point that has it.
        values: of the quantities there, SI.
    """

    value: float
    point: int
    values: dict[str, float]


class Sweep(Readable, AbstractContextManager["Sweep"]):
    """The points of a sweep with their results, read from the store on demand.

    Attributes:
        already: number of points that were stored before this run began.
        origin: the problem that was swept, if known.
        how: sentence on how the points were computed, if known.
        path: of the store; None if it is a temporary file.
        names: names of the swept quantities.
        results: names of the results.
        units: name -> SI unit, of quantities and results that have one.
        question: everything that the results depend on, as texts.

    Example:
        >>> import plough_opt as po
        >>> swept = po.Sweep.load("out/sweep.db")  # doctest: +SKIP
    """

    origin = Origin()
    how = ""

    def __init__(self, store: Store, already: int) -> None:
        self._store, self.already, self.path = store, already, store.path
        about = store.about
        self.names, self.results, self.units, self.question = about.names, about.results, about.units, about.question
        weakref.finalize(self, store.close)

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Read a store, complete or not.

        Raises:
            InputError: there is no such file, or it is damaged or not a store of this layout.

        Example:
            >>> import tempfile
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            ...     path = f"{folder}/squares.db"
            ...     po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, store=path, executor=pool).close()
            ...     with po.Sweep.load(path) as swept:
            ...         print(swept.column("y").tolist())
            [1.0, 9.0]
        """
        path = path_of("the store", path)
        if not path.is_file():
            raise InputError(f"there is no store {shown(str(path), 200)}")
        store = Store(path, write=False)
        with closed_on_error(store):
            if store.empty:
                raise InputError(f"'{path}' is empty, not the store of a sweep")
            already = store.counts().stored
        return cls(store, already)

    def close(self) -> None:
        """Close the store; the results are lost if it is a temporary file.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> largest = swept.extreme("y", largest=True).value
            >>> swept.close()
        """
        self._store.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._store.counts().stored

    @property
    def complete(self) -> bool:
        """Whether every point is stored."""
        return len(self) == self._store.about.count

    @property
    def failed(self) -> int:
        """Number of failed points: those without results for a known reason."""
        return self._store.counts().failed

    @property
    def table(self) -> NDArray[np.void]:
        """A structured array of ``point``, quantities and results, SI; results are NaN at points without any."""
        kind = np.dtype([("point", "i8"), *((name, "f8") for name in self._store.about.columns)])
        # NumPy converts None to NaN.
        return np.fromiter(self._store.rows("point", *self._store.about.columns), dtype=kind)

    def column(self, name: str) -> Array:
        """Return a quantity or a result at every point, SI; NaN at points without results.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.column("y").tolist()
            [1.0, 9.0]
        """
        if name not in self._store.about.columns:
            raise InputError(f"'{name}' is not a column: there are {', '.join(self._store.about.columns)}")
        return np.array([row[0] for row in self._store.rows(name)], dtype=float)

    @property
    def failures(self) -> Iterator[PointWithoutResults]:
        """The points that failed, in order."""
        return self._without_results("failed")

    @property
    def undetermined(self) -> Iterator[PointWithoutResults]:
        """The points without results because all their workers died, in order."""
        return self._without_results("undetermined")

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, each kind once, with the ranges of its numbers and the number of points that have it."""
        count = len(self)
        # Points that were computed again after their rows were lost were counted twice.
        return counted(((text, min(points, count)) for text, points in self._store.notes()), count, "points")

    def extreme(self, name: str, *, largest: bool = False) -> Extreme | None:
        """Return the least or the largest value of a result, or None if no point has results.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.extreme("y", largest=True).value
            9.0
        """
        if name not in self.results:
            raise InputError(f"'{name}' is not a result: there are {', '.join(self.results)}")
        row: tuple[Any, ...] | None = self._store.extreme(name, largest)
        if row is None:
            return None
        value, point, *values = row
        return Extreme(value, point, dict(zip(self.names, values, strict=True)))

    def page(self) -> Page:
        """Return the range of every result with its points, the first failures, and the warnings.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.page().heading
            '2 points, 0 failed'
        """
        stored, failed, undetermined = self._store.counts()
        also = f", {undetermined} undetermined" if undetermined else ""
        table = Grid.of("", "result", "least", "at", "largest", "at ", left=("at", "at "))
        for name, least, largest in self._ranges():
            display = self.origin.display(name, self.units.get(name, ""), least.value, largest.value)
            texts = [display.text(end.value) for end in (least, largest)]
            places = ["everywhere", ""] if texts[0] == texts[1] else [self._place(least), self._place(largest)]
            table.row(_short(name), texts[0], places[0], texts[1], places[1])
        parts: list[Part] = [table] if table.rows else []
        for state, count in zip(_LOST, (failed, undetermined), strict=True):
            for point in itertools.islice(self._without_results(state), _QUOTED):
                values = ", ".join(f"{key} = {self._text(key, value)}" for key, value in point.values.items())
                parts.append(f"{state} at {values}: {point.reason}")
            if count > _QUOTED:
                parts.append(f"... and {count - _QUOTED} more {state}: --csv writes all reasons")
        there = f"; {self.already} points were stored before" if self.already else ""
        footer = f"{self.how[:1].upper()}{self.how[1:]}; stored in {self.path}{there}" if self.how else ""
        return Page(f"{stored} points, {failed} failed{also}", tuple(parts), self.notes, footer, self.origin.title)

    def _ranges(self) -> Iterator[tuple[str, Extreme, Extreme]]:
        """Yield each result with its least and largest value, if any point has results."""
        for name in self.results:
            if (least := self.extreme(name)) and (largest := self.extreme(name, largest=True)):
                yield name, least, largest

    def _place(self, end: Extreme) -> str:
        return "\n".join(f"{_short(key)} {self._text(key, value)}" for key, value in end.values.items())

    def _text(self, name: str, value: float) -> str:
        return self.origin.display(name, self.units.get(name, ""), value).text(value)

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw every result against the swept quantities.

        With one or two swept quantities and up to 2,000 points there is a dot for each point, over the first quantity;
        the colour shows the second. Otherwise each of the first four quantities has its column, and more points than
        that are shown by their density.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the file name has an unknown ending, or the path cannot be written.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.plot().axes[0].get_ylabel()
            'y'
        """
        return written(_figure_of(self), target)

    def shown(self, name: str) -> tuple[Array, str]:
        """Return a column in its display unit, and its heading.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [0.1, 0.3]}, executor=pool, units={"x": "m"})
            >>> swept.shown("x")[1]
            'x [m]'
        """
        values = self.column(name)
        display = self.origin.display(name, self.units.get(name, ""), *values[np.isfinite(values)].tolist())
        return values / display.factor, display.heading(called(name))

    def to_json(self) -> str:
        """Return a summary as JSON text: the range of every result in SI units, and the points at its ends.

        The first thousand failed and the first thousand undetermined points are listed with their reasons.

        Example:
            >>> import json
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> json.loads(swept.to_json())["points"]
            2
        """
        ranges = {name: {"least": vars(least), "largest": vars(largest)} for name, least, largest in self._ranges()}
        lost: dict[str, Any] = {}
        for state in _LOST:
            lost[state] = [vars(point) for point in itertools.islice(self._without_results(state), _LISTED)]
        summary = {
            "schema": 1, "kind": "sweep", "title": self.origin.title, "points": len(self), "complete": self.complete,
            "units": self.units, "results": ranges, **lost, "notes": self.notes, "question": self.question,
            "store": None if self.path is None else str(self.path),
        }  # fmt: skip
        return json_text(summary)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each point: quantities and results in SI units, NaN where there are no results.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.to_dataframe()["y"].tolist()
            [1.0, 9.0]
        """
        optional("pandas")  # before all points are read
        table = self.table
        units = {name: unit for name, unit in self.units.items() if name in self._store.about.columns}
        return data_frame({name: table[name] for name in table.dtype.names or ()}, units)

    def to_csv(self, path: str | Path) -> Path:
        """Write a row for each point: its number, quantities and results in SI units, and why it has no results if so.

        Raises:
            InputError: the path cannot be written.

        Example:
            >>> import tempfile
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     lines = swept.to_csv(f"{folder}/swept.csv").read_text().splitlines()
            >>> lines[0], lines[2]
            ('point,x,y,reason', '1,3.0,9.0,')
        """
        columns = self._store.about.columns
        headings = (Display(self.units.get(name, ""), 1.0).heading(name) for name in columns)
        rows = ([*row, f"undetermined: {reason}" if state == "undetermined" else reason]
                for *row, state, reason in self._store.rows("point", *columns, "state", "reason"))  # fmt: skip
        return write_table(path, itertools.chain([["point", *headings, "reason"]], rows))

    def to_npz(self, path: str | Path) -> Path:
        """Write an array for each column, under its name; in the name ``_`` stands for a slash, a backslash or a colon.

        ``failed`` holds the numbers of the failed points, ``reasons`` the reasons, and ``undetermined`` the numbers of
        the undetermined points.

        Raises:
            InputError: the path cannot be written.

        Example:
            >>> import tempfile
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import numpy as np
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> with tempfile.TemporaryDirectory() as folder, np.load(swept.to_npz(f"{folder}/swept.npz")) as arrays:
            ...     print(arrays["y"])
            [1. 9.]
        """
        stored, failed, undetermined = self._store.counts()
        longest = max((len(failure.reason) for failure in self.failures), default=1)
        numbers = {name: (np.nan if row[0] is None else row[0] for row in self._store.rows(name))
                   for name in self._store.about.columns}  # fmt: skip

        def write(file: IO[bytes]) -> None:
            with zipfile.ZipFile(file, "w", allowZip64=True) as archive:
                _write_array(archive, "point", "<i8", stored, (row[0] for row in self._store.rows("point")))
                for member, column in zip(_members(numbers), numbers.values(), strict=True):
                    _write_array(archive, member, "<f8", stored, column)
                _write_array(archive, "failed", "<i8", failed, (lost.point for lost in self.failures))
                _write_array(archive, "undetermined", "<i8", undetermined, (lost.point for lost in self.undetermined))
                _write_array(archive, "reasons", f"<U{longest}", failed, (lost.reason for lost in self.failures))

        return write_file(path, "table", write)

    def _without_results(self, state: State) -> Iterator[PointWithoutResults]:
        for point, reason, *values in self._store.rows("point", "reason", *self.names, where=state):
            yield PointWithoutResults(point, dict(zip(self.names, values, strict=True)), reason)


def _figure_of(swept: Sweep) -> Figure:
    """Draw every result over the first swept quantity, or over each of them if there are more than two or many points.

    Points are not connected, because there may be a resonance between them.
    """
    names, keys = swept.results[:_MOST_ROWS], swept.names
    if len(swept) > _MOST_DOTS or len(keys) > 2:
        return _figure_of_many(swept, names, keys[:_MOST_COLUMNS])
    figure, panels = figure_with_panels(len(names), 2, (5.0, 3.2))
    colours: dict[str, Any] = {"color": COLOURS[0]}
    if len(keys) > 1:
        shades, shades_label = swept.shown(keys[1])
        colours = {"c": shades, "cmap": "viridis", "norm": scale_of(shades)}
    for axes, name in zip(panels, names, strict=True):
        points = _draw_points(axes, swept, keys[0], name, colours)
    if len(keys) > 1 and names:
        figure.colorbar(points, ax=panels, label=shades_label)
    return figure


def _figure_of_many(swept: Sweep, names: Sequence[str], keys: Sequence[str]) -> Figure:
    """Draw each result in a row and each swept quantity in a column; many points as their density."""
    figure, panels = figure_with_panels(len(names) * len(keys), len(keys), (3.6, 2.4))
    for axes, (name, key) in zip(panels, itertools.product(names, keys), strict=True):
        _draw_points(axes, swept, key, name, {"color": COLOURS[0]})
        axes.label_outer()
    if len(swept) > _MOST_DOTS:
        figure.suptitle("darker cells hold more points, on a logarithmic scale")
    return figure


def _draw_points(axes: Axes, swept: Sweep, key: str, name: str, colours: Mapping[str, Any]) -> Any:
    """Draw a result over a swept quantity in one panel: a dot for each point, or the density of many."""
    (places, heading), (values, label) = swept.shown(key), swept.shown(name)
    axes.set(xlabel=heading, ylabel=label)
    scale, finite = scale_of(places), np.isfinite(values)
    if len(swept) > _MOST_DOTS and finite.any():
        at = places[finite], values[finite]
        look: Any = {"bins": "log", "mincnt": 1, "cmap": "Blues", "linewidths": 0.0}
        points: Any = axes.hexbin(*at, gridsize=_CELLS, xscale=scale, **look)
    else:
        points = axes.scatter(places, values, s=14, **colours)
        axes.set_xscale(scale)
    # Show a constant result from 0, so that its rounding is not magnified.
    if finite.any() and np.max(values[finite]) > 0.0:
        largest = float(np.max(np.abs(values[finite])))
        if np.ptp(values[finite]) < CONSTANT * largest:
            axes.set_ylim(0.0, 1.2 * largest)
    return points


def _short(key: str) -> str:
    """Return a key without its table, for a narrow column."""
    return key.rpartition(".")[2]


def _members(names: Iterable[str]) -> list[str]:
    """Return names for the members of an archive, all different; none leads out of the folder where it is unpacked."""
    members: list[str] = []
    for name in names:
        plain = re.sub(r"[/\\:]", "_", name)
        while plain.casefold() in {other.casefold() for other in (*members, *RESERVED)}:
            plain += "_"
        members.append(plain)
    return members


def _write_array(archive: zipfile.ZipFile, name: str, kind: str, count: int, values: Iterator[Any]) -> None:
    """Write one array of an archive, with only a part of it in memory at once; texts are compressed."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    entry.compress_type = zipfile.ZIP_DEFLATED if kind.startswith("<U") else zipfile.ZIP_STORED
    with archive.open(entry, "w", force_zip64=True) as file:
        npy.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": (count,)})
        while part := list(itertools.islice(values, _AT_ONCE)):
            file.write(np.array(part, dtype=kind).tobytes())
