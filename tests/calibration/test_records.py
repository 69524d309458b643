"""Forces over time, and averages of runs with motion."""

import dataclasses
from unittest.mock import Mock

import numpy as np
import pytest
from scipy import interpolate

import plough_opt as po
from plough_opt.studies.calibration.model import Rows, interpolation

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


def test_derivatives_of_a_record_agree_with_differences(from_record):
    problem, y, step = from_record.source.setup.problem, np.array([0.3, 0.4]), 1e-5
    slope = problem.at(y)[1]
    for k, by in enumerate(step * np.eye(2)):
        difference = (problem.predict(y + by) - problem.predict(y - by)) / (2.0 * step)
        # step^2 = 1e-10 times third derivatives of some hundred times the slope.
        np.testing.assert_allclose(slope[:, k], difference, rtol=1e-5, atol=1e-7 * np.max(np.abs(difference)))


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
    monkeypatch.setattr(Rows, "checked", Mock(side_effect=po.IntegrationError("too fast")))
    assert "the run of the fitted scene could not be checked: too fast" in calibration.fit().warnings


def test_interpolation_is_exact_for_polynomials():
    places = np.array([0.0, 0.013, 0.5, 0.777, 0.999, 1.0])
    matrix = interpolation(places, 20)
    grid = np.linspace(0.0, 1.0, 21)
    for degree in range(8):
        # Eight nodes carry a polynomial of degree seven; weights of order ten at the ends.
        np.testing.assert_allclose(matrix @ grid**degree, places**degree, atol=1e-12)
    assert np.count_nonzero(matrix[0]) == np.count_nonzero(matrix[2]) == 1


def test_a_run_needs_a_duration():
    data = po.Measurements("mean_draft", [3e3, 3.1e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=10.0, name="drafts")
    with pytest.raises(po.InputError, match="drafts: mean_draft of this scene needs a run: give its duration"):
        po.calibrate(moving_scene(), data, {"soil.cohesion": (1e3, 80e3)})
    # The steps of a symbolic run are too long for this damper.
    with pytest.raises(po.InputError, match="drafts, row 1: the model has no finite prediction"):
        po.calibrate(moving_scene(damping=1e5), data, {"soil.cohesion": (1e3, 80e3)}, duration=30.0)
