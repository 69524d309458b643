"""What is no density profile, and where a density profile has no compaction front."""

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
        with pytest.raises(po.DomainError) as caught:
            quantity(CAVITY, PLAIN.with_density_profile(density))
        assert "front around a cavity of 0.05 m was not found" in str(caught.value)
        assert "let it compact more, or further out" in str(caught.value)


def test_a_profile_below_the_undisturbed_density_somewhere_behind_the_front_is_refused():
    soil = PLAIN.with_density_profile(lambda r: 1349.0 + 4000.0 * r)
    with pytest.raises(po.DomainError) as caught:
        plastic.stress(0.01, CAVITY, soil)
    assert f"density profile at 0 of the front radius over the undisturbed density = {1349 / 1350:.6g}" in str(
        caught.value
    )
    assert "must be above 1: behind the front the soil is denser than before" in str(caught.value)


@pytest.mark.parametrize("filled", [1.0001, 1.1, 10.0])
@pytest.mark.parametrize("order", [8, 40])
def test_a_profile_that_cannot_carry_the_soil_of_a_cavity_is_refused(filled, order):
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
    # R^2 = w^2 (ln 2 - ln(1 + exp(-(r*/w)^2))), which the order must resolve: the front is up to 3 w away.
    soil = PLAIN.with_density_profile(*FALLING, order=40)
    found = plastic.front_radius(Cavity(0.1 * math.sqrt(math.log(2.0) * filled), 0.0, 0.0), soil)
    wanted = 0.1 * math.sqrt(-math.log(math.expm1(math.log(2.0) * (1.0 - filled))))
    # Far out the soil is hardly denser than before, which magnifies the rounding of R by up to 1/(1 - b) = 1e4.
    assert found == pytest.approx(wanted, rel=1e-15 / (1.0 - filled) + 1e-14)


@pytest.mark.parametrize("order", [0, -3, 2.5, "16", None])
def test_an_order_that_is_none_is_refused(order):
    with pytest.raises(po.InputError) as caught:
        PLAIN.with_density_profile(lambda r: 1700.0 + 0.0 * r, order=order)
    assert f"order = {order!r}" in str(caught.value)
    assert "whole number from 1 on" in str(caught.value)


@pytest.mark.parametrize("density", [1700.0, None, "rho", [1700.0]])
def test_a_profile_that_is_no_function_is_refused(density):
    with pytest.raises(po.InputError) as caught:
        PLAIN.with_density_profile(density)
    assert repr(density) in str(caught.value)
    assert "a function of the radius, in kg/m^3" in str(caught.value)


def test_the_wall_pressure_needs_a_cavity():
    soil = ground("bell").soil(8)
    with pytest.raises(po.InputError, match="give its radius"):
        plastic.wall_pressure(soil)
    none, r = Cavity(0.0, 0.5, 0.0), 0.0
    for quantity in (
        plastic.front_speed,
        plastic.surface_pressure,
        *(
            lambda cavity, soil, name=name: getattr(plastic, name)(r, cavity, soil)
            for name in ("stress", "density", "current_radius", "particle_velocity", "particle_acceleration")
        ),
    ):
        with pytest.raises(po.DomainError, match="radius = 0 m must be above 0 m"):
            quantity(none, soil)


@pytest.mark.parametrize(("r", "words"), [(-0.01, "at least 0 m"), (0.5, "ahead of the front nothing moves")])
def test_radii_outside_the_field_are_refused(r, words):
    soil = ground("bell").soil(8)
    for name in (
        "stress",
        "density",
        "current_radius",
        "particle_velocity",
        "particle_acceleration",
        "quadrature_error",
    ):
        with pytest.raises(po.DomainError, match=words):
            getattr(plastic, name)(r, CAVITY, soil)


def test_the_quadratures_error_is_one_of_numbers():
    with pytest.raises(po.InputError, match="holds symbols"):
        plastic.quadrature_error(ca.SX.sym("r"), CAVITY, ground("bell").soil(8))
