"""`plough-opt accuracy`: tables, advice and files."""

import json

import pytest
from helpers.commands import call, printed
from helpers.problem_files import STATIC, SUBSOILER

from plough_opt.studies.accuracy.result import AccuracyStudy


@pytest.fixture
def static(tmp_path):
    """Return the path of a small problem file."""
    path = tmp_path / "small.toml"
    path.write_text(STATIC, encoding="utf-8")
    return path


def test_tables_advice_and_files(static, tmp_path):
    picture, output = tmp_path / "cost.png", tmp_path / "deep" / "cost.json"
    moving = ("--set", "effects.motion=true", "--set", "scene.duration=0.1 s")
    uncertain = "uncertain.soil.cohesion={ distribution = 'normal', mean = '20 kPa', std = '1 kPa' }"
    options = ("--thin", "--error", "1e-5", "--seconds", "0.05", "--plot", picture, "--output", output)
    done = call("accuracy", static, *options, *moving, "--set", uncertain)
    assert done.status == 0
    assert "averages of the motion: relative error against time" in done.out
    (advice,) = (line for line in done.out.splitlines() if line.startswith("averages of the motion: for 1e-05 take "))
    assert "the default" in advice
    assert "note: the study uses the nominal soil" in done.out
    assert "casadi " in done.out.splitlines()[-1]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {picture}" in done.err.replace("\n", "")
    study = AccuracyStudy.load(output)
    assert (study.wanted, study.duration) == (1e-5, pytest.approx(0.1))
    assert advice in json.loads(output.read_text(encoding="utf-8"))["advice"]


def test_a_file_without_a_motion_has_nothing_to_compare(static):
    assert "no motion to integrate" in printed("accuracy", static)


@pytest.mark.slow
def test_the_methods_of_a_motion_and_of_its_gradients():
    out = printed("accuracy", SUBSOILER, "--set", "scene.duration=0.1 s", "--thin", "--seconds", "0.2")
    for words in ("averages of the motion", "gradients of the averages"):
        assert f"{words}: relative error against time" in out
    for method in ("auto, error 1e-08 (default) ", "dop853, ", "cvodes, ", "quasi-static ", "harmonic balance, "):
        assert f" {method}" in out


def test_a_design_instead_of_a_scene(static, tmp_path):
    output = tmp_path / "cost.json"
    out = printed("accuracy", static, "--design", "--seconds", "0.3", "--output", output)
    for words in ("objective of the optimum: relative error", "variables of the optimum: relative", "auto (default)"):
        assert words in out
    study = AccuracyStudy.load(output)
    assert (study.duration, study.title) == (None, "Quasi-static")
    # One basin: every search finds its best.
    assert [row.right for row in study.thoroughness] == [row.asked for row in study.thoroughness]
    assert study.thoroughness[0].search == "near"
    assert all(max(entry.errors.values()) < 1e-9 for entry in study.entries if entry.failure is None)
