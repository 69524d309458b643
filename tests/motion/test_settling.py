"""Where a share that starts from equilibrium ends up, compared with the periodic orbit that was found."""

import numpy as np
import pytest
from helpers.orbit_oracle import follow, period
from helpers.scenes import scene_of

import plough_opt as po
from plough_opt.motion import orbit

# The orbit is stable (its larger multiplier is 0.73) and never retreats, but equilibrium leads to another motion.
TWO_MOTIONS = scene_of(
    po.Soil(1285.32, 0.829167, 41721.3, 0.472563, 0.689544, 0.0),
    po.Wedge(0.859646, 0.30097, 0.332078),
    *(8856.09, 18.1717, 1.13819),
    strength_wave=po.StrengthWave(0.262576, 0.0633886),
    damping=153.44,
    orbit="periodic",
)
WAVE = po.StrengthWave(0.3, 0.2)


def settled_on(scene, after, over):
    """Return, by SciPy, the states of a share from equilibrium at the ends of so many wavelengths.

    Beside them stand the RMS of the mount force [N] over the last wavelengths, and whether the share then retreats.
    """
    each = 60
    equilibrium = (scene.reaction.static + scene.reaction.drag * scene.tow_speed**2) / scene.stiffness
    times = np.linspace(0.0, after * period(scene), after * each + 1)
    z, rate = follow(scene, (equilibrium, 0.0), times[-1], times, rtol=1e-9)
    force = (scene.stiffness * z + scene.effects.damping * rate)[-over * each :]
    return np.array([z, rate])[:, ::each], float(np.std(force)), bool(np.max(rate[-over * each :]) > scene.tow_speed)


def test_another_motion_than_the_stable_orbit_is_named():
    run = po.simulate(TWO_MOTIONS)
    assert max(map(abs, run.floquet)) < 0.8
    assert run.speed.min() > 0.0
    ends, rms, retreats = settled_on(TWO_MOTIONS, after=120, over=6)
    np.testing.assert_allclose(ends[:, -1], ends[:, -7], rtol=1e-6, atol=1e-8)
    assert min(np.max(np.abs(ends[:, -1] - ends[:, -1 - k])) for k in range(1, 6)) > 1e-2
    found = run.settles
    assert (found.orbit, found.period, found.averaged, found.retreats) == (False, 6, 6, retreats)
    # The mean over 60 samples a wavelength is exact; the states are within 1e-6 of the limit.
    assert found.force_rms == pytest.approx(rms, rel=1e-6)
    (warning,) = [text for text in run.warnings if "equilibrium" in text]
    assert warning.startswith("a share that starts from equilibrium comes to a period-6 motion of RMS 423.4 N")
    assert "although the orbit is stable" in warning


# Without drag in the soil the last one comes nearer by only 0.2 % in every wavelength.
@pytest.mark.parametrize(("stiffness", "damping", "drag"), [(5e4, 20.0, True), (3e5, 400.0, True), (1e6, 1.0, False)])
def test_a_share_that_comes_to_the_orbit(r1_scene, damping, stiffness, drag):
    effects = {"strength_wave": WAVE, "damping": damping, "inertial_drag": drag}
    run = po.simulate(r1_scene(stiffness=stiffness, orbit="periodic", **effects))
    assert run.settles.orbit is True
    assert run.settles.force_rms == run.force_rms
    assert not [text for text in run.warnings if "equilibrium" in text]
    assert run.settles.text.startswith("comes to this orbit (after ")
    # A run from the start, one wavelength longer, ends as near to the orbit as stated. Its own error is far smaller.
    count = run.settles.wavelengths
    followed = po.simulate(
        r1_scene(stiffness=stiffness, **effects), (count + 1) * run.duration, outputs=40 * (count + 1)
    )
    away = np.max(np.abs(followed.deflection[-41:] - run.deflection[::10])) / (np.ptp(run.deflection) / 2.0)
    assert away <= 1.5 * run.settles.distance + 1e-9


def test_a_share_that_is_driven_away_from_the_start():
    effects = {"strength_wave": po.StrengthWave(0.6, 1.0), "damping": 100.0}
    given = {"share": po.Wedge(1.0, 0.3, 0.4), "stiffness": 3e4, "mass": 5.0, **effects}
    run = po.simulate(scene_of(orbit="periodic", **given))
    assert (run.settles.orbit, run.settles.period, run.settles.force_rms) == (False, None, np.inf)
    assert any("equilibrium is driven away without bound" in text for text in run.warnings)
    with pytest.raises(po.IntegrationError, match="without bound in finite time"):
        po.simulate(scene_of(**given), run.duration)


def test_an_undamped_share_never_settles(r1_scene):
    run = po.simulate(r1_scene(strength_wave=WAVE, inertial_drag=False, orbit="periodic"))
    assert run.settles.orbit is None
    (warning,) = [text for text in run.warnings if "equilibrium" in text]
    assert "has not settled after 64 wavelengths" in warning
    assert "nothing damps a deviation from the orbit" in warning


def test_a_share_near_an_unstable_orbit_is_followed_for_the_stated_time():
    run = po.simulate(scene_of(stiffness=2e4, strength_wave=WAVE, damping=20.0, orbit="periodic"))
    found = run.settles
    assert max(map(abs, run.floquet)) > 1.5
    assert found.orbit is not True
    assert found.wavelengths * run.accuracy.steps <= orbit.MOST_STEPS + 32 * run.accuracy.steps
    if found.orbit is None:
        assert f"has not settled after {found.wavelengths} wavelengths" in found.text
        assert found.averaged == 256
