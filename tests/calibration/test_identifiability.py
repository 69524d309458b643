"""Undetermined combinations, against closed forms of the model's own degeneracies."""

import math
import re

import numpy as np
import pytest
from helpers.known_soil import BOUNDS, TRUTH, drafts, steady_scene
from scipy import optimize, stats

import plough_opt as po

STRENGTH = {name: BOUNDS[name] for name in ("soil.cohesion", "soil.ambient_pressure", "soil.tool_friction")}


@pytest.fixture(scope="module")
def confounded(measured):
    """Cohesion and ambient pressure, which enter the draft together, beside a tool friction that does not."""
    return po.calibrate(steady_scene(), measured, STRENGTH)


def test_no_draft_separates_cohesion_and_ambient_pressure(confounded):
    (found,) = confounded.unidentifiable
    assert found.structural
    # F0 goes with nu p_a + 2 k cos(theta)/(1 + sin(theta)): p_a can be offset by tan(theta) of itself in cohesion.
    ratio = found.changes["soil.cohesion"] / found.changes["soil.ambient_pressure"]
    assert ratio == pytest.approx(-math.tan(TRUTH["soil.friction_angle"]), rel=1e-9)
    more, less = re.search(r"more ([\w.]+) can be offset by .+ less ([\w.]+);", found.words).groups()
    assert {more, less} == set(found.changes) == {"soil.cohesion", "soil.ambient_pressure"}


def test_undetermined_unknowns_have_infinite_intervals(confounded):
    determined = {found.name: found.determined for found in confounded.unknowns}
    assert determined == {"soil.cohesion": False, "soil.ambient_pressure": False, "soil.tool_friction": True}
    for kind in ("profile", "linearised"):
        for name, interval in confounded.intervals(kind=kind).items():
            assert [math.isfinite(end) for end in interval] == [determined[name]] * 2
    assert confounded.standard_errors["soil.cohesion"] == math.inf
    assert confounded.correlations == {}
    assert np.all(np.isfinite([row.standard_error for row in confounded.rows]))


def test_an_undetermined_unknown_does_not_change_the_others(confounded, measured):
    """Along the undetermined direction nothing changes, so that fixing one of the two changes no other result."""
    name = "soil.tool_friction"
    fit = po.calibrate(steady_scene(), measured, {key: STRENGTH[key] for key in ("soil.cohesion", name)})
    # The pull along the open direction moves the others by less than a hundredth of their error, squared here.
    assert confounded.total == pytest.approx(fit.total, rel=1e-3)
    error = fit.standard_errors[name]
    assert confounded.values[name] == pytest.approx(fit.values[name], abs=0.02 * error)
    assert confounded.standard_errors[name] == pytest.approx(error, rel=0.02)
    assert tuple(confounded.intervals()[name]) == pytest.approx(tuple(fit.intervals()[name]), abs=0.12 * error)


def test_a_single_unknown_that_the_data_hardly_narrow(plane):
    conditions, exact, _ = plane
    data = po.Measurements("mean_draft", exact, conditions, sigma=100.0 * exact)
    (found,) = po.calibrate(steady_scene(), data, {"soil.cohesion": BOUNDS["soil.cohesion"]}).unidentifiable
    assert found.words.startswith("soil.cohesion is hardly determined")


def test_exact_drafts_separate_them_no_better(plane):
    conditions, exact, _ = plane
    data = po.Measurements("mean_draft", exact, conditions, sigma=1e-8 * exact)
    fit = po.calibrate(steady_scene(), data, STRENGTH)
    assert [found.structural for found in fit.unidentifiable] == [True]
    assert fit.intervals()["soil.tool_friction"].kind == "linearised"  # too short to differ


def test_data_at_one_wedge_angle_ask_for_another():
    """At one wedge angle cohesion and tool friction are one factor; a coated share or another angle separates them."""
    conditions, exact = drafts(np.linspace(0.8, 3.0, 8), [po.deg(40.0)])
    unknown = {name: BOUNDS[name] for name in ("soil.cohesion", "soil.tool_friction")}
    data = po.Measurements("mean_draft", exact, conditions, sigma=0.03 * exact)
    fit = po.calibrate(steady_scene(), data, unknown)
    # Between the bounds of the cohesion the tool friction is not quite open.
    assert not fit.unknowns[0].determined
    assert "told apart" in fit.unidentifiable[0].words
    gain = {item.candidate.describe(): item.information for item in fit.next_measurements()}
    best = next(iter(gain))
    assert "tool friction 0.2" in best or "directly" in best
    # Speed separates the two by the drag alone, some 1 % of the draft; height not at all.
    angle, speed, height = (max(value for name, value in gain.items() if key in name)
                            for key in ("wedge_angle", "tow_speed", "height"))  # fmt: skip
    assert angle > 2.0 * max(speed, height)
    # Then it is measured, and both are determined.
    wide, wide_exact = drafts([2.0], np.radians([25.0, 60.0]))
    more = po.Measurements("mean_draft", wide_exact, wide, sigma=0.03 * wide_exact)
    assert all(found.determined for found in po.calibrate(steady_scene(), [data, more], unknown).unknowns)


def test_an_unknown_without_effect_is_named(measured):
    unknown = {"soil.cohesion": BOUNDS["soil.cohesion"], "scene.stiffness": (1e4, 1e6)}
    fit = po.calibrate(steady_scene(), measured, unknown)
    (found,) = fit.unidentifiable
    assert found.words.startswith("scene.stiffness has no effect")
    # It stays at its guess, the scene's own.
    assert fit.values["scene.stiffness"] == pytest.approx(5e4, rel=1e-3)


def test_six_unknowns_are_separated_into_determined_and_undetermined(measured):
    fit = po.calibrate(steady_scene(), measured, BOUNDS)
    # Of F0's strength, the drag beside it, tool friction and rate term the data determine four combinations of six.
    assert sum(found.structural for found in fit.unidentifiable) == 2
    named = {name for found in fit.unidentifiable for name in found.changes}
    assert {"soil.cohesion", "soil.ambient_pressure", "soil.friction_angle", "soil.density_ratio"} <= named
    assert {found.name for found in fit.unknowns if found.determined} == {"soil.tool_friction", "effects.rate_term"}
    assert fit.next_measurement.information == max(item.information for item in fit.next_measurements())


def test_a_small_part_of_a_combination_is_named_too(measured):
    """The bounds of the ambient pressure offset a hundredth of those of the cohesion."""
    unknown = {"soil.cohesion": (0.0, 1e6), "soil.ambient_pressure": (50e3, 70e3)}
    vague = po.Measurements("soil.ambient_pressure", [60e3], sigma=1e6)
    for data, count in (([measured], 1), ([measured, vague], 2)):
        found = po.calibrate(steady_scene(), data, unknown).unidentifiable
        assert (len(found), {name for one in found for name in one.changes}) == (count, set(unknown))


def test_a_direct_measurement_of_an_unknown_determines_all(measured):
    shear = po.Measurements("soil.ambient_pressure", [60e3], sigma=2e3, name="shear test")
    fit = po.calibrate(steady_scene(), [measured, shear], STRENGTH)
    assert fit.unidentifiable == ()
    assert fit.standard_errors["soil.ambient_pressure"] == pytest.approx(2e3, rel=1e-3)
    assert fit.cross_validation().rows.tolist() == list(range(len(measured.values)))


@pytest.mark.parametrize("loss", ["squares", "huber"])
def test_profile_ends_are_where_the_loss_has_risen(measured, three, loss):
    """Against a profile by SciPy: the other unknowns fitted at each value of the first."""
    fit = po.calibrate(steady_scene(), measured, three, loss=loss)
    found, rise = fit.source, 0.5 * stats.norm.ppf(0.975) ** 2
    if loss == "huber":  # Student's quantile, and the variance of docs/calibration.md
        freedom, size = len(measured.values) - 3, np.abs(fit.residuals / measured.sigma)
        variance = np.sum(np.minimum(size, 1.345) ** 2) / freedom / np.mean(size < 1.345)
        rise = 0.5 * stats.t.ppf(0.975, freedom) ** 2 * variance

    def risen(own):
        def loss_of(rest):
            return found.setup.problem.total(np.array([own, *rest]), found.data)

        options = {"xatol": 1e-9, "fatol": 1e-11}
        return optimize.minimize(loss_of, found.y[1:], method="Nelder-Mead", options=options).fun - fit.total

    for end in fit.intervals()["soil.cohesion"]:
        assert risen(found.unknowns[0].scaled(end)) == pytest.approx(rise, abs=1e-6)
