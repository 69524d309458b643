"""`plough-opt calibrate`: estimation of unknown quantities from measurements."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from plough_opt.app.options import add_option, add_shared
from plough_opt.app.terminal import LOG, give, progress, read
from plough_opt.core.errors import InputError, NotConverged, nearest
from plough_opt.core.quantities import quantities
from plough_opt.core.units import customary
from plough_opt.problem_file import Problem
from plough_opt.problem_file.source import with_unit

if TYPE_CHECKING:
    from plough_opt.studies.calibration import Fit, Measurements

_LOSSES: Final = ("squares", "huber", "soft_l1", "cauchy")


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of a calibration."""
    data = "CSV file of one measured result, with names and units in its header; repeatable"
    add_option(verb, "data", "FILE.csv", data, action="append", required=True)
    unknown = (
        'quantity to estimate, with its bounds: soil.cohesion="1..80 kPa"; repeatable (default: the [variables] of the'
        " file that are not columns of the data)"
    )
    add_option(verb, "unknown", 'KEY="RANGE"', unknown, action="append", default=[])
    known = 'separate measurement of an unknown, with one standard deviation: soil.friction_angle="28 +- 1 deg"'
    add_option(verb, "known", 'KEY="VALUE"', known, action="append", default=[])
    loss = "loss function; all but squares give outliers less weight (default: squares)"
    verb.add_argument("--loss", choices=_LOSSES, default="squares", help=loss)
    errors = "errors whose sigma is not stated: constant, or proportional to the result (default: constant)"
    verb.add_argument("--errors", choices=("constant", "relative"), default="constant", help=errors)
    add_option(verb, "level", "P", "confidence level of the intervals (default: 0.95)", type=float, default=0.95)
    add_option(verb, "folds", "N", "number of folds in cross-validation (default: leave one row out)", type=int)
    add_shared(verb, "json", "output", plot="draw the residuals: .png, .svg or .pdf")


def calibrate(options: argparse.Namespace) -> None:
    """Estimate a file's unknowns from measurements, and report which of them the data determine."""
    problem = read(options)
    from plough_opt.studies.calibration import calibrate as run
    from plough_opt.studies.calibration import read_measurements
    from plough_opt.studies.calibration.estimate import check_level

    check_level(options.level)
    _check_distinct(options.data)
    data = [read_measurements(path) for path in options.data]
    unknown = _unknowns(options.unknown)
    if unknown is None and not problem.variables:
        raise InputError(
            f'{problem.name}: nothing to estimate: add a table [variables], or --unknown soil.cohesion="1..80 kPa"'
        )
    _note_guesses(problem, unknown, data)
    data += map(_known, options.known)
    with progress() as notify:
        notify("calibrating", 0.0)
        fit = run(problem, data, unknown, loss=options.loss, errors=options.errors)
        fit = replace(fit, origin=fit.origin.with_data(options.data))
        notify("intervals", 0.5)
        fit.intervals(options.level)
        notify("what to measure next", 0.8)
        fit = fit.complete(options.level)
        text = fit.to_json() if options.json or options.output is not None else ""
        quality = "" if options.json else _quality(fit, options.folds)
        page = fit.page()
    page = replace(page, parts=(*page.parts, *([quality] if quality else [])))
    give(options, page, lambda: text, fit.plot)


def _check_distinct(paths: Sequence[str]) -> None:
    """Raise InputError for a file given twice: its rows would count twice and make the intervals too narrow."""
    places = [Path(path).resolve() for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise InputError(f"--data {path} is given twice, so its rows would count twice: remove one of the two")


def _unknowns(written: list[str]) -> dict[str, tuple[str, str]] | None:
    """Return key -> (lower, upper) as the command line gives them, or None."""
    found: dict[str, tuple[str, str]] = {}
    for text in written:
        key, *bounds = _split("--unknown", text, ("..",), 'soil.cohesion="1..80 kPa"')
        if key in found:
            raise InputError(f"--unknown {text}: '{key}' is given twice: remove one")
        found[key] = bounds[0], bounds[1]
    return found or None


def _note_guesses(problem: Problem, unknown: Mapping[str, object] | None, data: Sequence[Measurements]) -> None:
    """Log which variables of the file are neither unknown nor measured, and so are fixed at their guesses."""
    columns = {key for m in data for key in m.conditions}
    left = [] if unknown is None else [key for key in problem.variables if key not in unknown and key not in columns]
    if left:
        LOG.info("note: variables of the file fixed at their guesses: %s", ", ".join(left))


def _known(text: str) -> Measurements:
    """Return a separate measurement of an unknown as measurements of one row."""
    from plough_opt.studies.calibration import Measurements

    key, *written = _split("--known", text, ("+-", "±"), 'soil.friction_angle="28 +- 1 deg"')
    unit = quantities()[key]
    try:
        value, sigma = map(unit.parse, written)
    except InputError as error:
        raise InputError(f"--known {text}: '{key}' {error}") from None
    return Measurements(key, [value], sigma=sigma, name=f"--known {key}")


def _split(option: str, text: str, marks: Sequence[str], example: str) -> tuple[str, str, str]:
    """Return a key and the two quantities around a mark; the first takes the unit of the second if it has none."""
    key, _, written = (part.strip() for part in text.partition("="))
    mark = next((mark for mark in marks if mark in written), marks[0])
    first, _, second = (part.strip() for part in written.strip("\"'").partition(mark))
    if not (first and second):
        raise InputError(f"{option} {text}: expected KEY=..., like {example}")
    if key not in quantities():
        raise InputError(f"{option} {text}: '{key}' cannot be an unknown: {nearest(key, quantities())}")
    return key, with_unit(first, second), second


def _quality(fit: Fit, folds: int | None) -> str:
    """Return a sentence on the errors in cross-validation, or on why there is none."""
    try:
        found = fit.cross_validation(folds)
    except (InputError, NotConverged) as error:
        if folds is not None and isinstance(error, InputError):
            raise
        return f"No cross-validation: {error}."
    units = {row.result: row.unit for row in fit.rows}
    errors = "; ".join(f"{name} {_text(x, units[name])} (fitted rows {_text(found.rms_fitted[name], units[name])})"
                       for name, x in found.rms.items())  # fmt: skip
    return f"RMS error of rows left out of the fit, {found.folds} folds: {errors}."


def _text(value: float, unit: str) -> str:
    return customary(unit, value).text(value, 3)
