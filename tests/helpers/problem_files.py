"""Texts of problem files that tests change, and the folder of the shipped ones."""

import tomllib
from pathlib import Path

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
SUBSOILER, REFERENCE = PROBLEMS / "cotton_subsoiler.toml", PROBLEMS / "reference.toml"
COTTON = SUBSOILER.read_text(encoding="utf-8")
# One variable and no motion: quick to solve.
STATIC = Path(__file__).with_name("static.toml").read_text(encoding="utf-8")


def refused_files():
    """Return the tables of what is refused in problem files: name -> rows."""
    return tomllib.loads(Path(__file__).parents[1].joinpath("problem_file", "refused.toml").read_text(encoding="utf-8"))


def changed(*places, text=COTTON):
    """Return a text with some places of it, pairs of old and new, changed."""
    for old, new in places:
        assert text.count(old) == 1, f"{old!r} must stand in the file once"
        text = text.replace(old, new)
    return text
