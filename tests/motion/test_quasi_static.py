"""The quasi-static limit against adaptive quadrature."""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad

import plough_opt as po


@pytest.mark.parametrize(
    ("ramp", "wavelength", "duration"),
    [(None, 0.02, 0.5), (None, 50.0, 0.07), (0.3, 0.6, 1.0), (0.371234, 0.6, 1.0), (1.0, 0.6, 1.0), (2.5, 0.6, 1.0)],
)
@pytest.mark.parametrize("rate_term", [None, 0.05])
def test_runs_are_those_of_adaptive_quadrature(r1_scene, ramp, wavelength, duration, rate_term):
    scene = r1_scene(motion=False, strength_wave=po.StrengthWave(0.3, wavelength), tow_ramp=ramp, rate_term=rate_term)
    run = po.simulate(scene, duration)
    smoothstep = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    path = smoothstep.integ()
    v, reaction = scene.tow_speed, scene.reaction

    def speed(t):
        return v * smoothstep(min(t / ramp, 1.0)) if ramp else v

    def travel(t):
        return v * (ramp * path(min(t / ramp, 1.0)) + max(t - ramp, 0.0)) if ramp else v * t

    def force(t):
        static = reaction.static * (1 + (rate_term or 0.0) * speed(t) ** 2)
        return static * (1 + 0.3 * math.sin(2 * math.pi * travel(t) / wavelength)) + reaction.drag * speed(t) ** 2

    def average(function):
        # Ends of waves at full speed, and of the ramp.
        points = (
            np.arange(wavelength / v, duration, wavelength / v) if not ramp else [ramp] if ramp < duration else None
        )
        return quad(function, 0.0, duration, points=points, epsrel=1e-13, epsabs=0.0, limit=400)[0] / duration

    mean = average(force)
    rms = math.sqrt(average(lambda t: (force(t) - mean) ** 2))
    # Gauss-Legendre of degree 19 on panels of at most half a radian is exact up to rounding.
    assert run.mean_draft == pytest.approx(mean, rel=1e-12)
    assert run.force_rms == pytest.approx(rms, rel=1e-12, abs=1e-13 * mean)
    assert run.tow_power == pytest.approx(average(lambda t: force(t) * speed(t)), rel=1e-12)
    assert run.mount_force == pytest.approx([force(t) for t in run.time], rel=1e-12)
    assert run.speed == pytest.approx([speed(t) for t in run.time], rel=1e-12, abs=1e-15)
    assert run.travel == pytest.approx([travel(t) for t in run.time], rel=1e-12, abs=1e-15)
    assert run.mean_deflection == pytest.approx(run.mean_draft / scene.stiffness, rel=1e-15)
    assert run.displacement_rms == pytest.approx(run.force_rms / scene.stiffness, rel=1e-15)
    assert run.deflection == pytest.approx(run.mount_force / scene.stiffness, rel=1e-15)
    assert list(run.soil_resistance) == list(run.mount_force)
    assert run.error_estimate < 1e-11


def test_smallest_wave_keeps_its_digits(r1_scene):
    # Whole waves: RMS eps F0/sqrt(2). It is 1e-9 of the mean draft.
    run = po.simulate(r1_scene(motion=False, strength_wave=po.StrengthWave(1e-9, 0.5)), 2.0)
    assert run.force_rms == pytest.approx(1e-9 * run.scene.reaction.static / math.sqrt(2), rel=1e-8)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_averages_over_three_hundred_waves_do_not_depend_on_the_outputs(r1_scene, kind):
    def averages(height, outputs):
        scene = r1_scene(height=height, motion=False, strength_wave=po.StrengthWave(0.5, 0.013), tow_ramp=0.1)
        run = po.simulate(scene, 2.0, outputs=outputs)
        return [run.mean_draft, run.force_rms]

    x = kind.sym("height")
    found = ca.Function("averages", [x], [*averages(x, 1), *averages(x, 37)])(0.25)
    # Panels of half a radian with 4 Gauss points leave about 1e-12.
    assert [float(part) for part in found] == pytest.approx(averages(0.25, 400) * 2, rel=1e-9)
