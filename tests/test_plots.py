"""Pictures: what they show, in which units, and files that are whole or not there at all."""

import dataclasses
import io

import matplotlib.image
import matplotlib.pyplot
import numpy as np
import pytest
from matplotlib.figure import Figure

import plough_opt as po
from plough_opt.app import plots
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display
from plough_opt.design import Limit


@pytest.fixture(scope="module")
def scene():
    share = po.Wedge(angle=po.deg(25), chisel_angle=po.deg(15), height=0.25)
    effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.6))
    return po.Scene(po.named_soil("serozem"), share, stiffness=5e4, mass=23.0, tow_speed=2.0, effects=effects)


@pytest.fixture(scope="module")
def run(scene):
    return po.simulate(scene, duration=0.5, outputs=50)


@pytest.fixture(scope="module")
def optimum():
    """Return an optimum, with a scan over a log-scaled stiffness, and its run."""
    design = po.Design()
    stiffness = design.variable("mount", guess=5e4, lower=5e3, upper=5e5, unit="N/m", log=True)
    share = po.Wedge(angle=po.deg(39), chisel_angle=po.deg(15), height=0.2)
    soil = po.Soil(1400.0, 0.8, 15e3, po.deg(30), 0.5, ambient_pressure=10e3)
    effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.6))
    found = po.simulate(po.Scene(soil, share, stiffness, 22.0, 2.0, effects), 1.0, outputs=100)
    design.minimise(found.mean_draft / 1e3 + found.force_rms / 1e3)
    best = design.solve()
    return best, best(found)


@pytest.fixture
def figure():
    small = Figure(figsize=(2, 1))
    small.subplots().plot([0, 1], [0, 1])
    return small


def labels(axes):
    return axes.get_xlabel(), axes.get_ylabel()


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def words(axes):
    """Return all that is written inside the axes."""
    texts = [text.get_text() for text in axes.texts]
    return "\n".join(texts if axes.get_legend() is None else texts + legend(axes))


def panel(figure, title):
    """Return the axes with a title."""
    return next(axes for axes in figure.axes if axes.get_title() == title)


def line(axes, label):
    """Return the data of the line with a label."""
    return next(found.get_xydata() for found in axes.get_lines() if found.get_label() == label)


class TestRun:
    """plot_run: force, deflection and speed over time."""

    def test_its_lines_are_the_run_in_the_units_of_its_axes(self, run):
        force, deflection, speed = plots.plot_run(run).axes
        assert matplotlib.pyplot.get_fignums() == []
        assert (force.get_ylabel(), deflection.get_ylabel()) == ("force [kN]", "deflection [m]")
        assert labels(speed) == ("time [s]", "speed [m/s]")
        np.testing.assert_allclose(line(force, "mount force"), np.c_[run.time, run.mount_force / 1000])
        np.testing.assert_allclose(line(force, "soil resistance"), np.c_[run.time, run.soil_resistance / 1000])
        np.testing.assert_allclose(deflection.get_lines()[0].get_xydata(), np.c_[run.time, run.deflection])
        np.testing.assert_allclose(line(speed, "share"), np.c_[run.time, run.speed])
        np.testing.assert_allclose(line(speed, "strut")[:, 1], 2.0)

    def test_its_legend_has_the_mean_and_the_rms(self, run):
        force = plots.plot_run(run).axes[0]
        assert f"mean draft {run.mean_draft / 1000:.3g} kN" in legend(force)
        assert f"± RMS {run.force_rms / 1000:.3g} kN" in legend(force)

    def test_it_is_in_the_units_of_its_question_under_its_title(self, run):
        origin = Origin("Two shares", {"deflection": Display("cm", 0.01), "scene.tow_speed": Display("km/h", 1 / 3.6)})
        figure = plots.plot_run(dataclasses.replace(run, origin=origin))
        assert figure.get_suptitle() == "Two shares\nserozem, 7.2 km/h"
        np.testing.assert_allclose(line(figure.axes[1], "deflection")[:, 1], 100.0 * run.deflection)
        assert figure.axes[2].get_ylabel() == "speed [km/h]"

    def test_legends_hide_no_line(self, run):
        figure = plots.plot_run(run)
        figure.savefig(io.BytesIO(), format="png")
        for axes in figure.axes:
            box = axes.get_legend().get_window_extent()
            for drawn in axes.get_lines():
                assert not any(box.contains(*point) for point in axes.transData.transform(drawn.get_xydata()))

    def test_panels_that_stay_the_same_are_left_out(self, scene):
        still = dataclasses.replace(scene, effects=dataclasses.replace(scene.effects, motion=False))
        force, deflection = plots.plot_run(po.simulate(still, 0.5, outputs=40)).axes
        assert (force.get_ylabel(), deflection.get_ylabel()) == ("force [kN]", "deflection [m]")


class TestShare:
    """plot_share: the wedge's faces beside the equivalent cone."""

    def test_it_shows_wedge_and_cone_to_one_scale(self, scene):
        figure = plots.plot_share(scene)
        assert isinstance(figure, Figure)
        wedge, cone = figure.axes
        assert "Faces" in wedge.get_title()
        assert "cone" in cone.get_title()
        assert wedge.get_aspect() == cone.get_aspect() == 1.0
        assert wedge.get_ylabel() == "[m]"
        assert wedge.get_ylim() == cone.get_ylim()

    def test_it_says_the_angles_and_the_loosened_radius(self, scene):
        wedge, cone = plots.plot_share(scene).axes
        assert "λ = 25.0°" in words(wedge)
        assert f"β = {np.degrees(scene.cone.half_angle):.1f}°" in words(cone)
        assert f"r* = {po.loosened_radius(scene.cone, scene.soil):.3f} m" in words(cone)

    def test_its_faces_have_the_surface_of_the_share(self, scene):
        wedge = plots.plot_share(scene).axes[0]
        corners = [patch.get_xy() for patch in wedge.patches]
        (x0, y0), (x1, y1), (x2, y2) = corners[0][:3]
        one_face = abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)) / 2
        assert len(corners) == 2
        assert 2 * one_face == pytest.approx(scene.share.area, rel=1e-12)

    def test_a_share_given_as_a_cone_has_no_faces_to_show(self, scene, tmp_path):
        figure = plots.plot_share(dataclasses.replace(scene, share=po.Cone(po.deg(10), 0.25)))
        left, right = figure.axes
        assert "given as a cone" in words(left)
        assert not left.axison
        assert "β = 10.0°" in words(right)
        assert plots.save(figure, tmp_path / "cone.png").stat().st_size > 1000


class TestOptimum:
    """plot_optimum: the share, the response and the search."""

    def test_it_shows_share_response_and_search(self, optimum):
        figure = plots.plot_optimum(*optimum)
        assert isinstance(figure, Figure)
        wedge, _, force, deflection, search = figure.axes
        assert "Faces" in wedge.get_title()
        assert labels(force) == ("time [s]", "force [N]")
        assert labels(deflection) == ("time [s]", "deflection [mm]")
        assert labels(search) == ("mount [kN/m]", "objective")

    def test_its_search_is_on_a_log_scale_with_the_best_design_marked(self, optimum):
        best, run = optimum
        search = plots.plot_optimum(best, run).axes[4]
        assert search.get_xscale() == "log"
        np.testing.assert_allclose(line(search, "best"), [[best.variables["mount"] / 1e3, best.objective]])

    def test_every_local_optimum_is_marked(self, optimum):
        best, run = optimum
        two = (best.local_optima[0], dataclasses.replace(best.local_optima[0], variables={"mount": 1e5}, objective=2.0))
        search = plots.plot_optimum(dataclasses.replace(best, local_optima=two), run).axes[4]
        np.testing.assert_allclose(line(search, "other local optima"), [[1e2, 2.0]])

    def test_it_shows_requirements_and_the_limits_of_what_it_draws(self, optimum):
        best, run = optimum
        peak = run.peak_deflection
        high = Limit("deflection", "requirement", peak, "", 0.25 * peak, 0.0, False, "m", high=1.25 * peak)
        figure = plots.plot_optimum(dataclasses.replace(best, limits=(*best.limits, high)), run)
        required, deflection = panel(figure, "Requirements"), figure.axes[3]
        assert f"limit of the deflection {1250 * peak:.4g} mm" in legend(deflection)
        assert line(deflection, legend(deflection)[-1])[0, 1] == pytest.approx(1250 * peak)
        assert required.patches[0].get_width() == pytest.approx(20.0)  # per cent of the limit
        assert "deflection" in words(required)
        # A limit that decides is met to the optimiser's rounding, which no one wants to read.
        zero = Limit("loosening", "requirement", 6e-13, "", 6e-13, 1.0, True, "m", low=0.0)
        required = panel(
            plots.plot_optimum(dataclasses.replace(best, limits=(*best.limits, zero)), run), "Requirements"
        )
        assert words(required) == "loosening 0 mm ≥ 0 mm: decides"


class TestSave:
    """save: a whole file of the format that its ending names, or none."""

    def test_a_png_has_the_size_of_the_figure(self, run, tmp_path):
        path = plots.save(plots.plot_run(run), tmp_path / "run.png")
        assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
        image = matplotlib.image.imread(path)
        assert image.shape[:2] == (1027, 1170)  # 7.9 by 9 inches of 130 dots
        assert image[..., :3].std() > 0.05

    @pytest.mark.parametrize("name", ["run.jpg", "run", "run.png.txt", "run.", ".png", "png"])
    def test_another_format_is_refused_with_those_there_are(self, figure, tmp_path, name):
        with pytest.raises(po.InputError, match=r"picture format: end its name in one of \.png, \.svg, \.pdf"):
            plots.save(figure, tmp_path / "new" / name)
        assert list(tmp_path.iterdir()) == []
        assert plots.save(figure, tmp_path / "a" / "RUN.PNG").read_bytes().startswith(b"\x89PNG")

    def test_a_failing_save_leaves_an_existing_file_as_it_was(self, figure, tmp_path, monkeypatch):
        path = tmp_path / "run.png"
        path.write_text("old", encoding="utf-8")

        def fill_the_disk(target, **_):
            target.write(b"\x89PNG half of it")
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(figure, "savefig", fill_the_disk)
        with pytest.raises(po.InputError, match=r"the plot '.*run\.png' cannot be written: no space left"):
            plots.save(figure, path)
        assert path.read_text(encoding="utf-8") == "old"
        assert [found.name for found in tmp_path.iterdir()] == ["run.png"]


class TestWedgeField:
    def test_it_draws_both_stresses_around_the_body(self):
        nodes = [(0.0, 0.0), (0.1, 0.02), (0.2, 0.02)]
        figure = plots.plot_wedge_field(nodes, po.named_soil("serozem"), 2.0)
        labels = [axes.get_ylabel() for axes in figure.axes]
        assert sum("sigma_{yy}" in label for label in labels) == 1
        assert sum("sigma_{xy}" in label for label in labels) == 1
        for axes in figure.axes[:2]:
            assert axes.get_aspect() == 1.0
            assert axes.get_xlim()[0] < 0.0
            assert axes.get_xlim()[1] > 0.2
