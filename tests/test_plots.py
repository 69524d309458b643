"""Pictures: what they show, in which units, and files that are whole or not there at all."""

import dataclasses

import matplotlib.pyplot
import numpy as np
import pytest
from helpers.scenes import SHARP, scene_of
from helpers.small_designs import design

import plough_opt as po
from plough_opt.app import plots
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display


@pytest.fixture(scope="module")
def scene():
    return scene_of(share=SHARP, mass=23.0, strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.6))


@pytest.fixture(scope="module")
def run(scene):
    return po.simulate(scene, duration=0.5, outputs=50)


@pytest.fixture(scope="module")
def optimum(scene):
    """Return an optimum, with a scan over a log-scaled stiffness, and its run."""
    d, stiffness = design(mount=(5e4, 5e3, 5e5, "N/m", True))
    found = po.simulate(dataclasses.replace(scene, stiffness=stiffness), 1.0, outputs=100)
    d.minimise(found.mean_draft / 1e3 + found.force_rms / 1e3)
    best = d.solve()
    return best, best(found)


def labels(axes):
    return axes.get_xlabel(), axes.get_ylabel()


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def words(axes):
    """Return all that is written inside the axes."""
    texts = [text.get_text() for text in axes.texts]
    return "\n".join(texts if axes.get_legend() is None else texts + legend(axes))


def line(axes, label):
    """Return the data of the line with a label."""
    return next(found.get_xydata() for found in axes.get_lines() if found.get_label() == label)


def test_the_lines_of_a_run_are_in_the_units_of_its_axes(run):
    force, deflection, speed = plots.plot_run(run).axes
    assert matplotlib.pyplot.get_fignums() == []
    assert (force.get_ylabel(), deflection.get_ylabel()) == ("force [kN]", "deflection [m]")
    assert labels(speed) == ("time [s]", "speed [m/s]")
    np.testing.assert_allclose(line(force, "mount force"), np.c_[run.time, run.mount_force / 1000])
    np.testing.assert_allclose(line(force, "soil resistance"), np.c_[run.time, run.soil_resistance / 1000])
    np.testing.assert_allclose(deflection.get_lines()[0].get_xydata(), np.c_[run.time, run.deflection])
    np.testing.assert_allclose(line(speed, "share"), np.c_[run.time, run.speed])
    np.testing.assert_allclose(line(speed, "strut")[:, 1], 2.0)
    assert f"mean draft {run.mean_draft / 1000:.3g} kN" in legend(force)
    assert f"± RMS {run.force_rms / 1000:.3g} kN" in legend(force)


def test_a_run_is_drawn_with_the_units_and_the_title_of_its_problem_file(run):
    origin = Origin("Two shares", {"deflection": Display("cm", 0.01), "scene.tow_speed": Display("km/h", 1 / 3.6)})
    figure = plots.plot_run(dataclasses.replace(run, origin=origin))
    assert figure.get_suptitle() == "Two shares\nserozem, 7.2 km/h"
    np.testing.assert_allclose(line(figure.axes[1], "deflection")[:, 1], 100.0 * run.deflection)
    assert figure.axes[2].get_ylabel() == "speed [km/h]"


def test_a_share_is_drawn_with_its_area_and_the_cone_at_the_same_scale(scene):
    wedge, cone = plots.plot_share(scene).axes
    assert wedge.get_aspect() == cone.get_aspect() == 1.0
    assert wedge.get_ylim() == cone.get_ylim()
    assert "λ = 25.0°" in words(wedge)
    assert f"β = {np.degrees(scene.cone.half_angle):.1f}°" in words(cone)
    assert f"r* = {po.loosened_radius(scene.cone, scene.soil):.3f} m" in words(cone)
    corners = [patch.get_xy() for patch in wedge.patches]
    (x0, y0), (x1, y1), (x2, y2) = corners[0][:3]
    assert len(corners) == 2  # each with half of the area
    assert abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)) == pytest.approx(scene.share.area, rel=1e-12)


def test_an_optimum_is_drawn_with_its_response_and_every_optimum_of_the_search(optimum):
    best, run = optimum
    other = dataclasses.replace(best.local_optima[0], variables={"mount": 1e5}, objective=3.0, spread=None)
    figure = plots.plot_optimum(dataclasses.replace(best, local_optima=(best.local_optima[0], other)), run)
    _, _, force, deflection, search = figure.axes
    assert labels(force) == ("time [s]", "force [kN]")
    assert labels(deflection) == ("time [s]", "deflection [mm]")
    assert labels(search) == ("mount [kN/m]", "objective")
    assert search.get_xscale() == "log"
    np.testing.assert_allclose(line(search, "best"), [[best.variables["mount"] / 1e3, best.objective]])
    np.testing.assert_allclose(line(search, "other local optima"), [[1e2, 3.0]])


def test_a_sweep_of_one_quantity_is_drawn_in_one_colour(inline):
    varying, constant = (
        po.sweep(lambda at: {"b": at["a"], "c": 3.0}, {"a": [1.0, 2.0, 30.0]}, executor=inline).plot().axes
    )
    assert len(varying.collections[0].get_facecolor()) == 1
    assert (varying.get_xscale(), constant.get_ylim()) == ("log", (0.0, pytest.approx(3.6)))


def test_a_wedge_field_shows_both_stresses_around_the_body():
    figure = plots.plot_wedge_field([(0.0, 0.0), (0.1, 0.02), (0.2, 0.02)], po.named_soil("serozem"), 2.0)
    labels = " ".join(axes.get_ylabel() for axes in figure.axes)
    assert labels.count("σ_yy") == labels.count("σ_xy") == 1
    for axes in figure.axes[:2]:
        assert axes.get_aspect() == 1.0
        assert axes.get_xlim()[0] < 0.0 < 0.2 < axes.get_xlim()[1]
