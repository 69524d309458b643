"""Designs: what is declared, solved and refused, and what is odd but legal."""

import math
import subprocess
import sys
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pint
import pytest
from helpers.problem_files import PROBLEMS
from helpers.refusals import refusals
from helpers.scenes import Shank, scene_of
from helpers.small_designs import design, sticking
from helpers.three_modes import follow
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

import plough_opt as po
from plough_opt.design.declarations import Variable
from plough_opt.design.model import ipopt
from plough_opt.design.search.effort import effort_of, searched

# --- declarations of a design: invalid ones and their messages, and the scaling of variables ---

VALID = {"guess": 0.25, "lower": 0.1, "upper": 0.5, "unit": "m"}


def variable(**changes):
    return lambda d, _: d.variable("new", **VALID | changes)


def limited(**limits):
    return lambda d, x: d.require("new", x, unit="m", **limits)


# Declarations that are refused at once, with the message.
AT_ONCE = [
    (variable(guess=0.6), r"^variable 'new': .*guess 0.6( m)? .*outside its bounds 0.1( m)? to 0.5 m"),
    (variable(lower=0.5, guess=0.5), r"^variable 'new': .*lower 0.5( m)? is not below upper 0.5 m"),
    (variable(guess=math.nan), "^variable 'new': guess = nan must be finite"),
    (variable(lower=0.0, log=True), "^variable 'new': .*lower bound above 0, not 0"),
    (variable(guess="0.25"), "^variable 'new': .*= \"0.25\" has no unit"),
    (variable(upper=np.array([0.5])), r"^variable 'new': .*array\(\[0.5\]\) is not a number"),
    *((variable(tolerance=wrong), "^variable 'new': tolerance = .* must be a half") for wrong in (-1.0, "-1 %", True)),
    (limited(), "^requirement 'new' has no limit: give at_least, at_most or both"),
    (limited(at_least=2.0, at_most=1.0), r"^requirement 'new': .*at least 2( m)? is above at most 1 m"),
    (limited(at_most=math.inf), "^requirement 'new': at_most = inf must be finite"),
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
    message = f"'{name}' is declared already" if name in ("x", "p", "r") else r"name = .* must be a string of printable"
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
        with pytest.raises(po.InputError, match=r"parameter 'p' = .* must be finite"):
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


# --- solves of designs: optima known without a run, problem R1 against its truth, threads and interruptions ---

# Optima of R1 to ten digits; half a unit of the last one is 6e-11 of the objective.
TRUTH = [
    {"J": 0.8250057092, "stiffness": 5000.0},
    {"J": 0.8383450230, "stiffness": 500000.0},
    {"J": 0.9164459115, "stiffness": 37505.6423},
]
TRUE_ANGLE, TRUE_HEIGHT = po.deg(39.11469851), 0.2002828632


# --- optima known without any simulation --------------------------------------------------------------------


def test_active_bounds_are_kept_exactly_and_their_multipliers_are_the_slopes_of_the_objective():
    d, x, y, z = design(x=(0.5, 0.2, 1.0, "m"), y=(2.0, 1.0, 3.0, "", True), z=(2.0, 1.0, 3.0))
    d.minimise(x**2 - 5.0 * ca.log(y) + (z - 2.5) ** 2)
    best = d.solve()
    assert 0.2 <= best.variables["x"] <= 0.2 * (1 + 1e-8)
    assert 3.0 * (1 - 1e-8) <= best.variables["y"] <= 3.0
    # The objective never undercuts the truth.
    assert 0.0 <= best.objective - (0.2**2 - 5.0 * math.log(3.0)) < 1e-8
    assert (best.status, best.name, best.flat_directions, set(best.active)) == ("solved", "optimum", (), {"x", "y"})
    limits = {limit.name: limit for limit in best.limits}
    assert {limit.kind for limit in limits.values()} == {"bound"}
    # The barrier leaves the multiplier wrong by its own size over the margin, 1e-9 here.
    assert limits["x"].multiplier == pytest.approx(2.0 * 0.2, rel=1e-7)
    assert limits["y"].multiplier == pytest.approx(5.0 / 3.0, rel=1e-7)
    assert limits["z"].multiplier == pytest.approx(0.0, abs=1e-7)
    assert limits["x"].limits in ("0.2 to 1 m", "0.2 m to 1 m")


UNIT, SIZES = (0.9, 0.0, 1.0), (1e-9, 1.0, 1e9)
# Guesses and bounds, objective, limits and what they limit, and the optimum: variables, objective, multiplier.
KNOWN = [
    # At y = 1 the rest is x + (x - 0.3)^2, smallest at x = 0. The objective is zero at the start.
    ({"x": (0.5, 0.0, 1.0), "y": (0.5, 0.0, 1.0)}, lambda x, y: (x - y) + (x - 0.3) ** 2 - 0.04, None,
     {"x": 0.0, "y": 1.0}, -0.95, None),
    # Objectives and requirements of any size.
    *(({"x": UNIT}, lambda x, s=s: s * ((x - 0.25) ** 2 + 1.0), None, {"x": 0.25}, s, None) for s in SIZES),
    *(({"x": UNIT}, lambda x, s=s: s * ((x - 0.25) ** 2 + 1.0), ({"at_least": 0.4 / s}, lambda x, s=s: x / s),
       {"x": 0.4}, 1.0225 * s, 0.3 * s**2) for s in SIZES),
    # A limit of zero on a large quantity.
    *(({"x": UNIT}, lambda x: x**2, ({"at_least": 0.0}, lambda x, s=s: s * (x - 0.4) * (x + 1.0)),
       {"x": 0.4}, 0.16, 0.8 / (1.4 * s)) for s in (1e3, 1e6, 1e9)),
    # A column or row is required in every entry. Structural zeros count as zeros.
    *(({"x": UNIT}, lambda x: -x, ({"at_least": -1.0, "at_most": 0.8}, lambda x, stacked=stacked:
       stacked(x, 2.0 * x, ca.MX(1, 1), 0.5 * x)), {"x": 0.4}, -0.4, 0.5) for stacked in (ca.vertcat, ca.horzcat)),
]  # fmt: skip


@pytest.mark.parametrize(("variables", "objective", "required", "wanted", "least", "multiplier"), KNOWN)
def test_optima_known_in_closed_form(variables, objective, required, wanted, least, multiplier):
    d, *symbols = design(**variables)
    d.minimise(objective(*symbols))
    if required is not None:
        d.require("limited", required[1](*symbols), unit="N", **required[0])
    best = d.solve()
    assert best.variables == pytest.approx(wanted, rel=1e-8, abs=1e-8)
    assert best.objective == pytest.approx(least, rel=1e-8)
    if required is not None:
        limit = best.limits[0]
        assert limit.active
        assert limit.multiplier == pytest.approx(multiplier, rel=1e-7)
        assert 0.0 <= limit.margin * limit.multiplier < 1e-8 * abs(least)


def _least_squares(a, b):
    """Return the optimum of 1 + |a x - b|^2 for x between 0 and 1, by a design, and its objective by SciPy."""
    d, *x = design(**dict.fromkeys("xyz", (0.5, 0.0, 1.0)))
    d.minimise(1.0 + ca.sumsqr(ca.mtimes(ca.DM(a), ca.vertcat(*x)) - ca.DM(b)))
    return d.solve(), 1.0 + 2.0 * lsq_linear(a, b, (0.0, 1.0), tol=1e-14).cost


# Of two digits, because a slope within the optimiser's tolerance may leave something to gain.
COEFFICIENTS = st.integers(-200, 200).map(lambda hundredths: hundredths / 100.0)


@given(
    rows=st.lists(st.tuples(*[COEFFICIENTS] * 3), min_size=3, max_size=5), target=st.tuples(*[st.floats(-3.0, 3.0)] * 5)
)
@settings(max_examples=25, deadline=None)
def test_bounded_least_squares_as_scipy_solves_them(rows, target):
    found, truth = _least_squares(np.array(rows), np.array(target[: len(rows)]))
    assert truth - 1e-9 <= found.objective <= truth * (1.0 + 1e-7)


def test_a_requirement_added_later_counts():
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(x)
    assert d.solve().variables["x"] == pytest.approx(0.0, abs=1e-8)
    d.require("least", x, at_least=0.3)
    assert d.solve().variables["x"] == pytest.approx(0.3, rel=1e-8)
    d.minimise(-x)
    assert d.solve().variables["x"] == pytest.approx(1.0, rel=1e-8)


# --- problem R1 ---------------------------------------------------------------------------------------------


def test_r1_is_solved_to_its_global_optimum_and_has_three_in_order(r1):
    best, optima = r1.best, r1.best.local_optima
    assert (best.status, best.flat_directions, len(optima)) == ("solved", (), 3)
    assert not any("not reached" in warning for warning in best.warnings)
    # Half of the truth's last digit is 6e-11; the objective's own tolerance is 1e-10.
    assert best.objective == pytest.approx(TRUTH[0]["J"], rel=2e-10)
    for optimum, truth in zip(optima, TRUTH, strict=True):
        # At an active bound the barrier leaves 1e-10 of the objective on its safe side.
        assert optimum.objective == pytest.approx(truth["J"], rel=1e-9)
        # Nine digits of the truth; a bound is approached to 2e-9, and L3 is flat.
        assert optimum.variables["stiffness"] == pytest.approx(truth["stiffness"], rel=3e-9)
        assert optimum.variables["wedge angle"] == pytest.approx(TRUE_ANGLE, rel=1e-9)
        assert optimum.variables["height"] == pytest.approx(TRUE_HEIGHT, rel=1e-8)
        assert optimum.gap < 1e-8
        assert 0.0 < optimum.error_estimate < 1e-10
    assert (optima[0].objective, optima[0].variables) == (best.objective, best.variables)


def test_r1_optima_are_named_by_their_branch(r1):
    branches = [optimum.name.split(",")[0] for optimum in r1.best.local_optima]
    assert branches == ["soft branch", "stiff branch", "stiff branch"]
    # sqrt(5000/M) over 2 pi V0/ell, M and all by hand from the scene.
    scene = r1.best(r1.scene)
    ratio = math.sqrt(scene.stiffness / scene.inertia) / (2.0 * math.pi * 2.0 / 0.6)
    assert r1.best.name == f"soft branch, {ratio:.2f} of the wave's frequency"
    assert len({optimum.name for optimum in r1.best.local_optima}) == 3


def test_r1_limits_that_decide(r1):
    active = [set(optimum.active) for optimum in r1.best.local_optima]
    geometry = {"loosened radius", "half angle"}
    assert active == [geometry | {"stiffness"}, geometry | {"stiffness"}, geometry]
    for optimum in r1.best.local_optima:
        assert 0.0 <= optimum.margins["loosened radius"] < 1e-9
        assert 0.0 <= optimum.margins["half angle"] < 1e-9
        assert optimum.margins["mean deflection"] > 0.01
        # J grows when the radius grows: the limit pulls.
        pull = next(limit for limit in optimum.limits if limit.name == "loosened radius")
        assert pull.multiplier > 1.0


@dataclass(frozen=True)
class Nested:
    runs: tuple[po.Run, ...]


def test_r1_objects_and_expressions_come_back_with_numbers(r1):
    best = r1.best
    share, cone, scene = best(r1.share), best(r1.cone), best(r1.scene)
    assert isinstance(share, po.Wedge)
    assert share == po.Wedge(best.variables["wedge angle"], po.deg(15.0), best.variables["height"])
    assert cone.half_angle == pytest.approx(po.deg(15.0), rel=1e-9)
    assert po.loosened_radius(cone, r1.soil) == pytest.approx(0.12, rel=1e-9)
    assert (scene.stiffness, scene.soil) == (best.variables["stiffness"], r1.soil)
    nested = best({"a": [r1.height, 3.0, "text"], "b": (r1.k0, None), "c": Nested((r1.run,))})
    run = nested.pop("c").runs[0]
    assert nested == {"a": [best.variables["height"], 3.0, "text"], "b": (best.variables["stiffness"], None)}
    # A run in a field is simulated and checked as it is alone.
    assert (run.mean_draft, run.error_estimate) == (best(r1.run).mean_draft, best(r1.run).error_estimate)
    assert isinstance(run.scene.stiffness, float)
    deflection = best(r1.run.deflection)
    assert deflection.shape == (401,)
    assert deflection[0] == pytest.approx(scene.steady_resistance / scene.stiffness, rel=1e-12)
    assert best(r1.run.time) == pytest.approx(np.linspace(0.0, 2.0, 401), rel=1e-14)
    assert best(r1.cone.area) == pytest.approx(cone.area, rel=1e-14)
    assert best(r1.run.specific_draft) == pytest.approx(best(r1.run.mean_draft) / (math.pi * 0.12**2), rel=1e-8)


def test_r1_run_at_the_optimum_agrees_with_an_independent_integration(r1):
    run, motion = r1.best(r1.run), follow(r1.best(r1.scene), 2.0)
    assert run.error_estimate < 1e-8
    assert len(run.time) == 401
    # Local errors of 1e-12 over some thousand steps.
    assert (motion.mean_draft + motion.force_rms) / 1e3 == pytest.approx(r1.best.objective, rel=1e-9)
    for name in ("mean_draft", "force_rms"):
        assert getattr(motion, name) == pytest.approx(r1.best(getattr(r1.run, name)), rel=1e-9)
        assert getattr(run, name) == pytest.approx(getattr(motion, name), rel=1e-9)
    assert run.mount_force == pytest.approx(r1.best(r1.run.mount_force), rel=1e-8)


def test_r1_expression_with_a_foreign_symbol_is_refused(r1):
    for foreign, sentence in (
        (r1.height * ca.MX.sym("stranger"), "this design: stranger"),
        (2.0 * ca.MX.sym("height"), "this design"),
        (ca.SX.sym("height"), "SX expression"),
    ):
        with pytest.raises(po.InputError, match=sentence):
            r1.best(foreign)


# --- in threads, and interrupted ----------------------------------------------------------------------------


# Runs in a separate process, because an error in a thread must end it.
SCRIPT = """
from concurrent.futures import ThreadPoolExecutor
import plough_opt as po

def solved(upper):
    problem = po.read_problem("problems/cotton_subsoiler.toml", [f"variables.scene.stiffness.upper='{upper} kN/m'"])
    return problem.design()[0].solve(search="local").objective

uppers = [100, 900]
with ThreadPoolExecutor(2) as pool:
    together = list(pool.map(solved, uppers))
assert together == [solved(upper) for upper in uppers], together
print("all solved")
"""


def test_designs_in_threads_are_those_one_after_the_other():
    line = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(line, cwd=PROBLEMS.parent, capture_output=True, text=True, check=False)
    assert done.stdout.split("\n")[0] == "all solved", done.stderr


@pytest.mark.filterwarnings("ignore")  # CasADi reports every evaluation that failed
def test_an_interruption_ends_a_solve_and_not_the_next(monkeypatch):
    # A bound at the same place, so that quadratic programs leave the solve to IPOPT.
    d, x = design(x=(0.5, 0.1, 0.8))
    d.minimise(x + 1.0 / x)
    d.require("sum", x, at_most=0.8)

    def stop(*_, **_keywords):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ipopt.LastPoint, "__call__", stop)
        with pytest.raises(KeyboardInterrupt):
            d.solve()
    assert d.solve().variables["x"] == pytest.approx(0.8, rel=1e-9)


# --- inputs that are odd but legal, and odd ones that are refused in words: texts, NumPy's numbers, names, bounds ---

UNITS = pint.UnitRegistry()


def _declared(name="x", **more):
    d = po.Design()
    x = d.variable(name, **{"guess": 0.5, "lower": 0.0, "upper": 1.0, "unit": "m", **more})
    d.minimise((x - 0.25) ** 2 + 1.0)
    return d


NEAR = _declared().solve(search="near")


def _parameter(value, domain=(0.0, 1e4)):
    d, x = design(x=(0.5, 0.0, 1.0))
    pressure = d.parameter("pressure", 2e3, unit="Pa", domain=domain)
    d.minimise((x - pressure / 1e4) ** 2 + 1.0)
    return d.solve(search="near", parameters={"pressure": value}).variables["x"]


@pytest.mark.parametrize(
    ("search", "seconds"), [("20 s", 20.0), ("5 min", 300.0), ("1e3 ms", 1.0), ("0.5s", 0.5), (" .5 h", 1800.0)]
)
def test_a_search_takes_a_time_in_any_unit(search, seconds):
    assert searched(search, _declared().declared.variables) == (0,)
    assert effort_of(search, 1, 1, True).seconds == pytest.approx(seconds, rel=1e-15)


@pytest.mark.parametrize(
    "name", ["20 s", "5 min", "auto", "objective", "worst objective", "optimum", "position on the front", "Grösse µ"]
)
def test_a_variable_may_have_any_printable_name(name):
    best = _declared(name).solve(search=[name])
    assert best.variables == pytest.approx({name: 0.25}, abs=1e-6)
    assert best.search.variables == (name,)
    assert "optimum" in best.to_json()


@pytest.mark.parametrize("value", [3e3, "3 kPa", "0.03 bar", UNITS("3 kPa"), np.float32(3000), np.int64(3000)])
def test_a_parameter_of_a_solve_takes_a_unit(value):
    assert _parameter(value) == pytest.approx(0.3, abs=1e-7)


def test_a_catalogue_takes_units():
    assert NEAR.rounded(x="200 mm").variables == NEAR.rounded(x=0.2).variables
    assert NEAR.rounded(x=["10 cm", UNITS("300 mm")]).variables == {"x": 0.3}


NOT_SEARCHES = ["1.2.3 s", "-1 s", "inf s", "nan s", "1 m", "8", "", "\n", 8.0, True, np.float64(8.0), 0, None]
# A parameter of a solve keeps its unit and its domain.
NOT_PRESSURES = [2e4, "20 kPa", -1.0, "3 m", "3", True, None, float("nan"), UNITS("1 m")]
test_other_names_searches_parameters_and_equal_bounds_are_refused = refusals(
    po.InputError,
    *((lambda x=x: _declared(x), "name") for x in ("", " ", "a\nb", "worst objective\n", 3, None)),
    *((lambda x=x: searched(x, _declared().declared.variables), "search") for x in NOT_SEARCHES),
    (lambda: _declared().solve(search="z"), "valid names: auto, local"),
    (lambda: _declared().solve(search=("x", "yy")), "'yy'"),
    *((lambda x=x: _declared().solve(seed=x), f"seed = {x!r} must") for x in (-1, 1.0, True)),
    *((lambda x=x: _parameter(x), "'pressure'") for x in NOT_PRESSURES),
    (lambda: _declared(lower=0.5, upper=0.5), "the number itself"),
)


@pytest.mark.parametrize("number", [8, 16, 64])
def test_a_number_of_designs_is_that_of_the_sample(number):
    for objective in (lambda x: x**2, lambda x: x**2 + 1e-9 * sticking(x)):
        d, x = design(x=(0.3, 0.0, 1.0))
        d.minimise(objective(x) + 1.0)
        sampled = len(d.solve(search=number).search.values)
        # The sample has a power of two, and further designs around the guess.
        assert sampled <= number + 2


def test_a_flat_variable_at_its_bound_is_named():
    d, x, _ = design(x=(0.3, 0.0, 1.0), y=(1.0, 0.0, 1.0))
    d.minimise((x - 0.25) ** 2 + 1.0)
    best = d.solve(search="near")
    assert best.status == "not unique"
    assert [{name for name, change in way.items() if change} for way in best.flat_directions] == [{"y"}]
    assert "along y" in str(best)


# Objectives with a needle or without one, and the half width of the tolerance of x.
NEEDLES = [
    (lambda x: (x - 0.25) ** 2, 0.003, False),
    (lambda x: (x - 0.25) ** 2 - 1e-9, 0.003, False),
    (lambda x: 1e-6 * (x - 0.25) ** 2, 0.003, False),
    (lambda x: 1.0 + (x - 0.25) ** 2, 0.003, False),
    (lambda x: 1e6 * (x - 0.25) ** 2 / ((x - 0.25) ** 2 * 1e6 + 1.0), 0.1, True),
    (lambda x: 1e6 * (x - 0.25) ** 2 / ((x - 0.25) ** 2 * 1e6 + 1.0) - 1.0, 0.1, True),
]


@pytest.mark.parametrize(("objective", "tolerance", "needle"), NEEDLES)
def test_an_optimum_of_zero_is_a_needle_only_on_the_scale_of_its_objective(objective, tolerance, needle):
    d, x = design(x=(0.25, 0.0, 1.0, "", False, tolerance))
    d.minimise(objective(x))
    assert d.solve(search="near").spread.needle == needle


# --- a design's program for another solver, and options of IPOPT that a solve accepts or refuses ---

SILENT = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}


def test_the_program_is_part_of_a_larger_one():
    d, x, y = design(x=(0.2, 0.0, 1.0), y=(0.2, 0.0, 4.0))
    d.minimise((x - 0.7) ** 2 + (y - 2.0) ** 2)
    d.require("sum", x + y, at_most=2.5)
    nlp = d.nlp()
    # Two designs with one y: the mean of 2 and of 2.5 - 0.7, whose limit holds the second back.
    first, second = (ca.MX.sym(name, 2) for name in "ab")
    (f1, g1), (f2, g2) = (ca.graph_substitute([nlp.problem["f"], nlp.problem["g"]], [nlp.problem["x"]], [z])
                          for z in (first, second))  # fmt: skip
    both = {"x": ca.vertcat(first, second), "f": f1 + f2, "g": ca.vertcat(g1, g2, first[1] - second[1])}
    limits = {"lbg": [*nlp.lbg, *nlp.lbg, 0.0], "ubg": [*nlp.ubg, *nlp.ubg, 0.0], "lbx": 0.0, "ubx": 1.0}
    found = ca.nlpsol("s", "ipopt", both, SILENT)(x0=[*nlp.x0, *nlp.x0], **limits)["x"]
    for z in (found[:2], found[2:]):
        # On the line x + y = 2.5, at the point nearest to (0.7, 2).
        assert nlp.variables(z) == pytest.approx({"x": 0.6, "y": 1.9}, rel=1e-7)
    with pytest.raises(po.InputError, match="2 scaled variables"):
        nlp.variables([0.5])


REFUSED = {
    "tol": 1e-3,
    "ipopt.constr_viol_tol": 1e-3,
    "acceptable_tol": 1e-3,
    "bound_relax_factor": 1e-8,
    "nlp_scaling_method": "gradient-based",
    "hessian_approximation": "exact",
    "limited_memory_max_history": 3,
    "jacobian_approximation": "finite-difference-values",
    "fixed_variable_treatment": "make_constraint",
    "no_such_option": 1,
    "linear_solver": "none of these",
    "max_iter": "many",
}


@pytest.mark.parametrize("name", REFUSED)
def test_options_that_break_a_promise_are_refused_by_name(name):
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(x**2)
    with pytest.raises(po.InputError, match=name):
        d.solve(ipopt={name: REFUSED[name]})


def test_options_reach_ipopt(capfd):
    d, x, y = design(x=(-1.2, -2.0, 2.0), y=(1.0, -2.0, 2.0))
    # The kink keeps quadratic programs from the last digits, so that IPOPT is asked.
    d.minimise((1.0 - x) ** 2 + 10.0 * (y - x**2) ** 2 + ca.fabs(x - 0.5))
    quiet = d.solve(search="near")
    assert "Number of Iterations" not in capfd.readouterr().out
    told = d.solve(search="near", ipopt={"print_level": 5, "max_iter": 20})
    assert "Number of Iterations" in capfd.readouterr().out
    assert told.objective == pytest.approx(quiet.objective, rel=1e-6)
    assert np.isfinite(told.objective)


def test_an_unconfirmed_design_names_the_options_that_may_have_stopped_ipopt():
    """Two kinks close to each other, which no derivative confirms."""
    d, x = design(x=(0.3, 0.0, 1.0))
    d.minimise(1.0 + ca.fabs(x - 0.37) + 0.1 * ca.fabs(x - 0.371))
    plain, stopped = (" ".join(d.solve(**options).warnings) for options in ({}, {"ipopt": {"max_iter": 1}}))
    assert "did not confirm" in plain
    assert "options" not in plain
    assert "options given to it stop it (max_iter)" in stopped
