"""The command `plough-opt`: what it prints and writes, its exit status, and never a traceback."""

import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import REFERENCE, SUBSOILER, changed

import plough_opt as po
from plough_opt.app.main import main
from plough_opt.problem_file import template

# --- the command `plough-opt`: what it prints and writes, its exit status, and never a traceback ---

BRIEF = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=20")


def amount(text):
    """Return the number at the beginning of a quantity."""
    return float(text.split()[0])


def test_init_writes_the_template_and_says_what_next(tmp_path):
    path = tmp_path / "share.toml"
    assert f"plough-opt optimise {path}" in " ".join(printed("init", path).split())
    assert path.read_text(encoding="utf-8") == template()
    assert "\\x1b[2J" in printed("init", tmp_path / "\x1b[2J.toml")  # no command to the terminal comes out of a name


def test_soils_have_their_values_and_sources():
    out = printed("soils")
    assert cells(out, "serozem")[:2] == ["1350 kg/m^3", "1700 kg/m^3"]
    assert cells(out, "heavy clay")[2:] == ["0.812", "45 kPa", "15 deg", "0.40", "275 kPa"]
    assert all(f"\n{name}: engineering choice" in out for name in po.soil_names())
    soils = {soil["name"]: soil for soil in json.loads(printed("soils", "--json"))}
    assert tuple(soils) == po.soil_names()
    # To the digits of the published value.
    assert soils["serozem"].pop("cone_index") == pytest.approx(261446.126, rel=1e-9)
    assert po.Soil(**soils["serozem"]) == po.named_soil("serozem")


def test_check_shows_every_quantity_in_the_unit_of_the_file_and_what_follows():
    done = call("check", SUBSOILER)
    assert (done.status, done.err) == (0, "")
    assert "Subsoiler for cotton on serozem" in done.out
    for row, shown in {
        "soil": "serozem",
        "share.chisel_angle": "15 deg",
        "scene.tow_speed": "7.2 km/h",
        "effects.damping": "400 N*s/m",
        # 2 m/s over a wave of 0.2 m.
        "frequency of the strength wave": "10 Hz",
    }.items():
        assert cells(done.out, row) == [shown]
    # sqrt(k/M)/2 pi of the mount with the masses shown above it.
    mass = sum(amount(cells(done.out, row)[0]) for row in ("moving mass with the share", "added mass of soil"))
    frequency = amount(cells(done.out, "natural frequency")[0])
    assert frequency == pytest.approx(math.sqrt(50e3 / mass) / math.tau, rel=1e-3)
    assert cells(done.out, "equation of motion")[0].startswith("2 states")
    assert "3 variables, 3 requirements" in done.out


def test_check_shows_changes_and_notes_what_is_fixed(tmp_path):
    done = call("check", SUBSOILER, "--set=effects.damping=1 kN*s/m", "--set=share.height=0.3 m")
    assert cells(done.out, "effects.damping") == ["1 kN*s/m"]
    assert cells(done.out, "share.height") == ["0.3 m"]
    assert "2 variables" in done.out
    assert done.err == "note: 'share.height' is a variable of the file and is now fixed at 0.3 m\n"
    out = printed("check", SUBSOILER, "--set", "effects.formulation=printed")
    assert "natural frequency" not in out  # a spring that repels does not oscillate
    assert cells(out, "growth under the print's repelling spring")[0].startswith("exp(")
    out = printed("check", REFERENCE, "--set", "effects.motion=false", "--set", "title=a [red]title[/red] [/]")
    assert cells(out, "quasi-static") == ["no equation of motion"]
    assert "a [red]title[/red] [/]" in out
    path = tmp_path / "share.toml"
    path.write_text(changed(('steel_density = "7850 kg/m^3"', "")), encoding="utf-8")
    assert cells(printed("check", path), "scene.steel_density") == ["7850 kg/m^3"]  # a default has its unit too


def test_brackets_in_a_file_name_are_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "[/b].toml"  # rich would take it for the end of a style
    Path(name).parent.mkdir()
    shutil.copy(SUBSOILER, name)
    out = printed("check", name)
    assert f"{name} is valid" in out
    assert f"plough-opt optimise {name}" in out


def test_simulate_prints_the_numbers_of_the_run_and_saves_them(tmp_path):
    run = po.read_problem(REFERENCE, BRIEF[1::2]).simulate()
    done = call("simulate", REFERENCE, *BRIEF)
    assert (done.status, done.err) == (0, "")
    for row, expected in {
        "mean draft": run.mean_draft / 1e3,
        "RMS of the mount force": run.force_rms / 1e3,
        "tow power": run.tow_power / 1e3,
        "peak deflection": run.peak_deflection,
    }.items():
        assert cells(done.out, row)[0].split()[0] == f"{expected:.4g}"
    assert "ambient pressure (10 kPa) carries" in done.out
    assert "relative error about" in done.out
    path = tmp_path / "run.json"
    path.write_text(printed("simulate", REFERENCE, *BRIEF, "--json"), encoding="utf-8")
    saved = po.load(path)
    assert saved.origin.title == "R1: reference problem with three local optima"
    assert saved.averages == run.averages
    assert saved.mount_force.tolist() == run.mount_force.tolist()


@pytest.fixture(scope="module")
def optimised(tmp_path_factory):
    """Return the outcome of optimising R1 as JSON, and the folder of that and of its picture."""
    folder = tmp_path_factory.mktemp("r1")
    done = call("optimise", REFERENCE, "--json", "--plot", folder / "r1.svg")
    (folder / "r1.json").write_text(done.out, encoding="utf-8")
    return done, folder


def test_optimise_prints_the_best_of_three_optima_and_what_decided_it(optimised):
    out = printed("show", optimised[1] / "r1.json")
    assert "Best design: objective 0.825006 (solved)" in out
    table = out.split("Local optima found")[1].split("Note:")[0]
    objectives = [float(line.split("│")[2]) for line in table.splitlines() if line.startswith("│ s")]
    assert len(objectives) == 3
    assert objectives == sorted([0.825006, *objectives[1:]])
    assert cells(out, "share.wedge_angle") == ["39.11 deg", "5 deg to 60 deg", ""]
    assert cells(out, "scene.stiffness") == ["5 kN/m", "5 kN/m to 500 kN/m", "at its bound"]
    assert cells(out, "loosened_radius") == ["at least 0.12 m", "0.12 m", "0 m", "decides"]
    assert cells(out, "half_angle") == ["at most 15 deg", "15 deg", "0 deg", "decides"]
    limits, value, margin, decides = cells(out, "mean_deflection")
    assert (limits, decides) == ("at most 0.15 m", "")
    found = po.load(optimised[1] / "r1.json").run.mean_deflection
    assert (value, margin) == (f"{found:.4g} m", f"{0.15 - found:.3g} m")


def test_its_json_reads_back_equal_and_its_picture_is_an_svg(optimised):
    done, folder = optimised
    saved = po.load(folder / "r1.json")
    assert (done.status, done.err) == (0, f"wrote {folder / 'r1.svg'}\n")
    assert saved.to_json() == done.out.rstrip("\n")
    assert saved.objective == pytest.approx(0.825005709, abs=1e-9)
    averages = saved.run.averages
    assert averages.mean_draft / 1e3 + averages.force_rms / 1e3 == pytest.approx(0.825005709, abs=1e-8)
    assert ET.parse(folder / "r1.svg").getroot().tag.endswith("svg")


def test_an_impossible_requirement_is_no_solution_and_the_conflict_is_named(tmp_path):
    done = call("optimise", REFERENCE, "--set", "require.loosened_radius.at_least=2 m", "--plot", tmp_path / "r1.png")
    assert (done.status, done.out) == (1, "")
    assert done.err.startswith("no solution: ")
    assert len(done.err.splitlines()) == 1
    for words in ("'loosened_radius' (at least 2 m) fails by", "'half_angle' at most 15 deg", "upper bound 0.5 m of"):
        assert words in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 2, ["usage: plough-opt"]),
        (["check"], 2, ["usage: plough-opt"]),
        (["simulate", "a.toml", "-q", "-v"], 2, ["not allowed"]),
        (["completion", "cmd"], 2, ["bash"]),
        (["--help"], 0, ["\n    init ", "\n    check ", "\n    simulate ", "\n    optimise ", "\n    soils "]),
        (["check", "--help"], 0, ['--set KEY="VALUE"']),
        (["--version"], 0, [f"plough-opt {po.__version__}\n"]),
    ],
)
def test_usage_is_explained_and_help_goes_to_the_standard_stream(capsys, arguments, status, words):
    with pytest.raises(SystemExit, match=str(status)):
        main(arguments)
    streams = capsys.readouterr()
    assert [one for one in words if one not in streams[1 if status else 0]] == []


# What only a process of its own shows: exit status, streams, no traceback.
def test_the_installed_command_and_the_module_are_the_same():
    for line in ([Path(sys.executable).with_name("plough-opt")], [sys.executable, "-m", "plough_opt"]):
        done = subprocess.run([*line, "soils"], capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (0, printed("soils"), "")


def test_a_reader_that_has_seen_enough_is_no_error(command):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = command("check", SUBSOILER, stdout=writing)
    finally:
        os.close(writing)
    assert (done.status, done.err) == (0, "")


def test_a_full_disk_is_an_error_of_the_output(capsys):
    with Path("/dev/full").open("w") as full, contextlib.redirect_stdout(full):
        assert main(["soils"]) == 2
    assert capsys.readouterr().err == "output: [Errno 28] No space left on device\n"


def test_neither_casadis_notices_nor_a_title_in_another_script_disturb_a_terminal(command):
    stuck = ("--set", 'effects.contact="stick_slip"', "--set", 'effects.start="rest"')
    ascii_only = {"PYTHONIOENCODING": "ascii"}
    done = command("simulate", REFERENCE, *BRIEF, *stuck, "--set", "title=Плуг", environment=ascii_only)
    assert (done.status, done.err) == (0, "")
    assert "\\u041f" in done.out


# --- `plough-opt check FILE --against`: other draft models beside a file's scene ---


def test_it_prints_drafts_assumptions_and_marks(tmp_path):
    done = call(
        "check", SUBSOILER, "--against", "--depth", "40 cm", "--width", "80 mm", "--rake", "45 deg", "--texture",
        "medium", "--speed", "3 km/h", "--speed", "2.5 m/s", "--plot", tmp_path / "drafts.png",
    )  # fmt: skip
    assert (done.status, done.err) == (0, f"wrote {tmp_path / 'drafts.png'}\n")
    assert (tmp_path / "drafts.png").stat().st_size > 10_000
    (line,) = [line for line in done.out.splitlines() if line.startswith("│ ASABE")]
    # Worked by hand: 0.7 (226 + 1.8 S^2) 40 N at S = 3 and 9.
    for words in ("0.4 m", "6.78 (", "10.4 ("):
        assert words in line
    for words in ("Assumed", "docs/crosscheck.md", "Not verified", "not verified against the standard's text"):
        assert words in done.out
    assert "Outside the domain" not in done.out


def test_without_options_it_says_what_it_estimated_of_which_design_and_what_it_cannot_do():
    out = printed("check", SUBSOILER, "--against")
    assert "working depth 0.25 m: the share's height, because none was given" in out
    assert "Outside the domain" in out
    guess = "share.wedge_angle = 25 deg, share.height = 0.25 m, scene.stiffness = 50 kN/m"
    assert f"at the file's guess, {guess}; use --set" in out
    fixed = ("--set=share.wedge_angle=39.1 deg", "--set=share.height=0.254 m", "--set=scene.stiffness=50.8 kN/m")
    assert "guess" not in printed("check", SUBSOILER, "--against", *fixed)
    assert "ASABE" not in printed("check", SUBSOILER)
