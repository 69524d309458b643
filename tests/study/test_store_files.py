"""Stores that are damaged, have lost rows, are interrupted, or lie on a read-only medium; a second sweep on one."""

import collections
import contextlib
import functools
import os
import shutil
import sqlite3
import tempfile
from pathlib import Path

import numpy as np
import pytest
from helpers import swept
from helpers.commands import call, printed

import plough_opt as po
from plough_opt.studies.sweep.pool import Done
from plough_opt.studies.sweep.store import About, Store

OVER = {"a": [1.0, 2.0, 5.0], "b": [1.0, 2.0]}


def change(path, *statements):
    """Execute statements in an SQLite file."""
    with contextlib.closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)
    return path


@pytest.fixture
def store(inline, tmp_path):
    """Return a function that executes statements in a complete store and returns its path, and the store's table."""
    path = tmp_path / "sweep.db"
    with po.sweep(swept.failing_at_one, OVER, executor=inline, store=path) as whole:
        return functools.partial(change, path), whole.table.tobytes()


DAMAGED = {
    "ALTER TABLE points DROP COLUMN sine": "the columns point, state, reason, a, b, root",
    "UPDATE meta SET value = '7' WHERE key = 'results'": "results: Input should be a valid",
    "UPDATE meta SET value = '[\"failed\", \"root\"]' WHERE key = 'results'": "'failed' cannot name a column",
    "DELETE FROM meta WHERE key = 'units'": "units: Field required",
    "UPDATE meta SET value = 'x' WHERE key = 'count'": "count: Input should be",
    "INSERT INTO notes VALUES ('x', 'y', 'z', 1)": "its table of notes",
    "UPDATE points SET sine = 'much' WHERE point = 4": "its table of points",
    "UPDATE points SET sine = NULL WHERE point = 4": "its table of points",
    "UPDATE points SET sine = 1.0 WHERE point = 0": "its table of points",
    "UPDATE points SET a = x'00' WHERE point = 0": "its table of points",
    "UPDATE points SET reason = x'00' WHERE point = 0": "its table of points",
    "UPDATE points SET state = 'done' WHERE point = 0": "its table of points",
    "UPDATE points SET point = 6 WHERE point = 4": "its table of points",
    "UPDATE meta SET value = '1' WHERE key = 'layout'": "has layout 1, but this version reads layout 3",
    "DROP TABLE notes": "is a database, but not the store",
}


@pytest.mark.parametrize(("statement", "words"), DAMAGED.items())
def test_tables_that_are_not_those_of_a_store_are_refused(store, inline, statement, words):
    path = store[0](statement)
    with pytest.raises(po.InputError, match=words):
        po.Sweep.load(path)
    for retry in (False, True):
        with pytest.raises(po.InputError, match=words):
            po.sweep(swept.failing_at_one, OVER, executor=inline, store=path, retry=retry)


def test_a_damaged_byte_is_reported_or_can_be_read(store):
    path = store[0]()
    sound, rng, refused = path.read_bytes(), np.random.default_rng(4), 0
    for place in rng.integers(0, len(sound), 300).tolist():
        spoilt = bytearray(sound)
        spoilt[place] ^= int(rng.integers(1, 256))
        path.write_bytes(spoilt)
        try:
            with po.Sweep.load(path) as found:
                assert len(found.table) == len(found)
                list(found.failures), found.notes, found.extreme("sine")
        except po.InputError:
            refused += 1
    assert refused > 0


def test_a_store_that_rejects_a_row_is_an_error(store, inline):
    trigger = "CREATE TRIGGER lossy BEFORE INSERT ON points WHEN new.point = 3 BEGIN SELECT RAISE(IGNORE); END"
    path = store[0](trigger, "DELETE FROM points WHERE point IN (3, 4)")
    with pytest.raises(po.InputError, match="holds 5 of 6 points"):
        po.sweep(swept.failing_at_one, OVER, executor=inline, store=path)


@contextlib.contextmanager
def without_rights():
    """Give up the rights of the superuser."""
    own = os.geteuid()
    os.seteuid(own or 65534)
    try:
        yield
    finally:
        os.seteuid(own)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system has no owners of files")
@pytest.mark.parametrize("state", ["finished", "copied while it was written", "copied without its log"])
def test_a_store_is_read_from_a_read_only_folder(store, state):
    path = store[0]()
    with tempfile.TemporaryDirectory() as folder:  # other users cannot read those of pytest
        place = Path(folder)
        writer = sqlite3.connect(path)
        if state != "finished":
            assert writer.execute("PRAGMA journal_mode = WAL").fetchall() == [("wal",)]
            writer.execute("INSERT INTO notes VALUES ('kind', 'text', 0, 1)")
            writer.commit()
        copied = [path, *([Path(f"{path}-wal")] if state == "copied while it was written" else [])]
        for file in copied:
            assert Path(shutil.copy(file, place)).stat().st_size > 0
        writer.close()
        place.chmod(0o555)
        try:
            with without_rights():
                with pytest.raises(PermissionError):
                    (place / "other").touch()
                with po.Sweep.load(place / "sweep.db") as found:
                    assert (found.complete, found.table.tobytes()) == (True, store[1])
                    assert len(found.notes) == (state == "copied while it was written")
        finally:
            place.chmod(0o755)
        assert sorted(place.iterdir()) == sorted(place / file.name for file in copied)


def test_the_command_reports_undetermined_points_with_status_1(tmp_path):
    store = tmp_path / "sweep.db"
    first = printed(*swept.COMMAND, "--workers", "1", "--store", store)
    assert list(tmp_path.iterdir()) == [store]
    change(store, "DELETE FROM points WHERE point = 1")
    with contextlib.closing(Store(store)) as opened:
        done = Done(1, reasons={0: "3 workers ended while each worked on this point alone"})
        opened.keep(np.array([1]), np.array([[2e4]]), done, without="undetermined")
        opened.finish()
    done = call(*swept.COMMAND, "--store", store)
    assert done.status == 1
    assert "2 points, 0 failed, 1 undetermined" in done.out
    assert "undetermined at soil.cohesion = 20 kPa: 3 workers ended" in " ".join(done.out.split())
    assert "1 of 2 points are undetermined" in done.said
    assert "run the same command with --retry" in done.said
    again = printed(*swept.COMMAND, "--workers", "1", "--store", store, "--retry")
    assert again.splitlines()[:-1] == first.splitlines()[:-1]


VALUES = 60
LONG = {"a": po.Range(0.0, 1.0, VALUES), "b": [1.0, 2.0]}


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
            po.sweep(swept.Counted(file, 0.02), LONG, store=store, executor=inline, retry=retry)
    process.kill()
    process.wait()
    kept = swept.stored(store, "a, b")
    assert workers
    assert 10 <= len(kept) < 2 * VALUES
    # Workers end with their parent.
    swept.until(lambda: all(swept.process_of(worker)[0] in "XZ" for worker in workers))

    with po.sweep(swept.Counted(file, 0.02), LONG, store=store, executor=inline, workers=1) as resumed:
        assert (resumed.already, resumed.complete) == (len(kept), True)
        np.testing.assert_array_equal(resumed.table, po.sweep(swept.waves, LONG, executor=inline).table)
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
