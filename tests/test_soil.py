"""Soils: named soils, and the domain of each property of a soil and a share."""

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.soil.soil import STANDARD_ATMOSPHERE

# density, locked density [kg/m^3], b1, cohesion [kPa], friction angle [deg], mu0, E [MPa], Poisson's ratio
TABLE = {
    "loose sandy loam": (1300, 1800, 0.722, 5, 30, 0.40, 3, 0.30),
    "firm sandy loam": (1500, 1840, 0.815, 15, 32, 0.45, 8, 0.30),
    "serozem": (1350, 1700, 0.794, 20, 28, 0.50, 10, 0.33),
    "hardpan": (1600, 1750, 0.914, 35, 32, 0.50, 20, 0.35),
    "heavy clay": (1300, 1600, 0.812, 45, 15, 0.40, 8, 0.40),
}


@pytest.mark.parametrize("name", TABLE)
def test_named_soil_has_the_values_of_the_table(name):
    soil = po.named_soil(name)
    density, locked, ratio, cohesion, friction, tool_friction, modulus, poisson = TABLE[name]
    assert soil.name == name
    assert soil.density == density
    assert soil.density_ratio == ratio
    assert soil.density_ratio == pytest.approx(density / locked, abs=5.01e-4)  # the table rounds to three digits
    assert soil.cohesion == 1e3 * cohesion
    assert math.degrees(soil.friction_angle) == pytest.approx(friction, rel=3e-16)
    assert soil.tool_friction == tool_friction
    assert soil.ambient_pressure == STANDARD_ATMOSPHERE == 101325.0
    assert soil.youngs_modulus == 1e6 * modulus
    assert soil.poisson_ratio == poisson
    assert "not measured" in soil.source


def test_an_unknown_name_gets_the_nearest_suggested():
    with pytest.raises(po.InputError, match="did you mean 'firm sandy loam' or 'loose sandy loam'"):
        po.named_soil("sandy loam")


FIRM, WEDGE, CONE = po.named_soil("firm sandy loam"), po.Wedge(0.5, 0.2, 0.3), po.Cone(0.2, 0.3)
RIGHT = math.pi / 2
# What has the number, the number's name there and in messages, refused values, and allowed values at the domain's ends.
DOMAIN = [
    (FIRM, "density", "soil density", [0.0, -1400.0], []),
    (FIRM, "density_ratio", "density ratio b1", [1.0, 1.0001, 0.0, -0.2], [1e-300, math.nextafter(1.0, 0.0)]),
    (FIRM, "cohesion", "cohesion", [-1e-9], [0.0]),
    (FIRM, "friction_angle", "friction angle", [-1e-9, RIGHT, 2.0], [0.0, math.nextafter(RIGHT, 0.0)]),
    (FIRM, "tool_friction", "tool friction", [-0.1], [0.0]),
    (FIRM, "ambient_pressure", "ambient pressure", [-1.0], [0.0]),
    (FIRM, "youngs_modulus", "Young's modulus", [0.0, -1e6], [None]),
    (FIRM, "poisson_ratio", "Poisson's ratio", [-0.1, 0.5, 0.7], [0.0, math.nextafter(0.5, 0.0), None]),
    (WEDGE, "angle", "wedge angle", [0.0, -0.1, RIGHT, 2.0], []),
    (WEDGE, "chisel_angle", "chisel angle", [-1e-9, RIGHT, 2.0], [0.0]),
    (WEDGE, "height", "share height", [0.0, -0.3], []),
    (CONE, "half_angle", "half angle", [0.0, -0.1, RIGHT, 2.0], []),
    (CONE, "height", "share height", [0.0, -0.3], []),
]


@pytest.mark.parametrize(("thing", "argument", "name", "refused", "allowed"), DOMAIN)
def test_numbers_outside_the_domain_are_refused_by_name_and_value(thing, argument, name, refused, allowed):
    for value in [*refused, math.nan, math.inf, -math.inf]:
        for number in [value, np.array([getattr(thing, argument), value]), ca.DM(value), ca.SX(value), ca.MX(value)]:
            with pytest.raises(po.DomainError) as error:
                replace(thing, **{argument: number})
            assert any(f"{name} = {value:.{digits}g}" in str(error.value) for digits in (6, 17))
            assert ("must be finite" in str(error.value)) is not math.isfinite(value)
    for value in allowed:
        assert getattr(replace(thing, **{argument: value}), argument) == value
