"""The serialised Function in a process without plough_opt."""

import dataclasses
import json
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.export import write_casadi

READER = """
import sys
sys.modules["plough_opt"] = None
import json, casadi as ca
f = ca.Function.load(sys.argv[1])
x = ca.MX.sym("x", f.n_in())
stacked = ca.vertcat(*f.call(ca.vertsplit(x)))
jacobian = ca.Function("slopes", [x], [ca.densify(ca.jacobian(stacked, x))])
at = json.loads(sys.argv[2])
values = [value.full().ravel().tolist() for value in f.call(at)]
assert not [name for name in sys.modules if name.startswith("plough_opt.")]
print(json.dumps([f.name(), f.name_in(), f.name_out(), values, jacobian(at).full().tolist()]))
"""


def test_another_process_without_plough_opt_evaluates_and_differentiates(around_r1, tmp_path):
    path = write_casadi(around_r1, tmp_path / "new" / "r1.casadi")
    at = [0.6, 0.2, 3.5e4]
    done = subprocess.run(
        [sys.executable, "-c", READER, str(path), json.dumps(at)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    name, inputs, outputs, values, jacobian = json.loads(done.stdout)
    assert (name, inputs) == ("share", [port.argument for port in around_r1.inputs])
    assert outputs == [port.argument for port in around_r1.outputs]
    assert [value for (value,) in values] == list(around_r1(*at))
    assert jacobian == around_r1.slopes(*at).full().tolist()


def test_names_units_and_bounds_are_written_on_request(around_r1, tmp_path):
    path = tmp_path / "new" / "r1.json"
    write_casadi(around_r1, tmp_path / "r1.casadi", path)
    written = json.loads(path.read_text())
    assert written["inputs"] == [dataclasses.asdict(p) | {"argument": p.argument} for p in around_r1.inputs]
    limits = [(p["name"], p["lower"], p["upper"]) for p in written["outputs"]]
    assert ("loosened_radius", 0.12, None) in limits
    assert ("mean_deflection", None, 0.15) in limits
    with pytest.raises(po.InputError, match=r"end in \.json"):
        write_casadi(around_r1, tmp_path / "r1.casadi", tmp_path / "a.txt")
    assert written["error_estimate"] == around_r1.error_estimate
    assert written["steps"] == around_r1.accuracy.steps


def test_outside_its_bounds_the_results_are_nan(around_r1, tmp_path):
    loaded = ca.Function.load(str(write_casadi(around_r1, tmp_path / "r1.casadi")))
    middle = [port.value for port in around_r1.inputs]
    for k, port in enumerate(around_r1.inputs):
        width = port.upper - port.lower
        for value, finite in (
            (port.lower - 0.9e-6 * width, True), (port.upper + 0.9e-6 * width, True), (np.nan, False),
            (port.lower - 1.1e-6 * width, False), (port.upper + 1.1e-6 * width, False),
        ):  # fmt: skip
            found = loaded.call([*middle[:k], value, *middle[k + 1 :]])
            assert {bool(np.isfinite(float(one))) for one in found} == {finite}
