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
FALLING = (lambda r, width: 1350.0 * (1.0 + exp(-((r / width) ** 2))), 0.1)
"""Carries the soil of cavities up to R^2 = width^2 ln 2."""


@pytest.mark.parametrize("density", [lambda _r: 1349.0, lambda r: 1300.0 + 0.0 * r, lambda r: 1500.0 - 4000.0 * r])
def test_soil_that_does_not_compact_enough_has_no_front(density):
    for quantity in (plastic.front_radius, plastic.front_speed, plastic.surface_pressure):
        with pytest.raises(po.DomainError, match=r"cavity of 0\.05 m was not found.*make the profile denser or wider"):
            quantity(CAVITY, PLAIN.with_density_profile(density))


def test_a_profile_below_the_undisturbed_density_somewhere_behind_the_front_is_refused():
    soil = PLAIN.with_density_profile(lambda r: 1349.0 + 4000.0 * r)
    words = f"at 0 of the front radius over the undisturbed density = {1349 / 1350:.6g} must be above 1: .* compacted"
    with pytest.raises(po.DomainError, match=words):
        plastic.stress(0.01, CAVITY, soil)


@pytest.mark.parametrize("filled", [1.0001, 1.1, 10.0])
@pytest.mark.parametrize("order", [8, 40])
def test_a_profile_that_cannot_hold_the_soil_of_a_cavity_is_refused(filled, order):
    soil = PLAIN.with_density_profile(*FALLING, order=order)
    radius = 0.1 * math.sqrt(math.log(2.0) * filled)
    with pytest.raises(po.DomainError, match=f"around a cavity of {radius:.4g} m was not found"):
        plastic.front_radius(Cavity(radius, 0.5, 3.0), soil)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_an_expression_without_a_front_has_no_value(symbol):
    radius = symbol.sym("R")
    cavity, soil = Cavity(radius, 0.5, 3.0), PLAIN.with_density_profile(*FALLING, order=8)
    function = ca.Function("f", [radius], [plastic.front_radius(cavity, soil), plastic.surface_pressure(cavity, soil)])
    for filled in (0.9, 1.0001, 1.1, 10.0):
        found = [float(value) for value in function(0.1 * math.sqrt(math.log(2.0) * filled))]
        assert [math.isfinite(value) for value in found] == 2 * [filled < 1.0]
        assert [math.isnan(value) for value in found] == 2 * [filled > 1.0]


@pytest.mark.parametrize("filled", [0.5, 0.9, 0.99, 0.9999])
def test_the_front_is_found_up_to_the_largest_cavity(filled):
    # R^2 = w^2 (ln 2 - ln(1 + exp(-(r*/w)^2))). The quadrature must resolve it: the front is up to 3 w away.
    soil = PLAIN.with_density_profile(*FALLING, order=40)
    found = plastic.front_radius(Cavity(0.1 * math.sqrt(math.log(2.0) * filled), 0.0, 0.0), soil)
    wanted = 0.1 * math.sqrt(-math.log(math.expm1(math.log(2.0) * (1.0 - filled))))
    # Far out the soil is hardly compacted, which magnifies the rounding of R by up to 1/(1 - b) = 1e4.
    assert found == pytest.approx(wanted, rel=1e-15 / (1.0 - filled) + 1e-14)


@pytest.mark.parametrize(
    ("density", "order", "words"),
    [
        *[(lambda r: 1700.0 + 0.0 * r, order, "positive integer") for order in (0, 2.5, "16", None)],
        *[(density, 16, r"a function of the radius, in kg/m\^3") for density in (1700.0, None, "rho")],
    ],
)
def test_invalid_profiles_are_refused(density, order, words):
    with pytest.raises(po.InputError, match=words) as caught:
        PLAIN.with_density_profile(density, order=order)
    assert (f"order = {order!r}" if callable(density) else repr(density)) in str(caught.value)


FIELD = ("stress", "density", "current_radius", "particle_velocity", "particle_acceleration")


def test_the_wall_pressure_needs_a_cavity():
    soil, none = ground("bell").soil(8), Cavity(0.0, 0.5, 0.0)
    with pytest.raises(po.InputError, match="give its radius"):
        plastic.wall_pressure(soil)
    for name in ("front_speed", "surface_pressure", *FIELD):
        given = (none, soil) if name not in FIELD else (0.0, none, soil)
        with pytest.raises(po.DomainError, match="radius = 0 m must be above 0 m"):
            getattr(plastic, name)(*given)


@pytest.mark.parametrize(("r", "words"), [(-0.01, "at least 0 m"), (0.5, "over front radius")])
def test_radii_outside_the_field_are_refused(r, words):
    for soil in (ground("bell").soil(8), PLAIN):
        for name in (*FIELD, *(["quadrature_error"] if soil is not PLAIN else [])):
            with pytest.raises(po.DomainError, match=words):
                getattr(plastic, name)(r, CAVITY, soil)


def test_the_quadrature_error_needs_numbers():
    with pytest.raises(po.InputError, match="holds symbols"):
        plastic.quadrature_error(ca.SX.sym("r"), CAVITY, ground("bell").soil(8))
