"""`Sweep`: the points of a sweep with their results, as in its CSV file, which has a row for each."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import path_of, shown
from plough_opt.core.errors import Counted, InputError, count, counted, short
from plough_opt.core.files import COLOURS, CONSTANT, figure_with_panels, scale_of, written
from plough_opt.core.plain_data import Array, json_text
from plough_opt.core.saving import Origin
from plough_opt.core.tables import Grid, Page, Part, Readable, data_frame, write_table
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import called

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

BETWEEN: Final = " | "
"""Text between the warnings of a point."""

# Columns of texts, and the number of the point; quantities stand before "question", results after it.
_FIXED: Final = {"point": "i8", "question": "O", "warnings": "O", "reason": "O"}


@dataclass
class Sweep(Readable):
    """The points of a sweep with their results.

    Attributes:
        names: names of the swept quantities.
        results: names of the results.
        table: structured array with a row for each point: ``point``, quantities (SI), ``question`` (a digest of what
            else the results depend on), results (SI, NaN at points that failed), ``warnings`` and ``reason`` (why the
            point failed, or "").
        units: name -> SI unit, of quantities and results that have one.
        path: of the file, or None.
        origin: the problem that was swept, if known.
        how: sentence on how the points were computed, if known.

    Example:
        >>> import plough_opt as po
        >>> swept = po.Sweep.load("out/cohesion.csv")  # doctest: +SKIP
    """

    names: tuple[str, ...]
    results: tuple[str, ...]
    table: NDArray[np.void]
    units: Mapping[str, str]
    path: Path | None = None
    origin: Origin = field(default_factory=Origin)
    how: str = ""

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Read the file of a sweep, finished or not.

        Raises:
            InputError: there is no such file, or it is not that of a sweep.

        Example:
            >>> import tempfile
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            ...     path = f"{folder}/squares.csv"
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, file=path, executor=pool)
            ...     print(po.Sweep.load(path).column("y").tolist())
            [1.0, 9.0]
        """
        path = path_of("the file", path)
        try:
            with path.open(encoding="utf-8", errors="replace", newline="") as stream:
                return read_sweep(stream, path)
        except OSError as error:
            raise InputError(f"the file {shown(str(path), 200)} of a sweep cannot be read: {error.strerror}") from None

    def __len__(self) -> int:
        return len(self.table)

    @cached_property
    def failures(self) -> dict[int, str]:
        """Number of each point that failed -> the reason."""
        return {int(row["point"]): str(row["reason"]) for row in self.table[self.table["reason"] != ""]}

    @property
    def failed(self) -> int:
        """Number of points that failed."""
        return len(self.failures)

    def column(self, name: str) -> Array:
        """Return a quantity or a result at every point, SI; NaN at points that failed.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.column("y").tolist()
            [1.0, 9.0]
        """
        if name not in (columns := (*self.names, *self.results)):
            raise InputError(f"'{name}' is not a column: there are {', '.join(columns)}")
        return np.array(self.table[name])

    def extreme(self, name: str, *, largest: bool = False) -> dict[str, float] | None:
        """Return the point, quantities and results where a column is least or largest; None if every point failed.

        Example:
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> swept.extreme("y", largest=True)
            {'point': 1, 'x': 3.0, 'y': 9.0}
        """
        values = self.column(name)
        if not np.isfinite(values).any():
            return None
        row = self.table[np.nanargmax(values) if largest else np.nanargmin(values)]
        return {column: row[column].item() for column in ("point", *self.names, *self.results)}

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, each kind once, with the ranges of its numbers and the number of points that have it."""
        kinds: Counted = {}
        for texts in filter(None, self.table["warnings"]):
            count(kinds, texts.split(BETWEEN))
        return counted([(text, points) for text, _, points in kinds.values()], len(self), "points")

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
        table = Grid.of("", "result", "least", "at", "largest", "at ", left=("at", "at "))
        for name in self.results:
            ends = [end for end in (self.extreme(name), self.extreme(name, largest=True)) if end]
            if ends:
                display = self._display(name, *(end[name] for end in ends))
                least, largest = (display.text(end[name]) for end in ends)
                places = ["everywhere", ""] if least == largest else ["\n".join(self._place(end)) for end in ends]
                table.row(name.rpartition(".")[2], least, places[0], largest, places[1])
        lost = self.table[self.table["reason"] != ""]
        quoted = [f"failed at {', '.join(self._place(row))}: {row['reason']}" for row in lost[:3]]
        more = [f"... and {len(lost) - 3} more failed: the file has all reasons"] if len(lost) > 3 else []
        footer = f"{self.how}; stored in {self.path}" if self.how and self.path else self.how
        parts: tuple[Part, ...] = (*([table] if table.rows else []), *quoted, *more)
        return Page(f"{len(self)} points, {self.failed} failed", parts, self.notes, footer, self.origin.title)

    def _display(self, name: str, *values: float) -> Display:
        return self.origin.display(name, self.units.get(name, ""), *values)

    def _place(self, row: Any) -> list[str]:
        """Return the quantities of a row in words."""
        return [f"{name.rpartition('.')[2]} {self._display(name, row[name]).text(row[name])}" for name in self.names]

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw the first six results, a row each, over the first four swept quantities, a column each.

        Points are not connected, because there may be a resonance between them.

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
        if not len(self):
            raise InputError("no point is finished: there is nothing to draw")
        results, names = self.results[:6], self.names[:4]
        figure, panels = figure_with_panels(len(results) * len(names), len(names), (3.6, 2.4))
        for axes, pair in zip(panels, itertools.product(results, names), strict=True):
            columns = [self.column(name) for name in pair]
            units = [self._display(n, *x[np.isfinite(x)].tolist()) for n, x in zip(pair, columns, strict=True)]
            values, places = (x / unit.factor for x, unit in zip(columns, units, strict=True))
            axes.scatter(places, values, s=14 if len(self) < 1000 else 2, color=COLOURS[0], rasterized=len(self) > 1000)
            label, heading = (unit.heading(called(name)) for name, unit in zip(pair, units, strict=True))
            axes.set(xlabel=heading, ylabel=label, xscale=scale_of(places))
            if (largest := np.nanmax(values, initial=0.0)) and largest - np.nanmin(values) < CONSTANT * largest:
                axes.set_ylim(0.0, 1.2 * largest)  # so that the rounding of a constant is not magnified
        return written(figure, target)

    def to_json(self) -> str:
        """Return a summary as JSON text: where every result is least and largest, SI, and why points failed.

        Example:
            >>> import json
            >>> from concurrent.futures import ThreadPoolExecutor
            >>> import plough_opt as po
            >>> with ThreadPoolExecutor(1) as pool:
            ...     swept = po.sweep(lambda at: {"y": at["x"] ** 2}, {"x": [1.0, 3.0]}, executor=pool)
            >>> json.loads(swept.to_json())["points"]
            2
        """
        ends = {
            name: {"least": self.extreme(name), "largest": self.extreme(name, largest=True)} for name in self.results
        }
        head = {"schema": 1, "kind": "sweep", "title": self.origin.title, "points": len(self), "units": self.units}
        failed = {str(point): reason for point, reason in self.failures.items()}
        return json_text({**head, "results": ends, "failed": failed, "notes": self.notes})

    def to_dataframe(self) -> pandas.DataFrame:
        """Return `table` as a data frame, with the units in ``attrs["units"]``.

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
        return data_frame({name: self.table[name] for name in self.table.dtype.names or ()}, self.units)

    def to_csv(self, path: str | Path) -> Path:
        """Write `table` into a file from which `load` reads it.

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
            >>> lines[0]
            'point,x,question,y,warnings,reason'
        """
        return write_table(path, [headings(self.names, self.results, self.units), *self.table.tolist()])


def read_sweep(stream: TextIO, path: Path | None = None) -> Sweep:
    """Return the sweep in a stream; a last line without its end, which a killed run leaves, does not count.

    Raises:
        InputError: it is not a sweep.
    """
    first, *lines = [*stream] or [""]
    heads = first.rstrip("\n").split(",")
    if first.startswith("SQLite format 3"):
        raise InputError(f"'{path}' is a store of version 0.2, which this version cannot read: name a new CSV file")
    if heads[0] != "point" or heads[-2:] != ["warnings", "reason"] or "question" not in heads[2:]:
        raise InputError(f"'{path}' is not the file of a sweep: name another file")
    names, _, symbols = zip(*(head.rstrip("]").partition(" [") for head in heads), strict=True)
    middle, kind = names.index("question"), [(name, _FIXED.get(name, "f8")) for name in names]
    swept, results = names[1:middle], names[middle + 1 : -2]
    headings(swept, results, {})
    if lines and not lines[-1].endswith("\n"):
        lines.pop()
    try:
        table = np.loadtxt(lines, kind, None, ",", quotechar='"', ndmin=1) if lines else np.zeros(0, kind)
        if any(np.isinf(table[name]).any() for name in (*swept, *results)):
            raise ValueError("a number is infinite")
    except ValueError as error:
        why = f"holds what no sweep writes ({short(str(error), 120)})"
        raise InputError(f"'{path}' {why}: name another file") from None
    table = table[np.unique(table["point"], return_index=True)[1]]
    return Sweep(swept, results, table, {n: unit for n, unit in zip(names, symbols, strict=True) if unit}, path)


def headings(names: Sequence[str], results: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Return the headings of a file's columns.

    Raises:
        InputError: a name cannot be that of a column, is used twice, or is reserved; case is ignored.
    """
    folded = [str(name).casefold() for name in (*_FIXED, *names, *results)]
    for name in (*names, *results):
        if not isinstance(name, str) or not re.fullmatch(r'\w[^][,;"]*', name) or not name.isprintable():
            raise InputError(f"{shown(name)} cannot name a column: begin with a letter, and use no brackets and commas")
        if folded.count(name.casefold()) > 1:
            raise InputError(f"'{name}' cannot name a column: it is used twice, or reserved ({', '.join(_FIXED)})")
    before, after = ([Display(units.get(name, ""), 1.0).heading(name) for name in part] for part in (names, results))
    return ["point", *before, "question", *after, "warnings", "reason"]
