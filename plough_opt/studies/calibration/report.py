"""A fit as tables: what was found, what the data cannot tell, and what would."""

from __future__ import annotations

import math
from typing import Final

from plough_opt.core.tables import Grid, Page, Part
from plough_opt.studies.calibration.fitted import Fitted
from plough_opt.studies.calibration.parts import Found

# Correlations above this are worth a line.
_CORRELATED: Final = 0.5
_MOST_CANDIDATES: Final = 6


def fit_page(fit: Fitted) -> Page:
    """Return what was found, what the data cannot tell, what would, and how well the model follows the data.

    Intervals and the ranking of further measurements are shown where they are computed already: they take time.
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
    for found in fit.unknowns:
        value, error, told, notes = "not determined", "infinite", "infinite", []
        if found.determined:
            value, error = _text(fit, found, found.value), _text(fit, found, found.standard_error, 3)
        if interval := intervals.get(found.name):
            if found.determined:
                told = f"{_text(fit, found, interval.lower, 4)} to {_text(fit, found, interval.upper, 4)}"
            notes = [f"{side} end is the bound" for side in interval.clipped]
            notes += ["linearised"] if found.determined and interval.kind == "linearised" else []
        bounds = f"{_text(fit, found, found.lower, 3)} to {_text(fit, found, found.upper, 3)}"
        table.row(found.name, value, error, *([told] if between else []), bounds, "; ".join(notes))
    return table


def _next(fit: Fitted) -> Grid:
    """Return the candidates that would tell most, by the standard errors that they would leave."""
    names = [found.name.rpartition(".")[2] for found in fit.unknowns]
    title = "What to measure next: standard errors now, and with one more measurement of the same quality"
    table = Grid.of(title, "measurement", *names, fold=("measurement",))
    ranking = fit.known_ranking()
    table.row("now", *(_text(fit, found, ranking[0].errors[found.name][0], 3) for found in fit.unknowns))
    for item in ranking[:_MOST_CANDIDATES]:
        cells = [_text(fit, found, item.errors[found.name][1], 3) for found in fit.unknowns]
        table.row(item.candidate.describe(), *cells)
    return table


def _text(fit: Fitted, found: Found, value: float, digits: int = 5) -> str:
    """Return an SI value in the one unit in which its unknown is shown."""
    if math.isinf(value):
        return "infinite"
    return fit.origin.display(found.name, found.unit, found.value, found.upper).text(value, digits)
