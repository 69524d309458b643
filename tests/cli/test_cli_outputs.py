"""Files that every command with a result writes: JSON, tables, pictures, and the conflicts of an infeasible problem."""

import csv
import io
import json
from types import SimpleNamespace

import numpy as np
import pandas
import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import PROBLEMS, STATIC

import plough_opt as po
from plough_opt.app.options import parser
from plough_opt.core import tables
from plough_opt.core.tables import read_rows, write_frame

TRADE = (
    STATIC.partition("[minimise]")[0]
    + "[trade_off]\nmean_draft = {}\nloosened_radius = { maximise = true }\npoints = 5\n"
)
MOVING = ("--set", "effects.motion=true", "--set", "scene.duration=0.1 s", "--seconds", "0.05")
RESULTS = ("waves", "show", "compare", "simulate", "optimise", "tradeoff", "sweep", "calibrate", "accuracy")


@pytest.fixture
def static(tmp_path):
    path = tmp_path / "static.toml"
    path.write_text(STATIC, encoding="utf-8")
    return path


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
    }


def test_every_command_with_a_result_has_the_same_options():
    every = parser(whole=True)._subparsers._group_actions[0].choices
    for name in RESULTS:
        flags = {flag for action in every[name]._actions for flag in action.option_strings}
        assert {"--json", "--csv", "-o", "--output", "--plot"} <= flags, name
    for name in ("report", "export"):
        assert "-o" in {flag for action in every[name]._actions for flag in action.option_strings}


def test_every_command_writes_the_files(static, tmp_path):
    for name, line in lines(static, tmp_path).items():
        table, saved, picture = (tmp_path / f"{name}.{ending}" for ending in ("csv", "json", "svg"))
        done = call(*line, "--json", "--csv", table, "-o", saved, "--plot", picture)
        assert done.status == 0, done.err
        assert json.loads(done.out) == json.loads(saved.read_text(encoding="utf-8")) or name == "accuracy", name
        assert picture.read_text(encoding="utf-8").startswith("<?xml"), name
        heading, *rows = csv.reader(io.StringIO(table.read_text(encoding="utf-8")))
        assert rows or name == "waves", name
        assert {len(row) for row in rows} <= {len(heading)}, name


def test_a_table_has_the_numbers_of_the_result_with_their_units(static, tmp_path):
    printed("simulate", static, "--csv", tmp_path / "a.csv")
    run = po.read_problem(static).simulate()
    (_, heading), *rows = read_rows(tmp_path / "a.csv", "results")
    assert heading[:4] == ["time [s]", "travel [m]", "speed [m/s]", "deflection [m]"]
    assert [float(row[3]) for _, row in rows] == run.deflection.tolist()


def test_workbooks_are_written_where_openpyxl_is_installed(static, tmp_path, monkeypatch):
    done = call("simulate", static, "--csv", tmp_path / "a.xlsx")
    assert done.status == 0 or (done.status == 2 and "pip install 'openpyxl'" in done.said)
    rows = []
    book = SimpleNamespace(active=rows, save=lambda file: file.write(b"saved"))
    monkeypatch.setattr(tables, "optional", lambda _: SimpleNamespace(Workbook=lambda: book))
    frame = pandas.DataFrame({"x": [1.5, np.nan], "text": ["=1+1", "a"]})
    frame.attrs["units"] = {"x": "m"}
    assert write_frame(tmp_path / "b.xlsx", frame).read_bytes() == b"saved"
    assert rows == [["x [m]", "text"], [1.5, "'=1+1"], [None, "a"]]


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
