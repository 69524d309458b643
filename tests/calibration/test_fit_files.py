"""Fits as files and pictures."""

import math

import pytest
from helpers.known_soil import BOUNDS, steady_scene
from helpers.strict_json import strict

import plough_opt as po


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
