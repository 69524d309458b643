"""The cone index of a soil, and soils from a cone index."""

import dataclasses
import math

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from helpers.refusals import refusals
from helpers.scenes import scene_of

import plough_opt as po

ADJUSTS = ("strength factor", "cohesion", "density ratio")


def precise(soil):
    """Return (1 + mu0/tan b) (a^(nu/2) - 1)/nu (nu p_a + tau0/(1 + mu)) with 40 digits."""
    with mp.workdps(40):
        mu, beta = mp.sin(soil.friction_angle), mp.mpf(15) * mp.pi / 180
        nu = 2 * mu / (1 + mu)
        growth = ((1 / (1 - mp.mpf(soil.density_ratio))) ** (nu / 2) - 1) / nu
        tau0 = 2 * mp.mpf(soil.cohesion) * mp.cos(soil.friction_angle)
        strength = nu * soil.ambient_pressure + tau0 / (1 + mu)
        return float((1 + soil.tool_friction / mp.tan(beta)) * growth * strength)


@pytest.mark.parametrize("pressure", [101325.0, 5e3])
@pytest.mark.parametrize("name", po.soil_names())
def test_the_cone_index_is_the_formula(name, pressure):
    soil = dataclasses.replace(po.named_soil(name), ambient_pressure=pressure)
    # A dozen operations cost a few of the last bits.
    assert po.cone_index(soil) == pytest.approx(precise(soil), rel=2e-15)


@pytest.mark.parametrize("adjust", ADJUSTS)
@pytest.mark.parametrize("name", po.soil_names())
def test_a_soil_from_a_cone_index_has_that_cone_index(adjust, name):
    named, readings, x = po.named_soil(name), np.array([0.7e6, 1.5e6, 6e6]), ca.SX.sym("x")
    soil = po.Soil.from_cone_index(readings, soil=named, adjust=adjust)
    # For a density ratio of 1 - 1e-4 cancellation costs four of sixteen digits.
    assert po.cone_index(soil) == pytest.approx(readings, rel=1e-12)
    changed = {key for key, value in vars(soil).items() if np.any(value != vars(named)[key])}
    assert changed == {adjust.replace(" ", "_"), "name", "source"}
    index = po.cone_index(po.Soil.from_cone_index(x, soil=named, adjust=adjust))
    back = ca.Function("back", [x], [index, ca.jacobian(index, x)])
    assert [float(one) for one in back(1.5e6)] == pytest.approx([1.5e6, 1.0], rel=1e-12)


def test_the_draft_of_a_share_follows_the_closed_ratio():
    soil = po.Soil.from_cone_index(2e6, soil=po.named_soil("firm sandy loam"))
    cone = po.Cone(po.deg(11.0), 0.3)
    base = math.pi * (0.3 * math.tan(po.deg(11.0))) ** 2
    ratio = (1 + 0.45 / math.tan(po.deg(11.0))) / (1 + 0.45 / math.tan(po.deg(15.0)))
    assert po.resistance(cone, soil, 0.0, 0.0) == pytest.approx(2e6 * base * ratio, rel=1e-14)


def test_a_strength_factor_scales_the_static_resistance_and_nothing_else():
    soil = po.named_soil("hardpan")
    strong = dataclasses.replace(soil, strength_factor=3.0)
    cone = po.Cone(po.deg(12.0), 0.25)
    weak, found = po.soil_reaction(cone, soil), po.soil_reaction(cone, strong)
    coefficients = [po.resistance_coefficients(cone, one).A for one in (soil, strong)]
    assert [found.static, coefficients[1]] == pytest.approx([3.0 * weak.static, 3.0 * coefficients[0]], rel=1e-15)
    assert (found.drag, found.added_mass) == (weak.drag, weak.added_mass)
    assert po.loosened_radius(cone, strong) == po.loosened_radius(cone, soil)
    cavity = po.plastic.Cavity(0.05, 0.5, 0.0)
    assert po.plastic.surface_pressure(cavity, strong) == po.plastic.surface_pressure(cavity, soil)


STRENGTHLESS = po.Soil(1350.0, 0.8, 0.0, 0.0, 0.5)


SEROZEM, CLAY = po.named_soil("serozem"), po.named_soil("heavy clay")
test_readings_that_cannot_be_met_are_refused = refusals(
    (po.InputError, po.DomainError),
    (lambda: po.Soil.from_cone_index(0.0, SEROZEM, "cohesion"), "cone index = 0 Pa must be above 0"),
    (lambda: po.Soil.from_cone_index(1e5, CLAY, "cohesion"), r"3\.574 kPa above the reading"),
    (lambda: po.Soil.from_cone_index(1e6, SEROZEM, "cohesian"), "cohesion"),
    (lambda: po.Soil.from_cone_index(1e6, STRENGTHLESS), "zero strength"),
    (lambda: po.Soil.from_cone_index(1e6, "serozem"), "must be the Soil"),
    (lambda: po.Soil.from_cone_index(1e6, SEROZEM.with_density_profile(abs)), "a density profile cannot be adjusted"),
)


def test_a_soil_without_strength_gets_cohesion():
    soil = po.Soil.from_cone_index(1e6, soil=STRENGTHLESS, adjust="cohesion")
    assert po.cone_index(soil) == pytest.approx(1e6, rel=1e-14)


def test_properties_outside_the_range_of_soils_cause_warnings():
    serozem = po.named_soil("serozem")
    warned = {a: " ".join(po.Soil.from_cone_index(1.5e6, soil=serozem, adjust=a).warnings()) for a in ADJUSTS}
    expected = {"strength factor": "static resistance by 5.737", "cohesion": "370 kPa", "density ratio": "11.5 times"}
    assert all(words in warned[adjust] for adjust, words in expected.items())
    assert "0.992465" in warned["density ratio"]
    assert serozem.warnings() == ()
    scene = scene_of(po.Soil.from_cone_index(1.5e6, soil=serozem), motion=False)
    assert any("strength factor" in text for text in po.simulate(scene, 1.0).warnings)
