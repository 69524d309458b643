"""Saved results: what made them, shown again as they were printed, side by side, strictly valid JSON."""

import contextlib
import dataclasses
import functools
import hashlib
import io
import json
import math
import platform
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.app.main import main
from plough_opt.problem_file.robust_design import optimise_robust

ROOT = Path(__file__).parents[1]
QUICK = ("--set", "effects.motion=false", "--set", "scene.outputs=10")


def strict(text):
    """Return parsed JSON; refuse what is none, such as NaN."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def without_damper(name, folder):
    """Write a problem file of the package without what a quasi-static scene cannot have; return its path."""
    lines = (ROOT / "problems" / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith(("damping", "force_rms", "deflection"))]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a problem file and two optima of it that differ in the tow speed."""
    where = tmp_path_factory.mktemp("kept")
    without_damper("cotton_subsoiler", where).rename(where / "share.toml")
    return where


@pytest.fixture(scope="module")
def printed():
    """Return what a command prints."""

    def run(*words):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main([str(word) for word in words])
        assert status == 0, err.getvalue()
        return out.getvalue()

    return run


@pytest.fixture(scope="module")
def saved(folder, printed):
    paths = []
    for name, speed in (("slow", "7.2 km/h"), ("fast", "9 km/h")):
        words = ("optimise", folder / "share.toml", *QUICK, "--search", "near", "--set", f'scene.tow_speed="{speed}"')
        paths.append(folder / f"{name}.json")
        paths[-1].write_text(printed(*words, "--json"), encoding="utf-8")
    return paths


def test_a_saved_result_holds_what_made_it(folder, saved):
    for path, speed in zip(saved, ("7.2 km/h", "9 km/h"), strict=True):
        origin = po.load(path).origin
        text = (folder / "share.toml").read_text(encoding="utf-8")
        assert origin.text == text
        assert origin.file == "share.toml"
        assert origin.sha256 == hashlib.sha256(text.encode()).hexdigest()
        assert origin.overrides == ("effects.motion=false", "scene.outputs=10", f'scene.tow_speed="{speed}"')
        assert origin.seed == 0
        assert origin.made.endswith("+00:00")
        assert platform.node() == "" or platform.node() not in path.read_text(encoding="utf-8").split()


def test_it_can_be_made_again(saved, tmp_path):
    found = po.load(saved[1])
    again = tmp_path / "again.toml"
    again.write_text(found.origin.text, encoding="utf-8")
    best, _ = po.read_problem(again, found.origin.overrides).optimise(search="near", seed=found.origin.seed)
    assert best.variables == found.variables
    assert best.objective == found.objective


def test_show_prints_the_same_tables(folder, saved, printed):
    words = ("optimise", folder / "share.toml", *QUICK, "--search", "near", "--set", 'scene.tow_speed="9 km/h"')
    fresh, again = printed(*words).splitlines(), printed("show", saved[1]).splitlines()
    # The last line of the tables has the time that the solve took.
    assert again[: len(fresh) - 1] == fresh[:-1]
    assert again[-2].startswith("Made from share.toml (SHA-256 ")
    assert '--set scene.tow_speed="9 km/h"' in again[-2]
    assert "plough_opt" in again[-1]
    assert strict(printed("show", saved[1], "--json")) == strict(saved[1].read_text(encoding="utf-8"))


def test_compare_sets_designs_side_by_side(saved, printed, tmp_path):
    slow, fast = (po.load(path) for path in saved)
    picture = tmp_path / "both.svg"
    text = printed("compare", *saved, "--plot", picture)
    (row,) = [line for line in text.splitlines() if "tow speed" in line]
    assert [cell.strip() for cell in row.split("│")[2:4]] == ["7.2 km/h", "9 km/h"]
    (row,) = [line for line in text.splitlines() if "mean draft" in line]
    cells = [cell.strip() for cell in row.split("│")[2:4]]
    assert cells == [f"{one.run.averages.mean_draft / 1e3:.6g} kN" for one in (slow, fast)]
    # What all have alike is no row.
    assert "cohesion" not in text
    assert 'scene.tow_speed="9 km/h"' in text
    assert "slow.json" in picture.read_text(encoding="utf-8") or picture.stat().st_size > 5000
    found = strict(printed("compare", *saved, "--json"))
    assert found["fast.json"]["share.height"] == fast.variables["share.height"]


def test_compare_refuses_one_file_and_what_is_no_design(saved, capsys, tmp_path):
    assert main(["compare", str(saved[0])]) == 2
    assert "two or more" in capsys.readouterr().err
    assert main(["compare", str(saved[0]), str(saved[1]), "--plot", str(saved[0])]) == 2
    capsys.readouterr()
    other = shutil.copy(saved[0], tmp_path / "picture.png")
    assert main(["compare", str(saved[0]), str(other), "--plot", str(other)]) == 2
    assert "would overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ("export", "--to", "casadi", "--output", "share.casadi"),
        ("check",),
        ("simulate", *QUICK),
    ],
    ids=lambda words: words[0],
)
def test_json_of_every_command_is_strict(words, folder, printed, monkeypatch):
    monkeypatch.chdir(folder)
    command, *rest = words
    strict(printed(command, "share.toml", *rest, "--json"))


def test_init_and_soils_print_json(printed, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert strict(printed("init", "new.toml", "--json")) == {"wrote": ["new.toml"]}
    assert {soil["name"] for soil in strict(printed("soils", "--json"))} == set(po.soil_names())


def test_a_sweep_is_shown_from_its_store(folder, printed, monkeypatch):
    monkeypatch.chdir(folder)
    over = ("--over", "soil.cohesion=5..45 kPa:2", "--workers", "1", "--store", "s.db")
    assert strict(printed("sweep", "share.toml", *QUICK, *over, "--json"))["complete"]
    assert "2 points, 0 failed" in printed("show", "s.db")
    assert strict(printed("show", "s.db", "--json"))["points"] == 2


def test_a_design_in_python_keeps_its_declarations(tmp_path):
    d = po.Design()
    height = d.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
    cohesion = d.parameter("cohesion", "20 kPa")
    d.minimise(height * cohesion / 1e3)
    d.require("half height", height / 2.0, at_least="60 mm")
    best = d.solve(search="near", seed=3, parameters={"cohesion": 3e4})
    found = po.load(best.save(tmp_path / "deep" / "best.json"))
    declared = found.origin.declarations
    assert declared["height"]["kind"] == "variable"
    assert [declared["height"][key] for key in ("lower", "upper", "unit")] == [0.1, 0.5, "m"]
    assert declared["cohesion"]["value"] == 3e4
    assert declared["half height"]["at_least"] == 0.06
    assert "height" in declared["objective"]["expression"]
    assert found.origin.seed == 3
    assert str(found) == str(best)
    assert found.variables == best.variables


def test_a_front_in_python_keeps_its_declarations_and_units(tmp_path):
    d = po.Design()
    x = d.variable("x", guess="500 mm", lower="0 mm", upper="1000 mm")
    k = d.parameter("k", 2.0)
    d.require("sum", x * k, at_most=1.5)
    goals = po.Goal("draft", 5000.0 * (0.1 + x**2), "N"), po.Goal("radius", 0.1 + k * x, "m", maximise=True)
    front = po.trade_off(d, *goals, points=5, parameters={"k": 1.0})
    found = po.load(front.save(tmp_path / "front.json"))
    declared = found.origin.declarations
    assert {name: own["kind"] for name, own in declared.items()} == {
        "x": "variable", "k": "parameter", "sum": "requirement", "draft": "objective", "radius": "objective"
    }  # fmt: skip
    assert declared["k"]["value"] == 1.0
    assert declared["radius"]["aim"] == "maximise"
    assert "x [mm]" in str(front)
    assert str(found) == str(front)


def test_a_run_in_python_keeps_its_scene(tmp_path):
    scene = po.Scene(po.named_soil("serozem"), po.Cone(po.deg(10), 0.25), 5e4, 20.0, 2.0, po.Effects(damping=400.0))
    run = po.simulate(scene, 0.2, outputs=5)
    found = po.load(run.save(tmp_path / "run.json"))
    assert found.scene == scene
    quantities = strict((tmp_path / "run.json").read_text(encoding="utf-8"))["quantities"]
    assert quantities["soil.friction_angle"] == math.radians(28.0)
    assert str(found) == str(run)
    assert found.mount_force.tolist() == run.mount_force.tolist()


@pytest.mark.slow
def test_a_front_and_its_units_are_read_back(printed, tmp_path):
    output = tmp_path / "front.json"
    path = without_damper("draft_against_loosening", tmp_path)
    text = printed("tradeoff", path, "--points", "5", *QUICK, "--output", output)
    shown = printed("show", output)
    assert text.splitlines()[:12] == shown.splitlines()[:12]
    assert po.load(output).origin.overrides == ("effects.motion=false", "scene.outputs=10")


def test_the_problem_is_kept_whole_with_its_data_and_can_be_computed_again(printed, tmp_path, monkeypatch, capsys):
    kept, empty = tmp_path / "run.json", tmp_path / "empty"
    empty.mkdir()
    kept.write_text(printed("simulate", ROOT / "problems" / "field.toml", "--json"), encoding="utf-8")
    monkeypatch.chdir(empty)
    shown = printed("show", kept, "--problem")
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        assert (ROOT / "problems" / name).read_text(encoding="utf-8").rstrip() in shown
    printed("show", kept, "--restore", "again")
    found = po.load(kept)
    again = po.read_problem(empty / "again" / "field.toml", found.origin.overrides).simulate()
    assert again.mean_draft == found.mean_draft
    assert main(["show", str(kept), "--restore", "again"]) == 2  # nothing is overwritten
    assert "again" in capsys.readouterr().err


def test_a_run_of_a_file_is_drawn_with_the_files_limits(printed, tmp_path):
    kept = tmp_path / "run.json"
    kept.write_text(printed("simulate", ROOT / "problems" / "cotton_subsoiler.toml", "--json"), encoding="utf-8")
    for made in (po.load(kept), po.read_problem(ROOT / "problems" / "cotton_subsoiler.toml").simulate()):
        (axes,) = [axes for axes in made.plot().axes if axes.get_ylabel().startswith("deflection")]
        limit = [line for line in axes.lines if line.get_label().startswith("limit of the deflection")]
        assert [line.get_ydata()[0] for line in limit] == [0.12]  # in metres, as the file has it


def test_functions_and_effects_that_are_not_there_are_named_and_not_run(tmp_path):
    scene = dataclasses.replace(SCENE, effects=po.Effects(own=(Drag(30.0),)))
    path = po.simulate(scene, 0.1).save(tmp_path / "own.json")
    assert po.load(path).scene == scene  # this module is there
    text = path.read_text(encoding="utf-8").replace("test_kept_results:Drag", "elsewhere:Drag")
    path.write_text(text, encoding="utf-8")
    found = po.load(path)
    assert "mean draft" in str(found)
    (effect,) = found.scene.effects.own
    assert effect.newtons == 30.0
    with pytest.raises(po.InputError, match="'elsewhere:Drag', which is not defined here"):
        effect.force(0.0, 1.0)
    # Nor is a class taken that is no effect, or that belongs to Python.
    for name in ("subprocess:Popen", "plough_opt.soil.geometry:Cone"):
        path.write_text(text.replace("elsewhere:Drag", name), encoding="utf-8")
        if name.startswith("plough"):
            with pytest.raises(po.InputError, match="own"):
                po.load(path)
        else:
            assert type(po.load(path).scene.effects.own[0]).__name__ == "Popen"  # a stand-in of that name
            assert not isinstance(po.load(path).scene.effects.own[0], subprocess.Popen)


@dataclasses.dataclass(frozen=True)
class Drag:
    newtons: float

    def force(self, travel, speed):
        return self.newtons + 0.0 * travel * speed


SCENE = po.Scene(
    po.named_soil("serozem"), po.Cone(po.deg(10), 0.25), 5e4, 20.0, 2.0,
    po.Effects(damping=400.0, strength_wave=po.StrengthWave(0.3, 0.2)),
)  # fmt: skip
STILL = dataclasses.replace(SCENE, effects=po.Effects(motion=False))


@functools.cache
def run():
    return po.simulate(SCENE, 0.2, outputs=20)


def design():
    d = po.Design()
    height = d.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
    d.require("half height", height / 2.0, at_least="60 mm")
    return d, height


@functools.cache
def optimum():
    d, height = design()
    d.minimise(height**2)
    best = d.solve(search=200)
    return dataclasses.replace(best, run=run(), sensitivities=best.every_sensitivity())


def batch():
    mass = ca.MX.sym("mass")
    return po.Batch(dataclasses.replace(SCENE, mass=mass), 0.2, [mass])(np.array([[20.0], [30.0], [-1.0]]))


def fit():
    measured = po.Measurements("mean_draft", [7e3, 8e3, 9e3], {"scene.tow_speed": [1.0, 1.5, 2.0]}, sigma=100.0)
    return po.calibrate(STILL, measured, {"soil.cohesion": (1e3, 8e4)})


def front():
    d, height = design()
    goals = po.Goal("draft", 5000.0 * (0.1 + height**2), "N"), po.Goal("radius", 0.1 + height, "m", maximise=True)
    return po.trade_off(d, *goals, points=5)


def robust():
    path = ROOT / "problems" / "uncertain_field.toml"
    return optimise_robust(po.read_problem(path, ["uncertain.samples=8", "uncertain.fresh=100"]), lambda *_: None)


EVERY = {
    "Run": run,
    "Machine": lambda: po.Machine({"front": run(), "rear": run()}),
    "Optimum": optimum,
    "LocalOptimum": lambda: optimum().local_optima[0],
    "Rounded": lambda: optimum().rounded(height=0.05),
    "BatchResult": batch,
    "Fit": fit,
    "TradeOff": front,
    "AccuracyStudy": lambda: po.study_accuracy(STILL, 0.1, thin=True, allowance=0.01),
    "RobustOptimum": robust,
}


@pytest.mark.parametrize("name", EVERY)
def test_what_is_loaded_is_what_was_saved(name, tmp_path):
    """The same class, words, tables, pictures and frames, and the same file if it is saved once more."""
    made = EVERY[name]()
    assert type(made).__name__ == name
    path = made.save(tmp_path / "deep" / "result.json")
    strict(path.read_text(encoding="utf-8"))
    found = po.load(path)
    assert type(found) is type(made)
    assert type(found).load(path).to_json() == found.to_json()
    assert (str(found), repr(found)) == (str(made), repr(made))
    assert found.save(tmp_path / "again.json").read_bytes() == path.read_bytes()
    assert found._repr_html_().partition("<img")[0] == made._repr_html_().partition("<img")[0]
    assert drawn(found.plot()) == drawn(made.plot())
    again, frame = found.to_dataframe(), made.to_dataframe()
    assert again.equals(frame)
    assert again.attrs == frame.attrs


def drawn(figure):
    """Return what stands on a picture: titles, axes, and the ends of their scales."""
    return [
        (axes.get_title(), axes.get_xlabel(), axes.get_ylabel(), axes.get_xlim(), axes.get_ylim())
        for axes in figure.axes
    ]


def test_shares_in_one_frame_are_kept_shown_and_compared(printed, tmp_path):
    words = (ROOT / "problems" / "two_shares.toml", "--set", "scene.duration=0.1 s", "--json")
    slow, fast = tmp_path / "slow.json", tmp_path / "fast.json"
    slow.write_text(printed("simulate", *words), encoding="utf-8")
    fast.write_text(printed("simulate", *words, "--set", "scene.tow_speed=9 km/h"), encoding="utf-8")
    assert strict(slow.read_text(encoding="utf-8"))["kind"] == "machine"
    assert "together" in printed("show", slow)
    text = printed("compare", slow, fast, "--plot", tmp_path / "both.svg")
    for share in ("front", "rear"):
        (row,) = [line for line in text.splitlines() if f"mean draft, {share}" in line]
        cells = [cell.strip() for cell in row.split("│")[2:4]]
        drafts = [po.load(path).runs[share].mean_draft for path in (slow, fast)]
        assert cells == [f"{draft / 1e3:.6g} kN" for draft in drafts]
