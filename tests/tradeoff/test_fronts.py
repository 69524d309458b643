"""Fronts of known shape: designs without runs, whose fronts are closed forms."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import scene_of
from helpers.small_designs import design

import plough_opt as po
from plough_opt.studies.tradeoff.assembly import hole
from plough_opt.studies.tradeoff.front import MissingPoint

# Ends of the five parts of ZDT3, where the next minimum or the next level begins (Zitzler, Deb and Thiele 2000).
ZDT3 = [(0.0, 0.0830015349), (0.1822287280, 0.2577623634), (0.4093136748, 0.4538821041), (0.6183967944, 0.6525117038),
        (0.8233317983, 0.8518328654)]  # fmt: skip


# --- shapes -------------------------------------------------------------------------------------------------


def test_convex_front(convex):
    first, second = convex.objectives.T
    # Designs have y = 0 to the square root of the optimiser's tolerance of 1e-10, so objectives meet the curve to that.
    assert np.sqrt(first) + np.sqrt(second) == pytest.approx(1.0, abs=1e-10)
    # At the ends the other objective weighs 1e-4: both lie 1e-8 beside their own optima.
    assert max(first[0], second[-1]) < 1e-7
    assert len(convex.points) == 21
    assert convex.parts == (tuple(range(21)),)
    # Neighbours are equally far apart.
    distance = np.sum(np.abs(np.diff(convex.objectives / np.ptp(convex.objectives, axis=0), axis=0)), axis=1)
    assert distance == pytest.approx(2.0 / 20.0, rel=1e-5)
    assert convex.holes == convex.failures == convex.notes == ()


def test_concave_front(concave):
    # The requirement is met to 1e-11 divided by its multiplier, which is as small as 1e-4 at the anchors.
    assert np.hypot(*concave.objectives.T) == pytest.approx(1.0, abs=2e-7)
    assert len(concave.points) == 21
    assert concave.holes == concave.failures == ()
    assert concave.knee is None
    assert concave.points[10].active == ("outside",)


def test_broken_front_and_its_hole(broken):
    x, second = broken.objectives.T
    assert second == pytest.approx((x - 0.3) ** 2 * (0.8 - x), abs=1e-9)
    assert len(broken.parts) == 2
    assert np.all((x <= 0.3 + 1e-6) | (x >= 0.8))
    (hole,) = broken.holes
    assert hole.settled
    # Where there are dominated designs, those without a value are not missed.
    assert broken.failures == ()
    # An end is located to 1e-7 of the second objective; beside a minimum that is the root of it in the first.
    assert hole.start == pytest.approx((0.3, 0.0), abs=2e-4)
    assert hole.end == pytest.approx((0.8, 0.0), abs=1e-5)


def test_every_part_of_a_front_that_is_broken_four_times():
    d, x, y = design(x=(0.5, 1e-6, 1.0), y=(0.5, 0.0, 1.0))
    g = 1.0 + 9.0 * y
    second = g * (1.0 - ca.sqrt(x / g) - x / g * ca.sin(10.0 * ca.pi * x))
    # In the other order, so that a part ends where the next one begins to dominate it, and not at its own minimum.
    front = po.trade_off(d, second, x, points=41, search=["x"])
    ends = [tuple(front.objectives[list(part)][[-1, 0], 1]) for part in front.parts]
    # An end is located to 1e-7 of the first objective, whose minima have a curvature of 1e3.
    assert np.array(ends[::-1]) == pytest.approx(np.array(ZDT3), abs=3e-5)
    assert len(front.dominated) > 10


def test_a_front_that_a_requirement_interrupts():
    d, x, y = design(x=(0.1, 0.0, 1.0), y=(0.1, -1.0, 1.0))
    d.require("outside", (x - 0.5) ** 2, at_least=0.04)
    front = po.trade_off(d, x + y**2, 1.0 - x + y**2, points=21, search=["x"])
    (hole,) = front.holes
    assert hole.settled
    assert hole.start == pytest.approx((0.3, 0.7), abs=1e-9)
    assert hole.end == pytest.approx((0.7, 0.3), abs=1e-9)
    assert np.sum(front.objectives, axis=1) == pytest.approx(1.0, abs=1e-9)
    # The positions inside are infeasible, and that is all that failures report.
    assert {failure.reason.split(":")[0] for failure in front.failures} <= {"Infeasible_Problem_Detected"}


def test_a_front_along_an_equality(plane):
    d, x, y = plane
    d.require("line", x + y, at_least=0.5, at_most=0.5)
    front = po.trade_off(d, x**2 + y**2, (x - 1.0) ** 2 + y**2, points=11)
    # On y = 1/2 - x the optima of the objectives are x = 1/4 and x = 3/4, with the front between them.
    x = front.designs[:, 0]
    assert np.all(np.diff(x) > 0.0)
    # The other objective weighs 1e-4 at the ends, in units of its size at the guess, and moves them by about as much.
    assert x[[0, -1]] == pytest.approx([0.25, 0.75], abs=3e-4)
    assert front.objectives[:, 0] == pytest.approx(x**2 + (0.5 - x) ** 2, abs=1e-9)
    assert front.holes == ()


@pytest.mark.parametrize("status", ["Maximum_Iterations_Exceeded", "Infeasible_Problem_Detected"])
def test_a_hole_in_which_the_optimiser_failed_is_not_settled(broken, status):
    before, after = broken.points[broken.parts[0][-1]], broken.points[broken.parts[1][0]]
    signs = np.ones(2)
    within = MissingPoint(before.objectives, f"{status}: why")
    beside = MissingPoint(broken.points[0].objectives, "Maximum_Iterations_Exceeded: why")
    assert hole(before, after, [within, beside], signs) == replace(broken.holes[0], settled="Infeasible" in status)


# --- anchors and positions ----------------------------------------------------------------------------------


def test_the_design_stays_as_it_was_and_of_mirror_images_one_is_shown(plane):
    d, x, y = plane
    d.minimise((x - 0.7) ** 2 + y**2)
    rest = (y**2 - 0.25) ** 2
    assert len(po.trade_off(d, x**2 + rest, (x - 1.0) ** 2 + rest, points=5).points) == 5
    assert d.solve().variables["x"] == pytest.approx(0.7, abs=1e-6)


# --- domination ---------------------------------------------------------------------------------------------


def test_dominated_optima_are_kept_apart(broken):
    assert broken.dominated
    for point in broken.dominated:
        better = np.all(broken.objectives <= np.array(point.objectives) + 1e-7, axis=1)
        assert np.any(better)
    for point in broken.objectives:
        others = np.array([other.objectives for other in (*broken.points, *broken.dominated)])
        assert not np.any(np.all(others < point - 1e-7, axis=1))


# --- rates --------------------------------------------------------------------------------------------------


def test_rates_are_the_slope_of_the_front(convex, concave):
    first, second = convex.objectives[1:-1].T
    assert convex.rates[1:-1] == pytest.approx(-np.sqrt(second / first), rel=1e-7)
    first, second = concave.objectives[1:-1].T
    assert concave.rates[1:-1] == pytest.approx(-first / second, rel=1e-6)


def test_knee_and_area(convex):
    # The knee of sqrt(f1) + sqrt(f2) = 1 is f1 = f2 = 1/4, to half the distance of the positions.
    assert convex.knee.objectives == pytest.approx((0.25, 0.25), abs=0.051)
    # The area above the curve in the unit square is 1 - 1/6. The staircase of 20 steps misses about half a square each.
    assert 1.0 - 1.0 / 6.0 - 0.05 < convex.hypervolume((1.0, 1.0)) < 1.0 - 1.0 / 6.0
    assert convex.hypervolume((2.0, 1.0)) == pytest.approx(convex.hypervolume((1.0, 1.0)) + 1.0, abs=1e-6)


# --- certificates -------------------------------------------------------------------------------------------


def test_points_are_certified(convex, concave, broken):
    for front in (convex, concave, broken):
        for point in (*front.points, *front.dominated):
            assert point.residual < 1e-9
            assert point.violation < 1e-9
            assert point.doubt == ""


def test_a_point_that_bends_down_is_no_optimum(convex, concave):
    middle = convex.points[10]
    # Of two directions the position fixes one; in the other both objectives grow like y^2.
    assert middle.curvature > 0.1
    assert concave.points[10].curvature is None
    assert "it is not a minimum" in replace(middle, curvature=-1e-3).doubt
    assert replace(middle, curvature=-1e-9).doubt == ""
    assert "violates a requirement by 2.0e-06" in replace(middle, violation=2e-6).doubt


def test_positions_without_a_design_are_named():
    d, x = design(x=(0.9, 0.0, 1.0))
    # The root has no value between 0.4 and 0.6, where both objectives lead from either side.
    second = 1.0 - x + 1e-3 * ca.sqrt((x - 0.5) ** 2 - 0.01)
    front = po.trade_off(d, x, second, points=11)
    assert any("no finite number" in failure.reason for failure in front.failures)
    (hole,) = front.holes
    assert not hole.settled
    first, found = front.objectives.T
    assert np.all((first < 0.4) | (first > 0.6))
    assert found == pytest.approx(1.0 - first + 1e-3 * np.sqrt((first - 0.5) ** 2 - 0.01), abs=1e-9)


# --- refusals -----------------------------------------------------------------------------------------------


def test_no_design_meets_the_requirements(plane):
    d, x, y = plane
    d.require("far", x + y, at_least=4.0)
    with pytest.raises(po.InfeasibleDesign, match="'far'") as caught:
        po.trade_off(d, x, y)
    assert caught.value.conflicts == pytest.approx({"far": 1.0}, abs=1e-6)


@pytest.mark.slow
def test_a_region_that_only_the_optimiser_finds(plane):
    d, x, y = plane
    d.require("end of a valley", 1.0 + 1e4 * (y - x**3 + x) ** 2 + (x - 0.9) ** 2, at_most=1.0 + 3e-6)
    front = po.trade_off(d, 1.0 + x**2, 2.0 + x**2, points=5, search=200)
    # The least x of the region, in which one design is best in both.
    least = 0.9 - 3e-6**0.5
    assert front.designs == pytest.approx(np.array([[least, least**3 - least]]), abs=1e-6)


def test_no_design_meets_all_digits_of_a_requirement(plane):
    d, x, y = plane
    # To a search this is near enough.
    d.require("near", 1.0 - x**2 - y**2, at_least=1.0 + 3e-7)
    with pytest.raises(po.NotConverged, match="no optimum of objective number 1 alone"):
        po.trade_off(d, x, y, x + y, points=5, search="near")


@pytest.mark.parametrize(
    ("objectives", "options", "said"),
    [
        pytest.param(lambda x, y: (x, y, x + y, x - y), {}, "4 objectives", id="four"),
        pytest.param(lambda x, y: (x, ca.vertcat(x, y)), {}, "must be one number, not 2", id="vector"),
        pytest.param(lambda x, _: (x, 3.0), {}, "must be an expression", id="number"),
        pytest.param(lambda x, _: (ca.MX.sym("z"), x), {}, "'first objective' holds symbols", id="stranger"),
        pytest.param(lambda x, y: (po.Goal("a", x), po.Goal("a", y)), {}, "the same name 'a'", id="names"),
        pytest.param(lambda x, y: (po.Goal(" ", x), y), {}, "an objective's name = ' ' must be a text", id="no name"),
        pytest.param(lambda x, y: (x, y), {"search": ["X"]}, "search = 'X' is not a variable", id="search"),
        pytest.param(lambda x, y: (y, po.simulate(scene_of(mass=-x), 0.1).mean_draft), {}, "mass = -0.3 kg", id="mass"),
        pytest.param(lambda x, _: (ca.fabs(x) + x / 9, ca.fabs(x) - x / 9), {"points": 5, "search": "near"},
                     "no point of the front could be certified: the first-order conditions", id="kink",
                     marks=pytest.mark.slow),
        *(
            pytest.param(lambda x, y: (x, y), {"points": n}, "a whole number from 5 to 1000", id=f"{n} points")
            for n in (4, 1001, 7.5)
        ),
    ],
)  # fmt: skip
def test_questions_that_cannot_be(plane, objectives, options, said):
    d, x, y = plane
    with pytest.raises(po.PloughError, match=said):
        po.trade_off(d, *objectives(x, y), **options)
