"""Objectives that hardly conflict: a note with the size of the conflict, and no rate beyond the front."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po


@pytest.fixture(scope="module")
def small():
    """Front of a power of 4073 that changes by 3e-5 of it, against a deflection between 0 and 1."""
    d, x, y = design(x=(0.4, -2.0, 2.0), y=(0.4, -2.0, 2.0))
    power = po.Goal("power", 4073.0 * (1.0 + 3e-5 * (x**2 + y**2)), unit="W")
    return po.trade_off(d, power, po.Goal("deflection", (x - 1.0) ** 2 + y**2, unit="m"), points=11)


def test_a_small_conflict_is_traced_and_its_size_given(small):
    (note,) = small.notes
    assert note == "'power' hardly conflicts with the rest: along the whole front it changes by 0.003 % of its value"
    power, deflection = small.objectives.T
    # Efficient designs lie between both optima. The power's change of 3e-5 is known to its rounding, 1e-12.
    assert np.sqrt((power / 4073.0 - 1.0) / 3e-5) + np.sqrt(deflection) == pytest.approx(1.0, abs=1e-4)
    assert len(small.points) == 11


def test_conflicts_that_are_all_small_are_given_with_their_sizes():
    d, x, y = design(x=(0.4, -2.0, 2.0), y=(0.4, -2.0, 2.0))
    front = po.trade_off(d, 1.0 + 0.01 * (x**2 + y**2), 1.0 + 0.005 * ((x - 1.0) ** 2 + y**2), points=5)
    # From the best to the worst value.
    assert front.notes[0].endswith("hardly conflict: along the whole front they change by 0.99 % and 0.5 %")


def test_a_cost_beyond_the_front_is_not_given(small):
    assert small.cost(5) is None
    assert small.in_words(5).endswith("the whole front changes power by only 0.003 %")
    # The rate in units is still given, and the cost of 1 % less deflection, which is on the front.
    x = small.designs[5, 0]
    assert small.rate(5) == pytest.approx((x - 1.0) / (4073.0 * 3e-5 * x), rel=1e-4)
    assert small.cost(5, 0, 1) == pytest.approx(abs(small.rate(5, 0, 1) * small.objectives[5, 1] / 4073.0), rel=1e-3)


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


THREE = "'first objective', 'second objective' and 'third objective' do not conflict: one design is best in all three"
BOTH = "'first objective' and 'second objective' do not conflict: one design is best in both"
# An objective that is 0 at its best changes by more than 5 % at every other design, which would all be needles.
CONFLICTS = {
    "none": (lambda x, y: (x**2 + y**2, 2.0 * (x**2 + y**2) + 3.0), [0.0, 0.0], BOTH),
    "less than the optimiser's tolerance":
        (lambda x, y: (1 + 2e-6 * (x**2 + y**2), 1 + (x - 1) ** 2 + y**2), [1.0, 0.0], f"{BOTH}, to within 0.0002 %"),
    "none of three": (lambda x, y: (1.0 + x**2 + y**2, 2.0 + x**2 + y**2, 3.0 + x**4 + y**2), [0.0, 0.0], THREE),
}  # fmt: skip


@pytest.mark.parametrize("name", CONFLICTS)
def test_objectives_that_do_not_conflict_give_one_design_and_say_so(name, tmp_path):
    objectives, best, words = CONFLICTS[name]
    d, x, y = design(x=(0.4, -2.0, 2.0), y=(0.4, -2.0, 2.0))
    front = po.trade_off(d, *objectives(x, y), points=9)
    assert front.notes == (words,)
    assert front.designs == pytest.approx(np.array([best]), abs=1e-3)
    assert (front.holes, front.knee, front.points[0].rate) == ((), None, None)
    assert "no finite rate" in front.in_words(0)
    assert po.TradeOff.load(front.save(tmp_path / "one.json")).points == front.points
