"""Every code block of docs/sweeps.md runs."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from plough_opt.app import main

ROOT = Path(__file__).parents[1]
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8"), flags=re.DOTALL)
PYTHON = [text for language, text in BLOCKS if language == "python"]
LINES = [line for language, text in BLOCKS if language == "sh" for line in text.splitlines()]
# Every sweep begins processes: by default those of one script, with the slow tests all of them.
QUICK = ("def response",)


def marked(texts):
    return [
        pytest.param(text, id=str(number), marks=() if any(word in text for word in QUICK) else pytest.mark.slow)
        for number, text in enumerate(texts)
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    work = tmp_path_factory.mktemp("work")
    shutil.copytree(ROOT / "problems", work / "problems")
    return work


def test_there_are_blocks_of_both_kinds_and_no_others():
    assert len(PYTHON) == 3
    assert len(LINES) == 4
    assert {language for language, _ in BLOCKS} == {"python", "sh"}


@pytest.mark.parametrize("line", marked(LINES))
def test_shell_line_runs(line, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    program, *arguments = shlex.split(line)
    assert program == "plough-opt"
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "0 failed" in shown
    if "--npz" in line:
        assert "45 points were there already" in shown
        assert (folder / "out" / "cohesion.npz").stat().st_size > 5_000
    if "16384" in line:
        assert "po.Batch" in shown


@pytest.mark.parametrize("block", marked(PYTHON))
def test_python_block_runs_as_a_script(block, folder):
    script = folder / "script.py"
    script.write_text(block, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
