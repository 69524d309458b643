import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent


@pytest.fixture(scope="session")
def inline():
    """Return an executor in this process."""
    with ThreadPoolExecutor(1) as executor:
        yield executor


@pytest.fixture
def script(tmp_path):
    """Start a Python text as a process of its own, with the tests' helpers; it is killed at the end."""
    started = []

    def start(text, *command, **options):
        path = tmp_path / f"script{len(started)}.py"
        path.write_text(text, encoding="utf-8")
        environment = os.environ | {"PYTHONPATH": f"{TESTS}{os.pathsep}{ROOT}"}
        line = [*command, str(path)] if command else [sys.executable, str(path)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        started.append(subprocess.Popen(line, env=environment, **(pipes | options)))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def counted_text():
    """Return a script that sweeps `helpers.swept.Counted` into a store."""

    def text(store, file, pause, values, executor="None"):
        return (
            "from plough_opt.studies.sweep.points import Range\n"
            "from plough_opt.studies.sweep.sweeping import sweep\n"  # what files need is not imported
            "from concurrent.futures import ThreadPoolExecutor\n"
            "from pathlib import Path\n"
            "from helpers.swept import Counted\n"
            "if __name__ == '__main__':\n"
            f"    counted = Counted(Path({json.dumps(str(file))}), {pause})\n"
            f"    over = {{'a': Range(0.0, 1.0, {values}), 'b': [1.0, 2.0]}}\n"
            f"    sweep(counted, over, store={json.dumps(str(store))}, workers=2, executor={executor})\n"
        )

    return text
