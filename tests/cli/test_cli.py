"""The command `plough-opt`: what it prints and writes, its exit status, and never a traceback."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import plough_opt as po
from plough_opt.app import main
from plough_opt.problem_file import TEMPLATE

BRIEF = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=20")


def cells(out, row):
    """Return the cells of the one table row that begins with a name."""
    found = [line for line in out.splitlines() if re.match(rf"│ {re.escape(row)} +│", line)]
    assert len(found) == 1, f"one row {row!r} in\n{out}"
    return [cell.strip() for cell in found[0].strip("│").split("│")][1:]


def amount(text):
    """Return the number at the beginning of a quantity."""
    return float(text.split()[0])


def test_init_writes_a_valid_template_says_what_next_and_leaves_files_alone(cli, tmp_path):
    path = tmp_path / "share.toml"
    done = cli("init", path)
    assert done.status == 0
    assert path.read_text(encoding="utf-8") == TEMPLATE
    assert f"plough-opt optimise {path}" in " ".join(done.out.split())
    assert cli("check", path).status == 0
    path.write_text("mine", encoding="utf-8")
    done = cli("init", path)
    assert (done.status, done.out) == (2, "")
    assert done.err == f"bad input: '{path}' exists already and is left as it is: name another file\n"
    assert path.read_text(encoding="utf-8") == "mine"
    done = cli("init", tmp_path / "nowhere" / "share.toml")
    assert done.status == 2
    assert "cannot be written" in done.err
    assert [*tmp_path.iterdir()] == [path]


def test_soils_have_their_values_and_sources(cli):
    done = cli("soils")
    assert (done.status, done.err) == (0, "")
    assert cells(done.out, "serozem")[:2] == ["1350 kg/m^3", "1700 kg/m^3"]
    assert cells(done.out, "heavy clay")[2:] == ["0.812", "45 kPa", "15 deg", "0.40", "275 kPa"]
    for name in po.soil_names():
        assert f"\n{name}: engineering choice" in done.out
    soils = {soil["name"]: soil for soil in json.loads(cli("soils", "--json").out)}
    assert tuple(soils) == po.soil_names()
    # To the digits of the published value.
    assert soils["serozem"].pop("cone_index") == pytest.approx(261446.126, rel=1e-9)
    assert po.Soil(**soils["serozem"]) == po.named_soil("serozem")


def test_check_shows_every_quantity_in_the_unit_of_the_file_and_what_follows(cli, cotton):
    done = cli("check", cotton)
    out = done.out
    assert (done.status, done.err) == (0, "")
    assert "Subsoiler for cotton on serozem" in out
    for row, shown in {
        "soil": "serozem",
        "share.chisel_angle": "15 deg",
        "scene.tow_speed": "7.2 km/h",
        "effects.damping": "400 N*s/m",
        # 2 m/s over a wave of 0.2 m.
        "frequency of the strength wave": "10 Hz",
    }.items():
        assert cells(out, row) == [shown]
    # sqrt(k/M)/2 pi of the mount with the masses shown above it.
    mass = sum(amount(cells(out, row)[0]) for row in ("moving mass with the share", "added mass of soil"))
    assert amount(cells(out, "natural frequency")[0]) == pytest.approx(math.sqrt(50e3 / mass) / math.tau, rel=1e-3)
    assert cells(out, "equation of motion")[0].startswith("2 states")
    assert "3 variables, 3 requirements" in out


def test_check_shows_changes_and_notes_what_is_fixed(cli, cotton, reference, tmp_path):
    changes = ("effects.damping=1 kN*s/m", "share.height=0.3 m")
    done = cli("check", cotton, *(f"--set={text}" for text in changes))
    assert cells(done.out, "effects.damping") == ["1 kN*s/m"]
    assert cells(done.out, "share.height") == ["0.3 m"]
    assert "2 variables" in done.out
    assert done.err == "note: 'share.height' is a variable of the file and is now fixed at 0.3 m\n"
    out = cli("check", cotton, "--set", "effects.formulation=printed").out
    assert "natural frequency" not in out  # a spring that repels does not oscillate
    assert cells(out, "growth under the print's repelling spring")[0].startswith("exp(")
    out = cli("check", reference, "--set", "effects.motion=false", "--set", "title=a [red]title[/red] [/]").out
    assert cells(out, "quasi-static") == ["no equation of motion"]
    assert "a [red]title[/red] [/]" in out
    path = tmp_path / "share.toml"
    path.write_text(re.sub("steel_density.*", "", cotton.read_text(encoding="utf-8")), encoding="utf-8")
    assert cells(cli("check", path).out, "scene.steel_density") == ["7850 kg/m^3"]  # a default has its unit too


def test_brackets_in_a_file_name_are_shown(cli, cotton, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "[/b].toml"  # rich would take it for the end of a style
    Path(name).parent.mkdir()
    shutil.copy(cotton, name)
    done = cli("check", name)
    assert done.status == 0
    assert f"{name} is valid" in done.out
    assert f"plough-opt optimise {name}" in done.out


def test_simulate_prints_the_numbers_of_the_run_and_saves_them(cli, reference, tmp_path):
    run = po.read_problem(reference, BRIEF[1::2]).simulate()
    done = cli("simulate", reference, *BRIEF)
    assert (done.status, done.err) == (0, "")
    for row, expected in {
        "mean draft": run.mean_draft / 1e3,
        "RMS of the mount force": run.force_rms / 1e3,
        "tow power": run.tow_power / 1e3,
        "peak deflection": run.peak_deflection,
    }.items():
        assert amount(cells(done.out, row)[0]) == pytest.approx(expected, rel=1e-4)
    assert "ambient pressure (10 kPa) carries" in done.out
    assert "relative error about" in done.out
    path = tmp_path / "run.json"
    path.write_text(cli("simulate", reference, *BRIEF, "--json").out, encoding="utf-8")
    saved = po.load(path)
    assert saved.origin.title == "R1: reference problem with three local optima"
    assert saved.averages == run.averages
    assert saved.mount_force.tolist() == run.mount_force.tolist()


def test_a_picture_is_written_and_json_stands_alone_on_its_stream(cli, cotton, tmp_path):
    path = tmp_path / "pictures" / "run.pdf"
    done = cli("simulate", cotton, "--json", "--set", "share.height=20 cm", "--plot", path, *BRIEF)
    assert done.status == 0
    assert json.loads(done.out)["kind"] == "run"
    assert "note: " in done.err
    assert done.err.endswith(f"wrote {path}\n")
    assert path.read_bytes().startswith(b"%PDF-")


def test_optimise_prints_the_best_of_three_optima_and_what_decided_it(optimised):
    assert (optimised.status, optimised.err) == (0, "")
    assert "Best design: objective 0.825005709 (solved)" in optimised.out
    table = optimised.out.split("Local optima found")[1].split("Note:")[0]
    objectives = [float(line.split("│")[2]) for line in table.splitlines() if line.startswith("│ s")]
    assert len(objectives) == 3
    assert objectives == sorted([0.825005709, *objectives[1:]])
    angle, bounds, _ = cells(optimised.out, "share.wedge_angle")
    assert (amount(angle), bounds) == (pytest.approx(39.1147, abs=1e-3), "5 deg to 60 deg")
    assert cells(optimised.out, "scene.stiffness") == ["5 kN/m", "5 kN/m to 500 kN/m", "at its bound"]
    assert cells(optimised.out, "loosened_radius") == ["at least 0.12 m", "0.12 m", "0 m", "decides"]
    assert cells(optimised.out, "half_angle") == ["at most 15 deg", "15 deg", "0 deg", "decides"]
    limits, value, margin, decides = cells(optimised.out, "mean_deflection")
    assert (limits, decides) == ("at most 0.15 m", "")
    assert amount(value) + amount(margin) == pytest.approx(0.15, abs=1e-5)


def test_its_json_reads_back_equal_and_its_picture_is_an_svg(optimised_json, tmp_path):
    done, picture = optimised_json
    path = tmp_path / "r1.json"
    path.write_text(done.out, encoding="utf-8")
    saved = po.load(path)
    assert (done.status, done.err) == (0, f"wrote {picture}\n")
    assert saved.to_json() == done.out.rstrip("\n")
    assert saved.objective == pytest.approx(0.825005709, abs=1e-9)
    averages = saved.run.averages
    assert averages.mean_draft / 1e3 + averages.force_rms / 1e3 == pytest.approx(0.825005709, abs=1e-8)
    assert ET.parse(picture).getroot().tag.endswith("svg")


def test_an_impossible_requirement_is_no_solution_and_the_conflict_is_named(cli, reference, tmp_path):
    picture = tmp_path / "r1.png"
    done = cli("optimise", reference, "--set", "require.loosened_radius.at_least=2 m", "--plot", picture)
    assert (done.status, done.out) == (1, "")
    assert done.err.startswith("no solution: ")
    assert len(done.err.splitlines()) == 1
    assert "'loosened_radius' (at least 2 m) fails by" in done.err
    assert "'half_angle' at most 15 deg" in done.err
    assert "upper bound 0.5 m of 'share.height'" in done.err
    assert list(tmp_path.iterdir()) == []


BAD_INPUT = {
    "missing file": ("check subsoler.toml", "there is no file 'subsoler.toml': did you mean 'subsoiler.toml'"),
    "key": ("check wrong.toml", "wrong.toml, line 10: 'scene.tow_sped' is not a known key: did you mean 'tow_speed'?"),
    "picture": ("simulate subsoiler.toml --plot run.jpg", "'run.jpg' has no known picture format: end its name in"),
    "no objective": ("optimise aimless.toml", "aimless.toml: nothing to minimise: add a table [minimise]"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch, cotton):
    """Work in a folder of right and wrong files."""
    monkeypatch.chdir(tmp_path)
    text = cotton.read_text(encoding="utf-8")
    for name, content in {
        "subsoiler.toml": text,
        "wrong.toml": text.replace("tow_speed", "tow_sped"),
        "aimless.toml": re.sub(r"\[minimise\][^\[]*", "", text),
    }.items():
        Path(name).write_text(content, encoding="utf-8")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("line", "expected"), BAD_INPUT.values(), ids=list(BAD_INPUT))
def test_bad_input_is_refused_in_a_sentence_and_nothing_is_written(cli, line, expected):
    before = {path: path.read_bytes() for path in Path.cwd().iterdir()}
    done = cli(*line.split())
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("bad input: ")
    assert len(done.err.splitlines()) == 1
    assert expected in done.err
    assert {path: path.read_bytes() for path in Path.cwd().iterdir()} == before


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("verb", "picture"), [("simulate", "run.jpg"), ("optimise", "new/run.gif"), ("simulate", "")])
def test_a_picture_that_cannot_be_is_refused_before_anything_is_computed(cli, monkeypatch, verb, picture):
    def compute(*_):
        raise AssertionError("computed")

    monkeypatch.setattr(po.Problem, verb, compute)
    assert cli(verb, "subsoiler.toml", "--plot", picture).status == 2
    assert not Path("new").exists()


@pytest.mark.parametrize("arguments", [[], ["check"]], ids=["no command", "no file"])
def test_wrong_usage_is_explained(capsys, arguments):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert capsys.readouterr().err.startswith("usage: plough-opt")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--help"], ["\n    init ", "\n    check ", "\n    simulate ", "\n    optimise ", "\n    soils "]),
        (["check", "--help"], ['--set KEY="VALUE"']),
        (["--version"], [f"plough-opt {po.__version__}\n"]),
    ],
)
def test_help_and_version_go_to_the_standard_stream(capsys, arguments, words):
    with pytest.raises(SystemExit, match="0"):
        main(arguments)
    out = capsys.readouterr().out
    assert [one for one in words if one not in out] == []


# What only a process of its own shows: exit status, streams, no traceback.
def test_the_installed_command_and_the_module_are_the_same(cli):
    script = [Path(sys.executable).with_name("plough-opt")], [sys.executable, "-m", "plough_opt"]
    for line in script:
        done = subprocess.run([*line, "soils"], capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (0, cli("soils").out, "")


def test_a_process_shows_no_progress_where_there_is_no_terminal(command, reference):
    done = command("optimise", reference, "--json", "--search", "near", "--set", "effects.motion=false")
    assert (done.status, done.err) == (0, "")
    assert json.loads(done.out)["kind"] == "optimum"


@pytest.mark.parametrize("arguments", [["soils", "--json"], ["check"]], ids=" ".join)
def test_a_reader_that_has_seen_enough_is_no_error(command, cotton, arguments):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = command(*arguments, *([cotton] if arguments == ["check"] else []), stdout=writing)
    finally:
        os.close(writing)
    assert (done.status, done.err) == (0, "")


def test_neither_casadis_notices_nor_a_title_in_another_script_disturb_a_terminal(command, reference):
    stuck = ("--set", 'effects.contact="stick_slip"', "--set", 'effects.start="rest"')
    ascii_only = {"PYTHONIOENCODING": "ascii"}
    done = command("simulate", reference, *BRIEF, *stuck, "--set", "title=Плуг", environment=ascii_only)
    assert (done.status, done.err) == (0, "")
    assert "\\u041f" in done.out


def test_optimise_may_be_spelt_otherwise(cli, reference):
    told = {verb: cli(verb, reference, "--set", "scene.tow_sped=1 m/s") for verb in ("optimise", "optimize")}
    assert told["optimize"] == told["optimise"]
    assert told["optimize"].status == 2
