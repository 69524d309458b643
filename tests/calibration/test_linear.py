"""A model that is linear in its unknowns, against linear regression in closed form."""

import numpy as np
import pytest
from scipy import stats

import plough_opt as po

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


@pytest.mark.parametrize("kind", ["profile", "linearised"])
def test_intervals(both, kind):
    fit, found, covariance, quantile, _, _ = both
    errors = np.sqrt(np.diag(covariance))
    for k, interval in enumerate(fit.intervals(0.95, kind).values()):
        # The density is scaled logarithmically: its linearised interval is not symmetric, the profile's is.
        if kind == "linearised" and k == 1:
            factor = np.exp(quantile * errors[k] / found[k])
            expected = (found[k] / factor, found[k] * factor)
        else:
            expected = (found[k] - quantile * errors[k], found[k] + quantile * errors[k])
        assert interval.kind == kind
        # The profile's limit is met to 1e-9 of a loss, of which the interval is the root.
        np.testing.assert_allclose(tuple(interval), expected, rtol=1e-6)


def test_leaving_one_out_is_the_hat_matrix(both):
    fit, _, _, _, weighted, _ = both
    hat = weighted @ np.linalg.inv(weighted.T @ weighted) @ weighted.T
    expected = fit.residuals / (1.0 - np.diag(hat))
    found = fit.cross_validation()
    assert found.folds == len(fit.rows)
    np.testing.assert_allclose(found.errors, expected, rtol=1e-5, atol=1e-6 * np.max(np.abs(expected)))
    assert found.rms["mean_draft"] == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-6)
    assert found.rms["mean_draft"] > found.rms_fitted["mean_draft"]


def test_a_next_measurement_reduces_the_errors_as_predicted(regression):
    speeds, _, sigma, offset, matrix = regression
    scene = linear_scene(20e3, 1400.0, 2.0)
    exact = offset + matrix @ [20e3, 1400.0]
    # Errors so small, and bounds so wide, that the bounds tell nothing beside the data: some 1e-7 of the variance.
    data = po.Measurements("mean_draft", exact, {"scene.tow_speed": speeds}, sigma=sigma / 100.0)
    wide = {"soil.cohesion": (0.0, 4e7, 1e4), "soil.density": (1.0, 2e6, 1e3)}
    candidate = po.Candidate("mean_draft", {"scene.tow_speed": 9.0}, sigma=0.5)
    fit = po.calibrate(scene, data, wide)
    (promise,) = fit.next_measurements([candidate])
    draft = float(linear_scene(20e3, 1400.0, 9.0).steady_resistance)
    added = po.Measurements("mean_draft", [draft], {"scene.tow_speed": [9.0]}, sigma=0.5)
    then = po.calibrate(scene, [data, added], wide)
    for name, errors in promise.errors.items():
        assert errors == pytest.approx((fit.standard_errors[name], then.standard_errors[name]), rel=1e-5)


@pytest.mark.parametrize("loss", ["squares", "huber"])
def test_a_row_of_weight_zero_equals_no_row(regression, loss):
    speeds, values, _, _, _ = regression
    weights, spoilt, kept = np.ones(len(values)), values.copy(), np.arange(len(values)) != 3
    weights[3], spoilt[3] = 0.0, 3.0 * values[3]
    weighted = po.Measurements("mean_draft", spoilt, {"scene.tow_speed": speeds}, weights=weights)
    fewer = po.Measurements("mean_draft", values[kept], {"scene.tow_speed": speeds[kept]})
    scene = linear_scene(20e3, 1400.0, 2.0)
    fit, without = (po.calibrate(scene, data, UNKNOWN, loss=loss) for data in (weighted, fewer))
    assert fit.freedom == without.freedom
    # A robust fit ends when its scale changes by less than 1e-4.
    assert fit.values == pytest.approx(without.values, rel=1e-7 if loss == "squares" else 1e-5)
    assert fit.standard_errors == pytest.approx(without.standard_errors, rel=1e-6 if loss == "squares" else 1e-4)
