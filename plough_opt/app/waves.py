"""`plough-opt waves`: the strength waves that a record along a field holds."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING

from rich.table import Table

from plough_opt.app.terminal import check_outputs, console, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import wave_table
from plough_opt.core.units import Unit

if TYPE_CHECKING:
    from plough_opt.soil.record_waves import RecordWaves
    from plough_opt.soil.rig import Rig

_RIG = {
    "mass": ("kg", "20 kg", "mass on the rig that felt the force"),
    "stiffness": ("N/m", "50 kN/m", "stiffness of the rig's spring"),
    "damping": ("N*s/m", "400 N*s/m", "damping of the rig"),
    "tow-speed": ("m/s", "5 km/h", "speed along the path, of a rig or of readings over time"),
}


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of a record's waves."""
    verb.add_argument(
        "file", metavar="FILE.csv", help="record: position [m] or time [s], and cone_index [kPa] or force [kN]"
    )
    verb.add_argument("--part", type=float, default=0.8, metavar="P", help="of the variance to carry (default: 0.8)")
    verb.add_argument("--base-diameter", metavar='"0.136 m"', help="of the share, which averages shorter waves")
    for name, (_, example, text) in _RIG.items():
        verb.add_argument(f"--{name}", metavar=f'"{example}"', help=text)
    verb.add_argument("--json", action="store_true", help="print JSON (SI units) instead of a table")
    verb.add_argument("--plot", metavar="FILE", help="write a picture: .png, .svg or .pdf")


def waves(options: argparse.Namespace) -> None:
    """Find the waves of a record, and print them as a problem file takes them."""
    from plough_opt.problem_file.readings import read_strength_record
    from plough_opt.soil.strength_record import strength_waves

    check_outputs(options)
    numbers = {name: _number(options, name, unit) for name, (unit, _, _) in _RIG.items()}
    record = read_strength_record(options.file, _rig(numbers), tow_speed=numbers["tow-speed"])
    diameter = _number(options, "base-diameter", "m")
    found = strength_waves(record, options.part, base_diameter=diameter or 0.0)
    if options.json:
        print(json.dumps(_plain(found), indent=2, allow_nan=False))
    else:
        _print(found)
    if options.plot is not None:
        wrote(found.plot(options.plot))


def _number(options: argparse.Namespace, name: str, unit: str) -> float | None:
    """Return an option's quantity in SI, or None."""
    text = getattr(options, name.replace("-", "_"))
    if text is None:
        return None
    try:
        return Unit(unit).parse(text)
    except InputError as error:
        raise InputError(f"--{name} {error}") from None


def _rig(numbers: dict[str, float | None]) -> Rig | None:
    """Return the rig that the options describe, if they do."""
    from plough_opt.soil.rig import Rig

    mass, stiffness, damping, speed = (numbers[name] for name in _RIG)
    if mass is None and stiffness is None and damping is None:
        return None
    if mass is None or stiffness is None or speed is None:
        missing = ", ".join(f"--{name}" for name in ("mass", "stiffness", "tow-speed") if numbers[name] is None)
        raise InputError(f"a rig needs {missing} too; without --damping it has none")
    return Rig(mass, stiffness, damping or 0.0, speed)


def _print(found: RecordWaves) -> None:
    table = Table(title="Strength waves, with 95 % intervals")
    for heading in ("amplitude", "wavelength", "phase", "of the variance"):
        table.add_column(heading, justify="right")
    for one in found.found:
        table.add_row(
            f"{one.wave.amplitude:.3g} ± {one.amplitude:.1g}",
            f"{one.wave.wavelength:.4g} ± {one.wavelength:.1g} m",
            f"{math.degrees(float(one.wave.phase)):.0f} ± {math.degrees(one.phase):.1g} deg",
            f"{100.0 * one.part:.0f} %",
        )
    console().print(table)
    out = console()
    out.print(
        f"Strength varies by {100.0 * math.sqrt(found.variance):.3g} % of its trend (standard deviation); the waves"
        f" leave out {100.0 * found.left_out:.0f} % of the variance.",
        soft_wrap=True,
    )
    for note in found.notes:
        out.print(f"Note: {note}.", soft_wrap=True)
    if found.found:
        out.print("\n\\[effects]", soft_wrap=True)
    for number, one in enumerate(found.found, start=1):
        name = wave_table(number).removeprefix("effects.")
        out.print(
            f"{name} = {{ amplitude = {one.wave.amplitude:.4g}, wavelength = \"{one.wave.wavelength:.5g} m\","
            f' phase = "{math.degrees(float(one.wave.phase)):.4g} deg" }}',
            soft_wrap=True, markup=False,
        )  # fmt: skip


def _plain(found: RecordWaves) -> dict[str, object]:
    """Return what was found as JSON has it, in SI units."""
    return {
        "waves": [
            {
                "amplitude": [one.wave.amplitude, one.amplitude],
                "wavelength": [one.wave.wavelength, one.wavelength],
                "phase": [one.wave.phase, one.phase],
                "part": one.part,
            }
            for one in found.found
        ],
        "variance": found.variance,
        "left_out": found.left_out,
        "notes": list(found.notes),
        "spectrum": {
            name: getattr(found.spectrum, name).tolist() for name in ("wave_number", "density", "lower", "upper")
        },
    }
