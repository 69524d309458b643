"""Results of `simulate` against published numbers, exact solutions and symbolic runs; averages over whole waves."""

import dataclasses
import math
import pickle
import re

import casadi as ca
import numpy as np
import pytest
from helpers.linear_motion import averages, oscillation, released
from helpers.problem_files import SUBSOILER
from helpers.scenes import ARRAYS, AVERAGES, R1_RUNS, R1_SOIL, assert_alike, results_of, scene_of

import plough_opt as po

WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.6)
FINE = po.Accuracy("dop853", steps=3200)
WEAK = dataclasses.replace(R1_SOIL, cohesion=0.0, ambient_pressure=0.0)


def close_to(expected, allowed):
    """Return a value that is equal up to a fraction of the largest element."""
    return pytest.approx(expected, rel=0, abs=allowed * np.max(np.abs(expected)))


# --- published numbers of problem R1 ---


@pytest.mark.parametrize(("angle", "height", "stiffness", "mean", "rms"), R1_RUNS)
def test_reference_values_to_every_digit(r1_scene, angle, height, stiffness, mean, rms):
    scene = r1_scene(angle, height, stiffness, strength_wave=WAVE)
    for accuracy in (FINE, po.Accuracy(error=1e-12)):
        run = po.simulate(scene, 2.0, accuracy=accuracy)
        # Half a unit of the last published digit, and rounding.
        assert run.mean_draft == pytest.approx(mean, rel=0, abs=0.51e-9)
        assert run.force_rms == pytest.approx(rms, rel=0, abs=0.51e-9)


def test_a_simulated_scene_is_saved_like_a_new_one(r1_scene):
    scene = r1_scene(25.0, 0.25, 5e4, strength_wave=WAVE, tow_ramp=0.1)
    new = pickle.dumps(scene)
    po.simulate(scene, 0.1)
    assert pickle.dumps(scene) == new


# --- exact solutions ---


ADAPTIVE = [po.Accuracy(method) for method in ("erk", "cvodes", "idas", "rosenbrock")]
REPELS = po.Printed(pi_twice=False, one_third=False)
# stiffness N/m, tow speed m/s, damping N s/m, formulation (the spring as printed repels), duration s
OSCILLATIONS = [
    (5e4, 2.0, 250.0, "derived", 1.0),
    (5e4, 2.0, None, REPELS, 0.15),
    (5e4, 2.0, 250.0, REPELS, 0.2),
    (5e4, 2.0, None, "derived", 1.0),
    (3e2, 0.5, None, "printed", 1.5),
    (5e4, 2.0, 900.0, "derived", 1.0),
    (3e2, 0.0, 90.0, "printed", 2.0),
]


@pytest.mark.parametrize("accuracy", [FINE, None, *ADAPTIVE], ids=lambda a: a.method if a else "auto")
@pytest.mark.parametrize(("stiffness", "speed", "damping", "formulation", "duration"), OSCILLATIONS)
def test_linear_motion_from_rest(r1_scene, stiffness, speed, damping, formulation, duration, accuracy):
    effects = {"start": "rest", "inertial_drag": False, "damping": damping, "formulation": formulation}
    scene = r1_scene(stiffness=stiffness, tow_speed=speed, **effects)
    run = po.simulate(scene, duration, accuracy=accuracy, outputs=20)

    def exact(times):
        """Return the deflection and the force of the mount on the share."""
        z, rate = oscillation(scene, times)
        return z, scene.restoring_stiffness * z + (damping or 0.0) * rate

    (z, force), rate = exact(run.time), oscillation(scene, run.time)[1]
    # 3200 steps of order 8 leave rounding only, over seven oscillations or ten e-foldings.
    allowed = 1e-12 if accuracy is FINE else 3e-8
    assert run.deflection == close_to(z, allowed)
    assert run.speed == pytest.approx(speed - rate, rel=0, abs=allowed * max(speed, np.max(np.abs(rate))))
    assert run.travel == pytest.approx(speed * run.time - z, rel=0, abs=allowed * np.max(np.abs(z)))
    assert run.mount_force == close_to(force, allowed)
    for k, found in enumerate(((run.mean_deflection, run.displacement_rms), (run.mean_draft, run.force_rms))):
        expected = averages(lambda times, k=k: exact(times)[k], duration)
        assert found == close_to(expected, allowed)
    assert run.tow_power == pytest.approx(run.mean_draft * speed, rel=1e-12)
    assert accuracy is not None or run.error_estimate < 1e-8


@pytest.mark.parametrize("accuracy", [None, FINE, po.Accuracy("cvodes"), po.Accuracy("rosenbrock")])
@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"rate_term": 0.05},
        {"speed_term": 0.2},
        {"damping": 250.0},
        {"inertial_drag": False},
        {"inertial_drag": False, "soil": WEAK},
    ],
    ids=["drag", "rate", "speed", "damper", "bare", "no force"],
)
def test_a_steady_start_stays_steady_exactly(r1_scene, effects, accuracy):
    scene = r1_scene(**effects)
    run = po.simulate(scene, 2.0, accuracy=accuracy, outputs=40)
    steady = scene.steady_resistance
    assert run.force_rms == run.displacement_rms == 0.0
    assert np.ptp(run.deflection) == np.ptp(run.mount_force) == np.ptp(run.speed) == 0.0
    assert run.mean_draft == pytest.approx(steady, rel=1e-15)
    assert run.mean_deflection == pytest.approx(steady / scene.stiffness, rel=1e-15)
    assert run.error_estimate == 0.0
    assert run.peak_force == run.mount_force[0]


def test_the_smallest_oscillation_keeps_its_digits(r1_scene):
    amplitude, duration = 1e-9, 1.3
    scene = r1_scene(strength_wave=po.StrengthWave(amplitude, 0.6))
    run = po.simulate(scene, duration, accuracy=FINE)
    # To first order in the amplitude M w'' + 2 Fd V0 w' + k0 w = eps F0 sin(2 pi (V0 t - z_s)/ell).
    reaction, k, v = scene.reaction, scene.stiffness, scene.tow_speed
    damping, omega = 2 * reaction.drag * v, 2 * math.pi * v / 0.6
    forced = -1j * amplitude * reaction.static * np.exp(-2j * math.pi * scene.steady_resistance / k / 0.6)
    forced /= k - scene.inertia * omega**2 + 1j * damping * omega
    first = -forced.real, -(1j * omega * forced).real

    def deviation(times):
        return (forced * np.exp(1j * omega * times)).real + released(scene.inertia, damping, k, first, times)[0]

    mean, rms = averages(deviation, duration)
    # The next order in the amplitude is 1e-9 of this one; force_rms is 1e-10 of the mean draft.
    assert run.force_rms < 1e-9 * run.mean_draft
    assert run.force_rms == pytest.approx(k * rms, rel=1e-8)
    assert run.displacement_rms == pytest.approx(rms, rel=1e-8)
    assert run.mean_draft - scene.steady_resistance == pytest.approx(k * mean, abs=1e-15 * run.mean_draft)


# --- numbers and symbols ---

# Height, stiffness, tow speed, rate term, wave, damping, ramp and duration.
NUMBERS = [0.23, 6e4, 1.9, 0.0525, 0.345, 0.66, 225.0, 0.12, 0.6]


@pytest.mark.parametrize("ramp", ["none", "number", "symbol"])
@pytest.mark.parametrize("motion", [True, False])
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_numbers_and_symbols_run_alike(r1_scene, kind, motion, ramp):
    def run(height, stiffness, speed, rate, amplitude, wavelength, damping, ramp_time, duration):
        effects = {"rate_term": rate, "strength_wave": po.StrengthWave(amplitude, wavelength)}
        effects |= {"none": {}, "number": {"tow_ramp": NUMBERS[-2]}, "symbol": {"tow_ramp": ramp_time}}[ramp]
        effects |= {"damping": damping, "start": "rest"} if motion else {"motion": False}
        accuracy = po.Accuracy("dop853", steps=400) if motion else None
        scene = r1_scene(27.5, height, stiffness, tow_speed=speed, **effects)
        return po.simulate(scene, duration, accuracy=accuracy, outputs=10 if motion else 200)

    x = kind.sym("x", len(NUMBERS))
    found = ca.Function("run", [x], results_of(run(*ca.vertsplit(x)))).call([ca.DM(NUMBERS)])
    # The same operations in another order, and the quasi-static averages by panels of 0.1 rad.
    assert_alike(map(np.asarray, found), run(*NUMBERS), 1e-11)


# In a step, at the end of one, and after the run.
@pytest.mark.parametrize("ramp", [0.137, 0.15, 0.9])
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_a_ramp_that_moves_has_exact_derivatives(r1_scene, kind, ramp):
    def results(ramp, stiffness, accuracy=None):
        run = po.simulate(r1_scene(25.0, 0.25, stiffness, strength_wave=WAVE, damping=200.0, start="rest",
                                   tow_ramp=ramp), 0.6, outputs=4, accuracy=accuracy)  # fmt: skip
        return [run.mean_draft, run.force_rms, run.mean_deflection, run.tow_power]

    p, h = np.array([ramp, 5e4]), 1e-3 * ramp
    x = kind.sym("x", 2)
    column = ca.vertcat(*results(x[0], x[1]))
    slopes = ca.Function("slopes", [x], [ca.densify(ca.jacobian(column, x))])
    bends = ca.Function("bends", [x], [ca.hessian(ca.sum1(column), x)[0]])(p).full()[0]
    values, first = (np.array([results(ramp + k * h, 5e4, po.Accuracy(error=1e-12)) for k in (-2, -1, 0, 1, 2)]),
                     slopes(p).full()[:, 0])  # fmt: skip
    by_differences = (values[0] - 8.0 * values[1] + 8.0 * values[3] - values[4]) / (12.0 * h)
    assert np.max(np.abs(first - by_differences) * ramp / values[2]) < 1e-8
    second = [np.sum(slopes([ramp + k * h, 5e4]).full(), axis=0) for k in (-2, -1, 1, 2)]
    by_differences = (second[0] - 8.0 * second[1] + 8.0 * second[2] - second[3]) / (12.0 * h)
    assert np.max(np.abs(bends - by_differences) * ramp * p) / np.sum(values[2]) < 1e-8


@pytest.mark.parametrize("kind", [ca.DM, ca.SX, ca.MX])
def test_constant_expressions_are_numbers(r1_scene, kind):
    scene = r1_scene(strength_wave=WAVE)
    share = po.Cone(kind(scene.cone.half_angle), kind(scene.cone.height))
    same = {name: kind(getattr(scene, name)) for name in ("stiffness", "mass", "tow_speed")}
    wrapped, plain = dataclasses.replace(scene, share=share, **same), dataclasses.replace(scene, share=scene.cone)
    assert wrapped.describe() == plain.describe()
    runs = [po.simulate(wrapped, kind(1.0)), po.simulate(plain, 1.0)]
    assert len({(run.mean_draft, run.error_estimate) for run in runs}) == 1
    assert isinstance(runs[0].mount_force, np.ndarray)


# --- outputs ---


def test_outputs_and_what_follows_from_them(r1_scene):
    scene = r1_scene(strength_wave=WAVE, damping=250.0)
    few, run = (po.simulate(scene, 2.0, accuracy=FINE, outputs=outputs) for outputs in (1, 25))
    assert {getattr(run, name).shape for name in ARRAYS} == {(26,)}
    assert list(run.time) == pytest.approx(np.linspace(0.0, 2.0, 26), rel=1e-15)
    assert (run.peak_force, run.peak_deflection) == (max(run.mount_force), max(run.deflection))
    radius = po.loosened_radius(run.scene.cone, run.scene.soil)
    assert run.specific_draft == pytest.approx(run.mean_draft / (math.pi * radius**2), rel=1e-15)
    # Averages do not depend on the outputs.
    assert len(few.time) == 2
    for name in AVERAGES:
        assert getattr(few, name) == pytest.approx(getattr(run, name), rel=1e-12), name
    assert few.mount_force[-1] == pytest.approx(run.mount_force[-1], rel=1e-11)
    # Runs are compared by identity.
    assert run in [run]
    assert run != few


@pytest.mark.parametrize("ramp", [None, 0.33, 0.02, 0.98])
def test_outputs_between_few_steps_are_as_exact_as_the_steps(r1_scene, ramp):
    scene = r1_scene(strength_wave=WAVE, tow_ramp=ramp, damping=100.0, start="rest")
    fine, half_a_radian, a_radian = (
        po.simulate(scene, 1.0, accuracy=po.Accuracy("dop853", steps=steps), outputs=1000) for steps in (4000, 90, 45)
    )
    # The error of such steps at their ends. Without halved outermost steps it would be 100 times larger between.
    for few, left in ((half_a_radian, 5e-9), (a_radian, 2e-6)):
        for name in ("deflection", "mount_force", "speed", "soil_resistance"):
            there, here = getattr(fine, name), getattr(few, name)
            assert np.max(np.abs(there - here)) < left * np.max(np.abs(there)), name


# --- warnings and refusals ---


def test_a_share_that_retreats_carries_a_warning(r1_scene):
    run = po.simulate(r1_scene(10.0, 0.40, 1e4, strength_wave=WAVE, start="rest"), 2.0)
    (warning,) = [text for text in run.warnings if "retreats" in text]
    assert f"{-min(run.speed):.3g} m/s" in warning
    forwards = po.simulate(r1_scene(strength_wave=po.StrengthWave(0.05, 0.6)), 2.0)
    assert min(forwards.speed) > 0.0
    assert not [text for text in forwards.warnings if "retreats" in text]


# --- means over broken and over whole strength waves: the warning, and average = "whole waves" in a file ---

WHOLE = 'scene.average="whole waves"'
TWO = "effects.strength_wave_2={amplitude=0.1, wavelength='0.11 m'}"


def broken(run):
    """Return the change of the mean draft that a run warns of [%], and the duration of whole waves [s]; or None."""
    (found,) = [
        re.search(r"mean draft by (\S+) %.* waves of (\S+) s", text) for text in run.warnings if "wave" in text
    ] or [None]
    return None if found is None else (float(found[1]), float(found[2]))


@pytest.mark.parametrize("seed", range(12))
def test_a_broken_wave_is_pointed_out_if_it_matters(seed):
    rng = np.random.default_rng([32, 4, seed])
    wave = po.StrengthWave(float(rng.uniform(0.1, 0.9)), float(rng.uniform(0.1, 0.6)))
    effects = {"contact": po.StickSlip()} if seed % 4 == 3 else {"damping": float(rng.uniform(0.0, 500.0))}
    scene = scene_of(strength_wave=wave, **effects)
    period = wave.wavelength / scene.tow_speed
    duration = float(rng.uniform(1.1, 7.9)) * period
    run, whole = (po.simulate(scene, t, outputs=1000) for t in (duration, np.floor(duration / period) * period))
    percent = 100.0 * (run.mean_draft / whole.mean_draft - 1.0)
    if abs(percent) > 0.51:
        assert broken(run) == (pytest.approx(percent, rel=0.1), pytest.approx(float(whole.duration), rel=1e-3))
    elif abs(percent) < 0.49:
        assert broken(run) is None
    assert broken(whole) is None


AVERAGED = [
    (("scene.tow_speed=7.8 km/h",), 21 * 0.2 / (7.8 / 3.6)),
    (("scene.tow_speed=7.2 km/h",), 2.0),
    (("scene.duration=0.05 s",), 0.1),  # at least one wave
    (("scene.tow_speed=2.1 m/s", TWO), 21 * 0.2 / 2.1),  # the longest wave counts
]


@pytest.mark.parametrize(("changes", "expected"), AVERAGED)
def test_files_average_over_whole_waves(changes, expected):
    plain, whole = (po.read_problem(SUBSOILER, (*changes, *more)) for more in ((), (WHOLE,)))
    run = whole.simulate()
    assert run.duration == pytest.approx(expected, rel=1e-12)
    assert broken(run) is None
    by_hand = po.simulate(plain.scene(), expected)
    assert run.mean_draft == pytest.approx(by_hand.mean_draft, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "word"),
    [((WHOLE, "effects={}"), "strength wave"), ((WHOLE, "effects.orbit=periodic"), "transient"),
     (("scene.average=mean",), "whole waves")],
)  # fmt: skip
def test_whole_waves_of_nothing_are_refused(changes, word):
    with pytest.raises(po.InputError, match=word):
        po.read_problem(SUBSOILER, changes)
