"""Studies on the command line: accuracy, sensitivities, sweeps and fronts, and the files that commands write."""

import csv
import io
import json
import re
import signal
import subprocess
import sys

import numpy as np
import pandas
import pytest
from helpers import swept
from helpers.commands import call, cells, printed
from helpers.problem_files import PROBLEMS, STATIC, SUBSOILER, changed

import plough_opt as po
from plough_opt.app.main import parser
from plough_opt.core.tables import write_frame
from plough_opt.studies.accuracy import AccuracyStudy

# --- `plough-opt accuracy`: tables, advice and files ---


def test_tables_advice_and_files(static, tmp_path):
    output = tmp_path / "deep" / "cost.json"
    moving = ("--set", "effects.motion=true", "--set", "scene.duration=0.1 s")
    uncertain = "uncertain.soil.cohesion={ distribution = 'normal', mean = '20 kPa', std = '1 kPa' }"
    options = ("--error", "1e-5", "--seconds", "0.05", "--output", output)
    done = call("accuracy", static, *options, *moving, "--set", uncertain)
    assert done.status == 0
    assert "Error against time (of the reference: " in done.out
    (advice,) = (line for line in done.out.splitlines() if line.startswith("for 1e-05 take "))
    assert "the default" in advice
    assert "note: the study uses the nominal soil" in done.out
    assert "casadi " in done.out.splitlines()[-1]
    assert f"wrote {output}" in done.err.replace("\n", "")
    study = AccuracyStudy.load(output)
    assert (study.wanted, study.duration) == (1e-5, pytest.approx(0.1))
    assert advice in json.loads(output.read_text(encoding="utf-8"))["advice"]


def test_a_design_instead_of_a_scene(static, tmp_path):
    output = tmp_path / "cost.json"
    out = printed("accuracy", static, "--design", "--seconds", "0.3", "--output", output)
    for words in ("Effort against chance", "designs tried", "search, auto (default)"):
        assert words in out
    study = AccuracyStudy.load(output)
    assert (study.duration, study.title) == (None, "Quasi-static")
    # One basin: every search finds its best.
    assert {entry.right for entry in study.entries} == {1.0}
    assert study.entries[0].setting == "near"
    assert all(entry.error < 1e-9 for entry in study.entries)


# --- `plough-opt optimise --sensitivity`: elasticities of every quantity of the file and of the limits that decide ---

# One quantity in a customary unit, one requirement that decides and one that does not.
FREE = '"share.wedge_angle" = { lower = "5 deg", upper = "60 deg", guess = "25 deg" }'
LIMITS = 'half_angle = { at_most = "15 deg" }\nmean_deflection = { at_most = "1 m" }\n'
TEXT = changed(
    ('wedge_angle = "35 deg"\n', ""), ("[variables]", f"[variables]\n{FREE}"),
    ('name = "serozem"', 'name = "serozem"\ncohesion = "20 kPa"'), ("0.12 m", "0.15 m"), text=STATIC + LIMITS,
)  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("problems") / "static.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def saved(file):
    """Return the optimum with its sensitivities, read back from JSON."""
    path = file.with_name("best.json")
    path.write_text(printed("optimise", file, "--sensitivity", "--json"), encoding="utf-8")
    return po.load(path)


def test_the_table_has_every_quantity_that_matters_in_order_of_size(file, saved):
    done = call("optimise", file, "--sensitivity")
    assert (done.status, done.err) == (0, "")
    names = [item.name for item in saved.sensitivities]
    sizes = [abs(item.elasticity) for item in saved.sensitivities]
    assert sizes == sorted(sizes, reverse=True)
    # No mass moves, no spring deflects to its limit, and the plastic gas has no Young's modulus.
    soil = "density density_ratio cohesion friction_angle tool_friction ambient_pressure strength_factor"
    others = {"share.chisel_angle", "scene.tow_speed", "scene.stiffness"}
    limits = {"loosened_radius at_least", "half_angle at_most"}
    assert {*names} == {f"soil.{name}" for name in soil.split()} | others | limits
    places = [done.out.index(f"│ {name} ") for name in names]
    assert places == sorted(places)
    assert cells(done.out, "scene.tow_speed")[0] == "7.2 km/h"
    for item in saved.sensitivities:
        shown = f"{item.elasticity:+.3g}" if abs(item.elasticity) > 1e-9 else "0"
        assert cells(done.out, item.name)[1] == shown
    (radius,) = [item for item in saved.sensitivities if item.name == "loosened_radius at_least"]
    # The front's radius is proportional to the height, the draft to its square; the angle keeps it.
    assert cells(done.out, radius.name)[1:4] == [f"{radius.elasticity:+.3g}", "0", "+1"]
    # No percentage is one of a variable whose best value is 0.
    free = "variables.effects.rate_term={ lower = '0 s^2/m^2', upper = '1 s^2/m^2' }"
    out = printed("optimise", file, "--sensitivity", "--set", free)
    assert ("value 0" in out, " 0 s^2/m^2 │" in out) == (True, True)


# --- `plough-opt sweep`: tables, resumption, Ctrl-C and failures ---

SWEPT = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=40")
OVER = ("--over", 'soil.cohesion="5..45 kPa:3"', "--over", "scene.tow_speed=1 m/s, 3 m/s")


def test_a_sweep_is_reported_written_and_resumed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ("sweep", SUBSOILER, *SWEPT, *OVER, "--workers", "1")
    done = call(*command, "--csv", "deep/table.csv", "--plot", "deep/picture.svg")
    assert done.status == 0, done.err
    assert "Subsoiler for cotton on serozem\n6 points, 0 failed" in done.out
    assert re.search(r"│ mean_draft +│ +[0-9.]+ kN │ cohesion 5 kPa +│ +[0-9.]+ kN │ cohesion 45 kPa", done.out)
    assert "Each point is simulated by po.simulate; stored in deep/table.csv" in done.out
    assert "Note: at 6 of 6 points: ambient pressure (101.3 kPa) carries" in done.out
    assert "wrote deep/table.csv" in done.err
    assert "</svg>" in (tmp_path / "deep" / "picture.svg").read_text()
    table = (tmp_path / "deep" / "table.csv").read_bytes()
    rows = list(csv.reader(table.decode().splitlines()))
    assert rows[0][:5] == ["point", "soil.cohesion [Pa]", "scene.tow_speed [m/s]", "question", "mean_draft [N]"]
    run = po.read_problem(SUBSOILER, SWEPT[1::2]).simulate({"soil.cohesion": 25e3, "scene.tow_speed": 3.0})
    assert float(rows[4][4]) == run.mean_draft

    # Nothing is computed any more, and so no process begins.
    monkeypatch.setattr("plough_opt.studies.sweep.engine.ProcessPoolExecutor", None)
    assert call(*command, "--csv", "deep/table.csv").status == 0
    assert (tmp_path / "deep" / "table.csv").read_bytes() == table


def test_without_a_file_the_same_sweep_goes_on_in_one_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ("sweep", SUBSOILER, *SWEPT, "--over", "soil.cohesion=5, 9 kPa", "--workers", "1")
    for words, files in (((), 1), ((), 1), (("--set", "scene.frame_mass=25 kg"), 2)):
        assert call(*command, *words).status == 0
        assert len(list(tmp_path.glob("cotton_subsoiler-*.sweep.csv"))) == files


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_leaves_a_file_that_goes_on(tmp_path):
    file = str(tmp_path / "stick.toml")
    call("init", file)
    table = tmp_path / "table.csv"
    over = ("--over", "soil.cohesion=5..45 kPa:100", "--over", "scene.tow_speed=1..3 m/s:100", "--method", "each")
    command = ("sweep", file, *over, "--workers", "1", "--csv", str(table))
    process = subprocess.Popen([sys.executable, "-m", "plough_opt", *command], stderr=subprocess.PIPE, text=True)
    try:
        swept.until(lambda: swept.rows_of(table), process)
        process.send_signal(signal.SIGINT)
        error = process.communicate(timeout=60)[1]
    finally:
        process.kill()
    kept = len(swept.rows_of(table))
    assert 0 < kept < 10_000
    assert process.returncode == 130
    # Before it, where the machine is slow, how far it was after every ten seconds.
    expected = f"stopped: {kept} of 10000 points are in '{table}': the same sweep goes on there"
    assert error.splitlines()[-1] == expected
    # Another question is refused; the same one goes on (that it repeats nothing is tested elsewhere).
    before = table.read_bytes()
    assert before.endswith(b"\n")
    other = call(*command, "--set", "scene.frame_mass=25 kg")
    assert (other.status, "belongs to another sweep, of another problem" in other.said) == (2, True)
    assert table.read_bytes() == before


# --- `plough-opt tradeoff`, and the [trade_off] table of a problem file ---

LOOSENING = PROBLEMS / "draft_against_loosening.toml"
FIVE = ("--set", "scene.duration=0.1 s", "--points", "5")


def test_the_table_of_a_front(tmp_path):
    done = call("tradeoff", LOOSENING, *FIVE, "--output", tmp_path / "front.json")
    assert done.status == 0
    assert "Front of 5 designs" in done.out
    assert "Limits that decide every design: half angle." in done.out
    # A warning that holds for every design is given once, whatever its figures.
    assert done.out.count("Note: ") == 1, done.out
    assert "Note: at 5 of 5 designs: ambient pressure (101.3 kPa) carries 73 % of the static draft" in done.out
    assert "1 % costs: of loosened radius for 1 % less mean draft" in done.out
    front = po.TradeOff.load(tmp_path / "front.json")
    assert front.title == "Draft against loosened radius on serozem"
    # The last position is that of an anchor on a bound, where no other design lies.
    assert front.failures == ()
    assert front.objectives[0, 1] == pytest.approx(0.08, rel=1e-6)


def test_json():
    front = json.loads(printed("tradeoff", LOOSENING, *FIVE, "--json", "--set", "effects.strength_wave.amplitude=0"))
    assert front["kind"] == "trade-off"
    assert [goal["maximise"] for goal in front["goals"]] == [False, True]
    # Without waves the draft is steady and proportional to the height squared, the radius to the height. So 1 % less
    # draft costs half a per cent of the radius.
    for point in front["points"][1:-1]:
        assert point["rate"] * point["objectives"][0] / point["objectives"][1] == pytest.approx(0.5, rel=1e-6)


# --- what every command with a result writes: JSON, tables, pictures, and the conflicts of a problem ---

TRADE = (
    STATIC.partition("[minimise]")[0]
    + "[trade_off]\nmean_draft = {}\nloosened_radius = { maximise = true }\npoints = 5\n"
)
MOVING = ("--set", "effects.motion=true", "--set", "scene.duration=0.1 s", "--seconds", "0.05")
DRAFTS = ("--data", PROBLEMS / "synthetic_draft.csv")


def lines(static, folder):
    """Return each command with a result: its name -> its arguments."""
    saved, other, front = (folder / name for name in ("a.json", "b.json", "front.toml"))
    printed("simulate", static, "-o", saved)
    printed("simulate", static, "--set", "scene.tow_speed=9 km/h", "-o", other)
    front.write_text(TRADE, encoding="utf-8")
    return {
        "show": ["show", saved],
        "show several": ["show", saved, other],
        "simulate": ["simulate", static],
        "optimise": ["optimise", static],
        "tradeoff": ["tradeoff", front],
        "sweep": ["sweep", static, "--over", "scene.tow_speed=1..2 m/s:2"],
        "accuracy": ["accuracy", static, *MOVING],
        "calibrate": ["calibrate", PROBLEMS / "calibration.toml", *DRAFTS],
        "check": ["check", static],
        "check --effects": ["check", static, "--effects"],
        "soils": ["soils"],
    }


# Options of every command with a result, and what others have: these write their own files, or print JSON or a text.
ALL = {"--json", "--csv", "--output", "--plot"}
OTHERS = {
    "soils": ALL - {"--plot"}, "init": {"--json"}, "export": {"--json", "--output"}, "explore": {"--json", "--output"},
}  # fmt: skip


def test_every_command_with_a_result_has_the_same_options():
    for name, command in parser()._subparsers._group_actions[0].choices.items():
        flags = {flag for action in command._actions for flag in action.option_strings}
        assert flags & ALL == OTHERS.get(name, ALL), name
        assert ("-o" in flags) == ("--output" in flags), name


def test_every_command_writes_the_files(static, tmp_path):
    for name, line in lines(static, tmp_path).items():
        table, saved, picture = (tmp_path / f"{name}.{ending}" for ending in ("csv", "json", "svg"))
        drawn = () if name == "soils" else ("--plot", picture)
        done = call(*line, "--json", "--csv", table, "-o", saved, *drawn)
        assert done.status == 0, done.err
        assert json.loads(done.out) == json.loads(saved.read_text(encoding="utf-8")) or name == "accuracy", name
        assert not drawn or picture.read_text(encoding="utf-8").startswith("<?xml"), name
        heading, *rows = csv.reader(io.StringIO(table.read_text(encoding="utf-8")))
        assert rows, name
        assert {len(row) for row in rows} <= {len(heading)}, name


def test_workbooks_hold_numbers_as_numbers_and_no_formulas(static, tmp_path, monkeypatch):
    """pandas reads them by openpyxl, and tables of text beside them."""
    run = po.read_problem(static).simulate()
    for path, read in ((tmp_path / "a.csv", pandas.read_csv), (tmp_path / "a.xlsx", pandas.read_excel)):
        printed("simulate", static, "--csv", path)
        found = read(path)
        assert [*found.columns[:4]] == ["time [s]", "travel [m]", "speed [m/s]", "deflection [m]"]
        # The oldest pandas reads numbers right to one unit in the last place.
        assert found["deflection [m]"].tolist() == pytest.approx(run.deflection.tolist(), rel=3e-16)
    frame = pandas.DataFrame({"x": [1.5, np.nan], "on": [True, False], "n": [1, 2], "text": ["=1+1", "a"]})
    found = pandas.read_excel(write_frame(path, frame))
    assert found.fillna(-1.0).to_numpy().tolist() == [[1.5, True, 1, "'=1+1"], [-1.0, False, 2, "a"]]
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert "pip install 'openpyxl'" in call("simulate", static, "--csv", path).said


def test_an_infeasible_problem_gives_its_conflicts(static, tmp_path):
    line = ("optimise", static, "--set", "require.loosened_radius.at_least=5 m", "--json", "-o", tmp_path / "a.json")
    done = call(*line)
    assert done.status == 1
    found = json.loads(done.out)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == found
    with pytest.raises(po.InfeasibleDesign) as error:
        po.read_problem(static, ["require.loosened_radius.at_least=5 m"]).optimise()
    assert found["conflicts"] == pytest.approx(error.value.conflicts)
    assert found["blockers"] == error.value.blockers
    assert found["message"] in done.said
    for words in ("no solution: ", "'loosened_radius' (at least 5 m) fails by", "height = 0.5 m"):
        assert words in done.said
    assert f"wrote {tmp_path / 'a.json'}" in done.err.splitlines()
