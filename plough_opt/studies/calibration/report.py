"""A fit as tables: the unknowns, the undetermined combinations, and the next measurements."""

from __future__ import annotations

import math
from typing import Final

from plough_opt.core.tables import Grid, Page, Part
from plough_opt.studies.calibration.fitted import Fitted
from plough_opt.studies.calibration.parts import FittedUnknown

# Correlations above this are worth a line.
_CORRELATED: Final = 0.5
_MOST_CANDIDATES: Final = 6


def fit_page(fit: Fitted) -> Page:
    """Return the unknowns, the undetermined combinations, the next measurements, and the scatter about the fit.

    Intervals and the ranking of further measurements take time, and are shown only if they are already computed.
    """
    parts: list[Part] = [_unknowns(fit)]
    correlated = [c for c in fit.correlations_found if abs(c.value) >= _CORRELATED]
    for c in sorted(correlated, key=lambda c: -abs(c.value)):
        parts.append(f"Errors of {c.first} and {c.second} are correlated: {c.value:+.3f}.")
    parts += [f"Not determined: {item.words}." for item in fit.unidentifiable]
    if fit.known_ranking():
        parts.append(_next(fit))
    kind = "times the stated sigma" if fit.stated else "of the mean measured value"
    parts.append(f"Scatter about the fit: {fit.scatter:.3g} {kind}, {fit.freedom} degrees of freedom.")
    footer = f"Converged: no step lowers the loss (IPOPT: {fit.status}); {fit.seconds:.2f} s"
    files = ", ".join(dict.fromkeys(row.place.partition(",")[0] for row in fit.rows))
    heading = f"{len(fit.unknowns)} unknowns from {len(fit.rows)} rows of {files}"
    return Page(heading, tuple(parts), fit.warnings, footer, fit.title)


def _unknowns(fit: Fitted) -> Grid:
    level, intervals = fit.known_intervals()
    between = [f"{100 * level:g} % interval"] if intervals else []
    table = Grid.of("Calibrated", "unknown", "value", "standard error", *between, "bounds", "", left=("",))
    for unknown in fit.unknowns:
        value, error, ends, notes = "not determined", "infinite", "infinite", []
        if unknown.determined:
            value, error = _text(fit, unknown, unknown.value), _text(fit, unknown, unknown.standard_error, 3)
        if interval := intervals.get(unknown.name):
            if unknown.determined:
                ends = f"{_text(fit, unknown, interval.lower, 4)} to {_text(fit, unknown, interval.upper, 4)}"
            notes = [f"{side} end is the bound" for side in interval.clipped]
            notes += ["linearised"] if unknown.determined and interval.kind == "linearised" else []
        bounds = f"{_text(fit, unknown, unknown.lower, 3)} to {_text(fit, unknown, unknown.upper, 3)}"
        table.row(unknown.name, value, error, *([ends] if between else []), bounds, "; ".join(notes))
    return table


def _next(fit: Fitted) -> Grid:
    """Return the best candidates, with the standard errors that they would leave."""
    names = [unknown.name.rpartition(".")[2] for unknown in fit.unknowns]
    title = "What to measure next: standard errors now, and with one more measurement of the same quality"
    table = Grid.of(title, "measurement", *names, fold=("measurement",))
    ranking = fit.known_ranking()
    table.row("now", *(_text(fit, unknown, ranking[0].errors[unknown.name][0], 3) for unknown in fit.unknowns))
    for item in ranking[:_MOST_CANDIDATES]:
        cells = [_text(fit, unknown, item.errors[unknown.name][1], 3) for unknown in fit.unknowns]
        table.row(item.candidate.describe(), *cells)
    return table


def _text(fit: Fitted, unknown: FittedUnknown, value: float, digits: int = 5) -> str:
    """Return an SI value in the one unit in which its unknown is shown."""
    if math.isinf(value):
        return "infinite"
    return fit.origin.display(unknown.name, unknown.unit, unknown.value, unknown.upper).text(value, digits)
