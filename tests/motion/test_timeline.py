import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plough_opt.motion.plan import coarser
from plough_opt.motion.runge_kutta import ends
from plough_opt.motion.timeline import Timeline


def test_every_output_interval_has_the_same_whole_number_of_steps():
    timeline = Timeline(outputs=4, steps=12)
    assert timeline.nodes == pytest.approx(np.arange(13) / 12, rel=0, abs=4e-16)
    assert timeline.output_columns == [0, 3, 6, 9, 12]
    assert list(timeline.output_fractions) == [0.0, 0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize(
    ("outputs", "steps", "taken"), [(1, 1, 1), (1, 7, 7), (7, 1, 7), (5, 5, 5), (5, 12, 10), (5, 13, 15), (100, 3, 100)]
)
def test_each_interval_takes_the_nearest_whole_number_of_steps(outputs, steps, taken):
    assert len(Timeline(outputs, steps).nodes) == taken + 1


def test_a_step_ends_at_the_kink():
    timeline = Timeline(outputs=2, steps=4, kink=0.6)
    assert list(timeline.nodes) == [0.0, 0.25, 0.5, 0.6, 0.75, 1.0]
    assert timeline.output_columns == [0, 2, 5]


@pytest.mark.parametrize("kink", [None, 0.25, 0.25 + 1e-12, 0.25 - 1e-12, 1.0 - 1e-12])
def test_a_kink_at_a_node_adds_no_step_without_length(kink):
    assert Timeline(outputs=4, steps=4, kink=kink).nodes == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0], rel=0, abs=0)


@given(steps=st.integers(1, 400), kink=st.floats(1e-8, 1.0 - 1e-8))
def test_on_either_side_of_a_kink_steps_are_many_enough_to_read_between(steps, kink):
    timeline = Timeline(outputs=400, steps=steps, kink=kink, aligned=False)
    (at,) = np.flatnonzero(timeline.nodes == kink)
    before, after = np.diff(timeline.nodes[: at + 1]), np.diff(timeline.nodes[at:])
    for part in (before, after):
        assert len(part) >= min(steps, 0.6 * steps**0.75)
        # But for the outermost, which may be halves.
        assert np.all(np.abs(part[2:-2] - np.max(part)) < 1e-15)
        assert np.max(part) < (1.0 + 1e-12) / steps
    assert len(before) + len(after) <= steps + 0.6 * steps**0.75 + 6


@pytest.mark.parametrize(("steps", "taken"), [(1, 2), (2, 4), (3, 5), (17, 19), (400, 402)])
def test_as_many_steps_are_taken_as_were_asked_for_and_the_outermost_in_two(steps, taken):
    assert len(Timeline(1, steps, aligned=False).nodes) == steps + 1
    assert len(Timeline(100, steps, aligned=False).nodes) == taken + 1


@pytest.mark.parametrize("kink", [1e-6, 0.01, 0.07, 0.24])
def test_a_check_with_three_quarters_of_the_steps_takes_fewer_on_either_side_of_a_kink(kink):
    for steps in range(20, 2000, 7):
        nodes, check = (Timeline(100, n, kink, aligned=False).nodes for n in (steps, coarser(steps)))
        assert np.sum(check < kink) < np.sum(nodes < kink), steps
        assert np.sum(check > kink) < np.sum(nodes > kink), steps


def test_steps_that_end_at_moving_kinks_are_no_fewer_than_their_share():
    assert len(Timeline(outputs=5, steps=12, moving=True).nodes) == 16


@pytest.mark.parametrize("ramp", [1e-3, 0.3, 0.5, 0.6, 1.99, 2.0, 7.0])
def test_one_end_moves_with_the_ramp_and_the_others_stay(ramp):
    timeline, duration = Timeline(outputs=4, steps=4, moving=True), 2.0
    a, b = ends(timeline, duration, ca.DM(ramp))
    found = np.asarray(a * duration + b * ramp).ravel()
    expected = sorted([*(duration * timeline.nodes), min(ramp, duration)])
    assert found == pytest.approx(expected, rel=0, abs=4e-16)
    # Nothing but that end has a derivative by the ramp, and that has slope 1.
    assert sorted(np.asarray(b).ravel()) == [0.0] * 5 + [float(ramp < duration)]


@given(
    outputs=st.integers(1, 60),
    steps=st.integers(1, 400),
    kink=st.none() | st.floats(0.0, 1.0, exclude_min=True, exclude_max=True),
)
def test_nodes_hold_outputs_and_kink_in_order(outputs, steps, kink):
    timeline = Timeline(outputs, steps, kink)
    assert timeline.nodes[0] == 0.0
    assert timeline.nodes[-1] == 1.0
    # A kink nearer than 1e-9 to a node is that node.
    assert np.min(np.diff(timeline.nodes)) > 0.9e-9
    assert kink is None or np.min(np.abs(timeline.nodes - kink)) < 1e-9
    # linspace over outputs and over steps may differ in the last bit.
    assert timeline.nodes[timeline.output_columns] == pytest.approx(timeline.output_fractions, rel=0, abs=4e-16)
