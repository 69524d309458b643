"""Entry from first contact: both sides of its kink, and shares that turn back.

`test_effect_combinations` compares entry beside every other effect with an independent solver.
"""

import numpy as np
import pytest
from helpers import three_modes
from helpers.scenes import SHARP, scene_of

import plough_opt as po


def test_both_sides_of_the_kink_against_an_exact_solution(r1_soil):
    # The spring is so soft that the share only follows its momentum. Without wave, drag and added mass its energy
    # m v^2/2 falls by the work F0 L^3/(3 h^2) and, beyond h, by F0 (L - h) too.
    effects = {"start": "towed", "entry": True, "inertial_drag": False, "added_mass": False}
    scene = scene_of(r1_soil, SHARP, 1e-6, 100.0, 3.0, **effects)
    static, height = scene.reaction.static, scene.cone.height
    run = po.simulate(scene, 0.12, outputs=240)
    depth = np.minimum(run.travel, height)
    work = static * depth**3 / (3.0 * height**2) + static * np.maximum(run.travel - height, 0.0)
    assert np.count_nonzero(run.travel < height) > 100
    assert np.count_nonzero(run.travel > height) > 20
    assert scene.mass * run.speed**2 / 2.0 == pytest.approx(scene.mass * 9.0 / 2.0 - work, rel=2e-8)


@pytest.mark.parametrize("start", ["rest", "towed"])
@pytest.mark.parametrize("stiffness", [1e3, 5e3, 2e4])
def test_a_share_that_turns_back_stays_as_deep_as_it_was(r1_soil, start, stiffness):
    steep = po.Wedge(po.deg(60.0), po.deg(15.0), 0.5)
    effects = {"start": start, "entry": True, "inertial_drag": False, "strength_wave": po.StrengthWave(0.9, 0.11)}
    scene = scene_of(r1_soil, steep, stiffness, 24.0, 1.5, **effects)
    run, _ = three_modes.agreed(scene, 0.6, outputs=24)
    furthest = np.maximum.accumulate(po.simulate(scene, 0.6, outputs=2400).travel)[::100]
    assert np.any((run.travel < furthest - 0.01) & (furthest < scene.cone.height))
