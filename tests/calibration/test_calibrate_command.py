"""`plough-opt calibrate`: tables, files, and messages about invalid input."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.scripts import imported

import plough_opt as po
from plough_opt.app import main

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
FILE, DATA = PROBLEMS / "calibration.toml", PROBLEMS / "synthetic_draft.csv"


@pytest.fixture
def cli(capsys):
    """Run the command line in this process."""

    def call(*arguments):
        status = main([str(argument) for argument in arguments])
        return SimpleNamespace(status=status, **capsys.readouterr()._asdict())

    return call


def test_tables_and_files(cli, tmp_path):
    picture, output = tmp_path / "residuals.png", tmp_path / "deep" / "fit.json"
    done = cli("calibrate", FILE, "--data", DATA, "--plot", picture, "--output", output)
    assert done.status == 0
    assert "24 rows of" in done.out
    for name in ("soil.cohesion", "soil.tool_friction", "effects.rate_term"):
        assert f"│ {name} " in done.out
    for words in (
        "95 % interval",
        "What to measure next",
        "are correlated: -0.9",
        "RMS error of rows left out of the fit",
    ):
        assert words in done.out.replace("\n", " ")
    assert "an ambient pressure of 101.3 kPa is taken as known" in done.out.replace("\n", " ")
    assert picture.stat().st_size > 10_000
    fit = po.Fit.load(output)
    truth = {"soil.cohesion": 26e3, "soil.tool_friction": 0.42, "effects.rate_term": 0.03}
    for name, interval in fit.intervals().items():
        assert truth[name] in interval
        assert fit.values[name] in interval


def test_json_is_what_python_gives(cli):
    done = cli("calibrate", FILE, "--data", DATA, "--json", "--loss", "huber")
    assert (done.status, done.err) == (0, "")
    found = {u["name"]: u["value"] for u in json.loads(done.out)["unknowns"]}
    fit = po.calibrate(po.read_problem(FILE), po.read_measurements(DATA), loss="huber")
    assert found == pytest.approx(fit.values, rel=1e-12)


def test_unknowns_of_the_command_line_and_one_measured_by_itself(cli):
    options = ("--unknown", "soil.cohesion=1..80 kPa", "--unknown", 'soil.ambient_pressure="1 kPa .. 0.15 MPa"')
    done = cli("calibrate", FILE, "--data", DATA, *options)
    assert done.status == 0
    assert done.out.count("not determined") == 2
    assert "cannot be told apart" in done.out.replace("\n", " ")
    done = cli("calibrate", FILE, "--data", DATA, *options, "--known", "soil.ambient_pressure=101.3 +- 2 kPa")
    assert done.status == 0
    assert "not determined" not in done.out
    assert "Not determined" not in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--data", "nowhere.csv"), "there is no file 'nowhere.csv'"),
        (("--data", DATA, "--unknown", "soil.cohesion"), "--unknown soil.cohesion: expected KEY=..."),
        (("--data", DATA, "--unknown", "soil.cohesion=5 kPa"), 'like soil.cohesion="1..80 kPa"'),
        (("--data", DATA, "--unknown", "soil.cohesian=1..2 kPa"), "did you mean 'soil.cohesion'"),
        (("--data", DATA, "--unknown", "soil.cohesion=1..80"), "lower bound of 'soil.cohesion' = \"1\" has no unit"),
        (("--data", DATA, "--known", "soil.cohesion=20 kPa"), "--known soil.cohesion=20 kPa: expected KEY=..."),
        (("--data", DATA, "--known", "soil.cohesion=20 +- 0 kPa"), "sigma = 0 must be above 0"),
        (("--data", DATA, "--known", "soil.cohesion=20 +- 1 m"), "'soil.cohesion' = \"20 m\" has the wrong unit"),
        (
            ("--data", DATA, "--known", "soil.density=1 +- 1 kg/m^3"),
            "unknowns: effects.rate_term, soil.cohesion,",
        ),
        (("--data", DATA, "--data", DATA.parent / "." / DATA.name), "is given twice, so its rows would count twice"),
        (("--data", DATA, *2 * ("--unknown", "soil.cohesion=1..80 kPa")), "'soil.cohesion' is given twice"),
        (("--data", DATA, "--level", "95"), "level = 95.0"),
        (("--data", DATA, "--folds", "1"), "folds = 1"),
        (("--data", DATA, "--plot", "a.txt"), "no known picture format"),
        (("--data", DATA, "--output", PROBLEMS), "is a folder"),
    ],
)
def test_wrong_input_is_refused_and_writes_nothing(cli, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    done = cli("calibrate", FILE, *arguments)
    assert (done.status, done.out) == (2, "")
    assert words in done.err.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []


def test_a_file_without_unknowns_is_refused_with_the_option_to_give_them(cli):
    done = cli("calibrate", PROBLEMS / "stick_slip.toml", "--data", DATA)
    assert (done.status, done.out) == (2, "")
    assert "nothing to estimate: add a table [variables], or --unknown soil.cohesion=" in done.err


def test_the_shipped_data_are_what_their_script_makes(tmp_path):
    (tmp_path / "calibration.toml").write_text(FILE.read_text(encoding="utf-8"), encoding="utf-8")
    with imported("synthetic_draft") as script:
        script.FOLDER = tmp_path
        script.main()
    made = (tmp_path / "synthetic_draft.csv").read_text(encoding="utf-8")
    assert made == DATA.read_text(encoding="utf-8")
    assert made.startswith("# SYNTHETIC: nothing here was measured. Made by: python problems/synthetic_draft.py")
