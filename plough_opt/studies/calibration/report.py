"""Tables of a fit: the unknowns with their intervals, and the next measurements."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from plough_opt.core.kept import Origin
from plough_opt.core.tables import Grid
from plough_opt.studies.calibration.candidates import NextMeasurement
from plough_opt.studies.calibration.intervals import Interval
from plough_opt.studies.calibration.parts import FittedUnknown

_MOST_CANDIDATES: Final = 6


def unknowns_table(
    unknowns: Sequence[FittedUnknown], level: float, intervals: Mapping[str, Interval], origin: Origin
) -> Grid:
    """Return the values with their standard errors, and with their intervals if these are already computed."""
    between = [f"{100 * level:g} % interval"] if intervals else []
    table = Grid.of("Calibrated", "unknown", "value", "standard error", *between, "bounds", "", left=("",))
    for unknown in unknowns:
        value, error, ends, notes = "not determined", "infinite", "infinite", []
        if unknown.determined:
            value, error = _text(origin, unknown, unknown.value), _text(origin, unknown, unknown.standard_error, 3)
        if interval := intervals.get(unknown.name):
            if unknown.determined:
                ends = " to ".join(_text(origin, unknown, end, 4) for end in interval)
            notes = [f"{side} end is the bound" for side in interval.clipped]
            notes += ["linearised"] if unknown.determined and interval.kind == "linearised" else []
        bounds = " to ".join(_text(origin, unknown, end, 3) for end in (unknown.lower, unknown.upper))
        table.row(unknown.name, value, error, *([ends] if between else []), bounds, "; ".join(notes))
    return table


def next_table(unknowns: Sequence[FittedUnknown], ranking: Sequence[NextMeasurement], origin: Origin) -> Grid:
    """Return the best candidates, with the standard errors that they would leave."""
    names = [unknown.name.rpartition(".")[2] for unknown in unknowns]
    title = "What to measure next: standard errors now, and with one more measurement of the same quality"
    table = Grid.of(title, "measurement", *names, fold=("measurement",))
    table.row("now", *(_text(origin, unknown, ranking[0].errors[unknown.name][0], 3) for unknown in unknowns))
    for item in ranking[:_MOST_CANDIDATES]:
        cells = [_text(origin, unknown, item.errors[unknown.name][1], 3) for unknown in unknowns]
        table.row(item.candidate.describe(), *cells)
    return table


def _text(origin: Origin, unknown: FittedUnknown, value: float, digits: int = 5) -> str:
    """Return an SI value in the one unit in which its unknown is shown."""
    if math.isinf(value):
        return "infinite"
    return origin.display(unknown.name, unknown.unit, unknown.value, unknown.upper).text(value, digits)
