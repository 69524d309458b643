"""The points of a search's samples, and the ways between designs by which its basins are told apart."""

import warnings

import numpy as np
import pytest
from scipy.stats.qmc import Sobol

import plough_opt as po
from plough_opt.design import population
from plough_opt.design.landscape import Landscape, barriers, concatenated, end_straight_downhill
from plough_opt.design.sampling import MOST_DIMENSIONS, local_minima, sobol_points


@pytest.mark.parametrize("n", range(1, MOST_DIMENSIONS + 2))
def test_unscrambled_points_are_those_of_scipy(n, monkeypatch):
    class Zeros:
        """Scrambles nothing: the shift is 0 and the mixing matrix 1."""

        def spawn(self, _count):
            return [self]

        def integers(self, _high, size, dtype):
            return np.zeros(size, dtype)

    if n > MOST_DIMENSIONS:
        monkeypatch.setattr("scipy.stats.qmc.Sobol", lambda n, **_: Sobol(n, scramble=False))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a hundred is not a power of two
        assert np.array_equal(sobol_points(n, 100, Zeros()), Sobol(n, scramble=False).random(100))


@pytest.mark.parametrize("n", [1, 3, MOST_DIMENSIONS])
def test_scrambled_points_fill_every_slice_of_every_dimension_once(n):
    points = sobol_points(n, 256, np.random.default_rng(5))
    assert np.array_equal(np.sort(np.floor(256.0 * points), axis=0), np.tile(np.arange(256.0)[:, None], n))
    assert not np.array_equal(points, sobol_points(n, 256, np.random.default_rng(6)))


@pytest.fixture(scope="module")
def two_valleys():
    """Return the landscape of ((x^2 - 1)^2 + y^2)/2 + x/10, with valleys at x near 1 and -1."""
    d = po.Design()
    x, y = (d.variable(name, guess=0.5, lower=-2.0, upper=2.0) for name in "xy")
    d.minimise(0.5 * ((x**2 - 1.0) ** 2 + y**2) + 0.1 * x + 1.0)
    d.solve(search="near")
    return Landscape(d._program, np.empty(0))


def test_the_lowest_designs_of_a_grid_are_its_dips():
    grid = np.linspace(0.0, 1.0, 200)
    merit = grid + np.sin(20.0 * grid)
    lowest, downhill = local_minima(grid[:, None], merit)
    wall = np.r_[np.inf, merit, np.inf]
    dips = np.flatnonzero((merit < wall[:-2]) & (merit < wall[2:]))
    assert lowest.tolist() == dips[np.argsort(merit[dips])].tolist()
    # From every point a walk downhill over neighbours ends in one of them.
    assert set(downhill.tolist()) == set(dips.tolist())
    assert np.all(np.diff(downhill) >= 0)


def test_few_results_in_memory_at_once_change_no_bit(build_r1, program_of, monkeypatch):
    program, points = program_of(build_r1().design), np.random.default_rng(3).random((30, 3))
    for together in (1, 5):
        f, g = program.population(points, np.empty(0), together=together)
        with monkeypatch.context() as patch:
            patch.setattr(population, "_MOST_RESULTS", 7 * (g.shape[1] + 2))
            in_parts = program.population(points, np.empty(0), together=together)
        np.testing.assert_array_equal(f, in_parts[0])
        np.testing.assert_array_equal(g, in_parts[1])


def at(x, y):
    return np.array([0.25 * x + 0.5, 0.25 * y + 0.5])


def test_a_barrier_parts_valleys_and_nothing_else(two_valleys):
    left, right, beside = (two_valleys(at(*place)[None]) for place in ((-1.0, 0.0), (1.0, 0.0), (1.2, 0.3)))
    assert barriers(two_valleys, right, concatenated([left, beside])).tolist() == [True, False]


def test_a_design_belongs_to_the_end_to_which_it_falls_straight(two_valleys):
    # Where the slope 2 x (x^2 - 1) + 0.1 is none.
    left, _, right = np.sort(np.roots([2.0, 0.0, -2.0, 0.1]).real)
    ends = two_valleys(np.array([at(left, 0.0), at(right, 0.0)]))
    assert end_straight_downhill(two_valleys, at(1.5, 1.0), ends) == 1
    assert end_straight_downhill(two_valleys, at(-0.5, -1.9), ends) == 0
    # Beyond the ridge at x = 0.05 the other valley is nearer, and behind it.
    assert end_straight_downhill(two_valleys, at(-0.01, 0.0), ends) == 0
    assert end_straight_downhill(two_valleys, at(1.5, 1.0), ends.select([0])) is None
