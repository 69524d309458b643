"""Designs as they are made: over the tolerances of their variables, and rounded to catalogue values."""

import functools
import itertools
import math
import pickle
import re

import casadi as ca
import numpy as np
import pytest
from helpers.problem_files import COTTON, PROBLEMS, SUBSOILER
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design import Rounded
from plough_opt.design.confirmation import boxes
from plough_opt.design.search import effort

# --- designs as made, variables solved for in closed form, and tolerances in files

T = 0.1


def _offsets(d, *values):
    """Return the deviations of a design's variables from these values, as sampled within their tolerances."""
    variables = d.declared.variables
    box = boxes(variables, np.array([[v.scaled(x) for v, x in zip(variables, values, strict=True)]]))
    return np.array([[v.value(y) for v, y in zip(variables, row, strict=True)] for row in box]) - values


def test_a_linear_variable_is_made_within_its_tolerance_too():
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.2, 0.0, 1.0, "", False, T))
    d.minimise((x - 0.3) ** 2 + 10.0 * y + 1.0)
    d.require("r", y - x, at_least=0.1)
    best = d.solve()
    made = np.array(list(best.variables.values())) + _offsets(d, *best.variables.values())
    objectives = (made[:, 0] - 0.3) ** 2 + 10.0 * made[:, 1] + 1.0
    assert best.spread.worst == pytest.approx(objectives.max(), rel=1e-9)
    assert best.spread.kept == np.mean(made[:, 1] - made[:, 0] >= 0.1) < 1.0


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bound_on_a_peak_lies_on_it(log, sign):
    d, x, peak = design(x=(0.5, 0.0, 1.0), peak=(90.0, 0.01, 100.0, "", log))
    curves = [3.0 + ca.sin(11.0 * x), 3.0 + ca.cos(7.0 * x)]
    d.minimise(sign * peak)
    d.require("below", sign * (ca.vertcat(*curves) - peak), at_most=0.0)
    best = d.solve()

    def by_hand(x):
        return (sign * np.array([3.0 + np.sin(11.0 * x), 3.0 + np.cos(7.0 * x)])).max(axis=0)

    least = by_hand(np.linspace(0.0, 1.0, 200_001)).min()
    assert least - 1e-4 <= best.objective <= least + 1e-9


# --- problem files ----------------------------------------------------------------------------------------


def test_a_file_takes_the_variables_of_the_page(tmp_path):
    page = (PROBLEMS.parent / "docs" / "howto" / "tolerances.md").read_text("utf-8")
    variables = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)[0]
    path = tmp_path / "share.toml"
    path.write_text(re.sub(r"\[variables\].*?(?=\n\[)", variables, COTTON, flags=re.DOTALL), encoding="utf-8")
    design, _ = po.read_problem(path, ['share.wedge_angle="39 deg"']).design()
    assert [v.tolerance for v in design.declared.variables] == [pytest.approx(0.002, rel=1e-15), "5 %"]


WRONG = {'variables.share.height.tolerance="-5 mm"': "not be below 0"}


@pytest.mark.parametrize(("change", "words"), WRONG.items())
def test_files_with_wrong_tolerances_are_refused(change, words):
    with pytest.raises(po.InputError, match=words):
        po.read_problem(SUBSOILER, [change])


# --- what it costs to keep requirements in all designs as made ---


def test_the_cost_of_keeping_all_requirements():
    d, x, y = design(x=(0.5, 0.0, 1.0, "", False, 0.01), y=(0.5, 0.0, 1.0, "", False, 0.02))
    d.minimise(10.0 + 2.0 * x + y)
    d.require("sum", x + y, at_least=0.8)
    best = d.solve(search="near")
    # At y = 0.8 and x = 0, whose tolerance ends at the bound: y must rise by its tolerance, which costs as much, and
    # the worst design as made is worse by both tolerances, which the sample nearly shows.
    assert best.cost_of_keeping == pytest.approx(0.02 + 2.0 * 0.01 + 0.02, rel=0.15)
    assert best.spread.kept < 0.5 or best.keeping() == ""
    assert ("costs about" in str(best)) == (best.spread.kept < 0.5)


# --- optima in catalogue values, compared with closed forms and with all combinations by hand ---

# The optimiser's tolerance for objectives of order 1.
SOLVED = 1e-9


@functools.cache
def _solved(*, most=10.0, log=False):
    """Minimise 2 x + y with x y >= 3: x = sqrt(3/2), y = sqrt(6), J = 2 sqrt(6); with x held J = 2 x + 3/x."""
    d, x, y = design(**{"share.tip width": (1.0, 0.1, 10.0, "m", log), "y": (2.0, 0.1, most, "", log)})
    d.minimise(2.0 * x + y)
    d.require("yield", x * y, at_least=3.0, unit="m")
    return d.solve(), x, y


@pytest.mark.parametrize("log", [False, True])
def test_the_best_of_a_catalogue_with_the_rest_solved_again(log):
    best, x, y = _solved(log=log)
    found = best.rounded({"share.tip width": [90.0, 10.0, 1.5, 0.5, 1.1, 0.02, 1.5]})
    assert isinstance(found, Rounded)
    assert found.variables["share.tip width"] == 1.1
    assert found.variables["y"] == pytest.approx(3.0 / 1.1, rel=SOLVED)
    assert found.objective == pytest.approx(2.2 + 3.0 / 1.1, rel=SOLVED)
    assert found.cost == pytest.approx(2.2 + 3.0 / 1.1 - 2.0 * math.sqrt(6.0), rel=1e-6)
    assert found.cost_percent == pytest.approx(100.0 * found.cost / (2.0 * math.sqrt(6.0)), rel=1e-6)
    assert [choice.values["share.tip width"] for choice in found.tried] == [1.1, 1.5, 0.5, 10.0]
    by_hand = [2.0 * x + 3.0 / x for x in (1.1, 1.5, 0.5, 10.0)]
    assert [choice.objective for choice in found.tried] == pytest.approx(by_hand, rel=SOLVED)
    assert (found.combinations, found.screened) == (4, 4)
    assert (found(x), found(x * y)) == (1.1, pytest.approx(3.0, rel=SOLVED))
    assert found.active == ("yield",)
    assert found.fixed == ("share.tip width",)


def test_without_time_the_best_combination_so_far_is_returned(monkeypatch):
    monkeypatch.setattr(effort, "AUTO_SECONDS", 0.0)
    best, _, _ = _solved()
    found = best.rounded({"share.tip width": [1.5, 0.5, 1.1]})
    assert len(found.tried) == 1
    left_out = "descents in some combinations and optima of 2 of the 3 most promising ones were left out"
    assert left_out in found.warnings[0]
    assert found.objective == pytest.approx(2.2 + 3.0 / 1.1, rel=SOLVED)


@pytest.mark.parametrize(("x_step", "y_step"), [(0.5, 0.25), (0.2, 0.7), (1.0, 2.0)])
def test_steps_for_all_variables_give_the_best_combination(x_step, y_step):
    best, _, _ = _solved()
    found = best.rounded({"share.tip width": x_step}, y=y_step)
    sides = [[step * k for k in range(1, 100) if 0.1 <= step * k <= 10.0 * (1.0 + 1e-12)] for step in (x_step, y_step)]
    by_hand = {(x, y): 2.0 * x + y for x, y in itertools.product(*sides) if x * y >= 3.0}
    x, y = min(by_hand, key=by_hand.get)
    assert found.variables == pytest.approx({"share.tip width": x, "y": y}, rel=1e-14)
    assert found.objective == pytest.approx(by_hand[x, y], rel=1e-14)
    assert found.combinations == found.screened == math.prod(map(len, sides))
    assert len(found.tried) == 20
    for choice in found.infeasible:
        x, y = choice.values.values()
        assert choice.conflicts == {"yield": pytest.approx(3.0 - x * y, rel=1e-6)}
    # The first combination misses the limit by 1e-8 of it.
    assert best.rounded(tip_width=[1.0, 2.0], y=[3.0 - 3e-8]).variables["share.tip width"] == 2.0


def test_an_optimum_on_its_bound_is_a_multiple_of_the_step():
    d, x = design(x=(0.5, 0.3, 1.0))
    d.minimise(x)
    found = d.solve().rounded(x=0.1)
    assert found.variables == pytest.approx({"x": 0.3}, rel=1e-15)
    assert found.combinations == 8


def test_an_infeasible_value_is_named():
    best, _, _ = _solved(most=2.5)
    found = best.rounded(tip_width=[1.0, 1.5])
    assert found.variables["share.tip width"] == 1.5
    (failed,) = found.infeasible
    # At x = 1 the bound y <= 2.5 leaves a shortfall of 0.5.
    assert failed.conflicts == {"yield": pytest.approx(0.5, rel=1e-6)}
    assert "share.tip width = 1 m is infeasible: 'yield' fails by 0.5 m" in str(found)
    assert "2.06 % above that of the optimum" in str(found)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("worse", [0, 4000])
def test_the_lowest_of_many_basins_of_several_free_variables_is_found(worse, seed):
    """A parabola with ripples in each direction; every variable counts by itself, so the answer is known by hand."""

    def rippled(x, middle):
        return (x - middle) ** 2 + 0.1 * (1.0 - ca.cos(40.0 * (x - middle)))

    bottom = (0.309, 0.339, 0.751)
    d, *variables = design(**dict.fromkeys("xyz", (0.3, 0.0, 1.0)))
    d.minimise(1.0 + sum(map(rippled, variables, bottom)))
    values = [0.05, 0.25, 0.5, 0.75, 0.95, *np.linspace(0.9, 1.0, worse)]
    found = d.solve(search="near", seed=seed).rounded(x=values)
    assert found.objective == pytest.approx(1.0 + min(float(rippled(x, bottom[0])) for x in values), rel=1e-9)


def test_a_variable_that_searches_solve_for_keeps_its_catalogue_value():
    d, x, y, z = design(**dict.fromkeys("xyz", (0.5, 0.0, 1.0)))
    d.minimise(10.0 + x + 50.0 * y + z)
    d.require("least", x, at_least=0.2)
    # The first part has lower designs that nearly meet it, the second one lies around (0.9, 0.9).
    lower = (y - 0.2) ** 2 + (z - 0.2) ** 2 + 1e-3
    d.require("either", ca.fmin(lower, (y - 0.9) ** 2 + (z - 0.9) ** 2 - 1e-3), at_most=0.0)
    found = d.solve().rounded(x=[0.1, 0.3])
    assert [choice.values for choice in found.tried] == [{"x": 0.3}, {"x": 0.1}]
    assert found.objective == pytest.approx(10.3 + 51.0 * 0.9 - math.sqrt(2501.0 * 1e-3), rel=SOLVED)


def test_of_very_many_combinations_only_the_neighbours_are_tried():
    best, _, _ = _solved()
    found = best.rounded(tip_width=0.01, y=1e-3)
    assert found.combinations == 991 * 9901
    assert found.screened == len(found.tried) == 4
    assert f"of {991 * 9901} combinations only the 4 next to the optimum were tried" in str(found)
    # A millionth above the optimum: a multiple within that part of the range is taken for it.
    step = 1.000001e-3
    assert best.rounded(tip_width=step * math.sqrt(1.5), y=step * math.sqrt(6.0)).screened == 1


def test_every_infeasible_combination_is_named():
    best, _, _ = _solved(most=2.5)
    with pytest.raises(po.InfeasibleDesign) as refusal:
        best.rounded(tip_width=[0.8, 1.0])
    assert refusal.value.conflicts == {"yield": pytest.approx(0.5, rel=1e-6)}
    assert refusal.value.blockers == ["catalogue of 'share.tip width'"]
    assert "share.tip width = 1 m: 'yield' (at least 3 m) fails by 0.5 m" in str(refusal.value)


def test_sensitivities_keep_the_rounded_variables_held():
    found = _solved()[0].rounded(tip_width=[1.1])
    by_yield = found.sensitivity("yield", check=True)
    assert by_yield.objective == pytest.approx(1.0 / 1.1, rel=1e-10)
    assert by_yield.variables == pytest.approx({"share.tip width": 0.0, "y": 1.0 / 1.1}, rel=1e-10, abs=1e-12)
    assert by_yield.difference < 1e-5
    assert [item.name for item in found.every_sensitivity()] == ["yield at_least"]
    with pytest.raises(po.InputError, match="neither a parameter nor a limit"):
        found.sensitivity("share.tip width upper")


REFUSED = [
    ({"share.tip wdth": 0.1}, "did you mean 'share.tip width'"),
    ({}, "nothing to round"),
    ({"share.tip width": [1.0, math.nan]}, "must hold finite numbers"),
    ({"share.tip width": 0.0}, "must be above 0"),
    ({"share.tip width": 1e-16}, "too small for its bounds"),
    ({"share.tip width": [20.0, 30.0]}, "lies between its bounds 0.1 m and 10 m"),
    ({"share.tip width": 0.1, "tip_width": 0.2}, "two catalogues"),
]


@pytest.mark.parametrize(("catalogues", "message"), REFUSED)
def test_refusals(catalogues, message):
    with pytest.raises(po.InputError, match=message):
        _solved()[0].rounded(catalogues)


def test_a_rounded_optimum_cannot_be_rounded_again_but_pickled():
    found = _solved()[0].rounded(tip_width=[1.1])
    with pytest.raises(po.InputError, match="rounded already"):
        found.rounded(y=0.1)
    again = pickle.loads(pickle.dumps(found))
    assert (again.variables, again.cost, again.tried) == (found.variables, found.cost, found.tried)
