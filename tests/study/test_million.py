"""A million simulated designs stream through: no more memory than a few thousand take."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import plough_opt as po

COTTON = Path(__file__).resolve().parents[2] / "problems" / "cotton_subsoiler.toml"
OVER = {"share.wedge_angle": "25..39 deg", "share.height": "0.18..0.28 m", "scene.stiffness": "40..1000 kN/m log"}


@pytest.mark.parametrize(
    ("count", "brief"),
    [
        (2**12, ("scene.duration=0.1 s",)),
        pytest.param(2**20, (), marks=pytest.mark.slow),
    ],
    ids=("thinned", "in full"),
)
def test_memory_does_not_grow_with_the_points(count, brief, tmp_path, inline):
    problem = po.read_problem(COTTON, brief)
    options = {"samples": count, "method": "batch", "store": tmp_path / "sweep.db"}
    # In full by processes; one thread of this process is enough to see what the sweep itself holds.
    options |= {"executor": inline, "workers": 1} if count < 2**20 else {}
    peaks = []

    def watch(stored, total, failed):
        peaks.append((stored, tracemalloc.get_traced_memory()[1]))
        tracemalloc.reset_peak()
        assert (total, failed) == (count, 0)

    tracemalloc.start()
    try:
        with po.sweep(problem, OVER, progress=watch, **options) as found:
            found.to_csv(tmp_path / "sweep.csv")
            found.to_npz(tmp_path / "sweep.npz")
            written = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    early = max(peak for stored, peak in peaks if stored <= count // 4)
    late = max(peak for stored, peak in peaks if stored > count // 4)
    # A task's arrays come and go in any order: one more of them at once, 2048 rows of some 20 numbers, is no growth.
    one_task = 2048 * 20 * 8 * 8
    assert late < early + one_task
    assert written < early + one_task
    with np.load(tmp_path / "sweep.npz", mmap_mode="r") as arrays:
        assert arrays["mean_draft"].shape == (count,)
        assert np.isfinite(arrays["mean_draft"]).all()
