"""Domination, positions, gaps, area, volume and knee of points, against brute force and closed forms."""

import numpy as np
import pytest

from plough_opt.studies.tradeoff.front import (
    lead_over_front,
    lead_over_points,
    parts_of,
    strongest_dominators,
    thinned,
    uncrowded_on_curve,
    uncrowded_on_surface,
    undominated,
    undominated_in_order,
    volume,
)

LINE = np.column_stack([np.linspace(0.0, 1.0, 11), np.linspace(1.0, 0.0, 11)])


# --- domination ---------------------------------------------------------------------------------------------


def test_efficient_rows_are_those_that_brute_force_finds():
    rng = np.random.default_rng(1)
    points = rng.random((300, 2))
    beaten = [any(np.all(other < point) for other in points) for point in points]
    found = undominated_in_order(points)
    assert sorted(found) == np.flatnonzero(~np.array(beaten)).tolist()
    assert np.all(np.diff(points[found, 0]) > 0.0)
    assert np.all(np.diff(points[found, 1]) < 0.0)


def test_crowded_rows_go_and_ends_of_parts_stay():
    front = np.array([[0.0, 1.0], [0.001, 0.999], [0.1, 0.9], [0.2, 0.8], [0.201, 0.799], [0.9, 0.1], [1.0, 0.0]])
    assert uncrowded_on_curve(front, 0.2).tolist() == [0, 2, 4, 5, 6]


def test_of_rows_that_beat_each_other_by_rounding_one_stays():
    # Each row is better than the next by 1.7e-7 in one objective and worse by 0.9e-7 in two, where 1e-7 is rounding.
    turn = np.array([[0.0, 0.8, -0.9], [-0.9, 0.0, 0.8], [0.8, -0.9, 0.0]]) * 1e-7
    assert undominated(np.vstack([turn, turn[0] + 1e-3])).tolist() == [0, 2]
    twice = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    assert undominated(twice).tolist() == [0, 2]


def test_volume_is_that_of_the_boxes():
    rng = np.random.default_rng(2)
    points = rng.random((15, 3))
    # Sum the cells between the points' coordinates that some point dominates.
    cuts = [np.unique(np.r_[points[:, k], 1.1]) for k in range(3)]
    sizes = np.einsum("i,j,k->ijk", *(np.diff(cut) for cut in cuts))
    corners = np.stack(np.meshgrid(*(cut[:-1] for cut in cuts), indexing="ij"), axis=-1)
    covered = np.any(np.all(corners[..., None, :] >= points, axis=-1), axis=-1)
    assert volume(points, np.full(3, 1.1)) == pytest.approx(np.sum(sizes[covered]), rel=1e-13)
    assert volume(points, np.zeros(3)) == 0.0


# --- designs beyond a front ---------------------------------------------------------------------------------


def test_designs_beyond_a_line():
    designs = np.array([[0.33, 0.67], [0.33, 0.57], [0.33, 0.77], [-0.1, 1.5], [1.2, 0.3]])
    # On the line, below it by 0.05 in both objectives, above it, beyond an end by 0.1, and dominated by an end.
    assert lead_over_front(LINE, designs, 0.2)[:4] == pytest.approx([0.0, 0.05, -0.05, 0.1], abs=1e-12)
    assert lead_over_front(LINE, designs, 0.2)[4] < 0.0


def test_in_a_gap_only_points_count():
    broken = np.delete(LINE, [4, 5, 6], axis=0)
    middle = np.array([[0.5, 0.5]])
    assert lead_over_front(broken, middle, 0.2) == pytest.approx([0.2])
    assert lead_over_points(broken, middle) == pytest.approx([0.2])
    # A front of one point has no line.
    assert lead_over_front(LINE[:1], middle, 0.2) == pytest.approx([0.5])
    # With steps four times as long the same neighbours are not far apart.
    assert lead_over_front(broken, middle, 0.8) == pytest.approx([0.0], abs=1e-12)


def test_designs_beyond_a_plane():
    plane = np.array([[i, j, 6 - i - j] for i in range(7) for j in range(7 - i)]) / 6.0
    designs = np.array([[0.3, 0.3, 0.4], [0.3, 0.3, 0.37], [0.3, 0.3, 0.43]])
    assert lead_over_front(plane, designs, 1.0 / 6.0) == pytest.approx([0.0, 0.01, -0.01], abs=1e-12)
    # Points on a line have no triangle, and a lead of half a step does not count.
    assert lead_over_front(plane[:7], designs, 1 / 6) == pytest.approx(lead_over_points(plane[:7], designs) - 1 / 12)
    # Beyond the edge a lead of half a step does not count.
    outside = np.array([[-0.05, 0.5, 0.55]])
    assert lead_over_front(plane, outside, 1.0 / 6.0)[0] < 0.0 < lead_over_points(plane, outside)[0]


def test_by_how_much_designs_beat_a_point():
    designs = np.array([[0.4, 0.5], [0.1, 0.95], [0.5, 0.6]])
    most, by = strongest_dominators(LINE, designs)
    assert by == pytest.approx([max(min(a - c, b - d) for c, d in designs) for a, b in LINE], abs=1e-15)
    assert [most[0], most[10]] == [1, 0]
    assert np.all(strongest_dominators(LINE, np.empty((0, 2)))[1] == -np.inf)


# In a cell the row of least sum may be behind another one by the cell's size, and is then thinned out itself.
@pytest.mark.parametrize(("thin", "most"), [(undominated, 0.01), (thinned, 0.02)])
def test_thinned_designs_beat_all_others_to_a_tolerance(thin, most):
    designs = np.random.default_rng(1).random((2000, 3)) - 0.5
    kept = designs[thin(designs, 0.01)]
    behind = np.max(kept[None] - designs[:, None], axis=2).min(axis=1)
    assert np.max(behind) <= most
    assert len(thin(designs[:0], 0.01)) == 0
    assert not any(np.any(np.all(designs < own, axis=1)) for own in kept)


def test_parts_and_crowds():
    row = np.array([[k * 0.1, 1.0 - k * 0.1, 0.0] for k in (0, 1, 2, 6, 7)])
    parts, holes = parts_of(row, 0.1)
    assert parts == [[0, 1, 2], [3, 4]]
    assert [sorted(pair) for pair in holes] == [[2, 3]]
    assert uncrowded_on_surface(row, np.array([0, 1, 2, 2, 1]), 0.15).tolist() == [0, 2, 4]
