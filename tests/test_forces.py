"""Resistance of the soil to the share, equations (24)-(26), against reference values and 120 digits."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.equations import FIRM, resistance
from helpers.high_precision import assert_close, assert_derivatives

import plough_opt as po

# The documented accuracy is 1e-12; some hundred roundings of 1.1e-16 allow a bound ten times tighter.
DIGITS = 1e-13

REFERENCE = json.loads((Path(__file__).parent / "reference" / "plastic.json").read_text())["cases"]
CASES = [pytest.param(case, id=f"{case['kind']}-{number}") for number, case in enumerate(REFERENCE)]


def share_and_soil(values):
    """Build wedge and soil from values by name."""
    share = po.Wedge(values["wedge_angle"], values["chisel_angle"], values["height"])
    of_soil = ("density", "density_ratio", "cohesion", "friction_angle", "tool_friction", "ambient_pressure")
    return share, po.Soil(**{name: values[name] for name in of_soil})


def outputs(values):
    """Return the quantities in the reference file, except derivatives."""
    share, soil = share_and_soil(values)
    cone = share.equivalent_cone()
    coefficients = po.resistance_coefficients(cone, soil)
    return {
        "half_angle": cone.half_angle,
        "A": coefficients.A,
        "B": coefficients.B,
        "C": coefficients.C,
        "resistance": po.resistance(cone, soil, values["speed"], values["acceleration"]),
        "added_mass": po.added_mass(cone, soil),
        "wedge_area": share.area,
    }


@pytest.fixture(scope="module", params=[ca.SX, ca.MX], ids=["SX", "MX"])
def symbolic(request):
    """Return a Function from the eleven values to the outputs and to gradient and Hessian of the resistance."""
    x = request.param.sym("x", len(FIRM))
    out = outputs(dict(zip(FIRM, ca.vertsplit(x), strict=True)))
    hessian, gradient = ca.hessian(out["resistance"], x)
    return ca.Function("f", [x], [*out.values(), gradient, hessian], ["x"], [*out, "gradient", "hessian"])


def by_automatic_differentiation(symbolic, values):
    """Return the outputs with the derivatives under the names of the reference file."""
    out = symbolic(x=list(values.values()))
    gradient, hessian = out.pop("gradient").full()[:, 0], out.pop("hessian").full()
    named = {name: float(value) for name, value in out.items()}
    for i, name in enumerate(FIRM):
        named[f"d_resistance_d_{name}"] = gradient[i]
        named[f"d2_resistance_d_{name}2"] = hessian[i, i]
        named |= {f"d2_resistance_d_{name}_d_{other}": hessian[i, j] for j, other in enumerate(FIRM)}
    return named


@pytest.mark.parametrize("case", CASES)
def test_reference_from_numbers_and_symbols(symbolic, case):
    values, wanted = {name: float(case["inputs"][name]) for name in FIRM}, case["outputs"]
    found, numbers = by_automatic_differentiation(symbolic, values), outputs(values)
    for name, value in wanted.items():
        assert_close(found[name], value, DIGITS, name)
    for name, value in numbers.items():
        # This holds even near 90 degrees and b1 = 1, because the inputs are exact floats and nothing cancels. The
        # resistance does under deceleration, but by less than a factor of 20 in these cases.
        assert_close(value, wanted[name], DIGITS, name)


NEAR_90 = math.radians(89.99)
ONE_LOG = 1 - math.exp(-1)
SINGULAR = [
    *[{"friction_angle": v} for v in (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1.5, 1.569)],
    *[{"density_ratio": v} for v in (1e-12, 1e-9, 1e-6, 1e-3, 0.5, ONE_LOG, 0.99, 1 - 1e-6, 1 - 1e-9)],
    *[{"wedge_angle": v} for v in (1e-8, 1e-4, 1.5, math.radians(89.0))],
    *[{"chisel_angle": v} for v in (0.0, 1e-9, 1.4)],
    *[{"cohesion": 0.0, "ambient_pressure": v} for v in (0.0, 1e5)],
    {"tool_friction": 0.0, "speed": 0.0, "acceleration": 0.0},
    {"wedge_angle": 1e-8, "density_ratio": 1e-12, "friction_angle": 0.0},
    {"wedge_angle": 1e-8, "density_ratio": 1 - 1e-9, "friction_angle": 1e-12},
]


# The half angle, 88.7 degrees, is rounded to a float before its tangent is taken: half a unit in its last place is
# 5e-15 of the tangent, four times that of the force's speed terms and six times that of a second derivative.
BESIDE_90 = [{"wedge_angle": NEAR_90}, {"wedge_angle": NEAR_90, "density_ratio": 1 - 1e-9, "friction_angle": 1.5}]


@cache
def precise_derivatives(*point):
    return hp.derivatives(resistance, point)


@pytest.mark.parametrize("change", [*SINGULAR, *BESIDE_90], ids=str)
def test_gradient_and_hessian_up_to_the_singularities(symbolic, change):
    values = FIRM | change
    wanted, out = precise_derivatives(*values.values()), symbolic(x=list(values.values()))
    assert_close(outputs(values)["resistance"], wanted[0], DIGITS, "float")
    got = (out["resistance"].full()[0, 0], out["gradient"].full()[:, 0], out["hessian"].full())
    assert_derivatives(got, wanted, DIGITS, FIRM)


# A cone of half angle 15 degrees and base radius 50 mm at 2 m/s: locked density; force [N], with and without ambient
# pressure; share of the ambient pressure in the static force [%]. The values come from a separate closed form for a
# locked cylindrical cavity.
POINT_FORCES = {
    "loose sandy loam": (1800, 1162, 105, 92),
    "firm sandy loam": (1840, 2120, 425, 81),
    "serozem": (1700, 2075, 577, 73),
    "hardpan": (1750, 4792, 1731, 64),
    "heavy clay": (1600, 2181, 1366, 38),
}


@pytest.mark.parametrize("name", POINT_FORCES)
def test_named_soil_resists_as_a_locked_cylindrical_cavity(name):
    locked, force, without, share = POINT_FORCES[name]
    soil = po.named_soil(name)
    soil = replace(soil, density_ratio=soil.density / locked)
    bare = replace(soil, ambient_pressure=0.0)
    cone = po.Cone(po.deg(15.0), 0.05 / math.tan(po.deg(15.0)))
    assert [po.resistance(cone, one, 2.0, 0.0) for one in (soil, bare)] == pytest.approx([force, without], abs=0.5)
    static, bare_static = po.soil_reaction(cone, soil).static, po.soil_reaction(cone, bare).static
    assert 100 * (1 - bare_static / static) == pytest.approx(share, abs=0.5)


def test_arrays_are_computed_element_by_element():
    cases = [{name: float(case["inputs"][name]) for name in FIRM} for case in REFERENCE]
    together = outputs({name: np.array([case[name] for case in cases]) for name in FIRM})
    for name, values in together.items():
        wanted = [float(case["outputs"][name]) for case in REFERENCE]
        np.testing.assert_allclose(values, wanted, rtol=DIGITS, err_msg=name)
    # h tan(beta) / sqrt(1 - b1)
    wanted = 0.3 * np.tan([0.1, 0.2]) / math.sqrt(0.2)
    radii = po.loosened_radius(po.Cone(np.array([0.1, 0.2]), 0.3), share_and_soil(FIRM)[1])
    np.testing.assert_allclose(radii, wanted, rtol=1e-15)
