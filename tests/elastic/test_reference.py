"""The elastic medium against other solutions: closed forms, limits, and Fourier integrals."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest
from helpers.field_cases import MU, ground, slow
from helpers.refusals import refusals

import plough_opt as po
from plough_opt.soil.elastic import fourier

# --- the source's Fourier integrals against the closed forms, and knots on smooth profiles against both ---

LENGTH, HALF_THICKNESS = 0.5, 0.05
PROFILES = {
    "straight": lambda x: 0.1 * x,
    "parabolic arc": lambda x: 4.0 * HALF_THICKNESS * x * (LENGTH - x) / LENGTH**2,
    "shoulder": lambda x: HALF_THICKNESS * math.sin(math.pi * x / (2.0 * LENGTH)) ** 2,
}
POINTS = np.array([[0.2, 0.1], [-0.3, 0.2], [0.9, 0.3], [0.5, 0.05]])

FIELDS = ("wedge_stress", "cone_displacement", "cone_stress")


def as_columns(found):
    return np.column_stack(list(vars(found).values()))


def relative(found, wanted):
    """Return the largest difference of each point's components, relative to the largest of them."""
    return np.max(np.abs(found - wanted) / np.max(np.abs(wanted), axis=1, keepdims=True))


@pytest.mark.parametrize("speed", [0.7, 1e-6, *slow([0.0, 0.3, 0.95])])
@pytest.mark.parametrize("field", FIELDS)
def test_straight_profiles_agree_with_the_closed_form(field, speed):
    soil, V0 = ground(speed)
    factor = {} if field == "wedge_stress" else {"section_factor": 0.8}
    by_waves = getattr(fourier, field)(*POINTS.T, PROFILES["straight"], LENGTH, soil, V0, **factor)
    closed = getattr(po.elastic, field)(*POINTS.T, [(0.0, 0.0), (LENGTH, 0.1 * LENGTH)], soil, V0, **factor)
    assert relative(as_columns(by_waves), as_columns(closed)) < 2e-14


@pytest.mark.parametrize("profile", ["parabolic arc", *slow(["shoulder"])])
@pytest.mark.parametrize("field", FIELDS)
def test_knots_converge_with_the_square_of_their_number(field, profile):
    soil, V0 = ground(0.3)
    x, y = POINTS[:3].T
    smooth = as_columns(getattr(fourier, field)(x, y, PROFILES[profile], LENGTH, soil, V0))
    errors = []
    for count in (16, 32, 64):
        nodes = po.elastic.knots(PROFILES[profile], LENGTH, count)
        errors.append(relative(as_columns(getattr(po.elastic, field)(x, y, nodes, soil, V0)), smooth))
        pieces = np.diff([place for place, _ in nodes])
        assert pieces[0] == pytest.approx(pieces[-1], rel=1e-12)
        assert max(pieces) > 10.0 * pieces[0]  # closer together towards both ends
    rates = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert rates == pytest.approx([2.0, 2.0], abs=0.02)
    assert errors[-1] < 2e-3


def test_higher_orders_give_more_digits():
    at = (*POINTS.T, PROFILES["straight"], LENGTH, *ground(0.3))
    found = {order: as_columns(fourier.wedge_stress(*at, order)) for order in (3, 5, 7, 12)}
    errors = [relative(found[order], found[12]) for order in (3, 5, 7)]
    assert errors[0] > 100.0 * errors[1] > 1e4 * errors[2]


def test_floats_arrays_and_planes():
    given = (PROFILES["parabolic arc"], LENGTH, *ground(0.3))
    x, y = np.meshgrid([0.1, 0.3, 0.7], [0.2, 0.4])
    plane = fourier.cone_stress(x, y, *given, section_factor=1.0).rr
    single = fourier.cone_stress(0.3, 0.4, *given).rr
    assert plane.shape == (2, 3)
    assert isinstance(single, float)
    assert plane[1, 1] == pytest.approx(2.0 * single, rel=0, abs=1e-14 * MU)


REFUSED = {
    "on the axis": ({"y": 0.0}, "distance from the axis = 0 m must be above 0 m"),
    "so near that it would take for ever": ({"y": 1e-7}, "the closed forms have no such limit"),
    "point not a number": ({"x": math.nan}, "x = nan m"),
    "supersonic": ({"speed": 101.0}, r"speed over shear wave speed = 1\.01"),
    "no length": ({"length": 0.0}, "length of the profile = 0 m"),
    "blunt": ({"profile": lambda x: 0.01 + x}, "tip"),
    "profile not finite": ({"profile": lambda x: math.nan * x}, "profile = nan"),
    "no function": ({"profile": 3.0}, "the profile must be a function of x that returns a number"),
    "order of one": ({"order": 1}, "order = 1 must be a whole number"),
    "symbols": ({"x": ca.SX.sym("x")}, "closed forms"),
}


@pytest.mark.parametrize(("change", "sentence"), REFUSED.values(), ids=REFUSED)
def test_arguments_that_the_integrals_cannot_handle_are_refused(change, sentence):
    soil, speed = ground()
    given = {"x": 0.2, "y": 0.1, "profile": PROFILES["straight"], "length": LENGTH, "soil": soil, "speed": speed}
    given |= {"order": 12} | change
    for field in FIELDS:
        with pytest.raises((po.DomainError, po.InputError), match=sentence):
            getattr(fourier, field)(*given.values())


test_knots_on_invalid_profiles_are_refused = refusals(
    (po.DomainError, po.InputError),
    (lambda: po.elastic.knots(PROFILES["straight"], 0.5, 0), "count = 0 of straight pieces must be"),
    (lambda: po.elastic.knots(PROFILES["straight"], 0.0, 4), "length of the profile = 0 m"),
    (lambda: po.elastic.knots(lambda x: -x, 0.5, 4), "half thickness or radius at x"),
    (lambda: po.elastic.knots(lambda x: math.nan * x, 0.5, 4), "= nan m must be finite"),
    (lambda: po.elastic.knots(0.1, 0.5, 4), "function of x"),
    (lambda: po.elastic.knots(lambda _: "r", 0.5, 4), "returns a number, in metres: could not convert"),
)
