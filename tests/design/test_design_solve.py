"""Solves of designs: optima known without a run, problem R1 against its truth, threads and interruptions."""

import math
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers.small_designs import design
from helpers.three_modes import follow
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

import plough_opt as po
from plough_opt.design.model import ipopt

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


def test_an_objective_may_be_zero_at_the_start():
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    d.minimise((x - y) + (x - 0.3) ** 2 - 0.04)
    best = d.solve()
    # At y = 1 the rest is x + (x - 0.3)^2, smallest at x = 0.
    assert best.objective == pytest.approx(-1.0 + 0.09 - 0.04, rel=1e-8)
    assert best.variables == {"x": pytest.approx(0.0, abs=1e-8), "y": pytest.approx(1.0, abs=1e-8)}


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_objective_and_requirements_may_have_any_size(size):
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(size * ((x - 0.25) ** 2 + 1.0))
    best = d.solve()
    assert best.variables["x"] == pytest.approx(0.25, abs=1e-8)
    assert best.objective == pytest.approx(size, rel=1e-14)
    d.require("force", x / size, at_least=0.4 / size, unit="N")
    best = d.solve()
    limit = best.limits[0]
    assert best.variables["x"] == pytest.approx(0.4, rel=1e-8)
    assert limit.active
    assert limit.margin == pytest.approx(0.0, abs=1e-8 / size)
    assert limit.multiplier == pytest.approx(0.3 * size**2, rel=1e-7)


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9])
def test_a_limit_of_zero_on_a_large_quantity(size):
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(x**2)
    d.require("reserve", size * (x - 0.4) * (x + 1.0), at_least=0.0, unit="N")
    best = d.solve()
    assert best.variables["x"] == pytest.approx(0.4, rel=1e-8)
    assert best.active == ("reserve",)


@pytest.mark.parametrize("stacked", [ca.vertcat, ca.horzcat])
def test_a_column_or_row_is_required_in_every_entry(stacked):
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(-x)
    # Structural zeros count as zeros.
    d.require("path", stacked(x, 2.0 * x, ca.MX(1, 1), 0.5 * x), at_least=-1.0, at_most=0.8)
    best = d.solve()
    limit = best.limits[0]
    assert best.variables["x"] == pytest.approx(0.4, rel=1e-8)
    assert limit.value == pytest.approx(0.8, rel=1e-8)
    assert limit.multiplier == pytest.approx(0.5, rel=1e-7)


@pytest.mark.parametrize("constant", [0.0, 1.0])
def test_a_constant_objective_leaves_a_feasible_design(constant):
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(constant)
    d.require("least", x, at_least=0.7)
    d.require("given", 3.0, at_most=4.0)
    best = d.solve()
    assert best.objective == constant
    assert best.variables["x"] > 0.7
    assert best.margins["given"] == pytest.approx(1.0)


def _least_squares(a, b):
    """Return the optimum of 1 + |a x - b|^2 for x between 0 and 1, by a design, and its objective by SciPy."""
    d = po.Design()
    x = ca.vertcat(*(d.variable(f"x{k}", guess=0.5, lower=0.0, upper=1.0) for k in range(3)))
    d.minimise(1.0 + ca.sumsqr(ca.mtimes(ca.DM(a), x) - ca.DM(b)))
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


@pytest.mark.parametrize("slope", [1.4622579343563752e-06, 3e-7])
def test_a_valley_that_hardly_falls_is_followed_to_its_end(slope):
    a = np.array([(1.0, 1.0, 0.0)] * 3 + [(0.0, -slope, 0.0), (1.0, 1.0, 0.0)])
    found, truth = _least_squares(a, np.array([0.0, 0.0, 0.0, 1.0, 1.5]))
    # Two variables trade places along a valley that falls by twice the slope, over some 0.2; the third one is idle.
    assert found.objective == pytest.approx(truth, abs=1e-9)
    assert found.status == "not unique"


def test_an_objective_may_contain_a_lookup_table():
    table = ca.interpolant("table", "bspline", [np.linspace(0.0, 1.0, 21).tolist()], np.linspace(0.0, 1.0, 21) ** 2)
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(1.0 + table(x) - 0.5 * x)
    # A cubic spline through a parabola is that parabola.
    assert d.solve().variables["x"] == pytest.approx(0.25, abs=1e-8)


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


def test_r1_objects_and_expressions_come_back_with_numbers(r1):
    best = r1.best
    share, cone, scene = best(r1.share), best(r1.cone), best(r1.scene)
    assert isinstance(share, po.Wedge)
    assert share == po.Wedge(best.variables["wedge angle"], po.deg(15.0), best.variables["height"])
    assert cone.half_angle == pytest.approx(po.deg(15.0), rel=1e-9)
    assert po.loosened_radius(cone, r1.soil) == pytest.approx(0.12, rel=1e-9)
    assert (scene.stiffness, scene.soil) == (best.variables["stiffness"], r1.soil)
    nested = best({"a": [r1.height, 3.0, "text"], "b": (r1.k0, None)})
    assert nested == {"a": [best.variables["height"], 3.0, "text"], "b": (best.variables["stiffness"], None)}
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


ROOT = Path(__file__).parents[2]
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
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True, check=False)
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
