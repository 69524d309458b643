"""Processors: what a process is given counts, not what the machine has, and beside other workers it is one."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

import plough_opt as po
from plough_opt.core import process as processors

OWN_LIMIT = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from plough_opt.core.process import available
print(available())
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system knows no affinity")
def test_the_affinity_of_the_process_counts():
    done = subprocess.run([sys.executable, "-c", OWN_LIMIT], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1"]


def seen(_values):
    return {"processors": float(processors.available())}


def test_a_worker_of_a_sweep_keeps_one_processor_busy_and_the_sweep_leaves_no_trace(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(os, "process_cpu_count", lambda: 8, raising=False)
    with ThreadPoolExecutor(2) as threads:
        found = po.sweep(seen, {"a": [1.0, 2.0, 3.0]}, executor=threads, workers=2)
        assert set(found.column("processors").tolist()) == {1.0}
        assert threads.submit(processors.available).result() == 8
    assert processors.available() == 8


def test_runs_of_a_design_take_the_processors_that_there_are(monkeypatch, r1_scene):
    asked = []
    monkeypatch.setattr("plough_opt.design.nlp.available", lambda: asked.append(1) or 1)
    design = po.Design()
    height = design.variable("height", guess=0.25, lower=0.1, upper=0.5)
    runs = [po.simulate(r1_scene(height=height, stiffness=k), 0.2) for k in (4e4, 5e4)]
    design.minimise(sum(run.mean_draft for run in runs))
    design.require("radius", r1_scene(height=height).loosened_radius, at_least=0.12)
    design.solve(search="local")
    assert asked
