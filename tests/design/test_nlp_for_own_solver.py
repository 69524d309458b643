"""A design's program for another solver, and options of IPOPT that a solve accepts or refuses."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po

SILENT = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}


def test_another_solver_reaches_the_optimum_of_a_run(r1_soil, r1_wave):
    # The force is least between the bounds of the stiffness.
    d, k0 = design(stiffness=(7e4, 6e4, 1.2e5, "N/m"))
    cohesion = d.parameter("cohesion", r1_soil.cohesion)
    share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.2)
    soil, effects = replace(r1_soil, cohesion=cohesion), po.Effects(strength_wave=r1_wave)
    run = po.simulate(po.Scene(soil, share, k0, 25.0, 2.0, effects), 0.4, outputs=4)
    d.minimise(run.force_rms / 1e2)
    d.require("deflection", run.deflection, at_most=1.0, unit="m")
    firmer = {"cohesion": 1.1 * r1_soil.cohesion}
    best, nlp = d.solve(search="near", parameters=firmer), d.nlp(parameters=firmer)
    assert [nlp.problem[name].shape for name in "xpfg"] == [(1, 1), (1, 1), (1, 1), (len(nlp.scales), 1)]
    assert set(nlp.requirements[:4]) == {"deflection"}
    found = ca.nlpsol("s", "ipopt", nlp.problem, SILENT)(**nlp.arguments)
    # Here the steps suit the guess and the bounds, there the optimum.
    assert nlp.variables(found["x"]) == pytest.approx(best.variables, rel=1e-6)
    assert float(found["f"]) * nlp.objective_scale == pytest.approx(best.objective, rel=1e-9)
    rows = [name == "deflection" for name in nlp.requirements]
    highest = np.max((found["g"].full().ravel() * nlp.scales)[rows])
    assert highest == pytest.approx(next(limit.value for limit in best.limits if limit.name == "deflection"), rel=1e-6)


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


def test_an_objective_over_tolerances_has_no_program():
    d, x = design(x=(0.5, 0.0, 1.0))
    d.minimise(x**2, over="worst")
    with pytest.raises(po.InputError, match="without over"):
        d.nlp()


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


@pytest.mark.parametrize("over", [None, "worst"])
def test_options_reach_ipopt(over, capfd):
    d, x, y = design(x=(-1.2, -2.0, 2.0), y=(1.0, -2.0, 2.0))
    # The kink keeps quadratic programs from the last digits, so that IPOPT is asked.
    d.minimise((1.0 - x) ** 2 + 10.0 * (y - x**2) ** 2 + ca.fabs(x - 0.5), over=over)
    quiet = d.solve(search="near")
    assert "Number of Iterations" not in capfd.readouterr().out
    told = d.solve(search="near", ipopt={"print_level": 5, "max_iter": 20})
    assert "Number of Iterations" in capfd.readouterr().out
    assert told.objective == pytest.approx(quiet.objective, rel=1e-6)
    assert np.isfinite(told.objective)


def test_an_unconfirmed_design_names_the_options_that_may_have_stopped_ipopt():
    """Two kinks close to each other, which no derivative confirms."""
    d = po.Design()
    x = d.variable("x", guess=0.3, lower=0.0, upper=1.0)
    d.minimise(1.0 + ca.fabs(x - 0.37) + 0.1 * ca.fabs(x - 0.371))
    plain, stopped = (" ".join(d.solve(**options).warnings) for options in ({}, {"ipopt": {"max_iter": 1}}))
    assert "did not confirm" in plain
    assert "options" not in plain
    assert "options given to it stop it (max_iter)" in stopped
