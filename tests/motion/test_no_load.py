"""Oscillation of a share without static load, from rest: the source's two statements on stiffness.

Of M z'' = Fd (V0 - z')^2 - k0 z - c z' with z = 0 and z' = V0 at first. Without damper and drag z is
V0/omega sin(omega t): the amplitude of the mount force is V0 sqrt(k0 M), that of the displacement V0 sqrt(M/k0).
"""

import cmath
import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import brentq

import plough_opt as po

SHARE = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
MASS = 24.0
FINE = po.Accuracy("dop853", steps=400)
CONTACTS = ("resisting", po.StickSlip(1.5))


@pytest.fixture
def unloaded(r1_soil):
    """Build a scene of soil without strength: no cohesion, and the ambient pressure off."""
    soil = dataclasses.replace(r1_soil, cohesion=0.0)

    def build(stiffness=5e4, speed=2.0, *, drag=False, **effects):
        chosen = po.Effects(start="rest", inertial_drag=drag, ambient_pressure=False, **effects)
        scene = po.Scene(soil, SHARE, stiffness, MASS, speed, chosen)
        assert scene.reaction.static == 0.0
        return scene

    return build


def ideal(scene):
    """Return the amplitudes of mount force [N] and displacement [m] without damping."""
    return (
        scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia),
        scene.tow_speed * math.sqrt(scene.inertia / scene.stiffness),
    )


def at(scene, moment):
    """Return the run to a moment."""
    accuracy = None if scene.effects.events else FINE
    return po.simulate(scene, moment, accuracy=accuracy, outputs=1)


def turn(scene, quarters):
    """Return the spring's deflection where it turns, after some quarters of a period: there the share has speed V0."""
    about = quarters * math.pi / 2.0 / scene.natural_frequency
    moment = brentq(lambda t: at(scene, t).speed[-1] - scene.tow_speed, 0.8 * about, 1.2 * about, xtol=1e-15)
    return at(scene, moment).deflection[-1]


# --- the leading terms ---


@pytest.mark.parametrize("contact", CONTACTS, ids=["resisting", "stick_slip"])
@pytest.mark.parametrize("stiffness", [1e3, 5e4, 1e6])
def test_the_amplitudes_without_damping(unloaded, stiffness, contact):
    scene = unloaded(stiffness, contact=contact)
    force, displacement = ideal(scene)
    quarter = math.pi / 2.0 / scene.natural_frequency
    run = po.simulate(scene, 3.0 * quarter, accuracy=None if scene.effects.events else FINE, outputs=300)
    # Order 8 in steps of 0.01 rad leaves rounding; the default that finds events promises 1e-8.
    allowed = 1e-8 if scene.effects.events else 1e-13
    assert run.mount_force[100] == max(run.mount_force) == pytest.approx(force, rel=allowed)
    assert run.deflection[100] == max(run.deflection) == pytest.approx(displacement, rel=allowed)
    assert run.mount_force[-1] == pytest.approx(-force, rel=2.0 * allowed)
    assert run.mount_force == pytest.approx(force * np.sin(run.time / quarter * math.pi / 2.0), abs=allowed * force)


def test_stiffness_raises_the_force_and_lowers_the_displacement_by_the_square_root(unloaded):
    stiffness = np.geomspace(1e3, 1e6, 7)
    scenes = [unloaded(float(k)) for k in stiffness]
    runs = [at(scene, math.pi / 2.0 / scene.natural_frequency) for scene in scenes]
    force, displacement = ([getattr(run, name)[-1] for run in runs] for name in ("mount_force", "deflection"))
    assert np.diff(np.log(force)) / np.diff(np.log(stiffness)) == pytest.approx(0.5, abs=1e-12)
    assert np.diff(np.log(displacement)) / np.diff(np.log(stiffness)) == pytest.approx(-0.5, abs=1e-12)


def test_stiffness_does_so_with_drag_and_damper_too(unloaded):
    scenes = [unloaded(k, drag=True, damping=20.0) for k in (1e4, 2e4, 4e4)]
    duration = math.pi / scenes[0].natural_frequency
    runs = [po.simulate(scene, duration, outputs=400) for scene in scenes]
    force, displacement = [max(run.mount_force) for run in runs], [max(run.deflection) for run in runs]
    assert force == sorted(force)
    assert displacement == sorted(displacement, reverse=True)
    # A damping ratio below 0.03 takes less than 5 per cent off; most of that cancels between neighbours.
    assert np.diff(np.log(force)) / math.log(2.0) == pytest.approx(0.5, abs=0.02)
    assert np.diff(np.log(displacement)) / math.log(2.0) == pytest.approx(-0.5, abs=0.02)


def test_mass_and_speed_enter_by_their_powers(unloaded):
    first = unloaded()
    heavier = dataclasses.replace(first, mass=4.0 * first.inertia - first.reaction.added_mass)
    faster = dataclasses.replace(first, tow_speed=3.0 * first.tow_speed)
    force, displacement = (
        {
            name: getattr(at(scene, math.pi / 2.0 / scene.natural_frequency), array)[-1]
            for name, scene in {"first": first, "heavier": heavier, "faster": faster}.items()
        }
        for array in ("mount_force", "deflection")
    )
    for values in (force, displacement):
        assert values["heavier"] / values["first"] == pytest.approx(2.0, rel=1e-12)
        assert values["faster"] / values["first"] == pytest.approx(3.0, rel=1e-12)


# --- a damper ---


def damped_peaks(zeta):
    """Return the first peaks of force and displacement, as parts of the ideal ones, exactly.

    With lambda = omega exp(i psi), cos(psi) = -zeta, z is V0/omega_d Im exp(lambda t) and P = -M z'', so that P turns
    where Im exp(lambda t + 3 i psi) = 0, at omega_d t = 2 pi - 3 psi, and z at omega_d t = pi - psi.
    """
    psi = cmath.phase(complex(-zeta, math.sqrt(1.0 - zeta**2)))
    decay = zeta / math.sqrt(1.0 - zeta**2)
    return math.exp(-decay * (2.0 * math.pi - 3.0 * psi)), math.exp(-decay * (math.pi - psi))


def peaks_under_a_damper(scene, zeta):
    """Return the same of a scene, simulated to the two moments."""
    psi, damped = math.acos(-zeta), scene.natural_frequency * math.sqrt(1.0 - zeta**2)
    force, displacement = ideal(scene)
    ends = (2.0 * math.pi - 3.0 * psi) / damped, (math.pi - psi) / damped
    return at(scene, ends[0]).mount_force[-1] / force, at(scene, ends[1]).deflection[-1] / displacement


def with_damper(unloaded, zeta, stiffness=5e4):
    critical = 2.0 * math.sqrt(stiffness * unloaded(stiffness).inertia)
    return unloaded(stiffness, damping=zeta * critical)


@pytest.mark.parametrize("stiffness", [1e3, 1e6])
@pytest.mark.parametrize("zeta", [1e-4, 0.02, 0.2])
def test_a_damper_takes_off_what_the_closed_form_says(unloaded, stiffness, zeta):
    scene = with_damper(unloaded, zeta, stiffness)
    force, displacement = damped_peaks(zeta)
    assert peaks_under_a_damper(scene, zeta) == pytest.approx((force, displacement), rel=1e-13)
    # They are the largest of a run past them.
    run = po.simulate(scene, math.pi / scene.natural_frequency, accuracy=FINE, outputs=400)
    assert max(run.mount_force) == pytest.approx(force * ideal(scene)[0], rel=2e-5)
    assert max(run.deflection) == pytest.approx(displacement * ideal(scene)[1], rel=2e-5)


def test_to_first_order_a_damper_takes_off_a_quarter_turn_times_its_ratio(unloaded):
    ratios = [8e-3, 4e-3, 2e-3]
    left = np.array(
        [
            np.subtract(peaks_under_a_damper(with_damper(unloaded, zeta), zeta), 1.0 - zeta * math.pi / 2.0)
            for zeta in ratios
        ]
    )
    # Of second order: pi^2/8 + 1 of displacement and pi^2/8 + 3 of force, times zeta^2. The third order is zeta of it.
    for found, second in zip(left.T, (math.pi**2 / 8.0 + 3.0, math.pi**2 / 8.0 + 1.0), strict=True):
        assert found / np.square(ratios) == pytest.approx(second, rel=0.05)
        assert found[:-1] / found[1:] == pytest.approx(4.0, rel=0.02)


# --- drag ---


def drag_ratio(scene):
    """Return Fd V0/sqrt(k0 M), which is the damping ratio of the motion linearised about steady sliding."""
    return scene.reaction.drag * scene.tow_speed / math.sqrt(scene.stiffness * scene.inertia)


# With x = z omega/V0 and tau = omega t, x'' + x = delta (1 - x')^2 has x = sin(tau) + delta x1 with
# x1 = 3/2 (1 - cos(tau)) - tau sin(tau) - (cos(2 tau) - cos(tau))/6. Where x turns, a shift of tau counts twice.
FIRST_TURN = 5.0 / 3.0 - math.pi / 2.0
SECOND_TURN = 5.0 / 3.0 + 3.0 * math.pi / 2.0


def dragged(unloaded, speeds=(8.0, 4.0, 2.0, 1.0)):
    """Return scenes with ever less drag, their drag ratios, and the deflections at both turns as parts of the ideal."""
    scenes = [unloaded(speed=speed, drag=True) for speed in speeds]
    turns = np.array([[turn(scene, quarters) / ideal(scene)[1] for quarters in (1, 3)] for scene in scenes])
    return scenes, np.array([drag_ratio(scene) for scene in scenes]), turns


def test_drag_alone_to_first_order(unloaded):
    scenes, delta, turns = dragged(unloaded)
    assert 1e-4 < delta[-1] < delta[0] < 2e-2
    left = turns - np.array([1.0, -1.0]) - delta[:, None] * np.array([FIRST_TURN, SECOND_TURN])
    for residual in left.T:
        assert residual[:-1] / residual[1:] == pytest.approx(4.0, rel=0.1)
    # The nearer to none the nearer to four.
    off = np.abs(left[:-1] / left[1:] - 4.0)
    assert np.all(off[1:] < 0.6 * off[:-1])
    # The mount force of an undamped mount is k0 z: its peak is that of the displacement, but for k0.
    run = po.simulate(scenes[0], math.pi / scenes[0].natural_frequency, accuracy=FINE, outputs=400)
    assert max(run.mount_force) / ideal(scenes[0])[0] == pytest.approx(turns[0, 0], rel=2e-5)


def test_drag_shifts_the_middle_and_takes_off_the_swing_like_its_linear_damper(unloaded):
    _, delta, turns = dragged(unloaded)
    swing, middle = (turns[:, 0] - turns[:, 1]) / 2.0, (turns[:, 0] + turns[:, 1]) / 2.0
    # Half a turn under a damper of the ratio delta takes off delta pi: half of pi/2 and 3 pi/2 together.
    taken = (1.0 - swing) / delta
    assert taken[-1] == pytest.approx(math.pi, rel=4.0 * delta[-1])
    assert middle[-1] / delta[-1] == pytest.approx((FIRST_TURN + SECOND_TURN) / 2.0, rel=4.0 * delta[-1])


def test_nothing_but_the_drag_ratio_counts(unloaded):
    # x'' + x = delta (1 - x')^2 to every order: speed and stiffness do not enter by themselves.
    _, delta, turns = dragged(unloaded, speeds=(8.0,))
    other = unloaded(stiffness=5e3, speed=1.0, drag=True)
    same = dataclasses.replace(other, tow_speed=other.tow_speed * delta[0] / drag_ratio(other))
    assert drag_ratio(same) == pytest.approx(delta[0], rel=1e-14)
    assert turn(same, 1) / ideal(same)[1] == pytest.approx(turns[0, 0], rel=1e-12)
