"""Tables of a store as CSV and NPZ, written row by row, so that they need not fit into memory."""

import csv
import io
import itertools
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from plough_opt.core.files import write_file
from plough_opt.studies.sweep.layout import State
from plough_opt.studies.sweep.store import Store

_AT_ONCE = 16384


def write_csv(store: Store, path: str | Path) -> Path:
    """Write a row for each point: its number, quantities and results in SI units, or the reason why it has none.

    Raises:
        InputError: a place that cannot be written.
    """
    units = store.about.units

    def write(file: IO[bytes]) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        table = csv.writer(text, lineterminator="\n")
        headings = (f"{name} [{units[name]}]" if units.get(name) else name for name in store.about.columns)
        table.writerow(["point", *headings, "reason"])
        # A float's repr has all the digits that it needs, and None is empty.
        for *row, state, reason in store.rows("point", *store.about.columns, "state", "reason"):
            table.writerow([*row, f"undetermined: {reason}" if state == "undetermined" else reason])
        text.detach()  # flushes, and leaves the file open for `write_file`

    return write_file(path, "table", write)


def write_npz(store: Store, path: str | Path) -> Path:
    """Write an array for each column.

    ``failed`` has the numbers of the points that failed, ``reasons`` why they did, and ``undetermined`` the numbers of
    undetermined points.

    Raises:
        InputError: a place that cannot be written.
    """
    stored, failed, undetermined = store.stored()

    def write(file: IO[bytes]) -> None:
        with zipfile.ZipFile(file, "w", allowZip64=True) as archive:
            _write_array(archive, "point", np.dtype("<i8"), stored, (row[0] for row in store.rows("point")))
            for name in store.about.columns:
                numbers = (np.nan if row[0] is None else row[0] for row in store.rows(name))
                _write_array(archive, name, np.dtype("<f8"), stored, numbers)
            states: tuple[tuple[State, int], ...] = (("failed", failed), ("undetermined", undetermined))
            for state, count in states:
                points = (row[0] for row in store.rows("point", where=state))
                _write_array(archive, state, np.dtype("<i8"), count, points)
            longest = max((len(row[0]) for row in store.rows("reason", where="failed")), default=1)
            reasons = (row[0] for row in store.rows("reason", where="failed"))
            _write_array(archive, "reasons", np.dtype(f"<U{longest}"), failed, reasons, zipfile.ZIP_DEFLATED)

    return write_file(path, "table", write)


def _write_array(
    archive: zipfile.ZipFile,
    name: str,
    kind: np.dtype[Any],
    count: int,
    values: Iterable[Any],
    compression: int = zipfile.ZIP_STORED,
) -> None:
    """Write one array of an archive."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    entry.compress_type = compression
    with archive.open(entry, "w", force_zip64=True) as file:
        _write_header(file, kind, count)
        for part in _parts(values):
            file.write(np.array(part, dtype=kind).tobytes())


def _write_header(file: IO[bytes], kind: np.dtype[Any], count: int) -> None:
    npy.write_array_header_1_0(file, {"descr": npy.dtype_to_descr(kind), "fortran_order": False, "shape": (count,)})


def _parts(values: Iterable[Any]) -> Iterator[list[Any]]:
    rest = iter(values)
    while part := list(itertools.islice(rest, _AT_ONCE)):
        yield part
