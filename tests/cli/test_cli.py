"""The command `plough-opt`: what it prints, writes and imports, exit status, refusals, and never a traceback."""

import contextlib
import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import PROBLEMS, REFERENCE, SUBSOILER

import plough_opt as po
from plough_opt.app import commands, terminal
from plough_opt.app.main import main
from plough_opt.problem_file import template
from plough_opt.studies.sweep.engine import Plan

# --- the command `plough-opt`: what it prints and writes, its exit status, and never a traceback ---

BRIEF = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=20")
FIXED = ("--set=share.wedge_angle=25 deg", "--set=share.height=0.25 m", "--set=scene.stiffness=50 kN/m")


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


def test_simulate_prints_the_numbers_of_the_run_and_saves_them(tmp_path):
    run = po.read_problem(REFERENCE, BRIEF[1::2]).simulate()
    done = call("simulate", REFERENCE, *BRIEF)
    assert (done.status, done.err) == (0, "")
    assert cells(done.out, "mean draft") == [f"{run.mean_draft / 1e3:.4g} kN"]
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


def test_the_optimum_of_r1_has_nine_digits_and_its_picture_is_an_svg(optimised):
    done, folder = optimised
    saved = po.load(folder / "r1.json")
    assert (done.status, done.err) == (0, f"wrote {folder / 'r1.svg'}\n")
    drawn = saved.run.averages.mean_draft / 1e3 + saved.run.averages.force_rms / 1e3
    assert (saved.objective, drawn) == (pytest.approx(0.825005709, abs=1e-9), pytest.approx(0.825005709, abs=1e-8))
    assert ET.parse(folder / "r1.svg").getroot().tag.endswith("svg")


USAGE = [
    ([], "usage: plough-opt"),
    (["check"], "usage: plough-opt"),
    (["simulate", "a.toml", "-q", "-v"], "not allowed"),
    (["optimis"], "'optimis' is unknown: did you mean 'optimise'"),
]


@pytest.mark.parametrize(("arguments", "words"), USAGE)
def test_usage_is_explained(capsys, arguments, words):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert words in capsys.readouterr().err


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


# --- files that commands may not write to, and files that are left when they are interrupted ---


def test_a_closed_output_is_no_traceback():
    line = f'"{sys.executable}" -m plough_opt check "{SUBSOILER}" >&-'
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("ctrl_c")
class TestInterruptions:
    @pytest.mark.parametrize("goes_on", [True, False])
    def test_one_that_casadi_took_for_a_failed_evaluation_stops_the_command_all_the_same(self, monkeypatch, goes_on):
        def swallowing(_):
            with terminal.progress() as told:
                try:
                    os.kill(os.getpid(), signal.SIGINT)
                    time.sleep(60.0)
                except KeyboardInterrupt:
                    pass
                if goes_on:
                    told("the next stage", 0.5)
                    raise AssertionError("it went on")
            raise AssertionError("it was done")

        before = signal.getsignal(signal.SIGINT)
        with monkeypatch.context() as patched:
            patched.setattr(commands, "soils", swallowing)
            done = call("soils")
        assert (done.status, done.err) == (130, "stopped: no file was written\n")
        assert signal.getsignal(signal.SIGINT) is before
        assert call("soils").status == 0  # the next command knows nothing of it
        with ThreadPoolExecutor(1) as other:  # in which Python can set no handler
            assert other.submit(call, "soils").result().status == 0


# --- what a command says beside its results, and that it is under way ---


def test_quiet_leaves_results_alone_and_the_error_stream_empty(tmp_path):
    options = ("simulate", SUBSOILER, "--set", "share.height=0.3 m", "--json", *BRIEF)
    loud = call(*options, "--plot", tmp_path / "new" / "a.pdf")
    silent = call(*options, "--plot", tmp_path / "b.png", "--quiet")
    assert "note: " in loud.err
    assert loud.err.endswith(f"wrote {tmp_path / 'new' / 'a.pdf'}\n")
    assert (tmp_path / "new" / "a.pdf").read_bytes().startswith(b"%PDF-")
    assert silent.err == ""
    assert json.loads(silent.out)["averages"] == json.loads(loud.out)["averages"]
    wrong = call("simulate", "-q", SUBSOILER, "--set", "share.hight=0.3 m")
    assert wrong.status == 2
    assert "share.hight" in wrong.err


# --- what each command imports before it begins: counted in modules, by a process of its own ---

NUMERICAL = {"casadi", "matplotlib", "numpy", "pint", "pydantic", "scipy"}
ROOMS = ("soil", "laws", "motion", "design", "studies", "problem_file")
SCRIPT = """
import contextlib, io, json, sys
sys.argv[0] = "plough-opt"
from plough_opt.__main__ import main
with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
    main()
print(json.dumps([out.getvalue(), sorted(sys.modules)]))
"""


def started(*arguments):
    """Return what a command prints, and the modules that it imported."""
    line = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    done = subprocess.run(line, capture_output=True, text=True, check=True, timeout=60)
    out, modules = json.loads(done.stdout)
    return out, set(modules)


HELP = [
    (["--help"], "\n    calibrate "),
    (["--version"], f"plough-opt {po.__version__}\n"),
    (["sweep", "--help"], "--scheduler"),
    (["export", "--help"], "FMU"),
]


@pytest.mark.parametrize(
    ("arguments", "shown"), HELP, ids=lambda value: "-".join(value) if isinstance(value, list) else ""
)
def test_help_imports_no_numerical_library_and_no_room(arguments, shown):
    out, modules = started(*arguments)
    assert shown in out
    assert not modules & NUMERICAL
    assert not [name for name in modules if name.startswith(tuple(f"plough_opt.{room}" for room in ROOMS))]


# Command, what it prints, and what it does not import: all units of the file are common ones, which need no registry.
STUDIES = {"plough_opt.studies.tradeoff", "plough_opt.studies.uncertainty", "plough_opt.app.plots"}
NOT_USED = [
    (["check", SUBSOILER], "3 requirements", {"matplotlib", "pint", "scipy", "plough_opt.design", *STUDIES}),
    (["simulate", SUBSOILER], "mean draft", {"matplotlib", "pint", "scipy", "plough_opt.design", *STUDIES}),
    (["optimise", SUBSOILER, "--search", "near", *BRIEF], "Best design", {"matplotlib", "pint"}),
    (["explore", SUBSOILER, *FIXED, "--json", "-o", "a.html"], "a.html", {"matplotlib", "pint"}),
]


@pytest.mark.parametrize(("arguments", "shown", "left_alone"), NOT_USED, ids=[line[0] for line, *_ in NOT_USED])
def test_a_command_imports_only_what_it_uses(tmp_path, monkeypatch, arguments, shown, left_alone):
    monkeypatch.chdir(tmp_path)
    out, modules = started(*arguments)
    assert shown in out
    assert not modules & left_alone


# --- bad input of every command: exit status 2, one sentence, nothing computed, nothing written ---

# Command line in a folder with the shipped problem files, and what the message contains.
REFUSED = tomllib.loads(Path(__file__).with_name("refused.toml").read_text(encoding="utf-8"))["refused"]
SHORT = {
    "FILE": "cotton_subsoiler.toml", "TRADE": "draft_against_loosening.toml",
    "CALIBRATE": "calibrate calibration.toml --data synthetic_draft.csv",
    "COHESION": "--over 'soil.cohesion=5..45 kPa:3'",
}  # fmt: skip


@pytest.mark.parametrize(("line", "expected"), REFUSED, ids=[line for line, _ in REFUSED])
def test_bad_input_is_refused_in_a_sentence_before_anything_is_computed(tmp_path, monkeypatch, line, expected):
    shutil.copytree(PROBLEMS, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.casadi").mkdir()
    (tmp_path / "link.csv").symlink_to("draft_against_loosening.toml")
    (tmp_path / "round.csv").symlink_to("round.csv")
    before = {path: path.read_bytes() for path in tmp_path.glob("*.*") if path.is_file()}
    for owner, name in ((po.Problem, "simulate"), (po.Design, "solve"), (Plan, "_answers")):
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
    ("explore FILE --output a.html", "jinja2", "report"),
    ("export FILE --to stl --output a.stl", "trimesh", "parts"),
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
