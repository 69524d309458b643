"""Pressure of the plastic gas on the cavity wall, equation (23), against 120 digits and against its derivation."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.high_precision import assert_close, assert_derivatives, differentiated

import plough_opt as po
from plough_opt.soil.plastic import Cavity, front_radius, surface_pressure, wall_pressure

# The toolkit promises 1e-12; some hundred roundings of 1.1e-16 leave room for a bound ten times sharper.
DIGITS = 1e-13

ONE_LOG = 1 - math.exp(-1)  # without friction the exponent (nu/2 - 1) ln a then is -1: a switch of E(x)
RATIOS = [
    *[1e-12, 1e-9, 1e-6, 1e-3, 0.1, math.nextafter(0.5, 0.0), 0.5, math.nextafter(0.5, 1.0)],
    *[math.nextafter(ONE_LOG, 0.0), ONE_LOG, math.nextafter(ONE_LOG, 1.0), 0.8, 0.99, 1 - 1e-6, 1 - 1e-9],
]
ANGLES = [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.05, 0.5, 1.0, 1.4, 1.569]


def soil(density_ratio, friction_angle, cohesion=2e4, ambient_pressure=101325.0):
    return po.Soil(1400.0, density_ratio, cohesion, friction_angle, 0.45, ambient_pressure)


QUANTITIES = {
    "strength": (lambda *v: wall_pressure(soil(*v)).strength, hp.strength, 4),
    "rate": (lambda *v: wall_pressure(soil(*v)).rate, hp.rate, 2),
    "inertia": (lambda *v: wall_pressure(soil(*v)).inertia, hp.inertia, 2),
}
NAMES = ["density_ratio", "friction_angle", "cohesion", "ambient_pressure"]


@pytest.fixture(scope="module", params=QUANTITIES)
def coefficient(request):
    quantity, precise, size = QUANTITIES[request.param]
    return quantity, precise, size, [differentiated(quantity, symbol, size) for symbol in (ca.SX, ca.MX)]


@pytest.mark.parametrize("density_ratio", RATIOS)
def test_coefficient_with_gradient_and_hessian_up_to_its_singularities(coefficient, density_ratio):
    quantity, precise, size, functions = coefficient
    for friction_angle in ANGLES:
        point = (density_ratio, friction_angle, 2e4, 101325.0)[:size]
        assert_close(quantity(*point), precise(*hp.exact(point)), DIGITS, f"float at {friction_angle}")
        wanted = hp.derivatives(precise, point)
        for function in functions:
            assert_derivatives(function(point), wanted, DIGITS, NAMES[:size])


# density, density ratio, friction angle, cohesion, ambient pressure, R, R', R''
MOTIONS = [
    (1400.0, 0.8, 0.5, 2e4, 101325.0, 0.05, 0.5, 2.0),
    (1400.0, 0.8, 0.0, 2e4, 101325.0, 0.05, 0.5, 2.0),
    (1400.0, 0.8, 1e-6, 2e4, 0.0, 0.05, 0.5, -2.0),
    (1150.0, 0.3, 0.9, 0.0, 1e4, 0.2, 3.0, 40.0),
    (1700.0, 0.95, 0.6, 5e4, 101325.0, 0.01, 30.0, -500.0),
    (1300.0, 1e-6, 0.4, 1e3, 0.0, 0.05, 2.0, 5.0),
    (1600.0, 0.914, 1.4, 3e3, 5e3, 0.03, 0.0, 0.0),
]


@pytest.mark.parametrize("motion", MOTIONS)
def test_pressure_follows_from_the_momentum_of_the_soil_behind_the_front(motion):
    # Not equation (23) but what it is derived from: the field of acceleration, integrated from wall to front.
    density, density_ratio, friction_angle, cohesion, ambient_pressure, *cavity = motion
    ground = po.Soil(density, density_ratio, cohesion, friction_angle, 0.45, ambient_pressure)
    assert_close(surface_pressure(Cavity(*cavity), ground), hp.wall_pressure_by_momentum(*hp.exact(motion)), DIGITS)


def test_soil_with_a_friction_of_30_degrees_by_hand():
    # mu = 1/2, nu = 2/3, a = 8: a^(nu/2) = 2, phi = 3/2, a^(nu/2 - 1) = 1/4; tau0/(1 + mu) = 2 k/sqrt(3).
    p = wall_pressure(soil(0.875, math.asin(0.5), cohesion=math.sqrt(3.0) * 1e3, ambient_pressure=3e3))
    assert p.strength == pytest.approx(1.5 * (2e3 + 2e3), rel=1e-15)
    assert p.inertia == pytest.approx(1.5 / 0.875, rel=1e-15)
    assert p.rate == pytest.approx(1.5 / 0.875 + 2.0 - 0.75 / (0.875 * 4 / 3), rel=1e-15)


def test_arrays_are_taken_element_by_element():
    ratios, angles = (grid.ravel() for grid in np.meshgrid(RATIOS, ANGLES))
    grounds = [soil(float(b), float(t)) for b, t in zip(ratios, angles, strict=True)]
    together = soil(ratios, angles)
    wall = Cavity(0.05, 0.5, 2.0)
    # A few units in the last place: NumPy may take another exponential for whole registers than for one number.
    for name in ("strength", "rate", "inertia"):
        want = [getattr(wall_pressure(ground), name) for ground in grounds]
        np.testing.assert_allclose(getattr(wall_pressure(together), name), want, rtol=1e-14)
    np.testing.assert_allclose(
        surface_pressure(wall, together), [surface_pressure(wall, g) for g in grounds], rtol=1e-14
    )
    np.testing.assert_allclose(front_radius(wall, together), [front_radius(wall, g) for g in grounds], rtol=1e-15)
    walls_together = Cavity(np.array([0.01, 0.1]), np.array([0.0, 2.0]), np.array([-3.0, 3.0]))
    one_by_one = [
        surface_pressure(Cavity(0.01, 0.0, -3.0), grounds[5]),
        surface_pressure(Cavity(0.1, 2.0, 3.0), grounds[5]),
    ]
    np.testing.assert_allclose(surface_pressure(walls_together, grounds[5]), one_by_one, rtol=1e-15)
