"""Every code block of docs/results.md runs."""

import re
import shlex
import shutil
from pathlib import Path

from plough_opt.app import main

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


def code(language):
    """Return the page's blocks in a language, one after the other."""
    return "".join(re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL))


def test_python_blocks_run(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(code("python"), names)
    shown = capsys.readouterr().out
    assert "at least 120 mm" in shown
    assert "'lower': 0.1" in shown
    assert names["best"].to_dataframe().attrs["units"] == {"height": "m", "stiffness": "N/m"}


def test_shell_lines_run(capsys, monkeypatch, tmp_path):
    shutil.copytree(ROOT / "problems", tmp_path / "problems")
    monkeypatch.chdir(tmp_path)
    for line in code("sh").splitlines():
        command, _, output = line.partition(" > ")
        assert main(shlex.split(command)[1:]) == 0
        shown = capsys.readouterr().out
        if output:
            Path(output).write_text(shown, encoding="utf-8")
    assert "2 results side by side" in shown
    assert Path("both.png").stat().st_size > 5000
