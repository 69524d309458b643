"""docs/uncertain_soil.md: its tables are read, its figures are those of the problem file."""

import re
import tomllib
from pathlib import Path

from plough_opt.problem_file.uncertain import measure_of, uncertain_of

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "uncertain_soil.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.DOTALL)


def test_tables_are_those_of_the_problem_file():
    given = tomllib.loads("".join(text for language, text in BLOCKS if language == "toml"))
    file = tomllib.loads((ROOT / "problems" / "uncertain_field.toml").read_text(encoding="utf-8"))
    table = dict(given["uncertain"])
    assert {key: table[key] for key in file["uncertain"]} == file["uncertain"]
    assert uncertain_of(table).fresh == 4096
    assert given["minimise"] == file["minimise"]
    assert given["require"]["loosened_radius"] == file["require"]["loosened_radius"]


def test_every_measure_of_the_table_is_known():
    for text in re.findall(r"^\| `([^`=]+)` \|", TEXT, flags=re.MULTILINE):
        if text not in ("uniform", "triangular", "beta", "normal"):
            measure_of(text)
