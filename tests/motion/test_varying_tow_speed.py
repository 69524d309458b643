"""Runs with a tow speed that varies over time, against SciPy's integration of the model's equations written again."""

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pint
import pytest
from helpers.forces import SLIP, Forces
from helpers.refusals import refusals
from helpers.scenes import RESULTS, assert_alike, results_of, scene_of
from scipy.integrate import quad, solve_ivp

import plough_opt as po

WAVE = po.StrengthWave(0.3, 0.4, 0.7)
TABLE = ([0.0, 0.3, 0.35, 0.9, 1.7], [1.5, 2.5, 2.4, 0.8, 2.0])
STANDSTILL = ([0.0, 0.2, 0.6, 0.8], [0.0, 0.0, 2.0, 1.9])


def expected(scene, speed, knots, run):
    """Return the results of a run, in the order of `RESULTS`, from SciPy between the knots."""
    forces, times = Forces(scene), run.time
    forces.v0 = speed(0.0)  # of an equilibrium start
    travel, rate, _ = forces.start()
    # Travel, speed, deflection; integrals of force, deflection, their squares from the first ones, and power.
    ends, state, columns = [0.0, *(k for k in knots if k < times[-1]), times[-1]], [travel, rate, -travel], []
    first = forces.k * -travel + forces.c * (speed(0.0) - rate)

    def rates(t, y):
        force = forces.k * y[2] + forces.c * (speed(t) - y[1])
        acceleration = forces.acceleration(SLIP, force, y[0], y[1])
        change, shift = force - first, y[2] + travel
        return [y[1], acceleration, speed(t) - y[1], change, shift, change**2, shift**2, force * speed(t)]

    state = np.array([*state, 0.0, 0.0, 0.0, 0.0, 0.0])
    for begin, end in pairwise(ends):
        inside = times[(times >= begin) & (times < end)]
        found = solve_ivp(rates, (begin, end), state, "DOP853", [*inside, end], rtol=1e-12, atol=1e-13, max_step=0.01)
        columns, state = [*columns, found.y[:, :-1]], found.y[:, -1]
    y = np.column_stack([*columns, state])
    tow = np.array([speed(t) for t in times])
    force = forces.k * y[2] + forces.c * (tow - y[1])
    accelerations = np.array([forces.acceleration(SLIP, *row) for row in zip(force, y[0], y[1], strict=True)])
    soil = force - forces.m * accelerations
    change, shift, square, shift_square, power = state[3:] / times[-1]
    rms, shift_rms = math.sqrt(square - change**2), math.sqrt(shift_square - shift**2)
    return [times, y[0], y[1], y[2], force, soil, first + change, rms, shift - travel, shift_rms, power]


TABLES = {"table": (TABLE, TABLE[0][1:]), "standstill": (STANDSTILL, STANDSTILL[0][1:])}
EFFECTS = [
    {"damping": 300.0, "strength_wave": WAVE},
    {"rate_term": 0.05, "strength_wave": (WAVE, po.StrengthWave(0.2, 1.1)), "start": "rest"},
    {"contact": po.Smooth(0.8), "damping": 900.0, "start": "towed"},
]


def speed_of(speed):
    return lambda t: float(np.interp(t, *speed))


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("effects", EFFECTS)
def test_a_run_is_that_of_scipy_within_its_error_estimate(effects, name):
    speed, knots = TABLES[name]
    scene = scene_of(**effects)
    run = po.simulate(scene, 1.2, tow_speed=speed)
    assert run.error_estimate < 1e-8
    # SciPy is exact to 1e-12 of each state in each of a hundred steps.
    assert_alike(expected(scene, speed_of(speed), knots, run), run, run.error_estimate + 1e-10)


def test_random_tables_and_effects():
    rng = np.random.default_rng(32)
    for _ in range(12):
        count = rng.integers(2, 9)
        times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.4, count))])
        speeds = rng.uniform(0.3, 3.0, count + 1)
        scene = scene_of(
            stiffness=10.0 ** rng.uniform(4.0, 5.5),
            damping=rng.choice([None, 200.0]),
            rate_term=rng.choice([None, 0.03]),
            start=str(rng.choice(["equilibrium", "rest", "towed"])),
            strength_wave=WAVE,
        )
        run = po.simulate(scene, 0.8, tow_speed=(times, speeds), outputs=57)
        found = expected(scene, speed_of((times, speeds)), times[1:], run)
        assert_alike(found, run, run.error_estimate + 1e-10)


def test_forms_of_a_table_agree():
    scene = scene_of(damping=300.0, strength_wave=WAVE)
    ureg = pint.UnitRegistry()
    line = ([0.0, 0.6, 1.2], [1.0, 2.0, 3.0])
    texts = (["0 s", "600 ms", 1.2], ["3.6 km/h", "2 m/s", "10.8 km/h"])
    quantities = (np.array(line[0]) * ureg.s, np.array(line[1]) * 3.6 * ureg.km / ureg.h)
    exact = po.simulate(scene, 1.2, tow_speed=line)
    for given in (texts, quantities, np.array(line), [list(line[0]), list(line[1])]):
        assert_alike(results_of(exact), po.simulate(scene, 1.2, tow_speed=given), 1e-10)


def test_methods_and_machine_code_agree():
    scene = scene_of(damping=300.0, strength_wave=WAVE)
    run = po.simulate(scene, 1.2, tow_speed=TABLE, accuracy=po.Accuracy(error=1e-10))
    for more in ({"compiled": True}, {"accuracy": po.Accuracy("erk", tolerance=1e-12)},
                 {"accuracy": po.Accuracy("rk", steps=4000)}):  # fmt: skip
        other = po.simulate(scene, 1.2, tow_speed=TABLE, **more)
        assert_alike(results_of(other), run, other.error_estimate + 1e-10)


def test_a_rigid_mount_follows_the_table():
    scene = scene_of(motion=False, strength_wave=WAVE)
    run, forces = po.simulate(scene, 1.2, tow_speed=TABLE), Forces(scene)
    speed = speed_of(TABLE)
    path = np.array([quad(speed, 0.0, t, points=[k for k in TABLE[0] if 0.0 < k < t])[0] for t in run.time])
    assert run.travel == pytest.approx(path, abs=1e-12)
    draft = [forces.soil(s, speed(t)) for s, t in zip(path, run.time, strict=True)]
    assert run.mount_force == pytest.approx(draft, rel=1e-11)


PROFILE = po.simulate(scene_of(motion=False), 1.2, tow_speed=TABLE).scene.effects.tow_profile
IN_DESIGNS = (EFFECTS[0], EFFECTS[2], {"motion": False, "strength_wave": WAVE})


@pytest.mark.parametrize("effects", IN_DESIGNS, ids=["damped", "smooth", "rigid"])
def test_symbols_move_with_the_table(effects):
    stiffness, at, h = ca.MX.sym("stiffness"), 4e4, 40.0

    def swing(k, **more):
        scene = scene_of(stiffness=k, tow_speed=2.5, tow_profile=PROFILE, **effects)
        return po.simulate(scene, 1.2, **more).displacement_rms

    exact = {"accuracy": po.Accuracy(error=1e-11)} if effects.get("motion", True) else {}
    by_symbol = swing(stiffness)
    rms, slope = ca.Function("f", [stiffness], [by_symbol, ca.gradient(by_symbol, stiffness)])(at)
    assert float(rms) == pytest.approx(swing(at, **exact), rel=1e-10)
    difference = (swing(at + h, **exact) - swing(at - h, **exact)) / (2.0 * h)
    assert float(slope) == pytest.approx(difference, rel=1e-5)


def test_a_run_keeps_its_tow_speed_in_a_file(tmp_path):
    run = po.simulate(scene_of(), 1.2, tow_speed=TABLE)
    (tmp_path / "run.json").write_text(run.to_json())
    again = po.load(tmp_path / "run.json")
    assert again.scene == run.scene
    assert results_of(po.simulate(again.scene, 1.2))[6:] == pytest.approx(results_of(run)[6:], rel=0)
    assert len(RESULTS) == 11


def simulated(tow_speed=TABLE, duration=1.2, accuracy=None, **effects):
    return lambda: po.simulate(scene_of(**effects), duration, tow_speed=tow_speed, accuracy=accuracy)


X = ca.MX.sym("x")
test_refusals_name_the_cause = refusals(
    po.InputError,
    (simulated(orbit="periodic", strength_wave=WAVE, duration=None), "orbit"),
    (simulated(tow_ramp=0.5), "tow_ramp"),
    (simulated(contact=po.StickSlip()), "StickSlip"),
    (simulated(entry=True, start="towed"), "entry"),
    (simulated(random_strength=po.RandomStrength(0.2, 0.3), damping=9.0), "random strength"),
    (simulated(duration=ca.MX.sym("duration")), "duration"),
    *((simulated(wrong), "tow_speed = .* must be a tuple of times .* constant speed to the scene, and a function as a")
      for wrong in (2.5, "9 km/h", "fast", {0.0: 1.0}, X, (X, X), [1.0, 2.0], [], ([0.0, 1.0], [1.0, 2.0, 3.0]),
                    lambda t: 1.0 + t, [(0, 1), (4, 2)], np.array([[0.0, 1.0], [4.0, 2.0]]))),
    *((simulated(turned), "two columns: transpose") for turned in (np.array(TABLE).T, tuple(zip(*TABLE, strict=True)))),
    (simulated(([0.0, 1.0, 2.0], [1.0, math.nan, 2.0])), "speed in row 2 .*nan"),
    (simulated((["0 s", "1 m"], [1.0, 2.0])), "time in row 2"),
    *((simulated(late), "rise from 0") for late in (([0.5, 1.0], [1.0, 2.0]), ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0]))),
    (simulated(([0.0, 1.0], [1.0, -0.1])), "at least 0 everywhere; at 1 s"),
    (simulated((np.arange(300.0), np.ones(300))), "201"),
    (simulated(accuracy=po.Accuracy("dop853", steps=50)), "too few"),
    (lambda: po.Effects(tow_profile=([0, 1], [1, 2])), "SpeedProfile"),
    (lambda: po.Batch(simulated()().scene, 1.0, [X]), "batch"),
)  # fmt: skip


def test_a_strut_that_never_moves_is_outside_the_domain():
    with pytest.raises(po.DomainError, match="largest tow speed"):
        simulated(([0.0, 1.0], [0.0, 0.0]))()
