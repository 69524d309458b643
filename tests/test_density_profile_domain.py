"""Density profiles that are refused, or lack a compaction front."""

import math

import casadi as ca
import pytest
from helpers.density_profiles import ground

import plough_opt as po
from plough_opt.core.expressions import exp
from plough_opt.soil import plastic
from plough_opt.soil.plastic import Cavity

PLAIN = po.Soil(1350.0, 0.5, 2e4, 0.5, 0.45, 1e4)
CAVITY = Cavity(0.05, 0.5, 0.0)
OF_CAVITY = ("front_radius", "front_speed", "surface_pressure")
FIELD = ("stress", "density", "current_radius", "particle_velocity", "particle_acceleration")


def falling(r):
    """Return a density that carries the soil of cavities up to R^2 = 0.01 m^2 ln 2."""
    return 1350.0 * (1.0 + exp(-((r / 0.1) ** 2)))


def cavity_of(filled):
    """Return the radius of a cavity with a part of the soil that `falling` carries."""
    return 0.1 * math.sqrt(math.log(2.0) * filled)


@pytest.mark.parametrize("order", [8, 40])
@pytest.mark.parametrize(
    ("density", "radius"),
    [
        (lambda _r: 1349.0, 0.05),
        (lambda r: 1500.0 - 4000.0 * r, 0.05),
        *((falling, cavity_of(filled)) for filled in (1.0001, 1.1, 10.0)),
    ],
)
def test_a_profile_that_cannot_hold_the_soil_of_a_cavity_has_no_front(density, radius, order):
    words = f"cavity of {radius:.4g} m was not found.*make the profile denser or wider"
    for quantity in OF_CAVITY:
        with pytest.raises(po.DomainError, match=words):
            getattr(plastic, quantity)(Cavity(radius, 0.5, 3.0), PLAIN.with_density_profile(density, order=order))


def test_a_profile_below_the_undisturbed_density_somewhere_behind_the_front_is_refused():
    soil = PLAIN.with_density_profile(lambda r: 1349.0 + 4000.0 * r)
    words = f"at 0 of the front radius over the undisturbed density = {1349 / 1350:.6g} must be above 1: .* compacted"
    with pytest.raises(po.DomainError, match=words):
        plastic.stress(0.01, CAVITY, soil)


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


@pytest.mark.parametrize(
    ("density", "order", "words"),
    [
        *((falling, order, f"order = {order!r} .*positive integer") for order in (0, 2.5, "16", None)),
        *((density, 16, f"{density!r}.* a function of the radius, in kg/m") for density in (1700.0, "rho")),
    ],
)
def test_invalid_profiles_are_refused(density, order, words):
    with pytest.raises(po.InputError, match=words):
        PLAIN.with_density_profile(density, order=order)


def test_the_wall_pressure_needs_a_cavity():
    soil, none = ground("bell").soil(8), Cavity(0.0, 0.5, 0.0)
    with pytest.raises(po.InputError, match="give its radius"):
        plastic.wall_pressure(soil)
    for name in ("front_speed", "surface_pressure", *FIELD):
        with pytest.raises(po.DomainError, match="radius = 0 m must be above 0 m"):
            getattr(plastic, name)(*([0.0] if name in FIELD else []), none, soil)


@pytest.mark.parametrize(("r", "words"), [(-0.01, "at least 0 m"), (0.5, "over front radius")])
@pytest.mark.parametrize("soil", [ground("bell").soil(8), PLAIN], ids=["profile", "constant"])
def test_radii_outside_the_field_are_refused(soil, r, words):
    for name in (*FIELD, *(["quadrature_error"] if soil is not PLAIN else [])):
        with pytest.raises(po.DomainError, match=words):
            getattr(plastic, name)(r, CAVITY, soil)
    with pytest.raises(po.InputError, match="holds symbols"):
        plastic.quadrature_error(ca.SX.sym("r"), CAVITY, ground("bell").soil(8))
