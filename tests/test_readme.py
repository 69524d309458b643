"""Every code block of the README runs."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.commands import line_of_a_page

ROOT = Path(__file__).parents[1]
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
PYTHON = [text for language, text in BLOCKS if language == "python"]
LINES = [line for language, text in BLOCKS if language == "sh" for line in text.splitlines() if line]
ENVIRONMENT = Path(sys.prefix)


def shell(line: str) -> str:
    """Run a line in the present folder, one of the toolkit's commands in this process; return what it prints."""
    if line.startswith("plough-opt "):
        return line_of_a_page(line)
    environment = os.environ | {"PATH": f"{ENVIRONMENT / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(line, shell=True, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def rehearsed(line: str, brief: bool) -> str:
    """Return what stands for a line that would set up an environment, or test the tests, anew."""
    words = shlex.split(line)
    if line == "make run" and not brief:
        # The environment that runs this test is ready: -o keeps make from building another.
        return f"make run VENV={ENVIRONMENT} -o {ENVIRONMENT}/.plough_opt-installed"
    if words[0] == "make":
        return f"make --dry-run {words[1]}"
    if words[0].endswith("python3") and words[1:3] == ["-m", "venv"]:
        return f"{sys.executable} -m venv --without-pip .venv"
    if words[0] == ".venv/bin/pip":
        rest = line.removeprefix(".venv/bin/pip install")
        return f"{sys.executable} -m pip install --dry-run --no-deps --no-build-isolation {rest}"
    return line.replace(".venv/bin/", "")


@pytest.mark.parametrize("block", PYTHON, ids=range(len(PYTHON)))
def test_python_block_runs(block, capsys):
    exec(compile(block, "README.md", "exec"), {})  # the README's own text
    assert capsys.readouterr().out


# The longest lines, which other tests run thinned: of sweeps and of the study of accuracy.
LONG = ("plough-opt sweep", "plough-opt accuracy")
QUICK = [line for line in LINES if not line.startswith(LONG)]


@pytest.mark.parametrize("lines", [QUICK, pytest.param(LINES, marks=pytest.mark.slow)], ids=["quick", "all"])
def test_shell_lines_run_in_order_and_print_the_figures(tmp_path, monkeypatch, lines):
    assert {language for language, _ in BLOCKS} == {"python", "sh"}  # blocks of other languages would not run
    work = tmp_path / "clone"
    shutil.copytree(ROOT, work, ignore=shutil.ignore_patterns(".git", ".venv", ".*_cache", "out", "__pycache__"))
    monkeypatch.chdir(work)
    printed = {line: shell(rehearsed(line, brief=lines is QUICK)) for line in lines}
    # What `make run` does beside the same optimum is to draw it, as a line further down does.
    assert "--plot out/cotton_subsoiler.png" in printed["make run"] or (work / "out" / "cotton_subsoiler.png").exists()
    assert (work / "my_share.png").stat().st_size > 10_000
    assert '"schema": 2' in (work / "my_share.json").read_text(encoding="utf-8")
    for figure in ("39.1147 deg", "0.2540811 m", "50.77128 kN/m", "3.9415 kN", "0.65314 kN", "0.010312 m", "73 %"):
        assert figure in printed[".venv/bin/plough-opt optimise problems/cotton_subsoiler.toml"]
