"""Points of grids and samples, against itertools, NumPy and SciPy; and invalid sweeps of functions."""

import itertools

import numpy as np
import pytest
from scipy.stats import qmc

import plough_opt as po
from plough_opt.studies.sweep.points import PointGrid, PointSample


def test_a_grid_has_all_combinations_and_the_last_quantity_changes_fastest():
    grid = PointGrid({"a": (1.0, 2.5, 7.0), "b": po.Range(-1.0, 1.0, 4), "c": po.Range(1.0, 1000.0, 3, log=True)})
    expected = list(itertools.product((1.0, 2.5, 7.0), np.linspace(-1, 1, 4), np.geomspace(1, 1000, 3)))
    assert grid.count == len(expected)
    np.testing.assert_array_equal(grid.block(0, grid.count), expected)
    np.testing.assert_array_equal(grid.block(5, 17), expected[5:17])


def test_a_grid_of_a_trillion_points_needs_no_memory():
    grid = PointGrid({"a": po.Range(0.0, 1.0, 10**6), "b": po.Range(0.0, 1.0, 10**6)})
    np.testing.assert_array_equal(grid.block(10**12 - 1, 10**12), [[1.0, 1.0]])


# As sweeps request them: forwards, with gaps, and back for what another run abandoned.
BLOCKS = ([(0, 64)], [(0, 1), (1, 4), (4, 64)], [(0, 3), (10, 20), (3, 10), (20, 64)])


@pytest.mark.parametrize("blocks", BLOCKS, ids=("whole", "pieces", "holes"))
def test_a_sample_is_that_of_scipy(blocks):
    ranges = {"a": po.Range(2.0, 3.0), "b": po.Range(-7.0, 9.0), "c": po.Range(1e-3, 1e3, log=True)}
    sample = PointSample(ranges, 64, seed=5)
    found = np.empty((64, 3))
    for first, last in blocks:
        found[first:last] = sample.block(first, last)
    unit = qmc.Sobol(3, scramble=True, seed=5).random(64)
    np.testing.assert_array_equal(found[:, :2], qmc.scale(unit[:, :2], [2.0, -7.0], [3.0, 9.0]))
    # exp(log) of numbers up to e^7 loses a few bits, compared with the power that the sample computes.
    np.testing.assert_allclose(found[:, 2], np.exp(qmc.scale(unit[:, 2:], np.log(1e-3), np.log(1e3))[:, 0]), rtol=1e-14)


REFUSED = [
    ({}, {}, "over is empty"),
    ({"a": po.Range(0.0, 1.0)}, {}, "'a': .* has no number of values"),
    (dict.fromkeys("abcd", po.Range(0.0, 1.0, 10**5)), {}, r"the grid has 1e\+20 points"),
    ({"a": po.Range(0.0, 1.0, 3)}, {"samples": 8}, "a sample fills the range"),
    ({"a": (0.0, 1.0)}, {"samples": 8}, "a range with two ends"),
    ({"a": po.Range(0.0, 1.0)}, {"samples": 1}, "1 samples: give a whole number from 2"),
    ({"a": po.Range(0.0, 1.0)}, {"samples": 8, "seed": -1}, "seed = -1"),
    ({"a": [1.0]}, {}, "1 value"),
    ({"a": [1.0, 2.0, 1.0]}, {}, "same value twice"),
    ({"a": [1.0, float("nan")]}, {}, "must be finite"),
    ({"a": ["1", "2"]}, {}, "not all numbers"),
    ({"a": "5..45:9"}, {}, "give a po.Range or a list"),
    ({"a": [1.0, 2.0], "A": [1.0, 2.0]}, {}, "'a' cannot name"),
    ({"reason": [1.0, 2.0]}, {}, "'reason' cannot name"),
    ({"": [1.0, 2.0]}, {}, "'' cannot name"),
]


@pytest.mark.parametrize(("over", "options", "expected"), REFUSED)
def test_invalid_sweeps_of_functions_are_refused(inline, over, options, expected):
    with pytest.raises(po.InputError, match=expected):
        po.sweep(len, over, **{"executor": inline} | options)
