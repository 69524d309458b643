"""`plough-opt calibrate` and `waves`: unknown quantities, and strength waves, estimated from measurements."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plough_opt.app.main import RECORDED_SHARE, RIG, given_quantities
from plough_opt.app.terminal import LOG, check_outputs, give, progress, read
from plough_opt.core.errors import InputError, NotConverged, about, nearest
from plough_opt.core.plain_data import json_text
from plough_opt.core.quantities import quantities, wave_table
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import customary
from plough_opt.problem_file import Problem
from plough_opt.problem_file.source import with_unit

if TYPE_CHECKING:
    from plough_opt.soil.record_waves import RecordWaves
    from plough_opt.soil.strength import Rig
    from plough_opt.studies.calibration import Fit, Measurements
    from plough_opt.studies.calibration.fit import HeldOut


def calibrate(options: argparse.Namespace) -> None:
    """Estimate a file's unknowns from measurements, and report which of them the data determine."""
    problem = read(options)
    from plough_opt.studies.calibration import calibrate as run
    from plough_opt.studies.calibration import read_measurements
    from plough_opt.studies.calibration.quality import check_level

    check_level(options.level)
    if options.hold_out_by is not None and options.hold_out is None:
        raise InputError("--hold-out-by belongs to --hold-out: add a part of the rows, such as --hold-out 1/3")
    files: dict[Path, Measurements] = {}  # so that a file given twice is the same object, which `run` refuses
    data = [files.setdefault(Path(path).resolve(), read_measurements(path)) for path in options.data]
    unknown = _unknowns(options.unknown)
    if unknown is None and not problem.variables:
        raise InputError(f'{problem.name}: add a table [variables], or --unknown soil.cohesion="1..80 kPa"')
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
        held = _held_out(fit, options) if options.hold_out is not None else None
        text = fit.to_json() if options.json or options.output is not None else ""
        if held is not None and text:
            text = json_text(json.loads(text) | {"held_out": held.plain()})
        quality = "" if options.json else _quality(fit, options.folds)
        page = fit.page()
    more = (quality, held.words() if held is not None else "")
    page = replace(page, parts=(*page.parts, *(sentence for sentence in more if sentence)))
    give(options, page, lambda: text, fit.plot if held is None else held.plot, fit.to_dataframe)


def _held_out(fit: Fit, options: argparse.Namespace) -> HeldOut:
    """Return the predictions of the part of the rows that the options hold out."""
    written = options.hold_out.strip()
    try:
        part = float(Fraction(written.removesuffix("%").strip())) / (100.0 if written.endswith("%") else 1.0)
    except (ValueError, ZeroDivisionError):
        raise InputError(f"--hold-out {written}: expected a part of the rows, like 1/3, 0.3 or 30 %") from None
    return fit.hold_out(part, by=options.hold_out_by, seed=options.seed, level=options.level)


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
    with about(f"--known {text}: '{key}'"):
        value, sigma = map(unit.parse, written)
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


def waves(options: argparse.Namespace) -> None:
    """Find the waves in a record, and print them as entries of a problem file."""
    from plough_opt.problem_file.field_data import read_strength_record
    from plough_opt.soil.record_waves import strength_waves

    check_outputs(options)
    rig = given_quantities(options, RIG)
    record = read_strength_record(options.file, _rig(rig), tow_speed=rig.get("tow_speed"))
    found = strength_waves(record, options.part, **given_quantities(options, RECORDED_SHARE))
    give(options, _page(found), lambda: json_text(_plain(found)), found.plot, lambda: _frame(found))


def _frame(found: RecordWaves) -> Any:
    """Return a data frame with a row for each wave, in SI units."""
    names = {"amplitude": "", "wavelength": "m", "phase": "rad"}
    columns = {name: [float(getattr(one.wave, name)) for one in found.found] for name in names}
    return data_frame({**columns, "part": [one.part for one in found.found]}, names)


def _rig(given: dict[str, float]) -> Rig | None:
    """Return the rig that the options describe, or None."""
    from plough_opt.soil.strength import Rig

    if not {"mass", "stiffness", "damping"} & {*given}:
        return None
    if missing := [f"--{name}" for name in RIG if name != "damping" and name.replace("-", "_") not in given]:
        raise InputError(f"a rig also needs {', '.join(missing)}: add these options (--damping is 0 by default)")
    return Rig(given["mass"], given["stiffness"], given.get("damping", 0.0), given["tow_speed"])


def _page(found: RecordWaves) -> Page:
    """Return the waves as a table and as entries of a problem file."""
    table = Grid.of("Strength waves, with 95 % intervals", "amplitude", "wavelength", "phase", "part of the variance")
    entries = []
    for number, one in enumerate(found.found, start=1):
        amplitude, wavelength, phase = one.wave.amplitude, one.wave.wavelength, math.degrees(float(one.wave.phase))
        table.row(
            f"{amplitude:.3g} ± {one.amplitude:.1g}",
            f"{wavelength:.4g} ± {one.wavelength:.1g} m",
            f"{phase:.0f} ± {math.degrees(one.phase):.1g} deg",
            f"{100.0 * one.part:.0f} %",
        )
        name = wave_table(number).removeprefix("effects.")
        written = f'amplitude = {amplitude:.4g}, wavelength = "{wavelength:.5g} m", phase = "{phase:.4g} deg"'
        entries.append(f"{name} = {{ {written} }}")
    spread = (
        f"The strength has a standard deviation of {100.0 * math.sqrt(found.variance):.3g} % of its trend; the waves"
        f" omit {100.0 * found.left_out:.0f} % of the variance."
    )
    footer = "\n".join(["\n[effects]", *entries]) if entries else ""
    return Page("", parts=(table, spread), notes=found.notes, footer=footer)


def _plain(found: RecordWaves) -> dict[str, object]:
    """Return the waves and the spectrum as plain values for JSON, in SI units."""
    names, columns = ("amplitude", "wavelength", "phase"), ("wave_number", "density", "lower", "upper")
    waves = [{name: [getattr(one.wave, name), getattr(one, name)] for name in names} for one in found.found]
    return {
        "waves": [own | {"part": one.part} for own, one in zip(waves, found.found, strict=True)],
        **{name: getattr(found, name) for name in ("variance", "left_out", "notes")},
        "spectrum": {name: getattr(found.spectrum, name).tolist() for name in columns},
    }
