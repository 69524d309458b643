"""Optimum: limits with multipliers, its runs, solves with other parameters, pickling, flat directions, and saddles."""

import pickle
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.differences import order_4
from helpers.small_designs import design, sticking

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

    limit = _limit(solve(0.02), "deflection")
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


def test_wedge_and_chisel_angle_cannot_be_told_apart(r1_soil):
    # Both angles are free, and only the cone's half angle matters.
    d = po.Design()
    angle = d.variable("wedge angle", guess=po.deg(25.0), lower=po.deg(5.0), upper=po.deg(60.0), unit="rad")
    chisel = d.variable("chisel angle", guess=po.deg(15.0), lower=po.deg(5.0), upper=po.deg(30.0), unit="rad")
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.50, unit="m")
    share = po.Wedge(angle, chisel, height)
    cone = share.equivalent_cone()
    scene = po.Scene(r1_soil, share, 2e4, 25.0, 2.0, po.Effects(strength_wave=po.StrengthWave(0.3, 0.6), damping=300.0))
    run = po.simulate(scene, 1.0)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
    d.require("loosened radius", po.loosened_radius(cone, r1_soil), at_least=0.12, unit="m")
    d.require("half angle", cone.half_angle, at_most=po.deg(15.0), unit="rad")
    best = d.solve(search="local")
    assert best.status == "not unique"
    (direction,) = best.flat_directions
    assert abs(direction["height"]) < 1e-6
    # One angle grows while the other one shrinks.
    assert re.search(r"wedge angle (\+.* chisel angle -|-.* chisel angle \+)", " ".join(str(best).split()))

    def change(part):
        moved = (best.variables[name] + part * direction[name] for name in ("wedge angle", "chisel angle"))
        return abs(po.Wedge(*moved, 0.3).equivalent_cone().half_angle - best(cone).half_angle)

    # A tangent: a tenth of the step leaves a hundredth of the change. Across it 0.3 rad change for one of wedge angle.
    assert change(0.1) / change(1.0) == pytest.approx(0.01, rel=0.1)
    assert change(0.1) < 1e-2 * abs(0.1 * direction["wedge angle"])


# Objective, limits of the sum x + y, the best objective, and a basis of the flat directions.
VALLEYS = {
    "idle variable": (lambda x, _: 1.0 + (x - 0.25) ** 2, {"at_most": 3.0}, 1.0, [[0.0, 1.0]]),
    "total in the objective": (lambda x, y: 1.0 + (x + y - 1.2) ** 2, {"at_most": 3.0}, 1.0, [[1.0, -1.0]]),
    "zero at the optimum": (lambda x, y: (x + y - 0.7) ** 2, {"at_most": 3.0}, 0.0, [[1.0, -1.0]]),
    "total at an active limit": (lambda x, y: x + y, {"at_least": 0.7}, 0.7, [[1.0, -1.0]]),
    "constant objective": (lambda _x, _y: 1.0, {"at_most": 2.5}, 1.0, [[1.0, 0.0], [0.0, 1.0]]),
    "steep": (lambda x, y: 1.0 + 1e4 * (x - 0.25) ** 2 + (y - 0.5) ** 2, {"at_most": 3.0}, 1.0, []),
    "gentle": (lambda x, y: 1.0 + (x - 0.25) ** 2 + 1e-4 * (y - 0.5) ** 2, {"at_most": 3.0}, 1.0, []),
    "quartic": (lambda x, y: 1.0 + (x - 0.25) ** 2 + (y - 0.5) ** 4, {"at_most": 3.0}, 1.0, []),
    "corner": (lambda x, y: x + 2.0 * y + 1.0, {"at_most": 3.0}, 1.0, []),
}


@pytest.mark.parametrize(("objective", "limits", "least", "basis"), VALLEYS.values(), ids=VALLEYS)
def test_flat_directions_known_by_hand(objective, limits, least, basis):
    d, x, y = design(x=(0.9, 0.0, 1.0), y=(0.3, 0.0, 2.0))
    d.minimise(objective(x, y))
    d.require("sum", x + y, **limits)
    best = d.solve()
    assert best.status == ("not unique" if basis else "solved")
    assert best.objective == pytest.approx(least, abs=1e-8)
    assert len(best.flat_directions) == len(basis)
    if basis:
        found = np.array([[direction["x"], direction["y"]] for direction in best.flat_directions])
        assert np.linalg.matrix_rank(found) == len(basis)
        # Each is a step of 1 % of the range of the variable that changes most, within the space of the basis.
        assert np.max(np.abs(found) / [1.0, 2.0], axis=1) == pytest.approx(0.01, rel=1e-9)
        assert found @ (np.eye(2) - np.linalg.pinv(basis) @ basis) == pytest.approx(0.0, abs=1e-8)


# --- stationary points that are not minima ------------------------------------------------------------------


@pytest.mark.parametrize("search", ["auto", "near"])
@pytest.mark.parametrize(("others", "lean"), [(0, 0.8), (0, -0.8), (1, 0.8), (1, -0.8)])
def test_a_start_on_a_hilltop_or_a_saddle_is_left_on_the_lower_side(others, lean, search):
    d, x = design(x=(0.5, 0.0, 1.0))
    hill = 2.0 - (x - 0.5) ** 2 - lean * (x - 0.5) ** 3
    for k in range(others):
        hill += (d.variable(f"y{k}", guess=0.5, lower=0.0, upper=1.0) - 0.3) ** 2
    d.minimise(hill)
    # The gradient is zero at the start; the ends of x are 0.15 and 0.35 lower.
    assert d.solve(search=search).objective == pytest.approx(1.65, rel=1e-8)


def test_the_hilltops_of_several_variables_are_all_left():
    """Also if a run's events leave the descents to IPOPT, which moves one variable after the other."""
    d, *x = design(**{f"x{k}": (0.5, 0.0, 1.0) for k in range(4)})
    d.minimise(2.0 - sum((v - 0.5) ** 2 + 0.8 * (v - 0.5) ** 3 for v in x) + 1e-12 * sticking((x[0] - 0.5) ** 2))
    assert d.solve(search="near").objective == pytest.approx(2.0 - 4 * 0.35, rel=1e-7)


def test_a_saddle_with_too_little_to_gain_is_an_answer():
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    # The ends of x are lower by 1e-7 only, and there is nothing else to move to.
    d.minimise(1.0 - 4e-7 * (x - 0.5) ** 2 + (y - 0.5) ** 2)
    best = d.solve(search="near")
    assert best.status == "solved"
    assert best.objective == pytest.approx(1.0, abs=2e-7)
