"""Workers that are killed, hang or cannot begin, here, on a dask cluster and on MPI: no point is lost or repeated."""

import asyncio
import contextlib
import math
import multiprocessing.spawn
import os
import pickle
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError, Future
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import swept
from helpers.commands import call, printed
from helpers.extras import needs
from helpers.problem_files import REFERENCE

import plough_opt as po
from plough_opt.studies.sweep import engine
from plough_opt.studies.sweep import pool as pools
from plough_opt.studies.sweep.pool import ProcessPool, WorkerDied, environment

# --- workers that are killed at any moment, hang or cannot begin: no point is lost, repeated or wrongly called failed

by_proc = pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the workers in /proc")


@contextlib.contextmanager
def killing(seed, pauses, most):
    """Kill workers of this process at random moments, in random order; yield those killed."""
    rng, killed, stopped = random.Random(seed), [], threading.Event()

    def run():
        while len(killed) < most and not stopped.wait(rng.uniform(*pauses)):
            # A killed worker is listed until the pool has noticed its end.
            if there := sorted(set(swept.workers_of(os.getpid())) - set(killed)):
                killed.append(rng.choice(there))
                os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield killed
    finally:
        stopped.set()
        thread.join()


SERIES = [(1, 60, 6), *(pytest.param(seed, 450, 60, marks=pytest.mark.slow) for seed in range(2, 8))]


@by_proc
@pytest.mark.parametrize(("seed", "values", "kills"), SERIES)
def test_killed_workers_do_not_change_the_table(inline, tmp_path, seed, values, kills):
    began = time.monotonic()
    with ProcessPool(1, swept.waves) as pool:
        pool.submit(math.sqrt, 4.0).result(60.0)
    start = time.monotonic() - began
    pauses = (0.05 * start, 3.0 * start)  # some die before they have started, others at work
    over = {"a": po.Range(0.0, 1.0, values), "b": [1.0, 2.0]}
    truth = po.sweep(swept.waves, over, executor=inline).table
    counted, store = swept.Counted(tmp_path / "calls", 0.02), tmp_path / "sweep.db"
    with killing(seed, pauses, kills) as killed, po.sweep(counted, over, workers=2, store=store) as found:
        np.testing.assert_array_equal(found.table, truth)
        assert (found.failed, list(found.undetermined), found.complete) == (0, [], True)
    assert killed
    assert swept.stored(store) == [(point,) for point in range(2 * values)]


def test_a_point_that_kills_three_workers_is_undetermined_until_a_retry(tmp_path):
    deadly, store = swept.Deadly(tmp_path / "died"), tmp_path / "sweep.db"
    with po.sweep(deadly, {"a": np.arange(8.0)}, workers=1, store=store) as found:
        (one,) = found.undetermined
        assert (one.point, one.values) == (5, {"a": 5.0})
        assert "3 workers ended while each worked on this point alone; the last ended by signal 9" in one.reason
        assert (found.failed, list(found.failures), found.complete) == (0, [], True)
        expected = [math.nan if a == 5.0 else 2.0 * math.sin(a) for a in range(8)]
        np.testing.assert_array_equal(found.column("sine"), expected)
        assert '\n"5","5.0","","","undetermined: 3 workers' in found.to_csv(tmp_path / "t.csv").read_text()
        with np.load(found.to_npz(tmp_path / "t.npz")) as arrays:
            assert (arrays["undetermined"].tolist(), arrays["failed"].tolist()) == ([5], [])
    # Two deaths of the whole task, three on the way to a single point at most, and three alone.
    assert (tmp_path / "died").read_text().count("5.0") <= 3 + 2 + 3
    (tmp_path / "cured").touch()
    with po.sweep(deadly, {"a": np.arange(8.0)}, workers=1, store=store) as found:
        assert len(list(found.undetermined)) == 1
    for already in (7, 8):
        with po.sweep(deadly, {"a": np.arange(8.0)}, workers=1, store=store, retry=True) as found:
            assert (found.already, list(found.undetermined)) == (already, [])
            assert found.column("sine").tolist() == [2.0 * math.sin(a) for a in range(8)]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_sweep_whose_workers_all_die_or_cannot_begin_ends_with_the_reason(monkeypatch):
    assert pools._PATIENCE == 40.0  # as docs/howto/sweeps.md says
    monkeypatch.setattr(pools, "_PATIENCE", 0.5)
    for evaluation, command, words in (
        (swept.Unreadable(), pools._command, "the worker processes could not begin: RuntimeError: not here"),
        (swept.kills_always, pools._command, r"processes ended within \d+ s before .* by signal 9 \(Killed\)"),
        (swept.waves, lambda: ["/none"], r"processes ended within \d+ s before .* could not be started \(.*/none"),
        (swept.waves, [].pop, "the worker processes cannot be kept at work: IndexError"),
    ):
        monkeypatch.setattr(pools, "_command", command)
        with pytest.raises(po.InputError, match=words):
            po.sweep(evaluation, {"a": np.arange(64.0)}, workers=1)


@by_proc
def test_workers_end_with_the_pool_and_print_to_the_error_stream(capfd):
    before = set(swept.workers_of(os.getpid()))
    with ProcessPool(1, swept.waves) as pool:
        pool.submit(print, "from inside").result(60.0)
        pool.submit(os.system, "echo from a child").result(60.0)
        assert str(pool.submit(swept.refuse).exception(60.0)) == "RuntimeError: not here"
        pool.submit(time.sleep, 1.0)
        assert pool.submit(print, "cancelled").cancel()
        # The next call goes to the successor of an idle worker that has died.
        worker = pool.submit(os.getpid).result(60.0)
        os.kill(worker, signal.SIGKILL)
        os.waitid(os.P_PID, worker, os.WEXITED | os.WNOWAIT)
        # A worker that has begun may sweep itself.
        assert pool.submit(swept.sweep_waves).result(60.0) == [math.sqrt(b) / 3.0 for b in (2.0, 8.0, 2.0, 8.0)]
    assert set(swept.workers_of(os.getpid())) <= before
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


def test_a_point_that_hangs_fails_and_the_others_are_computed(tmp_path):
    with po.sweep(swept.hangs_at_two, {"a": np.arange(5.0)}, workers=1, limit=1.5, store=tmp_path / "s.db") as found:
        assert found.table["sine"].tolist()[3:] == [math.sin(3.0), math.sin(4.0)]
        (failure,) = found.failures
        assert failure.point == 2
        assert "no result after 1.5 s" in failure.reason
        assert "--limit" in failure.reason
        assert (found.complete, list(found.undetermined)) == (True, [])


def test_a_worker_that_hangs_before_it_begins_ends_the_sweep(monkeypatch):
    monkeypatch.setattr(pools, "_START", 1.0)
    monkeypatch.setattr(pools, "_command", lambda: [sys.executable, "-c", "import time; time.sleep(60.0)"])
    with pytest.raises(po.InputError, match="could not begin: they were not ready after 1 s"):
        po.sweep(swept.waves, {"a": [1.0, 2.0]}, workers=1)


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, "soon", True])
def test_limits_that_are_none_are_refused(limit):
    with pytest.raises(po.InputError, match="limit"):
        po.sweep(swept.waves, {"a": [1.0, 2.0]}, limit=limit)


def test_a_limit_is_for_processes_of_this_machine(inline):
    with pytest.raises(po.InputError, match="limit is for the processes of this machine"):
        po.sweep(swept.waves, {"a": [1.0, 2.0]}, limit=1.0, executor=inline)


def test_a_worker_whose_parent_has_died_ends_without_a_traceback():
    script = multiprocessing.spawn.get_preparation_data("worker of a sweep")
    script = {name: script[name] for name in ("sys_path", "dir", "name")}
    pipe = subprocess.PIPE
    with subprocess.Popen(pools._command(), stdin=pipe, stdout=pipe, stderr=pipe) as worker:
        worker.stdout.close()  # the pipe to the worker stays open, so that it notices the other one first
        pickle.dump((script, pickle.dumps(swept.waves)), worker.stdin)
        worker.stdin.flush()
        assert worker.stderr.read() == b""
        assert worker.wait() == 1


def test_neither_command_nor_workers_import_from_the_current_folder(tmp_path):
    # Python itself imports these before any code of the package runs.
    command = [sys.executable, "-c", "import runpy, sys; print(*sys.modules)"]
    earlier = {name.partition(".")[0] for name in subprocess.check_output(command, text=True).split()}
    for name in {*sys.stdlib_module_names, "numpy", "casadi", "rich", "pydantic"} - earlier - {"__main__"}:
        (tmp_path / f"{name}.py").write_text("raise ImportError('from the current folder')")
    command = [sys.executable, "-m", "plough_opt", *swept.COMMAND, "--workers", "1", "--limit", "60"]
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("Error")) == (0, 0), done.stderr
    assert "2 points, 0 failed" in done.stdout


def test_tasks_of_a_slow_batch_do_not_shrink(inline, monkeypatch):
    monkeypatch.setattr(engine, "_TASK_SECONDS", 0.0)  # as if a design took hours
    sizes = []
    many = SimpleNamespace(results=("x",), many=lambda values: sizes.append(len(values)) or (values.copy(), {}, []))
    po.sweep(many, {"a": po.Range(0.0, 1.0, 2048)}, executor=inline, workers=1).close()
    assert sizes == [64] * 32


# --- the same sweep on a dask cluster, one of whose workers is killed, and on MPI ---

OVER = {"a": po.Range(0.0, 1.0, 30), "b": [1.0, 2.0]}


@pytest.fixture(scope="module")
def cluster():
    """Return a client of two worker processes on this machine."""
    distributed = needs("distributed")
    arguments = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(**arguments) as running, distributed.Client(running) as client:
        yield client


def test_a_cluster_that_loses_a_worker_midway_gives_the_same_bits(cluster, inline, tmp_path):
    workers, killed = list(cluster.run(os.getpid).values()), []
    assert len({*workers, os.getpid()}) == 3
    counted, store = swept.Counted(tmp_path / "calls", 0.02), tmp_path / "sweep.db"

    def kill_one(stored, count, failed):
        if stored >= 15 and not killed:
            os.kill(workers[0], signal.SIGKILL)
            killed.append((stored, failed))
        assert count == 60

    options = {"executor": cluster.get_executor(pure=False), "workers": 2, "store": store, "progress": kill_one}
    with po.sweep(lambda values: counted(values), OVER, **options) as found:  # a lambda cannot be imported
        assert (found.complete, found.failed) == (True, 0)
        np.testing.assert_array_equal(found.table, po.sweep(swept.waves, OVER, executor=inline).table)
    assert killed[0][0] < 60


def test_the_command_gives_the_same_results_on_a_cluster(cluster, inline, tmp_path):
    options = ("--scheduler", cluster.scheduler.address, "--store", tmp_path / "sweep.db")
    assert "2 points, 0 failed" in printed(*swept.COMMAND, *options)
    problem = po.read_problem(REFERENCE, ["effects.motion=false"])
    expected = po.sweep(problem, {"soil.cohesion": [1e4, 2e4]}, executor=inline).table
    np.testing.assert_array_equal(po.Sweep.load(tmp_path / "sweep.db").table, expected)


def test_the_command_reports_a_scheduler_that_does_not_answer(monkeypatch, tmp_path):
    distributed = needs("distributed")
    monkeypatch.setattr(distributed, "Client", Mock(side_effect=OSError("Timed out trying to connect")))
    done = call(*swept.COMMAND, "--store", tmp_path / "sweep.db", "--scheduler", "tcp://nowhere:1")
    assert (done.status, "no dask scheduler answers at" in done.said) == (2, True)


def test_a_cluster_without_workers_ends_the_sweep(monkeypatch):
    distributed = needs("distributed")
    # With these constants it takes less than a minute, the last check and its answer included.
    assert pools._PATIENCE + 2.0 * pools._CHECK_EVERY < 60.0
    monkeypatch.setattr(pools, "_PATIENCE", 0.7)
    monkeypatch.setattr(pools, "_CHECK_EVERY", 0.5)
    arguments = {"n_workers": 0, "processes": False, "dashboard_address": ":0"}
    with distributed.LocalCluster(**arguments) as empty, distributed.Client(empty, set_as_default=False) as client:
        done = call(*swept.COMMAND, "--scheduler", empty.scheduler_address)
        assert (done.status, "it has no workers; start some with: dask worker" in done.said) == (2, True)
        executor = client.get_executor(pure=False)
        with pytest.raises(po.InputError, match=r"the cluster has had no workers for \d s: start some; finished"):
            po.sweep(swept.waves, OVER, executor=executor, workers=1)


class KilledWorker(Exception):  # name and attribute as in dask
    allowed_failures = 3


ERRORS = [
    (KilledWorker(), WorkerDied, "dask does not say how"),
    (CancelledError(), po.InputError, "scheduler is gone"),
    (asyncio.CancelledError(), po.InputError, "scheduler is gone"),
    (ZeroDivisionError("by zero"), ZeroDivisionError, "by zero"),
]


@pytest.mark.parametrize(("error", "kind", "words"), ERRORS)
def test_a_result_that_cannot_be_fetched_ends_its_task(error, kind, words):
    async def fetched():
        raise error

    future = Future()
    asyncio.run(pools._carry(fetched(), future))
    with pytest.raises(kind, match=words) as raised:
        future.result(0.0)
    assert getattr(raised.value, "deaths", 4) == 4


@pytest.mark.slow  # a cluster takes seconds to replace a worker
def test_a_point_that_kills_the_workers_of_a_cluster_is_undetermined(cluster, tmp_path):
    cluster.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
    executor = cluster.get_executor(pure=False)
    with po.sweep(swept.Deadly(tmp_path / "died"), {"a": np.arange(8.0)}, executor=executor, workers=2) as found:
        assert [one.point for one in found.undetermined] == [5]
        assert found.failed == 0
        assert found.column("sine").tolist()[6:] == [2.0 * np.sin(6.0), 2.0 * np.sin(7.0)]


@pytest.mark.slow
def test_mpi_gives_the_same_bits(script, inline, tmp_path):
    needs("mpi4py.futures")
    # The wheel of MPICH puts it beside this Python.
    launcher = shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if launcher is None:
        pytest.skip("there is no mpiexec")
    store, file = tmp_path / "sweep.db", tmp_path / "calls"
    text = swept.script_of(store, file, 0.0, 30, "MPIPoolExecutor()")
    # A second sweep of the script uses processes of its own, which do not join the MPI job.
    text = f"from mpi4py.futures import MPIPoolExecutor\n{text}    print(len(sweep(counted, over, workers=1)))\n"
    process = script(text, launcher, "-n", "2", sys.executable, "-m", "mpi4py.futures")
    out, error = process.communicate(timeout=120)
    assert (process.returncode, out) == (0, "60\n"), error
    np.testing.assert_array_equal(po.Sweep.load(store).table, po.sweep(swept.waves, OVER, executor=inline).table)


SESSION = """
import sys
sys.modules.update(dict.fromkeys(sys.argv[2:]))  # modules that cannot be imported
import plough_opt as po
factor, over = 3.0, {"x": [1.0, 2.0]}
def response(values):
    return {"y": factor * values["x"]}
for task in (response, lambda values: response(values)):
    with po.sweep(task, over, workers=1, store=sys.argv[1]) as found:
        print(found.table["y"], found.failed)
    factor = 4.0  # another function, so another sweep
    sys.argv[1] += "2"
"""


@pytest.mark.parametrize("absent", [[], ["cloudpickle"]])
def test_a_function_of_an_interactive_session_is_swept_or_refused_before_a_worker_starts(absent, tmp_path):
    command = [sys.executable, "-c", SESSION, str(tmp_path / "sweep.db"), *absent]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if absent:
        assert "InputError" in done.stderr
        assert "install cloudpickle" in done.stderr
    else:
        assert (done.stdout, done.stderr) == ("[3. 6.] 0\n[4. 8.] 0\n", "")
