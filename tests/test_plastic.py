"""Pressure of the plastic gas on the cavity wall, equation (23), against 120 digits and against its derivation."""

import math

import casadi as ca
import pytest
from helpers import high_precision as hp
from helpers.high_precision import assert_close, assert_derivatives, differentiated

import plough_opt as po
from plough_opt.soil.plastic import wall_pressure

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
