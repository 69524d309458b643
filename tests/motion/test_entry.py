"""Entry from first contact: the law itself, both sides of its kink, and the motion under every contact law."""

import math

import numpy as np
import pytest
from helpers import three_modes

import plough_opt as po

SHARE = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
BLUNT = po.Wedge(po.deg(70.0), po.deg(15.0), 0.40)
WAVE = po.StrengthWave(0.6, 0.2)
LAWS = {"resisting": "resisting", "smooth": po.Smooth(0.05), "stick_slip": po.StickSlip(1.2)}


def scene_of(soil, share=SHARE, stiffness=2e4, mass=24.0, speed=1.0, **effects):
    return po.Scene(soil, share, stiffness, mass, speed, po.Effects(**({"entry": True, "start": "towed"} | effects)))


def largest(values):
    return float(np.max(np.abs(values)))


# --- the law ---


@pytest.mark.parametrize("contact", LAWS.values(), ids=LAWS)
def test_slow_and_stiff_the_force_is_the_square_of_the_travel_and_then_constant(r1_soil, contact):
    speed = 0.02 if contact == "resisting" else 0.2
    # Damped, so that what a finite stiffness leaves of an oscillation dies at once.
    scene = scene_of(r1_soil, stiffness=1e6, speed=speed, contact=contact, damping=4e3, inertial_drag=False)
    run = po.simulate(scene, 1.6 * scene.cone.height / speed, outputs=64)
    static = scene.reaction.static
    expected = static * np.minimum(run.travel / scene.cone.height, 1.0) ** 2
    # M L'' is M V^2/h, some tens of newtons per metre of 1e6 N/m: below 1e-3 of the force.
    assert run.mount_force[1:] == pytest.approx(expected[1:], rel=0, abs=2e-3 * static)
    before, after = run.travel < 0.9 * scene.cone.height, run.travel > 1.1 * scene.cone.height
    assert np.count_nonzero(before) > 30
    assert np.count_nonzero(after) > 15
    # A parabola: its second difference is constant, 2 F0 (V dt/h)^2.
    bend = 2.0 * static * (speed * (run.time[1] - run.time[0]) / scene.cone.height) ** 2
    assert np.diff(run.mount_force[before], 2)[3:] == pytest.approx(bend, rel=0.05)
    assert run.mount_force[after] == pytest.approx(static, rel=2e-3)


def test_resistance_has_the_powers_of_the_buried_length(r1_soil):
    scene = scene_of(r1_soil, share=BLUNT, stiffness=5e5, speed=2.0, rate_term=0.05, strength_wave=WAVE)
    run = po.simulate(scene, 0.5, outputs=200)
    reaction, height = scene.reaction, scene.cone.height
    depth = np.clip(run.travel / height, 0.0, 1.0)
    wave = 1.0 + 0.6 * np.sin(2.0 * math.pi * run.travel / 0.2)
    force = depth**2 * (reaction.static * (1.0 + 0.05 * run.speed**2) * wave + reaction.drag * run.speed**2)
    acceleration = (run.mount_force - force) / (scene.mass + depth**3 * reaction.added_mass)
    expected = force + depth**3 * reaction.added_mass * acceleration
    assert np.count_nonzero((depth > 0.0) & (depth < 1.0)) > 30
    assert np.count_nonzero(depth == 1.0) > 30
    assert run.soil_resistance == pytest.approx(expected, rel=0, abs=1e-12 * largest(expected))


def test_both_sides_of_the_kink_against_an_exact_solution(r1_soil):
    # At rest under a spring that is so soft that the share follows its momentum: without wave, drag and added mass,
    # energy gives the speed: m v^2/2 falls by the work F0 L^3/(3 h^2), and beyond h by F0 (L - h) too.
    scene = scene_of(r1_soil, stiffness=1e-6, mass=100.0, speed=3.0, inertial_drag=False, added_mass=False)
    static, height = scene.reaction.static, scene.cone.height
    run = po.simulate(scene, 0.12, outputs=240)
    depth = np.minimum(run.travel, height)
    work = static * depth**3 / (3.0 * height**2) + static * np.maximum(run.travel - height, 0.0)
    assert np.count_nonzero(run.travel < height) > 100
    assert np.count_nonzero(run.travel > height) > 20
    assert scene.mass * run.speed**2 / 2.0 == pytest.approx(scene.mass * 9.0 / 2.0 - work, rel=2e-8)


# --- against a solver of our own ---

OTHERS = {
    "bare": {},
    "all": {"strength_wave": WAVE, "damping": 150.0, "tow_ramp": 0.3, "rate_term": 0.1},
    "force alone": {"inertial_drag": False, "added_mass": False, "strength_wave": WAVE},
}


@pytest.mark.parametrize("others", OTHERS.values(), ids=OTHERS)
@pytest.mark.parametrize("contact", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("start", ["rest", "towed"])
def test_an_independent_solver_agrees(r1_soil, start, contact, others):
    scene = scene_of(r1_soil, share=BLUNT, start=start, contact=contact, stiffness=2e4, speed=1.5, **others)
    # Pushed back through a wave of 0.2 m at up to 7 m/s, the soil's force changes by its own size within millimetres.
    _, expected = three_modes.agreed(scene, 0.8, outputs=16, resistance=10.0)
    assert max(expected.travel) > scene.cone.height


# --- what entry leaves behind ---


@pytest.mark.parametrize("start", ["rest", "towed"])
@pytest.mark.parametrize("stiffness", [1e3, 5e3, 2e4])
def test_a_share_that_turns_back_stays_as_deep_as_it_was(r1_soil, start, stiffness):
    steep = {"share": po.Wedge(po.deg(60.0), po.deg(15.0), 0.5), "strength_wave": po.StrengthWave(0.9, 0.11)}
    scene = scene_of(r1_soil, stiffness=stiffness, speed=1.5, start=start, inertial_drag=False, **steep)
    run, _ = three_modes.agreed(scene, 0.6, outputs=24)
    furthest = np.maximum.accumulate(po.simulate(scene, 0.6, outputs=2400).travel)[::100]
    assert np.any((run.travel < furthest - 0.01) & (furthest < scene.cone.height))
    # H is that of the furthest travel, read off a fine run to 1e-3 m.
    depth = np.minimum(furthest, scene.cone.height) / scene.cone.height
    wave = 1.0 + 0.9 * np.sin(2.0 * math.pi * run.travel / 0.11)
    force = depth**2 * scene.reaction.static * wave
    carried = depth**3 * scene.reaction.added_mass
    whole = force + carried * (run.mount_force - force) / (scene.mass + carried)
    assert run.soil_resistance == pytest.approx(whole, rel=0, abs=5e-3 * largest(whole))


def test_nothing_is_felt_before_the_strut_moves(r1_soil):
    for contact in LAWS.values():
        run = po.simulate(scene_of(r1_soil, contact=contact, speed=0.0, start="rest"), 1.0, outputs=5)
        assert largest(run.mount_force) == largest(run.travel) == largest(run.soil_resistance) == 0.0
