"""Grazing: a share under `StickSlip` whose speed just touches zero.

From rest without drag, wave and damper the speed is L' = V0 (1 - cos(omega t)) once the share has broken loose: it
touches zero in every cycle, whatever the stiffness and the tow speed. A slight damper keeps the share moving, and a
slight wave keeps it moving or stops it. Derivatives there are those of slipping on.
"""

import math

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.differences import differences
from helpers.linear_motion import released
from helpers.scenes import scene_of
from scipy.interpolate import CubicHermiteSpline

import plough_opt as po
from plough_opt.motion import checks

STIFFNESS, SPEED = 5e4, 2.0
TIGHT = po.Accuracy("erk", tolerance=1e-13)


def scene(stiffness=STIFFNESS, speed=SPEED, damping=0.0, breakaway=1.0, inertial_drag=False, **effects):
    sticky = {"start": "rest", "contact": po.StickSlip(breakaway), "inertial_drag": inertial_drag}
    return scene_of(stiffness=stiffness, tow_speed=speed, damping=damping, **sticky, **effects)


def waved(amplitude, wavelength):
    return scene(strength_wave=po.StrengthWave(amplitude, wavelength))


def duration(cycles=3.3):
    """Return the time in which the share breaks loose and swings so many times [s]."""
    own = scene()
    return own.reaction.static / (STIFFNESS * SPEED) + cycles * 2.0 * math.pi / own.natural_frequency


def results_of(own, cycles=3.3, accuracy=TIGHT):
    run = po.simulate(own, duration(cycles), accuracy=accuracy, outputs=1)
    return [run.mount_force[-1], run.travel[-1], run.mean_draft, run.force_rms]


def slopes(build, at, cycles=3.3, accuracy=TIGHT):
    """Return the derivatives of the results by the arguments of a scene, a row for each result."""
    x = ca.MX.sym("x", len(at))
    results = ca.vertcat(*results_of(build(*ca.vertsplit(x)), cycles, accuracy))
    return ca.Function("slopes", [x], [ca.jacobian(results, x)])(at).full()


def exact(stiffness, speed, damping, cycles):
    """Return mount force and travel of a share that breaks loose once and slips on, in closed form."""
    static, inertia = scene().reaction.static, scene().inertia
    # It sticks while k0 V0 t + c V0 is below F0.
    loose = (static - damping * speed) / (stiffness * speed)
    first = speed * loose - static / stiffness, speed
    z, rate = released(inertia, damping, stiffness, first, duration(cycles) - loose)
    return np.array([static + stiffness * z + damping * rate, speed * duration(cycles) - z - static / stiffness])


@pytest.mark.parametrize(
    ("cycles", "accuracy", "allowed"),
    [(0.5, TIGHT, 1e-11), (1.5, TIGHT, 1e-11), (3.3, TIGHT, 1e-11), (3.3, None, 1e-8)],
    ids=["no touch", "one touch", "three touches", "three touches by the default"],
)
def test_value_and_derivatives_are_those_of_the_exact_motion(cycles, accuracy, allowed):
    at = np.array([STIFFNESS, SPEED, 0.0])
    # Relative changes of stiffness and speed, and of critical damping.
    scales = np.array([STIFFNESS, SPEED, 2.0 * math.sqrt(STIFFNESS * scene().inertia)])
    value = exact(*at, cycles)
    expected = differences(lambda part: exact(*(at + part * scales), cycles), np.zeros(3))
    # Rounding decides whether a touch of zero counts as a stop, whose duration is then zero.
    assert np.array(results_of(scene(), cycles))[:2] == pytest.approx(value, rel=1e-11)
    found = slopes(scene, at, cycles, accuracy)
    assert np.all(np.isfinite(found))
    # Differences err by about 1e-12.
    assert np.max(np.abs(found[:2] * scales - expected) / value[:, None]) < allowed


def test_a_wave_that_keeps_it_moving_has_that_derivative():
    wavelength = 0.3
    here = np.array(results_of(scene()))
    derivatives = slopes(lambda amplitude: waved(amplitude, wavelength), [0.0])[:, 0]
    assert three_modes.follow(waved(1e-4, wavelength), duration()).count(0, 1) == 0
    size = np.max(np.abs(derivatives / here)) * np.abs(here)
    left = [(np.array(results_of(waved(h, wavelength))) - here) / h - derivatives for h in (2e-4, 1e-4)]
    # A forward difference is of first order.
    assert np.max(np.abs(left[1]) / size) < 2e-3
    assert np.linalg.norm(left[0] / size) / np.linalg.norm(left[1] / size) == pytest.approx(2.0, rel=0.05)


def test_a_wave_that_makes_it_stop_has_another():
    wavelength = 0.1
    # On the side that stops there is a slope too, but another one: the share waits until the mount pulls enough.
    here = results_of(scene())[0]
    derivative = slopes(lambda amplitude: waved(amplitude, wavelength), [0.0])[0, 0]
    assert math.isfinite(derivative)
    books = [three_modes.follow(waved(h, wavelength), duration()) for h in (1e-3, 1e-4)]
    assert all(book.count(0, 1) > 0 for book in books)
    differences = [(results_of(waved(h, wavelength))[0] - here) / h for h in (1e-3, 1e-4)]
    assert differences == pytest.approx(
        [(book.mount_force[-1] - here) / h for book, h in zip(books, (1e-3, 1e-4), strict=True)], rel=1e-6
    )
    assert differences[0] == pytest.approx(differences[1], rel=0.02)
    assert abs(differences[1] - derivative) > 0.2 * abs(derivative)


def grazes(run):
    return [text for text in run.warnings if "nearly stops" in text]


def test_a_warning_names_the_first_touch():
    run = po.simulate(scene(), 2.0)
    (text,) = grazes(run)
    # The mount stretches to the static force, then the share swings about the tow speed: L' = V0 (1 - cos(omega t)).
    assert f"t = {duration(1.0):.2g}" in text
    assert "has no derivative, and derivatives are those of slipping on" in text
    # A stop that was not noticed there changes the speed by as much as its error; outputs add 5e-11 to that.
    assert checks.unnoticed_stops(run, run.scene.natural_frequency, 1e-5) == pytest.approx(1e-5, rel=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_a_speed_is_least_where_its_cubic_between_two_outputs_is(seed):
    """The minimum agrees with the root of the derivative of SciPy's cubic."""
    rng = np.random.default_rng(seed)
    speed, slope = rng.uniform(-1.0, 1.0, 2), rng.uniform(0.1, 2.0, 2) * (-1.0, 1.0)
    cubic = CubicHermiteSpline([0.0, 1.0], speed, slope)
    turns = [x for x in cubic.derivative().roots(extrapolate=False) if cubic(x, 2) > 0.0]
    assert checks._minimum(speed, slope) == pytest.approx(turns[0], rel=1e-12)


@pytest.mark.parametrize(
    "changes", [{"damping": 300.0}, {"breakaway": 1.2}, {"breakaway": 2.0, "damping": 50.0}], ids=str
)
def test_a_motion_that_stops_or_keeps_going_has_no_warning(changes):
    assert not grazes(po.simulate(scene(inertial_drag=True, **changes), 2.0))


def test_a_share_that_begins_to_move_behind_a_ramp_has_no_warning():
    # At the start the speed is rounding, and below zero here.
    soil = po.Soil(1500.0, 0.6, 3.0, 0.3, 0.5, 0.0)
    effects = {"contact": po.StickSlip(), "tow_ramp": 0.0068, "inertial_drag": False, "added_mass": False}
    for speed in np.linspace(0.6, 0.8, 9).tolist():
        own = scene_of(soil, stiffness=2930.0, mass=59.2, tow_speed=speed, **effects)
        assert not grazes(po.simulate(own, 0.00473))
