"""Write insertions.csv, synthetic penetrometer readings: a soft topsoil over a dense layer at eight places.

Nothing in it was measured; it shows the way from readings to a share (problems/field.toml).

    python problems/make_field_data.py
"""

from pathlib import Path

import numpy as np

PLACES = 8


def insertions(seed: int = 7) -> str:
    """Return the text of the readings [kPa], every 2.5 cm down to 60 cm."""
    rng = np.random.default_rng(seed)
    depth = np.arange(0.0, 62.5, 2.5)
    dense = 1.0 / (1.0 + np.exp(-(depth - 22.0) / 3.0)) - 0.35 / (1.0 + np.exp(-(depth - 48.0) / 4.0))
    level = np.exp(0.16 * rng.standard_normal(PLACES))
    noise = np.exp(0.06 * rng.standard_normal((len(depth), PLACES)))
    readings = (250.0 + 1500.0 * dense)[:, None] * level * noise
    lines = ["# synthetic, by make_field_data.py: nothing here was measured"]
    lines.append("depth [cm], " + ", ".join(["cone_index [kPa]"] * PLACES))
    lines += [f"{z:.1f}, " + ", ".join(f"{q:.0f}" for q in row) for z, row in zip(depth, readings, strict=True)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "insertions.csv").write_text(insertions(), encoding="utf-8")
