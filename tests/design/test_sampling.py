"""The points of a search's samples, and the lines between designs that distinguish its basins."""

import numpy as np
import pytest
from helpers.small_designs import design
from scipy.stats.qmc import Sobol

from plough_opt.design.model import population
from plough_opt.design.model.program import Program
from plough_opt.design.search.landscape import Landscape, barriers, concatenated, end_straight_downhill
from plough_opt.design.search.points import MOST_DIMENSIONS, sobol_points


@pytest.mark.parametrize("n", [1, 3, MOST_DIMENSIONS, MOST_DIMENSIONS + 1])
def test_sobol_points_are_those_of_scipy(n):
    expected = Sobol(n, rng=np.random.default_rng(5)).random(128)
    assert np.array_equal(sobol_points(n, 128, np.random.default_rng(5)), expected)


@pytest.fixture(scope="module")
def two_valleys():
    """Return the landscape of ((x^2 - 1)^2 + y^2)/2 + x/10, with valleys at x near 1 and -1."""
    d, x, y = design(x=(0.5, -2.0, 2.0), y=(0.5, -2.0, 2.0))
    d.minimise(0.5 * ((x**2 - 1.0) ** 2 + y**2) + 0.1 * x + 1.0)
    none = np.empty(0)
    return Landscape(Program.of(d.declared).at(none), none)


def test_evaluation_in_small_chunks_changes_no_bit(build_r1, monkeypatch):
    program, points = Program.of(build_r1().design.declared), np.random.default_rng(3).random((30, 3))
    for together in (1, 5):
        f, g = program.population(points, np.empty(0), together=together)
        with monkeypatch.context() as patch:
            patch.setattr(population, "_MOST_RESULTS", 7 * (g.shape[1] + 2))
            in_parts = program.population(points, np.empty(0), together=together)
        np.testing.assert_array_equal(f, in_parts[0])
        np.testing.assert_array_equal(g, in_parts[1])


def at(x, y):
    return np.array([0.25 * x + 0.5, 0.25 * y + 0.5])


def test_a_barrier_separates_valleys_only(two_valleys):
    left, right, beside = (two_valleys(at(*place)[None]) for place in ((-1.0, 0.0), (1.0, 0.0), (1.2, 0.3)))
    assert barriers(two_valleys, right, concatenated([left, beside])).tolist() == [True, False]


def test_a_design_belongs_to_the_end_straight_downhill(two_valleys):
    # The zeros of the slope 2 x (x^2 - 1) + 0.1.
    left, _, right = np.sort(np.roots([2.0, 0.0, -2.0, 0.1]).real)
    ends = two_valleys(np.array([at(left, 0.0), at(right, 0.0)]))
    assert end_straight_downhill(two_valleys, at(1.5, 1.0), ends) == 1
    assert end_straight_downhill(two_valleys, at(-0.5, -1.9), ends) == 0
    # This start is nearer to the right valley, but beyond the ridge at x = 0.05.
    assert end_straight_downhill(two_valleys, at(-0.01, 0.0), ends) == 0
    assert end_straight_downhill(two_valleys, at(1.5, 1.0), ends.select([0])) is None
