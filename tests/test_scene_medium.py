"""Scenes in the elastic medium: the steady contact force, and what it lacks beside the plastic gas."""

import json

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.scenes import SEROZEM, SHARE, scene_of

import plough_opt as po
from plough_opt.soil import elastic


def scene(medium="elastic", **changes):
    return scene_of(**{"medium": medium, "stiffness": 5e5, "motion": False} | changes)


@pytest.mark.parametrize("share", [SHARE, SHARE.equivalent_cone()], ids=["wedge", "cone"])
def test_draft_is_the_contact_force_on_the_equivalent_cone(share):
    force = elastic.cone_force(SHARE.equivalent_cone(), SEROZEM, 2.0)
    run = po.simulate(scene(share=share), duration=1.0)
    assert run.mean_draft == pytest.approx(force, rel=1e-14)
    np.testing.assert_allclose(run.mount_force, force, rtol=1e-14)
    np.testing.assert_allclose(run.deflection, force / 5e5, rtol=1e-14)
    # Rounding of the average of a constant.
    assert run.force_rms <= 1e-14 * force
    assert run.tow_power == pytest.approx(2.0 * force, rel=1e-14)


def test_scene_carries_no_part_of_the_plastic_gas():
    own = scene()
    assert own.inertia == 20.0
    assert own.reaction.drag == own.reaction.added_mass == own.ambient_share == 0.0
    assert any("order of magnitude" in warning for warning in own.warnings())
    assert not any("order of magnitude" in warning for warning in scene("plastic").warnings())
    # The soil presses on the whole cone, so contact is never lost and the force above ambient pressure stays.
    assert scene(ambient_pressure=False).steady_resistance == pytest.approx(own.steady_resistance, rel=1e-14)
    run = po.simulate(own, duration=1.0)
    for loosened in (lambda: run.specific_draft, lambda: own.loosened_radius):
        with pytest.raises(po.InputError, match="no compaction front"):
            loosened()
    assert json.loads(run.to_json())["specific_draft"] is None


@pytest.mark.slow
def test_symbolic_scene_has_the_derivatives_of_its_draft():
    # Second derivatives are tested in tests/elastic.
    def draft(speed, angle):
        run = po.simulate(scene(share=po.Cone(angle, 0.25), tow_speed=speed), duration=1.0, outputs=3)
        return run.mean_draft

    x, at = ca.MX.sym("x", 2), np.array([20.0, 0.2])
    gradient = ca.Function("f", [x], [ca.gradient(draft(*ca.vertsplit(x)), x)])(at).full().ravel()
    slopes = differences(lambda y: draft(*(at * (1.0 + y)).tolist()), np.zeros(2), 1e-3)
    # Rounding over the relative step.
    np.testing.assert_allclose(gradient * at, slopes.ravel(), rtol=1e-10)
