"""Stops between outputs: speeds that are known between them, and what a stop that was passed over may change."""

import dataclasses

import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.estimate import unseen

SHARE = po.Wedge(po.deg(30), po.deg(15), 0.25)
RATE, TIME, FASTEST = 10.0, 1.0, 2.0


def swinging(lowest, outputs, breakaway=1.0, soil=1.0):
    """Return a run of given arrays: a share that swings between the lowest speed and twice its own, and slips on.

    Its speed is lowest 0.03 intervals off an output.
    """
    effects = po.Effects(start="rest", contact=po.StickSlip(breakaway))
    scene = po.Scene(po.named_soil("serozem"), SHARE, 4500.0, 45.0, 1.0, effects)
    # A run to be altered.
    run = po.simulate(scene, TIME, outputs=outputs)
    swing = (FASTEST - lowest) / 2.0
    since = RATE * (run.time - 0.5 - 0.03 / outputs)
    speed, acceleration = lowest + swing * (1.0 - np.cos(since)), RATE * swing * np.sin(since)
    resistance = np.full(outputs + 1, soil)
    return dataclasses.replace(
        run,
        speed=speed,
        soil_resistance=resistance,
        mount_force=resistance + scene.mass * acceleration,
        mode=np.zeros(outputs + 1),
    )


@pytest.mark.parametrize("outputs", [50, 200, 400])
def test_a_share_that_keeps_some_speed_has_not_stopped(outputs):
    # The polynomial errs by less than 1e-5 (10/50)^8 = 3e-11 of the largest speed.
    assert unseen(swinging(1e-9 * FASTEST, outputs), RATE, 0.0) == 0.0


def test_behind_a_gap_no_soil_resists():
    below, soil = 1e-6, 0.5
    run = swinging(-below, 200, soil=soil)
    # Below zero for 2 sqrt(2 v / V omega^2), with the swing's amplitude of half the largest speed.
    lasts = 2.0 * np.sqrt(2.0 * below / (FASTEST / 2.0 * RATE**2))
    expected = (below + soil * lasts / run.scene.mass) / FASTEST
    assert unseen(run, RATE, 0.0) == pytest.approx(expected, rel=1e-3)
    # The same within the error of its speeds.
    assert unseen(swinging(0.0, 200, soil=soil), RATE, below / FASTEST) == pytest.approx(expected, rel=1e-3)


def test_a_share_that_is_held_slips_on_at_once_unless_it_must_break_loose():
    below, soil = 1e-6, 1e4
    assert unseen(swinging(-below, 200, soil=soil), RATE, 0.0) == pytest.approx(below / FASTEST, rel=1e-3)
    run = swinging(-below, 200, breakaway=1.5, soil=soil)
    hardness = np.sqrt(run.scene.stiffness * run.scene.inertia)
    assert unseen(run, RATE, 0.0) == pytest.approx(0.5 * soil / hardness / FASTEST, rel=1e-3)


def test_other_laws_know_no_stop():
    run = swinging(-1e-6, 200)
    scene = dataclasses.replace(run.scene, effects=po.Effects(start="rest"))
    assert unseen(dataclasses.replace(run, scene=scene), RATE, 0.0) == 0.0
