"""Resonance at zero damping over thousands of periods: amplitude and phase against the exact solution and theory."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import SHARP, scene_of
from scipy.integrate import DOP853

import plough_opt as po

STIFFNESS, WAVELENGTH = 5e4, 0.6
# Deflections are rounded to 1e-16 of the static one, and the growth is 3e-8 of it.
ROUNDING = 3e-9


def resonance(soil, growth, periods):
    """Return a scene whose wave passes at its natural frequency and makes the force grow by a part of F0."""
    wave = po.StrengthWave(growth / (math.pi * periods), WAVELENGTH)
    scene = scene_of(soil, SHARP, STIFFNESS, 24.0, 1.0, inertial_drag=False, strength_wave=wave)
    omega = scene.natural_frequency
    return replace(scene, tow_speed=omega * WAVELENGTH / (2.0 * math.pi)), periods * 2.0 * math.pi / omega


def exact(scene, t):
    """Return the deflection's growth to first order in the wave: the next order is some growth F0/(k0 ell) of it.

    M w'' + k w = a sin(W t - d) with W the natural frequency, at rest at first:
    w = a/(2 W M) [sin(W t) cos(d)/W - t cos(W t - d)].
    """
    omega, static = scene.natural_frequency, scene.reaction.static
    d = 2.0 * math.pi * static / STIFFNESS / WAVELENGTH
    a = scene.effects.strength_wave.amplitude * static / scene.inertia
    return a / (2.0 * omega) * (math.cos(d) * np.sin(omega * t) / omega - t * np.cos(omega * t - d))


def amplitude_and_phase(t, values, omega):
    """Return what fits best as t times an oscillation, over the last tenth of the time: its complex factor."""
    late = t > 0.9 * t[-1]
    basis = np.column_stack([t[late] * np.cos(omega * t[late]), t[late] * np.sin(omega * t[late])])
    return complex(*np.linalg.lstsq(basis, values[late], rcond=None)[0])


def errors_of(scene, run):
    """Return the relative error of the amplitude and the error of the phase [rad]."""
    found, truth = (
        amplitude_and_phase(run.time, values, scene.natural_frequency)
        for values in (run.deflection - scene.reaction.static / STIFFNESS, exact(scene, run.time))
    )
    return abs(found) / abs(truth) - 1.0, cmath.phase(found / truth)


def predicted(steps, periods):
    """Return the same errors of an oscillator by the method's stability function R(i h), w of a step = R(i h) w."""
    n = len(DOP853.B)
    h = 2.0 * math.pi / steps
    inverse = np.linalg.solve(np.eye(n) - 1j * h * DOP853.A[:n, :n], np.ones(n))
    own = cmath.log(1.0 + 1j * h * (DOP853.B @ inverse)) - 1j * h
    # What grows like t has been excited half the time ago on average. The fit weighs t^2, over the last tenth.
    t = np.linspace(0.9, 1.0, 1001)
    error = own * steps * periods * np.sum(t**3) / np.sum(t**2) / 2.0
    # A frequency too low is a phase that lags.
    return error.real, -error.imag


CASES = [(10, 64), (300, 64), (1000, 12), (1000, 16), (1000, 24), (1000, 32)]
SLOW = [pytest.param(10_000, steps, marks=pytest.mark.slow) for steps in (12, 16, 24, 32)]


@pytest.mark.parametrize(("periods", "steps"), [*CASES, *SLOW])
def test_resonance_without_damping_by_fixed_steps(r1_soil, periods, steps):
    scene, duration = resonance(r1_soil, 1e-7, periods)
    run = po.simulate(scene, duration, accuracy=po.Accuracy("dop853", steps=steps * periods), outputs=4 * periods)
    assert run.accuracy.steps == steps * periods
    # The method's own error, 2e-7 of the amplitude and 1.2e-6 rad after a thousand periods of 12 steps, grows with the
    # time and falls by 2^9 and 2^8 where the steps double. To 1 per cent: the method errs in how it forces the
    # oscillator too, but that does not grow.
    amplitude, phase = predicted(steps, periods)
    assert errors_of(scene, run) == (
        pytest.approx(amplitude, rel=0.01, abs=ROUNDING),
        pytest.approx(phase, rel=0.01, abs=ROUNDING),
    )
    # And at every output, not in the fit alone: both errors are largest at the end.
    found, truth = run.deflection - scene.reaction.static / STIFFNESS, exact(scene, run.time)
    allowed = 2.0 * math.hypot(amplitude, phase) + 10.0 * ROUNDING
    assert np.max(np.abs(found - truth)) < allowed * np.max(np.abs(truth))


@pytest.mark.parametrize("periods", [100, 1000])
def test_resonance_without_damping_by_the_default(r1_soil, periods):
    # The default promises 1e-8 of the mean draft. The growth to 1e-4 of it leaves 2e-10 to the next order.
    scene, duration = resonance(r1_soil, 1e-4, periods)
    run = po.simulate(scene, duration, outputs=8 * periods)
    truth = STIFFNESS * exact(scene, run.time)
    assert np.max(np.abs(truth)) == pytest.approx(1e-4 * scene.reaction.static, rel=0.02)
    assert run.error_estimate <= 1e-8
    assert np.max(np.abs(run.mount_force - scene.reaction.static - truth)) < 1e-8 * scene.reaction.static
    amplitude, phase = errors_of(scene, run)
    assert math.hypot(amplitude, phase) < 1e-4


@pytest.mark.slow
def test_resonance_over_ten_thousand_periods_by_the_default_is_right_or_warned_of(r1_soil):
    scene, duration = resonance(r1_soil, 1e-4, 10_000)
    run = po.simulate(scene, duration, outputs=40_000)
    error = np.max(np.abs(run.mount_force - scene.reaction.static - STIFFNESS * exact(scene, run.time)))
    assert error < (5.0 * run.error_estimate + 1e-9) * scene.reaction.static
    assert run.error_estimate <= 1e-8 or any("was not reached" in text for text in run.warnings)
