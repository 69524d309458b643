"""Sweeps of problem files, and their stores: interrupted, shared, damaged and of earlier versions."""

import collections
import contextlib
import functools
import math
import os
import pickle
import shutil
import sqlite3
import tempfile
import tomllib
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers import swept
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS, REFERENCE, SUBSOILER
from helpers.refusals import refusals

import plough_opt as po
from plough_opt.core.units import Unit
from plough_opt.motion.vocabulary import MEASURES, Measure
from plough_opt.problem_file.source import read_axis
from plough_opt.problem_file.sweep import Optimisation, ProblemSweep, SimulationOfMany
from plough_opt.studies.sweep import engine
from plough_opt.studies.sweep.pool import Done
from plough_opt.studies.sweep.store import About, Store

# --- sweeps of problem files: the results of single runs and optimisations to the last bit, and memory that stays ---

# A design of the wedge angle and the height, without motion: quick to solve.
STEADY = ("effects.motion=false", "scene.duration=0.5 s", "scene.stiffness=50 kN/m")
BRIEF = ("scene.duration=0.2 s", "scene.outputs=40")
OVER = {"soil.cohesion": "5..45 kPa:3", "scene.tow_speed": po.Range(1.0, 3.0, 3)}


@pytest.fixture(scope="module")
def problem():
    return po.read_problem(SUBSOILER, BRIEF)


def test_every_point_has_the_results_of_a_single_simulation(problem, inline):
    table = po.sweep(problem, OVER, executor=inline).table
    assert len(table) == 9
    for row in table:
        changes = (f"soil.cohesion={row['soil.cohesion'] / 1e3} kPa", f"scene.tow_speed={row['scene.tow_speed']} m/s")
        run = po.read_problem(SUBSOILER, (*BRIEF, *changes)).simulate()
        for name in ("mean_draft", "force_rms", "mean_deflection", "tow_power", "peak_force", "error_estimate"):
            assert row[name] == getattr(run, name)
        assert row["loosened_radius"] == run.scene.loosened_radius
        assert row["moving_mass"] == run.scene.mass


def test_each_warning_is_kept_once_with_the_number_of_its_points_and_the_range_of_its_numbers(problem, inline):
    over, found = {"share.wedge_angle": "30, 55 deg", "soil.cohesion": "3, 40 kPa", "share.height": "1e-170, 0.2 m"}, []
    for method in ("each", "batch"):
        with po.sweep(problem, over, method=method, executor=inline) as swept:
            found.append((swept.notes, [failure.point for failure in swept.failures]))
    notes = found[0][0]
    assert found == [(notes, [0, 2, 4, 6])] * 2  # a share so small that its loosened section is 0 fails
    assert [note.partition(":")[0] for note in notes] == ["at 4 of 8 points", "at 2 of 8 points"]
    most, least = (100.0 * problem.scene({"soil.cohesion": cohesion}).ambient_share for cohesion in (3e3, 40e3))
    assert f"ambient pressure (101.3 kPa) carries {least:.0f} to {most:.0f} %" in notes[0]
    assert "above 20 deg the hypothesis of plane sections does not hold" in notes[1]


def test_an_optimum_does_not_depend_on_the_point_before(inline):
    problem = po.read_problem(REFERENCE, STEADY)
    forwards = po.sweep(problem, {"soil.cohesion": [10e3, 20e3]}, what="optimise", executor=inline).table
    changed = po.read_problem(REFERENCE, (*STEADY, "soil.cohesion=20 kPa"))
    best, run = changed.optimise()
    assert forwards["objective"][1] == best.objective
    assert forwards["share.height"][1] == best.variables["share.height"]
    assert forwards["mean_draft"][1] == run.mean_draft
    assert forwards["margin of loosened_radius"][1] == best.margins["loosened_radius"]


BOX = {"share.wedge_angle": "25..39 deg", "share.height": "0.18..0.28 m", "scene.stiffness": "40..1000 kN/m log"}


class TestMany:
    """Sweeps by `po.Batch`."""

    def test_a_design_has_the_same_bits_in_a_batch_of_any_size(self, problem, inline, monkeypatch):
        tables = []
        for size in (32, 1, 3, 13):
            monkeypatch.setattr(engine, "_SIZES_OF_MANY", (size, size))
            tables.append(po.sweep(problem, BOX, samples=32, method="batch", executor=inline).table.tobytes())
        assert len(set(tables)) == 1
        many = SimulationOfMany(problem, tuple(BOX))
        many.build()
        _, reasons, _ = pickle.loads(pickle.dumps(many)).many(np.array([[0.5, 0.2, 1e5], [-0.5, 0.2, 1e5]]))
        assert list(reasons) == [1]  # outside the domain

    def test_results_are_those_of_single_simulations_to_the_wanted_error(self, problem, inline):
        options = {"samples": 16, "executor": inline}
        table, single = (po.sweep(problem, BOX, method=method, **options).table for method in ("batch", "each"))
        assert table.dtype.names[4:] == SimulationOfMany(problem, ()).results
        assert list(table.dtype.names) == [name for name in single.dtype.names if not name.startswith("peak_")]
        for name in ("mean_draft", "force_rms"):
            # Both have errors up to 1e-8 of the larger of mean draft and RMS force.
            assert np.max(np.abs(table[name] - single[name]) / single["mean_draft"]) < 2e-8
        for name in ("loosened_radius", "half_angle", "moving_mass", "added_mass", "specific_draft", "cone_index"):
            np.testing.assert_allclose(table[name], single[name], rtol=3e-8)
        assert np.max(table["error_estimate"]) < 1e-8

    def test_results_of_the_files_own_and_broken_waves_are_those_of_single_simulations(self, inline):
        own = ("measures.work={ value = 'tow_power / scene.tow_speed', unit = 'N' }", "scene.duration=0.5 s")
        problem, axes = po.read_problem(SUBSOILER, own), {"scene.tow_speed": "1..3 m/s:30"}
        many, each = (po.sweep(problem, axes, method=method, executor=inline) for method in ("batch", "each"))
        with many, each:
            np.testing.assert_allclose(many.column("work"), each.column("work"), rtol=1e-7)
            counts = [[note.split()[1] for note in one.notes if "ends within a strength wave" in note]
                      for one in (many, each)]  # fmt: skip
        assert counts[0] == counts[1] != []

    def test_a_result_over_time_keeps_a_batch_away(self, monkeypatch):
        monkeypatch.setitem(MEASURES, "last", Measure(Unit("N"), lambda run: run.mount_force[-1]))
        problem, axes = po.read_problem(SUBSOILER), {"scene.tow_speed": "1..3 m/s:10000"}
        assert "po.simulate" in ProblemSweep.of(problem, axes).how
        with pytest.raises(po.InputError, match="'last' needs the motion over time"):
            ProblemSweep.of(problem, axes, method="batch")

    def test_a_chaotic_motion_that_misses_the_wanted_error_is_noted(self, inline):
        share = ("share.wedge_angle=0.639427778 rad", "share.height=0.482322562 m")
        problem = po.read_problem(REFERENCE, ("scene.duration=60 s", "accuracy.error=1e-4", *share))
        with po.sweep(problem, {"scene.stiffness": [8104.16376, 5e4]}, method="batch", executor=inline) as found:
            assert (found.column("error_estimate") > 1e-4).tolist() == [True, False]
            assert "at 1 of 2 points: the wanted relative error 1.0e-04 was not reached" in found.notes

    def test_a_batch_is_used_for_many_points_of_a_scene_that_it_supports(self, problem):
        axes = {"soil.cohesion": po.Range(1e4, 2e4, 100), "scene.tow_speed": po.Range(1.0, 2.0, 100)}
        assert "po.Batch" in ProblemSweep.of(problem, axes).how
        assert "po.simulate" in ProblemSweep.of(problem, {**axes, "scene.tow_speed": po.Range(1.0, 2.0, 99)}).how
        assert "po.simulate" in ProblemSweep.of(problem, axes, method="each").how
        sticky = po.read_problem(PROBLEMS / "stick_slip.toml")
        assert "po.simulate" in ProblemSweep.of(sticky, axes).how
        with pytest.raises(po.InputError, match="events"):
            ProblemSweep.of(sticky, axes, method="batch")

    def test_a_batch_of_periodic_orbits(self, inline):
        changed = ("effects.damping=10 N*s/m", "effects.strength_wave.amplitude=1.0", "share.height=45 cm")
        problem = po.read_problem(PROBLEMS / "draft_oscillation_loosening.toml", changed)
        axes = {"scene.stiffness": [3e3, 5e3, 1e4, 1e5], "scene.tow_speed": [1.5, 3.0]}
        with (
            po.sweep(problem, axes, method="batch", executor=inline) as found,
            po.sweep(problem, axes, method="each", executor=inline) as single,
        ):
            for name in ("mean_draft", "force_rms", "tow_power", "loosened_radius"):
                np.testing.assert_allclose(found.column(name), single.column(name), rtol=1e-6)
            assert any("equilibrium" in note for note in found.notes)
            unstable = [[note for note in one.notes if "the orbit is unstable" in note] for one in (found, single)]
            assert [*map(bool, unstable)] == [True, True]


TEXTS = [
    ("5..45 kPa:3", "Pa", (5e3, 25e3, 45e3)),
    ("5 kPa .. 45 kPa : 3", "Pa", (5e3, 25e3, 45e3)),
    ("10..1000 kN/m:3 log", "N/m", (1e4, 1e5, 1e6)),
    ("5, 10, 2 kPa", "Pa", (5e3, 1e4, 2e3)),
    ("500 g..2 kg:3", "kg", (0.5, 1.25, 2.0)),
    ("-1..1:3", "", (-1.0, 0.0, 1.0)),
    ("20..40 deg:2", "rad", (20 * math.pi / 180, 40 * math.pi / 180)),
    ("1..7 km/h:61", "m/s", tuple(Unit("m/s").parse(f"{1 + k / 10:.1f} km/h") for k in range(61))),
    ("5..45 kPa", "Pa", po.Range(5e3, 45e3)),
    ("5..45 kPa log", "Pa", po.Range(5e3, 45e3, log=True)),
]


@pytest.mark.parametrize(("text", "unit", "expected"), TEXTS)
def test_texts_of_grids_lists_and_samples(text, unit, expected):
    # To the last bit, as from a file.
    assert read_axis(text, Unit(unit), sampled=isinstance(expected, po.Range))[0] == expected


def axis(text, sampled=False):
    return read_axis(text, Unit("Pa"), sampled=sampled)


test_invalid_texts_are_refused = refusals(
    po.InputError,
    (lambda: axis("5..5 kPa:9"), "lower 5 is not below upper 5"),
    (lambda: axis("5..45:9"), '"5" has no unit'),
    (lambda: axis("5..45 kpa:9"), "unknown unit 'kpa'"),
    (lambda: axis("5..45 kPa:1"), "number of values = 1"),
    (lambda: axis("5..45 kPa:few"), '":few" is not a number of values'),
    (lambda: axis("5..45 kPa"), "has no number of values"),
    (lambda: axis("5..45 kPa:9", True), "does not use"),
    (lambda: axis("5, 45 kPa", True), "is not a range"),
    (lambda: axis("5 kPa"), "is one value"),
    (lambda: axis("0..5 kPa:3 log"), "needs a lower bound above 0"),
    (lambda: axis("..5 kPa:3"), "is not a range"),
    (lambda: axis("5, 5 kPa"), "same value twice"),
    (lambda: axis("5..1e999 kPa:3"), "must be finite"),
)
REFUSED = [
    (3, {}, "over = 3 must be a dictionary"),
    ({"soil.cohesion": [-1e4, 2e4]}, {}, "cohesion = -10000 Pa"),
    ({"effects.breakaway": [1.0, 2.0]}, {}, 'belongs to contact = "stick_slip"'),
    ({"soil.cohesion": [1e4, 2e4]}, {"what": "optimize"}, "did you mean 'optimise'"),
    ({"soil.cohesion": [1e4, 2e4]}, {"method": "many"}, "method = 'many' is unknown"),
    ({"soil.cohesion": [1e4, 2e4]}, {"what": "optimise", "method": "batch"}, "a batch cannot optimise"),
    ({"soil.cohesion": [1e4, 2e4]}, {"units": {}}, "a problem file has its own"),
    (dict(zip(BOX, ([0.4, 0.5], [0.2, 0.3], [5e4, 6e4]), strict=True)), {"what": "optimise"}, "variable is fixed"),
]


@pytest.mark.parametrize(("over", "more", "expected"), REFUSED)
def test_invalid_sweeps_are_refused_before_anything_is_computed(problem, inline, over, more, expected):
    with pytest.raises(po.InputError, match=expected):
        po.sweep(problem, over, executor=inline, **more)


def test_units_of_an_optimisation_cover_its_results(problem):
    assert {"margin of loosened_radius": "m", "scene.stiffness": "N/m"}.items() <= Optimisation(problem).units.items()


@pytest.mark.parametrize("count", [2**12, pytest.param(2**18, marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_points(tmp_path, inline, count):
    problem, peaks = po.read_problem(SUBSOILER, ("scene.duration=0.1 s",)), []

    def watch(stored, total, failed):
        peaks.append((stored, tracemalloc.get_traced_memory()[1]))
        tracemalloc.reset_peak()
        assert (total, failed) == (count, 0)

    # Workers simulate very many; this process shares out their tasks, stores the points and writes the tables.
    options = {"executor": inline, "workers": 1} if count == 2**12 else {}
    tracemalloc.start()
    try:
        with po.sweep(problem, BOX, samples=count, method="batch", store=tmp_path / "sweep.db", progress=watch,
                      **options) as found:  # fmt: skip
            found.to_csv(tmp_path / "sweep.csv")
            found.to_npz(tmp_path / "sweep.npz")
            written = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    early, late = (max(peak for stored, peak in peaks if (stored <= count // 4) == first) for first in (True, False))
    # Two tasks may overlap: the arrays of a second one, 2048 rows of about 20 numbers, are not growth.
    one_task = 2048 * 20 * 8 * 8
    assert max(late, written) < early + one_task
    with np.load(tmp_path / "sweep.npz") as arrays:
        assert np.isfinite(arrays["mean_draft"]).sum() == count


# --- stores that are damaged, have lost rows, are interrupted, or lie on a read-only medium; a second sweep on one ---

GRID = {"a": [1.0, 2.0, 5.0], "b": [1.0, 2.0]}


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
    with po.sweep(swept.failing_at_one, GRID, executor=inline, store=path) as whole:
        return functools.partial(change, path), whole.table.tobytes()


DAMAGED = tomllib.loads(Path(__file__).with_name("stores.toml").read_text(encoding="utf-8"))["damaged"]


@pytest.mark.parametrize(("statement", "words"), DAMAGED)
def test_tables_that_are_not_those_of_a_store_are_refused(store, inline, statement, words):
    path = store[0](statement)
    with pytest.raises(po.InputError, match=words):
        po.Sweep.load(path)
    for retry in (False, True):
        with pytest.raises(po.InputError, match=words):
            po.sweep(swept.failing_at_one, GRID, executor=inline, store=path, retry=retry)


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
        po.sweep(swept.failing_at_one, GRID, executor=inline, store=path)


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


def test_an_interrupted_call_stores_all_or_none(tmp_path):
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
