"""Saved results: their origin, shown as they were printed, compared, in strictly valid JSON."""

import hashlib
import platform
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import PROBLEMS, SUBSOILER
from helpers.strict_json import strict

import plough_opt as po

QUICK = ("--set", "effects.motion=false", "--set", "scene.outputs=10")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a shipped problem file, without the lines that need motion."""
    where = tmp_path_factory.mktemp("saved")
    text = SUBSOILER.read_text(encoding="utf-8")
    still = re.sub(r"^(damping|force_rms|deflection).*\n", "", text, flags=re.MULTILINE)
    (where / "share.toml").write_text(still, encoding="utf-8")
    return where


def optimised(folder, speed):
    return "optimise", folder / "share.toml", *QUICK, "--search", "near", "--set", f'scene.tow_speed="{speed}"'


@pytest.fixture(scope="module")
def saved(folder):
    """Two optima that differ in the tow speed."""
    paths = {folder / "slow.json": "7.2 km/h", folder / "fast.json": "9 km/h"}
    for path, speed in paths.items():
        path.write_text(printed(*optimised(folder, speed), "--json"), encoding="utf-8")
    return [*paths]


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


def test_a_file_name_that_is_no_text_is_saved_with_question_marks():
    assert replace(po.read_problem(SUBSOILER), name="a\udce4.toml").origin.file == "a?.toml"


def test_show_prints_the_same_tables(folder, saved):
    words = optimised(folder, "9 km/h")
    fresh, again = printed(*words).splitlines(), printed("show", saved[1]).splitlines()
    # The last line of the tables has the time that the solve took.
    assert again[: len(fresh) - 1] == fresh[:-1]
    assert again[-2].startswith("Made from share.toml (SHA-256 ")
    assert '--set scene.tow_speed="9 km/h"' in again[-2]
    assert "plough_opt" in again[-1]
    assert strict(printed("show", saved[1], "--json")) == strict(saved[1].read_text(encoding="utf-8"))


def test_compare_sets_designs_side_by_side(saved, tmp_path):
    slow, fast = (po.load(path) for path in saved)
    picture = tmp_path / "both.svg"
    text = printed("compare", *saved, "--plot", picture)
    assert cells(text, "tow speed") == ["7.2 km/h", "9 km/h"]
    assert cells(text, "mean draft") == [f"{one.run.averages.mean_draft / 1e3:.6g} kN" for one in (slow, fast)]
    # What all have alike is no row.
    assert "cohesion" not in text
    assert 'scene.tow_speed="9 km/h"' in text
    assert picture.stat().st_size > 5000
    found = strict(printed("compare", *saved, "--json"))
    assert found["fast.json"]["share.height"] == fast.variables["share.height"]


def test_compare_refuses_one_file_and_an_output_that_is_an_input(saved, tmp_path):
    other = shutil.copy(saved[0], tmp_path / "picture.png")
    for words, told in (([saved[0]], "two or more"), ([saved[0], other, "--plot", other], "would overwrite")):
        done = call("compare", *words)
        assert done.status == 2
        assert told in done.said


def test_json_of_every_command_is_strict(folder, monkeypatch):
    monkeypatch.chdir(folder)
    for command, *rest in (("export", "--to", "stl", "--at", "guess", "--output", "share.stl"), ("check",)):
        strict(printed(command, "share.toml", *rest, "--json"))
    assert strict(printed("init", "new.toml", "--json")) == {"wrote": ["new.toml"]}


def test_a_sweep_is_shown_from_its_store(tmp_path):
    store, over = tmp_path / "s.db", {"a": [1.0, 2.0]}
    with ThreadPoolExecutor(1) as inline, po.sweep(lambda point: {"b": point["a"]}, over, store=store, executor=inline):
        pass
    assert "2 points, 0 failed" in printed("show", store)
    assert strict(printed("show", store, "--json"))["points"] == 2
    assert "the store of a sweep has no problem file" in call("show", store, "--problem").said


def test_the_problem_is_saved_with_its_data_and_can_be_restored(tmp_path, monkeypatch):
    file, empty = tmp_path / "run.json", tmp_path / "empty"
    empty.mkdir()
    file.write_text(printed("simulate", PROBLEMS / "field.toml", "--json"), encoding="utf-8")
    monkeypatch.chdir(empty)
    shown = printed("show", file, "--problem")
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        assert (PROBLEMS / name).read_text(encoding="utf-8").rstrip() in shown
    printed("show", file, "--restore", "again")
    found = po.load(file)
    again = po.read_problem(empty / "again" / "field.toml", found.origin.overrides).simulate()
    assert again.mean_draft == found.mean_draft
    done = call("show", file, "--restore", "again")
    assert (done.status, "exists already" in done.said) == (2, True)  # nothing is overwritten


def test_a_run_of_a_file_is_drawn_with_the_files_limits(tmp_path):
    run = po.read_problem(SUBSOILER).simulate()
    for made in (run, po.load(run.save(tmp_path / "run.json"))):
        (axes,) = [axes for axes in made.plot().axes if axes.get_ylabel().startswith("deflection")]
        limit = [line for line in axes.lines if line.get_label().startswith("limit of the deflection")]
        assert [line.get_ydata()[0] for line in limit] == [0.12]  # in metres, as the file has it


def test_shares_in_one_frame_are_saved_shown_and_compared(tmp_path):
    words = (PROBLEMS / "two_shares.toml", "--set", "scene.duration=0.1 s", "--json")
    slow, fast = tmp_path / "slow.json", tmp_path / "fast.json"
    slow.write_text(printed("simulate", *words), encoding="utf-8")
    fast.write_text(printed("simulate", *words, "--set", "scene.tow_speed=9 km/h"), encoding="utf-8")
    assert strict(slow.read_text(encoding="utf-8"))["kind"] == "machine"
    assert "together" in printed("show", slow)
    text = printed("compare", slow, fast, "--plot", tmp_path / "both.svg")
    for share in ("front", "rear"):
        drafts = [po.load(path).runs[share].mean_draft for path in (slow, fast)]
        assert cells(text, f"mean draft, {share}") == [f"{draft / 1e3:.6g} kN" for draft in drafts]
