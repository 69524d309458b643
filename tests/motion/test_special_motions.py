"""Special motions: smooth contact, stick, slip, gap, entry, no motion, the print, several strength waves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import three_modes
from helpers.forces import Forces
from helpers.scenes import BLUNT, R1_SOIL, SHARP, Shank, scene_of
from scipy.integrate import quad

import plough_opt as po
from plough_opt.motion.solvers.checks import refuse_missed_event

# --- the smooth one-sided contact: its limit of zero width, an independent solver, and its warnings ---

WAVE = po.StrengthWave(0.6, 0.2)


def smooth_scene(contact, stiffness=2e4, speed=1.0, **effects):
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
    exact = po.simulate(smooth_scene(po.StickSlip(), **effects), 1.0, outputs=100)
    assert three_modes.follow(exact.scene, 1.0).count(0, 2) == 0
    runs = [po.simulate(smooth_scene(po.Smooth(0.02 / 2.0**k), **effects), 1.0, outputs=100) for k in range(3)]
    errors = np.array([np.max(np.abs(run.mount_force - exact.mount_force)) for run in runs])
    # Instead of sticking the share creeps at a fraction of the width, an error of first order.
    assert errors[-1] < 2e-2 * np.max(np.abs(exact.mount_force))
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("width", [0.5, 0.05, 0.005])
@pytest.mark.parametrize("effects", MOTIONS.values(), ids=MOTIONS)
def test_an_independent_solver_agrees(width, effects):
    # A narrow step makes the equation stiff in both programs.
    three_modes.agreed(smooth_scene(po.Smooth(width), **effects), 1.0, allowed=5e-8, resistance=20.0)


@pytest.mark.parametrize("contact", [po.Smooth(0.5), po.Smooth(2.5), po.Smooth(20.0), "resisting", po.StickSlip(1.1)])
def test_a_settled_share_has_the_steady_resistance(contact):
    own = () if isinstance(contact, po.StickSlip) else (Shank(100.0, 50.0),)
    settles = {"start": "towed", "damping": 3000.0, "rate_term": 0.05, "own": own}
    run = po.simulate(smooth_scene(contact, speed=2.0, **settles), 6.0)
    assert run.mount_force[-1] == pytest.approx(run.scene.steady_resistance, rel=1e-9)


@pytest.mark.parametrize("width", [1e-4, 1e-7])
def test_a_very_small_width_terminates_with_an_honest_error(width):
    run, exact = (
        po.simulate(smooth_scene(c, start="rest", speed=0.2), 1.0) for c in (po.Smooth(width), po.StickSlip())
    )
    assert run.error_estimate <= 1e-8 or any("was not reached" in text for text in run.warnings)
    assert run.mean_draft == pytest.approx(exact.mean_draft, rel=10.0 * width + 10.0 * run.error_estimate)


# --- the quasi-static limit against adaptive quadrature ---


@pytest.mark.parametrize(
    ("ramp", "wavelength", "duration"),
    [(None, 0.02, 0.5), (None, 50.0, 0.07), (0.3, 0.6, 1.0), (0.371234, 0.6, 1.0), (1.0, 0.6, 1.0), (2.5, 0.6, 1.0)],
)
@pytest.mark.parametrize("rate_term", [None, 0.05])
def test_runs_are_those_of_adaptive_quadrature(r1_scene, ramp, wavelength, duration, rate_term):
    scene = r1_scene(motion=False, strength_wave=po.StrengthWave(0.3, wavelength), tow_ramp=ramp, rate_term=rate_term)
    run, forces = po.simulate(scene, duration), Forces(scene)
    path, speed = np.transpose([forces.strut(t) for t in run.time])
    wave = wavelength / scene.tow_speed

    def force(t):
        return forces.soil(*forces.strut(t))

    def average(function):
        # Ends of waves at full speed, and of the ramp.
        points = np.arange(wave, duration, wave) if not ramp else [ramp] if ramp < duration else None
        return quad(function, 0.0, duration, points=points, epsrel=1e-13, epsabs=0.0, limit=400)[0] / duration

    mean = average(force)
    rms = math.sqrt(average(lambda t: (force(t) - mean) ** 2))
    # Gauss-Legendre of degree 19 on panels of at most half a radian is exact up to rounding.
    assert run.mean_draft == pytest.approx(mean, rel=1e-12)
    assert run.force_rms == pytest.approx(rms, rel=1e-12, abs=1e-13 * mean)
    assert run.tow_power == pytest.approx(average(lambda t: force(t) * forces.strut(t)[1]), rel=1e-12)
    assert run.mount_force == pytest.approx([force(t) for t in run.time], rel=1e-12)
    assert run.speed == pytest.approx(speed, rel=1e-12, abs=1e-15)
    assert run.travel == pytest.approx(path, rel=1e-12, abs=1e-15)
    assert run.mean_deflection == pytest.approx(run.mean_draft / scene.stiffness, rel=1e-15)
    assert run.displacement_rms == pytest.approx(run.force_rms / scene.stiffness, rel=1e-15)
    assert run.deflection == pytest.approx(run.mount_force / scene.stiffness, rel=1e-15)
    assert list(run.soil_resistance) == list(run.mount_force)
    assert run.error_estimate < 1e-11


def test_smallest_wave_keeps_its_digits(r1_scene):
    # Whole waves: RMS eps F0/sqrt(2). It is 1e-9 of the mean draft.
    run = po.simulate(r1_scene(motion=False, strength_wave=po.StrengthWave(1e-9, 0.5)), 2.0)
    assert run.force_rms == pytest.approx(1e-9 * run.scene.reaction.static / math.sqrt(2), rel=1e-8)


# --- equation (27) as printed: a spring that repels, from equilibrium, to overflow, and in a design ---


def test_its_unstable_equilibrium_is_exact_and_grows_at_the_natural_frequency(r1_scene):
    scene = r1_scene(formulation="printed")
    run = po.simulate(scene, 1.0, outputs=10)
    assert run.mean_deflection == pytest.approx(-scene.steady_resistance / scene.stiffness, rel=1e-15)
    assert run.mean_draft == pytest.approx(scene.steady_resistance, rel=1e-15)
    assert run.force_rms == np.ptp(run.deflection) == 0.0
    # A disturbance of 1e-12 of the soil's strength grows like exp(omega t), here by 1e9 in 0.45 s.
    wave = po.StrengthWave(1e-12, 0.6)
    disturbed = po.simulate(r1_scene(formulation="printed", strength_wave=wave, inertial_drag=False), 0.45, outputs=9)
    deviation = np.abs(disturbed.deflection + scene.reaction.static / scene.stiffness)
    growth = math.log(deviation[-1] / deviation[-2]) / (0.45 / 9)
    assert growth == pytest.approx(float(disturbed.scene.natural_frequency), rel=1e-3)


# --- overflow ---


@pytest.mark.parametrize("accuracy", [None, po.Accuracy("dop853"), po.Accuracy("erk")], ids=str)
@pytest.mark.parametrize(
    ("drag", "duration"),
    # Growth by exp(3e4); by exp(600), whose square overflows; and by drag of constant sign, which drives a retreating
    # share away in finite time.
    [(False, 2e3), (False, 39.0), (True, 1.0)],
)
def test_overflow_names_the_repelling_spring(r1_scene, drag, duration, accuracy):
    scene = r1_scene(stiffness=5e3, start="rest", inertial_drag=drag, formulation="printed")
    with pytest.raises(po.IntegrationError) as refusal:
        po.simulate(scene, duration, accuracy=accuracy, outputs=10)
    message = str(refusal.value)
    assert "the print's repelling spring drives the share away like exp(" in message
    assert f"exp({scene.natural_frequency:.3g} t)" in message
    assert "use a shorter duration, or formulation = 'derived'" in message
    assert "on 5 kN/m of a repelling spring, as printed, with" in message


# --- several strength waves: their sum in every kind of run, against an independent solver and linear series ---

WAVES = (po.StrengthWave(0.2, 0.2), po.StrengthWave(0.1, 0.3, 0.7), po.StrengthWave(0.05, 0.12, -2.0))


def waved_scene(waves=WAVES, **effects):
    """Return a scene of a damped share in serozem under strength waves."""
    return scene_of(**{"strength_wave": waves, "damping": 400.0} | effects)


@pytest.mark.parametrize("effects", [{}, {"contact": po.StickSlip(1.1)}, {"entry": True, "start": "rest"}], ids=str)
def test_an_independent_solver_agrees_under_several_waves(effects):
    three_modes.agreed(waved_scene(**effects), 1.0, outputs=50)


def test_small_waves_add_up_in_an_orbit():
    small = tuple(po.StrengthWave(1e-5 * w.amplitude, w.wavelength, w.phase) for w in WAVES)
    together = po.simulate(waved_scene(small, orbit="periodic"))
    alone = [po.simulate(waved_scene(w, orbit="periodic")) for w in small]
    # The response is linear but for the second order in the amplitude.
    assert together.force_rms == pytest.approx(math.sqrt(sum(run.force_rms**2 for run in alone)), rel=1e-4)


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
def test_an_independent_solver_agrees_that_it_sticks(name):
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


# --- designs ---


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
