"""Whole processes: imports and the command line. Nothing here asserts a time."""

import subprocess
import sys
from pathlib import Path

import pytest
from contest_table import processes

pytestmark = pytest.mark.bench

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
IMPORTS = {
    "import plough_opt": "import plough_opt",
    "import casadi, numpy: what plough_opt needs anyhow": "import casadi, numpy",
    "python -c pass": "pass",
    "import scipy.integrate, scipy.optimize": "import scipy.integrate, scipy.optimize",
    "import numba, scipy.optimize": "import numba, scipy.optimize",
    "import jax, diffrax, scipy.optimize": "import jax, diffrax, scipy.optimize",
}
SCRIPT = "import sys; from plough_opt.app import main; sys.exit(main(sys.argv[1:]))"


def _python(code, *arguments):
    return [sys.executable, "-W", "ignore", "-c", code, *arguments]


def _works(command):
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


def test_imports(contest):
    task = "start-up: a process that imports"
    commands = {name: _python(code) for name, code in IMPORTS.items()}
    for name in [name for name, command in commands.items() if not _works(command)]:
        contest.missing[name] = "not installed"
        del commands[name]
    spent = processes(commands, 7)
    above = spent["import plough_opt"].cpu - spent["import casadi, numpy: what plough_opt needs anyhow"].cpu
    for name, each in spent.items():
        ours = name == "import plough_opt"
        contest.add(task, name, each, ours=ours, note=f"{above * 1e3:.0f} ms above casadi and numpy" if ours else "")


def test_command_line(contest):
    for name in ("cotton_subsoiler.toml", "reference.toml"):
        task = f"start-up: plough-opt optimise {name}"
        commands = {"a process of its own": _python(SCRIPT, "optimise", str(PROBLEMS / name))}
        for what, each in processes(commands, 3).items():
            contest.add(task, what, each, ours=True)
