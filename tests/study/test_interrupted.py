"""Sweeps that are killed or interrupted, and two sweeps at once: real processes on one store."""

import collections
import platform
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
def test_a_killed_sweep_resumes_without_repeating_stored_points(script, inline, tmp_path):
    store, file = tmp_path / "sweep.db", tmp_path / "calls"
    process = script(swept.script_of(store, file, 0.02, VALUES))
    swept.until(lambda: len(swept.stored(store)) >= 10, process)
    workers = swept.workers_of(process.pid)
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


def test_two_runs_at_once_share_the_points(script, inline, tmp_path):
    store, file = tmp_path / "sweep.db", tmp_path / "calls"
    text = swept.script_of(store, file, 0.01, VALUES, "ThreadPoolExecutor(1), progress=print")
    for process in [script(text), script(text)]:
        shown, error = process.communicate(timeout=60)
        assert process.returncode == 0, error
        assert shown.splitlines()[-1] == "120 120 0"
    evaluated = calls(file)
    assert sorted(evaluated.values()) == [1] * (2 * VALUES)
    np.testing.assert_array_equal(po.Sweep.load(store).table, po.sweep(swept.waves, OVER, executor=inline).table)


class TestClaims:
    """Ranges of points that runs have claimed, and what happens to them when a run dies."""

    @pytest.fixture
    def open_store(self, tmp_path):
        opened = []

        def open_one(retry=False):
            opened.append(Store(tmp_path / "sweep.db"))
            about = About.model_construct(names=("a",), units={}, question={"q": "1"}, count=10, results=(), next=0)
            opened[-1].prepare(about, retry)
            return opened[-1]

        yield open_one
        for one in opened:
            one.close()

    @staticmethod
    def keep(store, first, last):
        numbers = np.arange(first, last)
        reasons = dict.fromkeys(range(len(numbers)), "no")
        return store.keep(numbers, numbers[:, None] * 1.0, Done(len(numbers), reasons=reasons))

    def test_released_points_are_taken_over_unless_they_are_stored(self, open_store):
        one, two = open_store(), open_store()
        one.claim(10)
        self.keep(one, 2, 5)
        assert two.claim(4) is None
        one.renew(0.0)
        assert two.claim(4).tolist() == [0, 1, 5, 6, 7, 8, 9]
        assert self.keep(two, 0, 9) == 6  # the other three keep their rows
        assert one.waiting()
        self.keep(two, 9, 10)
        assert two.claim(4) is None
        assert not one.waiting()

    def test_an_interrupt_between_two_statements_leaves_the_store_usable(self, open_store):
        one, two = open_store(), open_store()
        one.claim(10)
        self.keep(one, 0, 4)
        one.run("BEGIN IMMEDIATE")
        one.run("DELETE FROM points")
        one.renew(0.0)
        assert one.counts() == (4, 4, 0)
        assert two.claim(4).tolist() == [4, 5, 6, 7, 8, 9]

    def test_a_run_is_dead_unless_it_renews_its_lease(self, open_store):
        one, two = open_store(), open_store()
        one.claim(10)
        one.renew(-1.0)
        one.renew()
        assert two.claim(4) is None
        one.renew(-1.0)
        assert two.claim(4).tolist() == list(range(10))
        # A claim whose points the dead run stored after all is ended by the next one.
        self.keep(one, 0, 10)
        two.renew(0.0)
        assert (one.waiting(), one.claim(4), one.waiting()) == (True, None, False)

    def test_a_run_on_another_machine_is_dead_only_after_its_lease(self, open_store):
        one = open_store()
        one.claim(10)
        for owner, points in (("elsewhere:4194305", None), ("{}:4194305", 10), ("{}:none", 10)):
            one.run("UPDATE claims SET owner = ?", owner.format(platform.node()))  # no process has this number
            claim = open_store().claim(4)
            assert claim is points or len(claim) == points

    def test_failures_are_not_retried_while_another_run_lives(self, open_store):
        one, two = open_store(), open_store()
        one.claim(10)
        self.keep(one, 0, 4)
        with pytest.raises(po.InputError, match="another run fills the store"):
            open_store(retry=True)
        one.renew(0.0)
        open_store(retry=True)
        assert two.counts() == (0, 0, 0)
        found = set()
        while (claim := two.claim(10)) is not None:
            found |= set(claim.tolist())
        assert found == set(range(10))
