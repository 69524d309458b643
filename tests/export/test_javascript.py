"""The JavaScript export in node: the numbers are those of Python."""

import json
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.errors import InputError
from plough_opt.exchange.export.javascript import Source
from plough_opt.export import write_javascript

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs")
POINTS = 8
CLIENT = Path(__file__).with_name("client.mjs").read_text(encoding="utf-8")


def evaluated(component, folder, points):
    """Return what the module of a component says about itself, and its results at points, in node."""
    path = write_javascript(component, folder / "share.mjs")
    (folder / "client.mjs").write_text(CLIENT, encoding="utf-8")
    done = subprocess.run([NODE, folder / "client.mjs", path.as_uri()], input=json.dumps(points), capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def made(name, request, r1_scene):
    """Return a component whose graph has loops, columns, panels, or a law kept as one node."""
    if name in ("around_r1", "with_columns"):
        return request.getfixturevalue(name)
    if name == "quasi_static":
        scene = r1_scene(motion=False, strength_wave=po.StrengthWave(0.3, 0.2), tow_ramp=0.3)
        return po.component(
            scene, 1.0, inputs=["scene.tow_speed", "soil.cohesion"], outputs=["mean_draft", "force_rms"]
        )
    elastic = po.Soil(1400.0, 0.8, 15e3, po.deg(30.0), 0.5, 1e4, youngs_modulus=1e7, poisson_ratio=0.3)
    scene = po.Scene(elastic, po.Wedge("25 deg", "15 deg", 0.25), 5e4, 30.0, 2.0, po.Effects(motion=False), "elastic")
    return po.component(scene, 0.2, inputs=["soil.youngs_modulus", "share.height"], outputs=["mean_draft", "force_rms"])


@needs_node
@pytest.mark.parametrize("name", ["around_r1", "with_columns", "quasi_static", "elastic"])
def test_results_are_pythons(name, request, r1_scene, tmp_path):
    component = made(name, request, r1_scene)
    random = np.random.default_rng(33)
    low, high = ([getattr(port, end) for port in component.inputs] for end in ("lower", "upper"))
    points = random.uniform(low, high, (POINTS, len(low)))
    names = [port.name for port in component.inputs]
    said = evaluated(component, tmp_path, [{}, *(dict(zip(names, x, strict=True)) for x in points.tolist())])
    values = [[port.value for port in component.inputs], *points]
    for x, results in zip(values, said["results"], strict=True):
        expected = component.call([float(value) for value in x])
        for port, value in zip(component.outputs, expected, strict=True):
            # A zero in a column is relative to the column.
            least = 1e-12 * float(ca.norm_inf(value))
            assert np.ravel(results[port.name]) == pytest.approx(value.full().ravel(), rel=1e-12, abs=least)
    units = [(one["name"], one["unit"], one["lower"], one["upper"], one["value"]) for one in said["inputs"]]
    assert units == [(port.name, port.unit, port.lower, port.upper, port.value) for port in component.inputs]
    assert [(one["name"], one["unit"], one["size"]) for one in said["outputs"]] == [
        (port.name, port.unit, port.size) for port in component.outputs
    ]


@needs_node
def test_wrong_values_are_refused_by_name(around_r1, not_always_finite, tmp_path):
    outside, unknown = evaluated(around_r1, tmp_path, [{"share.height": 3.0}, {"share.hight": 0.2}])["results"]
    assert outside.startswith("RangeError: share.height = 3 m must lie between 0.15 and 0.3")
    assert 'there is no input "share.hight"' in unknown
    (infinite,) = evaluated(not_always_finite, tmp_path, [{"share.height": 0.22}])["results"]
    assert infinite == 'RangeError: "logarithm" has no finite value here'


def test_what_has_no_javascript_form_is_refused_by_name(r1_scene, r1_wave, tmp_path):
    scene = r1_scene(orbit="periodic", strength_wave=r1_wave, damping=400.0)
    orbit = po.component(scene, inputs=["scene.stiffness"], outputs=["force_rms"])
    with pytest.raises(InputError, match=r"CasADi's 'Newton'.*no JavaScript form: export to c or casadi"):
        write_javascript(orbit, tmp_path / "orbit.mjs")
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match="the operation 'erf' has no JavaScript form: use another"):
        Source("use another").add(ca.Function("f", [x], [ca.erf(x)]))
    assert not list(tmp_path.iterdir())
