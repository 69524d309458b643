"""Domination, gaps, area and knee of points in a plane, against brute force and closed forms."""

import numpy as np
import pytest

from plough_opt.studies.tradeoff.domination import in_order, knee, volume
from plough_opt.studies.tradeoff.positions import gaps, spread


def test_efficient_rows_are_those_that_brute_force_finds():
    rng = np.random.default_rng(1)
    points = rng.random((300, 2))
    beaten = [any(np.all(other < point) for other in points) for point in points]
    found = in_order(points)
    assert sorted(found) == np.flatnonzero(~np.array(beaten)).tolist()
    assert np.all(np.diff(points[found, 0]) > 0.0)
    assert np.all(np.diff(points[found, 1]) < 0.0)


def test_equal_rows_stay_once():
    assert len(in_order(np.array([[0.0, 1.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0]]))) == 2


def test_of_rows_as_good_in_one_objective_the_better_in_the_other_stays():
    assert in_order(np.array([[0.0, 1.0], [0.0, 0.4], [1e-9, 0.2]])).tolist() == [2]


def test_gaps_follow_rows_whose_neighbour_is_far():
    front = np.array([[0.0, 1.0], [0.1, 0.9], [0.5, 0.5], [0.6, 0.4]])
    assert gaps(front, 0.2) == [1]
    assert gaps(front, 1.0) == []


def test_crowded_rows_go_and_ends_of_parts_stay():
    front = np.array([[0.0, 1.0], [0.001, 0.999], [0.1, 0.9], [0.2, 0.8], [0.201, 0.799], [0.9, 0.1], [1.0, 0.0]])
    assert spread(front, 0.2).tolist() == [0, 2, 4, 5, 6]


def test_area_of_a_staircase():
    front = np.array([[0.0, 2.0], [1.0, 1.0], [3.0, 0.0]])
    # Columns of heights 3, 4 and 5 - y: (1 - 0) 1 + (3 - 1) 2 + (4 - 3) 3 under a corner at (4, 3).
    assert volume(front, np.array([4.0, 3.0])) == pytest.approx(8.0, rel=1e-15)
    assert volume(front, np.array([0.5, 1.5])) == 0.0


def test_knee_is_the_farthest_point_below_the_line_of_the_ends():
    x = np.linspace(0.0, 1.0, 101)
    assert knee(np.column_stack([x, (1.0 - np.sqrt(x)) ** 2])) == 25
    assert knee(np.column_stack([x, np.sqrt(1.0 - x**2)])) is None
    assert knee(np.column_stack([x, 1.0 - x])) is None
