"""A share that sticks while it enters the soil: against an independent solver, and the mechanics of each stick."""

from functools import cache

import numpy as np
import pytest
from helpers import three_modes
from helpers.scenes import BLUNT, R1_SOIL, SHARP, scene_of
from helpers.three_modes import SLIP, STICK

import plough_opt as po

# share, stiffness [N/m], speed [m/s], duration [s], breakaway, effects; and how often it sticks before it is buried
SCENES = {
    "soft": (SHARP, 5e2, 0.05, 10.0, 1.1, {"start": "rest"}, 9),
    "soft, rarely": (SHARP, 5e2, 0.05, 10.0, 2.0, {"start": "rest"}, 3),
    "blunt": (BLUNT, 2e3, 0.10, 6.0, 1.1, {"start": "rest"}, 11),
    "blunt, wave": (BLUNT, 2e3, 0.20, 4.0, 1.1, {"start": "rest", "strength_wave": po.StrengthWave(0.8, 0.05)}, 5),
    "gaps too": (
        SHARP, 3e3, 0.10, 4.0, 3.0,
        {"start": "rest", "strength_wave": po.StrengthWave(1.0, 0.02), "rate_term": 0.5}, 3,
    ),
    "ramp and damper": (
        SHARP, 1e3, 0.10, 5.0, 2.0,
        {"start": "rest", "strength_wave": po.StrengthWave(0.8, 0.05), "tow_ramp": 1.0, "damping": 20.0}, 2,
    ),
    "towed": (SHARP, 1e3, 0.10, 6.0, 1.1, {"start": "towed", "inertial_drag": False}, 3),
    "on beyond the end of entry": (SHARP, 2e3, 0.10, 9.0, 1.5, {"start": "rest"}, 5),
}  # fmt: skip


@cache
def solved(name):
    """Return scene, run and reference of a name."""
    share, stiffness, speed, duration, breakaway, effects, _ = SCENES[name]
    contact = po.StickSlip(breakaway)
    scene = scene_of(R1_SOIL, share, stiffness, 24.0, speed, entry=True, contact=contact, **effects)
    return scene, *three_modes.agreed(scene, duration, outputs=100)


def largest(values):
    return float(np.max(np.abs(values)))


@pytest.mark.parametrize("name", SCENES)
def test_while_it_sticks_the_mount_stretches_up_to_the_holding_force(name):
    scene, run, expected = solved(name)
    before_buried = [change for change in expected.changes if change.travel < scene.cone.height * (1.0 - 1e-9)]
    assert sum(change.new == STICK for change in before_buried) == SCENES[name][-1]
    # A share that first moves without resistance has the rounding errors of the spring.
    assert largest(run.travel - expected.travel) < 2e-8 * largest(expected.deflection)
    stuck = run.mode == STICK
    assert np.count_nonzero(stuck) > 10
    # Between two outputs of one stick the share stays where it is, and the spring takes up the strut's path.
    both = stuck[1:] & stuck[:-1]
    apart = np.array(
        [any(a < c.time < b for c in expected.changes) for a, b in zip(run.time, run.time[1:], strict=False)]
    )
    same = both & ~apart
    assert np.count_nonzero(same) > 5
    assert largest(np.diff(run.travel)[same]) < 1e-14
    assert np.all(np.diff(run.mount_force)[same] > 0.0)


@pytest.mark.parametrize("name", ["soft", "blunt", "soft, rarely", "on beyond the end of entry"])
def test_it_breaks_loose_at_the_holding_force(name):
    # Without a wave the force at which each stick ends grows with the square of the travel, and then no more.
    scene, _, books = solved(name)
    loose = [change for change in books.changes if (change.old, change.new) == (STICK, SLIP)]
    assert len(loose) >= 2
    near = 1e-6
    for change in loose[:1] + loose[-1:]:
        run = po.simulate(scene, change.time - near, outputs=1)
        assert run.mode[-1] == STICK
        hold = min(run.travel[-1] / scene.cone.height, 1.0) ** 2 * scene.reaction.static
        held = scene.effects.contact.breakaway * hold - scene.stiffness * scene.tow_speed * near
        assert run.mount_force[-1] == pytest.approx(held, rel=1e-8)
        assert po.simulate(scene, change.time + near, outputs=1).mode[-1] == SLIP


@pytest.mark.parametrize("breakaway", [1.0, 1.5, 5.0])
@pytest.mark.parametrize("start", ["rest", "towed"])
def test_first_contact_holds_nothing(breakaway, start):
    # At travel 0 the soil holds nothing, whatever the breakaway ratio: the share moves at once, by the spring alone.
    effects = {"entry": True, "start": start, "contact": po.StickSlip(breakaway)}
    scene = scene_of(R1_SOIL, SHARP, 5e2, 24.0, 0.5, **effects)
    omega, moment = np.sqrt(scene.stiffness / scene.mass), 1e-2
    run = po.simulate(scene, moment, outputs=10)
    assert set(run.mode) == {SLIP}
    free = 0.5 * moment if start == "towed" else 0.5 * (moment - np.sin(omega * moment) / omega)
    # The soil takes m_a (L/h)^3 and F0 (L/h)^2: of a travel of 5 mm and of 0.02 mm.
    assert run.travel[-1] == pytest.approx(free, rel=2e-3)
