"""Fronts of known shape, of a ridge, beside needles; surfaces of three objectives; as JSON, tables and pictures."""

import csv
import io
import itertools
import math
import time
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from helpers.problem_files import PROBLEMS
from helpers.scenes import scene_of
from helpers.small_designs import design
from matplotlib.figure import Figure

import plough_opt as po
from plough_opt.app.terminal import print_page
from plough_opt.core.screen import Screen
from plough_opt.design.model import program as program_module
from plough_opt.problem_file.sweep import SimulationOfMany
from plough_opt.studies.tradeoff.front import MissingPoint, distances, undominated, volume

# --- fronts of known shape, of a ridge, of objectives that hardly conflict, and of designs beside needles ---

# Ends of the five parts of ZDT3, where the next minimum or the next level begins (Zitzler, Deb and Thiele 2000).
ZDT3 = [(0.0, 0.0830015349), (0.1822287280, 0.2577623634), (0.4093136748, 0.4538821041), (0.6183967944, 0.6525117038),
        (0.8233317983, 0.8518328654)]  # fmt: skip


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


def test_the_design_stays_as_it_was_and_of_mirror_images_one_is_shown(plane):
    d, x, y = plane
    d.minimise((x - 0.7) ** 2 + y**2)
    rest = (y**2 - 0.25) ** 2
    assert len(po.trade_off(d, x**2 + rest, (x - 1.0) ** 2 + rest, points=5).points) == 5
    assert d.solve().variables["x"] == pytest.approx(0.7, abs=1e-6)


def test_dominated_optima_are_kept_apart(broken):
    assert broken.dominated
    for point in broken.dominated:
        better = np.all(broken.objectives <= np.array(point.objectives) + 1e-7, axis=1)
        assert np.any(better)
    for point in broken.objectives:
        others = np.array([other.objectives for other in (*broken.points, *broken.dominated)])
        assert not np.any(np.all(others < point - 1e-7, axis=1))


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


def test_no_design_meets_all_digits_of_a_requirement(plane):
    d, x, y = plane
    # To a search this is near enough.
    d.require("near", 1.0 - x**2 - y**2, at_least=1.0 + 3e-7)
    with pytest.raises(po.NotConverged, match="no optimum of objective number 1 alone"):
        po.trade_off(d, x, y, x + y, points=5, search="near")


WRONG_QUESTIONS = [
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
]  # fmt: skip


@pytest.mark.parametrize(("objectives", "options", "said"), WRONG_QUESTIONS)
def test_questions_that_cannot_be(plane, objectives, options, said):
    d, x, y = plane
    with pytest.raises(po.PloughError, match=said):
        po.trade_off(d, *objectives(x, y), **options)


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


FILE = PROBLEMS / "force_against_deflection.toml"


def test_parts_on_either_side_of_the_ridge_are_certified():
    """Mean deflection against the force's oscillation: soft mounts, and one as stiff as its bound."""
    # The first number of steps leaves an error of 2e-12, so the front is refined once.
    changes, told = ["trade_off.points=17", "accuracy.error=1e-12"], []
    front = po.read_problem(FILE, changes).trade_off(progress=lambda step, done: told.append((step, done)))
    assert (told[0], told.count(("refining", 0.0))) == (("building the model", 0.0), 1)
    assert all(0.0 <= done < 1.0 for _, done in told)
    assert front.parts[0] == (0,)
    assert [front.points[0].branch, *{front.points[k].branch for k in front.parts[1]}] == ["stiff", "soft"]
    assert front.points[0].variables["scene.stiffness"] == pytest.approx(5e5, rel=1e-6)
    assert (front.holes[0].settled, front.failures) == (True, ())
    # On the soft side the part begins where the oscillation is that of the stiff mount.
    assert front.objectives[1, 1] == pytest.approx(front.objectives[0, 1], rel=1e-6)
    # The stiffness is the only limit that decides some designs and not all: those at its bounds.
    rows = str(front).splitlines()[3 : 3 + len(front.points)]
    assert [row.split()[-1] for row in rows] == ["1", *["soft"] * (len(rows) - 2), "1"]
    assert "limits: 1 stiffness" in str(front)
    for point in front.points:
        assert point.gap < 1e-12
        assert max(point.violation, point.residual) < 1e-9
        assert {"loosened_radius", "half_angle"} <= set(point.active)
    many = SimulationOfMany(po.read_problem(FILE), tuple(axis.name for axis in front.variables), "")
    answers = many.many([dict(zip(many.names, row, strict=True)) for row in front.designs])
    found = [[answer.results[name] for name in ("mean_deflection", "force_rms")] for answer in answers]
    # Another method of integration, to the error that it promises.
    assert found == pytest.approx(front.objectives, rel=1e-6)


# Depth and width of a dip in the second objective. The tolerance, 0.3 % of a range of 1, is 1.5 times the width.
DEPTH, WIDTH = 0.5, 0.002


# The search around needles takes a minute.
@pytest.fixture(scope="module")
def front():
    """Front of x against 2 - x, with lower values in a dip along z that is too narrow to hit."""
    d, x, z = design(x=(0.4, 0.0, 1.0), z=(0.47, 0.0, 1.0))
    dip = DEPTH * ca.exp(-(((z - 0.5) / WIDTH) ** 2))
    return po.trade_off(d, po.Goal("a", x), po.Goal("b", 2.0 - x - dip), points=9)


@pytest.mark.slow
def test_designs_at_the_edge_of_a_needle_are_part_of_the_front_and_marked(front):
    assert len(front.needles) > 2
    for needle in front.needles:
        # A design is better than 2 - x only in the dip.
        assert abs(needle.variables["z"] - 0.5) < 3.0 * WIDTH
    edge = [point for point in front.points if not point.confirmed]
    assert len(edge) > 2
    for point in edge:
        x, z = point.variables["x"], point.variables["z"]
        assert not point.needle
        assert point.rate is None
        assert point.doubt == ""
        # Objectives are those of a simulation, to rounding.
        assert point.objectives == pytest.approx((x, 2.0 - x - DEPTH * np.exp(-(((z - 0.5) / WIDTH) ** 2))), rel=1e-12)
        # 5 % of a value of at most 2 is the limit for a needle.
        assert point.medians[1] - point.objectives[1] <= 0.05 * 2.0
    assert any(f"{len(edge)} of {len(front.points)} designs are unconfirmed" in note for note in front.notes)
    assert not any("are needles" in note and note.startswith(f"{len(front.points)} of") for note in front.notes)


# --- files and pictures -------------------------------------------------------------------------------------


def test_table_and_back(broken, tmp_path):
    path = broken.to_csv(tmp_path / "deep" / "front.csv")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    own = [row for row in rows if row["status"] == "front"]
    assert len(rows) == len(broken.points) + len(broken.dominated)
    # repr of a float reads back as the same float.
    assert np.array_equal([[float(row["a [N]"]), float(row["b"])] for row in own], broken.objectives)
    assert np.array_equal([[float(row["x"]), float(row["y"])] for row in own], broken.designs)
    rates = np.array([float(row["rate"] or "nan") for row in own])
    assert np.array_equal(rates, broken.rates, equal_nan=True)
    assert [int(row["part"]) for row in own] == [1 + (k in broken.parts[1]) for k in range(len(own))]


def test_picture(broken, concave, tmp_path):
    alone = Figure().subplots()
    assert broken.plot(alone) is alone
    assert len(alone.figure.axes) == 1
    figure = broken.plot(tmp_path / "front.png")
    assert (tmp_path / "front.png").read_bytes().startswith(b"\x89PNG")
    left, *panels = figure.axes
    varying = [name for name, own in zip("xy", broken.designs.T, strict=True) if np.ptp(own) > 1e-4 * np.max(own)]
    assert [axes.get_ylabel() for axes in panels] == varying
    for axes in panels:
        low, high = axes.get_ylim()
        assert all(low < y < high for line in axes.lines for y in line.get_ydata())
        along = np.concatenate([line.get_xdata() for line in axes.lines if line.get_marker() == "o"])
        assert along == pytest.approx(broken.objectives[:, 0])
    assert all(f"{name} " in figure.get_suptitle() for name in "xy" if name not in varying)
    assert left.get_xlabel() == "a [N]"
    labels = [text.get_text() for text in left.get_legend().get_texts()]
    assert labels[:4] == ["local optima, dominated", "front, part 1", "front, part 2", "hole: no efficient design"]
    lines = {line.get_label(): line.get_xydata() for line in left.lines}
    drawn = np.vstack([lines["front, part 1"], lines["front, part 2"]])
    assert drawn == pytest.approx(broken.objectives)
    assert len(lines["local optima, dominated"]) == len(broken.dominated)
    # Optima far away are neither shown nor named, and a concave front has no knee.
    far = replace(concave, dominated=(replace(concave.points[0], objectives=(9.0, 9.0)),)).plot(Figure().subplots())
    assert [text.get_text() for text in far.get_legend().get_texts()] == ["front"]


# --- tables -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def surface():
    """Surface of three objectives and four variables, with names and values as long as those of a problem file."""
    d = po.Design()
    names = {"share.wedge_angle": 1.0, "share.height": 0.1, "scene.stiffness": 1e5, "scene.tow_speed": 1.0}
    x = [d.variable(n, guess=s / 2, lower=s / 20, upper=2 * s, unit="", log=s > 1.0) / s for n, s in names.items()]
    goals = ("mean_draft", "N", 4321.09876), ("force_rms", "N", 12.3456789), ("loosened_radius", "m", 0.0123456)
    rest = 0.1 + (x[2] - x[0]) ** 2 + (x[3] - x[1]) ** 2
    corners = (0.1, 0.1), (1.0, 0.1), (0.1, 1.0)
    goals = [
        po.Goal(name, size * (rest + (x[0] - a) ** 2 + (x[1] - b) ** 2), unit)
        for (name, unit, size), (a, b) in zip(goals, corners, strict=True)
    ]
    return po.trade_off(d, *goals, points=10, search="near")


def printed(front, width=120):
    """Return the lines of a front."""
    out = io.StringIO()
    print_page(Screen(file=out, width=width), front.page())
    return out.getvalue().splitlines()


def test_a_surface_fits_into_120_characters_with_every_number_whole(surface):
    lines = printed(surface)
    table = [line for line in lines if line.startswith("│")]
    assert len(table) == len(surface.points)
    assert all(len(line) <= 120 for line in table)
    first = [cell.strip() for cell in table[0].split("│")[1:-1]]
    point = surface.points[0]
    shown = [point.objectives[0] / 1e3, point.objectives[1] / 1e3, point.objectives[2]]
    shown += [point.variables[axis.name] / (1e3 if axis.unit == "N/m" else 1.0) for axis in surface.variables]
    assert first[: len(shown)] == [f"{value:.5g}" for value in shown]
    headings = "".join(line for line in lines if line.startswith("┃"))
    assert all(word in headings for word in ("[kN]", "loosened", "stiffness", "(c)", "[%]"))
    (line,) = [line for line in printed(surface, 1000) if line.startswith("Knee")]
    assert f"at {surface.knee.objectives[0] / 1e3:.5g} kN, " in line
    assert (line.count(" N"), len(line.split(";"))) == (0, 3)


def test_picture_of_a_surface(surface, tmp_path):
    # Two points are a part of their own, which has no triangles.
    front = replace(surface, parts=(tuple(range(2, len(surface.points))), (0, 1)))
    space, *panels = [a for a in front.plot(tmp_path / "s.png").axes if a.get_label() != "<colorbar>"]
    assert (space.get_zlabel(), len(space.collections)) == ("loosened radius [m]", 1)
    drawn = np.hstack([line.get_data_3d() for line in space.lines if line.get_label().startswith("front, part")])
    shown = front.objectives / [1e3, 1e3, 1.0]
    assert np.roll(drawn.T, 2, axis=0) == pytest.approx(shown)
    # The third objective, four variables, and an empty place.
    assert [axes.axison for axes in panels] == [True] * 5 + [False]
    colours = [axes.collections[0] for axes in panels[:5]]
    assert np.asarray(colours[0].get_array()) == pytest.approx(shown[:, 2])
    for own in colours:
        assert np.asarray(own.get_offsets()) == pytest.approx(shown[:, :2])
    # The scale of the logarithmic stiffness, in the second column, ends 2 % beyond its values.
    log = colours[1].norm
    assert (log.vmin * 1.02, log.vmax / 1.02) == pytest.approx((front.designs[:, 2].min(), front.designs[:, 2].max()))
    axes = Figure().add_subplot(projection="3d")
    assert front.plot(axes) is axes


def test_failures_are_given_in_words_and_each_reason_once(surface):
    at = [point.objectives for point in surface.points[:3]]
    reasons = ("Infeasible_Problem_Detected: no design near the start meets the requirements",) * 2
    failures = tuple(map(MissingPoint, at, (*reasons, "Odd_Status: the optimiser stopped without an optimum")))
    lines = [line for line in printed(replace(surface, failures=failures), 1000) if "No certified design" in line]
    assert len(lines) == 2
    assert lines[0].endswith(": no design near the start meets the requirements.")
    assert lines[0].count(" kN and ") + lines[0].count(" m;") >= 2
    assert "_Problem_Detected" not in "".join(lines)
    assert "Odd_Status" not in "".join(lines)


# --- fronts of three objectives, in closed form: on their surfaces, evenly over all of them, with exact rates ---

POINTS, STEPS = 28, 6


# A search over all variables takes a minute longer. By default only the plane is searched so.
@pytest.fixture(scope="module", params=["near", pytest.param("auto", marks=pytest.mark.slow)])
def search(request):
    """Options of the search for a surface."""
    return request.param


@pytest.fixture(scope="module")
def sphere(search):
    """Concave front |f| = 1 outside the unit sphere, of which a weighted sum finds only the corners (DTLZ2)."""
    d, *x = design(**dict.fromkeys("xyz", (0.7, 0.0, 1.5)))
    d.require("outside", sum(own**2 for own in x), at_least=1.0)
    goals = (po.Goal(name, own) for name, own in zip("abc", x, strict=True))
    return po.trade_off(d, *goals, points=POINTS, search=search)


@pytest.fixture(scope="module")
def flat_surface():
    """Front f1 + f2 + f3 = 1 (DTLZ1)."""
    d, *x = design(**dict.fromkeys("xyz", (0.5, 0.0, 1.0)))
    d.require("above", sum(x), at_least=1.0)
    return po.trade_off(d, *x, points=POINTS)


@pytest.fixture(scope="module")
def convex_surface(search):
    """Front of the squared distances from three corners, whose efficient designs are those of the triangle."""
    d, x, y, z = design(x=(0.3, -2.0, 2.0), y=(0.3, -2.0, 2.0), z=(0.3, -2.0, 2.0))
    corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    goals = [po.Goal(f"to {a:g}, {b:g}", (x - a) ** 2 + (y - b) ** 2 + z**2) for a, b in corners]
    return po.trade_off(d, *goals, points=45, search=search)


# --- shapes -------------------------------------------------------------------------------------------------


def test_points_lie_on_the_surfaces(sphere, flat_surface, convex_surface):
    # The optimiser meets first-order conditions and requirements to 1e-10, anchors to that over a weight of 1e-6.
    assert np.linalg.norm(sphere.objectives, axis=1) == pytest.approx(1.0, abs=2e-5)
    assert np.sort(np.abs(np.linalg.norm(sphere.objectives, axis=1) - 1.0))[:-3] == pytest.approx(0.0, abs=1e-8)
    assert np.sum(flat_surface.objectives, axis=1) == pytest.approx(1.0, abs=1e-8)
    x, y, z = convex_surface.designs.T
    assert z == pytest.approx(0.0, abs=1e-5)
    for side in (x, y, 1.0 - x - y):
        assert np.all(side > -1e-4)


def test_anchors_are_on_the_front(sphere, convex_surface):
    for corner in np.eye(3):
        assert np.min(np.max(np.abs(sphere.objectives - corner), axis=1)) < 1e-4
    # The second and third objectives weigh 1e-3 and 1e-6 in an anchor, and move it by about as much.
    for corner in [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]:
        assert np.min(np.max(np.abs(convex_surface.designs - corner), axis=1)) < 3e-3


def test_a_plane_is_the_lattice_itself(flat_surface):
    lattice = [(i, j, STEPS - i - j) for i in range(STEPS + 1) for j in range(STEPS + 1 - i)]
    assert {tuple(row) for row in np.round(flat_surface.objectives * STEPS).astype(int)} == set(lattice)
    assert flat_surface.objectives * STEPS == pytest.approx(np.round(flat_surface.objectives * STEPS), abs=1e-6)


def test_the_whole_surface_is_covered(sphere, convex_surface):
    grid = np.array([p for p in itertools.product(np.linspace(0.0, 1.0, 25), repeat=2) if sum(p) <= 1.0])
    ball = np.column_stack([grid, 1.0 - np.sum(grid, axis=1)])
    triangle = np.column_stack([np.sum((grid - corner) ** 2, axis=1) for corner in ((0, 0), (1, 0), (0, 1))])
    for front, wanted, size, step in (
        (sphere, ball / np.linalg.norm(ball, axis=1, keepdims=True), 1.0, 1.0 / STEPS),
        (convex_surface, triangle, np.array([1.0, 2.0, 2.0]), 1.0 / 8.0),
    ):
        seen, found = (rows / size - np.mean(rows / size, axis=1, keepdims=True) for rows in (wanted, front.objectives))
        apart = np.min(np.max(np.abs(seen[:, None] - found[None]), axis=2), axis=1)
        # Every place in the lattice is within 2/3 of a step of a node; at the edges points are 0.7 steps apart.
        assert np.max(apart) < 1.3 * step
        assert np.mean(apart) < 0.6 * step


def test_no_point_beats_another(sphere, flat_surface, convex_surface):
    for front in (sphere, flat_surface, convex_surface):
        assert len(undominated(front.objectives)) == len(front.points)
        assert front.parts == (tuple(range(len(front.points))),)
        assert front.holes == front.failures == ()


def test_points_are_even(sphere):
    apart = distances(sphere.objectives) + np.eye(len(sphere.points))
    # Where the surface is steep, points between the nodes are shown too, so that no part of it is far from a point.
    assert np.min(apart) > 0.4 / STEPS
    assert np.max(np.min(apart, axis=1)) < 1.3 / STEPS


def test_rates_on_a_sphere(sphere):
    inner = [k for k, point in enumerate(sphere.points) if point.weights is not None and min(point.objectives) > 0.05]
    assert len(inner) > 10
    for k in inner:
        f = sphere.points[k].objectives
        for of, by in itertools.permutations(range(3), 2):
            # With the third objective held constant, f_of df_of + f_by df_by = 0.
            assert sphere.rate(k, of, by) == pytest.approx(-f[by] / f[of], rel=1e-6)
            assert sphere.cost(k, of, by) == pytest.approx((f[by] / f[of]) ** 2, rel=1e-6)


def test_words_on_three_objectives(sphere):
    middle = max(sphere.points, key=lambda point: min(point.objectives))
    assert sphere.in_words(sphere.points.index(middle), 2, 0).endswith("1 % less a costs 1 % more c")
    # The point in the middle of the sphere, to within a step of the lattice.
    assert middle.objectives == pytest.approx([1.0 / math.sqrt(3.0)] * 3, abs=0.02)
    with pytest.raises(po.InputError, match="of = 1 and by = 1 must be two different objectives, from 0 to 2"):
        sphere.rate(3, 1, 1)
    with pytest.raises(po.InputError, match="must be 3 objectives, finite numbers"):
        sphere.hypervolume((1.0, 1.0))


def test_the_knee_of_the_triangle(convex_surface, sphere):
    best = np.array(convex_surface.knee.objectives) / [1.0, 2.0, 2.0]
    assert np.sum(best) == pytest.approx(np.min(np.sum(convex_surface.objectives / [1.0, 2.0, 2.0], axis=1)), abs=0.02)
    assert sphere.knee is None


# --- shapes that are not whole ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_hole_between_two_parts():
    d, x, y = design(x=(0.2, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    d.require("outside", (x - 0.5) ** 2, at_least=0.09)
    front = po.trade_off(d, x, y, 2.0 - x - y, points=45, search=["x"])
    assert np.sum(front.objectives, axis=1) == pytest.approx(2.0, abs=1e-8)
    assert len(front.parts) == 2
    (hole,) = front.holes
    ends = sorted([hole.start[0], hole.end[0]])
    # An edge is located to half a step of the first objective's range of 1, and points are 0.7 steps apart.
    assert 0.0 < ends[0] <= 0.2 + 1e-9
    assert 0.8 - 1e-9 <= ends[1] < 1.0
    assert np.all((front.designs[:, 0] < 0.2 + 1e-9) | (front.designs[:, 0] > 0.8 - 1e-9))


def test_a_tail_that_gains_little_is_followed_to_its_end():
    d, s, t = design(s=(0.3, 0.0, 1.0), t=(0.3, 0.0, 1.0))
    # With t = 0 every s is efficient: from 0.6 to 1 the third objective gains 4 % for 40 and 64 % of the others.
    rest = 1.0 - s
    front = po.trade_off(d, s + t**2, s**2 + t**2, rest**4 + 0.03 * rest + t**2, points=45)
    step = 1.0 / 8.0
    # No design is farther from a point than two thirds of a step.
    assert np.max(np.diff(np.sort(np.r_[0.0, front.objectives[:, 0], 1.0]))) < 4.0 / 3.0 * step


def test_an_objective_that_conflicts_with_none_leaves_a_curve():
    d, x, y = design(x=(0.4, -2.0, 2.0), y=(0.4, -2.0, 2.0))
    idle = po.Goal("idle", 3.0 + y**2)
    front = po.trade_off(d, po.Goal("a", x**2 + y**2), idle, po.Goal("b", (x - 1.0) ** 2 + y**2), points=9)
    assert [goal.name for goal in front.goals] == ["a", "b"]
    assert front.notes[0] == "'idle' does not conflict with the others: it is at its best all along their front"
    assert np.sqrt(front.objectives).sum(axis=1) == pytest.approx(1.0, abs=1e-6)


# --- parameters and builds ----------------------------------------------------------------------------------


def shifted():
    """Return a design, and two objectives, the second of which has its optimum at a parameter."""
    d, x, y = design(x=(0.4, -4.0, 4.0), y=(0.4, -4.0, 4.0))
    c = d.parameter("c", 1.0)
    return d, (x**2 + y**2, (x - c) ** 2 + y**2)


def test_fronts_of_several_parameters_share_a_build(monkeypatch):
    built = []
    real = program_module.build_nlp
    monkeypatch.setattr(program_module, "build_nlp", lambda *a, **k: built.append(1) or real(*a, **k))
    d, goals = shifted()
    for c in (1.0, 3.0):
        front = po.trade_off(d, *goals, points=9, parameters={"c": c})
        assert np.sqrt(front.objectives).sum(axis=1) == pytest.approx(c, abs=1e-8)
    # The other objective weighs 1e-4 at the ends, and moves them by about as much.
    assert po.trade_off(d, *goals, points=9).objectives.max() == pytest.approx(1.0, abs=3e-4)
    assert len(built) == 2  # one, and a rough one for scans


def test_another_question_is_built_anew():
    d, (first, second) = shifted()
    local = {"points": 9, "search": "local"}
    began = time.perf_counter()
    front = po.trade_off(d, first, second, **local)
    assert 0.0 < front.seconds <= time.perf_counter() - began
    assert "Only the basin of the guess was searched" in front.search
    most = po.trade_off(d, first, po.Goal("b", -second, maximise=True), **local)
    assert most.objectives * [1.0, -1.0] == pytest.approx(front.objectives, abs=1e-9)
    assert -most.rates == pytest.approx(front.rates, rel=1e-6)
    assert most.hypervolume() == pytest.approx(front.hypervolume(), rel=1e-9)
    assert most.hypervolume((2.0, -3.0)) == pytest.approx(front.hypervolume((2.0, 3.0)), rel=1e-9)
    assert most.in_words(4).endswith("less b")
    d.require("kept", first, at_least=0.25)
    assert po.trade_off(d, first, second, **local).objectives[0, 0] == pytest.approx(0.25, rel=1e-8)


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
