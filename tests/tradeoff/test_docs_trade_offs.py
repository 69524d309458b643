"""Every code block of docs/trade_offs.md runs."""

import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest

from plough_opt.app import main

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "trade_offs.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.DOTALL)
LINES = [line for language, text in BLOCKS if language == "sh" for line in text.splitlines()]


def test_there_are_blocks_of_three_kinds():
    assert [language for language, _ in BLOCKS] == ["sh", "toml", "python"]
    assert tomllib.loads(BLOCKS[1][1])["trade_off"]["points"] == 40
    for picture in re.findall(r"\]\((\w+\.png)\)", TEXT):
        assert (ROOT / "docs" / picture).exists()


# Brief by default: each as shipped with the slow tests.
@pytest.mark.parametrize("brief", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("line", LINES, ids=[line.split("/")[1].split(".")[0] for line in LINES])
def test_shell_line_runs(line, brief, tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "problems", tmp_path / "problems")
    monkeypatch.chdir(tmp_path)
    program, *arguments = shlex.split(line)
    assert program == "plough-opt"
    if brief:
        key = "effects.orbit=linearised" if "oscillation" in line else "scene.duration=0.1 s"
        arguments += ["--points", "5", "--set", key]
    assert main(arguments) == 0
    assert "Front of" in capsys.readouterr().out
    assert len(list((tmp_path / "out").iterdir())) == sum(word.startswith("out/") for word in arguments)


def test_python_block_runs(capsys):
    exec(BLOCKS[2][1], {})
    shown = capsys.readouterr().out
    assert "1 % less draft costs" in shown
    assert "half angle" in shown
    assert "1 % more tow speed costs" in shown
