"""A density that varies behind the front: against the closed form, the source's equations and other integrators."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.density_profiles import DENSITIES, DENSITY, ground
from helpers.high_precision import mp

import plough_opt as po
from plough_opt.soil import plastic
from plough_opt.soil.plastic import Cavity

CAVITIES = {
    "steady": Cavity(0.05, 0.5, 0.0),
    "speeding up": Cavity(0.03, 1.5, 40.0),
    "slowing down": Cavity(0.05, 0.5, -20.0),
    "at rest": Cavity(0.05, 0.0, 0.0),
}
cavities = pytest.mark.parametrize(
    "cavity",
    [
        pytest.param(cavity, id=name, marks=[pytest.mark.slow] if name != "speeding up" else [])
        for name, cavity in CAVITIES.items()
    ],
)
profiles = pytest.mark.parametrize("name", DENSITIES)

# Quadrature orders that are exact to rounding, for all profiles except the bell and for the bell.
ENOUGH, PLENTY = 16, 24


def order_for(name):
    return PLENTY if name == "bell" else ENOUGH


def radii(cavity, soil, count=5):
    """Return radii from the wall to the front, which may be rounded outwards."""
    return np.linspace(0.0, plastic.front_radius(cavity, soil), count)


# --- a constant profile is the closed form ----------------------------------------------------------------------------

# A dozen roundings; the worst found is 1.4e-15, in the added mass of soil with b1 = 0.999 and 1.4 rad.
CONSTANT = 1e-14


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 1.4])
@pytest.mark.parametrize("b1", [1e-6, 0.1, 0.8, 0.999])
def test_a_constant_profile_is_the_closed_form(b1, angle):
    cone = po.Cone(0.2, 0.3)
    plain = po.Soil(DENSITY, b1, 2e4, angle, 0.45, 1e4)
    varied = plain.with_density_profile(lambda r, rho: rho + 0.0 * r, DENSITY / b1)
    for cavity in CAVITIES.values():
        r = radii(cavity, plain)
        for name in ("density", "current_radius", "particle_velocity", "particle_acceleration"):
            found, wanted = (getattr(plastic, name)(r, cavity, soil) for soil in (varied, plain))
            np.testing.assert_allclose(found, wanted, rtol=CONSTANT, err_msg=name)
        assert plastic.front_speed(cavity, varied) == pytest.approx(plastic.front_speed(cavity, plain), rel=CONSTANT)
        found, wanted = (plastic.surface_pressure(cavity, soil) for soil in (varied, plain))
        p = plastic.wall_pressure(plain)
        # The sum of the terms' magnitudes, because the terms cancel under deceleration.
        inertial = p.rate * cavity.rate**2 + p.inertia * cavity.radius * abs(cavity.acceleration)
        assert found == pytest.approx(wanted, abs=CONSTANT * (p.strength + DENSITY * inertial))
    for quantity in (
        lambda soil: dataclasses.astuple(po.resistance_coefficients(cone, soil)),
        lambda soil: po.resistance(cone, soil, 2.0, 3.0),
        lambda soil: po.loosened_radius(cone, soil),
    ):
        assert quantity(varied) == pytest.approx(quantity(plain), rel=CONSTANT)


# --- independent computations -----------------------------------------------------------------------------------------


@profiles
@cavities
def test_values_against_75_digits(name, cavity):
    earth = ground(name)
    soil, precise = earth.soil(order_for(name)), earth.field(cavity.radius, cavity.rate, cavity.acceleration)
    front = float(precise.front)
    # The terms have one sign except under deceleration, where inertia cancels to a tenth.
    digits = 1e-14
    hp.assert_close(plastic.front_radius(cavity, soil), precise.front, digits, "front")
    hp.assert_close(plastic.front_speed(cavity, soil), precise.front_speed, digits, "front speed")
    wall = precise.pressure(mp.mpf(0))
    gauge = wall - mp.mpf(soil.ambient_pressure)
    hp.assert_close(plastic.surface_pressure(cavity, soil), gauge, digits, "wall")
    for r in (0.0, 0.3 * front, 0.8 * front):
        exact, stress = mp.mpf(r), plastic.stress(r, cavity, soil)
        hp.assert_close(plastic.density(r, cavity, soil), DENSITY / precise.ratio(exact), digits, "density")
        hp.assert_close(plastic.current_radius(r, cavity, soil), precise.current_radius(exact), digits, "radius")
        hp.assert_close(plastic.particle_velocity(r, cavity, soil), precise.velocity(exact), digits, "velocity")
        acceleration = precise.acceleration_of(exact)
        hp.assert_close(plastic.particle_acceleration(r, cavity, soil), acceleration, digits, "acceleration")
        hp.assert_close(-stress.radial, precise.pressure(exact), digits, "radial")
        hp.assert_close(-stress.tangential, precise.tangential_pressure(exact), digits, "tangential", wall)


@pytest.mark.parametrize("name", ["exponential, b rising", "bell"])
def test_resistance_is_the_pressure_integrated_over_the_cone(name):
    earth, cone, speed, acceleration = ground(name), po.Cone(0.2, 0.3), 2.0, 3.0
    soil = earth.soil(24)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for x, weight in zip((nodes + 1.0) * 0.15, weights * 0.15, strict=True):
        cavity = Cavity(x * cone.slope, speed * cone.slope, acceleration * cone.slope)
        total += weight * plastic.surface_pressure(cavity, soil) * x * cone.slope * math.sqrt(1.0 + cone.slope**2)
    angle = math.sin(cone.half_angle) + soil.tool_friction * math.cos(cone.half_angle)
    # The bell is narrower than the front at the base.
    tolerance = 1e-6 if name == "bell" else 1e-12
    assert po.resistance(cone, soil, speed, acceleration) == pytest.approx(2.0 * math.pi * angle * total, rel=tolerance)


# --- the error of the quadrature --------------------------------------------------------------------------------------


def errors_of(name, orders, cavity):
    """Return true errors of the radial stress relative to the largest, and the toolkit's estimates of them."""
    earth = ground(name)
    precise = earth.field(cavity.radius, cavity.rate, cavity.acceleration)
    r = np.array([0.0, 0.4, 0.8]) * float(precise.front)
    truth = np.array([float(precise.pressure(mp.mpf(place))) for place in r])
    soils = [earth.soil(order) for order in orders]
    found = [np.max(np.abs(-plastic.stress(r, cavity, soil).radial - truth)) / np.max(truth) for soil in soils]
    return np.array(found), np.array([plastic.quadrature_error(r, cavity, soil) for soil in soils])


@profiles
@pytest.mark.parametrize("motion", ["steady", "speeding up"])
def test_the_error_falls_exponentially_and_its_estimate_is_reliable(name, motion):
    orders = [4, 8, 12, 16, 20, 24] if name == "bell" else [2, 4, 6, 8]
    error, estimate = errors_of(name, orders, CAVITIES[motion])
    above = error > 2e-14  # the others are rounding
    resolved = error[above]
    assert len(resolved) >= 2
    # Four more nodes reduce the error at least 50 times; for smooth profiles two more do so at least 100 times.
    factor = 50.0 if name == "bell" else 100.0
    assert all(fine < coarse / factor for coarse, fine in pairwise(resolved))
    assert np.all(error[~above] <= 2e-14)
    np.testing.assert_array_less(resolved, 1.5 * estimate[above])
    np.testing.assert_array_less(estimate[above], 1.5 * resolved)
    assert np.all(estimate[~above] < 1e-13)


@pytest.mark.parametrize("order", [4, 8])
def test_the_error_is_estimated_up_to_the_front(order):
    # The front of the finer quadrature may be slightly nearer, so that the coarse front lies ahead of it.
    cavity, soil = CAVITIES["steady"], ground("bell").soil(order)
    precise = ground("bell").field(cavity.radius, cavity.rate, cavity.acceleration)
    front = plastic.front_radius(cavity, soil)
    off = abs(front / float(precise.front) - 1.0)
    assert off > 1e-8
    estimate = plastic.quadrature_error(np.linspace(0.0, front, 5), cavity, soil)
    assert 0.1 * off < estimate < 10.0 * off
    assert plastic.quadrature_error(0.0, cavity, po.named_soil("serozem")) == 0.0
