"""The approximations of the periodic orbit: linear response and harmonic balance, against formula and orbit."""

import functools
import itertools
import math

import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.checks import difference

CASES = {
    "damped": {"damping": 400.0},
    "undamped": {},
    "soft": {"stiffness": 6e3, "damping": 150.0},
    "resonant": {"stiffness": 1.2e4, "damping": 300.0},
    "rate term": {"rate_term": 0.05, "damping": 100.0},
    "conservative": {"inertial_drag": False},
    "slow": {"tow_speed": 0.5, "damping": 300.0},
    "stiff": {"stiffness": 1e6, "damping": 1e3},
    "stiffest": {"stiffness": 1e9, "damping": 1e4},
}
SLOW = [pytest.param(name, marks=pytest.mark.slow if name == "stiffest" else ()) for name in CASES]


@pytest.fixture(scope="module")
def simulated(r1_scene):
    """Simulate the periodic motion of a case, each kind of orbit once."""

    @functools.cache
    def simulated(name, choice, amplitude=0.3, outputs=48):
        scene = r1_scene(strength_wave=po.StrengthWave(amplitude, 0.6), orbit=choice, **CASES[name])
        return po.simulate(scene, outputs=outputs, accuracy=po.Accuracy(error=1e-11))

    return simulated


@pytest.mark.parametrize("amplitude", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("name", SLOW)
def test_linear_response_is_that_of_the_textbook(simulated, name, amplitude):
    run = simulated(name, "linearised", amplitude)
    scene, effects, reaction = run.scene, run.scene.effects, run.scene.reaction
    v, kappa, damping = scene.tow_speed, effects.rate_term or 0.0, effects.damping or 0.0
    # F(L, L') to first order in w about L = V0 t - z_s, L' = V0: forced by the wave, damped by dF/dL'.
    omega = 2 * math.pi * v / 0.6
    steady = reaction.static * (1 + kappa * v**2) + reaction.drag * v**2
    friction = damping + 2 * v * (reaction.drag + kappa * reaction.static)
    push = amplitude * reaction.static * (1 + kappa * v**2)
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
@pytest.mark.parametrize("name", [name for name in CASES if name not in ("slow", "stiffest")])
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
@pytest.mark.parametrize("name", [name for name in CASES if name != "stiffest"])
def test_error_estimate_is_the_difference_from_the_orbit(simulated, name, choice):
    run, exact = simulated(name, choice), simulated(name, "periodic")
    assert run.error_estimate == pytest.approx(difference(run, exact), rel=1e-6, abs=1e-12)
    assert run.error_estimate > 0.0
