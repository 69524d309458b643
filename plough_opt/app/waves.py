"""`plough-opt waves`: the strength waves in a record along a field."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING

from plough_opt.app.options import QuantityOption, add_option, add_quantities, add_shared, given_quantities
from plough_opt.app.terminal import check_outputs, give, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import wave_table
from plough_opt.core.tables import Grid, Page

if TYPE_CHECKING:
    from plough_opt.soil.record_waves import RecordWaves
    from plough_opt.soil.strength_record import Rig

_RIG = {
    "mass": QuantityOption("kg", "20 kg", "moving mass of the rig that measured the force"),
    "stiffness": QuantityOption("N/m", "50 kN/m", "stiffness of the rig's spring"),
    "damping": QuantityOption("N*s/m", "400 N*s/m", "damping of the rig (default: 0)"),
    "tow-speed": QuantityOption("m/s", "5 km/h", "speed along the path, for a rig or readings over time"),
}
_SHARE = {
    "base-diameter": QuantityOption("m", "0.136 m", "base diameter of the share, over which strength is averaged"),
}


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of a record's waves."""
    record = "record: position [m] or time [s], and cone_index [kPa] or force [kN]"
    verb.add_argument("file", metavar="FILE.csv", help=record)
    add_option(verb, "part", "P", "fraction of the variance to represent (default: 0.8)", type=float, default=0.8)
    add_quantities(verb, _SHARE | _RIG)
    add_shared(verb, "json", "plot")


def waves(options: argparse.Namespace) -> None:
    """Find the waves in a record, and print them as entries of a problem file."""
    from plough_opt.problem_file.field_data import read_strength_record
    from plough_opt.soil.record_waves import strength_waves

    check_outputs(options)
    rig = given_quantities(options, _RIG)
    record = read_strength_record(options.file, _rig(rig), tow_speed=rig.get("tow_speed"))
    found = strength_waves(record, options.part, **given_quantities(options, _SHARE))
    give(options, _page(found), lambda: json.dumps(_plain(found), indent=2, allow_nan=False))
    if options.plot is not None:
        wrote(found.plot(options.plot))


def _rig(given: dict[str, float]) -> Rig | None:
    """Return the rig that the options describe, or None."""
    from plough_opt.soil.strength_record import Rig

    if not {"mass", "stiffness", "damping"} & {*given}:
        return None
    if missing := [f"--{name}" for name in _RIG if name != "damping" and name.replace("-", "_") not in given]:
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
    return {
        "waves": [
            {name: [getattr(one.wave, name), getattr(one, name)] for name in ("amplitude", "wavelength", "phase")}
            | {"part": one.part}
            for one in found.found
        ],
        "variance": found.variance,
        "left_out": found.left_out,
        "notes": list(found.notes),
        "spectrum": {
            name: getattr(found.spectrum, name).tolist() for name in ("wave_number", "density", "lower", "upper")
        },
    }
