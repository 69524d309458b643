"""`plough-opt accuracy`: tables, advice and files; and what is wrong with an input."""

import json

import pytest

from plough_opt.studies.accuracy.result import AccuracyStudy

SMALL = """
title = "Quasi-static"
[soil]
name = "serozem"
[share]
chisel_angle = "15 deg"
height = "0.25 m"
[scene]
tow_speed = "2 m/s"
frame_mass = "20 kg"
steel_density = "7850 kg/m^3"
stiffness = "50 kN/m"
duration = "0.2 s"
[effects]
motion = false
[variables]
"share.wedge_angle" = { lower = "5 deg", upper = "60 deg", guess = "25 deg" }
[minimise]
mean_draft = { per = "1 kN" }
[require]
loosened_radius = { at_least = "0.12 m" }
"""

UNCERTAIN = """
[uncertain]
samples = 8
"soil.cohesion" = { distribution = "normal", mean = "20 kPa", std = "1 kPa" }
"""


def test_tables_advice_and_files(cli, tmp_path):
    path, picture, output = tmp_path / "small.toml", tmp_path / "cost.png", tmp_path / "deep" / "cost.json"
    path.write_text(SMALL + UNCERTAIN, encoding="utf-8")
    done = cli("accuracy", path, "--thin", "--error", "1e-5", "--plot", picture, "--output", output)
    assert done.status == 0
    assert "quasi-static averages: relative error against time" in done.out
    (advice,) = (line for line in done.out.splitlines() if line.startswith("quasi-static averages: for 1e-05 take "))
    assert "the default" in advice
    assert "note: the study uses the nominal soil" in done.out
    assert "casadi " in done.out.splitlines()[-1]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {picture}" in done.err.replace("\n", "")
    study = AccuracyStudy.load(output)
    assert (study.wanted, study.title, study.duration) == (1e-5, "Quasi-static", pytest.approx(0.2))
    assert json.loads(output.read_text(encoding="utf-8"))["advice"] == advice


@pytest.mark.slow
def test_the_methods_of_a_motion_and_of_its_gradients(cli, cotton):
    done = cli("accuracy", cotton, "--set", "scene.duration=0.1 s", "--thin", "--seconds", "0.2")
    assert done.status == 0
    for words in ("averages of the motion", "gradients of the averages"):
        assert f"{words}: relative error against time" in done.out
    for method in ("auto, error 1e-08 (default) ", "dop853, ", "cvodes, ", "quasi-static ", "harmonic balance, "):
        assert f" {method}" in done.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--error", "2"), "wanted error = 2 must be at most 0.1"),
        (("--seconds", "0"), "time allowed to a method"),
    ],
)
def test_bad_input(cli, cotton, arguments, said):
    done = cli("accuracy", cotton, *arguments)
    assert (done.status, done.out) == (2, "")
    assert said in " ".join(done.err.split())
    assert "Traceback" not in done.err


def test_a_design_instead_of_a_scene(cli, tmp_path):
    path, output = tmp_path / "small.toml", tmp_path / "cost.json"
    path.write_text(SMALL, encoding="utf-8")
    done = cli("accuracy", path, "--design", "--seconds", "0.3", "--output", output)
    assert done.status == 0
    assert "optimum of the design: relative error against time" in done.out
    assert "(default)" in done.out
    assert "medians after a warm-up: one local solve" in done.out
    study = AccuracyStudy.load(output)
    assert study.duration is None
    assert study.title == "Quasi-static"
    # One basin: every search finds its best.
    assert [row.right for row in study.thoroughness] == [row.asked for row in study.thoroughness]
    assert study.thoroughness[0].search == "near"
    exact = next(e for e in study.entries if e.method == "exact Hessian, carried along")
    assert max(exact.errors.values()) < 1e-9
