"""A density that varies behind the front: against the closed form, 75 digits of the source's equations, quadrature.

Values, gradients and Hessians are compared, those in the profile's parameters included.
"""

import dataclasses
import math
from itertools import pairwise, product

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.density_profiles import DENSITIES, DENSITY, Ground, field, ground
from helpers.high_precision import mp

import plough_opt as po
from plough_opt.soil import plastic
from plough_opt.soil.plastic import Cavity

STEADY, SPEEDING_UP = Cavity(0.05, 0.5, 0.0), Cavity(0.03, 1.5, 40.0)
SLOWING_DOWN, AT_REST = Cavity(0.05, 0.5, -20.0), Cavity(0.05, 0.0, 0.0)
profiles = pytest.mark.parametrize("name", DENSITIES)

OF_CAVITY = ("front_radius", "front_speed", "surface_pressure")
QUANTITIES = (*OF_CAVITY, "current_radius", "particle_velocity", "particle_acceleration", "radial", "tangential")
# Quadrature orders that are exact to rounding, for all profiles except the bell and for the bell.
ENOUGH, PLENTY = 16, 24

# A dozen roundings; the worst found is 1.4e-15, in the added mass of soil with b1 = 0.999 and 1.4 rad.
CONSTANT = 1e-14


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 1.4])
@pytest.mark.parametrize("b1", [1e-6, 0.1, 0.8, 0.999])
def test_a_constant_profile_is_the_closed_form(b1, angle):
    cone = po.Cone(0.2, 0.3)
    plain = po.Soil(DENSITY, b1, 2e4, angle, 0.45, 1e4)
    varied = plain.with_density_profile(lambda r, rho: rho + 0.0 * r, DENSITY / b1)
    for cavity in (STEADY, SPEEDING_UP):
        # From the wall to the front, which may be rounded outwards.
        r = np.linspace(0.0, plastic.front_radius(cavity, plain), 5)
        for quantity in (*QUANTITIES[:-1], "density"):
            found, wanted = (field(quantity, r, cavity, soil) for soil in (varied, plain))
            np.testing.assert_allclose(found, wanted, rtol=CONSTANT, err_msg=quantity)
    for quantity in (
        lambda soil: dataclasses.astuple(po.resistance_coefficients(cone, soil)),
        lambda soil: po.loosened_radius(cone, soil),
    ):
        assert quantity(varied) == pytest.approx(quantity(plain), rel=CONSTANT)


@profiles
@pytest.mark.parametrize(
    "cavity", [SPEEDING_UP, *(pytest.param(one, marks=pytest.mark.slow) for one in (STEADY, SLOWING_DOWN, AT_REST))]
)
def test_values_against_75_digits(name, cavity):
    earth = ground(name)
    soil = earth.soil(PLENTY if name == "bell" else ENOUGH)
    precise = earth.field(cavity.radius, cavity.rate, cavity.acceleration)
    for place in (0.0, 0.3, 0.8):
        r = place * float(precise.front)
        for quantity in (*(OF_CAVITY if place == 0.0 else ()), *QUANTITIES[3:], "density"):
            # The terms have one sign except under deceleration, where inertia cancels to a tenth.
            scale = abs(precise.radial(mp.mpf(0))) if quantity == "tangential" else None
            wanted = getattr(precise, quantity)(mp.mpf(r))
            hp.assert_close(field(quantity, r, cavity, soil), wanted, 1e-14, quantity, scale)


@pytest.mark.parametrize("name", ["exponential, b rising", "bell"])
def test_resistance_is_the_pressure_integrated_over_the_cone(name):
    cone, soil, speed, acceleration = po.Cone(0.2, 0.3), ground(name).soil(24), 2.0, 3.0
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for x, weight in zip((nodes + 1.0) * 0.15, weights * 0.15, strict=True):
        cavity = Cavity(x * cone.slope, speed * cone.slope, acceleration * cone.slope)
        total += weight * plastic.surface_pressure(cavity, soil) * x * cone.slope * math.sqrt(1.0 + cone.slope**2)
    angle = math.sin(cone.half_angle) + soil.tool_friction * math.cos(cone.half_angle)
    # The bell is narrower than the front at the base.
    tolerance = 1e-6 if name == "bell" else 1e-12
    assert po.resistance(cone, soil, speed, acceleration) == pytest.approx(2.0 * math.pi * angle * total, rel=tolerance)


# --- derivatives ---

NAMES = ("c", "w", "r", "radius", "rate", "acceleration", "friction_angle", "cohesion")
STATE = {"r": 0.06, "radius": 0.05, "rate": 0.5, "acceleration": 3.0, "friction_angle": 0.5, "cohesion": 2e4}
# Some hundred roundings; the largest error found is 1.1e-13, in an entry that is a hundredth of its terms.
DIGITS = 3e-13


def toolkit(quantity, name):
    """Return a quantity as a function of the numbers or symbols in `NAMES`."""

    def at(c, w, r, radius, rate, acceleration, friction_angle, cohesion):
        soil = Ground(name, (c, w), friction_angle, cohesion).soil(ENOUGH)
        return field(quantity, r, Cavity(radius, rate, acceleration), soil)

    return at


def precise(quantity, name):
    """Return the same quantity as a function computed with 75 digits."""

    def at(c, w, r, radius, rate, acceleration, friction_angle, cohesion):
        earth = Ground(name, (c, w), friction_angle, cohesion)
        return getattr(earth.field(radius, rate, acceleration), quantity)(r)

    return at


def cases():
    """Yield quantities and profiles: by default a few, each with one profile; with the slow tests all."""
    default = {(quantity, "exponential, b falling") for quantity in ("radial", "front_speed", "particle_acceleration")}
    for case in product(QUANTITIES, [name for name in DENSITIES if name != "bell"]):
        yield pytest.param(*case, marks=[] if case in default else [pytest.mark.slow])


@pytest.mark.parametrize(("quantity", "name"), [*cases()])
def test_value_gradient_and_hessian(quantity, name):
    point, function = (*DENSITIES[name][1], *STATE.values()), toolkit(quantity, name)
    wanted = [np.array(one, float) for one in hp.derivatives(precise(quantity, name), point)]
    for symbol in (ca.SX, ca.MX):
        found = hp.differentiated(function, symbol, len(point))(point)
        assert found[0] == pytest.approx(float(wanted[0]), rel=1e-14)
        for one, exact in zip(found[1:], wanted[1:], strict=True):
            # The differences turn an exact zero into numbers below 1e-18.
            np.testing.assert_allclose(one, exact, rtol=DIGITS, atol=1e-18)


@pytest.mark.parametrize("place", [0.0, 1.0])
def test_slopes_at_wall_and_front(place):
    """Compare at the ends of the field, where the quadratures have zero length or begin on the axis."""
    name, rest = "exponential, b rising", [*STATE.values()][2:]
    front = float(ground(name).field(0.05, 0.5, 3.0).front)
    point = (*DENSITIES[name][1], place * front, STATE["radius"])
    value, wanted, _ = hp.derivatives(lambda *x: precise("radial", name)(*x, *rest), point)
    _, found, _ = hp.differentiated(lambda *x: toolkit("radial", name)(*x, *rest), ca.SX, len(point))(point)
    for k, slope in enumerate(wanted):
        scale = max(abs(slope), abs(value) / (10 * max(STATE["radius"], point[k])))
        hp.assert_close(found[k], slope, 1e-14, NAMES[k], scale)


# --- the error of the quadrature ---


@profiles
@pytest.mark.parametrize("cavity", [STEADY, SPEEDING_UP])
def test_the_error_falls_exponentially_and_its_estimate_is_reliable(name, cavity):
    """Compare true errors of the radial stress relative to the largest, and the toolkit's estimates of them."""
    exact = ground(name).field(cavity.radius, cavity.rate, cavity.acceleration)
    r = np.array([0.0, 0.4, 0.8]) * float(exact.front)
    truth = np.array([float(exact.radial(mp.mpf(place))) for place in r])
    soils = [ground(name).soil(order) for order in ([4, 8, 12, 16, 20, 24] if name == "bell" else [2, 4, 6, 8])]
    error = np.array([np.max(np.abs(plastic.stress(r, cavity, soil).radial - truth)) for soil in soils])
    error /= np.max(np.abs(truth))
    estimate = np.array([plastic.quadrature_error(r, cavity, soil) for soil in soils])
    above = error > 2e-14  # the others are rounding
    resolved = error[above]
    assert len(resolved) >= 2
    # Four more nodes reduce the error at least 50 times; for smooth profiles two more do so at least 100 times.
    factor = 50.0 if name == "bell" else 100.0
    assert all(fine < coarse / factor for coarse, fine in pairwise(resolved))
    np.testing.assert_array_less(resolved, 1.5 * estimate[above])
    np.testing.assert_array_less(estimate[above], 1.5 * resolved)
    assert np.all(estimate[~above] < 1e-13)


@pytest.mark.parametrize("order", [4, 8])
def test_the_error_is_estimated_up_to_the_front(order):
    # The front of the finer quadrature may be slightly nearer, so that the coarse front lies ahead of it.
    soil, exact = ground("bell").soil(order), ground("bell").field(STEADY.radius, STEADY.rate, STEADY.acceleration)
    front = plastic.front_radius(STEADY, soil)
    off = abs(front / float(exact.front) - 1.0)
    assert off > 1e-8
    estimate = plastic.quadrature_error(np.linspace(0.0, front, 5), STEADY, soil)
    assert 0.1 * off < estimate < 10.0 * off
    assert plastic.quadrature_error(0.0, STEADY, po.named_soil("serozem")) == 0.0
