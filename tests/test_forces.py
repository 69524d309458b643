"""Soils, shares, scenes, resistance and cone index, equations (5)-(7) and (24)-(26), against independent values."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.equations import FIRM, SOIL, forces, resistance
from helpers.high_precision import assert_close, assert_derivatives, mp
from helpers.refusals import refusals
from helpers.scenes import SEROZEM, SHARE, scene_of

import plough_opt as po
from plough_opt.soil import elastic

# --- properties ---


def test_reaction_omits_effects_that_are_off(r1_scene):
    full = po.soil_reaction(r1_scene().cone, r1_scene().soil)
    dry = po.soil_reaction(r1_scene().cone, replace(r1_scene().soil, ambient_pressure=0.0))
    assert r1_scene().reaction == full
    assert r1_scene(inertial_drag=False).reaction == replace(full, drag=0.0)
    assert r1_scene(added_mass=False).reaction == replace(full, added_mass=0.0)
    assert r1_scene(ambient_pressure=False).reaction == dry
    assert dry.static < full.static


# --- warnings ---


@pytest.mark.parametrize("name", po.soil_names())
@pytest.mark.parametrize(("pressure", "advised"), [(101325.0, True), (8e3, False)])
def test_ambient_share_is_the_part_of_the_pressure(r1_scene, name, pressure, advised):
    # It does not depend on the share: A is proportional to nu p_a + tau0/(1 + mu), equation (26).
    soil = replace(po.named_soil(name), ambient_pressure=pressure)
    mu = math.sin(soil.friction_angle)
    ambient, own = 2 * mu * pressure, 2 * soil.cohesion * math.cos(soil.friction_angle)
    share = ambient / (ambient + own)
    for scene in (r1_scene(soil=soil), r1_scene(12.0, 0.4, soil=soil)):
        assert scene.ambient_share == pytest.approx(share, rel=1e-13)
    (warning,) = r1_scene(soil=soil).warnings()
    assert f"({pressure / 1e3:.4g} kPa) carries {100 * share:.0f} % of the static draft" in warning
    assert ("set soil.ambient_pressure" in warning) == advised


@pytest.mark.parametrize(("half_angle", "warned"), [(15.0, False), (19.99, False), (20.01, True), (35.0, True)])
def test_a_blunt_share_carries_a_warning(r1_scene, half_angle, warned):
    scene = replace(r1_scene(ambient_pressure=False), share=po.Cone(po.deg(half_angle), 0.25))
    found = scene.warnings()
    assert bool(found) == warned
    assert not warned or (f"half angle is {half_angle:.1f} deg" in found[0] and "plane sections" in found[0])


def test_the_speed_term_is_as_small_as_the_readme_says():
    """The percentages of the draft hold for the best share of the cotton problem in all named soils."""
    cone = po.Wedge(po.deg(39.1), po.deg(15), 0.254).equivalent_cone()
    for speed, low, high in ((1.0, 0.15, 0.35), (2.0, 0.65, 1.35), (3.0, 1.5, 3.0)):
        for name in po.soil_names():
            soil = po.named_soil(name)
            part = 1.0 - po.resistance(cone, soil, 0.0, 0.0) / po.resistance(cone, soil, speed, 0.0)
            assert low < 100.0 * float(part) < high, (name, speed)


# --- the elastic medium: the steady contact force, and what it lacks beside the plastic gas ---


def scene(medium="elastic", **changes):
    return scene_of(**{"medium": medium, "stiffness": 5e5, "motion": False} | changes)


@pytest.mark.parametrize("share", [SHARE, SHARE.equivalent_cone()], ids=["wedge", "cone"])
def test_draft_is_the_contact_force_on_the_equivalent_cone(share):
    force = elastic.cone_force(SHARE.equivalent_cone(), SEROZEM, 2.0)
    run = po.simulate(scene(share=share), duration=1.0)
    assert run.mean_draft == pytest.approx(force, rel=1e-14)
    np.testing.assert_allclose(run.mount_force, force, rtol=1e-14)
    np.testing.assert_allclose(run.deflection, force / 5e5, rtol=1e-14)
    # Rounding of the average of a constant.
    assert run.force_rms <= 1e-14 * force
    assert run.tow_power == pytest.approx(2.0 * force, rel=1e-14)


def test_scene_carries_no_part_of_the_plastic_gas():
    own = scene()
    assert own.inertia == 20.0
    assert own.reaction.drag == own.reaction.added_mass == own.ambient_share == 0.0
    assert any("order of magnitude" in warning for warning in own.warnings())
    assert not any("order of magnitude" in warning for warning in scene("plastic").warnings())
    # The soil presses on the whole cone, so contact is never lost and the force above ambient pressure stays.
    assert scene(ambient_pressure=False).steady_resistance == pytest.approx(own.steady_resistance, rel=1e-14)
    run = po.simulate(own, duration=1.0)
    for loosened in (lambda: run.specific_draft, lambda: own.loosened_radius):
        with pytest.raises(po.InputError, match="no compaction front"):
            loosened()
    assert json.loads(run.to_json())["specific_draft"] is None


# --- soils, and the domain of each property of a soil and a share ---


LOAM, WEDGE, CONE = po.named_soil("firm sandy loam"), po.Wedge(0.5, 0.2, 0.3), po.Cone(0.2, 0.3)
RIGHT = math.pi / 2
# What has the number, the number's name there and in messages, refused values, and allowed values at the domain's ends.
DOMAIN = [
    (LOAM, "density", "soil density", [0.0, -1400.0], []),
    (LOAM, "density_ratio", "density ratio b1", [1.0, 1.0001, 0.0, -0.2], [1e-300, math.nextafter(1.0, 0.0)]),
    (LOAM, "cohesion", "cohesion", [-1e-9], [0.0]),
    (LOAM, "friction_angle", "friction angle", [-1e-9, RIGHT, 2.0], [0.0, math.nextafter(RIGHT, 0.0)]),
    (LOAM, "tool_friction", "tool friction", [-0.1], [0.0]),
    (LOAM, "ambient_pressure", "ambient pressure", [-1.0], [0.0]),
    (LOAM, "youngs_modulus", "Young's modulus", [0.0, -1e6], [None]),
    (LOAM, "poisson_ratio", "Poisson's ratio", [-0.1, 0.5, 0.7], [0.0, math.nextafter(0.5, 0.0), None]),
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


# --- resistance against independent values and 120 digits ---


# The documented accuracy is 1e-12; some hundred roundings of 1.1e-16 allow a bound ten times tighter.
DIGITS = 1e-13


def outputs(values):
    """Return resistance, F0, Fd and added mass for the values in the order of `FIRM`."""
    v = dict(zip(FIRM, values, strict=True))
    cone = po.Wedge(v["wedge_angle"], v["chisel_angle"], v["height"]).equivalent_cone()
    soil = po.Soil(**{name: v[name] for name in SOIL})
    reaction = po.soil_reaction(cone, soil)
    return po.resistance(cone, soil, v["speed"], v["acceleration"]), reaction.static, reaction.drag, reaction.added_mass


@pytest.fixture(scope="module", params=[ca.SX, ca.MX], ids=["SX", "MX"])
def symbolic(request):
    """Return a function of the values: the resistance, its gradient and its Hessian."""
    return hp.differentiated(lambda *x: outputs(x)[0], request.param, len(FIRM))


INDEPENDENT = json.loads((Path(__file__).parent / "reference" / "plastic.json").read_text(encoding="utf-8"))["cases"]


@pytest.mark.parametrize(
    "case", INDEPENDENT, ids=[f"{case['kind']}-{number}" for number, case in enumerate(INDEPENDENT)]
)
def test_independent_values(symbolic, case):
    """Every value of the table, which was computed from the source by another program, with 60 digits."""
    point, wanted = [float(case["inputs"][name]) for name in FIRM], case["outputs"]
    share = po.Wedge(*point[:3])
    cone, soil = share.equivalent_cone(), po.Soil(**{name: float(case["inputs"][name]) for name in SOIL})
    coefficients, forces = po.resistance_coefficients(cone, soil), outputs(point)
    value, gradient, hessian = symbolic(point)
    found = vars(coefficients) | {"half_angle": cone.half_angle, "wedge_area": share.area, "added_mass": forces[3]}
    for i, name in enumerate(FIRM):
        found |= {f"d_resistance_d_{name}": gradient[i], f"d2_resistance_d_{name}2": hessian[i, i]}
        found |= {f"d2_resistance_d_{name}_d_{other}": hessian[i, j] for j, other in enumerate(FIRM)}
    for result in (forces[0], value):
        found["resistance"] = result
        for name, number in wanted.items():
            assert_close(found[name], number, DIGITS, name)


# Under deceleration the terms of the resistance cancel in part.
ORDINARY = [
    *[{name: value * factor for (name, value), factor in zip(FIRM.items(), row, strict=True)}
      for row in np.random.default_rng(0).uniform(0.5, 1.2, (8, len(FIRM))).tolist()],
    {"acceleration": -40.0}, {"height": 1e-4}, {"height": 5.0},
]  # fmt: skip
SINGULAR = [
    *[{"friction_angle": v} for v in (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1.5, 1.569)],
    *[{"density_ratio": v} for v in (1e-12, 1e-9, 1e-6, 1e-3, 0.5, 1 - math.exp(-1), 0.99, 1 - 1e-6, 1 - 1e-9)],
    *[{"wedge_angle": v} for v in (1e-8, 1e-4, 1.5, math.radians(89.0))],
    *[{"chisel_angle": v} for v in (0.0, 1e-9, 1.4)],
    *[{"cohesion": 0.0, "ambient_pressure": v} for v in (0.0, 1e5)],
    {"tool_friction": 0.0, "speed": 0.0, "acceleration": 0.0},
    {"wedge_angle": 1e-8, "density_ratio": 1e-12, "friction_angle": 0.0},
    {"wedge_angle": 1e-8, "density_ratio": 1 - 1e-9, "friction_angle": 1e-12},
]


@cache
def precise_derivatives(*point):
    return hp.derivatives(resistance, point)


@pytest.mark.parametrize("change", [*ORDINARY, *SINGULAR], ids=str)
def test_forces_gradient_and_hessian_up_to_the_singularities(symbolic, change):
    values = FIRM | change
    wanted = precise_derivatives(*values.values())
    exact = wanted[0], *forces({name: mp.mpf(value) for name, value in values.items()})
    for name, found, true in zip(("F", "F0", "Fd", "added mass"), outputs(values.values()), exact, strict=True):
        assert_close(found, true, DIGITS, name)
    assert_derivatives(symbolic([*values.values()]), wanted, DIGITS, FIRM)


def test_arrays_are_computed_element_by_element():
    points = np.array([[*(FIRM | change).values()] for change in (*ORDINARY, *SINGULAR)])
    one_by_one = [outputs(point) for point in points.tolist()]
    np.testing.assert_allclose(np.transpose(outputs(points.T)), one_by_one, rtol=DIGITS)
    # h tan(beta) / sqrt(1 - b1)
    wanted = 0.3 * np.tan([0.1, 0.2]) / math.sqrt(0.2)
    radii = po.loosened_radius(po.Cone(np.array([0.1, 0.2]), 0.3), po.Soil(*(FIRM[name] for name in SOIL)))
    np.testing.assert_allclose(radii, wanted, rtol=1e-15)


# --- the cone index of a soil, and soils from a cone index ---


ADJUSTS = ("strength factor", "cohesion", "density ratio")


def precise(soil):
    """Return (1 + mu0/tan b) (a^(nu/2) - 1)/nu (nu p_a + tau0/(1 + mu)) with 120 digits."""
    mu, beta = mp.sin(soil.friction_angle), mp.mpf(15) * mp.pi / 180
    nu = 2 * mu / (1 + mu)
    growth = ((1 / (1 - mp.mpf(soil.density_ratio))) ** (nu / 2) - 1) / nu
    tau0 = 2 * mp.mpf(soil.cohesion) * mp.cos(soil.friction_angle)
    strength = nu * soil.ambient_pressure + tau0 / (1 + mu)
    return float((1 + soil.tool_friction / mp.tan(beta)) * growth * strength)


@pytest.mark.parametrize("pressure", [101325.0, 5e3])
@pytest.mark.parametrize("name", po.soil_names())
def test_the_cone_index_is_the_formula(name, pressure):
    soil = replace(po.named_soil(name), ambient_pressure=pressure)
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


def test_a_strength_factor_scales_the_static_resistance_and_nothing_else():
    soil = po.named_soil("hardpan")
    strong = replace(soil, strength_factor=3.0)
    cone = po.Cone(po.deg(12.0), 0.25)
    weak, found = po.soil_reaction(cone, soil), po.soil_reaction(cone, strong)
    coefficients = [po.resistance_coefficients(cone, one).A for one in (soil, strong)]
    assert [found.static, coefficients[1]] == pytest.approx([3.0 * weak.static, 3.0 * coefficients[0]], rel=1e-15)
    assert (found.drag, found.added_mass) == (weak.drag, weak.added_mass)
    assert po.loosened_radius(cone, strong) == po.loosened_radius(cone, soil)
    cavity = po.plastic.Cavity(0.05, 0.5, 0.0)
    assert po.plastic.surface_pressure(cavity, strong) == po.plastic.surface_pressure(cavity, soil)


STRENGTHLESS = po.Soil(1350.0, 0.8, 0.0, 0.0, 0.5)


CLAY = po.named_soil("heavy clay")
test_readings_that_cannot_be_met_are_refused = refusals(
    (po.InputError, po.DomainError),
    (lambda: po.Soil.from_cone_index(0.0, SEROZEM, "cohesion"), "cone index = 0 Pa must be above 0"),
    (lambda: po.Soil.from_cone_index(1e5, CLAY, "cohesion"), r"3\.574 kPa above the reading"),
    (lambda: po.Soil.from_cone_index(1e6, SEROZEM, "cohesian"), "cohesion"),
    (lambda: po.Soil.from_cone_index(1e6, STRENGTHLESS), "zero strength"),
    (lambda: po.Soil.from_cone_index(1e6, "serozem"), "must be the Soil"),
    (lambda: po.Soil.from_cone_index(1e6, SEROZEM.with_density_profile(abs)), "a density profile cannot be adjusted"),
)


# --- density ratio from a compression test ---

PRESSURES, LOST = [25e3, 50e3, 100e3, 200e3], [0.0103, 0.0208, 0.0393, 0.0654]


def test_density_ratio_follows_a_compression_test():
    x = ca.SX.sym("pressure")
    symbolic = po.Soil.from_compaction(PRESSURES, LOST, replace(SEROZEM, ambient_pressure=x)).density_ratio
    at = np.array([*PRESSURES, 31e3, 77e3, 160e3])
    # NumPy's interpolation of the logarithms; twelve digits are those of exp and log at numbers near 10.
    expected = 1.0 - np.exp(np.interp(np.log(at), np.log(PRESSURES), np.log(LOST)))
    soil = replace(SEROZEM, ambient_pressure=at)
    found = po.Soil.from_compaction([f"{p / 1e3:g} kPa" for p in PRESSURES], LOST, soil)
    np.testing.assert_allclose(found.density_ratio, expected, rtol=1e-12)
    of_pressure = ca.Function("of_pressure", [x], [symbolic])
    np.testing.assert_allclose([float(of_pressure(p)) for p in at], expected, rtol=1e-12)


def compacted(pressure=PRESSURES, lost=LOST, soil=SEROZEM):
    return po.Soil.from_compaction(pressure, lost, soil)


test_compression_tests_that_do_not_fit_are_refused = refusals(
    po.InputError,
    (lambda: compacted(soil=replace(SEROZEM, ambient_pressure=5e3)), "outside the compression test, 25 to 200 kPa"),
    (lambda: compacted([5e4, 4e4], [0.1, 0.2]), "must rise from above 0"),
    (lambda: compacted([5e4, 2e5], [0.1, 1.0]), "must rise from above 0 to below 1"),
    (lambda: compacted(soil=SEROZEM.with_density_profile(abs)), "no density ratio"),
)
