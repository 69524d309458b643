"""Requirements that cannot all be met, and designs that need a second attempt."""

import math
import re

import casadi as ca
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design import ipopt


def _sqrt_a(soil):
    """Return the front's radius over the cone's, from a cone of slope 1 and height 1."""
    return po.loosened_radius(po.Cone(math.pi / 4, 1.0), soil)


def test_the_shortfall_of_an_impossible_radius(build_r1):
    problem = build_r1(radius=0.9)
    with pytest.raises(po.InfeasibleDesign) as caught:
        problem.design.solve()
    error = caught.value
    # The largest share: half a metre high, at the largest half angle.
    shortfall = 0.9 - 0.5 * math.tan(po.deg(15.0)) * _sqrt_a(problem.soil)
    assert error.conflicts == {"loosened radius": pytest.approx(shortfall, rel=1e-7)}
    assert len(error.blockers) == 2
    assert any("requirement 'half angle'" in blocker for blocker in error.blockers)
    assert any("upper bound 0.5 m of 'height'" in blocker for blocker in error.blockers)
    assert re.search(r"'loosened radius' \(at least 0.9 m\) fails by 0.600\d* m", str(error))
    assert "height = 0.5 m" in str(error)


def test_requirements_that_contradict_each_other():
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(x**2)
    d.require("large", 10.0 * x, at_least=8.0, unit="m")
    d.require("small", 10.0 * x, at_most=2.0, unit="m")
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    # Scaled by their limits, the smaller limit is the dearer one to break.
    assert caught.value.conflicts == {"large": pytest.approx(6.0, rel=1e-7)}
    assert caught.value.blockers == ["requirement 'small' at most 2 m"]


def test_a_path_that_cannot_be_kept(r1_scene):
    d = po.Design()
    k0 = d.variable("stiffness", guess=5e4, lower=5e3, upper=5e5, unit="N/m", log=True)
    run = po.simulate(r1_scene(stiffness=k0), 0.5, outputs=50)
    d.minimise(run.mean_draft / 1e3)
    force = r1_scene().steady_resistance
    limit = 0.5 * force / 5e5
    d.require("deflection", run.deflection, at_most=limit, unit="m")
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    # From equilibrium without a wave nothing moves, and the stiffest mount bends least.
    assert caught.value.conflicts == {"deflection": pytest.approx(force / 5e5 - limit, rel=1e-6)}
    assert caught.value.blockers == ["upper bound 500 kN/m of 'stiffness'"]


def test_a_bound_alone_can_block():
    d = po.Design()
    x = d.variable("x", guess=0.5, lower=0.1, upper=1.0, unit="m", log=True)
    d.minimise(x)
    d.require("long", 3.0 * x, at_least=4.0, unit="m")
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    assert caught.value.conflicts == {"long": pytest.approx(1.0, rel=1e-7)}
    assert caught.value.blockers == ["upper bound 1 m of 'x'"]


def test_a_requirement_on_a_number_that_fails():
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(x)
    d.require("given", 3.0, at_most=2.0, unit="m")
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    assert caught.value.conflicts == {"given": pytest.approx(1.0, rel=1e-7)}


def test_an_equality_that_cannot_hold():
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(x)
    d.require("exact", x, at_least=1.5, at_most=1.5)
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    assert caught.value.conflicts == {"exact": pytest.approx(0.5, rel=1e-7)}


def test_requirements_that_touch_in_one_point_are_feasible():
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(x**2)
    d.require("least", x, at_least=0.4)
    d.require("most", x, at_most=0.4)
    best = d.solve()
    assert best.variables["x"] == pytest.approx(0.4, rel=1e-8)


def test_a_conflict_names_only_what_takes_part():
    d, x, y = design(x=(0.5, 0.0, 1.0, "m"), y=(0.5, 0.0, 1.0, "m"))
    d.minimise(x + y)
    d.require("long", x, at_least=2.0, unit="m")
    d.require("easy", y, at_least=0.25, unit="m")
    with pytest.raises(po.InfeasibleDesign) as caught:
        d.solve()
    assert caught.value.conflicts == {"long": pytest.approx(1.0, rel=1e-7)}
    assert caught.value.blockers == ["upper bound 1 m of 'x'"]


def test_a_start_that_violates_everything_is_no_obstacle(build_r1):
    problem = build_r1(guess=(59.0, 0.11, 5.1e3))
    best = problem.design.solve()
    assert best.objective == pytest.approx(0.8250057092, rel=2e-10)


def test_feasible_designs_behind_a_bend_are_found():
    d, x, y = design(x=(-0.9, -1.0, 1.0), y=(-0.9, -1.0, 1.0))
    d.minimise((x + 1.0) ** 2 + (y + 1.0) ** 2)
    d.require("inside", (x - 0.5) ** 2 + (y - 0.5) ** 2, at_most=0.04)
    d.require("outside", (x - 0.5) ** 2 + (y - 0.5) ** 2, at_least=0.01)
    best = d.solve()
    # The point of the circle of radius 0.2 about (0.5, 0.5) that is nearest to (-1, -1).
    wanted = 0.5 - 0.2 / math.sqrt(2.0)
    assert best.variables == {"x": pytest.approx(wanted, rel=1e-8), "y": pytest.approx(wanted, rel=1e-8)}


# --- not converged ------------------------------------------------------------------------------------------


def _rosenbrock():
    d, x, y = design(x=(-1.2, -2.0, 2.0), y=(1.0, -2.0, 2.0))
    d.minimise((1.0 - x) ** 2 + 100.0 * (y - x**2) ** 2)
    return d, x, y


def _unconfirmed(d):
    """Solve a design whose optimum the optimiser cannot confirm."""
    best = d.solve()
    assert best.status == "unconfirmed"
    assert any("did not confirm" in warning for warning in best.warnings)
    return best


def test_too_few_iterations_confirm_no_optimum(monkeypatch):
    monkeypatch.setitem(ipopt.OPTIONS, "ipopt.max_iter", 1)
    monkeypatch.setitem(ipopt.NEAR, "ipopt.max_iter", 1)
    monkeypatch.setitem(ipopt.FROM_BOTTOM, "ipopt.max_iter", 1)
    d, _, _ = _rosenbrock()
    _unconfirmed(d)


def test_too_few_iterations_with_requirements_are_not_called_infeasible(monkeypatch):
    monkeypatch.setitem(ipopt.OPTIONS, "ipopt.max_iter", 1)
    d, x, y = _rosenbrock()
    monkeypatch.setitem(ipopt.NEAR, "ipopt.max_iter", 1)
    monkeypatch.setitem(ipopt.FROM_BOTTOM, "ipopt.max_iter", 1)
    d.require("sum", x + y, at_least=1.0)
    _unconfirmed(d)


def test_an_objective_with_a_kink_never_looks_like_an_optimum():
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(1.0 + ca.fabs(x - 0.3))
    assert _unconfirmed(d).variables["x"] == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize("size", [1.0, 1e6])
def test_the_shortfall_of_a_limit_of_zero_is_in_the_requirements_own_unit(size):
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(1.0 + x)
    d.require("margin", size * (x - 1.25), at_least=0.0, unit="N")
    with pytest.raises(po.InfeasibleDesign, match="'margin'") as caught:
        d.solve()
    # At best x = 1, and a quarter of the size is lacking; IPOPT stops within 1e-8 of it.
    assert caught.value.conflicts == pytest.approx({"margin": 0.25 * size}, rel=1e-7)
    assert caught.value.blockers == ["upper bound 1 of 'x'"]


def test_more_equalities_than_variables_leave_no_room_to_confirm_an_optimum():
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(1.0 + x**2)
    d.require("one", x, at_least=0.8, at_most=0.8)
    d.require("same in other words", x + 1.0, at_least=1.8, at_most=1.8)
    assert _unconfirmed(d).variables["x"] == pytest.approx(0.8, abs=1e-6)


def test_noise_is_no_optimum():
    d, x = design(x=(0.1, 0.0, 1.0))
    d.minimise(1.0 + x + 1e-3 * ca.sin(1e7 * x))
    # The noise is 1e-3, and lowest beside 0: whichever of its dips is found, it is not called more than it is.
    best = d.solve()
    assert best.objective == pytest.approx(1.0, abs=2e-3)
    assert best.status in ("solved", "unconfirmed")


def test_a_model_that_breaks_between_the_bounds_says_so():
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(ca.sqrt(x - 0.5) + x)
    # Below 0.5 there is no value, and at it the slope is infinite.
    assert _unconfirmed(d).objective == pytest.approx(0.5, abs=5e-2)
