"""The accuracy study of a design: the reference and the errors of searches, and what has no result or no reference."""

import dataclasses
import math

import numpy as np
import pytest
from helpers.problem_files import REFERENCE
from helpers.small_designs import design, softest

import plough_opt as po
from plough_opt.core import compiler
from plough_opt.core.compiler import find_compiler
from plough_opt.studies.accuracy import study as studies
from plough_opt.studies.accuracy.result import OPTIMUM, VARIABLES
from plough_opt.studies.accuracy.study import reference_optimum

# The true optimum of problem R1: wedge angle [deg], height [m], stiffness [N/m] and objective. It is the best of 1.9
# million simulations on a grid, polished with exact gradients to a residual of 1e-9 and checked in long double.
R1 = (39.11469851, 0.2002828632, 37505.6423, 0.9164459115)


# --- the reference ---


@pytest.mark.slow
def test_the_reference_is_the_true_optimum_of_r1():
    d = po.read_problem(REFERENCE).design()[0]
    best = d.solve(search="near")
    known = dict(zip(best.variables, (math.radians(R1[0]), *R1[1:3]), strict=True))
    # Nearer to it than to the other optima, but farther off than any search: IPOPT and Newton's method lead to it.
    rough = dataclasses.replace(best, variables={name: 1.0005 * value for name, value in known.items()})
    found = reference_optimum(d.declared, rough)
    # The last digits of the true values.
    assert found.objective == pytest.approx(R1[3], abs=1e-10)
    assert found.variables == pytest.approx(known, rel=1e-8)
    assert max(found.floor, found.off) < 1e-12


def test_the_reference_of_a_design_with_every_result_of_a_run(r1_soil, r1_wave):
    """Outputs that are used and others that are not, two signals with an RMS, the tow power and a parameter."""
    d, k0 = design(stiffness=(2e4, 1e4, 4e4, "N/m", True))
    damping = d.parameter("damping", 250.0, unit="N s/m")
    effects = po.Effects(strength_wave=r1_wave, damping=damping, tow_ramp=0.13, start="rest")
    scene = po.Scene(r1_soil, po.Wedge(po.deg(30.0), po.deg(15.0), 0.2), k0, 25.0, 2.0, effects)
    run, averages = po.simulate(scene, 0.5, outputs=10), po.simulate(scene, 0.3, outputs=7)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3 + run.displacement_rms / 1e-2 + averages.tow_power / 1e3)
    d.require("deflection", run.deflection, at_most=0.045, unit="m")
    d.require("force", run.mount_force, at_least=-1e4, at_most=1e4, unit="N")
    best = d.solve(search="near")
    assert best.active
    found = reference_optimum(d.declared, best)
    # Gradients by two methods vanish at one design: IPOPT's tolerance of 1e-10, then rounding.
    assert found.errors(best)["variables"] < 1e-8
    assert max(found.floor, found.off) < 1e-12


@pytest.mark.slow
def test_the_reference_is_an_interior_optimum_by_two_integrators(r1_soil, r1_wave):
    best = softest(r1_soil, r1_wave, accuracy=po.Accuracy(error=1e-11)).solve(search="local")
    d = softest(r1_soil, r1_wave)
    found = reference_optimum(d.declared, d.solve(search="local"))
    # Objective and optimality by two methods that share nothing agree far below IPOPT's tolerance of 1e-10.
    assert 0.0 < found.floor < 1e-13
    assert found.off < 1e-11
    assert 0.05 < found.y[0] < 0.95
    assert found.objective == pytest.approx(best.objective, rel=1e-10)
    assert found.variables == pytest.approx(best.variables, rel=1e-6)


HARD = [
    ((2e4, 1e4, 6e4), None, {"damping": 400.0, "orbit": "periodic"}),
    ((7e4, 6e4, 1.2e5), 0.1, {"contact": po.StickSlip()}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "duration", "effects"), HARD, ids=["orbit", "sticks"])
def test_the_reference_of_an_orbit_and_of_a_share_that_sticks(r1_soil, r1_wave, stiffness, duration, effects):
    d = softest(r1_soil, r1_wave, stiffness, duration, **effects)
    best = d.solve(search="near")
    found = reference_optimum(d.declared, best)
    assert found.floor < 1e-9
    assert found.errors(best)["objective"] < 1e-8


# --- searches ---


def smooth(_soil, _wave):
    d, x = design(x=(0.5, 0.0, 2.0))
    d.minimise(1.0 + (x - 1.25) ** 2)
    return d


def with_a_run(soil, wave):
    return softest(soil, wave, duration=0.1)


@pytest.mark.parametrize("made", [smooth, pytest.param(with_a_run, marks=pytest.mark.slow)])
def test_searches_have_their_errors_and_times(r1_soil, r1_wave, made):
    d = made(r1_soil, r1_wave)
    study = po.study_design(d, thin=True, title="A design")
    methods = ["interpreted", "compiled"] if find_compiler() else ["interpreted"]
    efforts = ["near", "250 designs", "1000 designs", "auto", "thorough"]
    ranked = [e for e in study.entries if e.failure is None]
    assert {(e.method, e.setting) for e in ranked} == {(method, effort) for method in methods for effort in efforts}
    assert [e.seconds for e in ranked] == sorted(e.seconds for e in ranked)
    for entry in ranked:
        assert set(entry.errors) == {"objective", "variables"}
        assert 0.0 < entry.seconds < math.inf
        # One basin; IPOPT's tolerance.
        assert max(entry.errors.values()) < 1e-7
    assert [q.title for q in study.questions] == ["objective of the optimum", "variables of the optimum"]
    assert all("the default, interpreted, auto, takes" in study.advise(q) for q in study.questions)
    assert 0.0 < max(study.floors[OPTIMUM], study.floors[VARIABLES]) < 1e-11
    assert [axes.get_title() for axes in study.plot().axes] == [q.title for q in study.questions]
    assert [(row.search, row.right) for row in study.thoroughness] == [(e, 1 if e == "near" else 3) for e in efforts]
    # The design keeps its state.
    assert d.solve(search="near").variables == d.solve(search="near").variables


def test_the_largest_error_of_any_seed_is_that_of_the_basin_it_ended_in(monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    # Two wells on either side of the middle. The guess lies in the one without the best optimum.
    d, x = design(x=(-0.4, -1.0, 1.0))
    d.minimise((x**2 - 0.16) ** 2 - 0.02 * x)
    study = po.study_design(d, thin=True)
    # Roots of f' = 4 x^3 - 0.64 x - 0.02.
    low, _, high = np.sort(np.roots([4.0, 0.0, -0.64, -0.02]).real)
    value, least = ((x**2 - 0.16) ** 2 - 0.02 * x for x in (low, high))
    *ranked, compiled = study.entries
    (near,) = (entry for entry in ranked if entry.setting == "near")
    others = [entry for entry in ranked if entry is not near]
    assert near.errors["variables"] == pytest.approx((high - low) / 2.0, abs=1e-6)
    assert near.errors["objective"] == pytest.approx((value - least) / abs(least), rel=1e-6)
    assert all(max(entry.errors.values()) < 1e-8 for entry in others)
    assert [row.right for row in study.thoroughness] == [0, 3, 3, 3, 3]
    assert not any("take interpreted, near" in study.advise(question) for question in study.questions)
    assert compiled.failure == compiler.interpretation_warning()
    # Rounding of the roots, and of f'/f'' with f'' of about 1.
    assert reference_optimum(d.declared, d.solve()).variables["x"] == pytest.approx(high, abs=1e-14)


@pytest.fixture
def bowl(monkeypatch):
    """Return a design without a run, whose optimum is x = 1.25 and, by the requirement, y = 1; there is no compiler."""
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    d, x, y = design(x=(0.5, 0.0, 2.0), y=(1.5, 0.5, 2.0))
    d.minimise(1.0 + (x - 1.25) ** 2 + y)
    d.require("least y", y, at_least=1.0)
    d.require("least x", x, at_least=0.2)  # inactive
    return d


def test_the_reference_lies_on_the_active_limits(bowl):
    found = reference_optimum(bowl.declared, bowl.solve())
    # IPOPT stops 1e-11 inside the limit, and 1e-10 beside the bottom; the reference does not.
    assert found.variables == pytest.approx({"x": 1.25, "y": 1.0}, abs=1e-15)
    assert found.objective == pytest.approx(2.0, abs=1e-15)
    assert max(found.floor, found.off) < 1e-14


# --- what has no result or no reference ---


def test_a_search_that_takes_too_long_is_the_last(bowl):
    late = po.study_design(bowl, limit=1e-9, thin=True)
    assert [(row.search, row.asked) for row in late.thoroughness] == [("near", 1)]
    assert [entry.setting for entry in late.entries] == ["near", ""]


def test_an_effort_without_an_optimum_is_a_failure(bowl, monkeypatch):
    solved = studies._solved
    given_up = (None, 1e-3)
    monkeypatch.setattr(studies, "_solved", lambda d, s, *a, **k: given_up if s == 250 else solved(d, s, *a, **k))
    study = po.study_design(bowl, thin=True)
    assert {e.label for e in study.failures} == {"interpreted, 250 designs", "compiled"}
    assert [row.right for row in study.thoroughness] == [1, 0, 3, 3, 3]


def test_an_objective_over_the_tolerance_box_has_no_reference(monkeypatch):
    monkeypatch.setattr(studies, "_EFFORTS", ("near", 250))
    d, x = design(x=(0.5, 0.0, 2.0, "", False, 0.05))
    d.minimise((x - 1.25) ** 2, over="mean")
    study = po.study_design(d, thin=True)
    assert study.questions == ()
    assert any("no reference for the optimum" in note and "tolerances" in note for note in study.notes)
    assert [row.right for row in study.thoroughness] == [1, 3]
