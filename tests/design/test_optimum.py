"""Optimum: limits with multipliers, its runs, other parameters, sensitivities; it is a value that nothing changes."""

import copy
import dataclasses
import math
import pickle
import re
from dataclasses import dataclass, replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers.differences import order_4
from helpers.problem_files import SUBSOILER
from helpers.small_designs import design, sticking
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import plough_opt as po
from plough_opt.design.model import ipopt


def _limit(best, name):
    (limit,) = [limit for limit in best.limits if limit.name == name]
    return limit


# --- multipliers --------------------------------------------------------------------------------------------


def test_multiplier_of_a_path_is_the_slope_of_the_best_objective(r1_scene, r1_wave):
    def solve(deflection):
        d, k0 = design(stiffness=(2e4, 1e4, 1e6, "N/m", True))
        run = po.simulate(r1_scene(stiffness=k0, strength_wave=r1_wave, damping=2e3), 1.0, outputs=100)
        d.minimise(1.0 + k0 / 1e5)
        d.require("deflection", run.deflection, at_most=deflection, unit="m")
        return d.solve(search="local")

    limit = _limit(solve(0.02), "deflection")
    assert limit.active
    assert limit.value == pytest.approx(0.02, rel=1e-8)
    assert limit.multiplier == pytest.approx(-order_4(lambda z: solve(z).objective, 0.02, 1e-5), rel=1e-6)


def test_an_inactive_limit_has_no_multiplier(r1):
    limit = _limit(r1.best, "mean deflection")
    assert not limit.active
    assert limit.multiplier < 1e-6
    assert limit.value == pytest.approx(r1.best(r1.run.mean_draft) / 5e3, rel=1e-8)
    assert limit.margin == pytest.approx(0.15 - limit.value, rel=1e-12)
    # That of a bound is the distance to the nearer one: 0.10 m to 0.50 m.
    height = _limit(r1.best, "height")
    assert height.margin == pytest.approx(min(height.value - 0.10, 0.50 - height.value), abs=1e-12)


def test_variables_may_have_the_names_of_columns():
    d, first, second = design(objective=(0.25, 0.1, 0.5, "m"), optimum=(0.25, 0.1, 0.5))
    d.minimise(1.0 + (first - 0.2) ** 2 + (second - 0.3) ** 2)
    best = d.solve(search="near")
    frame = best.to_dataframe()
    assert list(frame.columns) == ["optimum", "objective", "variable objective", "variable optimum"]
    assert frame.loc[0, ["objective", "variable objective", "variable optimum"]].tolist() == pytest.approx(
        [1, 0.2, 0.3]
    )
    assert frame.attrs["units"] == {"variable objective": "m", "variable optimum": ""}
    assert [one["kind"] for one in best.origin.declarations.values()] == ["variable", "variable", "objective"]


# --- an expression, a run ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pair:
    name: str
    runs: tuple[po.Run, ...]


def test_a_nested_run_is_simulated_and_checked_as_it_is_alone(build_r1):
    problem = build_r1(outputs=7, duration=0.5)
    run, best = problem.run, problem.design.solve(search="local")
    alone = best(run)
    assert (len(alone.time), best(run.deflection).shape, alone.duration) == (8, (8,), 0.5)
    nested = best({"wanted": [run.mean_draft, _Pair("both", (run, run))]})
    for found in nested["wanted"][1].runs:
        for name in ("mean_draft", "error_estimate", "warnings"):
            assert getattr(found, name) == getattr(alone, name)
        np.testing.assert_array_equal(found.deflection, alone.deflection)
        assert isinstance(found.scene.stiffness, float)


# --- parameters ---------------------------------------------------------------------------------------------


@pytest.fixture
def with_parameter(build_r1, r1_soil):
    """Build R1 with the soil's cohesion as a parameter."""

    def build(value):
        soil = replace(r1_soil, cohesion=value)
        return build_r1(soil=soil, parameters=["cohesion"], duration=1.0, outputs=20, damping=300.0)

    return build


def test_a_parameter_of_a_solve_acts_as_if_declared_and_only_in_that_solve(with_parameter):
    question, harder = with_parameter(15e3), with_parameter(30e3)
    d, run = question.design, question.run
    first, fresh = d.solve(), harder.design.solve()
    before, other, again = first(run.mean_draft), d.solve(parameters={"cohesion": 30_000}), d.solve()
    assert first(run.mean_draft) == before
    assert (again.objective, again.variables) == (first.objective, first.variables)
    assert other.objective > 1.2 * first.objective
    # The program is scaled by the first solve's objective; both are good to the optimiser's 1e-10.
    assert other.objective == pytest.approx(fresh.objective, rel=1e-9)
    assert other.variables == pytest.approx(fresh.variables, rel=1e-7)
    assert len(other.local_optima) == len(fresh.local_optima)
    assert other(run.mean_draft) == pytest.approx(fresh(harder.run.mean_draft), rel=1e-9)
    assert (other(question.soil).cohesion, first(question.soil).cohesion) == (30e3, 15e3)


def test_an_unknown_or_impossible_parameter_is_refused(with_parameter):
    d = with_parameter(15e3).design
    for values, error, words in (
        ({"cohesoin": 20e3}, po.InputError, "'cohesoin' is not a parameter of this design: did you mean 'cohesion'"),
        ({"height": 0.2}, po.InputError, "'height' is not a parameter of this design"),
        ({"cohesion": -1.0}, po.PloughError, "cohesion"),
    ):
        with pytest.raises(error, match=words):
            d.solve(parameters=values)


def test_the_program_is_built_once_for_all_solves(build_nlp, with_parameter):
    d = with_parameter(15e3).design
    d.solve()
    program, written = d._program, build_nlp.call_count
    for cohesion in (14e3, 20e3, 15e3):
        d.solve(parameters={"cohesion": cohesion})
    assert d._program is program
    assert build_nlp.call_count == written


# --- warnings, copies -----------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [True, False])
def test_an_optimum_carries_the_warnings_of_its_run(motion):
    d, angle = design(angle=(po.deg(30), po.deg(20), po.deg(80), "rad"))
    share = po.Wedge(angle, po.deg(15), 0.25)
    scene = po.Scene(po.named_soil("serozem"), share, 1e5, 25.0, 2.0, po.Effects(motion=motion))
    run = po.simulate(scene, 0.5)
    d.minimise(run.mean_draft / 1e3)
    d.require("loosened radius", scene.loosened_radius, at_least=0.25, unit="m")
    best = d.solve()
    assert any("hypothesis of plane sections does not hold" in text for text in best.warnings)
    assert set(best.warnings) == set(best(run).warnings)


def test_a_pickled_optimum_keeps_its_numbers_and_refuses_what_needs_the_design(r1):
    one = r1.best.sensitivity("loosened radius")
    again = pickle.loads(pickle.dumps(replace(r1.best, sensitivities=(one,))))
    assert again.local_optima == r1.best.local_optima
    assert again.sensitivity("loosened radius") == one
    for lost in (
        lambda: again(r1.run.mean_draft),
        lambda: again.sensitivity("wedge angle upper"),
        lambda: again.rounded({"wedge angle": 0.1}),
    ):
        with pytest.raises(po.InputError, match="without its design"):
            lost()


def test_wedge_and_chisel_angle_cannot_be_told_apart(r1_soil):
    # Both angles are free, and only the cone's half angle matters.
    d = po.Design()
    angle = d.variable("wedge angle", guess=po.deg(25.0), lower=po.deg(5.0), upper=po.deg(60.0), unit="rad")
    chisel = d.variable("chisel angle", guess=po.deg(15.0), lower=po.deg(5.0), upper=po.deg(30.0), unit="rad")
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.50, unit="m")
    share = po.Wedge(angle, chisel, height)
    cone = share.equivalent_cone()
    scene = po.Scene(r1_soil, share, 2e4, 25.0, 2.0, po.Effects(strength_wave=po.StrengthWave(0.3, 0.6), damping=300.0))
    run = po.simulate(scene, 1.0)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
    d.require("loosened radius", po.loosened_radius(cone, r1_soil), at_least=0.12, unit="m")
    d.require("half angle", cone.half_angle, at_most=po.deg(15.0), unit="rad")
    best = d.solve(search="local")
    assert best.status == "not unique"
    (direction,) = best.flat_directions
    assert abs(direction["height"]) < 1e-6
    # One angle grows while the other one shrinks.
    assert re.search(r"wedge angle (\+.* chisel angle -|-.* chisel angle \+)", " ".join(str(best).split()))

    def change(part):
        moved = (best.variables[name] + part * direction[name] for name in ("wedge angle", "chisel angle"))
        return abs(po.Wedge(*moved, 0.3).equivalent_cone().half_angle - best(cone).half_angle)

    # A tangent: a tenth of the step leaves a hundredth of the change. Across it 0.3 rad change for one of wedge angle.
    assert change(0.1) / change(1.0) == pytest.approx(0.01, rel=0.1)
    assert change(0.1) < 1e-2 * abs(0.1 * direction["wedge angle"])


# Objective, limits of the sum x + y, the best objective, and a basis of the flat directions.
VALLEYS = {
    "idle variable": (lambda x, _: 1.0 + (x - 0.25) ** 2, {"at_most": 3.0}, 1.0, [[0.0, 1.0]]),
    "total in the objective": (lambda x, y: 1.0 + (x + y - 1.2) ** 2, {"at_most": 3.0}, 1.0, [[1.0, -1.0]]),
    "zero at the optimum": (lambda x, y: (x + y - 0.7) ** 2, {"at_most": 3.0}, 0.0, [[1.0, -1.0]]),
    "total at an active limit": (lambda x, y: x + y, {"at_least": 0.7}, 0.7, [[1.0, -1.0]]),
    "constant objective": (lambda _x, _y: 1.0, {"at_most": 2.5}, 1.0, [[1.0, 0.0], [0.0, 1.0]]),
    "steep": (lambda x, y: 1.0 + 1e4 * (x - 0.25) ** 2 + (y - 0.5) ** 2, {"at_most": 3.0}, 1.0, []),
    "gentle": (lambda x, y: 1.0 + (x - 0.25) ** 2 + 1e-4 * (y - 0.5) ** 2, {"at_most": 3.0}, 1.0, []),
    "quartic": (lambda x, y: 1.0 + (x - 0.25) ** 2 + (y - 0.5) ** 4, {"at_most": 3.0}, 1.0, []),
    "corner": (lambda x, y: x + 2.0 * y + 1.0, {"at_most": 3.0}, 1.0, []),
}


@pytest.mark.parametrize(("objective", "limits", "least", "basis"), VALLEYS.values(), ids=VALLEYS)
def test_flat_directions_known_by_hand(objective, limits, least, basis):
    d, x, y = design(x=(0.9, 0.0, 1.0), y=(0.3, 0.0, 2.0))
    d.minimise(objective(x, y))
    d.require("sum", x + y, **limits)
    best = d.solve()
    assert best.status == ("not unique" if basis else "solved")
    assert best.objective == pytest.approx(least, abs=1e-8)
    assert len(best.flat_directions) == len(basis)
    if basis:
        found = np.array([[direction["x"], direction["y"]] for direction in best.flat_directions])
        assert np.linalg.matrix_rank(found) == len(basis)
        # Each is a step of 1 % of the range of the variable that changes most, within the space of the basis.
        assert np.max(np.abs(found) / [1.0, 2.0], axis=1) == pytest.approx(0.01, rel=1e-9)
        assert found @ (np.eye(2) - np.linalg.pinv(basis) @ basis) == pytest.approx(0.0, abs=1e-8)


# --- stationary points that are not minima ------------------------------------------------------------------


@pytest.mark.parametrize("search", ["auto", "near"])
@pytest.mark.parametrize(("others", "lean"), [(0, 0.8), (0, -0.8), (1, 0.8), (1, -0.8)])
def test_a_start_on_a_hilltop_or_a_saddle_is_left_on_the_lower_side(others, lean, search):
    d, x = design(x=(0.5, 0.0, 1.0))
    hill = 2.0 - (x - 0.5) ** 2 - lean * (x - 0.5) ** 3
    for k in range(others):
        hill += (d.variable(f"y{k}", guess=0.5, lower=0.0, upper=1.0) - 0.3) ** 2
    d.minimise(hill)
    # The gradient is zero at the start; the ends of x are 0.15 and 0.35 lower.
    assert d.solve(search=search).objective == pytest.approx(1.65, rel=1e-8)


def test_the_hilltops_of_several_variables_are_all_left():
    """Also if a run's events leave the descents to IPOPT, which moves one variable after the other."""
    d, *x = design(**{f"x{k}": (0.5, 0.0, 1.0) for k in range(4)})
    d.minimise(2.0 - sum((v - 0.5) ** 2 + 0.8 * (v - 0.5) ** 3 for v in x) + 1e-12 * sticking((x[0] - 0.5) ** 2))
    assert d.solve(search="near").objective == pytest.approx(2.0 - 4 * 0.35, rel=1e-7)


def test_a_saddle_with_too_little_to_gain_is_an_answer():
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    # The ends of x are lower by 1e-7 only, and there is nothing else to move to.
    d.minimise(1.0 - 4e-7 * (x - 0.5) ** 2 + (y - 0.5) ** 2)
    best = d.solve(search="near")
    assert best.status == "solved"
    assert best.objective == pytest.approx(1.0, abs=2e-7)


# --- a result is a value: nothing that happens later, to its design or to other results, changes a bit of it ---


def _spring():
    """Return a design of a share on a spring under a strength wave, and its run."""
    d, k0, height = design(stiffness=(7e4, 2e4, 2e5, "N/m", True), height=(0.25, 0.2, 0.35, "m"))
    speed, soil = d.parameter("tow speed", 1.5, unit="m/s"), po.named_soil("serozem")
    share = po.Cone(0.2, height)
    scene = po.Scene(soil, share, k0, 60.0, speed, po.Effects(strength_wave=po.StrengthWave(0.3, 0.4)))
    run = po.simulate(scene, 0.3, outputs=1)
    d.minimise(run.force_rms / 1e3 + run.mean_draft / 1e4 + k0 / 4e5)
    d.require("radius", po.loosened_radius(share, soil), at_least=0.1, unit="m")
    return d, run


def _asked(best, run):
    """Return all that an optimum says, also by computing again."""
    rounded = best.rounded(stiffness=[4e4, 6e4, 1e5])
    return {
        "text": str(best),
        "deflection": best(run.mean_deflection),
        "sensitivity": best.sensitivity("tow speed", check=True),
        "every": best.every_sensitivity(),
        "rounded": (str(rounded), rounded.variables, rounded.tried, rounded.spread),
        "margins": best.margins,
        "spread": best.spread,
        "json": best.to_json(),
    }


QUESTIONS = [
    {"search": "near"},
    {"search": "near", "parameters": {"tow speed": 2.0}},
    {"search": 16, "seed": 3},
    {"search": 16, "seed": 4, "judge": "bare"},
    {"search": "stiffness", "parameters": {"tow speed": 1.0}},
]
# What may happen between two questions, by a name: to the design, and to the results at hand.
EVENTS = {
    **{f"solve {k}": lambda d, results, k=k: results.append((k, d.solve(**QUESTIONS[k]))) for k in range(5)},
    "round": lambda _, results: results[0][1].rounded(stiffness=[5e4, 9e4], height=[0.23, 0.25]),
    "sensitivity": lambda _, results: results[-1][1].every_sensitivity(),
    "print": lambda _, results: print(results[0][1]),
    "declare": lambda d, _: d.parameter(f"p{len(d._parameters)}", 1.0),
    "front": lambda d, _: po.trade_off(
        d, d._variables[0].symbol, 1.0 / d._variables[0].symbol, points=5, search="near"
    ),
}


@pytest.fixture(scope="module")
def alone():
    """For each question what its optimum says if nothing else was ever asked of the design."""
    answers = {}
    for number, question in enumerate(QUESTIONS):
        d, run = _spring()
        answers[number] = _without_time(_asked(d.solve(**question), run))
    return answers


def _without_time(asked):
    """Return answers without the texts that hold the seconds or the date of a solve."""
    return {key: own for key, own in asked.items() if key not in ("text", "json")}


# The seed is fixed; each example takes about two seconds.
@settings(max_examples=2, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.integers(0, len(QUESTIONS) - 1), st.lists(st.sampled_from(sorted(EVENTS)), min_size=2, max_size=5))
def test_an_optimum_says_the_same_whatever_happens_later(alone, first, events):
    d, run = _spring()
    results = [(first, d.solve(**QUESTIONS[first]))]
    before = str(results[0][1]), results[0][1].to_json()
    for event in events:
        EVENTS[event](d, results)
    for number, best in results:
        assert _without_time(_asked(copy.deepcopy(best), run)) == alone[number]
    assert (str(results[0][1]), results[0][1].to_json()) == before


def test_a_copy_keeps_the_design_and_a_pickle_leaves_it_out():
    d, run = _spring()
    best = d.solve(search="near")
    for one in (copy.copy(best), copy.deepcopy(best)):
        assert one == best
        assert one(run.mean_draft) == best(run.mean_draft)
        assert str(one.rounded(height=[0.23])) == str(best.rounded(height=[0.23]))
    again = pickle.loads(pickle.dumps(best))
    assert again == best
    for refused in (
        lambda: again(run.mean_draft),
        lambda: again.rounded(height=[0.23]),
        lambda: again.sensitivity("x"),
    ):
        with pytest.raises(po.InputError, match="saved without its design"):
            refused()


def _results():
    """Return results of every kind that a design or a run gives."""
    d, run = _spring()
    best = d.solve(search=16)
    front = po.trade_off(d, run.mean_draft / 1e3, run.force_rms / 1e3, points=5, search="near")
    still = po.simulate(best(run.scene), 0.1, outputs=2)
    return [
        best,
        best.local_optima[0],
        best.rounded(height=[0.23]),
        best.search,
        front,
        still,
        po.Machine({"a": still}),
    ]


def test_results_are_equal_if_their_numbers_are(tmp_path):
    first = _results()
    for number, one in enumerate(first):
        assert one == copy.deepcopy(one) == pickle.loads(pickle.dumps(one))
        assert hash(one) == hash(copy.deepcopy(one))
        assert [one == other for other in first] == [k == number for k in range(len(first))]
        assert one != "a text"
        if hasattr(one, "save"):
            assert po.load(one.save(tmp_path / f"{number}.json")) == one
    best, other = first[0], first[2]
    assert dataclasses.replace(best, objective=best.objective * (1.0 + 1e-15)) != best
    assert best.search != dataclasses.replace(best.search, values=best.search.values + 1e-12)
    assert best.search == dataclasses.replace(best.search, values=best.search.values.copy())
    assert other.search is None


# --- sensitivities of an optimum: against optima in closed form, and against designs solved again ---


def _cost_against_yield(a=2.0, c=3.0, *, most=10.0, log=False):
    """Build: minimise a x + y with x y >= c, whose optimum is x = sqrt(c/a), y = sqrt(c a), J = 2 sqrt(a c)."""
    d, x, y = design(x=(1.0, 0.1, most, "m", log), y=(4.0, 0.1, 10.0, "", log))
    d.minimise(d.parameter("weight", a, unit="1/m") * x + y)
    d.require("yield", x * y, at_least=c)
    return d


# --- closed forms ---------------------------------------------------------------------------------------------

# The conditions are solved to rounding by Newton's method, so a derivative is good to rounding too: 1e-10 leaves room
# for the condition of these small matrices.
EXACT = 1e-10


@pytest.mark.parametrize("log", [False, True])
def test_an_active_requirement_and_free_variables(log):
    best = _cost_against_yield(log=log).solve()
    root = math.sqrt(6.0)
    by_weight, by_yield = best.sensitivity("weight"), best.sensitivity("yield at_least")
    assert by_weight.objective == pytest.approx(root / 2.0, rel=EXACT)  # sqrt(c/a)
    assert by_yield.objective == pytest.approx(2.0 / root * 2.0 / 2.0, rel=EXACT)  # sqrt(a/c)
    assert by_weight.variables == pytest.approx({"x": -root / 8.0, "y": root / 4.0}, rel=EXACT)
    assert by_weight.elasticity == pytest.approx(0.5, rel=EXACT)
    assert by_weight.elasticities == pytest.approx({"x": -0.5, "y": 0.5}, rel=EXACT)
    assert by_yield.elasticity == pytest.approx(0.5, rel=EXACT)
    assert by_yield.elasticities == pytest.approx({"x": 0.5, "y": 0.5}, rel=EXACT)
    assert by_yield.touching == ()
    assert by_yield.falling == by_yield.variables


def test_no_active_limit():
    d, x = design(x=(0.1, -1.0, 3.0))
    d.minimise(ca.exp(x) - d.parameter("a", 2.0) * x)
    found = d.solve().sensitivity("a")
    # x = ln a, J = a - a ln a; bounds are reached, to first order, after (bound - x) a.
    assert found.objective == pytest.approx(-math.log(2.0), rel=EXACT)
    assert found.variables["x"] == pytest.approx(0.5, rel=EXACT)
    assert found.elasticities["x"] == pytest.approx(1.0 / math.log(2.0), rel=EXACT)
    assert found.valid_to == pytest.approx(2.0 + 2.0 * (3.0 - math.log(2.0)), rel=EXACT)
    assert found.valid_from == pytest.approx(2.0 + 2.0 * (-1.0 - math.log(2.0)), rel=EXACT)
    assert found.then == ("x lower begins to decide", "x upper begins to decide")


@pytest.mark.parametrize("log", [False, True])
def test_variables_on_their_limits_follow_them(log):
    best = _cost_against_yield(most=1.0, log=log).solve()  # x = 1 rather than 1.22, y = c
    assert best.sensitivity("weight").variables == pytest.approx({"x": 0.0, "y": 0.0}, abs=EXACT)
    assert best.sensitivity("weight").objective == pytest.approx(1.0, rel=EXACT)
    by_bound, by_yield = best.sensitivity("x upper"), best.sensitivity("yield")
    assert by_bound.objective == pytest.approx(2.0 - 3.0, rel=EXACT)  # J = a X + c/X
    assert by_bound.variables == pytest.approx({"x": 1.0, "y": -3.0}, rel=EXACT)
    assert by_yield.objective == pytest.approx(1.0, rel=EXACT)
    assert by_yield.variables == pytest.approx({"x": 0.0, "y": 1.0}, rel=EXACT, abs=EXACT)
    # The bound's multiplier c/X^2 - a vanishes at X = sqrt(c/a), along X by -2c: the yield's at c = a.
    assert by_bound.valid_to == pytest.approx(1.0 + 1.0 / 6.0, rel=EXACT)
    assert by_bound.then[1] == "x upper ceases to decide"
    assert by_yield.valid_from == pytest.approx(2.0, rel=EXACT)
    assert by_yield.then[0] == "x upper ceases to decide"


@pytest.mark.parametrize("log", [False, True])
def test_an_inactive_limit_changes_nothing_until_it_is_met(log):
    found = _cost_against_yield(log=log).solve().sensitivity("x upper")
    assert (found.objective, found.variables) == (0.0, {"x": 0.0, "y": 0.0})
    assert found.valid_from == pytest.approx(math.sqrt(1.5), rel=EXACT)  # x itself, whatever its scale
    assert (found.valid_to, found.then) == (None, ("x upper begins to decide", ""))
    assert "whatever its value" not in str(found)


@pytest.mark.parametrize("centre", [0.0, 2.0])
def test_an_equality_whichever_way_it_pulls(centre):
    d, x, y = design(x=(0.7, -5.0, 5.0), y=(0.7, -5.0, 5.0))
    d.minimise((x - centre) ** 2 + (y - centre) ** 2)
    d.require("sum", x + y, at_least=1.0, at_most=1.0)
    found = d.solve().sensitivity("sum", check=True)
    assert found.objective == pytest.approx(1.0 - 2.0 * centre, rel=EXACT)  # J = 2 (c/2 - centre)^2
    assert found.variables == pytest.approx({"x": 0.5, "y": 0.5}, rel=EXACT)
    # A parabola: differences are exact, but for the optimiser's 1e-10 over a step of 1e-3.
    assert found.difference < 1e-6


def test_two_limits_of_one_requirement_are_two_questions():
    d, x = design(x=(0.0, -5.0, 5.0))
    d.minimise(ca.exp(-x))
    d.require("band", 2.0 * x, at_least=-1.0, at_most=3.0)
    best = d.solve()
    upper = best.sensitivity("band at_most", check=True)
    assert upper.objective == pytest.approx(-0.5 * math.exp(-1.5), rel=EXACT)
    # As for the other checks.
    assert upper.difference < 5e-6
    assert best.sensitivity("band at_least").objective == 0.0
    assert best.sensitivity("band at_least").valid_to == pytest.approx(3.0, rel=EXACT)
    with pytest.raises(po.InputError, match="did you mean 'band at_least' or 'band at_most'"):
        best.sensitivity("band")


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_limit_that_just_touches_makes_the_derivatives_one_sided(unit):
    d, x, y = design(x=(0.3, -1.0, 1.0), y=(0.3, -2.0, 2.0))
    d.minimise((x - d.parameter("a", unit) / unit) ** 2 + (y - x) ** 2 + 1.0)
    best = d.solve()
    by_a, by_bound = best.sensitivity("a", check=True), best.sensitivity("x upper")
    assert by_a.touching == ("x upper",)
    assert by_a.objective * unit == pytest.approx(0.0, abs=EXACT)
    assert by_a.elasticities == pytest.approx({"x": 0.0, "y": 0.0}, abs=EXACT)
    assert by_a.falling == pytest.approx({"x": 1.0 / unit, "y": 1.0 / unit}, rel=EXACT)
    assert by_bound.variables == pytest.approx({"x": 0.0, "y": 0.0}, abs=EXACT)
    assert by_bound.falling == pytest.approx({"x": 1.0, "y": 1.0}, rel=EXACT)
    # One-sided differences of a parabola over a thousandth.
    assert by_a.difference < 2e-3
    assert "increasing values" in str(by_a)


# --- solving again --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["weight", "yield", "x upper", "y lower"])
@pytest.mark.parametrize("most", [1.0, 10.0])
def test_check_solves_again(monkeypatch, name, most):
    best = _cost_against_yield(most=most).solve()
    # A step of 1e-3 leaves some 1e-6 of derivatives of order one, the optimiser's 1e-10 some 1e-7.
    assert best.sensitivity(name, check=True).difference < 5e-6
    assert best.sensitivity(name).difference is None
    monkeypatch.setitem(ipopt.FROM_BOTTOM, "ipopt.max_cpu_time", 1e-9)
    with pytest.raises(po.NotConverged, match="check could not solve"):
        best.sensitivity(name, check=True)


def _bounded_parabola():
    d, x = design(x=(0.3, -1.0, 1.0))
    d.minimise((x - d.parameter("a", 1.0)) ** 2 + 1.0)
    return d


DIFFERENCES = {
    # One per cent of dy/dw = sqrt(c/a)/2, times w = 2, over y's range of 9.9.
    "on both sides": (_cost_against_yield, "weight", 0.01 * math.sqrt(1.5) / 9.9, 0.01),
    # One per cent of dx/da = 1 as a falls, over x's range of 2, but for the optimiser's 1e-7 over a step of 1e-3. As a
    # rises x stays at its bound: a mean of both sides would halve it.
    "on one side": (_bounded_parabola, "a", 0.005, 0.05),
}


@pytest.mark.parametrize(("build", "name", "difference", "near"), DIFFERENCES.values(), ids=DIFFERENCES)
def test_check_finds_a_wrong_derivative(monkeypatch, build, name, difference, near):
    best = build().solve()
    right = best.solved._in_units
    monkeypatch.setattr(best.solved, "_in_units", lambda dy: {k: 1.01 * v for k, v in right(dy).items()})
    assert best.sensitivity(name, check=True).difference == pytest.approx(difference, rel=near)


@pytest.fixture(scope="module")
def r1_parameters(build_r1):
    """R1, solved near its best optimum, with cohesion and speed as parameters."""
    design = build_r1(guess=(39.0, 0.2, 5.1e3), parameters=("cohesion", "tow speed")).design
    return SimpleNamespace(design=design, best=design.solve(search="local"))


@pytest.mark.parametrize(("name", "value", "step"), [("cohesion", 15e3, 75.0), ("tow speed", 2.0, 2e-3)])
def test_r1_solved_again_with_other_parameters(r1_parameters, name, value, step):
    found = r1_parameters.best.sensitivity(name)
    assert found.value == value

    def at(parameter):
        return r1_parameters.design.solve(parameters={name: parameter}, search="local")

    slope = order_4(lambda parameter: at(parameter).objective, value, step)
    # The transcription's own objective differs from the tight one by some 1e-9, smoothly; the differences of values
    # good to 1e-12 over a relative step of 1e-3 to 5e-3 leave 1e-9 of a part of the slope by speed that nearly cancels.
    assert found.objective == pytest.approx(slope, rel=2e-7)
    assert set(r1_parameters.best.active) == {"loosened radius", "half angle", "stiffness"}
    # Three active limits hold the three variables, and the parameters do not move these limits.
    assert at(value + step).variables == pytest.approx(r1_parameters.best.variables, rel=1e-8)
    assert max(map(abs, found.elasticities.values())) < 1e-12


def test_sensitivities_are_at_the_parameters_of_the_solve():
    found = _cost_against_yield().solve(parameters={"weight": 8.0}).sensitivity("weight")
    assert found.value == 8.0
    assert found.objective == pytest.approx(math.sqrt(3.0 / 8.0), rel=EXACT)


def test_every_quantity_of_a_problem_file_has_a_sensitivity():
    best = po.read_problem(SUBSOILER).design(parameters=True)[0].solve(search="local")
    assert len(best.every_sensitivity()) == 17  # the strength factor among them
    # A relative step of 2e-4 leaves its square times third derivatives of order one, the optimiser's 1e-10 over it.
    assert best.sensitivity("soil.density_ratio", check=True).difference < 5e-6


# --- refusals -------------------------------------------------------------------------------------------------


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(po.InputError) as refusal:
        _cost_against_yield().solve().sensitivity("wieght")
    with pytest.raises(po.InputError, match=r"valid names: .*[^.]\. Parameters: weight"):
        _cost_against_yield().solve().sensitivity("nope")
    assert "did you mean 'weight'?" in str(refusal.value)
    assert "declare it with design.parameter" in str(refusal.value)


ONE_DESIGN = {"at_least": (0.5, 1), "at_most": (0.5, 1)}
# Objective of x and y between 0.1 and 2 and of a parameter a = 1; limits of x, each with the number of times that it is
# required; a name; and words of the refusal.
REFUSED = {
    "not unique": (lambda x, y, a: (x + y - a) ** 2 + 1.0, {}, "a", r"not unique.*fix one of x, y"),
    "kink": (lambda x, y, a: ca.fabs(x - a) + (x - a) ** 2 + y + 1.0, {}, "a", "cannot be distinguished"),
    "kink without curvature": (lambda x, y, a: ca.fabs(x - a) + (y - 1.0) ** 2 + 1.0, {}, "a", "does not curve"),
    "no curvature": (lambda x, y, a: (x - a) ** 4 + (y - 1.0) ** 2 + 1.0, {}, "a", "does not curve"),
    "dependent": (lambda x, y, _: x**2 + y, {"at_least": (0.1, 1)}, "x lower", r"only.*x lower.*not independent"),
    "touching": (lambda x, y, a: (x - a) ** 2 + (y - a) ** 2, {"at_least": (1.0, 9)}, "a", "too many limits"),
    # No design is left if either limit moves into the other.
    "no design left below": (lambda x, y, _: x**2 + y, ONE_DESIGN, "only", "no derivative"),
    "no design left above": (lambda x, y, _: x**2 + y, ONE_DESIGN, "also", "no derivative"),
}


@pytest.mark.parametrize(("objective", "limits", "name", "words"), REFUSED.values(), ids=REFUSED)
def test_optima_without_a_derivative_are_refused(objective, limits, name, words):
    d, x, y = design(x=(0.7, 0.1, 2.0), y=(0.7, 0.1, 2.0))
    d.minimise(objective(x, y, d.parameter("a", 1.0)))
    for side, (limit, rows) in limits.items():
        d.require("only" if side == "at_least" else "also", ca.repmat(x, rows, 1), **{side: limit})
    with pytest.raises((po.InputError, po.NotConverged), match=words):
        d.solve().sensitivity(name)


def test_every_sensitivity_comes_in_order_of_size_and_only_if_it_matters():
    d, x = design(x=(0.5, 0.2, 3.0))
    d.parameter("idle", 3.0)
    d.minimise(d.parameter("a", 2.0) * x + d.parameter("b", 0.1) * x**2)
    found = d.solve().every_sensitivity()
    assert [item.name for item in found] == ["x lower", "a", "b"]
    # J = a x + b x^2 at x = 0.2.
    expected = [(0.4 + 0.008) / 0.404, 0.4 / 0.404, 0.004 / 0.404]
    assert [item.elasticity for item in found] == pytest.approx(expected, rel=EXACT)


def test_in_words():
    text = str(_cost_against_yield().solve().sensitivity("yield", check=True))
    assert text.startswith("yield = 3; one per cent more changes the objective by +0.5 %, x by +0.5 %, y by +0.5 %.")
    assert "Solving again" in text


def test_a_result_of_zero_has_no_elasticity():
    d, x, y = design(x=(0.5, 0.0, 1.0, "m"), y=(0.5, -1.0, 1.0))
    d.minimise(x + (y - d.parameter("a", 0.3, unit="m")) ** 2)
    found = d.solve().sensitivity("a")
    # But for rounding, the objective and x are 0.
    assert (found.elasticity, found.elasticities["x"]) == (None, None)
    assert "x by 0 per m, y by +1 %" in str(found)
