"""Sweeps that are killed or interrupted, and a second one on their store: real processes."""

import collections
import contextlib
from pathlib import Path

import numpy as np
import pytest
from helpers import swept

import plough_opt as po
from plough_opt.studies.sweep.pool import Done
from plough_opt.studies.sweep.store import About, Store

VALUES = 60
OVER = {"a": po.Range(0.0, 1.0, VALUES), "b": [1.0, 2.0]}


def calls(path):
    """Return how often each point was evaluated."""
    return collections.Counter(tuple(map(float, line.split())) for line in path.read_text().splitlines())


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for the workers in /proc")
def test_a_sweep_is_read_while_it_runs_and_resumes_without_repeating_stored_points(script, inline, tmp_path):
    store, file = tmp_path / "sweep.db", tmp_path / "calls"
    process = script(swept.script_of(store, file, 0.02, VALUES))
    swept.until(lambda: len(swept.stored(store)) >= 10, process)
    workers = swept.workers_of(process.pid)
    with po.Sweep.load(store) as part:
        assert (part.complete, len(part) >= 10, np.isfinite(part.column("sine")).all()) == (False, True, True)
    for retry in (False, True):
        with pytest.raises(po.InputError, match=r"another run fills the store '.*sweep\.db': wait for its end"):
            po.sweep(swept.Counted(file, 0.02), OVER, store=store, executor=inline, retry=retry)
    process.kill()
    process.wait()
    kept = swept.stored(store, "a, b")
    assert workers
    assert 10 <= len(kept) < 2 * VALUES
    # Workers end with their parent.
    swept.until(lambda: all(swept.process_of(worker)[0] in "XZ" for worker in workers))

    with po.sweep(swept.Counted(file, 0.02), OVER, store=store, executor=inline, workers=1) as resumed:
        assert (resumed.already, resumed.complete) == (len(kept), True)
        np.testing.assert_array_equal(resumed.table, po.sweep(swept.waves, OVER, executor=inline).table)
    evaluated = calls(file)
    assert len(evaluated) == 2 * VALUES
    assert all(evaluated[row] == 1 for row in kept)
    # Points that were computed twice were under way: six tasks for two workers, each of at most 0.25 s of pauses.
    assert sum(evaluated.values()) - 2 * VALUES <= 6 * int(0.25 / 0.02)
    assert [path.name for path in tmp_path.glob("sweep.db*")] == ["sweep.db"]


def test_points_are_claimed_once_and_stored_all_or_none(tmp_path):
    numbers = np.arange(10)
    about = About.model_construct(names=("a",), units={}, question={"q": "1"}, count=9000, results=())

    def failed(last, reasons):
        return numbers[:last], numbers[:last, None] * 1.0, Done(last, reasons=reasons)

    class Interrupted(dict):
        def get(self, key):
            if key == 3:
                raise KeyboardInterrupt
            return "no"

    with contextlib.closing(Store(tmp_path / "sweep.db")) as store:
        store.prepare(about)
        assert [store.claim(size).tolist() for size in (3, 2)] == [[0, 1, 2], [3, 4]]
        with pytest.raises(KeyboardInterrupt):
            store.keep(*failed(10, Interrupted()))
        store.run("BEGIN IMMEDIATE")  # as if the interrupt came between two statements
        store.run("DELETE FROM meta")
        store.keep(*failed(4, dict.fromkeys(range(4), "no")))
        assert store.counts() == (4, 4, 0)
    with contextlib.closing(Store(tmp_path / "sweep.db")) as store:
        store.prepare(about)
        found = []
        while (claim := store.claim(4000)) is not None:
            found += claim.tolist()
        assert found == list(range(4, 9000))
        store.run("DELETE FROM points WHERE point = 2")
    for retry, missing in ((False, [2, 4]), (True, [0, 1])):
        with contextlib.closing(Store(tmp_path / "sweep.db")) as store:
            store.prepare(about, retry)
            assert store.claim(2).tolist() == missing
