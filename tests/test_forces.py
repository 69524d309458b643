"""Resistance of the soil to the share, equations (24)-(26), against independent values and 120 digits."""

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
from helpers.high_precision import assert_close, assert_derivatives

import plough_opt as po

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


TABLE = json.loads((Path(__file__).parent / "reference" / "plastic.json").read_text(encoding="utf-8"))["cases"]


@pytest.mark.parametrize("case", TABLE, ids=[f"{case['kind']}-{number}" for number, case in enumerate(TABLE)])
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
NEAR_90 = math.radians(89.99)
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


# The half angle, 88.7 degrees, is rounded to a float before its tangent is taken: half a unit in its last place is
# 5e-15 of the tangent, four times that of the force's speed terms and six times that of a second derivative.
BESIDE_90 = [{"wedge_angle": NEAR_90}, {"wedge_angle": NEAR_90, "density_ratio": 1 - 1e-9, "friction_angle": 1.5}]


@cache
def precise_derivatives(*point):
    return hp.derivatives(resistance, point)


@pytest.mark.parametrize("change", [*ORDINARY, *SINGULAR, *BESIDE_90], ids=str)
def test_forces_gradient_and_hessian_up_to_the_singularities(symbolic, change):
    values = FIRM | change
    wanted = precise_derivatives(*values.values())
    exact = wanted[0], *forces({name: hp.mp.mpf(value) for name, value in values.items()})
    for name, found, true in zip(("F", "F0", "Fd", "added mass"), outputs(values.values()), exact, strict=True):
        assert_close(found, true, DIGITS, name)
    assert_derivatives(symbolic([*values.values()]), wanted, DIGITS, FIRM)


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
    points = np.array([[*(FIRM | change).values()] for change in (*ORDINARY, *SINGULAR)])
    one_by_one = [outputs(point) for point in points.tolist()]
    np.testing.assert_allclose(np.transpose(outputs(points.T)), one_by_one, rtol=DIGITS)
    # h tan(beta) / sqrt(1 - b1)
    wanted = 0.3 * np.tan([0.1, 0.2]) / math.sqrt(0.2)
    radii = po.loosened_radius(po.Cone(np.array([0.1, 0.2]), 0.3), po.Soil(*(FIRM[name] for name in SOIL)))
    np.testing.assert_allclose(radii, wanted, rtol=1e-15)
