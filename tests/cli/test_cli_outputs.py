"""Files that every command with a result writes: JSON, tables, pictures, and the conflicts of an infeasible problem."""

import csv
import io
import json
import sys

import numpy as np
import pandas
import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import PROBLEMS, STATIC

import plough_opt as po
from plough_opt.app.main import parser
from plough_opt.core.tables import read_rows, write_frame

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
        "waves": ["waves", PROBLEMS / "transect.csv"],
        "show": ["show", saved],
        "compare": ["compare", saved, other],
        "simulate": ["simulate", static],
        "optimise": ["optimise", static],
        "tradeoff": ["tradeoff", front],
        "sweep": ["sweep", static, "--over", "scene.tow_speed=1..2 m/s:2", "--store", folder / "s.db"],
        "accuracy": ["accuracy", static, "--thin", *MOVING],
        "calibrate": ["calibrate", PROBLEMS / "calibration.toml", *DRAFTS],
        "check": ["check", static],
        "check --effects": ["check", static, "--effects"],
        "check --against": ["check", static, "--against"],
        "soils": ["soils"],
    }


# Options of every command with a result, and what others have: these write their own files, or print JSON or a text.
ALL = {"--json", "--csv", "--output", "--plot"}
OTHERS = {
    "soils": ALL - {"--plot"}, "init": {"--json"}, "schema": set(), "completion": set(),
    "export": {"--json", "--output"}, "report": {"--json", "--output"}, "explore": {"--json", "--output"},
}  # fmt: skip


def test_every_command_with_a_result_has_the_same_options():
    for name, command in parser(whole=True)._subparsers._group_actions[0].choices.items():
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
        assert rows or name == "waves", name
        assert {len(row) for row in rows} <= {len(heading)}, name


def test_a_table_has_the_numbers_of_the_result_with_their_units(static, tmp_path):
    printed("simulate", static, "--csv", tmp_path / "a.csv")
    run = po.read_problem(static).simulate()
    (_, heading), *rows = read_rows(tmp_path / "a.csv", "results")
    assert heading[:4] == ["time [s]", "travel [m]", "speed [m/s]", "deflection [m]"]
    assert [float(row[3]) for _, row in rows] == run.deflection.tolist()


def test_workbooks_hold_numbers_as_numbers_and_no_formulas(static, tmp_path, monkeypatch):
    """pandas reads them by openpyxl."""
    run, path = po.read_problem(static).simulate(), tmp_path / "a.xlsx"
    printed("simulate", static, "--csv", path)
    found = pandas.read_excel(path)
    assert [*found.columns[:4]] == ["time [s]", "travel [m]", "speed [m/s]", "deflection [m]"]
    assert found["deflection [m]"].tolist() == run.deflection.tolist()
    frame = pandas.DataFrame({"x": [1.5, np.nan], "on": [True, False], "n": [1, 2], "text": ["=1+1", "a"]})
    frame.attrs["units"] = {"x": "m"}
    found = pandas.read_excel(write_frame(path, frame))
    assert found.columns.tolist() == ["x [m]", "on", "n", "text"]
    assert found.fillna(-1.0).to_numpy().tolist() == [[1.5, True, 1, "'=1+1"], [-1.0, False, 2, "a"]]
    for name in ("tradeoff", "sweep", "check"):
        printed(*lines(static, tmp_path)[name], "--csv", path)
        assert len(pandas.read_excel(path)) > 1, name
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
    assert f"wrote {tmp_path / 'a.json'}" in done.err.splitlines()


def test_compare_has_one_unit_a_row_and_differences(static, tmp_path):
    paths = [tmp_path / f"{k}.json" for k in range(3)]
    for path, speed, height in zip(paths, ("7.2 km/h", "2.5 m/s", "3 m/s"), (0.2, 0.25, 0.3), strict=True):
        printed(
            "simulate", static, "-o", path, "--set", f"scene.tow_speed={speed}", "--set", f"share.height={height} m"
        )
    drafts = [po.load(path).mean_draft for path in paths]
    two = printed("compare", *paths[:2])
    assert cells(two, "mean draft")[-1] == f"{100.0 * (drafts[1] / drafts[0] - 1.0):+.3g} %"
    assert cells(two, "tow speed") == ["7.2 km/h", "9 km/h", "+25 %"]
    assert cells(two, "RMS of the mount force")[-1] == "0 %"
    assert cells(printed("compare", *paths[::-1]), "tow speed") == ["3 m/s", "2.5 m/s", "2 m/s", "+33.3 %"]


def test_no_command_prints_more_digits_than_the_model_deserves(static):
    for name in ("simulate", "optimise"):
        out = printed(name, static)
        for row in ("mean draft", "mean deflection", "tow power"):
            number = cells(out, row)[0].split()[0]
            assert len(number.replace(".", "").lstrip("0")) <= 4, (name, row, number)
    assert (
        cells(printed("optimise", static), "share.height")[0]
        == f"{po.read_problem(static).optimise()[0].variables['share.height']:.4g} m"
    )
