"""Fronts as JSON, as tables on the screen and in files, and as pictures."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import plough_opt as po
from plough_opt.app.terminal import print_page
from plough_opt.core.screen import Screen
from plough_opt.studies.tradeoff.front import MissingPoint

# --- files and pictures -------------------------------------------------------------------------------------


def test_table_and_back(broken, tmp_path):
    path = broken.to_csv(tmp_path / "deep" / "front.csv")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    own = [row for row in rows if row["status"] == "front"]
    assert len(rows) == len(broken.points) + len(broken.dominated)
    # repr of a float reads back as the same float.
    assert np.array_equal([[float(row["a [N]"]), float(row["b"])] for row in own], broken.objectives)
    assert np.array_equal([[float(row["x"]), float(row["y"])] for row in own], broken.designs)
    rates = np.array([float(row["rate"] or "nan") for row in own])
    assert np.array_equal(rates, broken.rates, equal_nan=True)
    assert [int(row["part"]) for row in own] == [1 + (k in broken.parts[1]) for k in range(len(own))]


def test_picture(broken, concave, tmp_path):
    alone = Figure().subplots()
    assert broken.plot(alone) is alone
    assert len(alone.figure.axes) == 1
    figure = broken.plot(tmp_path / "front.png")
    assert (tmp_path / "front.png").read_bytes().startswith(b"\x89PNG")
    left, *panels = figure.axes
    varying = [name for name, own in zip("xy", broken.designs.T, strict=True) if np.ptp(own) > 1e-4 * np.max(own)]
    assert [axes.get_ylabel() for axes in panels] == varying
    for axes in panels:
        low, high = axes.get_ylim()
        assert all(low < y < high for line in axes.lines for y in line.get_ydata())
        along = np.concatenate([line.get_xdata() for line in axes.lines if line.get_marker() == "o"])
        assert along == pytest.approx(broken.objectives[:, 0])
    assert all(f"{name} " in figure.get_suptitle() for name in "xy" if name not in varying)
    assert left.get_xlabel() == "a [N]"
    labels = [text.get_text() for text in left.get_legend().get_texts()]
    assert labels[:4] == ["local optima, dominated", "front, part 1", "front, part 2", "hole: no efficient design"]
    lines = {line.get_label(): line.get_xydata() for line in left.lines}
    drawn = np.vstack([lines["front, part 1"], lines["front, part 2"]])
    assert drawn == pytest.approx(broken.objectives)
    assert len(lines["local optima, dominated"]) == len(broken.dominated)
    # Optima far away are neither shown nor named, and a concave front has no knee.
    far = replace(concave, dominated=(replace(concave.points[0], objectives=(9.0, 9.0)),)).plot(Figure().subplots())
    assert [text.get_text() for text in far.get_legend().get_texts()] == ["front"]


# --- tables -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def surface():
    """Surface of three objectives and four variables, with names and values as long as those of a problem file."""
    d = po.Design()
    names = {"share.wedge_angle": 1.0, "share.height": 0.1, "scene.stiffness": 1e5, "scene.tow_speed": 1.0}
    x = [d.variable(n, guess=s / 2, lower=s / 20, upper=2 * s, unit="", log=s > 1.0) / s for n, s in names.items()]
    goals = ("mean_draft", "N", 4321.09876), ("force_rms", "N", 12.3456789), ("loosened_radius", "m", 0.0123456)
    rest = 0.1 + (x[2] - x[0]) ** 2 + (x[3] - x[1]) ** 2
    corners = (0.1, 0.1), (1.0, 0.1), (0.1, 1.0)
    goals = [
        po.Goal(name, size * (rest + (x[0] - a) ** 2 + (x[1] - b) ** 2), unit)
        for (name, unit, size), (a, b) in zip(goals, corners, strict=True)
    ]
    return po.trade_off(d, *goals, points=10, search="near")


def printed(front, width=120):
    """Return the lines of a front."""
    out = io.StringIO()
    print_page(Screen(file=out, width=width), front.page())
    return out.getvalue().splitlines()


def test_a_surface_fits_into_120_characters_with_every_number_whole(surface):
    lines = printed(surface)
    table = [line for line in lines if line.startswith("│")]
    assert len(table) == len(surface.points)
    assert all(len(line) <= 120 for line in table)
    first = [cell.strip() for cell in table[0].split("│")[1:-1]]
    point = surface.points[0]
    shown = [point.objectives[0] / 1e3, point.objectives[1] / 1e3, point.objectives[2]]
    shown += [point.variables[axis.name] / (1e3 if axis.unit == "N/m" else 1.0) for axis in surface.variables]
    assert first[: len(shown)] == [f"{value:.5g}" for value in shown]
    headings = "".join(line for line in lines if line.startswith("┃"))
    assert all(word in headings for word in ("[kN]", "loosened", "stiffness", "(c)", "[%]"))
    (line,) = [line for line in printed(surface, 1000) if line.startswith("Knee")]
    assert f"at {surface.knee.objectives[0] / 1e3:.5g} kN, " in line
    assert (line.count(" N"), len(line.split(";"))) == (0, 3)


def test_picture_of_a_surface(surface, tmp_path):
    # Two points are a part of their own, which has no triangles.
    front = replace(surface, parts=(tuple(range(2, len(surface.points))), (0, 1)))
    space, *panels = [a for a in front.plot(tmp_path / "s.png").axes if a.get_label() != "<colorbar>"]
    assert (space.get_zlabel(), len(space.collections)) == ("loosened radius [m]", 1)
    drawn = np.hstack([line.get_data_3d() for line in space.lines if line.get_label().startswith("front, part")])
    shown = front.objectives / [1e3, 1e3, 1.0]
    assert np.roll(drawn.T, 2, axis=0) == pytest.approx(shown)
    # The third objective, four variables, and an empty place.
    assert [axes.axison for axes in panels] == [True] * 5 + [False]
    colours = [axes.collections[0] for axes in panels[:5]]
    assert np.asarray(colours[0].get_array()) == pytest.approx(shown[:, 2])
    for own in colours:
        assert np.asarray(own.get_offsets()) == pytest.approx(shown[:, :2])
    # The scale of the logarithmic stiffness, in the second column, ends 2 % beyond its values.
    log = colours[1].norm
    assert (log.vmin * 1.02, log.vmax / 1.02) == pytest.approx((front.designs[:, 2].min(), front.designs[:, 2].max()))
    axes = Figure().add_subplot(projection="3d")
    assert front.plot(axes) is axes


def test_failures_are_given_in_words_and_each_reason_once(surface):
    at = [point.objectives for point in surface.points[:3]]
    reasons = ("Infeasible_Problem_Detected: no design near the start meets the requirements",) * 2
    failures = tuple(map(MissingPoint, at, (*reasons, "Odd_Status: the optimiser stopped without an optimum")))
    lines = [line for line in printed(replace(surface, failures=failures), 1000) if "No certified design" in line]
    assert len(lines) == 2
    assert lines[0].endswith(": no design near the start meets the requirements.")
    assert lines[0].count(" kN and ") + lines[0].count(" m;") >= 2
    assert "_Problem_Detected" not in "".join(lines)
    assert "Odd_Status" not in "".join(lines)
