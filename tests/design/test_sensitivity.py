"""Sensitivities of an optimum: against optima in closed form, and against designs solved again."""

import math
from types import SimpleNamespace

import casadi as ca
import pytest
from helpers.differences import order_4
from helpers.problem_files import SUBSOILER
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design.model import ipopt


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
