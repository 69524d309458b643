"""A scene as one CasADi Function: its values, derivatives and error, every kind of scene, and invalid ones."""

import dataclasses
import json
import pickle
import re
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.refusals import refusals
from helpers.scenes import R1_RUNS, Shank, scene_of

import plough_opt as po
from plough_opt.core.quantities import QUANTITIES
from plough_opt.export import write_casadi
from plough_opt.laws import McKyesAli, UniversalEarthmoving
from plough_opt.motion.vocabulary import MEASURES

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


READER = """
import sys
sys.modules["plough_opt"] = None
import json, casadi as ca
f = ca.Function.load(sys.argv[1])
x = ca.MX.sym("x", f.n_in())
jacobian = ca.Function("slopes", [x], [ca.densify(ca.jacobian(ca.vertcat(*f.call(ca.vertsplit(x))), x))])
at = json.loads(sys.argv[2])
values = [float(value) for value in f.call(at)]
assert not [name for name in sys.modules if name.startswith("plough_opt.")]
print(json.dumps([f.name(), f.name_in(), f.name_out(), values, jacobian(at).full().tolist()]))
"""


def test_a_file_gives_the_same_numbers_in_a_process_without_plough_opt(r1, tmp_path):
    path, description = tmp_path / "new" / "r1.casadi", tmp_path / "new" / "r1.json"
    write_casadi(r1, path, description)
    line = [sys.executable, "-c", READER, str(path), json.dumps(START)]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    slopes = r1.slopes(*START).full().tolist()
    assert json.loads(done.stdout) == ["r1", r1.name_in(), r1.name_out(), [*r1(*START)], slopes]
    told = json.loads(description.read_text())
    assert told["inputs"] == [dataclasses.asdict(p) | {"argument": p.argument} for p in r1.inputs]
    assert (told["error_estimate"], told["steps"]) == (r1.error_estimate, r1.accuracy.steps)
    with pytest.raises(po.InputError, match=r"end in \.json"):
        write_casadi(r1, path, tmp_path / "a.txt")


def test_a_file_gives_nan_outside_its_bounds(r1, tmp_path):
    loaded = ca.Function.load(str(write_casadi(r1, tmp_path / "r1.casadi")))
    for k, port in enumerate(r1.inputs):
        width = port.upper - port.lower
        for value, finite in (
            (port.lower - 0.9e-6 * width, True), (port.upper + 0.9e-6 * width, True), (np.nan, False),
            (port.lower - 1.1e-6 * width, False), (port.upper + 1.1e-6 * width, False),
        ):  # fmt: skip
            found = loaded.call([*START[:k], value, *START[k + 1 :]])
            assert {bool(np.isfinite(float(one))) for one in found} == {finite}


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


# --- components of every kind of scene, and messages about invalid ones ---


WAVE = po.StrengthWave(0.3, 0.6)
STRENGTHLESS = po.Soil(1350.0, 0.8, 0.0, 0.0, 0.5)


KINDS = [
    {"damping": 250.0, "start": "rest", "strength_wave": WAVE},
    {"tow_ramp": 0.5, "strength_wave": WAVE},
    {"contact": po.Smooth(0.4), "rate_term": 0.05},
    {"motion": False, "strength_wave": WAVE, "tow_ramp": 0.5},
    {"orbit": "periodic", "strength_wave": WAVE, "damping": 400.0},
    {"own": (), "inertial_drag": False, "added_mass": False, "ambient_pressure": False},
    {"soil": STRENGTHLESS, "tow_speed": 0.0},
]


@pytest.mark.parametrize("effects", KINDS, ids=lambda effects: "+".join(effects))
def test_every_result_agrees_with_the_numeric_scene(r1_scene, effects):
    scene = r1_scene(**effects)
    duration = None if "orbit" in effects else 2.0
    inputs = [po.Input("share.height", 0.2, 0.3), po.Input("scene.stiffness", 3e4, 6e4)]
    everything = [name for name, one in MEASURES.items() if scene.effects.waves or not one.random]
    made = po.component(scene, duration, inputs=inputs, outputs=everything, samples=50)
    share = dataclasses.replace(scene.share, height=0.27)
    run = po.simulate(dataclasses.replace(scene, share=share, stiffness=5.1e4), duration, outputs=50)
    for name, found in zip(everything, made(0.27, 5.1e4), strict=True):
        # Two integrations, each to 1e-8 of the force; the RMS of nothing is rounding.
        wanted = MEASURES[name].of(run)
        assert found == pytest.approx(wanted, rel=3e-8, abs=3e-8 * np.max(np.abs(wanted)) + 1e-9), name


def test_every_quantity_can_be_an_input(r1_soil):
    """Each in turn, in a scene that has it: the output is that of the scene with the other number."""
    waves = tuple(po.StrengthWave(0.1, 0.2 + 0.05 * k, 0.3 * k - 1.0) for k in range(2))
    effects = po.Effects(strength_wave=waves, tow_ramp=0.1, damping=250.0, speed_term=0.1, rate_term=0.05,
                         contact=po.Smooth(0.5), random_strength=po.RandomStrength(0.2, 0.3))  # fmt: skip
    scene = po.Scene(r1_soil, po.Wedge(0.5, 0.25, 0.25), 5e4, 25.0, 2.0, effects)
    absent = {"share.half_angle", "effects.breakaway", "soil.youngs_modulus", "soil.poisson_ratio"}
    # Two of eight strength waves; the others are named and reached alike.
    names = [name for name in QUANTITIES if name not in absent and not re.search("wave_[3-8]", name)]
    # How exactly is another test's question.
    few = po.Accuracy("dop853", steps=20)
    made = po.component(scene, 0.2, inputs=names, outputs=["mean_draft", "stationary_force_rms"], accuracy=few)
    base = made(*(port.value for port in made.inputs))
    changed = [made(**{port.name: port.upper}) for port in made.inputs]
    moved = {port.name for port, found in zip(made.inputs, changed, strict=True) if [*found.values()] != [*base]}
    assert moved == set(names)
    cone = po.Scene(r1_soil, po.Cone(0.2, 0.25), 5e4, 25.0, 2.0, po.Effects(motion=False))
    assert po.component(cone, 1.0, inputs=["share.half_angle"], outputs=["half_angle"])(0.3) == 0.3


def test_the_elastic_medium_can_be_a_component():
    soil = po.named_soil("serozem")
    scene = po.Scene(soil, po.Wedge(0.5, 0.25, 0.25), 5e5, 20.0, 2.0, po.Effects(motion=False), medium="elastic")
    inputs = ["soil.youngs_modulus"]
    made = po.component(scene, 1.0, inputs=inputs, outputs=["mean_draft"])
    assert made(*(port.value for port in made.inputs)) == pytest.approx(scene.steady_resistance, rel=1e-13)
    with pytest.raises(po.InputError, match="no meaning in the elastic medium"):
        po.component(scene, 1.0, inputs=inputs, outputs=["loosened_radius"])


def steady(law, *bounds):
    scene = scene_of(medium=law, motion=False)
    return po.component(scene, 1.0, inputs=[po.Input(*bounds)], outputs=["mean_draft"])


STEEP, NARROW = McKyesAli(width=0.1, rake_angle=1.4), UniversalEarthmoving(width=0.1)
test_corners_outside_the_domain_of_a_law_are_refused = refusals(
    po.DomainError,
    (lambda: steady(STEEP, "soil.tool_friction", 0.4, 4.0), "at soil.tool_friction = 4: .*would not move up the face"),
    (lambda: steady(NARROW, "share.height", 0.2, 0.8), "at share.height = 0.8 m: .*critical depth"),
)


def test_duration_and_masses_are_inputs_too(r1_scene):
    scene = r1_scene(damping=300.0, start="rest")
    names = ["scene.duration", "scene.frame_mass", "scene.steel_density"]
    made = po.component(scene, 1.0, inputs=names, outputs=["moving_mass", "mean_draft"], steel_density=7850.0)
    found, draft = made(1.7, 30.0, 5000.0)
    mass = 30.0 + 5000.0 * scene.cone.volume
    assert found == pytest.approx(mass, rel=1e-14)
    other = dataclasses.replace(scene, mass=mass)
    assert draft == pytest.approx(po.simulate(other, 1.7).mean_draft, rel=3e-8)
    fixed = po.component(scene, 0.5, inputs=["share.height"], outputs=["mean_draft"])
    told = [any("the moving mass stays" in note for note in one.warnings) for one in (made, fixed)]
    assert told == [False, True]


FREE = ca.MX.sym("k")
HEIGHT = po.Input("k", 0.2, 0.3, symbol=FREE)
NOTHING = po.Output("nothing", of=lambda run: run.mean_draft / (0.0 * run.mean_draft))


def _stiffness(lower, upper):
    return {"inputs": [po.Input("scene.stiffness", lower, upper)]}


INVALID = [
    ({"contact": po.StickSlip()}, {}, "stick and slip cannot be a component: its events"),
    ({"entry": True, "start": "rest"}, {}, "enters the soil cannot be a component"),
    ({}, {"inputs": ["effects.damping"]}, "the scene has no 'effects.damping'"),
    ({}, {"inputs": ["scene.frame_mass"]}, "needs a steel_density"),
    ({}, {"inputs": ["scene.stiffness", "scene.stiffness"]}, "twice"),
    ({"own": (Shank(per_metre=-1e8),)}, {}, "at scene.stiffness = 50000 N/m: the motion of a share"),
    ({"height": FREE}, {"inputs": [HEIGHT], "steel_density": 7850.0}, "needs a numeric scene"),
    ({}, {"outputs": [NOTHING]}, "'nothing' has no finite value"),
    ({}, {"accuracy": po.Accuracy("cvodes")}, "'cvodes' has no fixed steps, as a component needs"),
    ({"stiffness": FREE}, {"inputs": ["share.height"]}, "symbols that are not inputs, k"),
    ({}, _stiffness(6e4, 7e4), "= 50000 lies outside its bounds 60000 to 70000"),
    ({}, _stiffness(1.0, 1e14), "so fast that the run would take"),
    ({}, _stiffness(1.0, np.inf), "upper of 'scene.stiffness' = inf N/m must be finite"),
    (
        {},
        {"inputs": [po.Input("share.wedge_angle", 0.1, 1.0), po.Input("soil.density_ratio", 0.5, 1.5)]},
        "at share.wedge_angle = 0.1 rad, soil.density_ratio = 1.5: density ratio b1",
    ),
]


@pytest.mark.parametrize(("effects", "requested", "words"), INVALID)
def test_an_invalid_component_is_refused_with_the_reason(r1_scene, effects, requested, words):
    requested = {"duration": 1.0, "inputs": ["scene.stiffness"], "outputs": ["mean_draft"]} | requested
    with pytest.raises((po.InputError, po.DomainError), match=re.escape(words)):
        po.component(r1_scene(**effects), **requested)


@pytest.fixture(scope="module")
def two_inputs(r1_scene):
    inputs = [po.Input("scene.stiffness", 4e4, 6e4), "share.height"]
    return po.component(r1_scene(), 1.0, inputs=inputs, outputs=["mean_draft"])


INVALID_CALLS = [
    ((1e6, 0.25), {}, r"scene.stiffness = 1e\+06 N/m must lie between 40000 and 60000 N/m"),
    ((5e4,), {}, "takes 2 inputs"),
    ((np.array([4e4, 5e4]), 0.25), {}, "component.map takes many"),
    ((), {"share.height": 0.2, "share_height": 0.3}, "'share.height' is given twice, also as 'share_height'"),
]


@pytest.mark.parametrize(("values", "named", "words"), INVALID_CALLS)
def test_invalid_calls_are_refused(two_inputs, values, named, words):
    with pytest.raises((po.InputError, po.DomainError), match=words):
        two_inputs(*values, **named)
    assert np.isfinite([two_inputs(bound, 0.25) for bound in (4e4 - 1.8e-5, 6e4 + 1.8e-5)]).all()
