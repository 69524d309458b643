"""docs/crosscheck.md: its tables are those of the code."""

import re
from pathlib import Path

from plough_opt.laws import LAWS
from plough_opt.laws.asabe import POINTS, TEXTURES

TEXT = (Path(__file__).parents[2] / "docs" / "crosscheck.md").read_text(encoding="utf-8")


def test_the_table_of_laws_matches_the_laws():
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (.*?) *\|(.*?)\|(.*?)\|(.*?)\|$", TEXT, flags=re.MULTILINE)
    assert [name for name, *_ in rows] == list(LAWS)
    for name, kind, *cells in rows:
        law = LAWS[name]()
        assert type(law).__name__ == kind
        for cell, what in zip(cells, ("motion", "added_mass", "loosened_radius", "entry"), strict=True):
            assert (cell.strip() == "yes") != law.lacks(what), (name, what)


def test_the_rows_of_the_standard_match_the_code():
    rows = re.findall(r"^\| (narrow|winged) point.* \| (\S+) \| (\S+) \| (\S+) \| (.+) \|$", TEXT, flags=re.MULTILINE)
    assert {name: tuple(map(float, found[:3])) for name, *found in rows} == POINTS
    for *_, factors in rows:
        assert tuple(map(float, factors.split(", "))) == tuple(TEXTURES.values())
