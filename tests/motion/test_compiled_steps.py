"""Runs in machine code give the results of interpreted ones, for every combination of effects."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import assert_alike, results_of

import plough_opt as po
from plough_opt.motion.compiled_steps import compiled_steps


def test_every_combination_of_effects(r1_scene, effects):
    scene = r1_scene(**effects)
    found, expected = (po.simulate(scene, 0.7, outputs=60, compiled=compiled) for compiled in (True, False))
    # The operations are the same, in the same order and not fused, so on most machines every bit agrees. A compiler's
    # own sine may round its last digit differently, over a few hundred steps.
    assert_alike(results_of(found), expected, 1e-12)
    # The difference of two runs that agree to eight digits has about eight digits left.
    assert found.error_estimate == pytest.approx(expected.error_estimate, rel=1e-3, abs=1e-12)
    assert (found.accuracy, found.warnings) == (expected.accuracy, expected.warnings)


def test_a_failure_is_the_same(r1_scene):
    scene, accuracy = r1_scene(stiffness=5e5, start="rest"), po.Accuracy("dop853", steps=4)
    messages = []
    for compiled in (False, True):
        with pytest.raises(po.IntegrationError, match="beyond t = ") as caught:
            po.simulate(scene, 200.0, accuracy=accuracy, outputs=2, compiled=compiled)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


def test_threads_do_not_share_states(r1_scene, r1_wave):
    scenes = [r1_scene(stiffness=k0, strength_wave=r1_wave) for k0 in np.linspace(3e4, 6e4, 12)]
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda scene: po.simulate(scene, 1.0, compiled=True), scenes))
    for run, scene in zip(runs, scenes, strict=True):
        assert np.array_equal(run.mount_force, po.simulate(scene, 1.0, compiled=True).mount_force)


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_a_run_is_interpreted_with_a_warning(r1_scene, r1_wave):
    scene = r1_scene(strength_wave=r1_wave)
    expected = po.simulate(scene, 1.0)
    compiled_steps.cache_clear()
    try:
        found = po.simulate(scene, 1.0, compiled=True)
    finally:
        compiled_steps.cache_clear()
    assert np.array_equal(found.mount_force, expected.mount_force)
    assert any("no C compiler was found" in warning for warning in found.warnings)


@dataclass(frozen=True)
class Tabled:
    """Own resistance that looks a force up in a table, which has no form for a vector register."""

    def force(self, travel, speed):
        return ca.interpolant("table", "linear", [[-1.0, 3.0]], [10.0, 50.0])(travel) + 0.0 * speed


@pytest.mark.parametrize(
    ("effects", "what"),
    [
        ({"own": (Tabled(),)}, "own effects"),
        ({"motion": False}, "a quasi-static run"),
        ({"contact": po.StickSlip(1.2)}, "a run by 'erk'"),
        ({"strength_wave": po.StrengthWave(0.3, 0.6), "orbit": "periodic"}, "a periodic orbit"),
    ],
)
def test_runs_that_cannot_be_compiled_carry_a_note(r1_scene, effects, what):
    scene, duration = r1_scene(**effects), None if "orbit" in effects else 0.2
    found, expected = (po.simulate(scene, duration, outputs=20, compiled=compiled) for compiled in (True, False))
    (note,) = set(found.warnings) - set(expected.warnings)
    assert note.startswith(f"compiled=True has no effect on {what}")
    assert found.mean_draft == expected.mean_draft
