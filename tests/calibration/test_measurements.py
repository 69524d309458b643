"""Measurements from Python and from CSV files, messages about mistakes, and forces over time."""

import dataclasses
import math
from unittest.mock import Mock

import numpy as np
import pytest
from scipy import interpolate

import plough_opt as po
from plough_opt.studies.calibration.model import Model

HEADER = "scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]\n"
ROWS = "3.6, 40, 3.9, 0.1\n7.2, 40, 4.1, 0.1\n"


@pytest.fixture
def written(tmp_path):
    """Write a CSV file and return its path."""

    def write(text):
        path = tmp_path / "draft.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_columns_are_kept_in_si_with_their_lines(written):
    data = po.read_measurements(written(f"# field 3\n\n{HEADER}{ROWS}"))
    assert data.result == "mean_draft"
    np.testing.assert_allclose(data.values, [3900.0, 4100.0], rtol=1e-15)
    np.testing.assert_allclose(data.conditions["scene.tow_speed"], [1.0, 2.0], rtol=1e-15)
    np.testing.assert_allclose(data.conditions["share.wedge_angle"], math.radians(40.0), rtol=1e-15)
    np.testing.assert_allclose(data.sigma, 100.0, rtol=1e-15)
    assert data.lines == (4, 5)
    assert data.row(1).endswith("draft.csv, line 5")


def test_sigma_in_per_cent_semicolons_tabs_weights_and_time(written):
    data = po.read_measurements(written("scene.tow_speed [km/h]\tmean_draft [kN]\n3.6\t4.0\n"))
    assert (data.conditions["scene.tow_speed"].tolist(), data.values.tolist()) == ([1.0], [4000.0])
    data = po.read_measurements(written("mean_draft [kN]; sigma [%]\n4.0; 5\n2.0; 10\n"))
    np.testing.assert_allclose(data.sigma, 200.0, rtol=1e-15)
    data = po.read_measurements(written("\ufefftime [ms],mount_force [N],weight\n0,1,1\n5,2,0\n"))
    assert data.time.tolist() == [0.0, 0.005]
    assert data.weights.tolist() == [1.0, 0.0]
    data = po.read_measurements(written("soil.tool_friction, mean_draft [N]\n0.5, 1e3\n0.6, 2E3\n"))
    assert data.conditions["soil.tool_friction"].tolist() == [0.5, 0.6]


PLAIN = HEADER + ROWS
SAME = {
    "CRLF": PLAIN.replace("\n", "\r\n"),
    "byte order mark": f"\ufeff{PLAIN}",
    "separators at line ends": PLAIN.replace("\n", ",\n"),
    "semicolons at line ends": PLAIN.replace(",", ";").replace("\n", ";\r\n") + ";;;\r\n",
}


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_a_file_reads_the_same_however_a_spreadsheet_wrote_it(written, text):
    path = written("")
    path.write_bytes(text.encode())
    found, plain = po.read_measurements(path), po.read_measurements(written(PLAIN))
    for name in ("values", "sigma", "lines"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))
    assert {key: column.tolist() for key, column in found.conditions.items()} == {
        key: column.tolist() for key, column in plain.conditions.items()
    }


WRONG_FILES = [
    (HEADER.replace("tow_", "two_") + ROWS, "line 1, column 'scene.two_speed [km/h]': this column is unknown: did"),
    ("mean_draft [kN], force_rms [N]\n1, 2\n", "mean_draft and force_rms are measured: write one file for each"),
    (HEADER.replace(" [kN], sigma", ", sigma") + ROWS, "the unit is missing: write it like 'mean_draft [kN]'"),
    (HEADER.replace("[deg]", "[kg]") + ROWS, "'kg' is not a unit of rad: write it like 'share.wedge_angle [deg]'"),
    (HEADER + "3.6, 40, , 0.1\n" + ROWS, "line 2, column 'mean_draft [kN]': the cell is empty"),
    (HEADER + "3.6, 40, 3.9, 0.1, 7\n", "line 2: the row has 5 cells"),
    (HEADER + "3.6, 40, 1e308, 0.1\n", "'1e308' is not a finite number"),
    (HEADER + "3.6, 40, 4.0, -0.1\n", "line 2: sigma = -100 must be above 0"),
    ("mean_draft [kN]\tsigma [kN]\n4,1\t0,1\n", "'4,1' is not a number: write a decimal point"),
    ("", "the file is empty"),
]


@pytest.mark.parametrize(("text", "words"), WRONG_FILES)
def test_a_wrong_file_is_refused_with_its_row(written, text, words):
    path = written(text)
    with pytest.raises(po.InputError) as refusal:
        po.read_measurements(path)
    assert words in str(refusal.value)
    assert str(path) in str(refusal.value)


def test_every_mistake_is_listed(written):
    rows = "".join(f"3.6, 40, {'' if k % 2 else 'x'}, 0.1\n" for k in range(10))
    with pytest.raises(po.InputError) as refusal:
        po.read_measurements(written(HEADER + rows))
    *lines, last = str(refusal.value).splitlines()
    assert last == "... and 2 more"
    assert [f"line {k}," in line for k, line in enumerate(lines, start=2)] == [True] * 8


REFUSED = [
    (("mean_drafts", [1.0]), {"name": "{1}"}, "{1}: 'mean_drafts' is not a measured result: did you mean"),
    (("mean_draft", [1.0, math.nan]), {}, "row 2: mean_draft = nan must be a finite number"),
    (("mean_draft", [1.0], {"scene.tow_speed": [1.0, 2.0]}), {}, "must have 1 rows, as 'mean_draft' has"),
    (("mean_draft", [1.0]), {"sigma": 0.0}, "row 1: sigma = 0 must be above 0"),
    (("mean_draft", [1.0]), {"weights": [1.0], "sigma": 1.0}, "exclude each other"),
    (("mean_draft", [1.0]), {"time": [1.0]}, "a time goes with mount_force"),
]


@pytest.mark.parametrize(("arguments", "keywords", "words"), REFUSED)
def test_invalid_measurements_are_refused(arguments, keywords, words):
    with pytest.raises(po.InputError) as refusal:
        po.Measurements(*arguments, **keywords)
    assert words in str(refusal.value)


WAVE = po.StrengthWave(0.3, 0.2)


def moving_scene(cohesion=20e3, damping=400.0, tow_speed=2.0, **effects):
    soil = po.Soil(1350.0, 0.794, cohesion, po.deg(28.0), 0.5, 1e4)
    share = po.Wedge(po.deg(39.0), po.deg(15.0), 0.25)
    own = po.Effects(strength_wave=WAVE, damping=damping, **effects)
    return po.Scene(soil, share, 5e4, 25.0, tow_speed, own)


@pytest.fixture(scope="module")
def record():
    """A force at uneven times of one run, with errors of 30 N."""
    run = po.simulate(moving_scene(start="rest"), 0.4)
    times = np.sort(np.random.default_rng(3).uniform(0.0, 0.4, 40))
    exact = interpolate.CubicSpline(run.time, run.mount_force)(times)
    noisy = exact + 30.0 * np.random.default_rng(4).standard_normal(len(times))
    return times, exact, noisy


@pytest.fixture(scope="module")
def from_record(record):
    """Cohesion and damping from that record."""
    times, _, noisy = record
    data = po.Measurements("mount_force", noisy, time=times, sigma=30.0, name="record")
    unknown = {"soil.cohesion": (1e3, 80e3, 10e3), "effects.damping": (50.0, 2000.0, 200.0)}
    return po.calibrate(moving_scene(start="rest"), data, unknown, starts=1)


def test_a_record_gives_strength_and_damping(from_record):
    intervals = from_record.intervals(0.999)
    assert 20e3 in intervals["soil.cohesion"]
    assert 400.0 in intervals["effects.damping"]
    assert from_record.values["effects.damping"] == pytest.approx(400.0, rel=0.1)
    assert not any("differ from the fitted" in text or "correlated" in text for text in from_record.warnings)


def test_the_calibrated_scene_predicts_the_record(from_record, record):
    """The numeric run, with its own check, is what was fitted."""
    run = po.simulate(from_record.scene, 0.4)
    spline = interpolate.CubicSpline(run.time, run.mount_force)
    # A cubic spline through 400 intervals of some 60 oscillations' phase errs by 1e-5 of the peak.
    np.testing.assert_allclose(from_record.predicted, spline(record[0]), atol=2e-4 * run.peak_force)
    assert from_record.soil.cohesion == from_record.values["soil.cohesion"]
    assert "calibrated" in from_record.soil.name
    assert "record" in from_record.soil.source


def test_correlated_residuals_give_a_warning(record):
    times, exact, _ = record
    drift = 60.0 * np.sin(2.0 * np.pi * times / 0.17)
    data = po.Measurements("mount_force", exact + drift, time=times, name="drifting")
    fit = po.calibrate(moving_scene(start="rest"), data, {"soil.cohesion": (1e3, 80e3)}, starts=1)
    assert any("residuals of neighbouring times are correlated" in warning for warning in fit.warnings)


@pytest.mark.parametrize("motion", [False, True])
def test_mean_drafts_and_even_records_of_runs_under_a_strength_wave(motion):
    effects = {"motion": motion, "damping": 400.0 if motion else None}
    speeds = np.array([1.0, 2.0])
    exact = np.array([float(po.simulate(moving_scene(tow_speed=v, **effects), 0.3).mean_draft) for v in speeds])
    run = po.simulate(moving_scene(**effects), 0.3)
    drafts = po.Measurements("mean_draft", exact, {"scene.tow_speed": speeds}, sigma=0.01 * exact)
    even = po.Measurements("mount_force", run.mount_force[::40], time=run.time[::40], sigma=30.0)
    guess = moving_scene(cohesion=35e3, **effects)
    fit = po.calibrate(guess, [drafts, even], {"soil.cohesion": (1e3, 80e3)}, duration=0.3, starts=1)
    # The symbolic run's steps err by 1e-8, the search by 1e-4 of the standard error, some 2 % here.
    assert fit.values["soil.cohesion"] == pytest.approx(20e3, rel=1e-5)


def test_fitted_runs_are_checked_by_runs_with_an_error_estimate(monkeypatch):
    """The 400 steps of a symbolic run are too few for 30 s, and for some starts too long: they have no prediction."""
    speeds, unknown = [1.0, 2.0], {"effects.damping": (100.0, 1e5)}
    data = po.Measurements("mean_draft", [1.4e3, 1.5e3], {"scene.tow_speed": speeds}, sigma=1.0)
    calibration = po.Calibration(moving_scene(), data, unknown, duration=30.0, starts=4)
    fit = calibration.fit()
    runs = [po.simulate(dataclasses.replace(fit.scene, tow_speed=v), 30.0).mean_draft for v in speeds]
    error = np.max(np.abs(runs - fit.predicted))
    assert any(f"differ from the fitted ones by up to {error:.2g} standard" in text for text in fit.warnings)
    monkeypatch.setattr(Model, "checked", Mock(side_effect=po.IntegrationError("too fast")))
    assert "the run of the fitted scene could not be checked: too fast" in calibration.fit().warnings


def test_a_run_needs_a_duration():
    data = po.Measurements("mean_draft", [3e3, 3.1e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=10.0, name="drafts")
    with pytest.raises(po.InputError, match="drafts: mean_draft of this scene needs a run: the duration is missing"):
        po.calibrate(moving_scene(), data, {"soil.cohesion": (1e3, 80e3)})
    # The steps of a symbolic run are too long for this damper.
    with pytest.raises(po.InputError, match="drafts, row 1: the model has no finite prediction"):
        po.calibrate(moving_scene(damping=1e5), data, {"soil.cohesion": (1e3, 80e3)}, duration=30.0)
