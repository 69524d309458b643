"""Bad input of every command, and each format of `plough-opt export` from a problem file."""

import json
import math
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import ezdxf
import pytest
import trimesh
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS, REFERENCE, SUBSOILER

import plough_opt as po
from plough_opt.studies.sweep.engine import SweepLoop

# --- bad input of every command: exit status 2, one sentence, nothing computed, nothing written ---

# Command line in a folder with the shipped problem files, and what the message contains.
REFUSED = [
    ("check cotton_subsoler.toml", "no file 'cotton_subsoler.toml': did you mean 'cotton_subsoiler.toml'"),
    ("check \x1b[31m.toml", "\\x1b"),  # no command to the terminal comes out of a name
    ("check FILE --set \x1b]0;x\x07=1", "\\x1b"),
    ("init \x1b[2J/a", "\\x1b"),
    ("init FILE", "'cotton_subsoiler.toml' exists already and is left as it is: name another file"),
    ("init nowhere/share.toml", "cannot be written"),
    ("optimise stick_slip.toml", "stick_slip.toml: nothing to choose: add a table [variables]"),
    ("optimise FILE --set minimise={}", "nothing to minimise: add a table [minimise]"),
    ("optimize FILE --set 'scene.tow_sped=1 m/s'", "'scene.tow_sped' is not a known key"),
    ("simulate FILE --plot run.jpg", "'run.jpg' is not a valid file name for the picture: it must end in .png"),
    ("optimise FILE --plot ''", "picture"),
    ("optimise FILE --csv out.xls", "'out.xls' is not a valid file name for the table: it must end in .csv or .xlsx"),
    ("optimise FILE --csv -", "--csv - would write a file of this name: name a file"),
    ("optimise FILE --plot insertions.csv/new/a.png", "insertions.csv' is not a folder"),
    # No output overwrites an input or another output; a link is what it leads to, even in a circle.
    ("tradeoff TRADE --csv TRADE", "--csv 'draft_against_loosening.toml' is the problem file, which it would overw"),
    ("tradeoff TRADE --csv x --output x", "--output 'x' is also the file of --csv, which it would overwrite: name"),
    ("tradeoff TRADE --csv link.csv", "is the problem file"),
    ("tradeoff TRADE --csv round.csv", "round.csv' cannot be written: the link leads in a circle"),
    ("sweep TRADE COHESION --store TRADE", "--store 'draft_against_loosening.toml' is the problem file"),
    ("calibrate calibration.toml --data synthetic_draft.csv --output synthetic_draft.csv", "is a data file"),
    ("tradeoff reference.toml", "add a table [trade_off] with two or three results, such as mean_draft = {}"),
    ("accuracy FILE --error 2", "wanted error = 2 must be at most 0.1"),
    ("accuracy FILE --seconds 0", "time allowed to a method"),
    ("check FILE --depth '0.4 m'", "--depth belongs to a comparison: add --against"),
    ("check FILE --against --depth 0.4", '--depth = "0.4" has no unit: write it like "0.3 m"'),
    ("check FILE --against --width '-8 cm'", "tool width = -0.08 m must be above 0 m"),
    ("check FILE --against --texture fin", "did you mean 'fine'?"),
    ("check FILE --against --rupture-ratio 0.5", "rupture distance ratio m = 0.5 must be at least 1"),
    ("report FILE --set minimise={} -o a.html", "add a table [minimise] or [trade_off]"),
    ("report uncertain_field.toml -o a.html", "remove the table [uncertain]"),
    ("report FILE -o a.txt", "end in .html"),
    # Several shares.
    ("export two_shares.toml --to c --output share.c", "--set shares=front"),
    ("sweep two_shares.toml --over 'soil.cohesion=5..45 kPa:2'", "--set shares=front"),
    ("report two_shares.toml -o share.html", "--set shares=front"),
    ("accuracy two_shares.toml", "--set shares=front"),
    # Exports.
    ("export FILE --to casadi --output a.txt", "end in .casadi"),
    ("export FILE --to casadi --output folder.casadi", "is a folder"),
    ("export FILE --to openmdao --output folder.casadi", "it is: name a new folder for the Python module"),
    ("export FILE --to fmu --output a.fmu --inputs share.height", "--inputs cannot be used with --to fmu"),
    ("export FILE --to casadi --output a.casadi --inputs share.hight", "'share.hight': did you mean 'share.height'"),
    ("export FILE --to casadi --output a.casadi --inputs ''", "--inputs '' has an empty name"),
    ("export FILE --to casadi --output a.casadi --outputs mean_drft", "'mean_drft': did you mean 'mean_draft'"),
    ("export reference.toml --to casadi --output a.casadi --inputs effects.damping", "cannot be an input"),
    ("export FILE --to casadi --output a.casadi --name 2nd", "name = '2nd' cannot be the name of a CasADi Function"),
    ("export FILE --to stl --output a.stl --body cone --thickness '1 cm'", "belong to a wedge: leave them out"),
    ("export FILE --to gltf --output a.stl", "end in .gltf or .glb"),
    ("export FILE --to stl --output a.stl --opening '60 mm'", '--opening = "60 mm" has the wrong unit'),
    ("export FILE --to stl --output a.stl --at guess --thickness '1 m'", "leaves nothing of the faces"),
    # Sweeps.
    ("sweep FILE --over 'soil.cohesoin=5..45 kPa:9'", "cannot be swept: did you mean 'soil.cohesion'"),
    ("sweep FILE --over 'soil.cohesion=5..45 kPa:1000000000000'", "at most 1000000; use a sample"),
    ("sweep FILE --over soil.cohesion", "--over soil.cohesion: expected KEY=RANGE, like"),
    ("sweep FILE COHESION COHESION", "'soil.cohesion' is swept twice"),
    ("sweep FILE COHESION --set 'soil.cohesion=5 kPa'", "'soil.cohesion' is also fixed by --set"),
    ("sweep FILE --over soil.density_ratio=0.5..1.5:3", "density ratio b1 = 1.5 must be below 1"),
    ("sweep FILE COHESION --workers 0", "--workers 0: a sweep needs at least one"),
    ("sweep FILE COHESION --workers 2 --scheduler tcp://x:1", "remove one of the two"),
    ("sweep FILE COHESION --store insertions.csv", "file is not a database"),
]
SHORT = {"FILE": "cotton_subsoiler.toml", "TRADE": "draft_against_loosening.toml",
         "COHESION": "--over 'soil.cohesion=5..45 kPa:3'"}  # fmt: skip


@pytest.mark.parametrize(("line", "expected"), REFUSED, ids=[line for line, _ in REFUSED])
def test_bad_input_is_refused_in_a_sentence_before_anything_is_computed(tmp_path, monkeypatch, line, expected):
    shutil.copytree(PROBLEMS, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.casadi").mkdir()
    (tmp_path / "link.csv").symlink_to("draft_against_loosening.toml")
    (tmp_path / "round.csv").symlink_to("round.csv")
    before = {path: path.read_bytes() for path in tmp_path.glob("*.*") if path.is_file()}
    for owner, name in ((po.Problem, "simulate"), (po.Design, "solve"), (SweepLoop, "run")):
        monkeypatch.setattr(owner, name, None)
    for short, long in SHORT.items():
        line = line.replace(short, long)
    done = call(*shlex.split(line))
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("bad input: ")
    assert len(done.err.splitlines()) == 1
    assert expected in done.err
    assert "\x1b" not in done.err
    assert {path: path.read_bytes() for path in tmp_path.glob("*.*") if path.is_file()} == before
    assert not [*(tmp_path / "folder.casadi").iterdir()]


# --- commands that need an extra say so first ---

MISSING = [
    ("report FILE --output a.html", "jinja2", "report"),
    ("explore FILE --output a.html", "jinja2", "report"),
    ("export FILE --to openmdao --output a", "openmdao", "openmdao"),
    ("export FILE --to stl --output a.stl", "trimesh", "parts"),
    ("export FILE --to gltf --output a.glb", "trimesh", "parts"),
    ("export FILE --to dxf --output a.dxf", "ezdxf", "parts"),
    ("export FILE --to step --output a.step", "build123d", "step"),
    ("sweep FILE --over share.height='0.2..0.3 m:3' --scheduler tcp://127.0.0.1:1", "distributed", "cluster"),
]


@pytest.mark.parametrize(("command", "library", "extra"), MISSING)
def test_extras_are_looked_for_before_anything_is_read(monkeypatch, tmp_path, command, library, extra):
    """Even the file need not exist."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    done = call(*shlex.split(command.replace("FILE", "missing.toml")))
    assert (done.status, f"pip install 'plough_opt[{extra}]'" in done.said) == (2, True), done.err
    assert "missing.toml" not in done.said


# --- `plough-opt export`: each format from a problem file ---


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
