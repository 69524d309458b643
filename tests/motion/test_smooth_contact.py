"""The smooth one-sided contact: its limit of zero width, an independent solver, and its warnings."""

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.scenes import R1_SOIL, SHARP, Shank, scene_of

import plough_opt as po

WAVE = po.StrengthWave(0.6, 0.2)


def scene(contact, stiffness=2e4, speed=1.0, **effects):
    return scene_of(R1_SOIL, SHARP, stiffness, 24.0, speed, contact=contact, **effects)


WITHOUT_GAP = {
    "wave": {"start": "rest", "strength_wave": po.StrengthWave(0.3, 0.4), "damping": 150.0},
    "ramp": {"start": "rest", "tow_ramp": 0.3, "rate_term": 0.05},
}
MOTIONS = {
    "damped": {"start": "rest", "strength_wave": WAVE, "damping": 100.0},
    "ramp": {"start": "towed", "strength_wave": WAVE, "tow_ramp": 0.4, "rate_term": 0.1},
    "equilibrium": {"start": "equilibrium", "strength_wave": po.StrengthWave(1.0, 0.3)},
    "steady and slow": {"start": "equilibrium", "speed": 0.02},
}


@pytest.mark.parametrize("effects", WITHOUT_GAP.values(), ids=WITHOUT_GAP)
def test_the_error_falls_with_the_width_where_no_gap_opens(effects):
    exact = po.simulate(scene(po.StickSlip(), **effects), 1.0, outputs=100)
    assert three_modes.follow(exact.scene, 1.0).count(0, 2) == 0
    runs = [po.simulate(scene(po.Smooth(0.02 / 2.0**k), **effects), 1.0, outputs=100) for k in range(3)]
    errors = np.array([np.max(np.abs(run.mount_force - exact.mount_force)) for run in runs])
    # Instead of sticking the share creeps at a fraction of the width, an error of first order.
    assert errors[-1] < 2e-2 * np.max(np.abs(exact.mount_force))
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("width", [0.5, 0.05, 0.005])
@pytest.mark.parametrize("effects", MOTIONS.values(), ids=MOTIONS)
def test_an_independent_solver_agrees(width, effects):
    # A narrow step makes the equation stiff in both programs.
    three_modes.agreed(scene(po.Smooth(width), **effects), 1.0, allowed=5e-8, resistance=20.0)


def test_a_symbolic_run_ends_steps_at_the_ends_of_the_contacts_step():
    """Steps across such an end would have an error of 2e-11 here instead of 7e-13."""

    def run_of(stiffness, accuracy):
        effects = {"start": "rest", "strength_wave": po.StrengthWave(0.3, 0.4), "damping": 100.0}
        return po.simulate(scene(po.Smooth(0.2), stiffness, **effects), 1.0, accuracy=accuracy, outputs=1)

    x = ca.MX.sym("x")
    found = ca.Function("draft", [x], [run_of(x, po.Accuracy("dop853", steps=400)).mean_draft])(2e4)
    assert float(found) == pytest.approx(run_of(2e4, po.Accuracy(error=1e-11)).mean_draft, rel=3e-12)


def test_a_share_that_retreats_carries_a_warning():
    run = po.simulate(scene(po.Smooth(0.05), 1e4, 2.0, start="rest", strength_wave=po.StrengthWave(1.0, 0.6)), 3.0)
    (warning,) = [text for text in run.warnings if "retreats" in text]
    assert f"{-min(run.speed):.3g} m/s" in warning
    assert "the smooth contact ignores the gap" in warning
    back = run.speed < 0.0
    assert np.any(back)
    # Only the added mass acts on a retreating share.
    force = run.scene.reaction.added_mass / run.scene.inertia * run.mount_force
    assert run.soil_resistance[back] == pytest.approx(force[back], rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("width", [2.0, 0.1, 1e-3])
def test_a_narrow_step_takes_far_fewer_equal_steps_than_would_resolve_its_slope(width):
    """Equal steps that resolve the step's slope everywhere would be 300,000 at the narrowest width."""
    run = po.simulate(scene(po.Smooth(width), start="rest", strength_wave=WAVE), 1.0)
    assert run.error_estimate <= 1e-8
    assert (run.accuracy.steps or 0) <= 20_000


@pytest.mark.parametrize("contact", [po.Smooth(0.5), po.Smooth(2.5), po.Smooth(20.0), "resisting", po.StickSlip(1.1)])
def test_a_settled_share_has_the_steady_resistance(contact):
    own = () if isinstance(contact, po.StickSlip) else (Shank(100.0, 50.0),)
    settles = {"start": "towed", "damping": 3000.0, "rate_term": 0.05, "own": own}
    run = po.simulate(scene(contact, speed=2.0, **settles), 6.0)
    assert run.mount_force[-1] == pytest.approx(run.scene.steady_resistance, rel=1e-9)


@pytest.mark.parametrize("width", [1e-4, 1e-7])
def test_a_very_small_width_terminates_with_an_honest_error(width):
    run, exact = (po.simulate(scene(c, start="rest", speed=0.2), 1.0) for c in (po.Smooth(width), po.StickSlip()))
    assert run.error_estimate <= 1e-8 or any("was not reached" in text for text in run.warnings)
    assert run.mean_draft == pytest.approx(exact.mean_draft, rel=10.0 * width + 10.0 * run.error_estimate)
