"""Stick, slip, gap and entry: an independent event-driven solver, hard starts, both sides of kinks, and a design."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import three_modes
from helpers.problem_files import SUBSOILER
from helpers.scenes import BLUNT, R1_SOIL, SHARP, scene_of

import plough_opt as po
from plough_opt.motion.checks import refuse_missed_event


def wave(amplitude, wavelength=0.6):
    return po.StrengthWave(amplitude, wavelength)


TENTH, FIFTH, DOUBLE = ({"contact": po.StickSlip(ratio)} for ratio in (1.1, 1.2, 2.0))
ENTERS = {"entry": True, "strength_wave": wave(0.8)}
WEAK = {
    "soil": replace(R1_SOIL, cohesion=300.0, ambient_pressure=0.0),
    "share": po.Wedge(po.deg(45.0), po.deg(15.0), 0.40),
    "strength_wave": wave(1.0, 0.1),
}
# stiffness [N/m], mass [kg], speed [m/s], duration [s], and what differs from stick and slip from rest
SCENES = {
    "strong wave, slow": (2e3, 24.0, 0.1, 6.0, {"strength_wave": wave(1.0, 0.3)}),
    "gap and recapture": (2e3, 24.0, 2.0, 3.0, {"strength_wave": wave(1.0), "start": "equilibrium"}),
    "many gaps": (1e4, 24.0, 2.0, 3.0, {"strength_wave": wave(1.0)}),
    "stiff": (1e6, 24.0, 2.0, 0.5, {"strength_wave": wave(0.8)}),
    "damped": (2e4, 24.0, 1.0, 2.0, DOUBLE | {"strength_wave": wave(0.8, 0.1), "damping": 100.0}),
    "ramp and rate": (
        2e4, 24.0, 1.0, 2.0, DOUBLE | {"strength_wave": wave(0.8), "tow_ramp": 0.5, "rate_term": 0.1}
    ),
    "soil caught again": (1e5, 20.0, 1.0, 1.0, WEAK | {"inertial_drag": False}),
    "soil caught again, damped ramp": (
        1e5, 20.0, 1.0, 1.0, WEAK | FIFTH | {"start": "equilibrium", "damping": 40.0, "tow_ramp": 0.05}
    ),
    "sticks while it enters": (2e4, 20.0, 1.0, 2.0, FIFTH | ENTERS | {"share": BLUNT}),
    "gap while it enters": (2e4, 22.0, 1.0, 1.0, FIFTH | ENTERS),
    # While they enter, these stick 9, 5, 3, 2 and 3 times.
    "soft, enters": (5e2, 24.0, 0.05, 10.0, TENTH | {"entry": True}),
    "blunt, enters": (2e3, 24.0, 0.2, 4.0, TENTH | {"entry": True, "share": BLUNT, "strength_wave": wave(0.8, 0.05)}),
    "gaps too, enters": (
        3e3, 24.0, 0.1, 4.0, ENTERS | {"contact": po.StickSlip(3.0), "strength_wave": wave(1.0, 0.02), "rate_term": 0.5}
    ),
    "damped ramp, enters": (
        1e3, 24.0, 0.1, 5.0, ENTERS | DOUBLE | {"strength_wave": wave(0.8, 0.05), "tow_ramp": 1.0, "damping": 20.0}
    ),
    "towed, enters": (1e3, 24.0, 0.1, 6.0, TENTH | {"entry": True, "start": "towed", "inertial_drag": False}),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_an_independent_solver_agrees(name):
    stiffness, mass, speed, duration, changes = SCENES[name]
    given = {"soil": R1_SOIL, "share": SHARP, "contact": po.StickSlip(), "start": "rest"} | changes
    scene = scene_of(stiffness=stiffness, mass=mass, tow_speed=speed, **given)
    _, expected = three_modes.agreed(scene, duration, outputs=40)
    # Modes, speeds and resistances are compared at the others.
    assert np.count_nonzero(expected.near_a_change(1e-7 * duration)) <= 6


@pytest.mark.parametrize("density_ratio", [1e-3, 1e-6, 0.1])
@pytest.mark.parametrize("stiffness", [5e4, 1e7])
def test_a_share_breaks_loose_soon_after_the_start(density_ratio, stiffness):
    loose = replace(R1_SOIL, density_ratio=density_ratio)
    effects = {"start": "rest", "contact": po.StickSlip(), "damping": 200.0, "inertial_drag": False}
    run, _ = three_modes.agreed(scene_of(loose, SHARP, stiffness, **effects), 0.05)
    assert run.mode[-1] == three_modes.SLIP


def test_a_share_that_hardly_moves_has_not_stopped():
    # In the first milliseconds of a ramp the share's speed is a rounded difference, which must not trigger an event.
    strong, slender = replace(R1_SOIL, cohesion=4e4, ambient_pressure=3e5), po.Wedge(po.deg(4.0), po.deg(15.0), 0.05)
    effects = {"start": "towed", "entry": True, "tow_ramp": 0.07, "added_mass": False}
    scene = scene_of(strong, slender, 260.0, 13.0, 0.2, contact=po.StickSlip(2.5), **effects)
    for duration in (0.045, 0.06, 0.3, 2.0):
        run, _ = three_modes.agreed(scene, duration)
        assert run.error_estimate < 1e-8


def test_a_problem_file_names_contact_and_entry():
    for changes, wanted in (
        ("{contact='stick_slip', breakaway=1.2, entry=true, start='towed'}", (po.StickSlip(1.2), True)),
        ("{contact='smooth', contact_width='5 cm/s'}", (po.Smooth(0.05), False)),
    ):
        effects = po.read_problem(SUBSOILER, [f"effects={changes}"]).scene().effects
        assert (effects.contact, effects.entry) == wanted


# --- designs ---


CONTACTS = [
    pytest.param(po.StickSlip(1.2), marks=pytest.mark.slow, id="stick_slip"),
    pytest.param(po.Smooth(0.2), id="smooth"),
]


@pytest.mark.parametrize("contact", CONTACTS)
def test_a_design_finds_what_brute_force_finds(contact):
    effects = {"contact": contact, "start": "rest", "strength_wave": wave(0.6, 0.3), "damping": 200.0}

    def cost(stiffness):
        run = po.simulate(scene_of(R1_SOIL, SHARP, stiffness, 24.0, 1.0, **effects), 1.0, outputs=10)
        return (run.mean_draft + run.force_rms) / 1e3

    d = po.Design()
    k0 = d.variable("stiffness", guess=1.5e4, lower=5e3, upper=5e4, unit="N/m", log=True)
    d.minimise(cost(k0))
    best = d.solve()
    found = cost(best(k0))
    assert best.status == "solved"
    assert best.objective == pytest.approx(found, rel=1e-7)
    # No sampled stiffness is better than the design, and its neighbours on either side are worse.
    assert found <= min(map(cost, np.geomspace(5e3, 5e4, 30).tolist())) + 1e-7
    assert all(cost(min(max(best(k0) * factor, 5e3), 5e4)) >= found - 1e-9 for factor in (0.995, 1.005))


def test_a_missed_event_is_an_error():
    effects = {"contact": po.StickSlip(1.3), "start": "rest", "strength_wave": wave(0.7, 0.4)}
    scene = scene_of(share=SHARP, stiffness=1e6, mass=30.0, **effects)
    with pytest.raises(po.IntegrationError, match=r"'erk' missed that the share stopped before t = .*: .* tighter"):
        po.simulate(scene, 1.0, accuracy=po.Accuracy("erk", tolerance=6e-3))
    run = po.simulate(scene, 1.0)
    held = replace(run, mode=np.full_like(run.mode, three_modes.STICK))
    with pytest.raises(po.IntegrationError, match=r"'erk' missed that the share broke loose before t = "):
        refuse_missed_event(held)
    refuse_missed_event(run)


# `test_effect_combinations` compares entry beside every other effect with an independent solver.


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
