"""Oscillation of a share without static load, from rest: the source's two statements on stiffness.

Of M z'' = Fd (V0 - z')^2 - k0 z - c z' with z = 0 and z' = V0 at first. Without damper and drag z is
V0/omega sin(omega t): the amplitude of the mount force is V0 sqrt(k0 M), that of the displacement V0 sqrt(M/k0).
"""

import cmath
import dataclasses
import math

import numpy as np
import pytest

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
