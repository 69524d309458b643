"""Texts of problem files that tests change, and the folder of the shipped ones."""

from pathlib import Path

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
SUBSOILER, REFERENCE = PROBLEMS / "cotton_subsoiler.toml", PROBLEMS / "reference.toml"
COTTON = SUBSOILER.read_text(encoding="utf-8")
# One variable and no motion: quick to solve.
STATIC = """\
title = "Quasi-static"
[soil]
name = "serozem"
[share]
chisel_angle = "15 deg"
wedge_angle = "35 deg"
[scene]
tow_speed = "7.2 km/h"
frame_mass = "20 kg"
stiffness = "60 kN/m"
duration = "0.5 s"
[effects]
motion = false
[variables]
"share.height" = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }
[minimise]
mean_draft = { per = "1 kN" }
[require]
loosened_radius = { at_least = "0.12 m" }
"""


def changed(*places, text=COTTON):
    """Return a text with some places of it, pairs of old and new, changed."""
    for old, new in places:
        assert text.count(old) == 1, f"{old!r} must stand in the file once"
        text = text.replace(old, new)
    return text
