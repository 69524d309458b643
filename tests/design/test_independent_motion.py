"""The simulator with which tests judge the search: against an adaptive integrator."""

import numpy as np
import pytest
from helpers.equations import forces, half_angle
from helpers.scenes import R1_SOIL
from helpers.three_modes import follow
from independent.motion import AVERAGES, simulate

import plough_opt as po


@pytest.mark.parametrize(("start", "ramp"), [("equilibrium", 0.3), ("rest", 0.0), ("towed", 0.0), ("rest", 0.3)])
def test_runs_agree_with_an_adaptive_integrator(start, ramp):
    random = np.random.default_rng(5)
    angle, height = random.uniform(0.2, 0.9, 2), random.uniform(0.15, 0.4, 2)
    stiffness, damping, speed = 10.0 ** random.uniform(4.0, 6.0, 2), random.uniform(50, 500, 2), random.uniform(1, 3, 2)
    amplitude = np.array([0.4, 0.2])
    values = {"wedge_angle": angle, "chisel_angle": 0.3, "height": height}
    static, drag, added = forces(vars(R1_SOIL) | values, np)
    steel = 7850.0 * np.pi / 3.0 * height**3 * np.tan(half_angle(angle, 0.3, np)) ** 2
    runs = (static, drag, 40.0 + steel + added, stiffness, damping, speed, amplitude, 0.5, ramp)
    with_paths, without = simulate(*runs, start, 0.8, paths=True), simulate(*runs, start, 0.8)
    for k in range(2):
        wave = po.StrengthWave(amplitude[k], 0.5)
        effects = po.Effects(strength_wave=wave, damping=damping[k], tow_ramp=ramp or None, start=start)
        wedge = po.Wedge(angle[k], 0.3, height[k])
        mass = 40.0 + wedge.equivalent_cone().solid_mass(7850.0)
        wanted = follow(po.Scene(R1_SOIL, wedge, stiffness[k], mass, speed[k], effects), 0.8, outputs=40)
        for name in AVERAGES:
            assert with_paths[name][k] == pytest.approx(getattr(wanted, name), rel=1e-8), name
            assert without[name][k] == pytest.approx(getattr(wanted, name), rel=1e-7), name
        # Degree 5 between steps of 0.3 rad: some 1e-8 of the oscillation.
        for name, near in (("deflection", 1e-7), ("mount force", 3e-6)):
            path = getattr(wanted, name.replace(" ", "_"))
            assert with_paths[name][::10, k] == pytest.approx(path, abs=near * np.max(np.abs(path))), name
