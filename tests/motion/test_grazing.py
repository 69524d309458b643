"""Grazing: a share under stick and slip whose speed just touches zero, as from rest without damping at every cycle."""

import math

import numpy as np
import pytest

import plough_opt as po

SHARE = po.Wedge(po.deg(30), po.deg(15), 0.25)


def scene(breakaway=1.0, **effects):
    soil = po.named_soil("serozem")
    law = po.StickSlip(breakaway)
    return po.Scene(soil, SHARE, 5e4, 20.0, 2.0, po.Effects(start="rest", contact=law, **effects))


def grazes(run):
    return [text for text in run.warnings if "all but stops" in text]


def test_it_is_flagged_where_it_happens():
    own = scene(inertial_drag=False)
    run = po.simulate(own, 2.0)
    (text,) = grazes(run)
    # The mount stretches to the static force, then the share swings about the tow speed: L' = V0 (1 - cos(omega t)).
    released = own.reaction.static / (own.stiffness * own.tow_speed)
    period = 2.0 * math.pi / own.natural_frequency
    assert f"t = {released + period:.2g}" in text
    assert "no derivative" in text


def test_the_motion_itself_is_right_over_many_touches():
    own = scene(inertial_drag=False)
    run = po.simulate(own, 3.0)
    released = own.reaction.static / (own.stiffness * own.tow_speed)
    since = np.maximum(run.time - released, 0.0)
    omega = own.natural_frequency
    speed = own.tow_speed * (1.0 - np.cos(omega * since))
    assert (3.0 - released) * omega / (2.0 * math.pi) > 20
    # Where the speed touches zero rounding decides between slip and an instant of stick, which leaves 1e-6 at most.
    np.testing.assert_allclose(run.speed, speed, atol=1e-6 * own.tow_speed)


@pytest.mark.parametrize(
    "changes", [{"damping": 300.0}, {"breakaway": 1.2}, {"breakaway": 2.0, "damping": 50.0}], ids=str
)
def test_a_motion_that_stops_or_keeps_going_is_not_flagged(changes):
    assert not grazes(po.simulate(scene(**changes), 2.0))


def test_other_contact_laws_have_no_grazing():
    resisting = po.Scene(po.named_soil("serozem"), SHARE, 5e4, 20.0, 2.0, po.Effects(start="rest", inertial_drag=False))
    assert not grazes(po.simulate(resisting, 1.0))


def test_a_share_that_begins_to_move_behind_a_ramp_is_not_flagged():
    # At its start the speed is rounding, below zero here.
    soil = po.Soil(
        density=1500, density_ratio=0.6, cohesion=3.0, friction_angle=0.3, tool_friction=0.5, ambient_pressure=0.0
    )
    effects = po.Effects(contact=po.StickSlip(), tow_ramp=0.0068, inertial_drag=False, added_mass=False)
    for speed in np.linspace(0.6, 0.8, 9):
        run = po.simulate(po.Scene(soil, SHARE, 2930.0, 59.2, float(speed), effects), 0.00473)
        assert not grazes(run)
