"""Optimum: limits with multipliers, its runs, solves with other parameters, and pickling."""

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.differences import order_4
from helpers.small_designs import design

import plough_opt as po


def _limit(best, name):
    (limit,) = [limit for limit in best.limits if limit.name == name]
    return limit


# --- multipliers --------------------------------------------------------------------------------------------


def test_multiplier_of_a_path_is_the_slope_of_the_best_objective(r1_scene, r1_wave):
    def solve(deflection):
        d, k0 = design(stiffness=(2e4, 1e4, 1e6, "N/m", True))
        run = po.simulate(r1_scene(stiffness=k0, strength_wave=r1_wave, damping=2e3), 1.0, outputs=100)
        d.minimise(1.0 + k0 / 1e5)
        d.require("deflection", run.deflection, at_most=deflection, unit="m")
        return d.solve(search="local")

    best = solve(0.02)
    limit = _limit(best, "deflection")
    assert limit.active
    assert limit.value == pytest.approx(0.02, rel=1e-8)
    assert limit.multiplier == pytest.approx(-order_4(lambda z: solve(z).objective, 0.02, 1e-5), rel=1e-6)


def test_an_inactive_limit_has_no_multiplier(r1):
    limit = _limit(r1.best, "mean deflection")
    assert not limit.active
    assert limit.multiplier < 1e-6
    assert limit.value == pytest.approx(r1.best(r1.run.mean_draft) / 5e3, rel=1e-8)
    assert limit.margin == pytest.approx(0.15 - limit.value, rel=1e-12)
    # That of a bound is the distance to the nearer one: 0.10 m to 0.50 m.
    height = _limit(r1.best, "height")
    assert height.margin == pytest.approx(min(height.value - 0.10, 0.50 - height.value), abs=1e-12)


def test_variables_may_have_the_names_of_columns():
    d, first, second = design(objective=(0.25, 0.1, 0.5, "m"), optimum=(0.25, 0.1, 0.5))
    d.minimise(1.0 + (first - 0.2) ** 2 + (second - 0.3) ** 2)
    best = d.solve(search="near")
    frame = best.to_dataframe()
    assert list(frame.columns) == ["optimum", "objective", "variable objective", "variable optimum"]
    assert frame.loc[0, ["objective", "variable objective", "variable optimum"]].tolist() == pytest.approx(
        [1, 0.2, 0.3]
    )
    assert frame.attrs["units"] == {"variable objective": "m", "variable optimum": ""}
    assert [one["kind"] for one in best.origin.declarations.values()] == ["variable", "variable", "objective"]


# --- an expression, a run ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pair:
    name: str
    runs: tuple[po.Run, ...]


def test_a_nested_run_is_simulated_and_checked_as_it_is_alone(build_r1):
    problem = build_r1(outputs=7, duration=0.5)
    run, best = problem.run, problem.design.solve(search="local")
    alone = best(run)
    assert (len(alone.time), best(run.deflection).shape, alone.duration) == (8, (8,), 0.5)
    nested = best({"wanted": [run.mean_draft, _Pair("both", (run, run))]})
    for found in nested["wanted"][1].runs:
        for name in ("mean_draft", "error_estimate", "warnings"):
            assert getattr(found, name) == getattr(alone, name)
        np.testing.assert_array_equal(found.deflection, alone.deflection)
        assert isinstance(found.scene.stiffness, float)


# --- parameters ---------------------------------------------------------------------------------------------


@pytest.fixture
def with_parameter(build_r1, r1_soil):
    """Build R1 with the soil's cohesion as a parameter."""

    def build(value):
        soil = replace(r1_soil, cohesion=value)
        return build_r1(soil=soil, parameters=["cohesion"], duration=1.0, outputs=20, damping=300.0)

    return build


def test_a_parameter_of_a_solve_acts_as_if_declared_and_only_in_that_solve(with_parameter):
    question, harder = with_parameter(15e3), with_parameter(30e3)
    d, run = question.design, question.run
    first, fresh = d.solve(), harder.design.solve()
    before, other, again = first(run.mean_draft), d.solve(parameters={"cohesion": 30_000}), d.solve()
    assert first(run.mean_draft) == before
    assert (again.objective, again.variables) == (first.objective, first.variables)
    assert other.objective > 1.2 * first.objective
    # The program is scaled by the first solve's objective; both are good to the optimiser's 1e-10.
    assert other.objective == pytest.approx(fresh.objective, rel=1e-9)
    assert other.variables == pytest.approx(fresh.variables, rel=1e-7)
    assert len(other.local_optima) == len(fresh.local_optima)
    assert other(run.mean_draft) == pytest.approx(fresh(harder.run.mean_draft), rel=1e-9)
    assert (other(question.soil).cohesion, first(question.soil).cohesion) == (30e3, 15e3)


def test_an_unknown_or_impossible_parameter_is_refused(with_parameter):
    d = with_parameter(15e3).design
    for given, error, words in (
        ({"cohesoin": 20e3}, po.InputError, "'cohesoin' is not a parameter of this design: did you mean 'cohesion'"),
        ({"height": 0.2}, po.InputError, "'height' is not a parameter of this design"),
        ({"cohesion": -1.0}, po.PloughError, "cohesion"),
    ):
        with pytest.raises(error, match=words):
            d.solve(parameters=given)


def test_the_program_is_built_once_for_all_solves(build_nlp, with_parameter):
    d = with_parameter(15e3).design
    d.solve()
    program, written = d._program, build_nlp.call_count
    for cohesion in (14e3, 20e3, 15e3):
        d.solve(parameters={"cohesion": cohesion})
    assert d._program is program
    assert build_nlp.call_count == written


# --- warnings, copies -----------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [True, False])
def test_an_optimum_carries_the_warnings_of_its_run(motion):
    d, angle = design(angle=(po.deg(30), po.deg(20), po.deg(80), "rad"))
    share = po.Wedge(angle, po.deg(15), 0.25)
    scene = po.Scene(po.named_soil("serozem"), share, 1e5, 25.0, 2.0, po.Effects(motion=motion))
    run = po.simulate(scene, 0.5)
    d.minimise(run.mean_draft / 1e3)
    d.require("loosened radius", scene.loosened_radius, at_least=0.25, unit="m")
    best = d.solve()
    assert any("hypothesis of plane sections does not hold" in text for text in best.warnings)
    assert set(best.warnings) == set(best(run).warnings)


def test_a_pickled_optimum_keeps_its_numbers_and_refuses_what_needs_the_design(r1):
    one = r1.best.sensitivity("loosened radius")
    again = pickle.loads(pickle.dumps(replace(r1.best, sensitivities=(one,))))
    assert again.local_optima == r1.best.local_optima
    assert again.sensitivity("loosened radius") == one
    for lost in (
        lambda: again(r1.run.mean_draft),
        lambda: again.sensitivity("wedge angle upper"),
        lambda: again.rounded({"wedge angle": 0.1}),
    ):
        with pytest.raises(po.InputError, match="without its design"):
            lost()
