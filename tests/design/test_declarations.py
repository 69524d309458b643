"""Declarations that a design refuses, and the sentence with which it does."""

import math
import re

import casadi as ca
import numpy as np
import pytest
from helpers.small_designs import design
from hypothesis import given
from hypothesis import strategies as st

import plough_opt as po
from plough_opt.design.declarations import Variable

WELL = {"guess": 0.25, "lower": 0.1, "upper": 0.5, "unit": "m"}


def _variable(**changes):
    settings = {"name": "height", "symbol": ca.MX.sym("height"), "log": False} | WELL | changes
    return Variable(**settings)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"guess": 0.6}, r"its guess 0.6( m)? lies outside its bounds 0.1( m)? to 0.5 m"),
        ({"guess": 0.09}, r"its guess 0.09( m)? lies outside its bounds 0.1( m)? to 0.5 m"),
        ({"lower": 0.5, "guess": 0.5}, r"lower 0.5( m)? is not below upper 0.5 m"),
        ({"lower": 0.7}, r"lower 0.7( m)? is not below upper 0.5 m"),
        ({"guess": math.nan}, "must be a finite number"),
        ({"lower": math.nan}, "must be a finite number"),
        ({"upper": math.nan}, "must be a finite number"),
        ({"lower": -math.inf}, "must be a finite number"),
        ({"upper": math.inf}, "must be a finite number"),
        ({"lower": 0.0, "log": True}, "needs a lower bound above 0, not 0"),
        ({"lower": -1.0, "log": True}, "needs a lower bound above 0, not -1"),
        ({"log": "yes"}, "log = 'yes' must be True or False"),
        ({"guess": "0.25"}, '= "0.25" has no unit: write it like "0.3 m"'),
        ({"upper": np.array([0.5])}, r"array\(\[0.5\]\) is not a number"),
    ],
)
def test_a_variable_that_cannot_be_is_refused_by_name(changes, sentence):
    with pytest.raises(po.InputError) as caught:
        po.Design().variable("share height", **(WELL | changes))
    assert str(caught.value).startswith("variable 'share height': ")
    assert re.search(sentence, str(caught.value))


def test_a_refused_variable_leaves_no_trace():
    d = po.Design()
    with pytest.raises(po.InputError):
        d.variable("x", guess=2.0, lower=0.0, upper=1.0)
    x = d.variable("x", guess=0.5, lower=0.0, upper=1.0)
    d.minimise((x - 0.2) ** 2)
    assert d.solve().variables == {"x": pytest.approx(0.2, rel=1e-8)}


@pytest.mark.parametrize("first", ["variable", "parameter"])
@pytest.mark.parametrize("second", ["variable", "parameter"])
def test_a_name_declared_twice_is_refused(first, second):
    def declare(kind):
        return d.variable("cohesion", guess=1.0, lower=0.0, upper=2.0) if kind == "variable" else d.parameter(
            "cohesion", 1.0
        )  # fmt: skip

    d = po.Design()
    declare(first)
    with pytest.raises(po.InputError, match="'cohesion' is declared already"):
        declare(second)


@pytest.mark.parametrize("name", ["", "  ", 3, None])
def test_what_is_declared_has_a_name(name):
    d, x = design(x=(0.5, 0.0, 1.0))
    for declare in (
        lambda: d.variable(name, **WELL),
        lambda: d.parameter(name, 1.0),
        lambda: d.require(name, x, at_most=0.9),
    ):
        with pytest.raises(po.InputError, match=r"name = .* must be a text"):
            declare()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_parameter_without_a_finite_value_is_refused(value):
    with pytest.raises(po.InputError, match=r"parameter 'cohesion': .* must be a finite number"):
        po.Design().parameter("cohesion", value)


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ({}, "has no limit: give at_least, at_most or both"),
        ({"at_least": 2.0, "at_most": 1.0}, r"at least 2( m)? is above at most 1 m"),
        ({"at_least": math.nan}, "at_least: nan must be a finite number"),
        ({"at_most": math.inf}, "at_most: inf must be a finite number"),
        ({"at_most": "0.12 kg"}, 'at_most = "0.12 kg" has the wrong unit: expected a quantity in m'),
        ({"at_most": np.array([0.1, 0.2])}, "at_most: .* is not a number"),
        ({"at_least": ca.DM([0.1, 0.2])}, "at_least: .* is not a number"),
        ({"at_least": ca.MX.sym("limit")}, "at_least: .* is not a number"),
    ],
)
def test_limits_that_cannot_be_are_refused_by_name(limits, sentence):
    d, x = design(x=(0.5, 0.0, 1.0))
    with pytest.raises(po.InputError) as caught:
        d.require("loosened radius", x, unit="m", **limits)
    assert str(caught.value).startswith("requirement 'loosened radius'")
    assert re.search(sentence, str(caught.value))


@pytest.mark.parametrize(
    ("declare", "sentence"),
    [
        (lambda d, x: [d.require("radius", x, **{side: 0.1}) for side in ("at_least", "at_most")],
         "'radius' is declared already"),
        (lambda d, x: d.minimise(ca.vertcat(x, x**2)), "objective must be one number, not 2"),
        (lambda d, _: d.minimise("mean draft"), "the objective: 'mean draft' is neither an expression nor a number"),
        (lambda d, _: d.require("radius", ca.MX(0, 1), at_least=0.0), "'radius' has no value to limit"),
        (lambda d, _: d.minimise(ca.SX.sym("x") ** 2), "the objective is an SX expression"),
        (lambda d, _: d.require("radius", ca.SX.sym("x"), at_least=0.0), "'radius' is an SX expression"),
        (lambda d, _: d.solve(), "nothing to minimise"),
    ],
)  # fmt: skip
def test_what_is_no_objective_and_no_requirement_is_refused(declare, sentence):
    with pytest.raises(po.InputError, match=sentence):
        declare(*design(x=(0.5, 0.0, 1.0)))


def test_solving_without_variables_is_refused():
    d = po.Design()
    d.minimise(3.0)
    with pytest.raises(po.InputError, match="nothing to choose"):
        d.solve()


@pytest.mark.parametrize(
    ("objective", "requirement", "sentence"),
    [
        (lambda x: x * ca.MX.sym("stranger"), None, r"'objective' holds symbols that .* not declare \(stranger\)"),
        (lambda x: x, lambda x: x + ca.MX.sym("stranger"), r"'radius' holds symbols .* \(stranger\)"),
        # A namesake of another design.
        (lambda x: (x - design(x=(0.5, 0.0, 1.0))[1]) ** 2, None, r"'objective' holds symbols .* \(x\)"),
    ],
)
def test_a_foreign_symbol_is_named(objective, requirement, sentence):
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(objective(x))
    if requirement:
        d.require("radius", requirement(x), at_least=0.1)
    with pytest.raises(po.InputError, match=sentence):
        d.solve()


@pytest.mark.parametrize("where", ["objective", "requirement"])
def test_a_model_without_a_value_at_the_start_names_what_fails(where):
    d, x = design(x=(-0.5, -1.0, 1.0, "m"))
    bad = ca.log(x)
    d.minimise(bad if where == "objective" else x**2)
    d.require("radius", bad if where == "requirement" else x, at_least=-3.0)
    named = "the objective" if where == "objective" else "requirement 'radius'"
    with pytest.raises(po.InputError, match=rf"{named} is not a finite number at the start \(x = -0.5 m\)"):
        d.solve(search="near")
    # A search over all designs needs no good guess.
    assert d.solve().status in ("solved", "unconfirmed")


@pytest.mark.parametrize(
    ("side", "bounds", "named"),
    [("lower", {"lower": -1e3, "upper": 1e5}, "stiffness"), ("upper", {"lower": 1.0, "upper": 95.0}, "wedge angle")],
)
def test_bounds_outside_the_models_domain_are_named(r1_scene, r1_wave, side, bounds, named):
    d = po.Design()
    x = d.variable(named, guess=25.0, **bounds)
    own = {"stiffness": x} if named == "stiffness" else {"wedge_angle_deg": x}
    d.minimise(po.simulate(r1_scene(**own, strength_wave=r1_wave), 0.5, outputs=5).mean_draft)
    with pytest.raises(po.DomainError, match=f"at the {side} bound of '{named}': {named} = "):
        d.solve()


def test_a_parameter_without_a_value_at_solve_is_refused():
    d, x = design(x=(0.5, 0.0, 1.0))
    p = d.parameter("cohesion", 0.3)
    d.minimise((x - p) ** 2)
    with pytest.raises(po.InputError):
        d.solve(parameters={"cohesion": math.nan})


# --- scaling ------------------------------------------------------------------------------------------------

BOUNDS = st.tuples(st.floats(1e-6, 1e6), st.floats(1e-3, 1e6)).map(lambda pair: (pair[0], pair[0] * (1.0 + pair[1])))


@given(bounds=BOUNDS, y=st.floats(0.0, 1.0), log=st.booleans())
def test_scaling_and_its_inverse_agree(bounds, y, log):
    lower, upper = bounds
    variable = _variable(lower=lower, upper=upper, guess=lower, log=log)
    assert lower <= variable.value(y) <= upper
    # A position is known no better than the value's rounding allows over the range of the bounds.
    accuracy = 4e-16 * (1.0 + upper / (upper - lower))
    assert variable.scaled(variable.value(y)) == pytest.approx(y, rel=0, abs=4 * accuracy)


@given(bounds=BOUNDS, log=st.booleans())
def test_bounds_are_met_exactly(bounds, log):
    lower, upper = bounds
    variable = _variable(lower=lower, upper=upper, guess=upper, log=log)
    assert [variable.value(y) for y in (-1e-9, 0.0, 1.0, 1.0 + 1e-9)] == [lower, lower, upper, upper]


def test_middle_of_a_log_scale_is_the_geometric_mean():
    variable = _variable(lower=5e3, upper=5e5, guess=5e4, log=True)
    assert variable.value(0.5) == pytest.approx(5e4, rel=1e-15)
    assert variable.scaled(5e4) == pytest.approx(0.5, rel=1e-15)


def test_a_domain_has_two_ends_in_order_around_the_value():
    for domain in ((1.0, 0.0), (0.0,), 3.0, [0.0, 1.0], ("0", "1"), (float("nan"), 1.0)):
        with pytest.raises(po.InputError, match="domain of 'x'"):
            po.Design().parameter("x", 0.5, domain=domain)
    with pytest.raises(po.InputError, match=r"parameter 'x': 28\.6479 deg lies outside its domain 0 deg to 5\."):
        po.Design().parameter("x", 0.5, unit="rad", domain=(0.0, 0.1))
