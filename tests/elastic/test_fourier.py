"""The Fourier integrals of the source against the closed forms, and knots on a smooth profile against both."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest
from helpers import oracle
from helpers.field_cases import MU, ground, inputs, slow

import plough_opt as po
from plough_opt.soil.elastic import fourier

mp = oracle.mp
LENGTH, HALF_THICKNESS = 0.5, 0.05
PROFILES = {
    "straight": lambda x: 0.1 * x,
    "parabolic arc": lambda x: 4.0 * HALF_THICKNESS * x * (LENGTH - x) / LENGTH**2,
    "half a wave": lambda x: HALF_THICKNESS * math.sin(math.pi * x / LENGTH),
    "shoulder": lambda x: HALF_THICKNESS * math.sin(math.pi * x / (2.0 * LENGTH)) ** 2,
}
# Half thickness and slope, in precise numbers.
PRECISE = {
    "parabolic arc": (lambda x: 4 * _H * x * (_L - x) / _L**2, lambda x: 4 * _H * (_L - 2 * x) / _L**2),
    "half a wave": (lambda x: _H * mp.sin(mp.pi * x / _L), lambda x: _H * mp.pi / _L * mp.cos(mp.pi * x / _L)),
    "shoulder": (
        lambda x: _H * mp.sin(mp.pi * x / (2 * _L)) ** 2,
        lambda x: _H * mp.pi / (2 * _L) * mp.sin(mp.pi * x / _L),
    ),
}
_L, _H = mp.mpf(LENGTH), mp.mpf(HALF_THICKNESS)
POINTS = np.array([[0.2, 0.1], [-0.3, 0.2], [0.9, 0.3], [0.5, 0.05]])

FIELDS = ("wedge_stress", "cone_displacement", "cone_stress")


def as_columns(found):
    return np.column_stack(list(vars(found).values()))


def relative(found, wanted):
    """Return the largest difference of each point's components, relative to the largest of them."""
    return np.max(np.abs(found - wanted) / np.max(np.abs(wanted), axis=1, keepdims=True))


@pytest.mark.parametrize("speed", [0.3, *slow([0.0, 1e-6, 0.7, 0.95])])
@pytest.mark.parametrize("field", FIELDS)
def test_straight_profiles_agree_with_the_closed_form(field, speed):
    soil, V0 = ground(speed)
    by_waves = getattr(fourier, field)(*POINTS.T, PROFILES["straight"], LENGTH, soil, V0)
    closed = getattr(po.elastic, field)(*POINTS.T, [(0.0, 0.0), (LENGTH, 0.1 * LENGTH)], soil, V0)
    assert relative(as_columns(by_waves), as_columns(closed)) < 2e-14


def precise_wedge_stress(x, y, profile, medium):
    """Return the stresses around a smooth profile: kernels of the displacement gradient over its slope."""
    alpha, eta, m = medium.alpha, medium.eta, medium.m

    def integral(kernel, k):
        def weighted(s):
            return PRECISE[profile][1](s) * kernel(x - s, k * y) / mp.pi

        return mp.quad(weighted, mp.linspace(0, LENGTH, 5))

    odd = {k: integral(lambda X, c: X / (X**2 + c**2), k) for k in (alpha, eta)}
    even = {k: integral(lambda X, c: c / (X**2 + c**2), k) for k in (alpha, eta)}
    ux_x = (2 * eta * odd[eta] - (1 + eta**2) / alpha * odd[alpha]) / m
    uy_y = ((1 + eta**2) * alpha * odd[alpha] - 2 * eta * odd[eta]) / m
    turned = (2 * (1 + eta**2) * even[eta] - 2 * (1 + eta**2) * even[alpha]) / m
    dilation = medium.lam * (ux_x + uy_y)
    return [dilation + 2 * medium.mu * ux_x, dilation + 2 * medium.mu * uy_y, medium.mu * turned, dilation]


def precise_cone_displacement(x, r, profile, medium):
    """Return the displacements around a smooth profile: kernels over S' = R R'."""
    eta, m = medium.eta, medium.m

    def integral(kernel, k):
        def weighted(s):
            radius, slope = (part(s) for part in PRECISE[profile])
            return radius * slope * kernel(x - s, mp.hypot(x - s, k * r))

        return mp.quad(weighted, mp.linspace(0, LENGTH, 5))

    source = {k: integral(lambda _, rho: 1 / (2 * rho), k) for k in (medium.alpha, eta)}
    spread = {k: integral(lambda X, rho: -(1 + X / rho) / (2 * r), k) for k in (medium.alpha, eta)}
    axial = ((1 + eta**2) * source[medium.alpha] - 2 * eta**2 * source[eta]) / m
    return [axial, ((1 + eta**2) * spread[medium.alpha] - 2 * spread[eta]) / m]


@pytest.mark.parametrize("profile", ["parabolic arc", *slow(["shoulder", "half a wave"])])
def test_smooth_profiles_against_precise_kernels(profile):
    soil, V0 = ground(0.3)
    x, y = POINTS.T
    with mp.workdps(18):
        medium = oracle.Medium(*inputs(0, 0, "wedge", 0.3)[2:6])
        exact = [(mp.mpf(a), mp.mpf(b)) for a, b in POINTS]
        stresses = np.array([precise_wedge_stress(*point, profile, medium) for point in exact], dtype=float)
        displacements = np.array([precise_cone_displacement(*point, profile, medium) for point in exact], dtype=float)
    assert relative(as_columns(fourier.wedge_stress(x, y, PROFILES[profile], LENGTH, soil, V0)), stresses) < 2e-14
    found = fourier.cone_displacement(x, y, PROFILES[profile], LENGTH, soil, V0)
    assert relative(as_columns(found), displacements) < 2e-14


@pytest.mark.parametrize("profile", ["parabolic arc", *slow(["half a wave", "shoulder"])])
@pytest.mark.parametrize("field", FIELDS)
def test_knots_converge_with_the_square_of_their_number(field, profile):
    soil, V0 = ground(0.3)
    x, y = POINTS[:3].T
    smooth = as_columns(getattr(fourier, field)(x, y, PROFILES[profile], LENGTH, soil, V0))
    errors = []
    for count in (16, 32, 64):
        nodes = po.elastic.knots(PROFILES[profile], LENGTH, count)
        errors.append(relative(as_columns(getattr(po.elastic, field)(x, y, nodes, soil, V0)), smooth))
    rates = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert rates == pytest.approx([2.0, 2.0], abs=0.02)
    assert errors[-1] < 2e-3


@pytest.mark.parametrize("profile", PROFILES)
def test_knots_lie_on_the_profile(profile):
    nodes = po.elastic.knots(PROFILES[profile], LENGTH, 7)
    assert len(nodes) == 8
    assert nodes[0] == (0.0, 0.0)
    assert nodes[-1][0] == LENGTH
    assert all(a < b for (a, _), (b, _) in itertools.pairwise(nodes))
    assert [b for _, b in nodes] == [PROFILES[profile](a) for a, _ in nodes]


def test_order_buys_digits():
    soil, V0 = ground(0.3)
    closed = as_columns(po.elastic.wedge_stress(*POINTS.T, [(0.0, 0.0), (LENGTH, 0.1 * LENGTH)], soil, V0))
    errors = [
        relative(as_columns(fourier.wedge_stress(*POINTS.T, PROFILES["straight"], LENGTH, soil, V0, order)), closed)
        for order in (3, 5, 7)
    ]
    assert errors[0] > 100.0 * errors[1] > 1e4 * errors[2]


def test_floats_arrays_and_planes():
    soil, V0 = ground(0.3)
    x, y = np.meshgrid([0.1, 0.3, 0.7], [0.2, 0.4])
    plane = fourier.wedge_stress(x, y, PROFILES["parabolic arc"], LENGTH, soil, V0).yy
    single = fourier.wedge_stress(0.3, 0.4, PROFILES["parabolic arc"], LENGTH, soil, V0).yy
    assert plane.shape == (2, 3)
    assert isinstance(single, float)
    assert plane[1, 1] == pytest.approx(single, rel=0, abs=1e-14 * MU)
    plane = fourier.cone_stress(x, y, PROFILES["parabolic arc"], LENGTH, soil, V0, section_factor=1.0).rr
    single = fourier.cone_stress(0.3, 0.4, PROFILES["parabolic arc"], LENGTH, soil, V0).rr
    assert plane[1, 1] == pytest.approx(2.0 * single, rel=0, abs=1e-14 * MU)


REFUSED = {
    "on the axis": ({"y": 0.0}, "distance from the axis = 0 m must be above 0 m"),
    "so near that it would take for ever": ({"y": 1e-7}, "the closed forms have no such limit"),
    "point not a number": ({"x": math.nan}, "x = nan m"),
    "supersonic": ({"speed": 101.0}, r"speed over shear wave speed = 1\.01"),
    "no length": ({"length": 0.0}, "length of the profile = 0 m"),
    "blunt": ({"profile": lambda x: 0.01 + x}, "tip"),
    "profile not finite": ({"profile": lambda x: math.nan * x}, "profile = nan"),
    "order of one": ({"order": 1}, "order = 1 must be a whole number"),
    "symbols": ({"x": ca.SX.sym("x")}, "closed forms"),
}


@pytest.mark.parametrize(("change", "sentence"), REFUSED.values(), ids=REFUSED)
def test_what_the_integrals_cannot_do_is_refused(change, sentence):
    soil, speed = ground()
    given = {"x": 0.2, "y": 0.1, "profile": PROFILES["straight"], "length": LENGTH, "soil": soil, "speed": speed}
    given |= {"order": 12} | change
    for field in FIELDS:
        with pytest.raises((po.DomainError, po.InputError), match=sentence):
            getattr(fourier, field)(*given.values())


@pytest.mark.parametrize(
    ("profile", "length", "count", "sentence"),
    [
        (PROFILES["straight"], 0.5, 0, "count = 0 of straight pieces must be"),
        (PROFILES["straight"], 0.5, 2.5, r"count = 2\.5 of straight pieces must be"),
        (PROFILES["straight"], 0.0, 4, "length of the profile = 0 m"),
        (lambda x: -x, 0.5, 4, "half thickness or radius at x"),
        (lambda x: math.nan * x, 0.5, 4, "= nan m must be finite"),
        (0.1, 0.5, 4, "function of x"),
    ],
)
def test_knots_of_what_is_no_profile_are_refused(profile, length, count, sentence):
    with pytest.raises((po.DomainError, po.InputError), match=sentence):
        po.elastic.knots(profile, length, count)
