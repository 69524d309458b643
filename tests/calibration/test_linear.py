"""Calibration: estimates, intervals and plans against closed forms and searches, with runs and without."""

import json
import math
import re

import numpy as np
import pytest
from helpers.commands import call, printed
from helpers.known_soil import BOUNDS, TRUTH, steady_scene
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported
from helpers.strict_json import strict
from scipy import optimize, stats

import plough_opt as po
from plough_opt.studies.calibration.least_squares import SOFT_L1

# --- models linear in their unknowns, against linear regression; optima of every loss; how often intervals hold ---

# The draft is linear in the cohesion (through F0) and, without rate term, in the density (through the drag).
UNKNOWN = {"soil.cohesion": (0.0, 60e3, 10e3), "soil.density": (100.0, 4000.0, 1000.0)}


def linear_scene(cohesion, density, speed):
    soil = po.Soil(density, 0.794, cohesion, po.deg(28.0), 0.5, 5e3)
    return po.Scene(soil, po.Wedge(po.deg(60.0), po.deg(15.0), 0.25), 5e4, 25.0, speed, po.Effects(motion=False))


@pytest.fixture(scope="module")
def regression():
    """Speeds, measured drafts, the design matrix and the closed-form solution of the weighted least squares."""
    speeds = np.linspace(0.5, 6.0, 14)
    at = np.array([[float(linear_scene(k, rho, v).steady_resistance) for k, rho in ((0, 1), (1e4, 1), (0, 1001))]
                   for v in speeds])  # fmt: skip
    offset = at[:, 0] - (at[:, 2] - at[:, 0]) / 1000.0
    matrix = np.column_stack([(at[:, 1] - at[:, 0]) / 1e4, (at[:, 2] - at[:, 0]) / 1000.0])
    exact = offset + matrix @ [20e3, 1400.0]
    sigma = 0.01 * exact
    values = exact + sigma * np.random.default_rng(5).standard_normal(len(exact))
    return speeds, values, sigma, offset, matrix


@pytest.fixture(scope="module", params=["stated", "estimated"])
def both(request, regression):
    """The fit, and the closed form, with sigma stated or estimated."""
    speeds, values, sigma, offset, matrix = regression
    stated = request.param == "stated"
    weights = 1.0 / sigma if stated else np.ones(len(values))
    data = po.Measurements("mean_draft", values, {"scene.tow_speed": speeds}, sigma=sigma if stated else None)
    fit = po.calibrate(linear_scene(20e3, 1400.0, 2.0), data, UNKNOWN)
    weighted = matrix * weights[:, None]
    target = (values - offset) * weights
    found = np.linalg.lstsq(weighted, target)[0]
    rest = target - weighted @ found
    freedom = len(values) - 2
    variance = 1.0 if stated else float(rest @ rest) / freedom
    covariance = variance * np.linalg.inv(weighted.T @ weighted)
    quantile = stats.norm.ppf(0.975) if stated else stats.t.ppf(0.975, freedom)
    return fit, found, covariance, quantile, weighted, weights


def test_values_errors_correlation_and_scatter(both, regression):
    fit, found, covariance, _, _, weights = both
    # The search stops within 1e-4 of a standard error, and here far closer.
    np.testing.assert_allclose(list(fit.values.values()), found, rtol=1e-7)
    errors = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(list(fit.standard_errors.values()), errors, rtol=1e-7)
    correlation = pytest.approx(covariance[0, 1] / errors.prod(), rel=1e-6)
    assert fit.correlations == {tuple(UNKNOWN): correlation, tuple(reversed(UNKNOWN)): correlation}
    size = np.mean(regression[1]) if np.all(weights == 1.0) else 1.0
    assert fit.scatter == pytest.approx(np.linalg.norm(fit.residuals * weights) / 12**0.5 / size, rel=1e-12)


def test_intervals(both):
    fit, found, covariance, quantile = both[:4]
    reach = quantile * np.sqrt(np.diag(covariance))
    ends = [[*interval] for interval in fit.intervals().values()]
    # The profile's limit is met to 1e-9 of a loss, of which the interval is the root.
    np.testing.assert_allclose(ends, np.column_stack([found - reach, found + reach]), rtol=1e-6)


@pytest.fixture(scope="session")
def script():
    """Yield problems/calibration_coverage.py as a module."""
    with imported("calibration_coverage") as module:
        yield module


def identifiable(found):
    """Return the unknowns that the data determined in every trial, and check that the others never were."""
    determined = [own for own in found if own.identifiable]
    assert all(own.identifiable == own.trials for own in determined)
    assert determined
    return determined


@pytest.mark.slow
@pytest.mark.parametrize("number", range(6))
def test_coverage_of_500_trials_is_95_per_cent_within_3(script, number):
    found = script.CASES[number].run(500)
    for own in identifiable(found):
        assert abs(own.rate - 0.95) <= 0.03, own


def test_every_unknown_is_identifiable_in_some_case_of_the_study(script):
    found = [own for case in script.CASES for own in case.run(1)]
    assert {own.name for own in found if own.identifiable} == set(script.BOUNDS)
    assert {own.name for own in found if not own.identifiable} == {"soil.cohesion", "soil.ambient_pressure"}


def residuals(measured):
    """Return the weighted residuals as a function of cohesion [kPa], tool friction and 100 times the rate term."""
    speed, angle = measured.conditions["scene.tow_speed"], measured.conditions["share.wedge_angle"]

    def of(x):
        soil = po.Soil(1350.0, TRUTH["soil.density_ratio"], x[0] * 1e3, TRUTH["soil.friction_angle"], x[1], 60e3)
        reaction = po.soil_reaction(po.Wedge(angle, po.deg(15.0), 0.25).equivalent_cone(), soil)
        drafts = reaction.static * (1.0 + x[2] / 100.0 * speed**2) + reaction.drag * speed**2
        return (drafts - measured.values) / measured.sigma

    return of


LOSSES = ("squares", "soft_l1")


def test_the_page_names_the_constant_of_the_code():
    text = (PROBLEMS.parent / "docs" / "explanation" / "fitting.md").read_text(encoding="utf-8")
    assert [float(c) for c in re.findall(r"\$c=([\d.]+)\$", text)] == [SOFT_L1]


@pytest.mark.parametrize("loss", LOSSES)
def test_values_errors_and_intervals_are_those_of_scipy_alone(measured, three, loss):
    """Least squares on residuals written apart, with slopes by differences, and a profile fitted at each value."""
    fit, r, scale = po.calibrate(steady_scene(), measured, three, loss=loss), residuals(measured), [1e3, 1.0, 0.01]
    options = {"x_scale": "jac", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "jac": "3-point", "f_scale": SOFT_L1}
    kind = {"squares": "linear", "soft_l1": "soft_l1"}[loss]
    best = optimize.least_squares(r, [20.0, 0.5, 2.0], loss=kind, **options)
    # The loss is flat at its optimum, and steps of squares are exact beyond its rounding.
    np.testing.assert_allclose([*fit.values.values()], best.x * scale, rtol=1e-9 if loss == "squares" else 2e-8)
    rise = 0.5 * stats.norm.ppf(0.975) ** 2
    if loss == "squares":
        errors = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac))) * scale
        np.testing.assert_allclose([*fit.standard_errors.values()], errors, rtol=1e-7)
    else:  # Student's quantile, and the variance of docs/explanation/fitting.md
        root, freedom = np.hypot(1.0, r(best.x) / SOFT_L1), len(measured.values) - 3
        variance = np.sum((r(best.x) / root) ** 2) / freedom / np.mean(root**-3.0)
        rise = 0.5 * stats.t.ppf(0.975, freedom) ** 2 * variance

    def risen(own):
        others = optimize.least_squares(lambda x: r([own, *x]), best.x[1:], loss=kind, **options)
        return others.cost - best.cost - rise

    interval = fit.intervals()["soil.cohesion"]
    for end, far in zip(interval, (0.3, 3.0), strict=True):
        expected = optimize.brentq(risen, best.x[0], far * best.x[0], xtol=1e-11, rtol=1e-13)
        assert end == pytest.approx(1e3 * expected, rel=1e-8)


def test_exact_drafts_without_sigma_give_the_truth(plane, three):
    conditions, exact, _ = plane
    for loss in LOSSES:
        fit = po.calibrate(steady_scene(), po.Measurements("mean_draft", exact, conditions), three, loss=loss)
        # Rounding of the drafts, magnified by their correlation.
        assert fit.values == pytest.approx({name: TRUTH[name] for name in three}, rel=1e-10)


def test_outliers_pull_a_robust_fit_less(plane, three):
    conditions, exact, noisy = plane
    spoilt = noisy.copy()
    spoilt[[2, 9, 20]] *= [1.8, 0.4, 1.7]
    data = po.Measurements("mean_draft", spoilt, conditions, sigma=0.03 * exact, name="spoilt")
    plain, robust = (po.calibrate(steady_scene(), data, three, loss=loss) for loss in LOSSES)
    # Without sigma only ratios of weights count, because the scatter is estimated.
    weighted = (po.Measurements("mean_draft", spoilt, conditions, weights=w / exact**2) for w in (1, 1e4))
    one, other = (po.calibrate(steady_scene(), own, three, loss="soft_l1") for own in weighted)
    assert list(one.values.values()) == pytest.approx(list(other.values.values()), rel=1e-4)
    assert one.values["soil.cohesion"] == pytest.approx(robust.values["soil.cohesion"], rel=0.1)
    for name in three:
        assert abs(robust.values[name] - TRUTH[name]) < 3.0 * robust.standard_errors[name]
    # The cohesion suffers most.
    assert abs(plain.values["soil.cohesion"] - 20e3) > 2.0 * abs(robust.values["soil.cohesion"] - 20e3)
    assert any("outliers: spoilt, row" in warning for warning in plain.warnings)
    assert any("the stated sigma" in warning for warning in plain.warnings)


def test_all_optima_are_found_and_close_ones_give_a_warning(measured):
    def scene_of(values):
        x = values["soil.cohesion"] / 40e3 - 1.0
        soil = {"cohesion": 20e3 + 10e3 * (4.0 * x**3 - 3.0 * x), "tool_friction": 0.46 + 0.03 * x}
        return steady_scene(values["scene.tow_speed"], values["share.wedge_angle"], **soil)

    fit = po.calibrate(scene_of, measured, {"soil.cohesion": (0.0, 80e3)}, starts=16)
    r, places = residuals(measured), np.linspace(-1.0, 1.0, 4001)
    loss = [np.sum(r([20 + 10 * (4 * x**3 - 3 * x), 0.46 + 0.03 * x, 2.0]) ** 2) / 2.0 for x in places]
    least = sorted(b for a, b, c in zip(loss, loss[1:], loss[2:], strict=False) if b < min(a, c))
    # The nearest place is within 10 Pa of an optimum, a twentieth of its standard error: 0.05^2/2 of a loss.
    assert list(fit.optima) == pytest.approx(least, abs=2e-3)
    near = sum(one - least[0] < 0.5 * 1.96**2 for one in least[1:])
    assert any(text.startswith(f"{near} other local optima fit almost as well") for text in fit.warnings)


def test_the_interval_of_an_unknown_at_its_bound_ends_there(measured, three):
    fit = po.calibrate(steady_scene(), measured, three | {"soil.tool_friction": (0.7, 1.5)})
    assert fit.values["soil.tool_friction"] == pytest.approx(0.7, abs=1e-6)
    interval = fit.intervals()["soil.tool_friction"]
    assert (interval.lower, interval.clipped) == (0.7, ("lower",))


# --- `calibrate` and its command: three kinds of models, tables, files, pictures, and messages about invalid input ---


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
    ({"soil.cohesion": (1e3, 2e3, 3e3)}, {}, "its guess 3000 lies outside its bounds 1000 to 2000"),
    ({"scene.tow_speed": (1.0, 2.0)}, {}, "plane: 'scene.tow_speed' is a column of the data"),
    ({"effects.strength_wave.amplitude": (0.0, 0.5)}, {}, "the scene has no 'effects.strength_wave.amplitude'"),
    ({"soil.cohesion": (1e3, 80e3)}, {"loss": "soft"}, "no loss is named 'soft': did you mean 'soft_l1'?"),
    ({"soil.cohesion": (1e3, 80e3)}, {"errors": "relative"}, "plane: sigma states the errors"),
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


REFUSED_DATA = [
    (steady_scene(), FEW, r"few: 2 rows are too few for 2 unknowns .* at least 3 are needed"),
    (steady_scene(), [STATED, FEW], "few: no sigma is stated"),
    (steady_scene(), ANGLES, "beyond, row 2: wedge angle = 2 rad must be below"),
    (steady_scene(), po.Measurements("soil.density_ratio", [0.8] * 3), "'soil.density_ratio' was measured"),
    (3.0, FEW, "must be a Problem, a Scene, or a function"),
    (steady_scene(po.Design().variable("v", guess=2.0, lower=1.0, upper=3.0)), FEW, "the scene holds symbols"),
]


@pytest.mark.parametrize(("scene", "data", "words"), REFUSED_DATA)
def test_data_that_do_not_fit_are_refused(scene, data, words):
    with pytest.raises(po.InputError, match=words):
        po.calibrate(scene, data, {"soil.cohesion": (1e3, 80e3), "soil.tool_friction": (0.1, 1.0)})


FILE, DATA = PROBLEMS / "calibration.toml", PROBLEMS / "synthetic_draft.csv"


def test_tables_and_files(tmp_path):
    picture, output = tmp_path / "residuals.png", tmp_path / "deep" / "fit.json"
    out = printed("calibrate", FILE, "--data", DATA, "--plot", picture, "--output", output)
    for words in (
        "24 rows of", "│ soil.cohesion ", "│ soil.tool_friction ", "│ effects.rate_term ", "95 % interval",
        "are correlated: -0.9",
    ):  # fmt: skip
        assert words in out.replace("\n", " ")
    assert picture.stat().st_size > 10_000
    truth = {"soil.cohesion": 26e3, "soil.tool_friction": 0.42, "effects.rate_term": 0.03}
    assert all(truth[name] in interval for name, interval in po.Fit.load(output).intervals().items())


def test_json_is_what_python_gives():
    done = call("calibrate", FILE, "--data", DATA, "--json", "--loss", "soft_l1")
    assert (done.status, done.err) == (0, "")
    fit = po.calibrate(po.read_problem(FILE), po.read_measurements(DATA), loss="soft_l1")
    assert json.loads(done.out)["values"] == pytest.approx(fit.values, rel=1e-12)


def test_unknowns_of_the_command_line_and_one_measured_by_itself(tmp_path):
    options = ("--unknown", "soil.cohesion=1..80 kPa", "--unknown", 'soil.ambient_pressure="1 kPa .. 0.15 MPa"')
    out = printed("calibrate", FILE, "--data", DATA, *options)
    assert out.count("not determined") == 2
    assert "cannot be told apart" in out.replace("\n", " ")
    out = printed("calibrate", FILE, "--data", DATA, *options, "--known", "soil.ambient_pressure=101.3 +- 2 kPa")
    assert "not determined" not in out.lower()
    few = tmp_path / "few.csv"
    few.write_text("scene.tow_speed [km/h], mean_draft [kN]\n3, 1.8\n", encoding="utf-8")
    done = call("calibrate", FILE, "--data", few, *options, "--known", "soil.ambient_pressure=101.3 +- 2 kPa")
    assert (done.status, "few.csv: no sigma is stated, but other sets state theirs" in done.said) == (2, True)


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
    for level in (0.9, 0.95):
        assert again.intervals(level) == fitted.intervals(level)
    assert again.correlations == fitted.correlations
    with pytest.raises(po.InputError, match=r"intervals of level 0\.8"):
        again.intervals(0.8)
    for ask in (again.hold_out, lambda: again.scene):
        with pytest.raises(po.InputError, match="this fit comes from a file"):
            ask()


def test_infinite_intervals_are_valid_json(measured, tmp_path):
    names = ("soil.cohesion", "soil.ambient_pressure")
    fit = po.calibrate(steady_scene(), measured, {name: BOUNDS[name] for name in names})
    strict(fit.to_json())
    again = po.Fit.load(fit.save(tmp_path / "open.json"))
    assert again.standard_errors["soil.cohesion"] == math.inf
    assert tuple(again.intervals()["soil.cohesion"]) == (-math.inf, math.inf)
    assert again.unidentifiable == fit.unidentifiable


# --- predictions of rows held out of a fit: linear regression, 150 synthetic sets, groups, refusals ---


@pytest.mark.parametrize("stated", [True, False])
def test_held_out_prediction_and_interval_are_those_of_linear_regression(regression, stated):
    speeds, _, _, offset, matrix = regression
    exact = offset + matrix @ [20e3, 1400.0]
    sigma = 0.01 * np.mean(exact)
    values = exact + sigma * np.random.default_rng(3).standard_normal(14)
    data = po.Measurements("mean_draft", values, {"scene.tow_speed": speeds}, sigma=sigma if stated else None)
    held = po.calibrate(linear_scene(20e3, 1400.0, 2.0), data, UNKNOWN).hold_out(1 / 3, seed=4, level=0.9)
    rows = np.array([int(row.place.rpartition(" ")[2]) - 1 for row in held.rows])
    kept = np.setdiff1d(np.arange(14), rows)
    assert (held.fitted, len(rows)) == (9, 5)
    found, rest, _, _ = np.linalg.lstsq(matrix[kept], (values - offset)[kept])
    variance = sigma**2 if stated else float(rest[0]) / 7
    quantile = stats.norm.ppf(0.95) if stated else stats.t.ppf(0.95, 7)
    inverse = np.linalg.inv(matrix[kept].T @ matrix[kept])
    spread = np.sqrt(variance * (1.0 + np.einsum("ni,ij,nj->n", matrix[rows], inverse, matrix[rows])))
    # The search stops within 1e-4 of a standard error, and here far closer.
    np.testing.assert_allclose([row.predicted for row in held.rows], (offset + matrix @ found)[rows], rtol=1e-8)
    np.testing.assert_allclose(held.half_widths, quantile * spread, rtol=1e-6)
    errors = (offset + matrix @ found - values)[rows]
    assert held.rms == {"mean_draft": pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-6)}
    assert held.coverage == (np.sum(np.abs(errors) <= quantile * spread), 5)


def test_rows_with_one_value_in_a_column_are_held_out_together():
    fit = po.calibrate(po.read_problem(FILE), po.read_measurements(DATA))
    held = fit.hold_out(1 / 3, by="scene.tow_speed", seed=2)
    speeds = {row.conditions["scene.tow_speed"] for row in held.rows}
    others = {row.conditions["scene.tow_speed"] for row in fit.rows} - speeds
    assert (len(speeds), len(others), len(held.rows), held.fitted) == (2, 4, 8, 16)


def test_the_command_prints_draws_and_writes_them(tmp_path):
    options = ("calibrate", FILE, "--data", DATA, "--hold-out", "2/3", "--seed", "3", "-q")
    text = printed(*options, "--plot", tmp_path / "held.svg")
    assert "Fitted to 8 rows, RMS error of 16 others: mean_draft" in text
    assert (tmp_path / "held.svg").stat().st_size > 1000
    written = json.loads(printed(*options, "--json"))["held_out"]
    assert (written["fitted"], written["finite"], len(written["rows"])) == (8, 16, 16)
