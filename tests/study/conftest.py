import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent


@pytest.fixture
def script(tmp_path):
    """Start a Python text as a process of its own, with the tests' helpers; it is killed at the end."""
    started = []

    def start(text, *command):
        path = tmp_path / f"script{len(started)}.py"
        path.write_text(text, encoding="utf-8")
        environment = os.environ | {"PYTHONPATH": f"{TESTS}{os.pathsep}{ROOT}"}
        line = [*command, str(path)] if command else [sys.executable, str(path)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(subprocess.Popen(line, env=environment, text=True, **pipes))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()
