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
from helpers.field_cases import EPS, cone, nodes_of, soil_of, wedge

import plough_opt as po

CASES = json.loads((Path(__file__).parents[1] / "reference" / "elastic.json").read_text(encoding="utf-8"))["cases"]
ROUNDINGS = 4.0 * EPS

# Names of the field's displacements in the table; those of its stresses begin with an s.
RENAMED = {"axial": "ux", "radial": "ur"}


def numbers(inputs):
    """Return the flat input of `field_cases`; a force has no point."""
    lam, mu, rho, speed = (float(inputs[name]) for name in ("lam", "mu", "rho", "V0"))
    moduli = (mu * (3.0 * lam + 2.0 * mu) / (lam + mu), lam / (2.0 * (lam + mu)))
    point = float(inputs.get("x", 0.0)), float(inputs.get("y", inputs.get("r", 0.0)))
    positions, heights = zip(*inputs["nodes"][1:], strict=True)
    return [*point, *moduli, rho, speed, *map(float, positions), *map(float, heights)]


def found(case, values):
    """Return the toolkit's results for a case under the table's names."""
    inputs, kind, elastic = case["inputs"], case["kind"], po.elastic
    if kind in ("wedge_stress", "cone_field"):
        field = (wedge if kind == "wedge_stress" else cone)(*values)._asdict()
        return {RENAMED.get(name, name if name[0] == "u" else f"s{name}"): value for name, value in field.items()}
    pressure, friction = float(inputs.get("p0", 0.0)), float(inputs.get("mu0", 0.0))
    at = nodes_of(values), soil_of(values, ambient_pressure=pressure, tool_friction=friction), values[5]
    if kind == "wedge_pressure":
        return {"p": elastic.wedge_pressure(values[0], *at)}
    if kind == "wedge_drag":
        return {"signed": elastic.wedge_force(*at, separation=False), "unilateral": elastic.wedge_force(*at)}
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
