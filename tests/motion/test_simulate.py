"""Results of `simulate` against published numbers, exact solutions and symbolic runs."""

import math

import casadi as ca
import numpy as np
import pytest

import plough_opt as po

WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.6)
FINE = po.Accuracy("dop853", steps=3200)
AVERAGES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
ARRAYS = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance")


def close_to(expected, allowed):
    """Return a value that is equal up to a fraction of the largest element."""
    return pytest.approx(expected, rel=0, abs=allowed * np.max(np.abs(expected)))


# --- published numbers of problem R1 ---

R1 = [
    # wedge angle deg, height m, stiffness N/m, mean N, RMS N
    (25.0, 0.25, 5e4, 531.047098354, 145.439117595),
    (25.0, 0.25, 6e3, 525.384371406, 209.467549465),
    (25.0, 0.25, 4e5, 530.442387539, 113.154184492),
    (10.0, 0.40, 1e4, 530.957907066, 921.978274273),
    (40.0, 0.15, 5e3, 405.636319546, 107.584572626),
]


@pytest.mark.parametrize(("angle", "height", "stiffness", "mean", "rms"), R1)
def test_reference_values_to_every_digit(r1_scene, angle, height, stiffness, mean, rms):
    scene = r1_scene(angle, height, stiffness, strength_wave=WAVE)
    for accuracy in (FINE, po.Accuracy(error=1e-12)):
        run = po.simulate(scene, 2.0, accuracy=accuracy)
        # Half a unit of the last published digit, and rounding.
        assert run.mean_draft == pytest.approx(mean, rel=0, abs=0.51e-9)
        assert run.force_rms == pytest.approx(rms, rel=0, abs=0.51e-9)


# --- exact solutions ---


def sum_of_exponentials(amplitudes, exponents, duration):
    """Return mean and RMS of the real part of sum a exp(lambda t) over the duration, in closed form."""

    def average(exponent):
        return np.expm1(exponent * duration) / (exponent * duration) if abs(exponent) > 0 else 1.0

    terms = list(zip(amplitudes, exponents, strict=True))
    mean = sum((a * average(x)).real for a, x in terms)
    square = sum(
        (a * b * average(x + y) + a * np.conj(b) * average(x + np.conj(y))).real / 2 for a, x in terms for b, y in terms
    )
    return mean, math.sqrt(square - mean**2)


@pytest.mark.parametrize("damping", [None, 0.0, 250.0, 900.0])
def test_linear_oscillation_from_rest(r1_scene, damping):
    scene = r1_scene(inertial_drag=False, start="rest", damping=damping)
    duration = 1.0
    run = po.simulate(scene, duration, accuracy=FINE, outputs=50)
    # z = z_s + exp(-d t) (-z_s cos(w t) + (V0 - d z_s)/w sin(w t)), as the real part of a exp(x t).
    k, c, z_s = scene.stiffness, damping or 0.0, scene.reaction.static / scene.stiffness
    d = c / (2 * scene.inertia)
    w = math.sqrt(k / scene.inertia - d**2)
    a, x = -z_s - 1j * (scene.tow_speed - d * z_s) / w, -d + 1j * w
    wave = np.exp(x * run.time)
    rate = (a * x * wave).real
    mean_z, rms_z = sum_of_exponentials([a], [x], duration)
    mean_p, rms_p = sum_of_exponentials([a * (k + c * x)], [x], duration)
    # 3200 steps of order 8 over seven oscillations leave rounding only.
    assert run.deflection == close_to(z_s + (a * wave).real, 1e-12)
    assert run.speed == close_to(scene.tow_speed - rate, 1e-12)
    assert run.travel == close_to(scene.tow_speed * run.time - z_s - (a * wave).real, 1e-12)
    assert run.mount_force == close_to(k * (z_s + (a * wave).real) + c * rate, 1e-12)
    assert run.mean_deflection == pytest.approx(z_s + mean_z, rel=1e-12)
    assert run.displacement_rms == pytest.approx(rms_z, rel=1e-12)
    assert run.mean_draft == pytest.approx(scene.reaction.static + mean_p, rel=1e-12)
    assert run.force_rms == pytest.approx(rms_p, rel=1e-12)
    assert run.tow_power == pytest.approx(run.mean_draft * scene.tow_speed, rel=1e-12)


@pytest.mark.parametrize("accuracy", [None, FINE, po.Accuracy("cvodes"), po.Accuracy("rosenbrock")])
@pytest.mark.parametrize("effects", [{}, {"rate_term": 0.05}, {"damping": 250.0}, {"inertial_drag": False}])
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
    reaction, k, inertia, v = scene.reaction, scene.stiffness, scene.inertia, scene.tow_speed
    c, omega = 2 * reaction.drag * v, 2 * math.pi * v / 0.6
    z_s = scene.steady_resistance / k
    forced = -1j * amplitude * reaction.static * np.exp(-2j * math.pi * z_s / 0.6)
    forced /= k - inertia * omega**2 + 1j * c * omega
    d = c / (2 * inertia)
    own = math.sqrt(k / inertia - d**2)
    w0, rate0 = -forced.real, -(forced * 1j * omega).real
    free = w0 - 1j * (rate0 + d * w0) / own
    mean, rms = sum_of_exponentials([forced, free], [1j * omega, -d + 1j * own], duration)
    # The next order in the amplitude is 1e-9 of this one; force_rms is 1e-10 of the mean draft.
    assert run.force_rms < 1e-9 * run.mean_draft
    assert run.force_rms == pytest.approx(k * rms, rel=1e-8)
    assert run.displacement_rms == pytest.approx(rms, rel=1e-8)
    assert run.mean_draft - scene.steady_resistance == pytest.approx(k * mean, abs=1e-15 * run.mean_draft)


# --- numbers and symbols ---

# Factors on the numbers of the scene below.
NAMES = ("angle", "height", "stiffness", "speed", "rate", "damping", "amplitude", "wavelength", "ramp", "duration")
FACTORS = np.array([1.1, 0.9, 1.2, 0.95, 1.05, 0.9, 1.15, 1.1, 0.8, 1.2])


def varied(r1_scene, factors, **effects):
    x = dict(zip(NAMES, factors, strict=True))
    strong = {
        "rate_term": 0.05 * x["rate"],
        "damping": 250.0 * x["damping"],
        "strength_wave": po.StrengthWave(0.3 * x["amplitude"], 0.6 * x["wavelength"]),
        "tow_ramp": 0.15 * x["ramp"],
        "start": "rest",
    }
    share = 25.0 * x["angle"], 0.25 * x["height"], 5e4 * x["stiffness"]
    scene = r1_scene(*share, tow_speed=2.0 * x["speed"], **(strong | effects))
    return po.simulate(scene, 0.5 * x["duration"], accuracy=po.Accuracy("dop853", steps=400), outputs=10)


@pytest.mark.parametrize("effects", [{}, {"tow_ramp": None}], ids=["ramp", "no ramp"])
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_numbers_and_symbols_run_alike(r1_scene, kind, effects):
    x = kind.sym("x", len(NAMES))
    symbolic, numeric = (varied(r1_scene, factors, **effects) for factors in (ca.vertsplit(x), FACTORS.tolist()))
    names = (*ARRAYS, *AVERAGES, "specific_draft")
    found = ca.Function("run", [x], [getattr(symbolic, name) for name in names]).call([ca.DM(FACTORS)])
    for name, value in zip(names, found, strict=True):
        expected = getattr(numeric, name)
        # The same operations in another order. With SX no step ends at the symbolic end of a ramp, so the method has
        # order 3 there, with steps of a millisecond.
        allowed = 1e-8 if kind is ca.SX and not effects else 5e-12
        assert value.full().ravel() == pytest.approx(expected, rel=0, abs=allowed * np.max(np.abs(expected))), name


def test_constant_expressions_are_numbers(r1_scene):
    plain = po.simulate(r1_scene(stiffness=5e4, strength_wave=WAVE), 1.0)
    wrapped = po.simulate(r1_scene(stiffness=ca.MX(5e4), strength_wave=WAVE), ca.DM(1.0))
    assert wrapped.mean_draft == plain.mean_draft
    assert wrapped.error_estimate == plain.error_estimate
    assert isinstance(wrapped.mount_force, np.ndarray)


def test_a_symbolic_run_refuses_what_it_lacks(r1_scene):
    run = po.simulate(r1_scene(stiffness=ca.MX.sym("stiffness"), strength_wave=WAVE), 1.0, outputs=5)
    for name, what in (("error_estimate", "error estimate"), ("seconds", "computing time")):
        with pytest.raises(po.InputError, match=f"no {what}: simulate the scene with numbers"):
            getattr(run, name)
    for name, array in (("peak_force", "mount_force"), ("peak_deflection", "deflection")):
        with pytest.raises(po.InputError, match=f"no {name}.*limit run.{array}"):
            getattr(run, name)
    assert "cannot be checked" in run.warnings[0]


# --- outputs ---


def test_outputs_and_what_follows_from_them(r1_scene):
    run = po.simulate(r1_scene(strength_wave=WAVE), 2.0, outputs=25)
    assert {getattr(run, name).shape for name in ARRAYS} == {(26,)}
    assert list(run.time) == pytest.approx(np.linspace(0.0, 2.0, 26), rel=1e-15)
    assert (run.peak_force, run.peak_deflection) == (max(run.mount_force), max(run.deflection))
    radius = po.loosened_radius(run.scene.cone, run.scene.soil)
    assert run.specific_draft == pytest.approx(run.mean_draft / (math.pi * radius**2), rel=1e-15)


def test_averages_do_not_depend_on_the_outputs(r1_scene):
    scene = r1_scene(strength_wave=WAVE, damping=250.0)
    few, many = (po.simulate(scene, 1.0, accuracy=FINE, outputs=outputs) for outputs in (1, 400))
    assert len(few.time) == 2
    for name in AVERAGES:
        assert getattr(few, name) == pytest.approx(getattr(many, name), rel=1e-12), name
    assert few.mount_force[-1] == pytest.approx(many.mount_force[-1], rel=1e-11)


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


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf])
def test_a_duration_must_be_positive(r1_scene, duration):
    with pytest.raises(po.DomainError, match="duration = "):
        po.simulate(r1_scene(), duration)


def test_a_run_prints_in_one_line(r1_scene):
    run = po.simulate(r1_scene(strength_wave=WAVE), 2.0)
    # Mean and RMS of the first case of R1.
    text = "<Run: 2 s in 400 intervals by dop853, mean draft 531.047 N, RMS 145.439 N, error estimate "
    assert repr(run).startswith(text)
    assert float(repr(run)[len(text) : -1]) == pytest.approx(run.error_estimate, rel=0.05)
