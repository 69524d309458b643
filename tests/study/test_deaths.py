"""Sweeps whose workers are killed at any moment: no point is lost, repeated or wrongly reported as failed."""

import math
import os
import random
import signal
import sqlite3
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from helpers import swept

import plough_opt as po
from plough_opt.studies.sweep import pool as pools
from plough_opt.studies.sweep.pool import ProcessPool, WorkerDied, environment

PROCESSES = Path("/proc")
by_proc = pytest.mark.skipif(not PROCESSES.is_dir(), reason="finds the workers in /proc")


def workers_here():
    """Return the worker processes of this process."""
    found = []
    for entry in PROCESSES.iterdir():
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid() and "plough_opt.studies.sweep.pool" in (entry / "cmdline").read_text():
                found.append(int(entry.name))
        except (OSError, ValueError, IndexError):  # not a process, or one that has ended
            continue
    return found


class Killer(threading.Thread):
    """Kills workers of this process at random moments, in random order, until it is stopped."""

    def __init__(self, seed, pauses, most):
        super().__init__(daemon=True)
        self.random, self.pauses, self.most = random.Random(seed), pauses, most
        self.killed, self.stopped = [], threading.Event()

    def run(self):
        while len(self.killed) < self.most and not self.stopped.wait(self.random.uniform(*self.pauses)):
            # A killed worker is listed until the pool has noticed its end.
            if there := sorted(set(workers_here()) - set(self.killed)):
                self.killed.append(self.random.choice(there))
                os.kill(self.killed[-1], signal.SIGKILL)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.stopped.set()
        self.join()


@pytest.fixture(scope="module")
def start():
    """Return the time that a worker takes to start on this machine now [s]."""
    began = time.monotonic()
    with ProcessPool(1, swept.waves) as pool:
        pool.submit(math.sqrt, 4.0).result(60.0)
    return time.monotonic() - began


@by_proc
@pytest.mark.parametrize(
    ("seed", "values", "kills"),
    [(1, 60, 6), *(pytest.param(seed, 450, 60, marks=pytest.mark.slow) for seed in range(2, 8))],
)
def test_killed_workers_do_not_change_the_table(inline, tmp_path, start, seed, values, kills):
    # Some die before they have started, others at work.
    pauses = (0.05 * start, 3.0 * start)
    over = {"a": po.Range(0.0, 1.0, values), "b": [1.0, 2.0]}
    with po.sweep(swept.waves, over, executor=inline) as undisturbed:
        truth = undisturbed.table
    counted = swept.Counted(tmp_path / "calls", 0.02)
    with (
        Killer(seed, pauses, kills) as killer,
        po.sweep(counted, over, workers=2, store=tmp_path / "sweep.db") as found,
    ):
        np.testing.assert_array_equal(found.table, truth)
        assert (found.failed, list(found.undetermined), found.complete) == (0, [], True)
    assert len(set(killer.killed)) == len(killer.killed) > 0
    connection = sqlite3.connect(tmp_path / "sweep.db")
    rows = Counter(row[0] for row in connection.execute("SELECT point FROM points"))
    connection.close()
    assert rows == Counter(range(2 * values))


def test_a_point_that_kills_three_workers_is_undetermined_until_a_retry(tmp_path):
    deadly, store = swept.Deadly(tmp_path / "died"), tmp_path / "sweep.db"
    with po.sweep(deadly, {"a": np.arange(8.0)}, workers=1, store=store) as found:
        (one,) = found.undetermined
        assert (one.point, one.values) == (5, {"a": 5.0})
        assert one.reason.startswith(
            "3 workers ended while each worked on this point alone; the last ended by signal 9"
        )
        assert (found.failed, list(found.failures), found.complete) == (0, [], True)
        expected = [math.nan if a == 5.0 else 2.0 * math.sin(a) for a in range(8)]
        np.testing.assert_array_equal(found.column("sine"), expected)
        assert (
            found.to_csv(tmp_path / "t.csv").read_text().splitlines()[6].startswith("5,5.0,,,undetermined: 3 workers")
        )
        with np.load(found.to_npz(tmp_path / "t.npz")) as arrays:
            assert (arrays["undetermined"].tolist(), arrays["failed"].tolist()) == ([5], [])
    # Two deaths of the whole task, three on the way to a single point at most, and three alone.
    assert (tmp_path / "died").read_text().count("5.0") <= 3 + 2 + 3
    (tmp_path / "cured").touch()
    with po.sweep(deadly, {"a": np.arange(8.0)}, workers=1, store=store) as found:
        assert len(list(found.undetermined)) == 1
    with po.sweep(deadly, {"a": np.arange(8.0)}, workers=1, store=store, retry=True) as found:
        assert (found.already, list(found.undetermined)) == (7, [])
        assert found.column("sine").tolist() == [2.0 * math.sin(a) for a in range(8)]


def test_a_sweep_whose_workers_all_die_ends_with_the_reason(monkeypatch):
    assert pools._PATIENCE == 40.0  # as docs/sweeps.md says
    monkeypatch.setattr(pools, "_PATIENCE", 0.5)
    with pytest.raises(po.InputError, match=r"worker processes ended within \d+ s before .* by signal 9 \(Killed\)"):
        po.sweep(swept.kills_always, {"a": np.arange(64.0)}, workers=1)


def test_an_evaluation_that_a_worker_cannot_unpickle_is_refused():
    with pytest.raises(po.InputError, match="the worker processes could not begin: RuntimeError: not here"):
        po.sweep(swept.Unreadable(), {"a": [1.0, 2.0]}, workers=1)


@by_proc
def test_workers_end_with_the_pool_and_print_to_the_error_stream(capfd):
    before = set(workers_here())
    with ProcessPool(1, swept.waves) as pool:
        pool.submit(print, "from inside").result(60.0)
        pool.submit(os.system, "echo from a child").result(60.0)
        # A worker that has begun may sweep itself.
        assert pool.submit(swept.sweep_waves).result(60.0) == [math.sqrt(b) / 3.0 for b in (2.0, 8.0, 2.0, 8.0)]
    assert set(workers_here()) <= before
    assert capfd.readouterr() == ("", "from inside\nfrom a child\n")


@by_proc
@pytest.mark.slow
def test_a_child_that_outlives_a_dead_worker_does_not_block_the_pool(tmp_path):
    with ProcessPool(1, swept.waves) as pool, pytest.raises(WorkerDied):
        pool.submit(swept.fork_and_die, str(tmp_path / "child")).result(30.0)
    child = int((tmp_path / "child").read_text())
    os.kill(child, signal.SIGKILL)


def test_all_workers_together_have_one_thread_per_core(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pools, "available", lambda: 5)
    with ProcessPool(1, swept.waves) as pool:
        assert pool.submit(os.getenv, "OPENBLAS_NUM_THREADS").result(60.0) == "5"
    # Numbers set by the user remain, and a worker does not join the MPI job of its parent.
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.setenv("PMI_FD", "9")
    found = environment(2)
    assert (found["OMP_NUM_THREADS"], found["MKL_NUM_THREADS"], "PMI_FD" in found) == ("3", "2", False)
