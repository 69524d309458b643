"""Every value of tests/reference/elastic.json, which was computed independently: floats, SX and MX.

Each output comes with a condition number, sum |d ln out / d ln in|: a result in doubles may err by that times the
rounding of the inputs, 1.1e-16, of which the conversion from Lame constants to Young's modulus and Poisson's ratio
makes a few more.
"""

import itertools
import json
import math
from pathlib import Path

import casadi as ca
import pytest
from helpers.field_cases import EPS

import plough_opt as po

CASES = json.loads((Path(__file__).parents[1] / "reference" / "elastic.json").read_text(encoding="utf-8"))["cases"]
ROUNDINGS = 4.0 * EPS

WEDGE = {"sxx": "xx", "syy": "yy", "sxy": "xy", "szz": "zz"}
CONE = {"sxx": "xx", "srr": "rr", "stt": "tt", "srx": "rx"}


def numbers(inputs):
    """Return Young's modulus, Poisson's ratio, density, speed, the point if any, and the nodes but the first."""
    lam, mu, rho, speed = (float(inputs[name]) for name in ("lam", "mu", "rho", "V0"))
    moduli = (mu * (3.0 * lam + 2.0 * mu) / (lam + mu), lam / (2.0 * (lam + mu)))
    point = (float(inputs[name]) for name in ("x", "y", "r") if name in inputs)
    nodes = (float(number) for node in inputs["nodes"][1:] for number in node)
    return [*moduli, rho, speed, *point, *nodes]


def found(case, values):
    """Return the toolkit's results for a case under the table's names, from the entries of `numbers`."""
    inputs, elastic = case["inputs"], po.elastic
    E, nu, density, speed, *rest = values
    count = len(rest) - 2 * (len(inputs["nodes"]) - 1)
    point, ends = rest[:count], rest[count:]
    nodes = [(0.0, 0.0), *zip(ends[::2], ends[1::2], strict=True)]
    soil = po.Soil(
        density=density,
        density_ratio=0.8,
        cohesion=0.0,
        friction_angle=0.5,
        tool_friction=float(inputs.get("mu0", 0.0)),
        ambient_pressure=float(inputs.get("p0", 0.0)),
        youngs_modulus=E,
        poisson_ratio=nu,
    )
    at = (*point, nodes, soil, speed)
    if case["kind"] == "wedge_stress":
        stress, gradient = elastic.wedge_stress(*at), elastic.wedge_gradient(*at)
        stresses = {name: getattr(stress, ours) for name, ours in WEDGE.items()}
        return {**stresses, **vars(gradient), "uy": elastic.wedge_displacement(*at)}
    if case["kind"] == "cone_field":
        stress, displacement = elastic.cone_stress(*at), elastic.cone_displacement(*at)
        stresses = {name: getattr(stress, ours) for name, ours in CONE.items()}
        return {**stresses, "ux": displacement.axial, "ur": displacement.radial}
    if case["kind"] == "wedge_pressure":
        return {"p": elastic.wedge_pressure(*at)}
    if case["kind"] == "wedge_drag":
        force = {"signed": elastic.wedge_force(*at, separation=False), "unilateral": elastic.wedge_force(*at)}
        return {name: force[name] for name in case["outputs"]}
    return {"F": elastic.cone_force(*at)}


def thrust(case):
    """Return the force of the ambient pressure and its friction on the face, which only the table includes."""
    inputs, total = case["inputs"], 0.0
    p0, mu0 = float(inputs.get("p0", 0.0)), float(inputs.get("mu0", 0.0))
    nodes = [(float(a), float(b)) for a, b in inputs["nodes"]]
    for (a, left), (b, right) in itertools.pairwise(nodes):
        girth = {"wedge_drag": 2.0, "cone_drag": math.pi * (left + right)}.get(case["kind"], 0.0)
        total += p0 * girth * (right - left + mu0 * (b - a))
    return total


def runs():
    """Yield every case with floats, SX and MX; SX graphs of forces and cones are large and run with the slow tests."""
    for case, (name, symbol) in itertools.product(CASES, {"float": None, "SX": ca.SX, "MX": ca.MX}.items()):
        large = case["kind"] in ("wedge_drag", "cone_field", "cone_drag") and case["id"] != 31
        marks = [pytest.mark.slow] if large and name == "SX" else []
        yield pytest.param(case, symbol, marks=marks, id=f"{case['id']} {case['kind']} {case['tag']} {name}")


@pytest.mark.parametrize(("case", "symbol"), [*runs()])
def test_value_of_the_table(case, symbol):
    values = numbers(case["inputs"])
    if symbol is None:
        results = found(case, values)
    else:
        v = symbol.sym("v", len(values))
        expressions = found(case, ca.vertsplit(v))
        stacked = ca.Function("f", [v], [ca.vertcat(*expressions.values())])(values)
        results = dict(zip(expressions, map(float, ca.vertsplit(stacked)), strict=True))
    assert set(case["outputs"]) == set(results)
    for name, text in case["outputs"].items():
        wanted, beyond = float(text), thrust(case)
        condition = case["cond"].get(name, max(case["cond"].values()))
        tolerance = ROUNDINGS * (condition * abs(wanted) + beyond)
        assert results[name] == pytest.approx(wanted - beyond, rel=0, abs=tolerance), name
