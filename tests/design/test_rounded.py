"""Optima in catalogue values: against closed forms, combinations by hand, and designs with these values as numbers."""

import itertools
import math
import pickle
from pathlib import Path

import casadi as ca
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design import Rounded

# The optimiser's tolerance, in objectives of order one.
SOLVED = 1e-9


def _solved(*, most=10.0, log=False):
    """Solve: minimise 2 x + y with x y >= 3: x = sqrt(3/2), y = sqrt(6), J = 2 sqrt(6); with x held J = 2 x + 3/x."""
    d = po.Design()
    x = d.variable("width of x", guess=1.0, lower=0.1, upper=10.0, unit="m", log=log)
    y = d.variable("y", guess=2.0, lower=0.1, upper=most, log=log)
    d.minimise(2.0 * x + y)
    d.require("yield", x * y, at_least=3.0, unit="m")
    best = d.solve()
    return best, x, y


@pytest.mark.parametrize("log", [False, True])
def test_the_best_of_a_catalogue_with_the_rest_solved_again(log):
    best, x, y = _solved(log=log)
    found = best.rounded({"width of x": [8.0, 1.5, 0.5, 1.1]})
    assert isinstance(found, Rounded)
    assert found.variables["width of x"] == 1.1
    assert found.variables["y"] == pytest.approx(3.0 / 1.1, rel=SOLVED)
    assert found.objective == pytest.approx(2.2 + 3.0 / 1.1, rel=SOLVED)
    assert found.cost == pytest.approx(2.2 + 3.0 / 1.1 - 2.0 * math.sqrt(6.0), rel=1e-6)
    assert found.cost_percent == pytest.approx(100.0 * found.cost / (2.0 * math.sqrt(6.0)), rel=1e-6)
    assert [choice.values["width of x"] for choice in found.tried] == [1.1, 1.5, 0.5, 8.0]
    by_hand = [2.0 * x + 3.0 / x for x in (1.1, 1.5, 0.5, 8.0)]
    assert [choice.objective for choice in found.tried] == pytest.approx(by_hand, rel=SOLVED)
    assert (found.combinations, found.screened) == (4, 4)
    assert (found(x), found(x * y)) == (1.1, pytest.approx(3.0, rel=SOLVED))
    assert found.active == ("yield",)
    assert found.fixed == ("width of x",)


def test_neither_order_nor_repetition_nor_values_beyond_the_bounds_matter():
    best, _, _ = _solved()
    one, other = best.rounded(width_of_x=[1.1, 1.5]), best.rounded(width_of_x=(90.0, 1.5, 0.02, 1.1, 1.5))
    assert one.objective == other.objective
    assert one.tried == other.tried


def test_every_choice_is_judged_within_its_tolerances():
    d = po.Design()
    x = d.variable("x", guess=0.5, lower=0.0, upper=1.0, tolerance=0.01)
    d.minimise(1.0 + 100.0 * (x - 0.3) ** 2)
    found = d.solve().rounded(x=[0.25, 0.31])
    first, second = found.tried
    # The sample of the box comes near its ends, within some hundredth of it.
    assert first.values == {"x": 0.31}
    assert first.spread.worst == pytest.approx(1.0 + 100.0 * 0.02**2, rel=1e-3)
    assert second.spread.worst == pytest.approx(1.0 + 100.0 * 0.06**2, rel=1e-2)
    assert found.spread == first.spread


@pytest.mark.parametrize(("x_step", "y_step"), [(0.5, 0.25), (0.2, 0.7), (1.0, 2.0)])
def test_steps_of_all_variables_are_all_combinations_by_hand(x_step, y_step):
    best, _, _ = _solved()
    found = best.rounded({"width of x": x_step}, y=y_step)
    sides = [[step * k for k in range(1, 100) if 0.1 <= step * k <= 10.0 * (1.0 + 1e-12)] for step in (x_step, y_step)]
    by_hand = {(x, y): 2.0 * x + y for x, y in itertools.product(*sides) if x * y >= 3.0}
    x, y = min(by_hand, key=by_hand.get)
    assert found.variables == pytest.approx({"width of x": x, "y": y}, rel=1e-14)
    assert found.objective == pytest.approx(by_hand[x, y], rel=1e-14)
    assert found.combinations == found.screened == math.prod(map(len, sides))
    assert len(found.tried) == 20
    for choice in found.infeasible:
        x, y = choice.values.values()
        assert choice.conflicts == {"yield": pytest.approx(3.0 - x * y, rel=1e-6)}


def test_an_optimum_in_the_catalogue_costs_nothing():
    best, _, _ = _solved()
    found = best.rounded({"width of x": [1.0, math.sqrt(1.5), 2.0]})
    assert found.variables["width of x"] == math.sqrt(1.5)
    assert found.cost_percent == pytest.approx(0.0, abs=1e-7)


def test_an_optimum_on_its_bound_is_a_multiple_of_the_step():
    d, x = design(x=(0.5, 0.3, 1.0))
    d.minimise(x)
    found = d.solve().rounded(x=0.1)
    assert found.variables == pytest.approx({"x": 0.3}, rel=1e-15)
    assert found.combinations == 8


def test_a_side_that_is_infeasible_is_named():
    best, _, _ = _solved(most=2.5)
    found = best.rounded(width_of_x=[1.0, 1.5])
    assert found.variables["width of x"] == 1.5
    (failed,) = found.infeasible
    # At x = 1 the other variable's bound of 2.5 leaves 0.5 missing.
    assert failed.conflicts == {"yield": pytest.approx(0.5, rel=1e-6)}
    assert "width of x = 1 m is infeasible: 'yield' fails by 0.5 m" in str(found)
    assert str(found).startswith(
        "width of x = 1.5 m, y = 2: objective 5, 2.06 % above that of the optimum; all 2 combinations were optimised"
    )


def test_a_far_value_that_others_make_better_is_found():
    """The catalogue's best lies in another basin than the optimum, and with the others held it is the worst."""
    d, x, y = design(x=(0.1, 0.0, 1.0), y=(0.1, 0.0, 1.0))
    near, far = (x - 0.11) ** 2 + (y - 0.1) ** 2, (x - 0.9) ** 2 + (y - 0.9) ** 2
    # Two wells: the narrower one is deeper by 0.1 at its bottom, between the values of the catalogue.
    d.minimise(2.0 - 1.1 * ca.exp(-near / 0.0005) - ca.exp(-far / 0.005))
    best = d.solve(judge="bare")
    assert best.variables["x"] == pytest.approx(0.11, abs=1e-4)
    found = best.rounded(x=[0.01, 0.2, 0.5, 0.9])
    assert found.variables["x"] == 0.9
    assert found.objective == pytest.approx(1.0, rel=1e-8)


def test_of_very_many_combinations_the_neighbours_are_tried_and_it_says_so():
    best, _, _ = _solved()
    found = best.rounded(width_of_x=0.01, y=1e-3)
    assert found.combinations == 991 * 9901
    assert found.screened == len(found.tried) == 4
    assert f"of {991 * 9901} combinations only the 4 beside the optimum were tried" in str(found)


def test_nothing_feasible_says_so_of_every_combination():
    best, _, _ = _solved(most=2.5)
    with pytest.raises(po.InfeasibleDesign) as refusal:
        best.rounded(width_of_x=[0.8, 1.0])
    assert refusal.value.conflicts == {"yield": pytest.approx(0.5, rel=1e-6)}
    assert refusal.value.blockers == ["catalogue of 'width of x'"]
    assert "width of x = 1 m: 'yield' (at least 3 m) fails by 0.5 m" in str(refusal.value)


def test_its_sensitivities_keep_what_is_held():
    found = _solved()[0].rounded(width_of_x=[1.1])
    by_yield = found.sensitivity("yield", check=True)
    assert by_yield.objective == pytest.approx(1.0 / 1.1, rel=1e-10)
    assert by_yield.variables == pytest.approx({"width of x": 0.0, "y": 1.0 / 1.1}, rel=1e-10, abs=1e-12)
    assert by_yield.difference < 1e-5
    assert [item.name for item in found.every_sensitivity()] == ["yield at_least"]
    with pytest.raises(po.InputError, match="neither a parameter nor a limit"):
        found.sensitivity("width of x upper")


@pytest.mark.parametrize(
    ("catalogues", "message"),
    [
        ({"with of x": 0.1}, "did you mean 'width of x'"),
        ({}, "nothing to round"),
        ({"width of x": []}, "must hold finite numbers"),
        ({"width of x": [1.0, math.nan]}, "must hold finite numbers"),
        ({"width of x": "1 m"}, "must hold finite numbers"),
        ({"width of x": 0.0}, "must be above 0"),
        ({"width of x": [20.0, 30.0]}, "lies between its bounds 0.1 m and 10 m"),
        ({"width of x": 0.1, "width_of_x": 0.2}, "two catalogues"),
    ],
)
def test_refusals(catalogues, message):
    with pytest.raises(po.InputError, match=message):
        _solved()[0].rounded(catalogues)


def test_once_rounded_there_is_nothing_to_round_and_it_can_be_kept():
    found = _solved()[0].rounded(width_of_x=[1.1])
    with pytest.raises(po.InputError, match="rounded already"):
        found.rounded(y=0.1)
    again = pickle.loads(pickle.dumps(found))
    assert (again.variables, again.cost, again.tried) == (found.variables, found.cost, found.tried)


@pytest.mark.slow
def test_cotton_against_designs_with_these_values_as_numbers():
    file = Path(__file__).parents[2] / "problems" / "cotton_subsoiler.toml"
    few = ["scene.outputs=50"]
    design, run = po.read_problem(file, few).design()
    found = design.solve(search="local").rounded(
        stiffness=[4e4, 5e4, 6.3e4], wedge_angle=[po.deg(1.0) * k for k in range(37, 41)]
    )
    assert found.variables["scene.stiffness"] == 5e4
    assert found.variables["share.wedge_angle"] == po.deg(1.0) * 39
    feasible = [choice for choice in found.tried if choice.objective is not None]
    assert (found.combinations, len(found.tried)) == (4 * 3, 12)
    assert found.objective == pytest.approx(feasible[0].objective, rel=1e-8)
    assert 0.0 < found.cost_percent < 1.0
    assert found(run).mean_draft == pytest.approx(found(run.mean_draft), rel=1e-9)

    def by_numbers(values):
        fixed = [
            f'{name}="{value!r} {unit}"' for (name, value), unit in zip(values.items(), ("N/m", "rad"), strict=True)
        ]
        return po.read_problem(file, few + fixed).design()[0].solve(search="local").objective

    # Either way the optimiser stops 1e-10 from the optimum, and the objective's transcription is good to 1e-9.
    assert found.objective == pytest.approx(by_numbers(feasible[0].values), rel=1e-9)
    # Geometry alone: at 40 degrees the cone is too blunt, whatever its height. The softest spring gives way too far.
    blunt = po.Wedge(po.deg(40.0), po.deg(15.0), 0.25).equivalent_cone().half_angle
    failing = [choice for choice in found.infeasible if choice.values["share.wedge_angle"] == po.deg(1.0) * 40]
    assert [choice.values["scene.stiffness"] for choice in failing] == [5e4, 6.3e4, 4e4]
    for choice in failing[:2]:
        assert choice.conflicts == {"half_angle": pytest.approx(blunt - po.deg(15.0), rel=1e-7)}
