"""The public equation of motion, against the model's equations written again, and integrated by SciPy."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers.forces import GAP, SLIP, Forces
from helpers.refusals import refusals
from helpers.scenes import Shank, scene_of
from scipy.integrate import solve_ivp

import plough_opt as po

WAVE = po.StrengthWave(0.3, 0.4, 0.7)
SCENES = {
    "plain": {},
    "damped": {"damping": 300.0, "strength_wave": WAVE},
    "rate term": {"rate_term": 0.05, "strength_wave": (WAVE, po.StrengthWave(0.2, 1.1)), "start": "rest"},
    "smooth": {"contact": po.Smooth(0.8), "damping": 300.0},
    "entry": {"entry": True, "start": "towed", "damping": 300.0},
    "stick and slip": {"contact": po.StickSlip(1.3), "strength_wave": WAVE, "start": "rest"},
    "printed": {"formulation": "printed", "damping": 300.0},
}


def flat(column):
    return np.asarray(column).ravel()


def arguments(equation):
    return [equation.controls, equation.parameters]


@pytest.mark.parametrize("effects", SCENES.values(), ids=SCENES)
def test_rate_and_outputs_are_those_of_the_model(effects):
    rng, controls = np.random.default_rng(11), ["tow_speed", "stiffness"] + ["damping"] * ("damping" in effects)
    scene = scene_of(**effects)
    equation, sign = scene.equation(controls=controls), -1.0 if effects.get("formulation") else 1.0
    for _ in range(40):
        travel, speed, z = rng.uniform(-0.1, 0.6), rng.uniform(0.01, 3.0), rng.uniform(-0.05, 0.1)
        u = [rng.uniform(0.0, 4.0), rng.uniform(1e4, 1e5), rng.uniform(10.0, 900.0)][: len(controls)]
        forces = Forces(scene)
        forces.k, forces.c = sign * u[1], u[2] if len(u) > 2 else 0.0
        mode = rng.choice([SLIP, GAP]) if isinstance(scene.effects.contact, po.StickSlip) else SLIP
        x = [travel, speed, z, float(mode), travel + 0.01, float(travel > 0.25)][: len(equation.names["state"])]
        pull = forces.k * z + forces.c * (u[0] - speed)
        acceleration = forces.acceleration(mode, pull, travel, speed)
        expected = [speed, acceleration, u[0] - speed, *[0.0] * (len(x) - 3)]
        assert flat(equation.rate(0.3, x, u, [])) == pytest.approx(expected, rel=1e-12, abs=1e-12)
        force, soil, again, tow, place, power = map(float, equation.outputs(0.3, x, u, []))
        resisted = forces.soil(travel, speed) + forces.carried(travel) * acceleration if mode == SLIP else 0.0
        assert [force, again, tow, place] == pytest.approx([pull, acceleration, u[0], travel + z], rel=1e-12, abs=1e-12)
        assert [soil, power] == pytest.approx([resisted, pull * u[0]], rel=1e-12, abs=1e-12 * abs(pull))


def speed_of(t):
    """Return a tow speed with a kink at 0.5 s and a jump at 0.8 s."""
    return 2.0 + 0.4 * math.sin(9.0 * t) + max(t - 0.5, 0.0) - 0.3 * (t >= 0.8)


def test_a_varying_speed_and_stiffness_integrated_by_scipy():
    scene = scene_of(damping=300.0, strength_wave=WAVE, rate_term=0.02)
    equation = scene.equation(controls=("stiffness", "tow_speed"), parameters=("soil.cohesion",))
    forces = Forces(scene)

    def controls(t):
        return [5e4 * (1.0 + 0.3 * math.cos(4.0 * t)), speed_of(t)]

    def again(t, x):
        forces.k, tow = controls(t)
        pull = forces.k * x[2] + forces.c * (tow - x[1])
        return [x[1], forces.acceleration(SLIP, pull, x[0], x[1]), tow - x[1]]

    def rate(t, x):
        return flat(equation.rate(t, x, controls(t), equation.parameters))

    x = flat(equation.start([5e4, 2.0], equation.parameters))
    assert x[:2] == pytest.approx(forces.start()[:2], rel=1e-13)
    y = x
    for begin, end in ((0.0, 0.5), (0.5, np.nextafter(0.8, 0.0)), (0.8, 1.2)):
        x, y = (
            solve_ivp(f, (begin, end), start, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
            for f, start in ((rate, x), (again, y))
        )
    assert x == pytest.approx(y, rel=1e-11, abs=1e-11)


SPEEDS = {"tow_profile": po.SpeedProfile((0.0, 0.4, 0.9), ((0.5, 0.5), (1.0, -0.3)))}


@pytest.mark.parametrize("effects", [{}, {"damping": 300.0, "strength_wave": WAVE, "tow_ramp": 0.3}, SPEEDS])
def test_at_constant_speed_it_gives_the_run_of_the_toolkit(effects):
    scene = scene_of(start="rest", **effects)
    equation, run = scene.equation(), po.simulate(scene, 1.0, accuracy=po.Accuracy(error=1e-10))
    start = flat(equation.start(*arguments(equation)))
    found = solve_ivp(lambda t, x: flat(equation.rate(t, x, [], [])), (0.0, 1.0), start, "DOP853", run.time,
                      rtol=1e-12, atol=1e-12).y  # fmt: skip
    assert found[0] == pytest.approx(run.travel, abs=1e-9)
    assert found[2] == pytest.approx(run.deflection, abs=1e-9)
    forces = equation.outputs.map(len(run.time))(run.time, found, [], [])
    assert flat(forces[0]) == pytest.approx(run.mount_force, abs=1e-8 * run.peak_force)
    assert flat(forces[1]) == pytest.approx(run.soil_resistance, abs=1e-6 * run.peak_force)


def test_events_lead_a_sticking_share_through_its_modes():
    scene = scene_of(contact=po.StickSlip(1.4), start="rest", damping=300.0, strength_wave=po.StrengthWave(0.9, 0.3))
    equation, run = scene.equation(), po.simulate(scene, 0.6)
    assert len(np.unique(run.mode)) > 1

    def value(k):
        def of(t, x):
            return float(equation.events(t, x, [], [])[0][k])

        of.terminal, of.direction = True, -1.0
        return of

    now, x, count = 0.0, flat(equation.start([], [])), 0
    while now < 0.6:
        found = solve_ivp(lambda t, x: flat(equation.rate(t, x, [], [])), (now, 0.6), x, "DOP853", rtol=1e-12,
                          atol=1e-12, events=[value(0), value(1)], max_step=5e-3)  # fmt: skip
        now, x = found.t[-1], found.y[:, -1]
        if found.status == 1:
            x, count = flat(equation.events(now, x, [], [])[1]), count + 1
    assert count > 1
    assert x[:3] == pytest.approx([run.travel[-1], run.speed[-1], run.deflection[-1]], abs=1e-7)


def test_parameters_are_differentiable_and_in_any_graph():
    scene = scene_of()
    equation = scene.equation(controls=("tow_speed",), parameters=("share.height", "scene.stiffness"))
    x, p = ca.MX.sym("x", 3), ca.MX.sym("p", 2)
    slope = ca.Function("slope", [x, p], [ca.jacobian(equation.rate(0.0, x, 2.0, p)[1], p)])
    at, h = flat(equation.start(*arguments(equation))), 1e-6

    def acceleration(height, stiffness):
        other = scene_of(share=po.Wedge(po.deg(30.0), po.deg(15.0), height), stiffness=stiffness).equation()
        return float(other.rate(0.0, at, [], [])[1])

    by_height = (acceleration(0.25 + h, 5e4) - acceleration(0.25 - h, 5e4)) / (2.0 * h)
    by_stiffness = (acceleration(0.25, 5e4 + 1.0) - acceleration(0.25, 5e4 - 1.0)) / 2.0
    assert flat(slope(at, equation.parameters)) == pytest.approx([by_height, by_stiffness], rel=1e-6)
    assert {equation.units[name] for name in equation.names["parameters"]} == {"m", "N/m"}
    assert [*equation.units] == [name for names in equation.names.values() for name in names]
    assert "  parameters[1]  scene.stiffness  50000  N/m\n" in str(equation)


def test_a_parameter_that_is_zero_in_the_scene_has_its_effect():
    shifted = scene_of(strength_wave=po.StrengthWave(0.3, 0.2, phase=1.0)).equation()
    equation = scene_of(strength_wave=po.StrengthWave(0.3, 0.2)).equation(parameters=("effects.strength_wave.phase",))
    at = flat(shifted.start([], []))
    # The same operations in both graphs, so that only the last digits may differ.
    assert flat(equation.rate(0.0, at, [], [1.0])) == pytest.approx(flat(shifted.rate(0.0, at, [], [])), rel=1e-13)
    assert flat(equation.rate(0.0, at, [], [0.0]))[1] != pytest.approx(flat(shifted.rate(0.0, at, [], []))[1], rel=0.01)


def equation(effects, **asked):
    return lambda: scene_of(**effects).equation(**asked)


test_refusals_name_the_cause = refusals(
    po.InputError,
    (equation({}, controls=("mass",)), "'mass' cannot be a control"),
    (equation({}, controls=("scene.tow_speed",)), "'scene.tow_speed' cannot be a control"),
    (equation({}, controls="tow_speed"), "must be a tuple"),
    (equation({}, controls=("tow_speed", "tow_speed")), "different names"),
    (equation({}, controls=("damping",)), "has no 'effects.damping'"),
    (equation({}, controls=("stiffness",), parameters=("scene.stiffness",)), "cannot be a parameter"),
    (equation({}, parameters=("soil.colour",)), "no quantity 'soil.colour'"),
    (equation({"tow_ramp": 0.5}, controls=("tow_speed",)), "tow_ramp and the control"),
    (equation(SPEEDS, controls=("tow_speed",)), "tow_profile and the control"),
    (equation({}, controls=None), "must be a tuple"),
    (equation({"motion": False}), "quasi-static scene"),
    (equation({"orbit": "periodic", "strength_wave": WAVE}), "orbit"),
    (equation({"damping": ca.MX.sym("damping")}), "scene with symbols"),
)


def test_an_effect_of_ones_own_enters_too():
    scene = scene_of(own=(Shank(150.0, 80.0),))
    bare, equation = scene_of().equation(), scene.equation()
    x = [0.1, 1.5, 0.05]
    change = float(equation.rate(0.0, x, [], [])[1] - bare.rate(0.0, x, [], [])[1])
    assert change == pytest.approx(-(150.0 + 80.0 * 1.5) / float(scene.inertia), rel=1e-12)
