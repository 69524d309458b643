"""The plastic gas: its field, uniform or of a density profile, against high precision, and its domain."""

import dataclasses
import math
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.high_precision import mp
from helpers.precise_field import Constant, Field
from helpers.refusals import refusals

import plough_opt as po
from plough_opt.core.expressions import exp
from plough_opt.soil import plastic
from plough_opt.soil.plastic import Cavity

DENSITY = 1400.0
"""Density of the undisturbed soil [kg/m^3]."""

AMBIENT = 1e4  # Pa

DENSITIES = {
    "exponential, b rising": (lambda r, c, w: DENSITY / (c - exp(-r / w) / 4.0), (0.9, 0.1)),
    "exponential, b falling": (lambda r, c, w: DENSITY / (c + exp(-r / w) / 4.0), (0.55, 0.1)),
    "quadratic, b rising": (lambda r, c, w: DENSITY * c * (1.0 - (r / w) ** 2), (1.4, 0.4)),
    "quadratic, b falling": (lambda r, c, w: DENSITY * c * (1.0 + (r / w) ** 2), (1.1, 0.2)),
    "bell": (lambda r, c, w: DENSITY * c * (1.0 + exp(-((r / w) ** 2)) / 4.0), (1.1, 0.05)),
}
"""Name -> density [kg/m^3] as a function of radius and two parameters, and their values. The bell varies most."""


class Ground(NamedTuple):
    """A named profile in soil with a given strength."""

    name: str
    parameters: tuple
    friction_angle: object = 0.5
    cohesion: object = 2e4

    def soil(self, order):
        """Return the toolkit's soil."""
        plain = po.Soil(DENSITY, 0.5, self.cohesion, self.friction_angle, 0.45, AMBIENT)
        return plain.with_density_profile(DENSITIES[self.name][0], *self.parameters, order=order)

    def field(self, radius, rate, acceleration):
        """Return the precise field around a cavity."""
        values = (*self.parameters, radius, rate, acceleration, self.friction_angle, self.cohesion)
        return Field(self.name, *map(mp.mpf, (*values, AMBIENT, DENSITY)))


def ground(name):
    """Return a profile with its default parameters."""
    return Ground(name, DENSITIES[name][1])


OF_CAVITY = ("front_radius", "front_speed", "surface_pressure")


def field(quantity, r, cavity, soil):
    """Return a quantity of the toolkit's field by its name, at a Lagrangian radius if it depends on that."""
    if quantity in ("radial", "tangential"):
        return getattr(plastic.stress(r, cavity, soil), quantity)
    return getattr(plastic, quantity)(*([] if quantity in OF_CAVITY else [r]), cavity, soil)


STEADY, SPEEDING_UP = Cavity(0.05, 0.5, 0.0), Cavity(0.03, 1.5, 40.0)
SLOWING_DOWN, AT_REST = Cavity(0.05, 0.5, -20.0), Cavity(0.05, 0.0, 0.0)
profiles = pytest.mark.parametrize("name", DENSITIES)

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


# --- profiles that are refused, or lack a compaction front ---


PLAIN = po.Soil(1350.0, 0.5, 2e4, 0.5, 0.45, 1e4)
OF_RADIUS = ("stress", "density", "current_radius", "particle_velocity", "particle_acceleration")


def falling(r):
    """Return a density that carries the soil of cavities up to R^2 = 0.01 m^2 ln 2."""
    return 1350.0 * (1.0 + exp(-((r / 0.1) ** 2)))


def cavity_of(filled):
    """Return the radius of a cavity with a part of the soil that `falling` carries."""
    return 0.1 * math.sqrt(math.log(2.0) * filled)


WITHOUT_FRONT = [
    (lambda _r: 1349.0, 0.05),
    (lambda r: 1500.0 - 4000.0 * r, 0.05),
    *((falling, cavity_of(filled)) for filled in (1.0001, 1.1, 10.0)),
]


@pytest.mark.parametrize("order", [8, 40])
@pytest.mark.parametrize(("density", "radius"), WITHOUT_FRONT)
def test_a_profile_that_cannot_hold_the_soil_of_a_cavity_has_no_front(density, radius, order):
    words = f"cavity of {radius:.4g} m was not found.*make the profile denser or wider"
    for quantity in OF_CAVITY:
        with pytest.raises(po.DomainError, match=words):
            getattr(plastic, quantity)(Cavity(radius, 0.5, 3.0), PLAIN.with_density_profile(density, order=order))


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_an_expression_without_a_front_has_no_value(symbol):
    radius = symbol.sym("R")
    cavity, soil = Cavity(radius, 0.5, 3.0), PLAIN.with_density_profile(falling, order=8)
    function = ca.Function("f", [radius], [plastic.front_radius(cavity, soil), plastic.surface_pressure(cavity, soil)])
    for filled in (0.9, 1.0001, 1.1, 10.0):
        found = [float(value) for value in function(cavity_of(filled))]
        assert [math.isfinite(value) for value in found] == 2 * [filled < 1.0]


@pytest.mark.parametrize("filled", [0.5, 0.9, 0.99, 0.9999])
def test_the_front_is_found_up_to_the_largest_cavity(filled):
    # R^2 = w^2 (ln 2 - ln(1 + exp(-(r*/w)^2))). The quadrature must resolve it: the front is up to 3 w away.
    soil = PLAIN.with_density_profile(falling, order=40)
    found = plastic.front_radius(Cavity(cavity_of(filled), 0.0, 0.0), soil)
    wanted = 0.1 * math.sqrt(-math.log(math.expm1(math.log(2.0) * (1.0 - filled))))
    # Far out the soil is hardly compacted, which magnifies the rounding of R by up to 1/(1 - b) = 1e4.
    assert found == pytest.approx(wanted, rel=1e-15 / (1.0 - filled) + 1e-14)


FADED = f"over the undisturbed density = {1349 / 1350:.6g} must be above 1: .* compacted"
FADING, AXIS = PLAIN.with_density_profile(lambda r: 1349.0 + 4000.0 * r), Cavity(0.0, 0.5, 0.0)
BELL = ground("bell").soil(8)
test_profiles_and_cavities_without_a_field_are_refused = refusals(
    (po.InputError, po.DomainError),
    (lambda: plastic.stress(0.01, STEADY, FADING), FADED),
    *((partial(PLAIN.with_density_profile, falling, order=n), "order = .* whole number") for n in (0, 2.5, "16", None)),
    (lambda: PLAIN.with_density_profile("rho"), "'rho'.* a function of the radius, in kg/m"),
    (lambda: plastic.wall_pressure(BELL), "give its radius"),
    (lambda: plastic.front_speed(AXIS, BELL), "radius = 0 m must be above 0 m"),
    (lambda: plastic.surface_pressure(AXIS, BELL), "radius = 0 m must be above 0 m"),
    *((partial(getattr(plastic, name), 0.0, AXIS, BELL), "radius = 0 m must be above 0 m") for name in OF_RADIUS),
    (lambda: plastic.quadrature_error(ca.SX.sym("r"), STEADY, BELL), "holds symbols"),
)


@pytest.mark.parametrize(("r", "words"), [(-0.01, "at least 0 m"), (0.5, "over front radius")])
@pytest.mark.parametrize("soil", [BELL, PLAIN], ids=["profile", "constant"])
def test_radii_outside_the_field_are_refused(soil, r, words):
    for name in (*OF_RADIUS, *(["quadrature_error"] if soil is not PLAIN else [])):
        with pytest.raises(po.DomainError, match=words):
            getattr(plastic, name)(r, STEADY, soil)


# --- the uniform field, against 120 digits of the textbook's formulas ---


# Some fifty roundings of 1.1e-16 of either sign; the largest error found is 1.6e-15.
EXACT = 4e-15
ORDINARY = {
    "radius": 0.05, "rate": 0.5, "acceleration": 3.0, "density_ratio": 0.8, "friction_angle": 0.5, "cohesion": 2e4,
    "ambient_pressure": 101325.0, "density": 1400.0,
}  # fmt: skip
# A fraction of the front radius, and what differs.
PLACES = [
    *((place, {}) for place in (0.0, 1e-6, 0.6, 1.0)),
    *((0.6, {"density_ratio": b1}) for b1 in (1e-9, 1e-3, 0.5, 1 - 1e-6)),
    *((0.6, {"friction_angle": angle}) for angle in (0.0, 1e-9, 1.5)),
    (1.0, {"density_ratio": 1 - 1e-6, "friction_angle": 0.0}),
    (0.7, {"acceleration": -40.0, "cohesion": 0.0, "ambient_pressure": 0.0}),
    (0.9, {"radius": 0.2, "rate": 30.0, "acceleration": -500.0, "density_ratio": 0.95}),
]


@pytest.mark.parametrize(("place", "changes"), PLACES)
def test_the_uniform_field_is_that_of_the_textbook(place, changes):
    radius, rate, acceleration, b1, angle, cohesion, pressure, density = (ORDINARY | changes).values()
    soil, cavity = po.Soil(density, b1, cohesion, angle, 0.5, pressure), Cavity(radius, rate, acceleration)
    exact = Constant(*map(mp.mpf, (b1, radius, rate, acceleration, angle, cohesion, pressure, density)))
    r = place * radius / math.sqrt(1 - b1)
    for quantity in QUANTITIES:
        of = getattr(exact, quantity)
        # At the front terms cancel that are as large as at the wall.
        size = max(abs(of(mp.mpf(r))), abs(of(mp.mpf(0))))
        hp.assert_close(field(quantity, r, cavity, soil), of(mp.mpf(r)), EXACT, quantity, size)
