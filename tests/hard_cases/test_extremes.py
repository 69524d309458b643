"""Scenes at the ends of the domain: right by an independent integrator, or refused with a clear message; resonance."""

import dataclasses
import math
import signal
from dataclasses import replace

import numpy as np
import pytest
from helpers import three_modes, wild_scenes
from helpers.scenes import R1_SOIL, RESULTS, SHARP, scene_of

import plough_opt as po

WAVE = po.StrengthWave(0.5, 0.3)
LIMIT = 30
pytestmark = pytest.mark.usefixtures("clock")


def scene(soil=R1_SOIL, share=SHARP, mass=24.0, **changes):
    return scene_of(soil, share, mass=mass, **changes)


def assert_finite(run):
    for name in (*RESULTS, "opening", "mode"):
        assert np.all(np.isfinite(getattr(run, name))), name
    chaotic = any("too sensitive to be predicted at all" in note for note in run.warnings)
    assert chaotic if np.isinf(run.error_estimate) else run.error_estimate >= 0.0


@pytest.fixture
def clock():
    """End a test that hangs."""

    def late(*_):
        raise TimeoutError("the scene took too long")

    signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    yield
    signal.alarm(0)


# --- mounts from nothing to a wall ---


def test_the_stiffest_mount_is_rigid():
    run = po.simulate(scene(stiffness=1e8, damping=2e4, strength_wave=WAVE, tow_ramp=0.2), 0.6)
    rigid = po.simulate(scene(stiffness=1e8, motion=False, strength_wave=WAVE, tow_ramp=0.2), 0.6)
    # The difference is the inertial force M s'' of the ramp, whose mean is M V0/0.6 s.
    inertial = run.scene.inertia * run.scene.tow_speed / 0.6
    assert run.mean_draft - inertial == pytest.approx(rigid.mean_draft, rel=1e-4)


def test_a_wall_without_damper_ends():
    rigid, run = (po.simulate(scene(stiffness=1e12, motion=on, strength_wave=WAVE), 0.1) for on in (False, True))
    assert run.error_estimate <= 1e-8
    assert run.mean_draft == pytest.approx(rigid.mean_draft, rel=1e-4)


# --- soils, shares, mounts and speeds ---

SOILS = {
    "loosest": {"density_ratio": 1e-12},
    "densest": {"density_ratio": 1.0 - 1e-9},
    "no internal friction": {"friction_angle": 0.0},
    "steepest friction": {"friction_angle": po.deg(89.9)},
    "no cohesion": {"cohesion": 0.0},
    "no pressure": {"ambient_pressure": 0.0},
    "polished": {"tool_friction": 0.0},
    "nothing holds it": {"cohesion": 0.0, "ambient_pressure": 0.0, "friction_angle": 0.0, "tool_friction": 0.0},
}


LAWS = {"resisting": "resisting", "smooth": po.Smooth(0.5), "stick and slip": po.StickSlip(1.2)}
TOWED = {"strength_wave": WAVE, "start": "towed"}
FAST = {"tow_speed": 1e3, "strength_wave": po.StrengthWave(0.5, 3.0), "start": "towed"}


def cases():
    """Yield name -> changes of the scene and duration; by default every second case runs."""
    # Only the soil that it carries has mass, until it leaves the soil and a gap opens.
    yield "no weight", ({"mass": 1e-6, "stiffness": 1e3, "contact": po.StickSlip(1.2), "strength_wave": WAVE}, 0.01)
    for law in ("resisting", "stick and slip"):
        yield f"a thousand metres a second, {law}", (FAST | {"contact": LAWS[law]}, 0.05)
        for angle in (1e-8, 1e-3, po.deg(89.0), po.deg(89.99)):
            share = po.Wedge(angle, po.deg(15.0), 0.25)
            yield f"wedge of {angle:g}, {law}", (TOWED | {"share": share, "contact": LAWS[law]}, 0.3)
        for name, changes in SOILS.items():
            soil = dataclasses.replace(R1_SOIL, **changes)
            yield f"{name}, {law}", (TOWED | {"soil": soil, "contact": LAWS[law]}, 0.3)
    yield "no weight, damped", ({"mass": 1e-6, "stiffness": 1e5, "damping": 300.0, "strength_wave": WAVE}, 0.1)
    for name, law in LAWS.items():
        for stiffness, duration in ((1.0, 1.0), (1e2, 1.0), (1e7, 0.02)):
            changes = {"stiffness": stiffness, "contact": law, "strength_wave": WAVE}
            yield f"{stiffness:g} N/m, {name}", (changes, duration)
        for start, entry in (("rest", False), ("rest", True), ("towed", False), ("equilibrium", False)):
            if name != "stick and slip":
                at_rest = {"tow_speed": 0.0, "contact": law, "start": start, "entry": entry}
                yield f"a strut at rest, {start}, {name}{', entry' * entry}", (at_rest, 0.5)


CASES = dict(cases())
# Resistance that keeps its sign, with this much drag, pushes a retreating share ever faster.
REFUSED = {"densest, resisting"}


@pytest.mark.parametrize("name", CASES)
def test_an_independent_solver_agrees_at_the_ends(name):
    changes, duration = CASES[name]
    if name in REFUSED:
        with pytest.raises(po.IntegrationError, match="the resistance drives the share away"):
            po.simulate(scene(**changes), duration)
    else:
        assert_finite(three_modes.agreed(scene(**changes), duration, allowed=5e-8, resistance=20.0)[0])


# --- events by the thousand ---


@pytest.mark.parametrize(
    ("breakaway", "speed", "cycles"),
    [(1.2, 0.1, 10), (1.5, 0.05, 200), pytest.param(1.5, 0.2, 1500, marks=pytest.mark.slow)],
)
def test_breakaway_keeps_an_exact_cycle_alive_for_thousands_of_events(breakaway, speed, cycles):
    effects = {"contact": po.StickSlip(breakaway), "inertial_drag": False, "added_mass": False}
    sticky = scene(stiffness=2e4, tow_speed=speed, start="rest", **effects)
    static, k = sticky.reaction.static, sticky.stiffness
    omega, excess = math.sqrt(k / sticky.mass), (breakaway - 1.0) * static / k
    # It sticks until the spring has stretched by twice the excess, and slips for part of a period in between.
    stuck = 2.0 * excess / speed
    slipping = 2.0 / omega * (math.pi - math.atan(excess * omega / speed))
    first = breakaway * static / (k * speed)
    before_next = 0.4 * stuck
    run = po.simulate(sticky, first + cycles * (stuck + slipping) - before_next, outputs=50)
    assert run.mode[-1] == three_modes.STICK
    assert run.mount_force[-1] == pytest.approx(breakaway * static - k * speed * before_next, rel=1e-8 * cycles)
    assert run.travel[-1] == pytest.approx(cycles * speed * (stuck + slipping), rel=1e-8 * cycles)


# --- samples of the whole domain and every effect ---


@pytest.mark.parametrize(
    "seeds", [pytest.param(range(30), id="30"), pytest.param(range(10_000), id="10000", marks=pytest.mark.slow)]
)
def test_a_sample_of_the_whole_domain(seeds):
    runs, reasons = 0, []
    for seed in seeds:
        drawn = wild_scenes.sampled(seed, most_phase=math.inf, speed_term=True)
        if drawn is None:
            continue
        signal.alarm(10 * LIMIT)
        try:
            run = po.simulate(*drawn[:2], outputs=drawn[2])
        except po.PloughError as refusal:
            reasons.append(str(refusal))
            continue
        runs += 1
        assert_finite(run)
        assert run.force_rms >= 0.0, seed
        if isinstance(run.scene.effects.contact, po.StickSlip):
            assert np.min(run.soil_resistance[run.mode == three_modes.GAP], initial=0.0) == 0.0, seed
            assert np.all(np.isin(np.round(run.mode), (0, 1, 2))), seed
    assert runs > 0.5 * len(seeds)
    assert all(len(reason) > 40 for reason in reasons)


# --- resonance at zero damping over thousands of periods against the exact solution ---

STIFFNESS, WAVELENGTH = 5e4, 0.6


def resonance(soil, growth, periods):
    """Return a scene whose wave passes at its natural frequency and makes the force grow by a part of F0."""
    wave = po.StrengthWave(growth / (math.pi * periods), WAVELENGTH)
    scene = scene_of(soil, SHARP, STIFFNESS, 24.0, 1.0, inertial_drag=False, strength_wave=wave)
    omega = scene.natural_frequency
    return replace(scene, tow_speed=omega * WAVELENGTH / (2.0 * math.pi)), periods * 2.0 * math.pi / omega


def exact(scene, t):
    """Return the deflection's growth to first order in the wave: the next order is some growth F0/(k0 ell) of it.

    M w'' + k w = a sin(W t - d) with W the natural frequency, at rest at first:
    w = a/(2 W M) [sin(W t) cos(d)/W - t cos(W t - d)].
    """
    omega, static = scene.natural_frequency, scene.reaction.static
    d = 2.0 * math.pi * static / STIFFNESS / WAVELENGTH
    a = scene.effects.strength_wave.amplitude * static / scene.inertia
    return a / (2.0 * omega) * (math.cos(d) * np.sin(omega * t) / omega - t * np.cos(omega * t - d))


@pytest.mark.parametrize("periods", [100, 1000])
def test_resonance_without_damping_by_the_default(r1_soil, periods):
    # The default promises 1e-8 of the mean draft. The growth to 1e-4 of it leaves 2e-10 to the next order.
    scene, duration = resonance(r1_soil, 1e-4, periods)
    run = po.simulate(scene, duration, outputs=8 * periods)
    truth = STIFFNESS * exact(scene, run.time)
    assert np.max(np.abs(truth)) == pytest.approx(1e-4 * scene.reaction.static, rel=0.02)
    assert run.error_estimate <= 1e-8
    # So amplitude and phase are right to 1e-4.
    assert np.max(np.abs(run.mount_force - scene.reaction.static - truth)) < 1e-8 * scene.reaction.static
