"""Mass in the mean draft: the momentum that share and carried soil gain, and what vanishes as the mount gets stiff."""

import numpy as np
import pytest

import plough_opt as po

SHARE = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
# The path of 1.2 m at full speed is two whole waves.
WAVE = po.StrengthWave(0.3, 0.6)
DURATION = 0.6
STIFFNESS = (1e6, 1e7, 1e8)
MASSES = (12.0, 48.0, 96.0)


def scene_of(soil, stiffness, mass, **effects):
    return po.Scene(soil, SHARE, stiffness, mass, 2.0, po.Effects(strength_wave=WAVE, **effects))


def damped(soil, stiffness, mass, **effects):
    """Return a scene with a damper of ratio 0.3, so that what rings at the start is gone after some oscillations."""
    return scene_of(soil, stiffness, mass, damping=0.6 * (stiffness * mass) ** 0.5, **effects)


def inertial_draft(scene, run):
    """Return the mean draft that only speeds share and carried soil up: M times the change of speed over the time."""
    return scene.inertia * (run.speed[-1] - run.speed[0]) / run.duration


def rigid_draft(soil, mass=1.0, **effects):
    return po.simulate(scene_of(soil, 1e6, mass, motion=False, **effects), DURATION).mean_draft


@pytest.fixture
def left(r1_soil):
    """Return what stiff mounts leave above the rigid limit, as parts of it: a row per stiffness, a column per mass."""

    def find(effects, ramp):
        limit = rigid_draft(r1_soil, **ramp)
        rows = []
        for stiffness in STIFFNESS:
            scenes = [damped(r1_soil, stiffness, mass, **effects, **ramp) for mass in MASSES]
            runs = [po.simulate(scene, DURATION, outputs=10) for scene in scenes]
            rows.append([run.mean_draft - inertial_draft(scene, run) for scene, run in zip(scenes, runs, strict=True)])
        return np.array(rows) / limit - 1.0

    return find


@pytest.mark.parametrize(
    ("effects", "ramp", "power"),
    [({}, {}, 1.5), ({"added_mass": False}, {}, 1.5), ({}, {"tow_ramp": 0.2}, 1.0)],
    ids=["steady start", "no added mass", "ramp"],
)
def test_a_stiff_mount_forgets_the_mass(left, effects, ramp, power):
    # The share lags by the force over the stiffness, 1/k0. Over whole waves that does not change the mean but for the
    # first oscillations, which last for 1/sqrt(k0); during a ramp, where the waves are not whole, it does.
    found = left(effects, ramp)
    assert np.max(np.abs(found[-1])) < 1e-5
    for differences in (found, found[:, :1] - found[:, 1:]):
        orders = np.log10(np.abs(differences[:-1] / differences[1:]))
        # The next order is some ten per cent at 1e6 N/m: sqrt(M/k0) against 0.05 s, in which the force changes.
        assert orders[0] == pytest.approx(power, abs=0.08)
        assert orders[1] == pytest.approx(power, abs=0.02)


@pytest.mark.parametrize("mass", MASSES)
def test_a_ramp_takes_the_momentum_of_share_and_carried_soil(r1_soil, mass):
    # Of the whole mean draft that is the only part that goes with the mass.
    scene = damped(r1_soil, 1e8, mass, tow_ramp=0.2)
    run = po.simulate(scene, DURATION, outputs=10)
    expected = scene.inertia * scene.tow_speed / DURATION
    assert inertial_draft(scene, run) == pytest.approx(expected, rel=1e-4)
    rigid = rigid_draft(r1_soil, tow_ramp=0.2)
    assert run.mean_draft - rigid == pytest.approx(expected, rel=0, abs=2e-5 * rigid)
    assert rigid == rigid_draft(r1_soil, mass, tow_ramp=0.2)
