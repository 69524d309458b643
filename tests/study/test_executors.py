"""The same sweep on a dask cluster, one of whose workers is killed, and on MPI."""

import asyncio
import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import CancelledError, Future
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import swept
from helpers.commands import call, printed
from helpers.problem_files import REFERENCE

import plough_opt as po
from plough_opt.studies.sweep import pool as clusters
from plough_opt.studies.sweep.pool import WorkerDied

OVER = {"a": po.Range(0.0, 1.0, 30), "b": [1.0, 2.0]}


@pytest.fixture(scope="module")
def cluster():
    """Return a client of two worker processes on this machine."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
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
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", Mock(side_effect=OSError("Timed out trying to connect")))
    done = call(*swept.COMMAND, "--store", tmp_path / "sweep.db", "--scheduler", "tcp://nowhere:1")
    assert (done.status, "no dask scheduler answers at" in done.said) == (2, True)


def test_a_cluster_without_workers_ends_the_sweep(monkeypatch):
    distributed = pytest.importorskip("distributed")
    # With these constants it takes less than a minute, the last check and its answer included.
    assert clusters._PATIENCE + 2.0 * clusters._CHECK_EVERY < 60.0
    monkeypatch.setattr(clusters, "_PATIENCE", 0.7)
    monkeypatch.setattr(clusters, "_CHECK_EVERY", 0.5)
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
    asyncio.run(clusters._carry(fetched(), future))
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
    pytest.importorskip("mpi4py.futures", reason="mpi4py is not installed")
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
