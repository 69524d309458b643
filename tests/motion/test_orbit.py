"""The periodic orbit under a strength wave against SciPy's integration, and its approximations against formulas."""

import functools
import itertools
import math

import numpy as np
import pytest
from helpers.orbit_oracle import monodromy, orbit
from helpers.scenes import Shank, Waves

import plough_opt as po
from plough_opt.motion.checks import difference

OUTPUTS = 96
ORBITS = ["periodic", "linearised", po.HarmonicBalance(2)]
WAVE = po.StrengthWave(0.3, 0.6)
FULL = po.StrengthWave(1.0, 0.6)
CASES = {
    "undamped with drag": {},
    "damped": {"damping": 400.0},
    "soft": {"stiffness": 2e3},
    "stiff": {"stiffness": 1e7},
    "resonant": {"stiffness": 1.2e4},
    "resonant and damped": {"stiffness": 1.2e4, "damping": 250.0},
    "rate term": {"rate_term": 0.05, "damping": 100.0},
    "speed term": {"speed_term": 0.2, "damping": 100.0},
    "conservative": {"inertial_drag": False},
    "slow": {"tow_speed": 0.5, "damping": 300.0},
    "strongest": {"strength_wave": FULL},
    "strongest, soft": {"strength_wave": FULL, "stiffness": 4e3, "damping": 100.0},
    "strongest, short": {"strength_wave": po.StrengthWave(1.0, 0.2), "stiffness": 1e5, "damping": 400.0},
    "weak": {"strength_wave": po.StrengthWave(1e-5, 0.6), "damping": 100.0},
    "retreating": {"height": 0.5, "stiffness": 3e4, "strength_wave": FULL},
    "light": {"added_mass": False, "ambient_pressure": False, "damping": 50.0},
}
STIFFEST = {"stiffest": {"stiffness": 1e9}, "stiffest and damped": {"stiffness": 1e9, "damping": 2e4}}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in STIFFEST]


@pytest.fixture(scope="module")
def scene_of(r1_scene):
    def build(name, **changes):
        own = {"strength_wave": WAVE, "orbit": "periodic"} | (CASES | STIFFEST)[name] | changes
        return r1_scene(**own)

    return build


@pytest.mark.parametrize("name", [*CASES, *SLOW])
def test_orbit_and_multipliers_are_those_that_scipy_finds_by_shooting(scene_of, name):
    run = po.simulate(scene_of(name), accuracy=po.Accuracy(error=1e-11), outputs=OUTPUTS)
    true = orbit(run.scene, (run.deflection[0], run.scene.tow_speed - run.speed[0]), OUTPUTS)
    assert run.error_estimate <= 1e-8
    # SciPy's relative tolerance of 1e-12 and the root of the shooting leave about 3e-11.
    size = np.ptp(true.deflection)
    assert run.deflection == pytest.approx(true.deflection, rel=0, abs=2e-10 * size + 1e-14 * np.max(true.deflection))
    assert run.mount_force == pytest.approx(true.force, rel=0, abs=2e-10 * np.max(true.force))
    # The speed of the share is rounded to 1e-16 of itself.
    rate, allowed = run.scene.tow_speed - run.speed, 1e-9 * np.max(np.abs(true.rate)) + 2e-15
    assert rate == pytest.approx(true.rate, rel=0, abs=allowed)
    # Compare sum and product, which are smooth where two multipliers meet; the multipliers themselves are not.
    phase = run.scene.natural_frequency * run.duration
    expected = [1.0, -np.trace(true.monodromy), np.linalg.det(true.monodromy)]
    allowed = 1e-9 * max(1.0, np.max(np.abs(expected)), phase)
    assert np.poly(np.array(run.floquet)).real == pytest.approx(expected, rel=0, abs=allowed)


@pytest.mark.parametrize(("damping", "unstable"), [(35.2, True), (35.3, False)])
def test_an_unstable_orbit_carries_a_warning(scene_of, damping, unstable):
    # Between these two the largest multiplier passes through 1, from which it differs by 4e-4 at both.
    run = po.simulate(scene_of("soft", damping=damping), outputs=1)
    first = np.array([run.deflection[0], run.scene.tow_speed - run.speed[0]])
    excess = max(abs(np.linalg.eigvals(monodromy(run.scene, first)))) - 1.0
    assert max(map(abs, run.floquet)) - 1.0 == pytest.approx(excess, abs=1e-9)
    assert (1e-4 < excess < 1e-3) if unstable else (-1e-3 < excess < -1e-4)
    warnings = [text for text in run.warnings if "the orbit is unstable" in text]
    assert len(warnings) == unstable
    assert all(f"grows {1.0 + excess:.4g} times in every wavelength" in text for text in warnings)


@pytest.mark.parametrize("choice", ORBITS, ids=str)
@pytest.mark.parametrize("effects", [{}, {"damping": 100.0, "rate_term": 0.05}, {"inertial_drag": False}])
def test_without_amplitude_the_share_slides_steadily(r1_scene, choice, effects):
    scene = r1_scene(strength_wave=po.StrengthWave(0.0, 0.6), orbit=choice, **effects)
    run = po.simulate(scene, outputs=8)
    assert run.mean_draft == pytest.approx(scene.steady_resistance, rel=1e-15)
    assert run.force_rms == run.displacement_rms == run.error_estimate == 0.0
    assert run.deflection == pytest.approx(np.full(9, scene.steady_resistance / scene.stiffness), rel=1e-15)
    assert run.speed == pytest.approx(np.full(9, 2.0), rel=1e-15)


def close(run, exact, within):
    """Return whether averages and mount force of two orbits differ by at most a part of the RMS."""
    size = within * exact.force_rms
    averages = abs(run.mean_draft - exact.mean_draft), abs(run.force_rms - exact.force_rms)
    return max(*averages, abs(run.mount_force - exact.mount_force).max()) <= size


@pytest.mark.parametrize(
    "own",
    [(Shank(0.0, 800.0),), (Waves(0.3, -0.2),), (Shank(0.0, 300.0, 80.0), Waves(-0.1, 0.4))],
    ids=["damper", "waves", "drag and waves"],
)
def test_the_linear_response_to_a_slight_wave_is_the_orbit(r1_scene, own):
    slight = po.StrengthWave(1e-4, 0.2)
    exact, linear = (
        po.simulate(r1_scene(strength_wave=slight, own=own, orbit=orbit)) for orbit in ("periodic", "linearised")
    )
    # The neglected terms are of second order in the deviation, about 1e-4 of the forces here.
    assert close(linear, exact, 1e-3)


def test_an_own_wave_is_as_good_as_the_soils(r1_scene):
    own = (Waves(0.2 * float(r1_scene().reaction.static)),)
    parts, whole = (
        po.simulate(r1_scene(strength_wave=po.StrengthWave(amplitude, 0.2), own=waves, orbit="linearised"))
        for amplitude, waves in ((0.1, own), (0.3, ()))
    )
    # Exact except for rounding of the coefficients from 16 samples.
    assert close(parts, whole, 1e-12)


APPROXIMATED = {
    "damped": {"damping": 400.0},
    "undamped": {},
    "soft": {"stiffness": 6e3, "damping": 150.0},
    "resonant": {"stiffness": 1.2e4, "damping": 300.0},
    "rate term": {"rate_term": 0.05, "damping": 100.0},
    "speed term": {"speed_term": 0.2, "damping": 100.0},
    "conservative": {"inertial_drag": False},
    "slow": {"tow_speed": 0.5, "damping": 300.0},
    "stiff": {"stiffness": 1e6, "damping": 1e3},
    "stiffest": {"stiffness": 1e9, "damping": 1e4},
}
NOT_THE_STIFFEST = [pytest.param(name, marks=pytest.mark.slow if name == "stiffest" else ()) for name in APPROXIMATED]


@pytest.fixture(scope="module")
def simulated(r1_scene):
    """Simulate the periodic motion of a case, each kind of orbit once."""

    @functools.cache
    def simulated(name, choice, amplitude=0.3, outputs=48):
        scene = r1_scene(strength_wave=po.StrengthWave(amplitude, 0.6), orbit=choice, **APPROXIMATED[name])
        return po.simulate(scene, outputs=outputs, accuracy=po.Accuracy(error=1e-11))

    return simulated


@pytest.mark.parametrize("amplitude", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("name", NOT_THE_STIFFEST)
def test_linear_response_is_that_of_the_textbook(simulated, name, amplitude):
    run = simulated(name, "linearised", amplitude)
    scene, effects, reaction = run.scene, run.scene.effects, run.scene.reaction
    v, damping = scene.tow_speed, effects.damping or 0.0
    linear, kappa = effects.speed_term or 0.0, effects.rate_term or 0.0  # no case has both
    # F(L, L') to first order in w about L = V0 t - z_s, L' = V0: forced by the wave, damped by dF/dL'.
    omega = 2 * math.pi * v / 0.6
    steady = reaction.static * (1 + linear * v + kappa * v**2) + reaction.drag * v**2
    friction = damping + linear * reaction.static + 2 * v * (reaction.drag + kappa * reaction.static)
    push = amplitude * reaction.static * (1 + linear * v + kappa * v**2)
    phasor = push / (scene.stiffness - scene.inertia * omega**2 + 1j * omega * friction)
    phasor *= np.exp(-2j * math.pi / 0.6 * steady / scene.stiffness)
    turning = phasor * np.exp(1j * omega * np.asarray(run.time))
    force = phasor * (scene.stiffness + 1j * omega * damping)
    # Near resonance the spring's force and the inertia's cancel to a few digits less.
    size = abs(phasor)
    assert run.deflection == pytest.approx(steady / scene.stiffness + turning.imag, rel=1e-13, abs=1e-11 * size)
    assert run.speed == pytest.approx(v - (1j * omega * turning).imag, rel=1e-13, abs=1e-11 * omega * size)
    assert run.mean_draft == pytest.approx(steady, rel=1e-14)
    assert run.mean_deflection == pytest.approx(steady / scene.stiffness, rel=1e-14)
    assert run.displacement_rms == pytest.approx(abs(phasor) / math.sqrt(2), rel=1e-11)
    assert run.force_rms == pytest.approx(abs(force) / math.sqrt(2), rel=1e-11)
    assert run.tow_power == pytest.approx(steady * v, rel=1e-14)


@pytest.mark.parametrize("amplitude", [0.3, 1.0])
@pytest.mark.parametrize("name", [name for name in APPROXIMATED if name not in ("slow", "stiffest")])
def test_harmonics_converge_exponentially_to_the_orbit(simulated, name, amplitude):
    # In all results, averages included: see the estimate below.
    errors = [simulated(name, po.HarmonicBalance(n), amplitude).error_estimate for n in (1, 3, 5, 7, 16)]
    # Two more harmonics leave a tenth or less, until the error of the orbit itself remains.
    for before, after in itertools.pairwise(errors):
        assert after < max(0.12 * before, 3e-10)
    assert errors[-1] < 3e-10


@pytest.mark.parametrize("choice", [po.HarmonicBalance(1), po.HarmonicBalance(4)])
@pytest.mark.parametrize("name", ["damped", "undamped", "soft"])
def test_no_balanced_harmonic_of_the_force_is_left_over(simulated, name, choice):
    run = simulated(name, choice, 0.8, 240)
    scene, reaction, damping = run.scene, run.scene.reaction, run.scene.effects.damping or 0.0
    z = np.asarray(run.deflection)[:-1]
    omega, turns = 2 * np.pi / run.duration, np.fft.rfftfreq(240, 1 / 240)
    rate, bend = (np.fft.irfft((1j * omega * turns) ** k * np.fft.rfft(z), 240) for k in (1, 2))
    speed, travel = scene.tow_speed - rate, scene.tow_speed * np.asarray(run.time)[:-1] - z
    soil = reaction.static * (1 + 0.8 * np.sin(2 * np.pi * travel / 0.6)) + reaction.drag * speed**2
    left = np.abs(np.fft.rfft(scene.inertia * bend + scene.stiffness * z + damping * rate - soil)) / 240
    # The projection uses 4 n + 12 samples, so that only harmonics of the force beyond them remain.
    assert np.max(left[: choice.harmonics + 1]) < 1e-9 * reaction.static
    assert np.max(left[choice.harmonics + 1 :]) > 1e-6 * reaction.static
    # The mean of a few harmonics over equal intervals is exact.
    assert run.mean_draft == pytest.approx(np.mean(run.mount_force[:-1]), rel=1e-13)
    assert run.force_rms == pytest.approx(np.std(run.mount_force[:-1]), rel=1e-12)
    assert run.displacement_rms == pytest.approx(np.std(z), rel=1e-12)


@pytest.mark.parametrize("choice", ["linearised", po.HarmonicBalance(1), po.HarmonicBalance(3)])
@pytest.mark.parametrize("name", [name for name in APPROXIMATED if name != "stiffest"])
def test_error_estimate_is_the_difference_from_the_orbit(simulated, name, choice):
    run, exact = simulated(name, choice), simulated(name, "periodic")
    assert run.error_estimate == pytest.approx(difference(run, exact), rel=1e-6, abs=1e-12)
    assert run.error_estimate > 0.0
