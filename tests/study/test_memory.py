"""A sweep of very many designs takes no more memory than one of a few thousand."""

import tracemalloc

import numpy as np
import pytest
from helpers.problem_files import SUBSOILER

import plough_opt as po

OVER = {"share.wedge_angle": "25..39 deg", "share.height": "0.18..0.28 m", "scene.stiffness": "40..1000 kN/m log"}


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
        with po.sweep(problem, OVER, samples=count, method="batch", store=tmp_path / "sweep.db", progress=watch,
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
