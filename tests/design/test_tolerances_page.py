"""docs/tolerances.md: its table of variables is read."""

import re
from pathlib import Path

import plough_opt as po

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "tolerances.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.DOTALL)


def test_its_variables_are_those_of_a_file(tmp_path):
    (variables,) = (text for language, text in BLOCKS if language == "toml")
    file = (ROOT / "problems" / "cotton_subsoiler.toml").read_text(encoding="utf-8")
    start = file.index("[variables]")
    path = tmp_path / "share.toml"
    end = file.index("\n[", start)
    path.write_text(f"{file[:start]}{variables}{file[end:]}", encoding="utf-8")
    problem = po.read_problem(path, ['share.wedge_angle="39 deg"'])
    assert [v.tolerance for v in problem.variables.values()] == [0.002, "5 %"]
