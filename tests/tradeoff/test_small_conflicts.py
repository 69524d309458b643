"""Objectives that hardly conflict: a note with the size of the conflict, and no rate beyond the front."""

from itertools import pairwise

import numpy as np
import pytest

import plough_opt as po


@pytest.fixture(scope="module")
def small():
    """Front of a power of 4073 that changes by 3e-5 of it, against a deflection between 0 and 1."""
    d = po.Design()
    x, y = (d.variable(name, guess=0.4, lower=-2.0, upper=2.0) for name in "xy")
    power = po.Goal("power", 4073.0 * (1.0 + 3e-5 * (x**2 + y**2)), unit="W")
    return po.trade_off(d, power, po.Goal("deflection", (x - 1.0) ** 2 + y**2, unit="m"), points=11)


def test_a_conflict_too_small_to_act_on_is_said_with_its_size(small):
    assert small.notes == (
        "'power' hardly conflicts with the rest: along the whole front it changes by 0.003 % of its value",
    )


def test_the_front_is_right_all_the_same(small):
    power, deflection = small.objectives.T
    # Efficient designs lie between both optima. The power's change of 3e-5 is known to its rounding, 1e-12.
    assert np.sqrt((power / 4073.0 - 1.0) / 3e-5) + np.sqrt(deflection) == pytest.approx(1.0, abs=1e-4)
    assert len(small.points) == 11


def test_a_cost_beyond_the_front_is_not_given(small):
    assert small.cost(5) is None
    assert small.in_words(5).endswith("the whole front changes power by only 0.003 %")
    # The rate in units is still given, and the cost of 1 % less deflection, which is on the front.
    x = small.designs[5, 0]
    assert small.rate(5) == pytest.approx((x - 1.0) / (4073.0 * 3e-5 * x), rel=1e-4)
    assert small.cost(5, of=0, by=1) == pytest.approx(
        abs(small.rate(5, 0, 1) * small.objectives[5, 1] / 4073.0), rel=1e-3
    )


def test_the_picture_has_no_offset_and_ticks_that_do_not_touch(small):
    figure = small.plot()
    figure.canvas.draw()
    front, *panels = figure.axes
    for axes in (front, panels[-1]):
        labels = [label for label in axes.get_xticklabels() if label.get_text()]
        boxes = sorted((label.get_window_extent() for label in labels), key=lambda box: box.x0)
        assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
        assert axes.xaxis.get_offset_text().get_text() == ""
    low, high = front.get_xlim()
    # The axis spans 1 % of the power, which changes by 0.003 %.
    assert high - low == pytest.approx(0.01 * 4.073, rel=0.01)


def test_a_conflict_below_the_optimisers_tolerance_is_none_and_its_size_is_given():
    d = po.Design()
    x, y = (d.variable(name, guess=0.4, lower=-2.0, upper=2.0) for name in "xy")
    front = po.trade_off(d, 1.0 + 2e-6 * (x**2 + y**2), 1.0 + (x - 1.0) ** 2 + y**2, points=9)
    (note,) = front.notes
    assert (
        note
        == "'first objective' and 'second objective' do not conflict: one design is best in both, to within 0.0002 %"
    )
    assert front.designs[0] == pytest.approx([1.0, 0.0], abs=1e-3)


def test_objectives_near_zero_make_no_needle():
    # An objective that is 0 at its best changes by more than 5 % at every other design, which would all be needles.
    d = po.Design()
    x, y = (d.variable(name, guess=0.4, lower=0.0, upper=1.0) for name in "xy")
    both = (x - 0.3) ** 2 + (y - 0.2) ** 2
    front = po.trade_off(d, both, 2.0 * both + 3.0)
    assert front.notes == ("'first objective' and 'second objective' do not conflict: one design is best in both",)
    front = po.trade_off(d, 100.0 + 1e-3 * x, (1.0 - x) ** 2 + y**2)
    assert len(front.notes) == 1
    assert front.notes[0].endswith("do not conflict: one design is best in both, to within 0.001 %")


def test_objectives_that_do_not_conflict_give_one_design_and_say_so(alone, tmp_path):
    assert alone.objectives == pytest.approx(np.array([[1.0, 3.0]]), abs=1e-9)
    assert alone.notes == ("'draft' and 'power' do not conflict: one design is best in both",)
    assert alone.holes == ()
    assert alone.knee is None
    assert alone.points[0].rate is None
    assert "no finite rate" in alone.in_words(0)
    assert po.TradeOff.load(alone.save(tmp_path / "one.json")).points == alone.points
