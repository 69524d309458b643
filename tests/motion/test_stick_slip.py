"""Stick, slip and gap: against a solver of our own, exact cycles, and the books of energy."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.three_modes import GAP, SLIP, STICK

import plough_opt as po

SHARP = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
MIDDLE = po.Wedge(po.deg(45.0), po.deg(15.0), 0.40)
BLUNT = po.Wedge(po.deg(70.0), po.deg(15.0), 0.40)


def wave(amplitude, wavelength=0.6):
    return po.StrengthWave(amplitude, wavelength)


def law(breakaway=1.0):
    return po.StickSlip(breakaway)


# share, cohesion [Pa], ambient pressure [Pa], stiffness [N/m], mass [kg], speed [m/s], duration [s], effects
SCENES = {
    "one event": (SHARP, 15e3, 1e4, 5e4, 24.0, 0.1, 2.0, {"start": "rest"}),
    "strong wave, slow": (SHARP, 15e3, 1e4, 2e3, 24.0, 0.1, 6.0, {"strength_wave": wave(1.0, 0.3), "start": "rest"}),
    "gap and recapture": (SHARP, 15e3, 1e4, 2e3, 24.0, 2.0, 3.0, {"strength_wave": wave(1.0)}),
    "many gaps": (SHARP, 15e3, 1e4, 1e4, 24.0, 2.0, 3.0, {"strength_wave": wave(1.0), "start": "rest"}),
    "stiff": (SHARP, 15e3, 1e4, 1e6, 24.0, 2.0, 0.5, {"strength_wave": wave(0.8), "start": "rest"}),
    "breakaway 2, towed": (
        SHARP, 15e3, 1e4, 2e3, 24.0, 0.5, 3.0,
        {"contact": law(2.0), "strength_wave": wave(0.5, 0.3), "start": "towed"},
    ),
    "damped": (
        SHARP, 15e3, 1e4, 2e4, 24.0, 1.0, 2.0,
        {"contact": law(2.0), "strength_wave": wave(0.8, 0.1), "start": "rest", "damping": 100.0},
    ),
    "ramp and rate": (
        SHARP, 15e3, 1e4, 2e4, 24.0, 1.0, 2.0,
        {"contact": law(2.0), "strength_wave": wave(0.8), "start": "rest", "tow_ramp": 0.5, "rate_term": 0.1},
    ),
    "ramp from equilibrium": (
        SHARP, 15e3, 1e4, 2e4, 24.0, 1.0, 2.0,
        {"contact": law(1.2), "strength_wave": wave(0.8), "tow_ramp": 0.5, "damping": 100.0},
    ),
    "blunt": (
        BLUNT, 15e3, 1e4, 2e4, 20.0, 1.0, 2.0,
        {"contact": law(1.2), "strength_wave": wave(0.8), "start": "rest"},
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
    "force alone": (
        SHARP, 15e3, 1e4, 1e4, 24.0, 2.0, 2.0,
        {"contact": law(1.2), "strength_wave": wave(1.0), "start": "rest", "inertial_drag": False, "added_mass": False},
    ),
    "no added mass": (BLUNT, 1e3, 0.0, 2e4, 60.0, 2.0, 1.5, {"start": "rest", "added_mass": False}),
}  # fmt: skip
HEAVY = "soil caught again"


def scene_of(soil, name, **changes):
    share, cohesion, pressure, stiffness, mass, speed, duration, effects = SCENES[name]
    soil = dataclasses.replace(soil, cohesion=cohesion, ambient_pressure=pressure)
    effects = po.Effects(**({"contact": law()} | effects | changes))
    return po.Scene(soil, share, stiffness, mass, speed, effects), duration


@pytest.fixture(scope="module")
def solved(r1_soil):
    """Return scene, run and reference of a name, each solved once."""
    known = {}

    def solve(name):
        if name not in known:
            scene, duration = scene_of(r1_soil, name)
            run = po.simulate(scene, duration, outputs=40)
            known[name] = scene, run, three_modes.follow(scene, duration, outputs=40)
        return known[name]

    return solve


def largest(values):
    return float(np.max(np.abs(values)))


# --- against a solver of our own ---


@pytest.mark.parametrize("name", SCENES)
def test_an_independent_solver_agrees(solved, name):
    scene, run, expected = solved(name)
    # Modes and the soil's force jump at an event; the events themselves are found to some 1e-12 of the duration.
    far = ~expected.near_a_change(1e-7 * run.duration)
    assert np.count_nonzero(far) >= 35
    assert list(run.mode[far]) == list(expected.mode[far])
    force = largest(expected.mount_force)
    size = max(abs(expected.mean_draft), expected.force_rms)
    # The run promises 1e-8 of both; the reference is exact to some 1e-11.
    assert largest(run.mount_force - expected.mount_force) < 2e-8 * force
    assert largest((run.soil_resistance - expected.soil_resistance)[far]) < 2e-8 * force
    assert largest(run.opening - expected.opening) < 2e-8 * largest(expected.deflection)
    assert largest((run.speed - expected.speed)[far]) < 1e-7 * largest(expected.speed) + 1e-12 * scene.tow_speed
    for average in ("mean_draft", "force_rms"):
        assert getattr(run, average) == pytest.approx(getattr(expected, average), rel=0, abs=2e-8 * size), average
    for average in ("mean_deflection", "displacement_rms"):
        found = getattr(run, average) * scene.stiffness
        assert found == pytest.approx(getattr(expected, average) * scene.stiffness, rel=0, abs=2e-8 * size), average
    assert run.tow_power == pytest.approx(expected.tow_power, rel=0, abs=2e-8 * size * scene.tow_speed)


@pytest.mark.slow
def test_the_scenes_reach_every_change_of_mode(solved):
    counts = {
        change: sum(solved(name)[2].count(*change) for name in SCENES)
        for change in [(SLIP, STICK), (SLIP, GAP), (STICK, SLIP), (GAP, SLIP)]
    }
    # The strut never goes back, so a sticking share is never pushed back either.
    assert all(count >= 10 for count in counts.values()), counts
    scene, _, expected = solved(HEAVY)
    assert expected.count(GAP, SLIP) >= 1
    assert scene.reaction.added_mass > 0.3 * scene.mass


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_an_independent_solver_agrees_on_sampled_scenes(r1_soil, seed):
    random = np.random.default_rng(seed)
    heavy = random.random() < 0.5
    soil = dataclasses.replace(r1_soil, cohesion=1e3, ambient_pressure=0.0) if heavy else r1_soil
    start = random.choice(["equilibrium", "rest", "towed"])
    effects = po.Effects(
        contact=law(random.choice([1.0, 1.2, 2.0])),
        start=str(start),
        entry=bool(start != "equilibrium" and random.random() < 0.4),
        strength_wave=wave(random.uniform(0.3, 1.0), random.uniform(0.1, 0.8)),
        damping=random.choice([None, random.uniform(0.0, 500.0)]),
        tow_ramp=random.choice([None, random.uniform(0.05, 0.5)]),
        rate_term=random.choice([None, random.uniform(0.0, 0.2)]),
        inertial_drag=bool(random.random() < 0.7),
        added_mass=bool(random.random() < 0.7),
    )
    stiffness, speed = 10 ** random.uniform(3.3, 6.0), 10 ** random.uniform(-1.0, 0.3)
    scene = po.Scene(soil, BLUNT if heavy else SHARP, stiffness, random.uniform(10.0, 60.0), speed, effects)
    run, expected = po.simulate(scene, 1.0, outputs=20), three_modes.follow(scene, 1.0, outputs=20)
    allowed = max(10.0 * run.error_estimate, 1e-9)
    assert largest(run.mount_force - expected.mount_force) <= allowed * largest(expected.mount_force)
    size = max(abs(expected.mean_draft), expected.force_rms)
    assert abs(run.mean_draft - expected.mean_draft) <= allowed * size
    assert abs(run.force_rms - expected.force_rms) <= allowed * size


# --- energy ---


def test_recapture_costs_energy(solved):
    expected = solved(HEAVY)[2]
    assert expected.capture_loss > 0.03 * expected.soil_work
    assert solved("force alone")[2].count(GAP, SLIP) > 0
    assert solved("force alone")[2].capture_loss == 0.0


# --- what the three modes mean ---


@pytest.mark.parametrize("name", SCENES)
def test_soil_only_resists(r1_soil, name):
    scene, duration = scene_of(r1_soil, name)
    run = po.simulate(scene, duration, outputs=1000)
    gap, stick = run.mode == GAP, run.mode == STICK
    furthest = np.maximum.accumulate(run.travel)
    rounding = 1e-8 * largest(run.deflection)
    assert np.min(np.diff(run.travel[~gap])) >= -rounding
    assert largest((furthest - run.travel)[~gap]) <= rounding
    assert np.min(run.speed[~gap]) >= -1e-5 * largest(run.speed)
    assert np.all(run.speed[stick] == 0.0)
    assert np.all(run.soil_resistance[gap] == 0.0)
    assert np.all(run.opening[~gap] == 0.0)
    assert np.all(run.opening[gap] > 0.0)
    hold = np.array([three_modes._Share(scene).hold(travel) for travel in run.travel])
    pull = run.mount_force[stick]
    force = largest(run.mount_force)
    assert np.all(run.soil_resistance[stick] == pull)
    assert np.all((pull >= -1e-8 * force) & (pull <= hold[stick] + 1e-8 * force))


@pytest.mark.parametrize("name", [HEAVY, "many gaps", "damped"])
def test_recaptured_soil_keeps_the_momentum(solved, name):
    scene, _, expected = solved(name)
    capture = next(change for change in expected.changes if (change.old, change.new) == (GAP, SLIP))

    def speed_at(moment):
        return float(po.simulate(scene, moment, outputs=1).speed[-1])

    # A straight line through two speeds on either side reaches the moment of the recapture.
    near = 1e-6
    before = 2.0 * speed_at(capture.time - near) - speed_at(capture.time - 2.0 * near)
    after = 2.0 * speed_at(capture.time + near) - speed_at(capture.time + 2.0 * near)
    assert after / before == pytest.approx(scene.mass / scene.inertia, rel=1e-6)


def test_without_a_wave_the_share_starts_once_and_settles(r1_soil):
    scene, _ = scene_of(r1_soil, "one event", damping=300.0)
    run = po.simulate(scene, 4.0, outputs=4000)
    assert list(run.mode) == sorted(run.mode, reverse=True)
    assert set(run.mode) == {SLIP, STICK}
    moved = run.time[run.mode == SLIP][0]
    share = three_modes._Share(scene)
    assert share.pull(moved, 0.0, 0.0) == pytest.approx(scene.reaction.static, rel=2e-2)
    late = run.time > 2.0
    # exp(-c t/2M) after 2 s is below 1e-5.
    assert run.mount_force[late] == pytest.approx(scene.steady_resistance, rel=1e-4)
    assert run.speed[late] == pytest.approx(scene.tow_speed, rel=1e-3)


@pytest.mark.parametrize(("breakaway", "speed", "cycles"), [(1.2, 0.1, 10), (2.0, 0.5, 50), (1.5, 0.05, 200)])
def test_breakaway_keeps_an_exact_cycle_alive(r1_soil, breakaway, speed, cycles):
    effects = po.Effects(contact=law(breakaway), start="rest", inertial_drag=False, added_mass=False)
    scene = po.Scene(r1_soil, SHARP, 2e4, 24.0, speed, effects)
    static, k = scene.reaction.static, scene.stiffness
    omega, excess = math.sqrt(k / scene.mass), (breakaway - 1.0) * static / k
    # It sticks until the spring has made up the excess on both sides of steady sliding, and swings in between.
    stuck = 2.0 * excess / speed
    slipping = 2.0 / omega * (math.pi - math.atan(excess * omega / speed))
    first = breakaway * static / (k * speed)
    before_next = 0.4 * stuck
    run = po.simulate(scene, first + cycles * (stuck + slipping) - before_next, outputs=50)
    assert run.mode[-1] == STICK
    assert run.mount_force[-1] == pytest.approx(breakaway * static - k * speed * before_next, rel=1e-8 * cycles)
    assert run.travel[-1] == pytest.approx(cycles * speed * (stuck + slipping), rel=1e-8 * cycles)


def test_a_strut_that_stands_still_leaves_the_share_where_it_is(r1_soil):
    for start in ("rest", "towed", "equilibrium"):
        scene = po.Scene(r1_soil, SHARP, 2e4, 24.0, 0.0, po.Effects(contact=law(1.5), start=start))
        run = po.simulate(scene, 1.0, outputs=10)
        assert np.ptp(run.travel) == 0.0
        assert run.mount_force == pytest.approx(scene.reaction.static if start == "equilibrium" else 0.0)


def test_rosenbrock_finds_the_same_events(r1_soil, solved):
    scene, duration = scene_of(r1_soil, "many gaps")
    run = po.simulate(scene, duration, accuracy=po.Accuracy("rosenbrock", tolerance=1e-9), outputs=40)
    expected = solved("many gaps")[2]
    assert run.mean_draft == pytest.approx(expected.mean_draft, rel=1e-6)
    assert run.force_rms == pytest.approx(expected.force_rms, rel=1e-6)


# --- a problem file, and refusals ---

FILE = """
title = "Share that sticks"
[soil]
name = "serozem"
[share]
wedge_angle = "25 deg"
chisel_angle = "15 deg"
height = "0.25 m"
[scene]
tow_speed = "0.5 m/s"
frame_mass = "24 kg"
steel_density = "0 kg/m^3"
stiffness = "20 kN/m"
duration = "1 s"
[effects]
strength_wave = { amplitude = 0.8, wavelength = "0.2 m" }
start = "towed"
"""


@pytest.mark.parametrize(
    ("lines", "contact", "entry"),
    [
        ('contact = "stick_slip"', po.StickSlip(1.0), False),
        ('contact = "stick_slip"\nbreakaway = 1.2', po.StickSlip(1.2), False),
        ('contact = "stick_slip"\nbreakaway = 1.2\nentry = true', po.StickSlip(1.2), True),
        ('contact = "smooth"\ncontact_width = "5 cm/s"', po.Smooth(0.05), False),
        ("entry = true", "resisting", True),
    ],
)
def test_a_problem_file_has_the_same_words(tmp_path, lines, contact, entry):
    path = tmp_path / "share.toml"
    path.write_text(FILE + lines, encoding="utf-8")
    scene = po.read_problem(path).scene()
    assert scene.effects == po.Effects(
        contact=contact, entry=entry, start="towed", strength_wave=po.StrengthWave(0.8, 0.2)
    )
    same = po.Scene(po.named_soil("serozem"), SHARP, 2e4, 24.0, 0.5, scene.effects)
    found, expected = (po.simulate(s, 1.0, outputs=10).mean_draft for s in (scene, same))
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('contact = "smooth"', "contact_width"),
        ("breakaway = 1.2", "breakaway"),
        ('contact = "stick_slip"\ncontact_width = "5 cm/s"', "contact_width"),
        ('contact = "stick_slip"\nbreakaway = 0.5', "breakaway"),
        ('contact = "sticky"', "stick_slip"),
    ],
)
def test_a_problem_file_that_asks_for_no_law_is_refused(tmp_path, lines, said):
    path = tmp_path / "share.toml"
    path.write_text(FILE + lines, encoding="utf-8")
    with pytest.raises(po.PloughError, match=said):
        po.read_problem(path).scene()


@pytest.mark.parametrize("method", ["dop853", "cvodes", "idas", "collocation", "rk"])
@pytest.mark.parametrize("effects", [{"contact": law()}, {"entry": True}], ids=["contact", "entry"])
@pytest.mark.parametrize("speed", [1.0, ca.MX.sym("speed")], ids=["number", "symbol"])
def test_methods_that_find_no_events_are_refused(r1_soil, method, effects, speed):
    scene = po.Scene(r1_soil, SHARP, 2e4, 24.0, speed, po.Effects(start="rest", **effects))
    with pytest.raises(po.InputError, match=f"'{method}' finds no events.*'erk' or 'rosenbrock'"):
        po.simulate(scene, 1.0, accuracy=po.Accuracy(method))


def test_sx_symbols_are_refused(r1_soil):
    for effects in ({"contact": law()}, {"entry": True}):
        scene = po.Scene(r1_soil, SHARP, ca.SX.sym("k"), 24.0, 1.0, po.Effects(start="rest", **effects))
        with pytest.raises(po.InputError, match=r"takes MX symbols only: make the scene of casadi\.MX"):
            po.simulate(scene, 1.0)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: po.Smooth(0.0), "width of the smooth contact = 0 m/s must be above 0"),
        (lambda: po.Smooth(-1.0), "width of the smooth contact = -1 m/s must be above 0"),
        (lambda: po.Smooth(math.nan), "width of the smooth contact = nan"),
        (lambda: po.StickSlip(0.999), "breakaway ratio = 0.999 must be at least 1"),
        (lambda: po.StickSlip(math.inf), "breakaway ratio = inf must be finite"),
        (lambda: po.Effects(contact=po.StickSlip), "must be 'resisting', Smooth"),
        (lambda: po.Effects(entry=True), "entry begins at first contact"),
        (lambda: po.Effects(motion=False, contact=law()), "a contact law needs motion"),
        (lambda: po.Effects(motion=False, contact=po.Smooth(0.1)), "a contact law needs motion"),
        (lambda: po.Effects(motion=False, start="towed"), "needs motion"),
        (lambda: po.Effects(motion=False, start="rest", entry=True), "needs motion"),
        (lambda: po.Effects(contact=law(), formulation="printed"), "the print knows no contact law"),
        (lambda: po.Effects(contact=po.Smooth(0.1), formulation="printed"), "the print knows no contact law"),
    ],
)
def test_what_has_no_meaning_is_refused(build, said):
    with pytest.raises(po.PloughError, match=said):
        build()
