"""By how much designs are better than a front: on curves and planes in closed form."""

import numpy as np
import pytest

from plough_opt.studies.tradeoff.domination import beating, beyond_front, beyond_points, undominated

LINE = np.column_stack([np.linspace(0.0, 1.0, 11), np.linspace(1.0, 0.0, 11)])


def test_designs_beyond_a_line():
    designs = np.array([[0.33, 0.67], [0.33, 0.57], [0.33, 0.77], [-0.1, 1.5], [1.2, 0.3]])
    # On the line, 0.05 below it in both objectives, above it, beyond an end by 0.1, and beaten by an end.
    assert beyond_front(LINE, designs, 0.2)[:4] == pytest.approx([0.0, 0.05, -0.05, 0.1], abs=1e-12)
    assert beyond_front(LINE, designs, 0.2)[4] < 0.0


def test_in_a_gap_only_points_count():
    broken = np.delete(LINE, [4, 5, 6], axis=0)
    middle = np.array([[0.5, 0.5]])
    assert beyond_front(broken, middle, 0.2) == pytest.approx([0.2])
    assert beyond_points(broken, middle) == pytest.approx([0.2])
    # Neighbours three steps apart are one part of steps that long.
    assert beyond_front(broken, middle, 0.8) == pytest.approx([0.0], abs=1e-12)


def test_designs_beyond_a_plane():
    plane = np.array([[i, j, 6 - i - j] for i in range(7) for j in range(7 - i)]) / 6.0
    designs = np.array([[0.3, 0.3, 0.4], [0.3, 0.3, 0.37], [0.3, 0.3, 0.43]])
    assert beyond_front(plane, designs, 1.0 / 6.0) == pytest.approx([0.0, 0.01, -0.01], abs=1e-12)
    # Beside the edge half a step is none.
    outside = np.array([[-0.05, 0.5, 0.55]])
    assert beyond_front(plane, outside, 1.0 / 6.0)[0] < 0.0 < beyond_points(plane, outside)[0]


def test_by_how_much_designs_beat_a_point():
    designs = np.array([[0.4, 0.5], [0.1, 0.95], [0.5, 0.6]])
    most, by = beating(LINE, designs)
    assert by == pytest.approx([max(min(a - c, b - d) for c, d in designs) for a, b in LINE], abs=1e-15)
    assert [most[0], most[10]] == [1, 0]
    assert np.all(beating(LINE, np.empty((0, 2)))[1] == -np.inf)


def test_thinned_designs_beat_all_others_to_a_tolerance():
    designs = np.random.default_rng(1).random((2000, 3))
    kept = designs[undominated(designs, 0.01)]
    behind = np.max(kept[None] - designs[:, None], axis=2).min(axis=1)
    assert np.max(behind) <= 0.01
    assert not any(np.any(np.all(designs < own, axis=1)) for own in kept)
