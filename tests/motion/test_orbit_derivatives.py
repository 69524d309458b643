"""Derivatives of the periodic orbit and its approximations, against differences of order 8."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.scenes import R1_SOIL, SHARP, scene_of

import plough_opt as po

CHOICES = ["periodic", "linearised", po.HarmonicBalance(3)]
# Stiffness, mass, tow speed, wavelength, amplitude and damping.
PLACES = {
    "between": (3e4, 25.0, 2.0, 0.6, 0.5, 300.0),
    "soft": (4e3, 25.0, 2.0, 0.6, 0.3, 150.0),
    "stiff, strongest": (1.5e5, 25.0, 1.5, 0.4, 0.97, 1e3),
    "beside resonance": (1.3e4, 25.0, 2.0, 0.6, 0.3, 250.0),
}
# The others are slow, and of the same kind.
FEW = [pytest.param(name, marks=() if name == "stiff, strongest" else pytest.mark.slow) for name in PLACES]


def results(values, choice):
    stiffness, mass, speed, wavelength, amplitude, damping = values
    effects = {"strength_wave": po.StrengthWave(amplitude, wavelength), "damping": damping, "orbit": choice}
    scene = scene_of(R1_SOIL, SHARP, stiffness, mass, speed, **effects)
    # At most 0.2 rad per step of order 8, which leaves rounding.
    run = po.simulate(scene, accuracy=po.Accuracy("dop853", steps=120), outputs=48)
    averages = [run.mean_draft, run.force_rms, run.mean_deflection, run.displacement_rms, run.tow_power]
    at_times = [run.deflection[16], run.mount_force[24], run.soil_resistance[7], run.speed[12], run.duration]
    return averages + at_times


@cache
def functions(choice):
    """Return the Functions of values and Jacobian, and of the Hessian of a weighted sum, for a kind of orbit."""
    x, weights = ca.MX.sym("x", 6), ca.MX.sym("weights", 10)
    found = ca.vertcat(*results(ca.vertsplit(x), choice))
    first = ca.Function("first", [x], [found, ca.jacobian(found, x)])
    return first, ca.Function("second", [x, weights], [ca.hessian(ca.dot(weights, found), x)[0]])


@pytest.mark.parametrize("place", FEW)
@pytest.mark.parametrize("choice", CHOICES)
def test_gradients_and_hessians_are_those_of_differences(choice, place):
    first, second = functions(choice)
    at = np.array(PLACES[place])
    value, slopes = (np.asarray(result) for result in first(at))
    value = value.ravel()
    assert value == pytest.approx([float(one) for one in results(PLACES[place], choice)], rel=1e-9)
    weights = np.cos(np.arange(10)) / np.abs(value)  # so that no result hides behind a larger one
    bends = np.asarray(second(at, weights)) * np.outer(at, at)
    assert bends == pytest.approx(bends.T, rel=1e-9, abs=1e-9)
    # Along a direction in which all quantities change.
    along = np.array([1.0, -0.8, 0.6, 0.9, -0.7, 0.5])

    def both(t):
        values, gradients = (np.asarray(result) for result in first(at * (1.0 + t * along)))
        return np.concatenate([values.ravel(), weights @ gradients])

    slope, row = np.split(differences(both, np.zeros(1), 2e-3).ravel(), [10])
    # Errors of 1e-14 over steps of 2e-3, and the truncation of order 8 near the resonance.
    assert slopes @ (at * along) == pytest.approx(slope, rel=0, abs=3e-9 * np.max(np.abs(value)))
    assert bends @ along == pytest.approx(row * at, rel=0, abs=1e-8 * np.max(np.abs(bends)))


@pytest.mark.parametrize("choice", CHOICES)
def test_derivatives_are_finite_and_right_without_amplitude(choice):
    first, second = functions(choice)
    at, some = np.array([3e4, 25.0, 2.0, 0.6, 0.0, 300.0]), np.array([3e4, 25.0, 2.0, 0.6, 1e-4, 300.0])
    value, slopes = (np.asarray(result) for result in first(at))
    for part in (value, slopes, np.asarray(second(at, np.ones(10)))):
        assert np.all(np.isfinite(part))
    change = (np.asarray(first(some)[0]) - value) / 1e-4
    # The deflection changes in proportion to the amplitude, with a correction of first order in it ...
    assert slopes[5, 4] == pytest.approx(change[5, 0], rel=1e-3)
    # ... and the mean draft by its square.
    assert slopes[0, 4] == pytest.approx(0.0, abs=1e-9 * value[0, 0])
    # Derivatives by other quantities are those of steady sliding, on which c has no effect.
    deflection = value[2, 0]
    assert slopes[2, 0] == pytest.approx(-deflection / 3e4, rel=1e-9)
    assert slopes[2, [1, 3, 5]] == pytest.approx(np.zeros(3), abs=1e-12 * deflection)
