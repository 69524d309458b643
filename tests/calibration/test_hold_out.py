"""Predictions of rows held out of a fit: against linear regression, over 150 synthetic sets, by groups, refusals."""

import json

import numpy as np
import pytest
from helpers.commands import call, printed
from helpers.known_soil import steady_scene
from helpers.problem_files import PROBLEMS
from scipy import stats

import plough_opt as po

FILE, DATA = PROBLEMS / "calibration.toml", PROBLEMS / "synthetic_draft.csv"
SPEEDS = np.linspace(0.5, 6.0, 15)


def linear_scene(cohesion, density, speed):
    soil = po.Soil(density, 0.794, cohesion, po.deg(28.0), 0.5, 5e3)
    return po.Scene(soil, po.Wedge(po.deg(60.0), po.deg(15.0), 0.25), 5e4, 25.0, speed, po.Effects(motion=False))


@pytest.fixture(scope="module")
def linear():
    """Return the offset and the design matrix of drafts that are linear in cohesion and density."""
    at = np.array([[float(linear_scene(k, rho, v).steady_resistance) for k, rho in ((0, 1), (1e4, 1), (0, 1001))]
                   for v in SPEEDS])  # fmt: skip
    slope = (at[:, 2] - at[:, 0]) / 1000.0
    return at[:, 0] - slope, np.column_stack([(at[:, 1] - at[:, 0]) / 1e4, slope])


def calibration(values, sigma):
    unknown = {"soil.cohesion": (0.0, 60e3, 10e3), "soil.density": (100.0, 4000.0, 1000.0)}
    data = po.Measurements("mean_draft", values, {"scene.tow_speed": SPEEDS}, sigma=sigma)
    return po.Calibration(linear_scene(20e3, 1400.0, 2.0), data, unknown)


@pytest.mark.parametrize("stated", [True, False])
def test_prediction_and_interval_are_those_of_linear_regression(linear, stated):
    offset, matrix = linear
    exact = offset + matrix @ [20e3, 1400.0]
    sigma = 0.01 * np.mean(exact)
    values = exact + sigma * np.random.default_rng(3).standard_normal(15)
    held = calibration(values, sigma if stated else None).fit().hold_out(1 / 3, seed=4, level=0.9)
    rows = np.array([int(row.place.rpartition(" ")[2]) - 1 for row in held.rows])
    kept = np.setdiff1d(np.arange(15), rows)
    assert (held.fitted, len(rows)) == (10, 5)
    found, rest, _, _ = np.linalg.lstsq(matrix[kept], (values - offset)[kept])
    variance = sigma**2 if stated else float(rest[0]) / 8
    quantile = stats.norm.ppf(0.95) if stated else stats.t.ppf(0.95, 8)
    inverse = np.linalg.inv(matrix[kept].T @ matrix[kept])
    spread = np.sqrt(variance * (1.0 + np.einsum("ni,ij,nj->n", matrix[rows], inverse, matrix[rows])))
    # The search stops within 1e-4 of a standard error, and here far closer.
    np.testing.assert_allclose([row.predicted for row in held.rows], (offset + matrix @ found)[rows], rtol=1e-8)
    np.testing.assert_allclose(held.half_widths, quantile * spread, rtol=1e-6)
    errors = (offset + matrix @ found - values)[rows]
    assert held.rms == {"mean_draft": pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-6)}
    assert held.coverage == (np.sum(np.abs(errors) <= quantile * spread), 5)


def test_intervals_hold_95_percent_of_the_rows_held_out(linear):
    offset, matrix = linear
    exact = offset + matrix @ [20e3, 1400.0]
    rng = np.random.default_rng(8)
    calibrated = calibration(exact, None)
    inside = count = 0
    for seed in range(150):
        fit = calibrated.fit(exact + 0.02 * np.mean(exact) * rng.standard_normal(15))
        hit, finite = fit.hold_out(0.4, seed=seed).coverage
        inside, count = inside + hit, count + finite
    # 900 rows; six of one set share its fit, so that their number varies twice as much as that of independent ones.
    assert count == 900
    assert abs(inside / count - 0.95) < 4 * 2 * (0.95 * 0.05 / count) ** 0.5


def test_rows_with_one_value_in_a_column_are_held_out_together():
    fit = po.calibrate(po.read_problem(FILE), po.read_measurements(DATA))
    held = fit.hold_out(1 / 3, by="scene.tow_speed", seed=2)
    speeds = {row.conditions["scene.tow_speed"] for row in held.rows}
    others = {row.conditions["scene.tow_speed"] for row in fit.rows} - speeds
    assert (len(speeds), len(others), len(held.rows), held.fitted) == (2, 4, 8, 16)


def test_a_row_whose_prediction_the_others_do_not_determine_has_no_interval():
    soil = {"soil.cohesion": (1e3, 80e3), "effects.rate_term": (0.0, 0.2)}
    speeds = np.array([1.0] * 5 + [4.0])
    values = [float(steady_scene(v).steady_resistance) for v in speeds]
    data = po.Measurements("mean_draft", values, {"scene.tow_speed": speeds}, sigma=50.0)
    fit = po.calibrate(steady_scene(), data, soil)
    seed = next(s for s in range(9) if {r.conditions["scene.tow_speed"] for r in
                                        fit.hold_out(0.5, by="scene.tow_speed", seed=s).rows} == {4.0})  # fmt: skip
    held = fit.hold_out(0.5, by="scene.tow_speed", seed=seed)
    assert held.coverage == (0, 0)
    assert np.isinf(held.half_widths).all()
    assert "1 more depend on what the fitted rows do not determine" in held.words()
    with pytest.raises(po.InputError, match="hold out a smaller part"):
        held.plot()


def test_the_command_prints_draws_and_writes_them(tmp_path):
    options = ("calibrate", FILE, "--data", DATA, "--hold-out", "2/3", "--seed", "3", "-q")
    text = printed(*options, "--plot", tmp_path / "held.svg")
    assert "Fitted to 8 rows, RMS error of 16 others: mean_draft" in text
    assert (tmp_path / "held.svg").stat().st_size > 1000
    written = json.loads(printed(*options, "--json"))["held_out"]
    assert (written["fitted"], written["finite"], len(written["rows"])) == (8, 16, 16)


WRONG_PARTS = [
    (("--hold-out", "some"), "--hold-out some: expected a part of the rows, like 1/3"),
    (("--hold-out", "1/0"), "--hold-out 1/0: expected a part"),
    (("--hold-out-by", "scene.tow_speed"), "--hold-out-by belongs to --hold-out"),
    (("--hold-out", "1.5"), "hold out 1.5: give a part of the rows between 0 and 1"),
    (("--hold-out", "0.95"), "leaves fewer than the 3"),
    (("--hold-out", "0.3", "--hold-out-by", "scene.towspeed"), "did you mean 'scene.tow_speed'"),
]


@pytest.mark.parametrize(("options", "words"), WRONG_PARTS)
def test_parts_that_cannot_be_held_out_are_refused(options, words):
    done = call("calibrate", FILE, "--data", DATA, *options)
    assert (done.status, done.out) == (2, "")
    assert words in done.said
