"""The contest for the optimum of a design: reference, errors and failures."""

import math

import numpy as np
import pytest

import plough_opt as po
from plough_opt.core import compiler
from plough_opt.core.compiler import find_compiler
from plough_opt.studies.accuracy import optimum
from plough_opt.studies.accuracy.optimum import REPORTED, REQUIREMENTS, TRUE, VARIABLES, design_contest

FAMILIES = ["transcription", "integrator", "derivatives", "compiled"]


def short(soil, wave, *, guess=7e4, limits=(6e4, 1.2e5), duration=0.4, objective=None, **effects):
    """Return a simplified problem R1 with the stiffness as its only variable, and an optimum between the bounds."""
    d = po.Design()
    k0 = d.variable("stiffness", guess=guess, lower=limits[0], upper=limits[1], unit="N/m", log=True)
    share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.2)
    scene = po.Scene(soil, share, k0, 25.0, 2.0, po.Effects(strength_wave=wave, **effects))
    run = po.simulate(scene, duration, outputs=4)
    d.minimise(objective(run) if objective else run.force_rms / 1e2)
    return d


@pytest.fixture(scope="module")
def contest(r1_soil, r1_wave):
    return design_contest(short(r1_soil, r1_wave), budget=0.0, limit=20.0)


def entries_of(contest, family, word=""):
    return [entry for entry in contest.entries if entry.family == family and word in entry.label]


@pytest.mark.slow
def test_the_reference_is_an_interior_optimum_by_two_integrators(contest, r1_soil, r1_wave):
    best = contest.best
    # Objective and optimality by two methods that share nothing agree far below IPOPT's tolerance of 1e-10.
    assert 0.0 < best.floor < 1e-13
    assert best.off < 1e-11
    assert 0.05 < best.y[0] < 0.95

    def objective(k0):
        share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.2)
        scene = po.Scene(r1_soil, share, k0, 25.0, 2.0, po.Effects(strength_wave=r1_wave))
        return po.simulate(scene, 0.4, accuracy=po.Accuracy(error=1e-11)).force_rms / 1e2

    k0 = best.variables["stiffness"]
    assert best.objective == pytest.approx(objective(k0), rel=1e-10)
    assert objective(k0) < min(objective(k0 * 0.99), objective(k0 * 1.01))


def test_every_family_has_rows_and_each_row_its_errors_or_its_reason(contest):
    assert list(dict.fromkeys(entry.family for entry in contest.entries)) == FAMILIES
    for entry in contest.entries:
        if entry.failure is None:
            assert set(entry.errors) == {REPORTED, TRUE, VARIABLES, REQUIREMENTS}
            assert 0.0 < entry.seconds < math.inf
            assert entry.setup > 0.0
        else:
            assert entry.failure
            assert entry.seconds == math.inf
            assert not entry.errors


def test_errors_of_order_8_fall_with_the_steps_and_the_variables_follow(contest):
    rows = [entry for entry in entries_of(contest, "integrator", "dop853") if entry.failure is None]
    assert len(rows) >= 3
    reported = [entry.errors[REPORTED] for entry in rows]
    assert reported == sorted(reported, reverse=True)
    assert reported[0] > 100.0 * reported[-1]
    for entry in rows:
        # At an interior optimum the loss is of second order in the variables, far below the error of the reported
        # value.
        assert entry.errors[TRUE] <= 10.0 * entry.errors[VARIABLES] ** 2 + contest.best.floor
        assert entry.errors[REQUIREMENTS] == 0.0


def test_derivatives_change_the_time_and_not_the_answer(contest):
    rows = entries_of(contest, "derivatives") + entries_of(contest, "compiled")
    exact = [entry for entry in rows if "differences" not in entry.method]
    if find_compiler() is None:
        exact.remove(rows[-1])
    assert len(exact) == 3 + (find_compiler() is not None)
    first = exact[0].errors
    for entry in exact:
        # The same steps in another order of operations differ by rounding, and IPOPT's tolerance of 1e-10.
        assert entry.errors[REPORTED] == pytest.approx(first[REPORTED], abs=1e-11)
        assert entry.errors[VARIABLES] == pytest.approx(first[VARIABLES], abs=1e-8)


# --- failures ----------------------------------------------------------------------------------------------


@pytest.fixture
def bowl():
    """Return a design without a run, whose optimum is x = 1.25 and, by the requirement, y = 1."""
    d = po.Design()
    x = d.variable("x", guess=0.5, lower=0.0, upper=2.0)
    y = d.variable("y", guess=1.5, lower=0.5, upper=2.0)
    d.minimise(1.0 + (x - 1.25) ** 2 + y)
    d.require("least y", y, at_least=1.0)
    d.require("least x", x, at_least=0.2)  # inactive, and so without an error
    return d


def test_a_design_without_a_run_has_derivatives_alone(bowl, monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    contest = design_contest(bowl, budget=0.0)
    best = contest.best
    # IPOPT stops 1e-11 inside the limit, and 1e-10 beside the bottom; the reference does not.
    assert best.variables == pytest.approx({"x": 1.25, "y": 1.0}, abs=1e-15)
    assert best.objective == pytest.approx(2.0, abs=1e-15)
    assert max(best.floor, best.off) < 1e-14
    assert {entry.family for entry in contest.entries} == {"derivatives", "compiled"}
    for entry in contest.entries:
        if entry.family == "compiled":
            assert entry.failure == "no C compiler was found ($CC, cc, gcc, clang), or it failed"
        else:
            # Rounding divided by the step of a forward difference, and a tolerance of 1e-6.
            limit = 1e-5 if "differences" in entry.method else 1e-9
            assert entry.failure is None
            assert max(entry.errors.values()) < limit


def test_a_solve_that_takes_too_long_is_a_row_with_its_reason(bowl, monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    rows = [entry for entry in design_contest(bowl, budget=0.0, limit=1e-9).entries if entry.family == "derivatives"]
    assert all("no optimum after 1e-09 s" in entry.failure for entry in rows)


def test_an_optimum_elsewhere_is_named(monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    # Two wells on either side of the middle. Contestants start in the one without the reference.
    monkeypatch.setattr(optimum, "_NEAR_START", 0.4)
    d = po.Design()
    x = d.variable("x", guess=-0.4, lower=-1.0, upper=1.0)
    d.minimise((x**2 - 0.16) ** 2 - 0.02 * x)
    contest = design_contest(d, budget=0.0, near=True)
    # Roots of f' = 4 x^3 - 0.64 x - 0.02.
    low, _, high = np.sort(np.roots([4.0, 0.0, -0.64, -0.02]).real)
    # Rounding of the roots, and of f'/f'' with f'' of about 1.
    assert contest.best.variables["x"] == pytest.approx(low, abs=1e-14)
    for entry in entries_of(contest, "derivatives"):
        assert entry.elsewhere.startswith(
            f"ended in another optimum, {(high**2 - 0.16) ** 2 - 0.02 * high:.7g} instead"
        )
        assert "another optimum" not in entry.label
        assert entry.errors[VARIABLES] == pytest.approx((high - low) / 2.0, abs=1e-6)


def test_a_thin_contest_leaves_out_every_other_setting(r1_soil, r1_wave, monkeypatch):
    monkeypatch.setattr(optimum, "measured", lambda contestants, *_, **__: contestants)
    full, thin = (
        {(c.family, c.method): len(c.settings) for c in design_contest(short(r1_soil, r1_wave), thin=thin).entries}
        for thin in (False, True)
    )
    assert (full["integrator", "dop853"], full["transcription", "multiple shooting"]) == (3, 2)
    assert thin == {name: math.ceil(count / 2) for name, count in full.items()}


@pytest.mark.slow
def test_an_orbit_is_solved_by_harmonics_and_by_shooting(r1_soil, r1_wave, monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    monkeypatch.setattr(optimum, "_FIXED", (("dop853", (0.8,)),))
    d = po.Design()
    k0 = d.variable("stiffness", guess=2e4, lower=1e4, upper=6e4, unit="N/m", log=True)
    share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.2)
    effects = po.Effects(strength_wave=r1_wave, damping=400.0, orbit="periodic")
    run = po.simulate(po.Scene(r1_soil, share, k0, 25.0, 2.0, effects), outputs=4)
    d.minimise(run.force_rms / 1e3 + k0 / 1e5)
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
    d = short(r1_soil, r1_wave, duration=0.1, objective=lambda run: run.mean_draft / 1e3, contact=po.StickSlip())
    contest = design_contest(d, budget=0.0)
    found = {entry.method for entry in entries_of(contest, "integrator") if entry.failure is None}
    assert found == {"erk", "rosenbrock"}
    refused = {entry.method: entry.failure for entry in entries_of(contest, "integrator") if entry.failure}
    assert set(refused) == {"dop853", "rk", "collocation", "cvodes"}
    assert all(reason.startswith("cannot locate events") for reason in refused.values())
    meshes = [entry for entry in entries_of(contest, "transcription") if entry.method != "single shooting"]
    assert meshes
    assert all("events cannot be put on a mesh" in entry.failure for entry in meshes)
    assert entries_of(contest, "derivatives", "L-BFGS")[0].failure is None
    (single,) = entries_of(contest, "transcription", "single shooting")
    assert single.setting == "erk, tolerance 1e-10"
    # A failure of CasADi itself is reported as such.
    assert single.failure is None or single.failure.startswith("CasADi failed: ")
