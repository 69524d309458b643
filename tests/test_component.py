"""A scene as one CasADi Function: its values, derivatives and error, and its use in other graphs."""

import copy
import pickle
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.equations import FIRM, forces, mp
from helpers.high_precision import derivatives, differentiated
from helpers.scenes import R1_RUNS

import plough_opt as po

STEEL = 7850.0
BOUNDS = {"share.wedge_angle": (po.deg(5), po.deg(60)), "share.height": (0.1, 0.5), "scene.stiffness": (5e3, 5e5)}
INPUTS = [po.Input(name, *bounds) for name, bounds in BOUNDS.items()]
RESULTS = ["mean_draft", "force_rms", "loosened_radius", "mean_deflection", "half_angle"]
# Optimum of problem R1 with a mount of medium stiffness: from a grid of 1.9 million simulations, polished.
START, OPTIMUM, OBJECTIVE = [po.deg(25), 0.25, 5e4], [po.deg(39.11469851), 0.2002828632, 37505.6423], 0.9164459115


@pytest.fixture(scope="module")
def r1(r1_scene, r1_wave):
    return po.component(
        r1_scene(strength_wave=r1_wave), 2.0, inputs=INPUTS, outputs=RESULTS, steel_density=STEEL, name="r1"
    )


def test_names_units_and_bounds_are_attached(r1):
    assert [(p.name, p.unit, p.lower, p.upper) for p in r1.inputs] == [
        ("share.wedge_angle", "rad", *BOUNDS["share.wedge_angle"]),
        ("share.height", "m", 0.1, 0.5),
        ("scene.stiffness", "N/m", 5e3, 5e5),
    ]
    assert [(p.name, p.unit) for p in r1.outputs] == list(zip(RESULTS, ["N", "N", "m", "m", "rad"], strict=True))
    assert (r1.name(), r1.name_in()) == ("r1", ["share_wedge_angle", "share_height", "scene_stiffness"])
    assert r1.name_out() == RESULTS
    for text in ("scene.stiffness [N/m] 5000 to 500000, value 50000", "force_rms [N]", "551 steps", "plane sections"):
        assert text in str(r1)


@pytest.mark.parametrize("run", R1_RUNS, ids=lambda run: f"{run[0]:g}deg-{run[2]:g}")
def test_values_agree_with_long_double_simulations(r1, run):
    angle, height, stiffness, mean, rms = run
    found = r1(po.deg(angle), height, stiffness)
    # The table has twelve digits; the error of the steps grows to the estimated one with the mount's frequency.
    assert found[0] == pytest.approx(mean, rel=1e-11 if stiffness < 1e5 else r1.error_estimate)
    assert found[1] == pytest.approx(rms, rel=2e-11 if stiffness < 1e5 else r1.error_estimate)


def test_narrower_bounds_need_fewer_steps_and_a_given_number_is_used(r1, r1_scene, r1_wave):
    scene = r1_scene(strength_wave=r1_wave)
    soft = po.component(scene, 2.0, inputs=[po.Input("scene.stiffness", 5e3, 6e4)], outputs=["mean_draft"])
    assert soft.accuracy.steps < r1.accuracy.steps / 2
    assert r1.error_estimate <= 1e-8
    few = po.component(scene, 2.0, inputs=INPUTS, outputs=["mean_draft"], accuracy=po.Accuracy("dop853", steps=200))
    assert few.accuracy.steps == 200
    assert few.error_estimate > 1e-6
    assert any("was not reached" in note for note in few.warnings)


def test_all_derivatives_of_a_draft_agree_with_120_digits():
    """Quasi-static, every quantity an input: value, gradient and Hessian against the textbook formulas."""
    of_share, of_soil = [*FIRM][:3], [*FIRM][3:9]
    names = {f"share.{key}": key for key in of_share} | {f"soil.{key}": key for key in of_soil}
    names["scene.tow_speed"] = "speed"
    soil, share = po.Soil(**{key: FIRM[key] for key in of_soil}), po.Wedge(*(FIRM[key] for key in of_share))
    wave = po.StrengthWave(0.4, 0.7)
    scene = po.Scene(soil, share, 5e4, 20.0, FIRM["speed"], po.Effects(motion=False, strength_wave=wave))
    bounds = [po.Input(name, 0.9 * FIRM[own], 1.1 * FIRM[own]) for name, own in names.items()]
    made = po.component(scene, 1.3, inputs=bounds, outputs=["mean_draft"])

    def mean_draft(*x):
        values = dict.fromkeys(FIRM, mp.mpf(0)) | dict(zip(names.values(), x, strict=True))
        static, drag, _ = forces(values)
        phase = 2 * mp.pi * values["speed"] * mp.mpf(1.3) / mp.mpf(0.7)
        return static * (1 + mp.mpf(0.4) * (1 - mp.cos(phase)) / phase) + drag * values["speed"] ** 2

    at = [FIRM[own] for own in names.values()]
    value, gradient, hessian = derivatives(mean_draft, [mp.mpf(x) for x in at])
    draft, first, second = differentiated(lambda *x: made.call([*x])[0], ca.MX, len(at))(at)
    assert draft == pytest.approx(float(value), rel=2e-14)
    parts = np.abs(at) / float(value)
    assert first * parts == pytest.approx(np.array(gradient, dtype=float) * parts, abs=1e-12)
    # Scaled second derivatives are of order one to a thousand, that by the phase's speed largest.
    parts = np.outer(parts, np.abs(at))
    assert second * parts == pytest.approx(np.array(hessian, dtype=float) * parts, rel=1e-11, abs=1e-11)


def test_first_and_second_derivatives_of_a_motion_are_those_of_differences(r1):
    at = np.array([0.5, 0.3, 3e4])
    size = np.array([r1(*at)]).T

    def values(part):
        return np.array([r1.call(list(part * at))]).ravel()

    def slopes(part):
        return r1.slopes(*(part * at)).full() * at / size

    x, one = ca.MX.sym("x", 3), np.ones(3)
    curvatures = ca.Function("curvatures", [x], [ca.densify(ca.jacobian(ca.vec(r1.slopes(*ca.vertsplit(x))), x))])
    # Differences of values with a rounding of 1e-14 over steps of 2e-3 of each input.
    assert slopes(one) == pytest.approx(differences(values, one, 2e-3) / size, rel=1e-10, abs=1e-11)
    found = curvatures(at).full().reshape(3, 5, 3).transpose(1, 0, 2) * at / size[:, :, None] * at[:, None]
    second = differences(slopes, one, 2e-3).reshape(5, 3, 3)
    assert found == pytest.approx(second, rel=1e-9, abs=1e-9 * np.abs(second).max())


def test_a_component_is_a_casadi_function(r1):
    assert isinstance(r1, ca.Function)
    assert ca.Function(r1).call(START) == r1.call(START)
    copied = copy.deepcopy([r1, copy.copy(r1)])[1]
    assert (copied(*START), copied.inputs, copied.warnings) == (r1(*START), r1.inputs, r1.warnings)


def test_a_pickle_gives_the_same_numbers_in_another_process(r1, tmp_path):
    path = tmp_path / "r1.pickle"
    path.write_bytes(pickle.dumps(r1))
    code = (
        f"import pickle; c = pickle.load(open({str(path)!r}, 'rb')); x = {START}\n"
        "print(c(*x), c.slopes(*x).full().tolist(), c.inputs, c.error_estimate)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    here = (r1(*START), r1.slopes(*START).full().tolist(), r1.inputs, r1.error_estimate)
    assert done.stdout.strip() == " ".join(map(str, here))


def test_omitted_inputs_have_the_scenes_values(r1):
    found = r1(scene_stiffness=4e4)
    assert found == r1(**{"scene.stiffness": 4e4})
    assert tuple(found.values()) == r1(po.deg(25), 0.25, 4e4)
    assert list(found) == RESULTS
    assert r1.call({"scene_stiffness": 4e4})["mean_draft"] == found["mean_draft"]


def test_a_design_takes_a_component_and_finds_the_optimum_of_r1(r1_scene, r1_wave):
    """The optimum with a mount of medium stiffness, between narrow bounds."""
    d, bounds = po.Design(), ((po.deg(30), po.deg(50)), (0.15, 0.3), (3e4, 4.5e4))
    inputs = [po.Input(name, *own) for name, own in zip(BOUNDS, bounds, strict=True)]
    scene = r1_scene(37.0, 0.22, 4e4, strength_wave=r1_wave)
    around = po.component(scene, 2.0, inputs=inputs, outputs=RESULTS, steel_density=STEEL)
    draft, rms, radius, deflection, half_angle = around(
        *(d.variable(p.name, guess=p.value, lower=p.lower, upper=p.upper, unit=p.unit) for p in around.inputs)
    )
    d.minimise(draft / 1e3 + rms / 1e3)
    d.require("radius", radius, at_least=0.12)
    d.require("deflection", deflection, at_most=0.15)
    d.require("half angle", half_angle, at_most=po.deg(15))
    best = d.solve(search="near")
    assert best.objective == pytest.approx(OBJECTIVE, rel=1e-9)
    assert [*best.variables.values()] == pytest.approx(OPTIMUM, rel=1e-7)


def test_sx_symbols_give_the_same_numbers_and_derivatives(r1_scene, r1_wave):
    inputs = [po.Input("scene.stiffness", 4e4, 6e4)]
    made = po.component(r1_scene(strength_wave=r1_wave), 0.5, inputs=inputs, outputs=["mean_draft", "force_rms"])
    k = ca.SX.sym("k")
    found = made(k)
    assert all(isinstance(one, ca.SX) for one in found)
    values, slopes = ca.Function("f", [k], [ca.vertcat(*found), ca.jacobian(ca.vertcat(*found), k)])(4.5e4)
    assert values.full().ravel() == pytest.approx(made(4.5e4), rel=1e-14)
    assert slopes.full() == pytest.approx(made.slopes(4.5e4).full(), rel=1e-12)
