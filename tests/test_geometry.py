"""Wedge and cone, equations (5)-(7), against the printed formulas in 120 digits."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.high_precision import assert_close, assert_derivatives
from hypothesis import given, settings
from hypothesis import strategies as st

import plough_opt as po
from plough_opt.core import expressions as ex
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT

# Fixed examples, so that a run can be repeated.
repeatable = settings(deadline=None, derandomize=True, max_examples=60)

# A dozen roundings of 1.1e-16, squared twice.
ROUNDING = 1e-14

WEDGES = [
    *[(math.radians(d), 0.2) for d in (1e-6, 0.1, 5.0, 30.0, 45.0, 60.0, 80.0, 89.0, 89.9, 89.99)],
    *[(1e-8, 0.0), (1e-8, 0.3), (1e-4, 1.5), (0.5, 0.0), (0.5, 1e-9), (0.5, 1.2)],
]


STEEP_CHISELS = [(0.5, 1.5), (1.4, 1.5), (0.5, 1.57), (0.5, math.radians(89.99)), (1.57, 1.57)]


def half_angle_of(wedge_angle, chisel_angle):
    return po.Wedge(wedge_angle, chisel_angle, 0.3).equivalent_cone().half_angle


def differentiated(quantity, symbol, size):
    """Return a Function from a vector to value, gradient and Hessian, by automatic differentiation."""
    x = symbol.sym("x", size)
    y = quantity(*ca.vertsplit(x))
    hessian, gradient = ca.hessian(y, x)
    return ca.Function("f", [x], [y, gradient, hessian])


def arrays(function, point):
    value, gradient, hessian = (part.full() for part in function(point))
    return value[0, 0], gradient[:, 0], hessian


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", WEDGES)
def test_half_angle_of_the_equivalent_cone(point, symbol):
    assert_close(half_angle_of(*point), hp.half_angle(*hp.exact(point)), 1e-15, "float")
    # The angle is an exact float, so its tangent rounds only once and nothing is given away beside 90 degrees.
    got = arrays(differentiated(half_angle_of, symbol, 2), point)
    assert_derivatives(got, hp.derivatives(hp.half_angle, point), ROUNDING, ["wedge angle", "chisel angle"])


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", STEEP_CHISELS)
def test_half_angle_with_the_chisel_beside_90_degrees(point, symbol):
    value, gradient, hessian = hp.derivatives(hp.half_angle, point)
    got_value, got_gradient, got_hessian = arrays(differentiated(half_angle_of, symbol, 2), point)
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
    got = arrays(differentiated(area, symbol, 3), point)
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
    got = arrays(differentiated(lambda beta, h: po.Cone(beta, h).area, symbol, 2), point)
    assert_derivatives(got, hp.derivatives(hp.cone_area, point), ROUNDING, ["half angle", "height"])


def test_cone_of_sixty_degrees_by_hand():
    cone = po.Cone(half_angle=math.pi / 6, height=math.sqrt(3.0))  # base radius 1, slant height 2
    assert cone.area == pytest.approx(2 * math.pi, rel=1e-15)
    assert cone.volume == pytest.approx(math.pi / math.sqrt(3.0), rel=1e-15)
    assert cone.solid_mass(3.0) == pytest.approx(math.pi * math.sqrt(3.0), rel=1e-15)


def test_degrees():
    assert po.deg(90.0) == math.pi / 2
    assert math.degrees(PLANE_SECTIONS_LIMIT) == pytest.approx(20.0, rel=1e-15)
    degrees = np.array([0.0, 12.5, 60.0])
    np.testing.assert_allclose(po.deg(degrees), np.radians(degrees), rtol=3e-16)
    x = ca.SX.sym("x")
    assert float(ca.Function("f", [x], [po.deg(x)])(45.0)) == pytest.approx(math.pi / 4, rel=3e-16)


def test_slender_wedge_has_the_half_angle_of_the_leading_term():
    # sin(beta) -> 1/(2p) = tan(lambda)/(pi cos^2(chisel)); the next term is smaller by (1/2p)^2 = 1e-17.
    beta = po.Wedge(1e-8, 0.4, 0.3).equivalent_cone().half_angle
    assert beta == pytest.approx(1e-8 / (math.pi * math.cos(0.4) ** 2), rel=1e-15)


angle = st.floats(1e-6, math.radians(89.0))
chisel = st.floats(0.0, math.radians(80.0))
height = st.floats(1e-3, 10.0)


@repeatable
@given(angle, chisel, height)
def test_equivalent_cone_has_equal_height_and_area(wedge_angle, chisel_angle, share_height):
    share = po.Wedge(wedge_angle, chisel_angle, share_height)
    cone = share.equivalent_cone()
    assert cone.height == share_height
    # Rounding the half angle to a float costs tan(beta)/cos(beta) some eps * beta (1 + sin^2)/(sin cos).
    beta = cone.half_angle
    conditioning = beta * (1 + math.sin(beta) ** 2) / (math.sin(beta) * math.cos(beta))
    assert cone.area == pytest.approx(share.area, rel=1e-15 + 3e-16 * conditioning)


@repeatable
@given(angle, chisel, height)
def test_printed_relation_of_the_angles_holds(wedge_angle, chisel_angle, share_height):
    # (7) cleared of its cancelling difference: sin^2(beta) + 2 p sin(beta) = 1.
    sine = math.sin(po.Wedge(wedge_angle, chisel_angle, share_height).equivalent_cone().half_angle)
    p = math.pi * math.cos(chisel_angle) ** 2 / (2 * math.tan(wedge_angle))
    assert sine**2 + 2 * p * sine == pytest.approx(1.0, rel=3e-15)


@repeatable
@given(angle, st.floats(0.01, math.radians(80.0)), st.floats(1.001, 1.2))
def test_half_angle_grows_with_wedge_and_chisel_angle(wedge_angle, chisel_angle, factor):
    beta = half_angle_of(wedge_angle, chisel_angle)
    assert half_angle_of(min(wedge_angle * factor, 1.57), chisel_angle) > beta
    assert half_angle_of(wedge_angle, min(chisel_angle * factor, 1.57)) > beta


@repeatable
@given(angle, chisel, height, st.floats(0.01, 100.0))
def test_areas_scale_with_the_square_of_the_height(wedge_angle, chisel_angle, share_height, factor):
    share, larger = (po.Wedge(wedge_angle, chisel_angle, h) for h in (share_height, share_height * factor))
    assert larger.area == pytest.approx(share.area * factor**2, rel=1e-15)
    cone, larger_cone = share.equivalent_cone(), larger.equivalent_cone()
    assert larger_cone.half_angle == cone.half_angle
    assert larger_cone.area == pytest.approx(cone.area * factor**2, rel=1e-15)
    assert larger_cone.volume == pytest.approx(cone.volume * factor**3, rel=2e-15)


def test_angles_that_give_one_half_angle_cannot_be_told_apart():
    # Equal tan(lambda)/cos^2(chisel): a narrow wedge with a steep chisel is the same cone as a wide one without.
    steep = po.Wedge(0.3, 0.6, 0.3)
    wide = po.Wedge(math.atan(math.tan(0.3) / math.cos(0.6) ** 2), 0.0, 0.3)
    assert wide.equivalent_cone().half_angle == pytest.approx(steep.equivalent_cone().half_angle, rel=1e-15)
    assert wide.area == pytest.approx(steep.area, rel=1e-15)


def test_arrays_are_taken_element_by_element():
    angles, chisels, heights = np.array([1e-8, 0.3, 1.5]), np.array([0.0, 0.2, 1.2]), np.array([0.01, 0.3, 2.0])
    share = po.Wedge(angles, chisels, heights)
    cone = share.equivalent_cone()
    one_by_one = [po.Wedge(*map(float, row)) for row in zip(angles, chisels, heights, strict=True)]
    # Two units in the last place: NumPy may take another tangent for whole registers than for one number.
    np.testing.assert_allclose(share.area, [w.area for w in one_by_one], rtol=5e-16)
    for name in ("half_angle", "height", "slope", "area", "volume"):
        want = [getattr(w.equivalent_cone(), name) for w in one_by_one]
        np.testing.assert_allclose(getattr(cone, name), want, rtol=5e-15)
    assert np.shape(po.Wedge(0.3, 0.2, heights).area) == (3,)


WEDGE = {"angle": 0.5, "chisel_angle": 0.2, "height": 0.3}
CONE = {"half_angle": 0.2, "height": 0.3}
BAD = [
    *[(po.Wedge, WEDGE, "angle", "wedge angle", v) for v in (0.0, -0.1, math.pi / 2, 2.0)],
    *[(po.Wedge, WEDGE, "chisel_angle", "chisel angle", v) for v in (-1e-9, math.pi / 2, 2.0)],
    *[(po.Wedge, WEDGE, "height", "share height", v) for v in (0.0, -0.3)],
    *[(po.Cone, CONE, "half_angle", "half angle", v) for v in (0.0, -0.1, math.pi / 2, 2.0)],
    *[(po.Cone, CONE, "height", "share height", v) for v in (0.0, -0.3)],
]
NOT_FINITE = [
    (kind, good, argument, name, value)
    for kind, good, argument, name in {(k, tuple(g.items()), a, n) for k, g, a, n, _ in BAD}
    for value in (math.nan, math.inf, -math.inf)
]


@pytest.mark.parametrize(("kind", "good", "argument", "name", "value"), BAD + sorted(NOT_FINITE, key=str))
def test_number_outside_the_domain_is_refused_by_name_and_value(kind, good, argument, name, value):
    good = dict(good)
    kinds = [float(value), np.array([good[argument], value]), ca.DM(value), ca.SX(value), ca.MX(value)]
    for number in kinds:
        with pytest.raises(po.DomainError) as error:
            kind(**(good | {argument: number}))
        assert name in str(error.value)
        assert any(f"{value:.{digits}g}" in str(error.value) for digits in (6, 17))
        assert ("must be finite" in str(error.value)) is not math.isfinite(value)
        assert isinstance(error.value, po.PloughError)
        assert isinstance(error.value, ValueError)


@pytest.mark.parametrize("density", [-1.0, math.nan, math.inf])
def test_mass_of_an_impossible_material_is_refused(density):
    with pytest.raises(po.DomainError, match=f"density of the share's material = {density:.6g} kg/m"):
        po.Cone(**CONE).solid_mass(density)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_symbols_pass(symbol):
    x = symbol.sym("x")
    cone = po.Wedge(x, -x, 2.0 * x).equivalent_cone()
    assert ex.is_symbolic(cone.half_angle)
    assert ex.is_symbolic(po.Cone(x, x).solid_mass(x))


def test_chisel_angle_of_zero_is_allowed():
    share = po.Wedge(0.5, 0.0, 0.3)
    assert share.area == pytest.approx(0.09 * math.tan(0.5), rel=1e-15)
