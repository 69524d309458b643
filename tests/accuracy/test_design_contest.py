"""The contest for the optimum of a design: reference, errors and failures."""

import math

import numpy as np
import pytest
from helpers.small_designs import design, softest

import plough_opt as po
from plough_opt.core import compiler
from plough_opt.core.compiler import find_compiler
from plough_opt.studies.accuracy import local_solve, optimum
from plough_opt.studies.accuracy.optimum import REPORTED, REQUIREMENTS, TRUE, VARIABLES, design_contest


@pytest.fixture(scope="module")
def contest(r1_soil, r1_wave):
    return design_contest(softest(r1_soil, r1_wave), budget=0.0, limit=20.0)


def entries_of(contest, family, word=""):
    return [entry for entry in contest.entries if entry.family == family and word in entry.label]


@pytest.mark.slow
def test_the_reference_is_an_interior_optimum_by_two_integrators(contest, r1_soil, r1_wave):
    best, own = contest.best, softest(r1_soil, r1_wave, accuracy=po.Accuracy(error=1e-11)).solve(search="local")
    # Objective and optimality by two methods that share nothing agree far below IPOPT's tolerance of 1e-10.
    assert 0.0 < best.floor < 1e-13
    assert best.off < 1e-11
    assert 0.05 < best.y[0] < 0.95
    assert best.objective == pytest.approx(own.objective, rel=1e-10)
    assert best.variables == pytest.approx(own.variables, rel=1e-6)


def test_every_family_has_rows_and_each_row_its_errors_or_its_reason(contest):
    assert {entry.family for entry in contest.entries} == {"transcription", "integrator", "derivatives", "compiled"}
    for entry in contest.entries:
        if entry.failure is None:
            assert set(entry.errors) == {REPORTED, TRUE, VARIABLES, REQUIREMENTS}
            assert 0.0 < min(entry.seconds, entry.setup) <= entry.seconds < math.inf
        else:
            assert (bool(entry.failure), entry.seconds, entry.errors) == (True, math.inf, {})


def test_errors_of_order_8_fall_with_the_steps_and_the_variables_follow(contest):
    rows = [entry for entry in entries_of(contest, "integrator", "dop853") if entry.failure is None]
    assert len(rows) >= 3
    reported = [entry.errors[REPORTED] for entry in rows]
    assert reported == sorted(reported, reverse=True)
    assert reported[0] > 100.0 * reported[-1]
    for entry in rows:
        # At an interior optimum the loss is of second order in the variables, far below the error of the reported.
        assert entry.errors[TRUE] <= 10.0 * entry.errors[VARIABLES] ** 2 + contest.best.floor
        assert entry.errors[REQUIREMENTS] == 0.0


def test_derivatives_change_the_time_and_not_the_answer(contest):
    rows = entries_of(contest, "derivatives") + entries_of(contest, "compiled")
    exact = [entry for entry in rows if "differences" not in entry.method and entry.failure is None]
    assert len(exact) == 3 + (find_compiler() is not None)
    first = exact[0].errors
    for entry in exact:
        # The same steps in another order of operations differ by rounding, and IPOPT's tolerance of 1e-10.
        assert entry.errors[REPORTED] == pytest.approx(first[REPORTED], abs=1e-11)
        assert entry.errors[VARIABLES] == pytest.approx(first[VARIABLES], abs=1e-8)


# --- failures ----------------------------------------------------------------------------------------------


@pytest.fixture
def bowl(monkeypatch):
    """Return a design without a run, whose optimum is x = 1.25 and, by the requirement, y = 1; there is no compiler."""
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    d, x, y = design(x=(0.5, 0.0, 2.0), y=(1.5, 0.5, 2.0))
    d.minimise(1.0 + (x - 1.25) ** 2 + y)
    d.require("least y", y, at_least=1.0)
    d.require("least x", x, at_least=0.2)  # inactive, and so without an error
    return d


def test_a_design_without_a_run_has_derivatives_alone(bowl):
    contest = design_contest(bowl, budget=0.0)
    best = contest.best
    # IPOPT stops 1e-11 inside the limit, and 1e-10 beside the bottom; the reference does not.
    assert best.variables == pytest.approx({"x": 1.25, "y": 1.0}, abs=1e-15)
    assert best.objective == pytest.approx(2.0, abs=1e-15)
    assert max(best.floor, best.off) < 1e-14
    assert {entry.family for entry in contest.entries} == {"derivatives", "compiled"}
    for entry in contest.entries:
        if entry.family == "compiled":
            assert "no C compiler was found" in entry.failure
        else:
            # Rounding divided by the step of a forward difference, and a tolerance of 1e-6.
            assert max(entry.errors.values()) < (1e-5 if "differences" in entry.method else 1e-9)


def test_a_solve_that_takes_too_long_is_a_row_with_its_reason(bowl, monkeypatch):
    late = po.study_design(bowl, limit=1e-9, thin=True)
    # The first search takes longer, too, and so no other follows.
    assert [(row.search, row.asked) for row in late.thoroughness] == [("near", 1)]
    monkeypatch.setattr(local_solve, "_MOST_ITERATIONS", 1)
    for contest, said in ((late, "optimum after 1e-09 s"), (design_contest(bowl, budget=0.0), ", after 1 iterations")):
        assert all(said in entry.failure for entry in entries_of(contest, "derivatives"))


def test_an_optimum_elsewhere_is_named(monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    # Two wells on either side of the middle. Contestants start in the one without the reference.
    monkeypatch.setattr(optimum, "_NEAR_START", 0.4)
    d, x = design(x=(-0.4, -1.0, 1.0))
    d.minimise((x**2 - 0.16) ** 2 - 0.02 * x)
    contest = design_contest(d, budget=0.0, near=True)
    # Roots of f' = 4 x^3 - 0.64 x - 0.02.
    low, _, high = np.sort(np.roots([4.0, 0.0, -0.64, -0.02]).real)
    # Rounding of the roots, and of f'/f'' with f'' of about 1.
    assert contest.best.variables["x"] == pytest.approx(low, abs=1e-14)
    for entry in entries_of(contest, "derivatives"):
        away = (high**2 - 0.16) ** 2 - 0.02 * high
        assert entry.elsewhere.startswith(f"ended in another optimum, {away:.7g} instead")
        assert "another optimum" not in entry.label
        assert entry.errors[VARIABLES] == pytest.approx((high - low) / 2.0, abs=1e-6)


def test_a_thin_contest_leaves_out_every_other_setting(r1_soil, r1_wave, monkeypatch):
    monkeypatch.setattr(optimum, "measured", lambda contestants, *_, **__: contestants)
    contests = (design_contest(softest(r1_soil, r1_wave), thin=thin) for thin in (False, True))
    full, thin = ({(c.family, c.method): len(c.settings) for c in contest.entries} for contest in contests)
    assert (full["integrator", "dop853"], full["transcription", "multiple shooting"]) == (3, 2)
    assert thin == {name: math.ceil(count / 2) for name, count in full.items()}


@pytest.mark.slow
def test_an_orbit_is_solved_by_harmonics_and_by_shooting(r1_soil, r1_wave, monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    monkeypatch.setattr(optimum, "_FIXED", (("dop853", (0.8,)),))
    d = softest(r1_soil, r1_wave, (2e4, 1e4, 6e4), None, damping=400.0, orbit="periodic")
    contest = design_contest(d, budget=0.0)
    # Harmonics and steps of order 8 lead to the same orbit; the reference takes finer steps than either.
    assert contest.best.floor < 1e-12
    ways = [entries_of(contest, "integrator", "dop853")[0], *entries_of(contest, "derivatives", "exact gradient")]
    assert len(ways) == 2
    assert all(entry.failure is None and entry.errors[REPORTED] < 1e-8 for entry in ways)
    assert "harmonics" in ways[1].setting
    refused = {entry.method: entry.failure for entry in entries_of(contest, "integrator") if entry.failure}
    assert refused["cvodes"] == "cannot find a periodic orbit"
    assert all("Newton's method" in entry.failure for entry in entries_of(contest, "compiled"))


@pytest.mark.slow
def test_a_share_that_sticks_is_solved_by_methods_that_locate_events(r1_soil, r1_wave, monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    contest = design_contest(softest(r1_soil, r1_wave, duration=0.1, contact=po.StickSlip()), budget=0.0)
    found = {entry.method for entry in entries_of(contest, "integrator") if entry.failure is None}
    assert found == {"erk", "rosenbrock"}
    refused = {entry.method: entry.failure for entry in entries_of(contest, "integrator") if entry.failure}
    assert set(refused) == {"dop853", "rk", "collocation", "cvodes"}
    assert all(reason.startswith("cannot locate events") for reason in refused.values())
    assert entries_of(contest, "derivatives", "L-BFGS")[0].failure is None
    (single,) = entries_of(contest, "transcription", "single shooting")
    assert single.setting == "erk, tolerance 1e-10"
    # A failure of CasADi itself is reported as such.
    assert single.failure is None or single.failure.startswith("CasADi failed: ")
