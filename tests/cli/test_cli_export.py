"""`plough-opt export`: each format from a problem file."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import casadi as ca
import ezdxf
import pytest
import trimesh
from helpers.commands import call, printed
from helpers.problem_files import REFERENCE, SUBSOILER

import plough_opt as po


def _component(out):
    """Return the names of inputs and outputs that the command printed."""
    rows = [line.split() for line in out.splitlines() if line.startswith(("in ", "out "))]
    return [row[1] for row in rows if row[0] == "in"], [row[1] for row in rows if row[0] == "out"]


def test_casadi_has_the_files_variables_and_all_that_it_minimises_and_requires(tmp_path):
    told = ("--description", tmp_path / "r1.json")
    slow = ("--set", "scene.tow_speed=1 m/s")
    done = call("export", REFERENCE, "--to", "casadi", "--output", tmp_path / "r1.casadi", *told, *slow)
    assert (done.status, done.err) == (0, f"wrote {tmp_path / 'r1.casadi'}\nwrote {tmp_path / 'r1.json'}\n")
    inputs, outputs = _component(done.out)
    assert inputs == ["share.wedge_angle", "share.height", "scene.stiffness"]
    assert outputs == ["objective", "mean_draft", "force_rms", "loosened_radius", "mean_deflection", "half_angle"]
    found = ca.Function.load(str(tmp_path / "r1.casadi"))(share_height=0.3)
    run = po.read_problem(REFERENCE, slow[1:]).simulate({"share.height": 0.3})
    assert float(found["force_rms"]) == pytest.approx(run.force_rms, rel=1e-7)
    assert float(found["objective"]) == pytest.approx((run.mean_draft + run.force_rms) / 1e3, rel=1e-7)
    told = json.loads((tmp_path / "r1.json").read_text())
    assert {port["name"]: (port["lower"], port["upper"]) for port in told["outputs"]}["mean_deflection"] == (None, 0.15)


def test_c_with_inputs_and_outputs_of_ones_own_passes_its_test(tmp_path):
    names = ["--inputs", "soil.cohesion, scene.tow_speed", "--outputs", "mean_draft,moving_mass", "--name", "cotton"]
    out = printed("export", SUBSOILER, "--to", "c", "--output", tmp_path / "c", *names)
    assert _component(out) == (["soil.cohesion", "scene.tow_speed"], ["mean_draft", "moving_mass"])
    assert "soil.cohesion [Pa] 10000 to 40000, value 20000" in out
    assert {path.name for path in (tmp_path / "c").iterdir()} == {"Makefile", "cotton.c", "cotton.h", "cotton_test.c"}


def test_what_to_do_next_can_be_pasted_whatever_the_folder_is_called(tmp_path):
    folder = tmp_path / 'new "share\'s"'
    out = printed("export", SUBSOILER, "--to", "fmu", "--output", folder / "a.fmu", "--sources")
    assert "next: fmpy simulate '" in out
    few = ("--set", "effects={motion=false}", "--outputs", "mean_draft")
    out = printed("export", SUBSOILER, "--to", "casadi", "--output", folder / "a.casadi", *few)
    line = out[out.index("next: ") + len("next: ") :]
    # Its python is the one that has CasADi.
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    assert "share" in subprocess.check_output(line, shell=True, text=True, env=os.environ | {"PATH": path})
    assert "next: plough-opt optimise '" in printed("init", folder / "a.toml")


def test_parts_are_of_the_best_design_or_of_the_guesses(tmp_path):
    still = ("--set", "effects={motion=false}", "--set", "scene.duration=0.1 s")
    best = po.read_problem(REFERENCE, still[1::2]).optimise()[0].variables
    for at, angle in (([], best["share.wedge_angle"]), (["--at", "guess"], po.deg(25))):
        path = tmp_path / "a.dxf"
        done = call("export", REFERENCE, "--to", "dxf", "--output", path, *still, *at)
        assert (done.status, done.err) == (0, f"wrote {path}\n")
        assert f"wedge angle {math.degrees(angle):.4g} deg" in done.out
        (outline,) = ezdxf.readfile(path).modelspace().query("LWPOLYLINE")
        (_, _), (x, y), _ = outline.get_points("xy")
        assert math.atan2(-y, x) == pytest.approx(angle, rel=1e-9)


def test_parts_have_units_and_bodies(tmp_path):
    bent = ("--opening", "60 deg", "--thickness", "1 cm", "--at", "guess")
    out = printed("export", REFERENCE, "--to", "gltf", "--output", tmp_path / "a.glb", *bent)
    share = po.read_problem(REFERENCE).scene().share
    made = share.mesh(opening=po.deg(60), thickness=0.01)
    assert f"60 deg between the faces, plate of 10 mm, {1e6 * made.volume:.4g} cm^3" in out
    assert trimesh.load_scene(tmp_path / "a.glb").to_mesh().volume == pytest.approx(made.volume, rel=1e-6)
    cone = ("--output", tmp_path / "a.stl", "--body", "cone", "--at", "guess")
    assert "Cone of the guesses: half angle" in printed("export", REFERENCE, "--to", "stl", *cone)
    volume = share.equivalent_cone().volume
    assert trimesh.load_mesh(tmp_path / "a.stl").volume == pytest.approx(1e9 * volume, rel=1e-6)


@pytest.mark.parametrize(("part", "words"), [("[variables]", "nothing to vary"), ("[minimise]", "requires nothing")])
def test_a_file_without_variables_or_results_needs_names_of_inputs_and_outputs(tmp_path, part, words):
    fixed = ("share.wedge_angle=25 deg", "share.height=0.2 m", "scene.stiffness=50 kN/m")
    (tmp_path / "p.toml").write_text(REFERENCE.read_text(encoding="utf-8").partition(part)[0], encoding="utf-8")
    with pytest.raises(po.InputError, match=words):
        po.read_problem(tmp_path / "p.toml", fixed if part == "[variables]" else ()).component()
