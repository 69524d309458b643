"""Saved results: their origin, shown as they were printed, compared, in strictly valid JSON."""

import contextlib
import hashlib
import io
import platform
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from helpers.strict_json import strict

import plough_opt as po
from plough_opt.app.main import main

ROOT = Path(__file__).parents[1]
QUICK = ("--set", "effects.motion=false", "--set", "scene.outputs=10")


def without_damper(name, folder):
    """Write a shipped problem file without the lines that need motion; return its path."""
    lines = (ROOT / "problems" / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    remaining = [line for line in lines if not line.startswith(("damping", "force_rms", "deflection"))]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(remaining) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a problem file and two optima of it that differ in the tow speed."""
    where = tmp_path_factory.mktemp("saved")
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


def test_compare_refuses_one_file_and_an_output_that_is_an_input(saved, capsys, tmp_path):
    assert main(["compare", str(saved[0])]) == 2
    assert "two or more" in capsys.readouterr().err
    assert main(["compare", str(saved[0]), str(saved[1]), "--plot", str(saved[0])]) == 2
    capsys.readouterr()
    other = shutil.copy(saved[0], tmp_path / "picture.png")
    assert main(["compare", str(saved[0]), str(other), "--plot", str(other)]) == 2
    assert "would overwrite" in capsys.readouterr().err


def test_json_of_every_command_is_strict(folder, printed, monkeypatch, tmp_path):
    monkeypatch.chdir(folder)
    for command, *rest in (("export", "--to", "stl", "--output", "share.stl"), ("check",), ("simulate", *QUICK)):
        strict(printed(command, "share.toml", *rest, "--json"))
    monkeypatch.chdir(tmp_path)
    assert strict(printed("init", "new.toml", "--json")) == {"wrote": ["new.toml"]}
    assert {soil["name"] for soil in strict(printed("soils", "--json"))} == set(po.soil_names())


def test_a_sweep_is_shown_from_its_store(printed, tmp_path):
    store, over = tmp_path / "s.db", {"a": [1.0, 2.0]}
    with ThreadPoolExecutor(1) as inline, po.sweep(lambda point: {"b": point["a"]}, over, store=store, executor=inline):
        pass
    assert "2 points, 0 failed" in printed("show", store)
    assert strict(printed("show", store, "--json"))["points"] == 2


def test_the_problem_is_saved_with_its_data_and_can_be_restored(printed, tmp_path, monkeypatch, capsys):
    file, empty = tmp_path / "run.json", tmp_path / "empty"
    empty.mkdir()
    file.write_text(printed("simulate", ROOT / "problems" / "field.toml", "--json"), encoding="utf-8")
    monkeypatch.chdir(empty)
    shown = printed("show", file, "--problem")
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        assert (ROOT / "problems" / name).read_text(encoding="utf-8").rstrip() in shown
    printed("show", file, "--restore", "again")
    found = po.load(file)
    again = po.read_problem(empty / "again" / "field.toml", found.origin.overrides).simulate()
    assert again.mean_draft == found.mean_draft
    assert main(["show", str(file), "--restore", "again"]) == 2  # nothing is overwritten
    assert "again" in capsys.readouterr().err


def test_a_run_of_a_file_is_drawn_with_the_files_limits(printed, tmp_path):
    file = tmp_path / "run.json"
    file.write_text(printed("simulate", ROOT / "problems" / "cotton_subsoiler.toml", "--json"), encoding="utf-8")
    for made in (po.load(file), po.read_problem(ROOT / "problems" / "cotton_subsoiler.toml").simulate()):
        (axes,) = [axes for axes in made.plot().axes if axes.get_ylabel().startswith("deflection")]
        limit = [line for line in axes.lines if line.get_label().startswith("limit of the deflection")]
        assert [line.get_ydata()[0] for line in limit] == [0.12]  # in metres, as the file has it


def test_shares_in_one_frame_are_saved_shown_and_compared(printed, tmp_path):
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
