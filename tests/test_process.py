"""A process: the processors it may use, and CasADi's notices, which a stream of the commands drops."""

import io
import itertools
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from rich.console import Console

import plough_opt as po
from plough_opt.core.process import Sieve, available, progress_on, without_notices


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system has no processor affinity")
def test_the_affinity_of_the_process_counts():
    code = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from plough_opt.core.process import available; print(available())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1"]


def seen(_values):
    return {"processors": float(available())}


def test_a_worker_of_a_sweep_keeps_one_processor_busy_and_the_sweep_leaves_no_trace(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(os, "process_cpu_count", lambda: 8, raising=False)
    with ThreadPoolExecutor(2) as threads:
        found = po.sweep(seen, {"a": [1.0, 2.0, 3.0]}, executor=threads, workers=2)
        assert set(found.column("processors").tolist()) == {1.0}
        assert threads.submit(available).result() == 8
    assert available() == 8


def test_runs_of_a_design_use_the_available_processors(monkeypatch, r1_scene):
    asked = []
    monkeypatch.setattr("plough_opt.design.model.nlp.available", lambda: asked.append(1) or 1)
    design = po.Design()
    height = design.variable("height", guess=0.25, lower=0.1, upper=0.5)
    runs = [po.simulate(r1_scene(height=height, stiffness=k), 0.2) for k in (4e4, 5e4)]
    design.minimise(sum(run.mean_draft for run in runs))
    design.require("radius", r1_scene(height=height).loosened_radius, at_least=0.12)
    design.solve(search="local")
    assert asked


NOTICE = 'CasADi - 2026-01-01 00:00:00 WARNING("Event support is experimental") [.../core/integrator.cpp:755]\n'
OTHER = 'CasADi - 2026-01-01 00:00:00 WARNING("Something else") [.../core/function.cpp:1]\n'


@pytest.mark.parametrize("cuts", [(), (9, 40, 60)])
def test_the_notice_is_dropped_even_in_pieces_and_other_output_passes(cuts):
    stream = io.StringIO()
    sieve = Sieve(stream)
    pieces = [NOTICE[i:j] for i, j in itertools.pairwise([0, *cuts, len(NOTICE)])]
    for piece in ("before\n", *pieces, OTHER[:20], OTHER[20:], "no end of a line"):
        assert sieve.write(piece) == len(piece)
    assert stream.getvalue() == f"before\n{OTHER}no end of a line"


def test_pieces_of_different_threads_do_not_mix():
    stream = io.StringIO()
    sieve = Sieve(stream)
    with ThreadPoolExecutor(1) as other:
        sieve.write(NOTICE[:50])
        other.submit(sieve.write, OTHER).result()
        sieve.write(NOTICE[50:])
    assert stream.getvalue() == OTHER


def test_a_process_without_an_error_stream_needs_no_sieve(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    with without_notices():
        assert sys.stderr is None


def test_progress_on_a_terminal_is_a_bar():
    terminal = Console(file=io.StringIO(), force_terminal=True, color_system=None)
    with progress_on(terminal) as show:
        show("half of it", 0.5)
    assert f"half of it {12 * '━'} " in terminal.file.getvalue()  # of 24
