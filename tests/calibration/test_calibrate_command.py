"""`plough-opt calibrate`: tables, files, and messages about invalid input."""

import json

import pytest
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported

import plough_opt as po

FILE, DATA = PROBLEMS / "calibration.toml", PROBLEMS / "synthetic_draft.csv"


def test_tables_and_files(tmp_path):
    picture, output = tmp_path / "residuals.png", tmp_path / "deep" / "fit.json"
    out = printed("calibrate", FILE, "--data", DATA, "--plot", picture, "--output", output)
    for words in (
        "24 rows of", "│ soil.cohesion ", "│ soil.tool_friction ", "│ effects.rate_term ", "95 % interval",
        "What to measure next", "are correlated: -0.9", "RMS error of rows left out of the fit",
        "an ambient pressure of 101.3 kPa is taken as known",
    ):  # fmt: skip
        assert words in out.replace("\n", " ")
    assert picture.stat().st_size > 10_000
    truth = {"soil.cohesion": 26e3, "soil.tool_friction": 0.42, "effects.rate_term": 0.03}
    assert all(truth[name] in interval for name, interval in po.Fit.load(output).intervals().items())


def test_json_is_what_python_gives():
    done = call("calibrate", FILE, "--data", DATA, "--json", "--loss", "huber")
    assert (done.status, done.err) == (0, "")
    found = {u["name"]: u["value"] for u in json.loads(done.out)["unknowns"]}
    fit = po.calibrate(po.read_problem(FILE), po.read_measurements(DATA), loss="huber")
    assert found == pytest.approx(fit.values, rel=1e-12)


def test_unknowns_of_the_command_line_and_one_measured_by_itself(tmp_path):
    options = ("--unknown", "soil.cohesion=1..80 kPa", "--unknown", 'soil.ambient_pressure="1 kPa .. 0.15 MPa"')
    out = printed("calibrate", FILE, "--data", DATA, *options)
    assert out.count("not determined") == 2
    assert "cannot be told apart" in out.replace("\n", " ")
    out = printed("calibrate", FILE, "--data", DATA, *options, "--known", "soil.ambient_pressure=101.3 +- 2 kPa")
    assert "not determined" not in out.lower()
    few, lines = tmp_path / "few.csv", DATA.read_text(encoding="utf-8").splitlines(keepends=True)
    for count, unknown, why in (
        (7, (), "3 folds leave fewer rows than unknowns"),
        (5, options[:2], "cross-validation needs two"),
    ):
        few.write_text("".join(lines[:count]), encoding="utf-8")
        assert f"No cross-validation: {why}" in printed("calibrate", FILE, "--data", few, *unknown)
    few.write_text("scene.tow_speed [km/h], mean_draft [kN]\n3, 1.8\n", encoding="utf-8")
    done = call("calibrate", FILE, "--data", few, *options, "--known", "soil.ambient_pressure=101.3 +- 2 kPa")
    assert (done.status, "few.csv: no sigma is stated, but other sets state theirs" in done.said) == (2, True)


REFUSED = [
    (("--data", DATA, "--unknown", "soil.cohesion"), "--unknown soil.cohesion: expected KEY=..."),
    (("--data", DATA, "--unknown", "soil.cohesion=5 kPa"), 'like soil.cohesion="1..80 kPa"'),
    (("--data", DATA, "--unknown", "soil.cohesoin=1..80 kPa"), "cannot be an unknown: did you mean 'soil.cohesion"),
    (("--data", DATA, "--folds", "1"), "folds = 1 must be a whole number from 2 to 24"),
    (("--data", DATA, "--unknown", "soil.cohesion=1..80"), "lower bound of 'soil.cohesion' = \"1\" has no unit"),
    (("--data", DATA, "--known", "soil.cohesion=20 kPa"), "--known soil.cohesion=20 kPa: expected KEY=..."),
    (("--data", DATA, "--known", "soil.cohesion=20 +- 0 kPa"), "sigma = 0 must be above 0"),
    (("--data", DATA, "--known", "soil.cohesion=20 +- 1 m"), "'soil.cohesion' = \"20 m\" has the wrong unit"),
    (("--data", DATA, "--known", "soil.density=1 +- 1 kg/m^3"), "unknowns: effects.rate_term, soil.cohesion,"),
    (("--data", DATA, "--data", DATA.parent / "." / DATA.name), "is given twice, so its rows would count twice"),
    (("--data", DATA, *2 * ("--unknown", "soil.cohesion=1..80 kPa")), "'soil.cohesion' is given twice"),
    (("--data", DATA, "--output", PROBLEMS), "is a folder"),
    (("--data", DATA, "--set", "variables={}"), "add a table [variables], or --unknown soil.cohesion="),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED)
def test_wrong_input_is_refused_and_writes_nothing(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    done = call("calibrate", FILE, *arguments)
    assert (done.status, done.out) == (2, "")
    assert words in done.said
    assert list(tmp_path.iterdir()) == []


def test_the_shipped_data_are_what_their_script_makes(tmp_path):
    (tmp_path / "calibration.toml").write_text(FILE.read_text(encoding="utf-8"), encoding="utf-8")
    with imported("synthetic_draft") as script:
        script.FOLDER = tmp_path
        script.main()
    made = (tmp_path / "synthetic_draft.csv").read_text(encoding="utf-8")
    assert made == DATA.read_text(encoding="utf-8")
    assert made.startswith("# SYNTHETIC: nothing here was measured. Made by: python problems/synthetic_draft.py")
