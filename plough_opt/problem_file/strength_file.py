"""Records of soil strength from a CSV file: cone index along a path, or a force with the rig that felt it."""

from pathlib import Path
from typing import Any

from plough_opt.core.checks import path_of
from plough_opt.core.csv_rows import check_rising, columns_of, readings_of, table_of
from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit
from plough_opt.problem_file.schema import RANDOM
from plough_opt.problem_file.source import Source
from plough_opt.soil.random_strength import Spectrum
from plough_opt.soil.rig import Rig
from plough_opt.soil.strength_record import StrengthRecord, strength_spectrum

_UNITS = {"position": Unit("m"), "time": Unit("s"), "cone_index": Unit("Pa"), "force": Unit("N")}
_EXAMPLE = "'position [m], cone_index [kPa]', or 'time [s], force [kN]'"


def read_strength_record(path: str | Path, rig: Rig | None = None, *, tow_speed: float | None = None) -> StrengthRecord:
    """Read a record of soil strength from a CSV file.

    The first line that is neither empty nor begins with ``#`` names two columns with their units: ``position`` or
    ``time``, and ``cone_index`` or ``force``.

    Args:
        path: the file.
        rig: the mount on which a force was felt, without which the soil's strength does not follow from a force.
        tow_speed: of a penetrometer or load cell whose readings are over time [m/s]; default: the rig's.

    Raises:
        InputError: no such file, a column or cell that cannot be, each with its line, a force without a rig, or times
            without a speed.

    Example:
        >>> import plough_opt as po
        >>> len(po.read_strength_record("problems/transect.csv").position) > 100
        True
    """
    path = path_of("the file of readings", path)
    place, headings, rows = readings_of(path, _EXAMPLE)
    columns = columns_of(place, headings, _UNITS)
    names = [name for name, _ in columns]
    along = [name for name in names if name in ("position", "time")]
    if len(names) != 2 or len(along) != 1:
        raise InputError(f"{place}: a place and a strength are needed, as {_EXAMPLE}")
    table = table_of(path, rows, columns, lambda _k, _value, _cell: None)
    check_rising(path, [line for line, _ in rows], table[:, names.index(along[0])], along[0])
    found = dict(zip(names, table.T, strict=True))
    if "force" in found and rig is None:
        raise InputError(
            f"{path}: a force is the response of the mount that felt it: give the rig's mass, stiffness, damping and"
            " tow speed, by which its own oscillation is divided out"
        )
    if "cone_index" in found:
        rig = None
    speed = tow_speed if tow_speed is not None else rig.tow_speed if rig is not None else None
    if "time" in found and speed is None:
        raise InputError(f"{path}: readings over time need the tow speed, for waves are lengths along the path")
    position = found["position"] if "position" in found else found["time"] * (speed or 1.0)
    return StrengthRecord(position, found["force" if "force" in found else "cone_index"], rig, str(path))


def spectrum_of_file(source: Source, folder: Path) -> Spectrum | None:
    """Return the spectrum of the record that a problem file's random strength names, if it names one."""
    place = tuple(RANDOM.split("."))
    entry: Any = source.data.get(place[0])
    entry = entry.get(place[1]) if isinstance(entry, dict) else None
    if not isinstance(entry, dict) or not isinstance(entry.get("record"), str):
        return None
    with source.noting((*place, "record")):
        record = read_strength_record(folder / entry["record"])
        source.read_files[entry["record"]] = (folder / entry["record"]).read_text(encoding="utf-8")
        with source.noting((*place, "base_diameter"), prefix="'base_diameter' "):
            diameter = Unit("m").parse(entry.get("base_diameter", "0 m"))
            return strength_spectrum(record, base_diameter=diameter)
    return None
