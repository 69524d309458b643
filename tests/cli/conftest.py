import os
import subprocess
import sys

import pytest
from helpers.commands import Outcome
from helpers.problem_files import STATIC


@pytest.fixture
def static(tmp_path):
    """Return the path of a small problem file."""
    path = tmp_path / "static.toml"
    path.write_text(STATIC, encoding="utf-8")
    return path


@pytest.fixture
def command():
    """Run the command as a process of its own; keywords as of ``subprocess.run``."""

    def run(*arguments, environment=None, **options):
        own = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"} | (environment or {})
        line = [sys.executable, "-c", "import sys; from plough_opt.app.main import main; sys.exit(main())"]
        options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "encoding": "utf-8"} | options
        done = subprocess.run([*line, *map(str, arguments)], env=own, timeout=60, check=False, **options)
        return Outcome(done.returncode, done.stdout or "", done.stderr or "")

    return run
