import contextlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from plough_opt.app import main

PROBLEMS = Path(__file__).parents[2] / "problems"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a command: exit status and the two streams."""

    status: int
    out: str
    err: str


def call(*arguments):
    """Run the command line in this process, neither stream a terminal."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([str(argument) for argument in arguments])
    return Outcome(status, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def cli():
    """Run the command line in this process and return its outcome."""
    return call


@pytest.fixture
def command():
    """Run the command as a process of its own; keywords as of ``subprocess.run``."""

    def run(*arguments, environment=None, **options):
        own = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"} | (environment or {})
        line = [sys.executable, "-c", "import sys; from plough_opt.app import main; sys.exit(main())"]
        options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "encoding": "utf-8"} | options
        done = subprocess.run([*line, *map(str, arguments)], env=own, timeout=60, check=False, **options)
        return Outcome(done.returncode, done.stdout or "", done.stderr or "")

    return run


@pytest.fixture(scope="session")
def cotton():
    """Return the path of the subsoiler's problem file."""
    return PROBLEMS / "cotton_subsoiler.toml"


@pytest.fixture(scope="session")
def reference():
    """Return the path of the reference problem R1."""
    return PROBLEMS / "reference.toml"


@pytest.fixture(scope="session")
def optimised(reference):
    """Return the outcome of optimising R1, as tables."""
    return call("optimise", reference)


@pytest.fixture(scope="session")
def optimised_json(reference, tmp_path_factory):
    """Return the outcome of optimising R1, as JSON, and the picture that came with it."""
    picture = tmp_path_factory.mktemp("pictures") / "r1.svg"
    return call("optimise", reference, "--json", "--plot", picture), picture
