"""Pictures: what they show, in which units, and files that are whole or not there at all."""

import dataclasses
import io
import itertools

import matplotlib.pyplot
import numpy as np
import pytest
from helpers.scenes import SHARP, scene_of
from helpers.small_designs import design
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

import plough_opt as po
from plough_opt.app import plots
from plough_opt.app.panels import deflection_of, draw_panel
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display
from plough_opt.design import Limit


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


def test_legends_hide_no_line(run):
    figure = plots.plot_run(run)
    figure.savefig(io.BytesIO(), format="png")
    for axes in figure.axes:
        box = axes.get_legend().get_window_extent()
        for drawn in axes.get_lines():
            assert not any(box.contains(*point) for point in axes.transData.transform(drawn.get_xydata()))


def test_constant_panels_are_omitted(scene):
    still = dataclasses.replace(scene, effects=dataclasses.replace(scene.effects, motion=False))
    force, deflection = plots.plot_run(po.simulate(still, 0.5, outputs=40)).axes
    assert (force.get_ylabel(), deflection.get_ylabel()) == ("force [kN]", "deflection [m]")


def test_a_constant_is_drawn_without_its_rounding_and_times_of_rest_are_shaded():
    steady = po.simulate(scene_of(motion=False, inertial_drag=False, tow_ramp=0.1), 0.2, outputs=20)
    axes = Figure().subplots()
    draw_panel(axes, steady, deflection_of(steady))  # as an animation does
    assert legend(axes) == ["deflection", f"mean {steady.mean_deflection:.3g} m"]
    assert axes.get_ylim()[0] < 0.96 * steady.mean_deflection
    slight = po.simulate(scene_of(strength_wave=po.StrengthWave(1e-3, 0.2)), 0.2, outputs=20)
    assert plots.plot_run(slight).axes[1].get_ylim()[0] < 0.96 * slight.mean_deflection
    stuck = po.simulate(scene_of(contact=po.StickSlip(), start="rest"), 0.2, outputs=200)
    axes = plots.plot_run(stuck).axes[0]
    assert legend(axes)[-1] == "sticks"
    assert axes.collections[0].get_paths()[0].get_extents().x1 == stuck.time[np.argmax(stuck.speed > 0.0) - 1]


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


def test_a_share_given_as_a_cone_has_no_faces_to_show(scene):
    left, right = plots.plot_share(dataclasses.replace(scene, share=po.Cone(po.deg(10), 0.25))).axes
    assert "given as a cone" in words(left)
    assert not left.axison
    assert "β = 10.0°" in words(right)
    assert f"{scene.stiffness / 1e3:.4g} kN/m" in right.get_xlabel()
    assert "r*" not in words(plots.plot_share(dataclasses.replace(scene, medium="mckyes_ali")).axes[1])


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


def test_an_optimum_is_drawn_with_requirements_and_the_limits_of_what_is_drawn(optimum):
    best, run = optimum
    peak = run.peak_deflection
    high = Limit("deflection", "requirement", peak, "", 0.25 * peak, 0.0, False, "m", high=1.25 * peak)
    # An active limit is met to the optimiser's rounding, which must not be shown.
    zero = Limit("loosening", "requirement", 6e-13, "", 6e-13, 1.0, True, "m", low=0.0)
    mean = dataclasses.replace(high, name="mean_deflection", low=0.75 * peak)
    figure = plots.plot_optimum(dataclasses.replace(best, limits=(*best.limits, high, zero, mean)), run)
    figure.savefig(io.BytesIO(), format="png")  # which warns of legends that do not fit
    deflection = figure.axes[3]
    (required,) = (axes for axes in figure.axes if axes.get_title() == "Requirements")
    assert f"limit of the deflection {1250 * peak:.4g} mm" in legend(deflection)
    assert line(deflection, legend(deflection)[-1])[0, 1] == pytest.approx(1250 * peak)
    # Dollar signs are drawn as such: no label contains a formula.
    assert not [axes for axes in figure.axes if "$" in axes.get_xlabel() + axes.get_ylabel()]
    assert required.patches[0].get_width() == pytest.approx(20.0)  # per cent of the limit
    assert words(required).splitlines()[1] == "loosening 0 mm ≥ 0 mm: decides"
    # An active requirement has a mark in the place of a bar.
    marks = [one.get_xydata().tolist() for one in required.get_lines() if one.get_marker() == "D"]
    assert marks == [[[0.0, 1.0]]]


def test_nothing_in_the_picture_of_an_optimum_covers_anything_else(optimum):
    best, run = optimum
    limit = Limit("deflection", "requirement", 0.1, "", 0.02, 0.0, False, "m", high=0.12)
    figure = plots.plot_optimum(dataclasses.replace(best, limits=(*best.limits, limit)), run)
    figure.savefig(io.BytesIO(), format="png")
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    assert len(boxes) == 6
    for one, other in itertools.combinations(boxes, 2):
        over = Bbox.intersection(one, other)
        assert over is None or min(over.width, over.height) < 2.0, (one, other)
    edges = figure.bbox
    assert all(edges.x0 - 1 <= box.x0 and box.x1 <= edges.x1 + 1 and box.y1 <= edges.y1 + 1 for box in boxes[:3])


def test_a_far_limit_is_named_and_does_not_flatten_the_curve(run):
    peak = run.peak_deflection
    near, far = (Limit("deflection", "requirement", peak, "", 0.1, 0.0, False, "m", high=k * peak) for k in (1.2, 20.0))
    plain, close, distant = (plots.plot_run(run, limits).axes[1] for limits in ((), (near,), (far,)))
    assert line(close, legend(close)[-1])[0, 1] == pytest.approx(1.2 * peak)
    assert "above this picture" in legend(distant)[-1]
    assert distant.get_ylim() == pytest.approx(plain.get_ylim(), rel=0.2)
    assert close.get_ylim()[1] > 1.2 * peak


def test_a_sweep_of_one_quantity_is_drawn_in_one_colour(inline):
    varying, constant = (
        po.sweep(lambda at: {"b": at["a"], "c": 3.0}, {"a": [1.0, 2.0, 30.0]}, executor=inline).plot().axes
    )
    assert len(varying.collections[0].get_facecolor()) == 1
    assert (varying.get_xscale(), constant.get_ylim()) == ("log", (0.0, pytest.approx(3.6)))


def test_a_picture_has_one_of_three_formats(tmp_path):
    for name in ("run.jpg", "run", "run.png.txt"):
        with pytest.raises(po.InputError, match=r"must end in \.png, \.svg or \.pdf"):
            plots.save(Figure(figsize=(2, 1)), tmp_path / "new" / name)
    assert list(tmp_path.iterdir()) == []
    assert plots.save(Figure(figsize=(2, 1)), tmp_path / "a" / "RUN.PNG").read_bytes().startswith(b"\x89PNG")
    assert plots.save(Figure(figsize=(2, 1)), tmp_path / "run.svg").read_bytes().startswith(b"<?xml")


def test_a_wedge_field_shows_both_stresses_around_the_body():
    figure = plots.plot_wedge_field([(0.0, 0.0), (0.1, 0.02), (0.2, 0.02)], po.named_soil("serozem"), 2.0)
    labels = " ".join(axes.get_ylabel() for axes in figure.axes)
    assert labels.count("sigma_{yy}") == labels.count("sigma_{xy}") == 1
    for axes in figure.axes[:2]:
        assert axes.get_aspect() == 1.0
        assert axes.get_xlim()[0] < 0.0 < 0.2 < axes.get_xlim()[1]
