"""Fixtures of the benchmarks: one table for a whole run, one core, and the other tools."""

import importlib
import os
from pathlib import Path

import pytest
from contest_table import Contest

CONTEST = pytest.StashKey[Contest]()
OUT = Path(__file__).resolve().parents[2] / "out" / "bench.json"


def pytest_configure(config):
    config.stash[CONTEST] = Contest()


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(config):
    contest = config.stash[CONTEST]
    if contest.rows or contest.growths:
        contest.show()
        contest.write(OUT)
        print(f"written to {OUT}")


@pytest.fixture(scope="session")
def contest(request):
    """Return the table of this run."""
    return request.config.stash[CONTEST]


@pytest.fixture(scope="session", autouse=True)
def _one_core():
    """Keep this process and its children on one core, so that no tool gains by using several."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    yield
    os.sched_setaffinity(0, before)


@pytest.fixture(scope="session")
def peer(contest):
    """Return a function that imports a module of peers/, or returns None and notes what is missing."""

    def find(name):
        try:
            return importlib.import_module(f"peers.{name}")
        except (ImportError, FileNotFoundError) as missing:
            contest.missing[name] = str(missing)
            return None

    return find
