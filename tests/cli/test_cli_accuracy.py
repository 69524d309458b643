"""`plough-opt accuracy`: tables, advice and files; and what is wrong with an input."""

import json

import pytest

from plough_opt.studies.accuracy.result import AccuracyStudy

# Short, damped by the file, every other setting.
BRIEF = ("--set", "scene.duration=0.1 s", "--thin", "--seconds", "0.2")


@pytest.fixture(scope="module")
def done(cli, cotton, tmp_path_factory):
    """Return the outcome of a short study of the cotton problem, and the files that it wrote."""
    folder = tmp_path_factory.mktemp("accuracy")
    picture, output = folder / "cost.png", folder / "deep" / "cost.json"
    return cli("accuracy", cotton, *BRIEF, "--error", "1e-5", "--plot", picture, "--output", output), picture, output


def test_tables_and_advice(done):
    outcome = done[0]
    assert outcome.status == 0
    assert "averages of the motion: relative error against time" in outcome.out
    assert "gradients of the averages: relative error against time" in outcome.out
    for method in ("auto, error 1e-08 (default) ", "dop853, ", "cvodes, ", "quasi-static ", "harmonic balance, "):
        assert f" {method}" in outcome.out
    assert max(map(len, outcome.out.split("Times are")[0].splitlines())) <= 80
    (advice,) = (line for line in outcome.out.splitlines() if line.startswith("averages of the motion: for 1e-05"))
    assert "take " in advice
    assert "the default" in advice
    assert "casadi " in outcome.out.splitlines()[-1]


def test_files(done):
    outcome, picture, output = done
    assert picture.read_bytes().startswith(b"\x89PNG")
    study = AccuracyStudy.load(output)
    assert study.wanted == 1e-5
    assert study.title == "Subsoiler for cotton on serozem"
    assert study.duration == pytest.approx(0.1)
    assert json.loads(output.read_text(encoding="utf-8"))["advice"].splitlines()[0] in outcome.out
    assert f"wrote {picture}" in outcome.err.replace("\n", "")


@pytest.mark.slow
def test_a_lasting_orbit_needs_no_duration(cli, cotton, tmp_path):
    path = tmp_path / "orbit.toml"
    text = cotton.read_text(encoding="utf-8").replace("[effects]", '[effects]\norbit = "linearised"')
    path.write_text("\n".join(line for line in text.splitlines() if "duration" not in line), encoding="utf-8")
    done = cli("accuracy", path, "--thin", "--seconds", "0.1")
    assert (done.status, done.err) == (0, "")
    assert " linearised " in done.out
    assert "finds no lasting orbit" in done.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--error", "2"), "wanted error = 2 must be at most 0.1"),
        (("--error", "0"), "wanted error = 0 must be at least"),
        (("--seconds", "0"), "time allowed to a contestant"),
        (("--plot", "cost.jpg"), "no known picture format"),
    ],
)
def test_bad_input(cli, cotton, arguments, said):
    done = cli("accuracy", cotton, *arguments)
    assert (done.status, done.out) == (2, "")
    assert said in " ".join(done.err.split())
    assert "Traceback" not in done.err


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
    exact = next(e for e in study.entries if e.method == "exact Hessian, carried along")
    assert max(exact.errors.values()) < 1e-9


def test_an_uncertain_soil_is_said_to_take_no_part(cli, tmp_path):
    path = tmp_path / "small.toml"
    uncertain = (
        '[uncertain]\nsamples = 8\n"soil.cohesion" = { distribution = "normal", mean = "20 kPa", std = "1 kPa" }\n'
    )
    path.write_text(SMALL + uncertain, encoding="utf-8")
    done = cli("accuracy", path)
    assert done.status == 0
    assert "note: the soil is the nominal one: its uncertainty takes no part" in done.out


def test_a_design_without_variables_is_refused(cli, tmp_path):
    path = tmp_path / "still.toml"
    path.write_text(
        SMALL.split("[variables]")[0].replace("height =", 'wedge_angle = "25 deg"\nheight ='), encoding="utf-8"
    )
    done = cli("accuracy", path, "--design")
    assert done.status == 2
    assert "nothing to" in done.err
