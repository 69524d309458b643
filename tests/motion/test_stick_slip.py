"""Stick, slip and gap: an independent event-driven solver, hard starts, refusals and a design."""

import dataclasses
import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.three_modes import GAP, SLIP, STICK

import plough_opt as po
from plough_opt.motion.judgement import refuse_missed_event

SHARP = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
MIDDLE = po.Wedge(po.deg(45.0), po.deg(15.0), 0.40)
BLUNT = po.Wedge(po.deg(70.0), po.deg(15.0), 0.40)


def wave(amplitude, wavelength=0.6):
    return po.StrengthWave(amplitude, wavelength)


def law(breakaway=1.0):
    return po.StickSlip(breakaway)


# share, cohesion [Pa], ambient pressure [Pa], stiffness [N/m], mass [kg], speed [m/s], duration [s], effects
SCENES = {
    "strong wave, slow": (SHARP, 15e3, 1e4, 2e3, 24.0, 0.1, 6.0, {"strength_wave": wave(1.0, 0.3), "start": "rest"}),
    "gap and recapture": (SHARP, 15e3, 1e4, 2e3, 24.0, 2.0, 3.0, {"strength_wave": wave(1.0)}),
    "many gaps": (SHARP, 15e3, 1e4, 1e4, 24.0, 2.0, 3.0, {"strength_wave": wave(1.0), "start": "rest"}),
    "stiff": (SHARP, 15e3, 1e4, 1e6, 24.0, 2.0, 0.5, {"strength_wave": wave(0.8), "start": "rest"}),
    "damped": (
        SHARP, 15e3, 1e4, 2e4, 24.0, 1.0, 2.0,
        {"contact": law(2.0), "strength_wave": wave(0.8, 0.1), "start": "rest", "damping": 100.0},
    ),
    "ramp and rate": (
        SHARP, 15e3, 1e4, 2e4, 24.0, 1.0, 2.0,
        {"contact": law(2.0), "strength_wave": wave(0.8), "start": "rest", "tow_ramp": 0.5, "rate_term": 0.1},
    ),
    "soil caught again": (
        MIDDLE, 300.0, 0.0, 1e5, 20.0, 1.0, 1.0,
        {"strength_wave": wave(1.0, 0.1), "start": "rest", "inertial_drag": False},
    ),
    "soil caught again, damped ramp": (
        MIDDLE, 300.0, 0.0, 1e5, 20.0, 1.0, 1.0,
        {"contact": law(1.2), "strength_wave": wave(1.0, 0.1), "damping": 40.0, "tow_ramp": 0.05},
    ),
    "sticks while it enters": (
        BLUNT, 15e3, 1e4, 2e4, 20.0, 1.0, 2.0,
        {"contact": law(1.2), "strength_wave": wave(0.8), "start": "rest", "entry": True},
    ),
    "gap while it enters": (
        SHARP, 15e3, 1e4, 2e4, 22.0, 1.0, 1.0,
        {"contact": law(1.2), "strength_wave": wave(0.8), "start": "rest", "entry": True},
    ),
}  # fmt: skip


def scene_of(soil, name, **changes):
    share, cohesion, pressure, stiffness, mass, speed, duration, effects = SCENES[name]
    soil = dataclasses.replace(soil, cohesion=cohesion, ambient_pressure=pressure)
    effects = po.Effects(**({"contact": law()} | effects | changes))
    return po.Scene(soil, share, stiffness, mass, speed, effects), duration


def largest(values):
    return float(np.max(np.abs(values)))


# --- an independent solver ---


@pytest.mark.parametrize("name", SCENES)
def test_an_independent_solver_agrees(r1_soil, name):
    scene, duration = scene_of(r1_soil, name)
    run, expected = three_modes.agreed(scene, duration, outputs=40)
    # Events are located to about 1e-12 of the duration.
    far = ~expected.near_a_change(1e-7 * run.duration)
    assert np.count_nonzero(far) >= 35
    assert largest(run.opening - expected.opening) < 2e-8 * largest(expected.deflection)
    assert largest((run.speed - expected.speed)[far]) < 1e-7 * largest(expected.speed) + 1e-12 * scene.tow_speed
    # The definition of each mode holds exactly.
    gap, stick = run.mode == GAP, run.mode == STICK
    assert np.all(run.speed[stick] == 0.0)
    assert np.all(run.soil_resistance[stick] == run.mount_force[stick])
    assert np.all(run.soil_resistance[gap] == 0.0)
    assert np.all((run.opening > 0.0) == gap)


# --- hard starts ---


@pytest.mark.parametrize("density_ratio", [1e-3, 1e-6, 0.1])
@pytest.mark.parametrize("stiffness", [5e4, 1e7])
def test_a_share_breaks_loose_soon_after_the_start(r1_soil, density_ratio, stiffness):
    effects = po.Effects(start="rest", contact=law(), damping=200.0, inertial_drag=False)
    loose = dataclasses.replace(r1_soil, density_ratio=density_ratio)
    scene = po.Scene(loose, SHARP, stiffness, 20.0, 2.0, effects)
    run = po.simulate(scene, 0.5)
    assert run.mode[-1] == SLIP
    # Amplitude of the oscillation about steady sliding that begins at rest under the static force.
    swing = scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia)
    damper = 200.0 * 2.0 * scene.tow_speed
    assert np.max(run.mount_force) < scene.reaction.static + swing + damper
    decay = math.exp(-100.0 * 0.45 / scene.inertia)
    assert abs(run.mount_force[-1] - scene.reaction.static) < decay * (swing + scene.reaction.static)


def test_a_share_that_hardly_moves_has_not_stopped(r1_soil):
    # In the first milliseconds of a ramp the share's speed is a rounded difference, which must not trigger an event.
    strong = dataclasses.replace(r1_soil, cohesion=4e4, ambient_pressure=3e5)
    effects = po.Effects(contact=law(2.5), start="towed", entry=True, tow_ramp=0.07, added_mass=False)
    scene = po.Scene(strong, po.Wedge(po.deg(4.0), po.deg(15.0), 0.05), 260.0, 13.0, 0.2, effects)
    for duration in (0.045, 0.06, 0.3, 2.0):
        run, _ = three_modes.agreed(scene, duration)
        assert run.error_estimate < 1e-8


def test_a_standing_strut_does_not_move_the_share(r1_soil):
    for start in ("rest", "towed", "equilibrium"):
        scene = po.Scene(r1_soil, SHARP, 2e4, 24.0, 0.0, po.Effects(contact=law(1.5), start=start))
        run = po.simulate(scene, 1.0, outputs=10)
        assert np.ptp(run.travel) == 0.0
        assert run.mount_force == pytest.approx(scene.reaction.static if start == "equilibrium" else 0.0)


# --- a problem file, and refusals ---

COTTON = Path(__file__).parents[2] / "problems" / "cotton_subsoiler.toml"
SLIPS, SMOOTH = "contact = 'stick_slip'", "contact = 'smooth'"


@pytest.mark.parametrize(
    ("changes", "contact", "entry"),
    [
        ([SLIPS], po.StickSlip(1.0), False),
        ([SLIPS, "breakaway = 1.2"], po.StickSlip(1.2), False),
        ([SLIPS, "breakaway = 1.2", "entry = true", "start = 'towed'"], po.StickSlip(1.2), True),
        ([SMOOTH, "contact_width = '5 cm/s'"], po.Smooth(0.05), False),
        (["entry = true", "start = 'rest'"], "resisting", True),
    ],
)
def test_a_problem_file_names_contact_and_entry(changes, contact, entry):
    effects = po.read_problem(COTTON, [f"effects.{change}" for change in changes]).scene().effects
    assert (effects.contact, effects.entry) == (contact, entry)


@pytest.mark.parametrize("method", ["dop853", "cvodes", "idas", "collocation", "rk"])
@pytest.mark.parametrize("effects", [{"contact": law()}, {"entry": True}], ids=["contact", "entry"])
@pytest.mark.parametrize("speed", [1.0, ca.MX.sym("speed")], ids=["number", "symbol"])
def test_methods_that_cannot_locate_events_are_refused(r1_soil, method, effects, speed):
    scene = po.Scene(r1_soil, SHARP, 2e4, 24.0, speed, po.Effects(start="rest", **effects))
    with pytest.raises(po.InputError, match=f"'{method}' cannot locate.*'erk' or 'rosenbrock'"):
        po.simulate(scene, 1.0, accuracy=po.Accuracy(method))


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: po.Effects(contact=po.StickSlip), "must be 'resisting', Smooth"),
        (lambda: po.Effects(contact=po.Smooth(0.1), formulation="printed"), "the print has no contact law"),
    ],
)
def test_contacts_without_meaning_are_refused(build, said):
    with pytest.raises(po.PloughError, match=said):
        build()


# --- designs ---


@pytest.mark.parametrize(
    "contact",
    [
        pytest.param(po.StickSlip(1.2), marks=pytest.mark.slow, id="stick_slip"),
        pytest.param(po.Smooth(0.2), id="smooth"),
    ],
)
def test_a_design_finds_what_brute_force_finds(r1_soil, contact):
    effects = po.Effects(contact=contact, start="rest", strength_wave=wave(0.6, 0.3), damping=200.0)

    def cost(stiffness):
        run = po.simulate(po.Scene(r1_soil, SHARP, stiffness, 24.0, 1.0, effects), 1.0, outputs=10)
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
    effects = po.Effects(contact=law(1.3), start="rest", strength_wave=wave(0.7, 0.4))
    scene = po.Scene(po.named_soil("serozem"), SHARP, 1e6, 30.0, 2.0, effects)
    with pytest.raises(po.IntegrationError, match=r"'erk' missed that the share stopped before t = .*: .* tighter"):
        po.simulate(scene, 1.0, accuracy=po.Accuracy("erk", tolerance=6e-3))
    run = po.simulate(scene, 1.0)
    held = dataclasses.replace(run, mode=np.full_like(run.mode, STICK))
    with pytest.raises(po.IntegrationError, match=r"'erk' missed that the share broke loose before t = "):
        refuse_missed_event(held)
    refuse_missed_event(run)
