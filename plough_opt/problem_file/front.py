"""The [trade_off] table: two or three measures, each minimised or maximised, and a number of points."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import is_count
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.vocabulary import Measure
from plough_opt.problem_file.source import Source

TABLE = "trade_off"
EXAMPLE = "[trade_off] with two or three results, such as mean_draft = {} and loosened_radius = { maximise = true }"
POINTS, FEWEST, MOST = 40, 5, 1000


@dataclass(frozen=True)
class FrontTable:
    """The trade-off that a file describes.

    Attributes:
        maximise: name of each of the measures -> whether more of it is better.
        points: number of positions on the front.
    """

    maximise: Mapping[str, bool]
    points: int = POINTS


def front_of(table: Mapping[str, Any]) -> FrontTable:
    """Return a checked table."""
    goals = {name: entry.get("maximise", False) for name, entry in table.items() if name != "points"}
    return FrontTable(goals, table.get("points", POINTS))


def check_front(source: Source, table: Mapping[str, Any], law: ResistanceLaw, known: Mapping[str, Measure]) -> None:
    """Note everything that is wrong in the table."""
    for name, entry in table.items():
        with source.noting((TABLE, name)):
            _check_entry(source, name, entry, law, known)
    count = sum(name != "points" for name in table)
    if count not in (2, 3) and all(name in {*known, "points"} for name in table):
        with source.noting((TABLE,)):
            how = {0: "of nothing", 1: "of one alone"}.get(count, f"of {count} results")
            more = ": put the others into [require]" if count > 3 else f": give {EXAMPLE}"
            raise InputError(f"a front is drawn of two or three results, not {how}{more}")


def _check_entry(source: Source, name: str, entry: Any, law: ResistanceLaw, known: Mapping[str, Measure]) -> None:
    if name == "points":
        if isinstance(entry, bool) or not is_count(entry) or not FEWEST <= entry <= MOST:
            raise InputError(f"'trade_off.points' = {entry!r} must be a whole number from {FEWEST} to {MOST}")
        return
    allowed = [measure for measure, own in known.items() if not own.everywhere]
    if name not in allowed:
        raise InputError(f"'{name}' cannot be traded: {nearest(name, [*allowed, 'points'])}")
    known[name].check(name, law)
    if not isinstance(entry, dict):
        raise InputError(f"'trade_off.{name}' must be {{}} or {{ maximise = true }}, not {entry!r}")
    for key, value in entry.items():
        if key != "maximise":
            raise source.error((TABLE, name, key), f"'trade_off.{name}.{key}' is not a known key:"
                               f" {nearest(key, ['maximise'])}")  # fmt: skip
        if not isinstance(value, bool):
            raise source.error((TABLE, name, key), f"'trade_off.{name}.maximise' = {value!r} must be true or false")
