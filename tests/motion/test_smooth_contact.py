"""The smooth one-sided contact: its limit of zero width, an independent solver, and its warnings."""

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes

import plough_opt as po

SHARE = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
WAVE = po.StrengthWave(0.6, 0.2)


def scene_of(soil, contact, **effects):
    stiffness, speed = effects.pop("stiffness", 2e4), effects.pop("speed", 1.0)
    return po.Scene(soil, SHARE, stiffness, 24.0, speed, po.Effects(contact=contact, **effects))


def largest(values):
    return float(np.max(np.abs(values)))


def retreats(run):
    return [text for text in run.warnings if "retreats" in text]


@pytest.mark.parametrize(
    "effects",
    [
        {"start": "rest"},
        {"start": "rest", "strength_wave": po.StrengthWave(0.3, 0.4), "damping": 150.0},
        {"start": "rest", "tow_ramp": 0.3, "rate_term": 0.05},
    ],
    ids=["rest", "wave", "ramp"],
)
def test_the_error_falls_with_the_width_where_no_gap_opens(r1_soil, effects):
    exact_scene = scene_of(r1_soil, po.StickSlip(), **effects)
    exact = po.simulate(exact_scene, 1.0, outputs=100)
    assert three_modes.follow(exact_scene, 1.0).count(0, 2) == 0
    widths = 0.02 / 2.0 ** np.arange(4)
    errors = [
        largest(
            po.simulate(scene_of(r1_soil, po.Smooth(w), **effects), 1.0, outputs=100).mount_force - exact.mount_force
        )
        for w in widths
    ]
    # Instead of sticking the share creeps at a fraction of the width, an error of first order.
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 1e-2 * largest(exact.mount_force)
    assert orders == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("width", [0.5, 0.05, 0.005])
@pytest.mark.parametrize(
    "effects",
    [
        {"start": "rest", "strength_wave": WAVE, "damping": 100.0},
        {"start": "towed", "strength_wave": WAVE, "tow_ramp": 0.4, "rate_term": 0.1},
        {"start": "equilibrium", "strength_wave": po.StrengthWave(1.0, 0.3)},
    ],
    ids=["damped", "ramp", "equilibrium"],
)
def test_an_independent_solver_agrees(r1_soil, width, effects):
    scene = scene_of(r1_soil, po.Smooth(width), **effects)
    # A narrow step makes the equation stiff in both programs.
    three_modes.agreed(scene, 1.0, allowed=5e-8, resistance=20.0)


def test_a_symbolic_run_ends_steps_at_the_ends_of_the_contacts_step(r1_soil):
    """Steps across such an end would have an error of 2e-11 here instead of 7e-13."""

    def run_of(stiffness, accuracy):
        effects = {"start": "rest", "strength_wave": po.StrengthWave(0.3, 0.4), "damping": 100.0}
        scene = scene_of(r1_soil, po.Smooth(0.2), stiffness=stiffness, **effects)
        return po.simulate(scene, 1.0, accuracy=accuracy, outputs=1)

    x = ca.MX.sym("x")
    found = ca.Function("draft", [x], [run_of(x, po.Accuracy("dop853", steps=400)).mean_draft])(2e4)
    assert float(found) == pytest.approx(run_of(2e4, po.Accuracy(error=1e-11)).mean_draft, rel=3e-12)


@pytest.mark.parametrize("speed", [0.02, 0.05, 0.2])
def test_a_steady_start_has_the_resistance_of_the_step(r1_soil, speed):
    scene = scene_of(r1_soil, po.Smooth(0.1), speed=speed)
    u = min(speed / 0.1, 1.0)
    share = u**5 * (126.0 - 420.0 * u + 540.0 * u**2 - 315.0 * u**3 + 70.0 * u**4)
    run = po.simulate(scene, 1.0, outputs=10)
    steady = share * (scene.reaction.static + scene.reaction.drag * speed**2)
    assert run.mount_force == pytest.approx(steady, rel=1e-12)
    assert run.force_rms == pytest.approx(0.0, abs=1e-9 * steady)


def test_a_share_that_retreats_carries_a_warning(r1_soil):
    wave = po.StrengthWave(1.0, 0.6)
    scene = scene_of(r1_soil, po.Smooth(0.05), start="rest", strength_wave=wave, speed=2.0, stiffness=1e4)
    run = po.simulate(scene, 3.0)
    (warning,) = retreats(run)
    assert f"{-min(run.speed):.3g} m/s" in warning
    assert "the smooth contact ignores the gap" in warning
    back = run.speed < 0.0
    assert np.any(back)
    # Only the added mass acts on a retreating share.
    force = scene_of(r1_soil, po.Smooth(0.05)).reaction.added_mass / run.scene.inertia * run.mount_force
    assert run.soil_resistance[back] == pytest.approx(force[back], rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("width", [1e-4, 1e-7])
def test_a_very_small_width_terminates_with_an_honest_error(r1_soil, width):
    scene = scene_of(r1_soil, po.Smooth(width), start="rest", speed=0.2)
    exact = po.simulate(scene_of(r1_soil, po.StickSlip(), start="rest", speed=0.2), 1.0)
    run = po.simulate(scene, 1.0)
    assert run.seconds < 60.0
    assert run.error_estimate <= 1e-8 or any("was not reached" in text for text in run.warnings)
    assert run.mean_draft == pytest.approx(exact.mean_draft, rel=10.0 * width + 10.0 * run.error_estimate)
