"""What results show of themselves: the command line's tables as text and in notebooks, pictures and data frames."""

import math
import re
import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy import stats

import plough_opt as po
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import customary
from plough_opt.studies.accuracy.contest import Entry

pandas = pytest.importorskip("pandas")


def scene_of(height=0.25, stiffness=1e5, angle=30.0):
    share = po.Wedge(po.deg(angle), po.deg(15), height)
    effects = po.Effects(damping=400.0, strength_wave=po.StrengthWave(0.3, 0.2))
    return po.Scene(po.named_soil("serozem"), share, stiffness, 20.0, 2.0, effects)


@pytest.fixture(scope="module")
def best():
    d = po.Design()
    height = d.variable("height", guess=0.25, lower=0.1, upper=0.5, unit="m")
    stiffness = d.variable("stiffness", guess=1e5, lower=1e4, upper=1e6, unit="N/m", log=True)
    scene = scene_of(height, stiffness)
    run = po.simulate(scene, 1.0)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
    d.require("loosened radius", scene.loosened_radius, at_least=0.12, unit="m")
    return d.solve(search="near"), run


@pytest.fixture(scope="module")
def front():
    d = po.Design()
    x = d.variable("x", guess=0.5, lower=0.0, upper=1.0, unit="m")
    draft = po.Goal("draft", 5000.0 * (0.1 + x**2), "N")
    return po.trade_off(d, draft, po.Goal("radius", 0.1 + (1.0 - x) ** 2, "m"), points=5, title="a front")


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    over = {"a": [1.0, 2.0, 3.0], "b": [0.0, 10.0]}
    return po.sweep(squared, over, workers=1, store=tmp_path_factory.mktemp("sweep") / "s.db", units={"force": "N"})


def squared(point):
    if point["a"] == 2.0 and point["b"] == 10.0:
        raise ValueError("too much")
    return {"force": 1e3 * point["a"] ** 2 + point["b"]}


@pytest.fixture(scope="module")
def batch():
    height = ca.MX.sym("height")
    many = po.Batch(scene_of(height), 0.3, [height])
    return many(np.array([[0.2], [0.3]]))


@pytest.fixture(scope="module")
def fit():
    angles = np.radians([20.0, 25.0, 30.0, 35.0])
    scenes = [replace(scene_of(angle=math.degrees(a)), effects=po.Effects(motion=False)) for a in angles]
    drafts = [po.simulate(scene, 0.2).mean_draft for scene in scenes]
    measured = po.Measurements("mean_draft", drafts, {"share.wedge_angle": angles}, sigma=20.0)
    return po.calibrate(scenes[0], [measured], {"soil.cohesion": (1e3, 8e4)}, duration=0.2)


@pytest.fixture(scope="module")
def study():
    entries = tuple(
        Entry("integrator", name, "", seconds, 0.1, {"averages": error})
        for name, seconds, error in (("a", 1e-3, 1e-3), ("b", 2e-3, 1e-7))
    )
    return po.AccuracyStudy("cost", 1.0, 1e-6, entries, {"motion": 1e-17}, ("a note",), versions={"casadi": "3"})


@pytest.fixture(scope="module")
def robust():
    field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.lognorm(0.3, scale=20e3))
    cone = po.Cone(po.deg(10), 0.2)
    robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
    robust.expected("draft")
    return robust


def test_an_optimum_prints_its_tables(best):
    text = str(best[0])
    assert len(text) < 2500
    for words in ("Best design: objective", "(solved)", "height", "loosened radius", "decides", " m "):
        assert words in text, words
    assert "array(" not in text
    # The value printed is the one returned.
    assert f"{best[0].variables['height']:.5g}"[:6] in text
    assert str(best[0].local_optima[0]).count("\n") >= 4


def test_a_limit_that_decides_has_no_margin(best):
    (limit,) = [limit for limit in best[0].limits if limit.kind == "requirement"]
    assert limit.active
    assert limit.margin_text() == "0 m"
    row = next(line for line in str(best[0]).splitlines() if line.startswith("  loosened radius"))
    assert re.search(r"at least 0.12 m +0.12 m +0 m +decides$", row)


def test_a_run_prints_its_table(best):
    run = best[0](best[1])
    text = str(run)
    assert re.search(rf"mean draft +{run.mean_draft / 1e3:.5g} kN", text)
    assert re.search(rf"RMS of the mount force +{run.force_rms / 1e3:.5g} kN", text)
    # Deflections of some and of some tens of millimetres stand beside each other in one unit.
    assert len(set(re.findall(r"deflection +[-0-9.e]+ (\w+)", text))) == 1
    assert all(f"Note: {note}." in text for note in run.warnings)
    assert str(best[1]) == "<Run: expressions of a scene's symbols>"


@pytest.mark.parametrize("name", ["best", "front", "swept", "batch", "fit", "study", "robust"])
def test_every_result_shows_itself_briefly(name, request):
    result = request.getfixturevalue(name)
    result = result[0] if isinstance(result, tuple) else result
    assert len(repr(result)) < 200
    assert "\n" not in repr(result)
    text = str(result)
    assert text.count("\n") >= 2
    assert not re.search(r"array\(|MX\(|object at 0x", text)
    html = result._repr_html_()
    assert html.count("<table>") == html.count("</table>") >= 1
    assert ('src="data:image/png;base64,' in html) == (name != "robust")


def test_a_symbolic_run_shows_no_numbers(best):
    assert "expressions" in best[1]._repr_html_()
    with pytest.raises(po.InputError, match="symbolic run"):
        best[1].plot()
    with pytest.raises(po.InputError, match="symbolic run"):
        best[1].to_dataframe()


def test_frames_hold_the_numbers_with_their_units(best, front, swept, batch, fit, study):
    run = best[0](best[1])
    frame = run.to_dataframe()
    np.testing.assert_array_equal(frame["mount_force"], run.mount_force)
    assert frame.attrs["units"]["mount_force"] == "N"
    frame = best[0].to_dataframe()
    assert frame.loc[0, "height"] == best[0].variables["height"]
    assert frame.attrs["units"] == {"height": "m", "stiffness": "N/m"}
    assert list(best[0].local_optima[0].to_dataframe()["name"]) == [limit.name for limit in best[0].limits]
    np.testing.assert_array_equal(front.to_dataframe()[["draft", "radius"]], front.objectives)
    assert front.to_dataframe().attrs["units"] == {"draft": "N", "radius": "m", "x": "m"}
    frame = swept.to_dataframe()
    assert list(frame["force"][:3]) == [1000.0, 1010.0, 4000.0]
    assert math.isnan(frame["force"][3])
    assert frame.attrs["units"] == {"force": "N"}
    np.testing.assert_array_equal(batch.to_dataframe()["mean_draft"], batch.mean_draft)
    np.testing.assert_array_equal(fit.to_dataframe()["observed"], fit.observed)
    assert len(study.to_dataframe()) == len(study.entries)


def test_a_frame_without_pandas_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(po.InputError, match=r"pip install 'plough_opt\[pandas\]'"):
        data_frame({"x": [1.0]}, {"x": "m"})


@pytest.mark.parametrize("name", ["best", "front", "swept", "batch", "fit", "study"])
def test_every_result_writes_its_picture(name, request, tmp_path):
    result = request.getfixturevalue(name)
    result = result[0] if isinstance(result, tuple) else result
    path = tmp_path / "picture.svg"
    assert result.plot(path).axes
    assert path.read_text(encoding="utf-8").lstrip().startswith("<?xml")
    with pytest.raises(po.InputError, match="no known picture format"):
        result.plot(tmp_path / "picture.txt")


def test_designs_are_drawn_between_their_limits(best):
    figure = best[0].local_optima[0].plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["loosened radius [m]", "height [m]", "stiffness [kN/m]"]
    places = {line.get_marker(): line.get_xdata()[0] for line in figure.axes[0].lines if len(line.get_xdata())}
    assert places == {"o": best[0].limits[0].value, "None": 0.12}


def test_what_a_sweep_prints(swept):
    text = str(swept)
    assert "6 points, 1 failed" in text
    assert re.search(r"force +1 kN +a 1 +9\.01 kN +a 3\n +b 0 +b 10", text)
    assert "failed at a = 2, b = 10: ValueError: too much" in text


def test_values_of_a_kind_have_one_unit():
    assert customary("N", 12.0, 1200.0).text(12.0) == "0.012 kN"
    assert customary("m", 0.003, 0.05).text(0.003) == "0.003 m"
    assert customary("m", 0.003, -0.004).text(0.003) == "3 mm"
    assert customary("N", math.inf, math.nan).text(2.0) == "2 N"


def test_texts_of_a_user_are_no_markup():
    grid = Grid.of("<b>title</b>", "name", "value")
    grid.row("[bold]x[/] & y", "two\nlines")
    page = Page("<script>", (grid, "1 < 2"), ("a < b",), "end", "[red]")
    html = page.html()
    assert "<script>" not in html
    assert "&lt;b&gt;title" in html
    assert "two<br>lines" in html
    assert "[bold]x[/] & y" in str(page)
    assert str(grid).splitlines()[-1].strip() == "lines"
