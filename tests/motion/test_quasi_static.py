"""The quasi-static limit against closed forms and adaptive quadrature."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad

import plough_opt as po

WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.6)
AVERAGES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
ARRAYS = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance")


@pytest.fixture
def quasi_scene(r1_scene):
    def build(*args, **keywords):
        return r1_scene(*args, **keywords, motion=False)

    return build


@pytest.mark.parametrize("duration", [0.07, 2.0])
@pytest.mark.parametrize("wavelength", [0.02, 50.0])
@pytest.mark.parametrize("rate_term", [None, 0.05])
def test_wave_in_closed_form(quasi_scene, duration, wavelength, rate_term):
    scene = quasi_scene(strength_wave=po.StrengthWave(0.3, wavelength), rate_term=rate_term)
    run = po.simulate(scene, duration)
    v, reaction = scene.tow_speed, scene.reaction
    static, drag = reaction.static * (1.0 + (rate_term or 0.0) * v**2), reaction.drag * v**2
    # Mean and mean square of sin(x) for x from 0 to the phase of the whole path.
    phase = 2 * math.pi * v * duration / wavelength
    mean = (1 - math.cos(phase)) / phase
    square = 0.5 - math.sin(2 * phase) / (4 * phase)
    rms = 0.3 * static * math.sqrt(square - mean**2)
    # Gauss-Legendre of degree 19 on panels of at most half a radian is exact up to rounding.
    assert run.mean_draft == pytest.approx(static * (1 + 0.3 * mean) + drag, rel=1e-13)
    assert run.force_rms == pytest.approx(rms, rel=0, abs=1e-13 * run.mean_draft)
    assert run.mean_deflection == pytest.approx(run.mean_draft / scene.stiffness, rel=1e-15)
    assert run.displacement_rms == pytest.approx(run.force_rms / scene.stiffness, rel=1e-15)
    assert run.tow_power == pytest.approx(run.mean_draft * v, rel=1e-13)
    assert run.error_estimate < 1e-13
    sine = np.sin(2 * np.pi * v * run.time / wavelength)
    # A phase of hundreds of radians rounds to 1e-14 of itself.
    assert run.mount_force == pytest.approx(static * (1 + 0.3 * sine) + drag, rel=1e-13)
    assert run.deflection == pytest.approx(run.mount_force / scene.stiffness, rel=1e-15)
    assert list(run.soil_resistance) == list(run.mount_force)
    assert run.travel == pytest.approx(v * run.time, rel=1e-15)
    assert run.speed == pytest.approx(np.full(401, v), rel=1e-15)


@pytest.mark.parametrize(("ramp", "duration"), [(0.3, 1.0), (0.371234, 1.0), (1.0, 1.0), (2.5, 1.0)])
@pytest.mark.parametrize("rate_term", [None, 0.05])
def test_tow_ramp_by_adaptive_quadrature(quasi_scene, ramp, duration, rate_term):
    scene = quasi_scene(strength_wave=WAVE, tow_ramp=ramp, rate_term=rate_term)
    run = po.simulate(scene, duration, outputs=10)
    smoothstep = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    path = smoothstep.integ()
    v, reaction = scene.tow_speed, scene.reaction

    def speed(t):
        return v * smoothstep(min(t / ramp, 1.0))

    def force(t):
        s = v * (ramp * path(min(t / ramp, 1.0)) + max(t - ramp, 0.0))
        static = reaction.static * (1 + (rate_term or 0.0) * speed(t) ** 2)
        return static * (1 + 0.3 * math.sin(2 * math.pi * s / 0.6)) + reaction.drag * speed(t) ** 2

    def average(function):
        points = [ramp] if ramp < duration else None
        return quad(function, 0.0, duration, points=points, epsrel=1e-13, epsabs=0.0, limit=200)[0] / duration

    mean = average(force)
    assert run.mean_draft == pytest.approx(mean, rel=1e-12)
    assert run.force_rms == pytest.approx(math.sqrt(average(lambda t: (force(t) - mean) ** 2)), rel=1e-12)
    assert run.tow_power == pytest.approx(average(lambda t: force(t) * speed(t)), rel=1e-12)
    assert run.mount_force == pytest.approx([force(t) for t in run.time], rel=1e-12)
    assert run.speed == pytest.approx([speed(t) for t in run.time], rel=1e-12, abs=1e-15)


def test_without_a_wave_nothing_varies(quasi_scene):
    run = po.simulate(quasi_scene(), 2.0)
    # The weights of 400 panels sum to one up to rounding.
    assert run.force_rms == pytest.approx(0.0, abs=1e-14 * run.mean_draft)
    assert run.mean_draft == pytest.approx(run.scene.steady_resistance, rel=1e-14)


def test_smallest_wave_keeps_its_digits(quasi_scene):
    # Whole waves: RMS eps F0/sqrt(2). It is 1e-9 of the mean draft.
    run = po.simulate(quasi_scene(strength_wave=po.StrengthWave(1e-9, 0.5)), 2.0)
    assert run.force_rms == pytest.approx(1e-9 * run.scene.reaction.static / math.sqrt(2), rel=1e-8)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("ramp", ["none", "number", "symbol"])
def test_numbers_and_symbols_run_alike(quasi_scene, kind, ramp):
    values = [0.3, 4e4, 1.5, 0.37]

    def run(height, stiffness, speed, ramp_time):
        effects = {"none": {}, "number": {"tow_ramp": 0.37}, "symbol": {"tow_ramp": ramp_time, "rate_term": 0.05}}
        scene = quasi_scene(25.0, height, stiffness, tow_speed=speed, strength_wave=WAVE, **effects[ramp])
        return po.simulate(scene, 2.0)

    x = kind.sym("x", 4)
    symbolic, numeric = run(*ca.vertsplit(x)), run(*values)
    names = (*ARRAYS, *AVERAGES)
    of_x = ca.Function("run", [x], [getattr(symbolic, name) for name in names])
    for name, found in zip(names, of_x.call([ca.DM(values)]), strict=True):
        # Gauss-Legendre of degree 7 on panels of 0.1 rad.
        assert found.full().ravel() == pytest.approx(getattr(numeric, name), rel=1e-11, abs=1e-15), name


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("outputs", [1, 37])
def test_averages_do_not_depend_on_the_outputs(quasi_scene, kind, outputs):
    static = kind.sym("cohesion")
    soil = dataclasses.replace(quasi_scene().soil, cohesion=static)
    scene = quasi_scene(soil=soil, strength_wave=po.StrengthWave(0.5, 0.013), tow_ramp=0.1)
    run = po.simulate(scene, 2.0, outputs=outputs)
    found = ca.Function("averages", [static], [run.mean_draft, run.force_rms])(15e3)
    numbers = po.simulate(quasi_scene(strength_wave=po.StrengthWave(0.5, 0.013), tow_ramp=0.1), 2.0)
    # Three hundred waves: panels of half a radian with 4 Gauss points leave about 1e-12.
    assert [float(x) for x in found] == pytest.approx([numbers.mean_draft, numbers.force_rms], rel=1e-9)
