"""Soils: named soils, and the domain of each property."""

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
    # The sets of values were not measured on single soils.
    for word in ("choice", "not measured", "density", "tool friction"):
        assert word in soil.source


@pytest.mark.parametrize(
    ("wrong", "suggested"),
    [
        ("hard pan", ["hardpan"]),
        ("Serozem", ["serozem"]),
        ("clay", ["heavy clay"]),
        ("sandy loam", ["firm sandy loam", "loose sandy loam"]),
    ],
)
def test_unknown_name_gets_the_nearest_suggested(wrong, suggested):
    with pytest.raises(po.InputError, match="did you mean") as error:
        po.named_soil(wrong)
    assert all(repr(name) in str(error.value) for name in suggested)


def test_own_soil_has_the_standard_atmosphere_and_no_elastic_constants():
    soil = po.Soil(1400.0, 0.8, 2e4, 0.5, 0.45)
    assert soil.ambient_pressure == 101325.0
    assert soil.youngs_modulus is None
    assert soil.poisson_ratio is None
    assert "user" in soil.source


# argument, its name in messages, refused values
DOMAIN = [
    ("density", "soil density", [0.0, -1400.0]),
    ("density_ratio", "density ratio b1", [1.0, 1.0001, 0.0, -0.2]),
    ("cohesion", "cohesion", [-1e-9, -2e4]),
    ("friction_angle", "friction angle", [-1e-9, math.pi / 2, 2.0]),
    ("tool_friction", "tool friction", [-0.1]),
    ("ambient_pressure", "ambient pressure", [-1.0]),
    ("youngs_modulus", "Young's modulus", [0.0, -1e6]),
    ("poisson_ratio", "Poisson's ratio", [-0.1, 0.5, 0.7]),
]


@pytest.mark.parametrize(("argument", "name", "values"), DOMAIN)
def test_number_outside_the_domain_is_refused_by_name_and_value(argument, name, values):
    firm = po.named_soil("firm sandy loam")
    good = getattr(firm, argument)
    for value in [*values, math.nan, math.inf, -math.inf]:
        for number in [float(value), np.array([good, value]), ca.DM(value), ca.SX(value), ca.MX(value)]:
            with pytest.raises(po.DomainError) as error:
                replace(firm, **{argument: number})
            assert any(f"{name} = {value:.{digits}g}" in str(error.value) for digits in (6, 17))
            assert ("must be finite" in str(error.value)) is not math.isfinite(value)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        *[(name, 0.0) for name in ("cohesion", "friction_angle", "tool_friction", "ambient_pressure", "poisson_ratio")],
        *[("density_ratio", 1e-300), ("density_ratio", math.nextafter(1.0, 0.0))],
        *[("friction_angle", math.nextafter(math.pi / 2, 0.0)), ("poisson_ratio", math.nextafter(0.5, 0.0))],
        *[("youngs_modulus", None), ("poisson_ratio", None)],
    ],
)
def test_ends_of_the_domain_are_allowed(argument, value):
    assert getattr(replace(po.named_soil("hardpan"), **{argument: value}), argument) == value
