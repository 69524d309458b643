"""docs/calibration.md: its examples run, its formulas survive Markdown, its constants are those of the code."""

import re
import shlex
from pathlib import Path

import pytest

from plough_opt.app import main
from plough_opt.studies.calibration.loss import CAUCHY, HUBER, SOFT_L1

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Work in a folder that has the problems, and nothing else."""
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_python_example_runs(repository, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    exec(compile(code, "calibration.md", "exec"), {})  # the page's own text
    assert "soil.cohesion" in capsys.readouterr().out
    assert (repository / "out" / "residuals.png").stat().st_size > 10_000
    assert (repository / "out" / "fit.json").stat().st_size > 1_000


def test_the_command_runs(repository, capsys):
    (line,) = re.findall(r"```sh\n(.*?)\n```", TEXT, flags=re.DOTALL)
    words = shlex.split(line)
    assert words[0] == "plough-opt"
    assert main(words[1:]) == 0
    assert "What to measure next" in capsys.readouterr().out
    assert (repository / "out" / "residuals.png").stat().st_size > 10_000


def test_formulas_survive_markdown():
    """A display formula is a fenced block; in a line a backslash before punctuation needs the backquoted form."""
    prose = re.sub(r"```.*?```", "", TEXT, flags=re.DOTALL)
    assert "$$" not in prose
    for formula in re.findall(r"\$([^$\n]+)\$", prose):
        assert not re.search(r"\\[^A-Za-z]|\*", formula), formula


def test_constants_are_those_of_the_code():
    assert [float(c) for c in re.findall(r"\$c=([\d.]+)\$", TEXT)] == [HUBER, SOFT_L1, CAUCHY]
