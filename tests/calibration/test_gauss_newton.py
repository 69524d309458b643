"""The optimum against SciPy's least squares on residuals written apart, and derivatives against differences."""

import numpy as np
import pytest
from helpers.known_soil import TRUTH, steady_scene
from scipy import optimize

import plough_opt as po
from plough_opt.studies.calibration.loss import CAUCHY, HUBER, LOSSES, SOFT_L1


def residuals(measured):
    """Return the weighted residuals as a function of cohesion [kPa], tool friction and 100 times the rate term."""
    speed, angle = measured.conditions["scene.tow_speed"], measured.conditions["share.wedge_angle"]

    def of(x):
        soil = po.Soil(1350.0, TRUTH["soil.density_ratio"], x[0] * 1e3, TRUTH["soil.friction_angle"], x[1], 60e3)
        reaction = po.soil_reaction(po.Wedge(angle, po.deg(15.0), 0.25).equivalent_cone(), soil)
        drafts = reaction.static * (1.0 + x[2] / 100.0 * speed**2) + reaction.drag * speed**2
        return (drafts - measured.values) / measured.sigma

    return of


SCALES = {"squares": 1.0, "huber": HUBER, "soft_l1": SOFT_L1, "cauchy": CAUCHY}


@pytest.mark.parametrize("loss", LOSSES)
def test_optimum_is_that_of_scipy(measured, three, loss):
    fit = po.calibrate(steady_scene(), measured, three, loss=loss)
    name = "linear" if loss == "squares" else loss
    found = optimize.least_squares(
        residuals(measured), [25.0, 0.6, 3.0], loss=name, f_scale=SCALES[loss], jac="3-point",
        bounds=([1.0, 0.05, 0.0], [80.0, 1.5, 20.0]), xtol=1e-15, ftol=1e-15, gtol=1e-12,
    )  # fmt: skip
    values = np.array(list(fit.values.values())) * np.array([1e-3, 1.0, 100.0])
    # SciPy's differences leave a gradient of 1e-10 of its scale, in a problem whose condition is some 1e4.
    np.testing.assert_allclose(values, found.x, rtol=2e-6)
    assert fit.total == pytest.approx(found.cost, rel=1e-10)


def test_exact_data_give_the_truth_back(plane, three):
    conditions, exact, _ = plane
    fit = po.calibrate(steady_scene(), po.Measurements("mean_draft", exact, conditions), three)
    for name, value in fit.values.items():
        # IPOPT stops when no step lowers the loss by 1e-8 of a squared one per cent.
        assert value == pytest.approx(TRUTH[name], rel=1e-6)
    assert fit.scatter < 1e-6


def test_derivatives_of_predictions_and_losses(measured, three):
    for loss in LOSSES:
        program = po.Calibration(steady_scene(), measured, three, loss=loss).program
        y, step = np.array([0.31, 0.42, 0.23]), 1e-6
        q = program._packed(measured.values, 1.0 / measured.sigma, None)
        slope, gradient = program.slope(y), np.asarray(program._local(y, q)[0]).ravel()
        for k in range(3):
            high, low = y.copy(), y.copy()
            high[k] += step
            low[k] -= step
            # Central differences: step^2 = 1e-12 and rounding 1e-16/step = 1e-10, of curvatures of some ten.
            by_difference = (program.predict(high) - program.predict(low)) / (2.0 * step)
            np.testing.assert_allclose(slope[:, k], by_difference, rtol=1e-7)
            losses = [program.total(x, measured.values, 1.0 / measured.sigma) for x in (high, low)]
            assert gradient[k] == pytest.approx((losses[0] - losses[1]) / (2.0 * step), rel=1e-6)


@pytest.mark.parametrize("loss", LOSSES)
def test_a_loss_fits_its_weight_and_its_curvature(loss):
    own, step = LOSSES[loss], 1e-5
    for r in (-7.0, -1.0, 0.3, 1.2, 3.0):
        slope = (own.value(r + step) - own.value(r - step)) / (2.0 * step)
        assert own.weight(r) * r == pytest.approx(slope, rel=1e-8)
        bend = (own.weight(r + step) * (r + step) - own.weight(r - step) * (r - step)) / (2.0 * step)
        assert own.curvature(r) == pytest.approx(bend, rel=1e-7, abs=1e-9)
    assert own.value(1e-3) == pytest.approx(0.5e-6, rel=1e-5)


def test_outliers_pull_a_robust_fit_less(plane, three):
    conditions, exact, noisy = plane
    spoilt = noisy.copy()
    spoilt[[2, 9, 20]] *= [1.8, 0.4, 1.7]
    data = po.Measurements("mean_draft", spoilt, conditions, sigma=0.03 * exact, name="spoilt")
    plain, robust = (po.calibrate(steady_scene(), data, three, loss=loss) for loss in ("squares", "cauchy"))
    for name, truth in TRUTH.items():
        if name in three:
            assert abs(robust.values[name] - truth) < 3.0 * robust.standard_errors[name]
    # The cohesion suffers most: squares miss it by more than ten times the robust fit's error.
    assert abs(plain.values["soil.cohesion"] - 20e3) > 4.0 * abs(robust.values["soil.cohesion"] - 20e3)
    assert any("outliers: spoilt, row" in warning for warning in plain.warnings)
    assert any("the stated sigma" in warning for warning in plain.warnings)


def test_a_bound_that_holds_is_told(measured, three):
    fit = po.calibrate(steady_scene(), measured, three | {"soil.tool_friction": (0.7, 1.5)})
    assert fit.values["soil.tool_friction"] == pytest.approx(0.7, abs=1e-6)
    assert any("soil.tool_friction is at its lower bound 0.7" in warning for warning in fit.warnings)
    interval = fit.intervals()["soil.tool_friction"]
    assert interval.lower == 0.7
    assert interval.clipped == ("lower",)
