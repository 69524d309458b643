"""Wedge and cone, equations (5)-(7), against the printed formulas in 120 digits."""

import math

import casadi as ca
import pytest
from helpers import equations
from helpers import high_precision as hp
from helpers.high_precision import assert_close, assert_derivatives, differentiated

import plough_opt as po

# A dozen roundings of 1.1e-16 in numbers that are squared twice.
ROUNDING = 1e-14

WEDGES = [
    *[(math.radians(d), 0.2) for d in (1e-6, 0.1, 5.0, 30.0, 45.0, 60.0, 80.0, 89.0, 89.9, 89.99)],
    *[(1e-8, 0.0), (1e-8, 0.3), (1e-4, 1.5), (0.5, 0.0), (0.5, 1e-9), (0.5, 1.2)],
]
CONES = [1e-8, 0.01, 0.2, 0.7, 1.5]
STEEP_CHISELS = [(0.5, 1.5), (1.4, 1.5), (0.5, 1.57), (0.5, math.radians(89.99)), (1.57, 1.57)]


def wedge_area(*numbers):
    return po.Wedge(*numbers).area


def cone_area(*numbers):
    return po.Cone(*numbers).area


def half_angle(wedge_angle, chisel_angle):
    return po.Wedge(wedge_angle, chisel_angle, 0.3).equivalent_cone().half_angle


EQUATIONS = [
    *[(wedge_area, equations.wedge_area, (*point, 0.3)) for point in WEDGES],
    *[(cone_area, equations.cone_area, (angle, 0.3)) for angle in CONES],
    *[(half_angle, equations.half_angle, point) for point in WEDGES],
]


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize(("equation", "precise", "point"), EQUATIONS)
def test_value_gradient_and_hessian(equation, precise, point, symbol):
    assert_close(equation(*point), precise(*map(hp.mp.mpf, point)), 1e-15, "float")
    # An angle is an exact float, so its tangent is rounded only once and accurate even near 90 degrees.
    found = differentiated(equation, symbol, len(point))(point)
    assert_derivatives(found, hp.derivatives(precise, point), ROUNDING, range(len(point)))


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", STEEP_CHISELS)
def test_half_angle_with_the_chisel_beside_90_degrees(point, symbol):
    value, gradient, hessian = hp.derivatives(equations.half_angle, point)
    got_value, got_gradient, got_hessian = differentiated(half_angle, symbol, 2)(point)
    assert_close(got_value, value, 1e-15, "value")
    # The curvature along the chisel angle is a small difference of terms as large as slope * tan(chisel).
    terms = abs(gradient[1]) * hp.mp.tan(hp.mp.mpf(point[1]))
    for i, j in ((0, 0), (0, 1), (1, 1)):
        assert_close(got_gradient[i], gradient[i], ROUNDING, f"slope {i}")
        scale = terms + abs(hessian[i][j]) if i == j == 1 else None
        assert_close(got_hessian[i, j], hessian[i][j], ROUNDING, f"curvature {i}{j}", scale)


@pytest.mark.parametrize("angle", CONES)
def test_volume_and_mass_of_a_cone(angle):
    tan, height = hp.mp.tan(hp.mp.mpf(angle)), hp.mp.mpf(0.3)
    cone, volume = po.Cone(angle, 0.3), hp.mp.pi * (height * tan) ** 2 * height / 3
    assert_close(cone.slope, tan, 1e-15)
    assert_close(cone.volume, volume, 1e-15)
    assert_close(cone.solid_mass(7850.0), 7850 * volume, 1e-15)


def test_degrees():
    assert po.deg(90.0) == math.pi / 2
    x = ca.SX.sym("x")
    assert float(ca.Function("f", [x], [po.deg(x)])(45.0)) == pytest.approx(math.pi / 4, rel=3e-16)
