"""Declarations of a design: invalid ones and their messages, and the scaling of variables."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import Shank, scene_of
from helpers.small_designs import design
from hypothesis import given
from hypothesis import strategies as st

import plough_opt as po
from plough_opt.design.declarations import Variable

VALID = {"guess": 0.25, "lower": 0.1, "upper": 0.5, "unit": "m"}


def variable(**changes):
    return lambda d, _: d.variable("new", **VALID | changes)


def limited(**limits):
    return lambda d, x: d.require("new", x, unit="m", **limits)


# Declarations that are refused at once, with the message.
AT_ONCE = [
    (variable(guess=0.6), r"^variable 'new': .*guess 0.6( m)? .*outside its bounds 0.1( m)? to 0.5 m"),
    (variable(lower=0.5, guess=0.5), r"^variable 'new': .*lower 0.5( m)? is not below upper 0.5 m"),
    (variable(guess=math.nan), "^variable 'new': .*finite number"),
    (variable(lower=0.0, log=True), "^variable 'new': .*lower bound above 0, not 0"),
    (variable(guess="0.25"), "^variable 'new': .*= \"0.25\" has no unit"),
    (variable(upper=np.array([0.5])), r"^variable 'new': .*array\(\[0.5\]\) is not a number"),
    *((variable(tolerance=wrong), "^variable 'new': tolerance = .* must be a half") for wrong in (-1.0, "-1 %", True)),
    (limited(), "^requirement 'new' has no limit: give at_least, at_most or both"),
    (limited(at_least=2.0, at_most=1.0), r"^requirement 'new': .*at least 2( m)? is above at most 1 m"),
    (limited(at_most=math.inf), "^requirement 'new': at_most: inf must be a finite number"),
    (limited(at_most="0.12 kg"), "^requirement 'new': at_most = \"0.12 kg\" has the wrong unit: expected .* in m"),
    (limited(at_most=np.array([0.1, 0.2])), "^requirement 'new': at_most: .* is not a number"),
    (limited(at_least=ca.MX.sym("limit")), "^requirement 'new': at_least: .* is not a number"),
    (lambda d, _: d.require("new", ca.MX(0, 1), at_least=0.0), "'new' has no value to limit"),
    (lambda d, _: d.require("new", ca.SX.sym("x"), at_least=0.0), "'new' is an SX expression"),
    (lambda d, x: d.minimise(ca.vertcat(x, x**2)), "objective must be one number, not 2"),
    (lambda d, _: d.minimise("mean draft"), "the objective: 'mean draft' is neither an expression nor a number"),
    (lambda d, _: d.minimise(ca.SX.sym("x") ** 2), "the objective is an SX expression"),
]


@pytest.mark.parametrize(("declare", "message"), AT_ONCE)
def test_an_invalid_declaration_is_refused_and_leaves_no_trace(declare, message):
    d, x = design(x=(0.5, 0.0, 1.0))
    with pytest.raises(po.InputError, match=message):
        declare(d, x)
    with pytest.raises(po.InputError, match="nothing to minimise"):
        d.solve()
    d.minimise((x - d.variable("new", **VALID)) ** 2)
    best = d.solve(search="near")
    assert (list(best.variables), best.margins) == (["x", "new"], {})


@pytest.mark.parametrize("name", ["", "  ", 3, None, "x", "p", "r"])
def test_every_declaration_needs_a_new_name(name):
    d, x = design(x=(0.5, 0.0, 1.0))
    d.parameter("p", 1.0)
    d.require("r", x, at_most=1.0)
    message = f"'{name}' is declared already" if name in ("x", "p", "r") else r"name = .* must be a text"
    for declare in (
        lambda: d.variable(name, **VALID),
        lambda: d.parameter(name, 1.0),
        lambda: d.require(name, x, at_most=0.9),
    ):
        with pytest.raises(po.InputError, match=message):
            declare()


def _pushed(x):
    """Return the draft of a share that runs away if x is negative."""
    return po.simulate(scene_of(own=(Shank(viscous=1e7 * x),), strength_wave=po.StrengthWave(0.3, 0.2)), 0.2).mean_draft


# Symbols that the design did not declare, one of them with the name of its variable.
STRANGER, NAMESAKE = ca.MX.sym("stranger"), ca.MX.sym("x")
# Objective, what is to be at least 0.1, and the message.
AT_THE_START = [
    (lambda x: x * STRANGER, lambda x: x, r"'objective' holds symbols .* \(stranger\)"),
    (lambda _: NAMESAKE**2, lambda x: x, r"'objective' holds symbols .* \(x\)"),
    (lambda x: x, lambda x: x + STRANGER, r"'radius' holds symbols .* \(stranger\)"),
    (ca.log, lambda x: x, r"the objective is not a finite number at the start \(x = -0.5 m\)"),
    (lambda x: x, ca.log, r"requirement 'radius' is not a finite number at the start \(x = -0.5 m\)"),
    (lambda x: ca.log(x - 2.0), lambda x: x, "the objective is not a finite number"),
    (_pushed, lambda x: x, r"cannot be evaluated at the start \(x = -0.5 m\): the motion of a .* has no finite result"),
]


@pytest.mark.parametrize(("objective", "required", "message"), AT_THE_START)
def test_expressions_without_a_value_at_the_start_are_refused(objective, required, message):
    d, x = design(x=(-0.5, -1.0, 1.0, "m"))
    d.minimise(objective(x))
    d.require("radius", required(x), at_least=0.1)
    with pytest.raises(po.InputError, match=message):
        # A search needs a value anywhere.
        d.solve(search="auto" if message.endswith("number") else "near")


def test_a_design_without_variables_is_refused():
    d = po.Design()
    d.minimise(3.0)
    with pytest.raises(po.InputError, match="nothing to choose"):
        d.solve()


@pytest.mark.parametrize("where", ["objective", "requirement"])
def test_a_search_needs_no_value_at_the_guess(where):
    d, x, _ = design(x=(-0.5, -1.0, 1.0, "m"), idle=(0.0, -1.0, 1.0))
    bad = ca.log(x)
    d.minimise(bad if where == "objective" else x**2)
    d.require("radius", bad if where == "requirement" else x, at_least=-3.0)
    assert d.solve().status in ("solved", "unconfirmed", "not unique")
    with pytest.raises(po.NotConverged, match="designs between the bounds has a value"):
        d.solve(search="idle")


def test_an_invalid_parameter_is_refused():
    d, x = design(x=(0.5, 0.0, 1.0))
    for value in (math.nan, math.inf):
        with pytest.raises(po.InputError, match=r"parameter 'p': .* must be a finite number"):
            d.parameter("p", value)
    for domain in ((1.0, 0.0), (0.0,), 3.0, ("0", "1"), (math.nan, 1.0)):
        with pytest.raises(po.InputError, match="domain of 'p'"):
            d.parameter("p", 0.5, domain=domain)
    with pytest.raises(po.InputError, match=r"parameter 'p': 28\.6479 deg lies outside its domain 0 deg to 5\."):
        d.parameter("p", 0.5, unit="rad", domain=(0.0, 0.1))
    d.minimise((x - d.parameter("p", 0.3)) ** 2)
    with pytest.raises(po.InputError, match="finite"):
        d.solve(parameters={"p": math.nan})


# --- scaling ------------------------------------------------------------------------------------------------

BOUNDS = st.tuples(st.floats(1e-6, 1e6), st.floats(1e-3, 1e6)).map(lambda pair: (pair[0], pair[0] * (1.0 + pair[1])))


@given(bounds=BOUNDS, y=st.floats(0.0, 1.0), log=st.booleans())
def test_scaling_and_its_inverse_agree_and_meet_the_bounds_exactly(bounds, y, log):
    lower, upper = bounds
    variable = Variable(name="x", symbol=ca.MX.sym("x"), guess=lower, lower=lower, upper=upper, unit="", log=log)
    assert lower <= variable.value(y) <= upper
    assert [variable.value(end) for end in (-1e-9, 0.0, 1.0, 1.0 + 1e-9)] == [lower, lower, upper, upper]
    # A position is known no better than the value's rounding allows over the range of the bounds.
    accuracy = 4e-16 * (1.0 + upper / (upper - lower))
    assert variable.scaled(variable.value(y)) == pytest.approx(y, rel=0, abs=4 * accuracy)
    middle = math.sqrt(lower * upper) if log else (lower + upper) / 2.0
    assert variable.value(0.5) == pytest.approx(middle, rel=1e-14)
