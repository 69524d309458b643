"""Events in the first step of an integrator, and derivatives through the end of entry."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes

import plough_opt as po

SHARE = po.Wedge(po.deg(25), po.deg(15), 0.25)


def soil(density_ratio):
    return po.Soil(1400.0, density_ratio, 15e3, po.deg(30.0), 0.5, 1e4)


@pytest.mark.parametrize("density_ratio", [1e-3, 1e-6, 0.1])
@pytest.mark.parametrize("stiffness", [5e4, 1e7])
def test_a_share_breaks_loose_however_soon(density_ratio, stiffness):
    effects = po.Effects(start="rest", contact=po.StickSlip(), damping=200.0, inertial_drag=False)
    scene = po.Scene(soil(density_ratio), SHARE, stiffness, 20.0, 2.0, effects)
    run = po.simulate(scene, 1.0)
    assert run.mode[-1] == 0.0
    # The swing about steady sliding that follows from standstill at the static force.
    swing = scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia)
    damper = 200.0 * 2.0 * scene.tow_speed
    assert np.max(run.mount_force) < scene.reaction.static + swing + damper
    assert run.mount_force[-1] == pytest.approx(scene.reaction.static, abs=0.05 * (swing + scene.reaction.static))


@pytest.mark.parametrize("contact", ["resisting", po.StickSlip(1.2)], ids=str)
def test_the_end_of_entry_has_its_derivatives(contact):
    def outputs(speed):
        effects = po.Effects(start="towed", entry=True, contact=contact)
        scene = po.Scene(soil(0.8), SHARE, 1e4, 24.0, speed, effects)
        run = po.simulate(scene, 0.5, accuracy=po.Accuracy("erk", tolerance=1e-12), outputs=5)
        return run, [run.mean_draft, run.mount_force[-1], run.travel[-1]]

    speed = ca.MX.sym("speed")
    _, expressions = outputs(speed)
    slopes = ca.Function("slopes", [speed], [ca.jacobian(ca.vertcat(*expressions), speed)])(1.0).full().ravel()
    step = 1e-3
    sixth = np.array([-1, 9, -45, 45, -9, 1]) / (60 * step)
    values = np.array([outputs(1.0 + k * step)[1] for k in (-3, -2, -1, 1, 2, 3)])
    run, _ = outputs(1.0)
    assert np.max(run.travel) > SHARE.height
    # Sixth-order differences of values that are good to 1e-12 of the tolerance.
    np.testing.assert_allclose(slopes, sixth @ values, rtol=1e-8)


def test_a_share_that_barely_moves_yet_has_not_stopped(r1_soil):
    # In the first milliseconds of a ramp the share's speed is the rounding of a difference: no event may come of it.
    soil = dataclasses.replace(r1_soil, cohesion=4e4, ambient_pressure=3e5)
    effects = po.Effects(contact=po.StickSlip(2.5), start="towed", entry=True, tow_ramp=0.07, added_mass=False)
    scene = po.Scene(soil, po.Wedge(po.deg(4.0), po.deg(15.0), 0.05), 260.0, 13.0, 0.2, effects)
    for duration in (0.045, 0.06, 0.3, 2.0):
        run, expected = po.simulate(scene, duration, outputs=10), three_modes.follow(scene, duration, outputs=10)
        assert np.max(np.abs(run.mount_force - expected.mount_force)) < 2e-8 * np.max(np.abs(expected.mount_force))
        assert run.error_estimate < 1e-8
