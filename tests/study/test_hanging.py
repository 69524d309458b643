"""Workers that hang are replaced, those whose parent has died are quiet, and none imports from the current folder."""

import math
import multiprocessing.spawn
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers import swept

import plough_opt as po
from plough_opt.studies.sweep import engine, pool


def test_a_point_that_hangs_fails_and_the_others_are_computed(tmp_path):
    with po.sweep(swept.hangs_at_two, {"a": np.arange(5.0)}, workers=1, limit=1.5, store=tmp_path / "s.db") as found:
        assert found.table["sine"].tolist()[3:] == [math.sin(3.0), math.sin(4.0)]
        (failure,) = found.failures
        assert failure.point == 2
        assert "no result after 1.5 s" in failure.reason
        assert "--limit" in failure.reason
        assert (found.complete, list(found.undetermined)) == (True, [])


def test_a_worker_that_hangs_before_it_begins_ends_the_sweep(monkeypatch):
    monkeypatch.setattr(pool, "_START", 1.0)
    monkeypatch.setattr(pool, "_command", lambda: [sys.executable, "-c", "import time; time.sleep(60.0)"])
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
    with subprocess.Popen(pool._command(), stdin=pipe, stdout=pipe, stderr=pipe) as worker:
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


class Sizes:
    """An evaluation of many points that records the sizes of its tasks."""

    results = ("x",)

    def __init__(self):
        self.seen = []

    def many(self, values):
        self.seen.append(len(values))
        return values.copy(), {}, []


def test_tasks_of_a_slow_batch_do_not_shrink(monkeypatch):
    monkeypatch.setattr(engine, "_TASK_SECONDS", 0.0)  # as if a design took hours
    sizes = Sizes()
    with ThreadPoolExecutor(1) as executor:
        po.sweep(sizes, {"a": po.Range(0.0, 1.0, 2048)}, executor=executor, workers=1).close()
    assert sizes.seen == [64] * 32
