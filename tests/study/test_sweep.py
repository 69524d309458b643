"""Sweeps of functions: points, results, failures, and the file, which goes on after a kill and on any executor."""

import collections
import csv
import math
import os
import shutil
import signal
import sqlite3
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from helpers import swept
from helpers.commands import call, printed
from helpers.extras import needs
from helpers.problem_files import REFERENCE
from scipy.stats import qmc

import plough_opt as po
from plough_opt.studies.sweep.points import points_of

OVER = {"a": po.Range(0.0, 3.0, 40), "b": [1.0, 2.0, 5.0]}


def expected_waves():
    places = np.linspace(0.0, 3.0, 40).tolist()
    return [tuple(swept.waves({"a": a, "b": b}).values()) for a in places for b in OVER["b"]]


def test_results_are_those_of_the_function_with_any_executor(inline, tmp_path):
    result = po.sweep(swept.waves, OVER, executor=inline)
    assert (result.names, result.results, len(result), result.failed) == (("a", "b"), ("sine", "root"), 120, 0)
    assert result.table[["sine", "root"]].tolist() == expected_waves()
    assert result.table["point"].tolist() == list(range(120))
    np.testing.assert_array_equal(result.column("root"), result.table["root"])
    best, rows = result.extreme("sine", largest=True), [row[0] for row in expected_waves()]
    assert (best["sine"], best["point"], best["b"]) == (max(rows), rows.index(max(rows)), 5.0)
    for ask in (result.column, result.extreme):
        with pytest.raises(po.InputError, match="'cube' is not a column: there are a, b, sine, root"):
            ask("cube")
    with ThreadPoolExecutor(3) as threads:
        others = [po.sweep(swept.waves, OVER, executor=threads), po.sweep(swept.waves, OVER, workers=2)]
    others.append(po.Sweep.load(result.to_csv(tmp_path / "a.csv")))
    for other in others:
        assert other.table.tolist() == result.table.tolist()


def test_failures_are_rows_with_a_reason(inline, tmp_path):
    result = po.sweep(swept.failing, {"a": [0.0, 1.0, 7.0, 3.0]}, executor=inline, file=tmp_path / "deep" / "t.csv")
    reasons = [
        "ZeroDivisionError: float division by zero",
        "ValueError: one is, not allowed",
        "half = inf is not finite",
    ]
    assert result.failures == dict(zip((0, 1, 3), reasons, strict=True))
    np.testing.assert_array_equal(result.column("inverse"), [np.nan, np.nan, 1.0 / 7.0, np.nan])
    assert math.copysign(1.0, result.column("half")[2]) == -1.0
    rows = list(csv.reader((tmp_path / "deep" / "t.csv").read_text(encoding="utf-8").splitlines()))
    assert rows[0] == ["point", "a", "question", "inverse", "half", "warnings", "reason"]
    assert (rows[1][:2], rows[1][3:]) == (["0", "0.0"], ["nan", "nan", "", reasons[0]])
    assert "failed at a 0: ZeroDivisionError" in str(result)
    assert len(result.to_dataframe()) == 4


def test_a_sample_is_that_of_scipy():
    ranges = {"a": po.Range(2.0, 3.0), "b": po.Range(-7.0, 9.0), "c": po.Range(1e-3, 1e3, log=True)}
    found = points_of(ranges, 64, 5)
    unit = qmc.Sobol(3, scramble=True, seed=5).random(64)
    np.testing.assert_array_equal(found[:, :2], qmc.scale(unit[:, :2], [2.0, -7.0], [3.0, 9.0]))
    # exp(log) of numbers up to e^7 loses a few bits, compared with the power that the sample computes.
    np.testing.assert_allclose(found[:, 2], np.exp(qmc.scale(unit[:, 2:], np.log(1e-3), np.log(1e3))[:, 0]), rtol=1e-14)


REFUSED = [
    ({}, {}, "over is empty"),
    ({"a": po.Range(0.0, 1.0)}, {}, "'a': .* has no number of values"),
    (dict.fromkeys("abcd", po.Range(0.0, 1.0, 10**5)), {}, r"the grid has 1e\+20 points"),
    ({"a": po.Range(0.0, 1.0, 3)}, {"samples": 8}, "a sample fills the range"),
    ({"a": [1.0]}, {}, "two values or more"),
    ({"a": [1.0, 2.0, 1.0]}, {}, "same value twice"),
    ({"a": ["1", "2"]}, {}, "a value of 'a'"),
    ({"a": "5..45:9"}, {}, "give a po.Range or a list"),
    ({"reason": [1.0, 2.0]}, {}, "'reason' cannot name"),
    ({"=a": [1.0, 2.0]}, {}, "'=a' cannot name"),
    ({"a": [1.0, 2.0]}, {"method": "batch"}, "what and method are for problem files"),
    ({"a": [1.0, 2.0]}, {"executor": 3}, "executor = 3"),
]


@pytest.mark.parametrize(("over", "options", "expected"), REFUSED)
def test_invalid_sweeps_of_functions_are_refused(inline, over, options, expected):
    with pytest.raises(po.InputError, match=expected):
        po.sweep(len, over, **{"executor": inline} | options)


# --- the file: a row for each point; it goes on after a kill, and belongs to one sweep ---


def test_a_file_of_another_sweep_is_refused_and_left_as_it_is(inline, tmp_path):
    file, same = tmp_path / "sweep.csv", {"a": [1.0, 2.0], "b": [1.0, 2.0]}
    po.sweep(swept.waves, same, executor=inline, file=file)
    before = file.read_bytes()
    for function, over, more, expected in (
        (swept.waves, {"a": [1.0, 2.0], "c": [1.0, 2.0]}, {}, "over a, b and not a, c"),
        (swept.waves, same | {"a": [1.0, 3.0]}, {}, "with other values of a, b"),
        (swept.failing, same, {}, "of another problem, function, option or version"),
        (swept.waves, {"a": po.Range(1.0, 2.0), "b": po.Range(1.0, 2.0)}, {"samples": 4}, "with other values"),
    ):
        with pytest.raises(po.InputError, match=f"belongs to another sweep, {expected}.*: name another file"):
            po.sweep(function, over, executor=inline, file=file, **more)
    assert file.read_bytes() == before


def test_a_file_that_no_sweep_wrote_is_refused_and_left_as_it_is(inline, tmp_path):
    file = tmp_path / "sweep.csv"
    po.sweep(swept.waves, {"a": [1.0, 2.0], "b": [1.0, 2.0]}, executor=inline, file=file)
    sound, store = file.read_text(encoding="utf-8"), tmp_path / "store.db"
    with closing(sqlite3.connect(store)) as connection:
        connection.execute("CREATE TABLE meta (key, value)")
    head, first, *_ = sound.splitlines()
    for content, words in (
        (b"this is something else", "is not the file of a sweep: name another file"),
        (b"\x93\x00\xff,\n", "is not the file of a sweep: name another file"),
        (f"{head}\n{first},7\n".encode(), "holds what no sweep writes"),
        (f"{head}\n{first.replace('1.0', 'one')}\n".encode(), "holds what no sweep writes .*'one'"),
        (f"{head}\n{first.replace('1.0', '9' * 400)}\n".encode(), "a number is infinite"),
        (store.read_bytes(), "is a store of version 0.2, which this version cannot read: name a new CSV file"),
    ):
        file.write_bytes(content)
        with pytest.raises(po.InputError, match=words):
            po.Sweep.load(file)
        with pytest.raises(po.InputError, match=words):
            po.sweep(swept.waves, {"a": [1.0, 2.0], "b": [1.0, 2.0]}, executor=inline, file=file)
        assert file.read_bytes() == content
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(po.InputError, match="cannot be read"):
            po.Sweep.load(path)
    with pytest.raises(po.InputError, match=r"store of a sweep of version 0\.2"):
        po.load(store)


def test_a_line_that_a_killed_run_left_half_is_computed_again(inline, tmp_path):
    file, calls, over = tmp_path / "sweep.csv", tmp_path / "calls", {"a": [1.0, 2.0], "b": [1.0, 2.0]}
    whole = po.sweep(swept.Counted(calls), over, executor=inline, file=file).table.tolist()
    sound = file.read_text(encoding="utf-8")
    for cut in (1, 5, len(sound.splitlines()[-1])):
        calls.write_text("")
        file.write_text(sound[:-cut], encoding="utf-8")
        assert len(po.Sweep.load(file)) == 3
        assert po.sweep(swept.Counted(calls), over, executor=inline, file=file).table.tolist() == whole
        assert (file.read_text(encoding="utf-8"), len(calls.read_text().splitlines())) == (sound, 1)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for the workers in /proc")
def test_a_killed_run_goes_on_without_repeating_finished_points(script, inline, tmp_path):
    file, calls, values = tmp_path / "sweep.csv", tmp_path / "calls", 60
    over = {"a": po.Range(0.0, 1.0, values), "b": [1.0, 2.0]}
    process = script(swept.script_of(file, calls, 0.02, values))
    swept.until(lambda: len(swept.rows_of(file)) >= 10, process)
    assert np.isfinite(po.Sweep.load(file).column("sine")).all()
    workers = [
        e.name for e in Path("/proc").iterdir() if e.name.isdigit() and swept.process_of(e.name)[1] == process.pid
    ]
    assert len(workers) >= 2
    process.kill()
    process.wait()
    swept.until(lambda: all(swept.process_of(worker)[0] in "XZ" for worker in workers))
    kept = [tuple(map(float, row.split(",")[1:3])) for row in swept.rows_of(file)]
    assert 10 <= len(kept) < 2 * values

    resumed = po.sweep(swept.Counted(calls, 0.02), over, file=file, executor=inline, workers=1)
    assert (
        resumed.table[["sine", "root"]].tolist()
        == po.sweep(swept.waves, over, executor=inline).table[["sine", "root"]].tolist()
    )
    evaluated = collections.Counter(tuple(map(float, line.split())) for line in calls.read_text().splitlines())
    assert len(evaluated) == 2 * values
    assert all(evaluated[row] == 1 for row in kept)
    # Points that were computed twice were under way: four tasks for two workers, each of about 0.25 s of pauses.
    assert sum(evaluated.values()) - 2 * values <= 4 * int(0.3 / 0.02)


def test_an_executor_that_fails_ends_the_sweep_with_the_reason(tmp_path):
    ended = ThreadPoolExecutor(1)
    ended.shutdown()
    with ProcessPoolExecutor(1) as pool:
        for function, options, words in (
            (swept.kills_always, {"workers": 1}, "BrokenProcessPool"),
            (lambda _: {"x": 1.0}, {"executor": pool}, "PicklingError|AttributeError"),
            (swept.waves, {"executor": ended}, "RuntimeError: cannot schedule new futures after shutdown"),
        ):
            with pytest.raises(po.InputError, match=f"the executor failed .({words}).*goes on from its file"):
                po.sweep(function, OVER, file=tmp_path / "a.csv", **options)


# --- the same sweep on a dask cluster and on MPI ---

PAIRS = {"a": po.Range(0.0, 1.0, 30), "b": [1.0, 2.0]}


@pytest.fixture(scope="module")
def cluster():
    """Return a client of two worker processes on this machine."""
    distributed = needs("distributed")
    arguments = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(**arguments) as running, distributed.Client(running) as client:
        yield client


def test_a_cluster_gives_the_same_bits_and_goes_on_after_a_worker_has_died(cluster, inline, tmp_path):
    expected, killed = po.sweep(swept.waves, PAIRS, executor=inline).table[["sine", "root"]].tolist(), []
    workers = list(cluster.run(os.getpid).values())
    assert len({*workers, os.getpid()}) == 3

    def kill_one(_text, part):
        if part > 0.2 and not killed:
            os.kill(workers[0], signal.SIGKILL)
            killed.append(part)

    counted = swept.Counted(tmp_path / "calls", 0.02)
    options = {"executor": cluster.get_executor(), "workers": 2, "file": tmp_path / "a.csv", "progress": kill_one}
    found = po.sweep(lambda values: counted(values), PAIRS, **options)  # dask sends what cannot be imported too
    assert found.table[["sine", "root"]].tolist() == expected
    assert killed[0] < 1.0


def test_the_command_gives_the_same_results_on_a_cluster(cluster, inline, tmp_path):
    options = ("--scheduler", cluster.scheduler.address, "--csv", tmp_path / "sweep.csv")
    assert "2 points, 0 failed" in printed(*swept.COMMAND, *options)
    problem = po.read_problem(REFERENCE, ["effects.motion=false"])
    expected = po.sweep(problem, {"soil.cohesion": [1e4, 2e4]}, executor=inline)
    assert po.Sweep.load(tmp_path / "sweep.csv").column("mean_draft").tolist() == expected.column("mean_draft").tolist()


def test_the_command_reports_a_scheduler_that_does_not_answer_or_has_no_workers(monkeypatch):
    distributed = needs("distributed")
    arguments = {"n_workers": 0, "processes": False, "dashboard_address": ":0"}
    with distributed.LocalCluster(**arguments) as empty, distributed.Client(empty, set_as_default=False):
        done = call(*swept.COMMAND, "--scheduler", empty.scheduler_address)
        assert (done.status, "it has no workers; start some with: dask worker" in done.said) == (2, True)

    def silent(*_, **__):
        raise OSError("Timed out trying to connect")

    monkeypatch.setattr(distributed, "Client", silent)
    done = call(*swept.COMMAND, "--scheduler", "tcp://nowhere:1")
    assert (done.status, "no dask scheduler answers at" in done.said) == (2, True)


def test_mpi_gives_the_same_bits(script, inline, tmp_path):
    needs("mpi4py.futures")
    # The wheel of MPICH puts it beside this Python.
    launcher = shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if launcher is None:
        pytest.skip("there is no mpiexec")
    file = tmp_path / "sweep.csv"
    text = swept.script_of(file, tmp_path / "calls", 0.0, 30, "MPIPoolExecutor()")
    process = script(
        f"from mpi4py.futures import MPIPoolExecutor\n{text}",
        launcher,
        "-n",
        "2",
        sys.executable,
        "-m",
        "mpi4py.futures",
    )
    _, error = process.communicate(timeout=120)
    assert process.returncode == 0, error
    expected = po.sweep(swept.waves, PAIRS, executor=inline).table[["sine", "root"]].tolist()
    assert po.Sweep.load(file).table[["sine", "root"]].tolist() == expected
