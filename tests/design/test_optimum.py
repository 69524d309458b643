"""Optimum: limits with multipliers, its runs, other parameters, sensitivities; it is a value that nothing changes."""

import copy
import dataclasses
import math
import pickle
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest
from helpers.differences import order_4
from helpers.every_result import EVERY
from helpers.problem_files import SUBSOILER
from helpers.small_designs import design, sticking

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
    "sextic": (lambda x, y: 1.0 + (x - 0.25) ** 2 + (y - 0.5) ** 6, {"at_most": 3.0}, 1.0, []),
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


def test_an_optimum_says_the_same_whatever_happens_later():
    d, run = _spring()
    asked = []

    def ask(**question):
        best = d.solve(**question)
        asked.append((best, _asked(copy.deepcopy(best), run)))
        return best

    first = ask(search="near")
    ask(search=16, seed=3, parameters={"tow speed": 2.0})
    first.rounded(stiffness=[5e4, 9e4], height=[0.23, 0.25])
    ask(search="stiffness", parameters={"tow speed": 1.0}).every_sensitivity()
    print(first)
    d.parameter("p", 1.0)
    stiffness = d.declared.variables[0].symbol
    po.trade_off(d, stiffness, 1.0 / stiffness, points=5, search="near")
    for best, before in asked:
        assert _asked(copy.deepcopy(best), run) == before
    again = ask(search="near")
    assert (again.objective, again.variables) == (first.objective, first.variables)


def test_a_copy_keeps_the_design_and_a_pickle_leaves_it_out():
    d, run = _spring()
    best = d.solve(search="near")
    for one in (copy.copy(best), copy.deepcopy(best)):
        assert one == best
        assert one(run.mean_draft) == best(run.mean_draft)
        assert str(one.rounded(height=[0.23])) == str(best.rounded(height=[0.23]))
    one = best.sensitivity("tow speed")
    again = pickle.loads(pickle.dumps(replace(best, sensitivities=(one,))))
    assert again == replace(best, sensitivities=(one,))
    assert again.sensitivity("tow speed") == one
    for refused in (
        lambda: again(run.mean_draft),
        lambda: again.rounded(height=[0.23]),
        lambda: again.sensitivity("x"),
    ):
        with pytest.raises(po.InputError, match="saved without its design"):
            refused()


def test_results_are_equal_if_their_numbers_are(tmp_path):
    names = ("Optimum", "LocalOptimum", "Rounded", "TradeOff", "Run", "Machine")
    first = [*(EVERY[name]() for name in names), EVERY["Optimum"]().search]
    for number, one in enumerate(first):
        assert one == copy.deepcopy(one) == pickle.loads(pickle.dumps(one))
        assert hash(one) == hash(copy.deepcopy(one))
        assert [one == other for other in first] == [k == number for k in range(len(first))]
        assert one != "a text"
        if hasattr(one, "save"):
            assert po.load(one.save(tmp_path / f"{number}.json")) == one
    best, _, other, *_ = first
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


def _exponential():
    d, x = design(x=(0.1, -1.0, 3.0))
    d.minimise(ca.exp(x) - d.parameter("a", 2.0) * x)
    return d


def _equality(centre):
    d, x, y = design(x=(0.7, -5.0, 5.0), y=(0.7, -5.0, 5.0))
    d.minimise((x - centre) ** 2 + (y - centre) ** 2)
    d.require("sum", x + y, at_least=1.0, at_most=1.0)
    return d


def _band():
    d, x = design(x=(0.0, -5.0, 5.0))
    d.minimise(ca.exp(-x))
    d.require("band", 2.0 * x, at_least=-1.0, at_most=3.0)
    return d


ROOT, LOG, HALF, STILL = math.sqrt(6.0), math.log(2.0), {"x": 0.5, "y": 0.5}, {"x": 0.0, "y": 0.0}
# Design, parameter or limit, derivatives of the objective and of the variables, and up to where they hold and why.
SENSITIVITIES = [
    # x = ln a, J = a - a ln a; bounds are reached, to first order, after (bound - x) a.
    (_exponential, "a", -LOG, {"x": 0.5}, {"valid_from": 2.0 + 2.0 * (-1.0 - LOG)}, "x lower begins"),
    (_exponential, "a", -LOG, {"x": 0.5}, {"valid_to": 2.0 + 2.0 * (3.0 - LOG)}, "x upper begins"),
    # J = 2 (c/2 - centre)^2, whichever way the equality pulls.
    *((partial(_equality, c), "sum", 1.0 - 2.0 * c, HALF, {}, "") for c in (0.0, 2.0)),
    (_band, "band at_most", -0.5 * math.exp(-1.5), {"x": 0.5}, {}, ""),
    (_band, "band at_least", 0.0, {"x": 0.0}, {"valid_to": 3.0}, ""),
]  # fmt: skip
for log in (False, True):
    free, bounded = (partial(_cost_against_yield, most=most, log=log) for most in (10.0, 1.0))
    SENSITIVITIES += [
        (free, "weight", ROOT / 2.0, {"x": -ROOT / 8.0, "y": ROOT / 4.0}, {}, ""),
        (free, "yield at_least", 2.0 / ROOT, {"x": 0.5 / ROOT, "y": 1.0 / ROOT}, {}, ""),
        # An inactive limit changes nothing until it is met: x itself, whatever its scale.
        (free, "x upper", 0.0, STILL, {"valid_from": ROOT / 2.0}, "x upper begins"),
        # x = 1 rather than 1.22, and y = c, J = a X + c/X. The bound's multiplier c/X^2 - a vanishes at X = sqrt(c/a),
        # along X by -2c; the yield's at c = a.
        (bounded, "weight", 1.0, STILL, {}, ""),
        (bounded, "x upper", -1.0, {"x": 1.0, "y": -3.0}, {"valid_to": 1.0 + 1.0 / 6.0}, "x upper ceases"),
        (bounded, "yield", 1.0, {"x": 0.0, "y": 1.0}, {"valid_from": 2.0}, "x upper ceases"),
    ]


@pytest.mark.parametrize(("build", "name", "objective", "variables", "valid", "why"), SENSITIVITIES)
def test_sensitivities_in_closed_form(build, name, objective, variables, valid, why):
    best = build().solve()
    found = best.sensitivity(name, check=True)
    assert found.objective == pytest.approx(objective, rel=EXACT, abs=1e-15)
    assert found.variables == found.falling == pytest.approx(variables, rel=EXACT, abs=EXACT)
    assert found.touching == ()
    assert found.elasticity == pytest.approx(found.objective * found.value / best.objective, rel=EXACT)
    relative = {own: slope * found.value / best.variables[own] for own, slope in found.variables.items()}
    assert found.elasticities == pytest.approx(relative, rel=EXACT)
    assert {end: getattr(found, end) for end in valid} == pytest.approx(valid, rel=EXACT)
    assert any(text.startswith(why) for text in found.then)
    # Solving again: a step of 1e-3 leaves some 1e-6 of derivatives of order one, the optimiser's 1e-10 some 1e-7.
    assert found.difference < 5e-6


def test_a_check_that_cannot_solve_is_refused_and_a_wrong_name_has_a_suggestion(monkeypatch):
    best = _cost_against_yield().solve(parameters={"weight": 8.0})
    # At the parameters of the solve.
    assert best.sensitivity("weight").objective == pytest.approx(math.sqrt(3.0 / 8.0), rel=EXACT)
    assert best.sensitivity("weight").difference is None
    with pytest.raises(po.InputError, match="did you mean 'band at_least' or 'band at_most'"):
        _band().solve().sensitivity("band")
    monkeypatch.setitem(ipopt.FROM_BOTTOM, "ipopt.max_cpu_time", 1e-9)
    with pytest.raises(po.NotConverged, match="check could not solve"):
        best.sensitivity("weight", check=True)


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
    assert "whatever its value" not in str(_cost_against_yield().solve().sensitivity("x upper"))


def test_a_result_of_zero_has_no_elasticity():
    d, x, y = design(x=(0.5, 0.0, 1.0, "m"), y=(0.5, -1.0, 1.0))
    d.minimise(x + (y - d.parameter("a", 0.3, unit="m")) ** 2)
    found = d.solve().sensitivity("a")
    # But for rounding, the objective and x are 0.
    assert (found.elasticity, found.elasticities["x"]) == (None, None)
    assert "x by 0 per m, y by +1 %" in str(found)
