"""Wedge and cone, equations (5)-(7), against the printed formulas in 120 digits."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.high_precision import assert_close, assert_derivatives, differentiated

import plough_opt as po
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT

# A dozen roundings of 1.1e-16 in numbers that are squared twice.
ROUNDING = 1e-14

WEDGES = [
    *[(math.radians(d), 0.2) for d in (1e-6, 0.1, 5.0, 30.0, 45.0, 60.0, 80.0, 89.0, 89.9, 89.99)],
    *[(1e-8, 0.0), (1e-8, 0.3), (1e-4, 1.5), (0.5, 0.0), (0.5, 1e-9), (0.5, 1.2)],
]


STEEP_CHISELS = [(0.5, 1.5), (1.4, 1.5), (0.5, 1.57), (0.5, math.radians(89.99)), (1.57, 1.57)]


def half_angle_of(wedge_angle, chisel_angle):
    return po.Wedge(wedge_angle, chisel_angle, 0.3).equivalent_cone().half_angle


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", WEDGES)
def test_half_angle_of_the_equivalent_cone(point, symbol):
    assert_close(half_angle_of(*point), hp.half_angle(*hp.exact(point)), 1e-15, "float")
    # The angle is an exact float, so its tangent is rounded only once and accurate even near 90 degrees.
    got = differentiated(half_angle_of, symbol, 2)(point)
    assert_derivatives(got, hp.derivatives(hp.half_angle, point), ROUNDING, ["wedge angle", "chisel angle"])


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", STEEP_CHISELS)
def test_half_angle_with_the_chisel_beside_90_degrees(point, symbol):
    value, gradient, hessian = hp.derivatives(hp.half_angle, point)
    got_value, got_gradient, got_hessian = differentiated(half_angle_of, symbol, 2)(point)
    assert_close(got_value, value, 1e-15, "value")
    # The curvature along the chisel angle is a small difference of terms as large as slope * tan(chisel).
    terms = abs(gradient[1]) * hp.mp.tan(hp.mp.mpf(point[1]))
    for i, j in ((0, 0), (0, 1), (1, 1)):
        assert_close(got_gradient[i], gradient[i], ROUNDING, f"slope {i}")
        scale = terms + abs(hessian[i][j]) if i == j == 1 else None
        assert_close(got_hessian[i, j], hessian[i][j], ROUNDING, f"curvature {i}{j}", scale)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", WEDGES)
def test_area_of_the_wedge(point, symbol):
    def area(wedge_angle, chisel_angle, height):
        return po.Wedge(wedge_angle, chisel_angle, height).area

    point = (*point, 0.3)
    assert_close(area(*point), hp.wedge_area(*hp.exact(point)), 1e-15, "float")
    got = differentiated(area, symbol, 3)(point)
    assert_derivatives(got, hp.derivatives(hp.wedge_area, point), ROUNDING, ["wedge angle", "chisel angle", "height"])


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("half_angle", [1e-8, 0.01, 0.2, 0.7, 1.5])
def test_cone_area_volume_and_mass(half_angle, symbol):
    point = (half_angle, 0.3)
    tan, height = hp.mp.tan(hp.mp.mpf(half_angle)), hp.mp.mpf(0.3)
    cone = po.Cone(*point)
    assert_close(cone.slope, tan, 1e-15)
    assert_close(cone.area, hp.cone_area(*hp.exact(point)), 1e-15)
    assert_close(cone.volume, hp.mp.pi * (height * tan) ** 2 * height / 3, 1e-15)
    assert_close(cone.solid_mass(7850.0), 7850 * hp.mp.pi * (height * tan) ** 2 * height / 3, 1e-15)
    got = differentiated(lambda beta, h: po.Cone(beta, h).area, symbol, 2)(point)
    assert_derivatives(got, hp.derivatives(hp.cone_area, point), ROUNDING, ["half angle", "height"])


def test_degrees():
    assert po.deg(90.0) == math.pi / 2
    assert math.degrees(PLANE_SECTIONS_LIMIT) == pytest.approx(20.0, rel=1e-15)
    degrees = np.array([0.0, 12.5, 60.0])
    np.testing.assert_allclose(po.deg(degrees), np.radians(degrees), rtol=3e-16)
    x = ca.SX.sym("x")
    assert float(ca.Function("f", [x], [po.deg(x)])(45.0)) == pytest.approx(math.pi / 4, rel=3e-16)


WEDGE = {"angle": 0.5, "chisel_angle": 0.2, "height": 0.3}
CONE = {"half_angle": 0.2, "height": 0.3}
NOT_FINITE = (math.nan, math.inf, -math.inf)
BAD = [
    (po.Wedge, WEDGE, "angle", "wedge angle", (0.0, -0.1, math.pi / 2, 2.0, *NOT_FINITE)),
    (po.Wedge, WEDGE, "chisel_angle", "chisel angle", (-1e-9, math.pi / 2, 2.0, *NOT_FINITE)),
    (po.Wedge, WEDGE, "height", "share height", (0.0, -0.3, *NOT_FINITE)),
    (po.Cone, CONE, "half_angle", "half angle", (0.0, -0.1, math.pi / 2, 2.0, *NOT_FINITE)),
    (po.Cone, CONE, "height", "share height", (0.0, -0.3, *NOT_FINITE)),
]


@pytest.mark.parametrize(("kind", "good", "argument", "name", "values"), BAD)
def test_number_outside_the_domain_is_refused_by_name_and_value(kind, good, argument, name, values):
    for value in values:
        for number in (float(value), np.array([good[argument], value]), ca.DM(value), ca.SX(value), ca.MX(value)):
            with pytest.raises(po.DomainError, match=name) as error:
                kind(**(good | {argument: number}))
            assert any(f"{value:.{digits}g}" in str(error.value) for digits in (6, 17))
            assert ("must be finite" in str(error.value)) is not math.isfinite(value)
