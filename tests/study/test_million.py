"""A sweep of a million designs takes no more memory than one of a few thousand."""

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import plough_opt as po

COTTON = Path(__file__).resolve().parents[2] / "problems" / "cotton_subsoiler.toml"
OVER = {"share.wedge_angle": "25..39 deg", "share.height": "0.18..0.28 m", "scene.stiffness": "40..1000 kN/m log"}


def test_memory_does_not_grow_with_the_points(tmp_path, inline):
    problem, count = po.read_problem(COTTON, ("scene.duration=0.1 s",)), 2**12
    peaks = []

    def watch(stored, total, failed):
        peaks.append((stored, tracemalloc.get_traced_memory()[1]))
        tracemalloc.reset_peak()
        assert (total, failed) == (count, 0)

    options = {"samples": count, "method": "batch", "store": tmp_path / "sweep.db", "executor": inline, "workers": 1}
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
    # Two tasks may overlap: the arrays of a second one, 2048 rows of about 20 numbers, are not growth.
    one_task = 2048 * 20 * 8 * 8
    assert late < early + one_task
    assert written < early + one_task


MILLION = """
import json, resource, sys
import plough_opt as po

def used():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)

if __name__ == "__main__":
    path, over, folder = json.loads(sys.stdin.read())
    early = []
    def watch(stored, count, failed):
        if stored < count // 8:
            early[:] = [used()]
    with po.sweep(po.read_problem(path), over, samples=2**20, store=f"{folder}/sweep.db", progress=watch) as found:
        found.to_csv(f"{folder}/sweep.csv")
        found.to_npz(f"{folder}/sweep.npz")
        print(json.dumps([len(found), found.failed, *early, used(), found.question["computed"]]))
"""


@pytest.mark.slow
def test_a_million_designs_in_flat_memory(script, tmp_path):
    pytest.importorskip("resource", reason="this system does not report the memory of a process")
    process = script(MILLION, stdin=-1)
    out, error = process.communicate(json.dumps([str(COTTON), OVER, str(tmp_path)]), timeout=1800)
    assert process.returncode == 0, error
    count, failed, early, late, computed = json.loads(out)
    assert (count, failed) == (2**20, 0)
    assert "po.Batch" in computed
    # MiB in the main process: SQLite's cache of 2 MiB and the buffers of the tables.
    assert late < early + 16.0
    with np.load(tmp_path / "sweep.npz") as arrays:
        assert arrays["mean_draft"].shape == (2**20,)
        assert np.isfinite(arrays["mean_draft"]).all()
