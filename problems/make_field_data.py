"""Write insertions.csv and transect.csv: synthetic readings of a penetrometer, in eight insertions and along a path.

Nothing in them was measured; they show the way from readings to a share (problems/field.toml).

    python problems/make_field_data.py
"""

import math
from pathlib import Path

import numpy as np

PLACES = 8
SPACING, LENGTH = 0.05, 40.0
# True values of the transect: RMS and correlation length [m] of the random strength,
RMS, CORRELATION_LENGTH = 0.12, 0.35
# and amplitude and distance [m] of the wheel rows.
ROW_AMPLITUDE, ROWS = 0.08, 1.4
NOTE = "# synthetic, by make_field_data.py: nothing here was measured"


def insertions(seed: int = 7) -> str:
    """Return the text of the readings [kPa], every 2.5 cm down to 60 cm."""
    rng = np.random.default_rng(seed)
    depth = np.arange(0.0, 62.5, 2.5)
    dense = 1.0 / (1.0 + np.exp(-(depth - 22.0) / 3.0)) - 0.35 / (1.0 + np.exp(-(depth - 48.0) / 4.0))
    level = np.exp(0.16 * rng.standard_normal(PLACES))
    noise = np.exp(0.06 * rng.standard_normal((len(depth), PLACES)))
    readings = (250.0 + 1500.0 * dense)[:, None] * level * noise
    lines = [NOTE, "depth [cm], " + ", ".join(["cone_index [kPa]"] * PLACES)]
    lines += [f"{z:.1f}, " + ", ".join(f"{q:.0f}" for q in row) for z, row in zip(depth, readings, strict=True)]
    return "\n".join(lines) + "\n"


def transect(seed: int = 11) -> str:
    """Return the text of the readings [kPa] at 35 cm depth, every 5 cm along 40 m, on a slope of strength."""
    rng = np.random.default_rng(seed)
    place = np.arange(0.0, LENGTH, SPACING)
    kept = math.exp(-SPACING / CORRELATION_LENGTH)
    random = np.empty(len(place))
    random[0] = rng.standard_normal()
    for k, step in enumerate(rng.standard_normal(len(place) - 1), start=1):
        random[k] = kept * random[k - 1] + math.sqrt(1.0 - kept**2) * step
    relative = 1.0 + RMS * random + ROW_AMPLITUDE * np.sin(2.0 * math.pi * place / ROWS + 0.5)
    readings = (1500.0 + 6.0 * place) * relative
    rows = [f"{x:.2f}, {q:.0f}" for x, q in zip(place, readings, strict=True)]
    return "\n".join([NOTE, "position [m], cone_index [kPa]", *rows]) + "\n"


if __name__ == "__main__":
    for name, text in (("insertions.csv", insertions()), ("transect.csv", transect())):
        (Path(__file__).parent / name).write_text(text, encoding="utf-8")
