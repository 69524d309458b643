"""The reference of the accuracy study: closed forms, 28-digit integration, another solver, and an honest estimate."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers import precise_motion, three_modes
from helpers.scenes import SEROZEM, scene_of

import plough_opt as po
from plough_opt.core.expressions import maximum
from plough_opt.studies.accuracy.reference import EPS, QUANTITIES, errors_of, reference_gradient, reference_run

mp = precise_motion.mp
WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.2)
STRONG = po.StrengthWave(amplitude=0.9, wavelength=0.1)
SMALL = po.Wedge(po.deg(30), po.deg(15), 0.05)
LIGHT = replace(SEROZEM, ambient_pressure=5e3)


def off(found, wanted):
    """Return the distance of a wide float from a precise number."""
    return float(abs(mp.mpf(str(found)) - wanted))


# --- closed forms ---


def oscillation(k, m, V, c, F, T):
    """Return the mount force over time of m z'' + c z' + k z = F with z(0) = 0, z'(0) = V, and its mean up to T."""
    root = mp.sqrt(mp.mpc((c / (2 * m)) ** 2 - k / m))
    one, other = -c / (2 * m) + root, -c / (2 * m) - root
    b = (V + one * F / k) / (other - one)
    parts = [(rate, (k + c * rate) * a) for rate, a in ((one, -F / k - b), (other, b))]
    mean = mp.re(F + sum(a * mp.expm1(rate * T) / (rate * T) for rate, a in parts))
    return lambda t: mp.re(F + sum(a * mp.exp(rate * t) for rate, a in parts)), mean


def from_rest(plain, duration, outputs):
    """Return the reference of a linear oscillation, its mount force and mean in closed form, and their size."""
    numbers = (plain.stiffness, plain.mass, 2.0, plain.effects.damping or 0.0, plain.reaction.static, duration)
    k, m, *others = (mp.mpf(float(x)) for x in numbers)
    pull, mean = oscillation(k, m + mp.mpf(float(plain.reaction.added_mass)), *others)
    pulls = [pull(t) for t in mp.linspace(0, mp.mpf(duration), outputs + 1)]
    return reference_run(plain, duration, outputs=outputs), pull, mean, pulls, float(max(map(abs, pulls)))


def test_a_linear_oscillation_from_rest():
    T = mp.mpf(0.7)
    found, pull, mean, pulls, peak = from_rest(scene_of(start="rest", inertial_drag=False, damping=150.0), 0.7, 7)
    spread = mp.sqrt(mp.quad(lambda t: (pull(t) - mean) ** 2, mp.linspace(0, T, 15)) / T)
    # The rounding of thirty radians of phase is some tens of units in the last place.
    assert max(map(off, found.run.mount_force, pulls)) < 200 * EPS * peak
    assert off(found.run.mean_draft, mean) < 200 * EPS * float(mean)
    assert off(found.run.force_rms, spread) < 200 * EPS * float(mean)
    assert off(found.run.tow_power, mean * 2) < 200 * EPS * float(mean * 2)
    assert found.error < 200 * EPS


def test_the_errors_of_averages_and_of_forces_are_apart():
    # After four hundred radians the rounding of the phase affects every force, but hardly the averages.
    found, _, mean, pulls, peak = from_rest(scene_of(stiffness=5e8, start="rest", inertial_drag=False), 0.1, 50)
    assert off(found.run.mean_draft, mean) < 10 * found.errors["mean draft"] * float(found.run.force_rms)
    wrong = max(map(off, found.run.mount_force, pulls)) / peak
    assert found.errors["averages"] < wrong < 10 * found.errors["trajectory"]
    assert found.error == max(found.errors.values())


# --- 28 digits ---

PRECISE = {
    "wave, drag, rate term and damper": (scene_of(strength_wave=WAVE, damping=400.0, rate_term=0.02), 0.04),
    "ramp": (scene_of(tow_ramp=0.03, strength_wave=WAVE, damping=100.0, start="rest"), 0.04),
    "entry": (scene_of(share=SMALL, start="towed", entry=True, strength_wave=STRONG), 0.04),
    "stick and slip": (scene_of(soil=LIGHT, tow_speed=0.5, start="rest", damping=50.0, contact=po.StickSlip(1.1)), 0.1),
}
ENTERS = scene_of(tow_speed=1.0, start="rest", entry=True, damping=50.0, strength_wave=STRONG)
STICKS = replace(ENTERS, effects=replace(ENTERS.effects, contact=po.StickSlip(1.1)))
SLOWER = {"stick, slip and gap while it enters": (STICKS, 0.5), "retreat while it enters, resisting": (ENTERS, 0.4)}


@pytest.mark.parametrize("name", [*PRECISE, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOWER)])
def test_against_28_digits(name):
    share, duration = {**PRECISE, **SLOWER}[name]
    found = reference_run(share, duration, outputs=2)
    travel, speed, pull, misses = precise_motion.follow(share, found.events, duration)
    way = share.tow_speed * duration
    # Rounding of forces and phases over a few oscillations. A share stops, or turns, at 1e-12 of the tow speed
    # backwards, which changes the motion after that by less than a thousandth of as much.
    tolerance = 1e-15 if "stick" in name or "retreat" in name else 100 * EPS
    assert off(found.run.travel[-1], travel) < tolerance * way
    assert off(found.run.speed[-1], speed) < tolerance * share.tow_speed
    assert off(found.run.mount_force[-1], pull) < tolerance * float(np.max(np.abs(found.run.mount_force)))
    assert all(float(miss) < tolerance for miss in misses)  # mpmath 1.3 cannot compare with NumPy's long doubles
    # The estimate may be below the true error by no more than a small factor.
    true = off(found.run.mount_force[-1], pull) / float(np.max(np.abs(found.run.mount_force)))
    assert true < max(10 * found.error, tolerance / 10)
    assert found.error < tolerance


@dataclass(frozen=True)
class Kinked:
    """Resistance that is constant up to a travel of 0.01 m, and then grows."""

    slope: float

    def force(self, travel, _speed):
        return self.slope * maximum(travel, 0.01)


def test_a_kink_in_an_own_resistance_is_met_with_short_steps():
    share = scene_of(mass=25.0, own=(Kinked(1e4),), start="towed", inertial_drag=False)
    found = reference_run(share, 0.06, outputs=2)
    k, F, V, S, edge, T = (mp.mpf(float(x)) for x in (5e4, share.reaction.static, 2.0, 1e4, 0.01, 0.06))
    M = mp.mpf(float(share.mass)) + mp.mpf(float(share.reaction.added_mass))
    # Travel and speed before the kink and after it.
    before = mp.odefun(lambda t, x: [x[1], (k * (V * t - x[0]) - F - S * edge) / M], 0, [mp.zero, V])
    crossing = mp.findroot(lambda t: before(t)[0] - edge, 0.006)
    after = mp.odefun(lambda t, x: [x[1], (k * (V * t - x[0]) - F - S * x[0]) / M], crossing, before(crossing))
    # The kink costs digits, which the estimate shows.
    peak = float(np.max(np.abs(found.run.mount_force)))
    assert 5e4 * off(found.run.travel[-1], after(T)[0]) < found.error * peak
    assert found.error < 1e-14 * max(1.0, float(EPS) / 1e-19)


# --- another solver ---

OTHERS = {
    "smooth": (scene_of(tow_speed=0.5, strength_wave=STRONG, damping=200.0, contact=po.Smooth(0.2)), 0.1),
    "gap": (scene_of(tow_speed=0.5, strength_wave=STRONG, damping=200.0, contact=po.StickSlip(1.2)), 0.6),
    "entry": (scene_of(tow_speed=1.0, start="towed", entry=True, damping=50.0, contact=po.StickSlip(1.1)), 0.5),
}


@pytest.mark.parametrize("name", OTHERS)
def test_against_another_solver_averages_and_all(name):
    share, duration = OTHERS[name]
    found = reference_run(share, duration, outputs=20)
    other = three_modes.follow(share, duration, outputs=20)
    # The error of SciPy's order 8 at a tolerance of 1e-12.
    assert max(errors_of(other, found.run).values()) < 3e-11
    assert float(found.run.mean_deflection) == pytest.approx(other.mean_deflection, rel=1e-10)
    assert float(found.run.displacement_rms) == pytest.approx(other.displacement_rms, rel=1e-9)
    assert float(found.run.tow_power) == pytest.approx(other.tow_power, rel=1e-10)
    clear = ~other.near_a_change(1e-9)
    assert np.array_equal(found.run.mode[clear].astype(int), other.mode[clear])


ORBITS = {
    # At 1.7 m/s a third of the period, thrice, is more than the period in the widest floats.
    "rounding": ({"tow_speed": 1.7, "strength_wave": WAVE}, 0.2 / 1.7),
    # Two waves of 0.2 m and 0.3 m repeat together after 0.6 m.
    "two waves": ({"strength_wave": (WAVE, po.StrengthWave(0.2, 0.3, 1.0))}, 0.3),
}


@pytest.mark.parametrize("name", ORBITS)
def test_an_orbit_returns_to_where_it_began_and_is_that_of_simulate(name):
    changes, duration = ORBITS[name]
    share = scene_of(damping=400.0, orbit="periodic", **changes)
    found = reference_run(share, outputs=3)
    peak = float(np.max(np.abs(found.run.mount_force)))
    assert abs(found.run.mount_force[-1] - found.run.mount_force[0]) < 100 * EPS * peak
    assert found.error < 200 * EPS
    assert len(found.run.mount_force) == len(found.run.time) == 4
    assert float(found.run.time[-1]) == pytest.approx(duration, rel=1e-15)
    run = po.simulate(share, accuracy=po.Accuracy(error=1e-11), outputs=3)
    assert errors_of(run, found.run)["trajectory"] < 1e-10


def test_errors_are_relative_to_forces_of_any_size():
    found, true = (SimpleNamespace(mean_draft=mean, force_rms=rms, mount_force=np.array(forces))
                   for mean, rms, forces in ((0.3, 0.2, [-0.5, 0.1]), (0.2, 0.4, [-0.8, 0.2])))  # fmt: skip
    parts = {"averages": 0.5, "mean draft": 0.25, "RMS": 0.5, "last force": 0.125, "trajectory": 0.375}
    assert errors_of(found, true) == pytest.approx(parts)


# --- what has no reference ---


@dataclass(frozen=True)
class Tabled:
    """Resistance by a table of the speed, which CasADi looks up in doubles only."""

    size: float

    def force(self, _travel, speed):
        return self.size * ca.interpolant("table", "linear", [[0.0, 1.0, 4.0]], [10.0, 40.0, 50.0])(speed)


@dataclass(frozen=True)
class Held:
    """Resistance that never lets a resting share go."""

    def force(self, _travel, speed):
        return 100.0 + 0.0 * speed

    def at_rest(self, travel):
        return np.inf + travel


WITHOUT_REFERENCE = [
    ({"motion": False}, 1.0, {}, "quasi-static"),
    ({}, None, {}, "duration"),
    ({"own": (Tabled(3.0),)}, 0.1, {}, "wide floats"),
    ({"own": (Held(),), "contact": po.StickSlip(), "start": "rest"}, 0.1, {}, "a force is not finite"),
    ({"contact": po.StickSlip()}, 0.1, {"Motion.next_event": lambda *at: (at[2].start, 0)}, "hangs at t = 0 s"),
    ({}, 0.1, {"_MOST_STEPS": 1, "_CHECKED_EVERY": 1}, "would take more than 1 steps at t = 0 s"),
    ({"damping": 50.0, "strength_wave": WAVE, "orbit": "periodic"}, None, {"_MOST_NEWTON": 1}, "no periodic"),
]


@pytest.mark.parametrize(("effects", "duration", "patches", "said"), WITHOUT_REFERENCE)
def test_what_has_no_reference_says_why(monkeypatch, effects, duration, patches, said):
    for name, value in patches.items():
        monkeypatch.setattr(f"plough_opt.studies.accuracy.reference.{name}", value)
    with pytest.raises(po.PloughError, match=said):
        reference_run(scene_of(**effects), duration)


# --- gradients ---


def test_gradients_of_a_linear_oscillation_in_closed_form():
    plain = scene_of(start="rest", inertial_drag=False)
    found = reference_gradient(plain, 0.3)
    F, added, T = (mp.mpf(float(x)) for x in (plain.reaction.static, plain.reaction.added_mass, 0.3))

    def mean(k, m, V):
        return oscillation(k, m + added, V, mp.zero, F, T)[1]

    at = [mp.mpf(float(getattr(plain, name))) for name in QUANTITIES]
    for j, value in enumerate(at):
        order = tuple(int(i == j) for i in range(3))
        wanted = mp.diff(mean, tuple(at), order) * value
        assert off(found.values[0, j], wanted) < max(found.error, 1e-15) * float(np.max(np.abs(found.values)))
    assert found.error < 1e-12


def test_a_gradient_through_events_is_that_of_the_run():
    share = scene_of(stiffness=2e4, tow_speed=0.2, soil=LIGHT, start="rest", damping=30.0, contact=po.StickSlip(1.2))
    found = reference_gradient(share, 0.4)
    x = ca.MX.sym("x", 3)
    varied = replace(share, **dict(zip(QUANTITIES, ca.vertsplit(x), strict=True)))
    run = po.simulate(varied, 0.4, accuracy=po.Accuracy("erk", tolerance=1e-12))
    slopes = ca.Function("slopes", [x], [ca.jacobian(ca.vertcat(run.mean_draft, run.force_rms), x)])
    at = [float(getattr(share, name)) for name in QUANTITIES]
    size = float(np.max(np.abs(found.values)))
    # The error that the location of events to 1e-12 leaves.
    events = reference_run(share, 0.4).events
    assert {name for _, name in events} == {"move", "stop"}
    assert np.allclose(np.asarray(slopes(at)) * at, found.values.astype(float), rtol=0, atol=1e-8 * size)
    assert found.error < 1e-10
    # At an event it depends on the stiffness whether the event belongs to the run.
    with pytest.raises(po.IntegrationError, match="the events change"):
        reference_gradient(share, float(events[-1][0]))
