"""`calibrate` and its command: three kinds of models, tables, files, pictures, and messages about invalid input."""

import dataclasses
import json
import math

import numpy as np
import pytest
from helpers.commands import call, printed
from helpers.known_soil import BOUNDS, steady_scene
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported
from helpers.strict_json import strict

import plough_opt as po
from plough_opt.studies.calibration import least_squares


def test_scene_problem_and_function_give_the_same(measured, three, fitted):
    def scene_of(values):
        soil = {name: values[f"soil.{name}"] for name in ("cohesion", "tool_friction")}
        return steady_scene(values["scene.tow_speed"], values["share.wedge_angle"], **soil)

    two = {name: three[name] for name in ("soil.cohesion", "soil.tool_friction")}
    from_function, from_scene = (po.calibrate(given, measured, two).values for given in (scene_of, steady_scene()))
    assert from_function == pytest.approx(from_scene, rel=1e-7)
    given = ["soil.ambient_pressure=60 kPa", "variables.soil.cohesion.guess=40 kPa"]
    problem = po.read_problem(PROBLEMS / "calibration.toml", given)
    from_file = po.calibrate(problem, measured)
    for name, value in from_file.values.items():
        # Bounds and guesses differ, the optimum does not: the search stops within 1e-4 of a standard error.
        assert abs(value - fitted.values[name]) < 1e-3 * fitted.standard_errors[name]
    with pytest.raises(po.InputError, match=r"a problem file has no 'scene\.mass': did you mean 'scene\.frame_mass'"):
        po.calibrate(problem, measured, {"scene.mass": (1.0, 100.0)})


REFUSED_UNKNOWNS = [
    ({"soil.cohesian": (1e3, 2e3)}, {}, "'soil.cohesian' cannot be an unknown: did you mean 'soil.cohesion'"),
    ({"soil.cohesion": (2e3, 1e3)}, {}, "the lower bound 2000 must be below the upper bound 1000"),
    ({"soil.cohesion": 5.0}, {}, "must be (lower, upper) or (lower, upper, guess)"),
    ({"soil.cohesion": (1e3, 2e3, 3e3)}, {}, "the guess 3000 must lie between"),
    ({"soil.cohesion": (1e3, float("inf"))}, {}, "upper bound of 'soil.cohesion' = inf Pa must be finite"),
    ({"scene.tow_speed": (1.0, 2.0)}, {}, "plane: 'scene.tow_speed' is a column of the data"),
    ({"soil.friction_angle": (0.1, 2.0)}, {}, "upper bound of 'soil.friction_angle': friction angle = 2 rad"),
    ({"scene.frame_mass": (1.0, 2.0)}, {}, "a scene has no quantity 'scene.frame_mass': did you mean 'scene.mass'"),
    ({"effects.strength_wave.amplitude": (0.0, 0.5)}, {}, "the scene has no 'effects.strength_wave.amplitude'"),
    ({}, {}, "no unknowns"),
    ({"soil.cohesion": (1e3, 80e3)}, {"loss": "huberr"}, "no loss is named 'huberr': did you mean 'huber'?"),
    ({"soil.cohesion": (1e3, 80e3)}, {"starts": 0}, "starts = 0 must be a whole number from 1 to 16"),
]


@pytest.mark.parametrize(("unknown", "keywords", "words"), REFUSED_UNKNOWNS)
def test_invalid_unknowns_and_options_are_refused(measured, unknown, keywords, words):
    with pytest.raises((po.InputError, po.DomainError)) as refusal:
        po.calibrate(steady_scene(), measured, unknown, **keywords)
    assert words in str(refusal.value)


SPEEDS = {"scene.tow_speed": [1.0, 2.0]}
FEW = po.Measurements("mean_draft", [1e3, 2e3], SPEEDS, name="few")
STATED = po.Measurements("mean_draft", [1e3, 2e3], SPEEDS, sigma=10.0)
ANGLES = po.Measurements("mean_draft", [1e3] * 3, {"share.wedge_angle": [0.5, 2.0, 0.6]}, name="beyond")
CONE = po.Scene(steady_scene().soil, po.Cone(0.3, 0.25), 5e4, 25.0, 2.0, po.Effects(motion=False))


REFUSED_DATA = [
    (steady_scene(), FEW, r"few: 2 rows are too few for 2 unknowns .* at least 3 are needed"),
    (steady_scene(), [STATED, FEW], "few: no sigma is stated"),
    (steady_scene(), ANGLES, "beyond, row 2: wedge angle = 2 rad must be below"),
    (steady_scene(), po.Measurements("soil.density_ratio", [0.8] * 3), "'soil.density_ratio' was measured"),
    (steady_scene(), po.Measurements("mean_draft", [0.0] * 3, name="zeros"), "zeros: every measured value is 0"),
    (steady_scene(), [[1.0, 2.0]], "the data must be Measurements"),
    (3.0, FEW, "must be a Problem, a Scene, or a function"),
    (len, FEW, "the function of values returned 3: it must return a Scene"),
    (steady_scene(po.Design().variable("v", guess=2.0, lower=1.0, upper=3.0)), FEW, "the scene holds symbols"),
    (CONE, ANGLES, "the scene has no 'share.wedge_angle'"),
]


@pytest.mark.parametrize(("scene", "data", "words"), REFUSED_DATA)
def test_data_that_do_not_fit_are_refused(scene, data, words):
    with pytest.raises(po.InputError, match=words):
        po.calibrate(scene, data, {"soil.cohesion": (1e3, 80e3), "soil.tool_friction": (0.1, 1.0)})


def test_a_calibration_fits_other_observed_values(measured, three, fitted):
    calibration = po.Calibration(steady_scene(), measured, three)
    assert calibration.fit(measured.values).values == fitted.values
    for wrong in ([1.0, 2.0], [np.nan] * 24):
        with pytest.raises(po.InputError, match="observed must be 24 finite numbers"):
            calibration.fit(wrong)


def test_invalid_levels_kinds_folds_and_candidates_are_refused(fitted):
    with pytest.raises(po.InputError, match="level = 95 must lie between 0 and 1"):
        fitted.intervals(95)
    with pytest.raises(po.InputError, match="must be 'profile' or 'linearised'"):
        fitted.intervals(kind="bootstrap")
    with pytest.raises(po.InputError, match="folds = 1 must be a whole number from 2 to 24"):
        fitted.cross_validation(1)
    with pytest.raises(po.InputError, match="none of the candidates"):
        fitted.next_measurements([po.Candidate("mount_force"), po.Candidate("soil.density")])


def test_a_fit_that_does_not_converge_is_refused(measured, three, fitted, monkeypatch):
    monkeypatch.setitem(least_squares._TOLERANCES, "max_nfev", 1)
    with pytest.raises(po.NotConverged, match="did not converge from any of 4 starts") as failure:
        po.calibrate(steady_scene(), measured, three)
    assert failure.value.status
    # A profile that does not converge gives way to the linearised interval.
    assert dataclasses.replace(fitted).intervals(0.9) == fitted.intervals(0.9, "linearised")


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


def test_a_loaded_fit_knows_what_was_computed_and_cannot_compute_further(fitted, tmp_path):
    fitted.intervals(0.9)
    again = po.Fit.load(fitted.save(tmp_path / "fit.json"))
    for level, kind in ((0.9, "profile"), (0.95, "profile"), (0.95, "linearised")):
        assert again.intervals(level, kind) == fitted.intervals(level, kind)
    assert again.next_measurements() == fitted.next_measurements()
    assert again.correlations == fitted.correlations
    with pytest.raises(po.InputError, match=r"profile intervals of level 0\.8"):
        again.intervals(0.8)
    for ask in (again.cross_validation, lambda: again.scene, lambda: again.next_measurements([])):
        with pytest.raises(po.InputError, match="this fit comes from a file"):
            ask()


def test_infinite_intervals_are_valid_json(measured, tmp_path):
    names = ("soil.cohesion", "soil.ambient_pressure")
    fit = po.calibrate(steady_scene(), measured, {name: BOUNDS[name] for name in names})
    assert "measure next" not in str(fit)  # not computed yet
    strict(fit.to_json())
    again = po.Fit.load(fit.save(tmp_path / "open.json"))
    assert again.standard_errors["soil.cohesion"] == math.inf
    assert tuple(again.intervals()["soil.cohesion"]) == (-math.inf, math.inf)
    assert again.unidentifiable == fit.unidentifiable


def test_pictures(fitted):
    first, *panels = fitted.plot().axes
    assert (first.get_xlabel(), panels[1].get_xlabel()) == ("predicted mean draft [kN]", "tow speed [km/h]")
    # Every row is a point in every panel.
    assert [len(axes.lines[0].get_xdata()) for axes in panels] == [len(fitted.rows)] * 3


def test_a_picture_of_several_results(measured, three):
    radius = po.Measurements("loosened_radius", [0.2, 0.21], sigma=0.01, name="radius")
    first = po.calibrate(steady_scene(), [measured, radius], three).plot().axes[0]
    assert (first.get_xlabel(), len(first.containers)) == ("predicted, over the largest of its kind", 2)
