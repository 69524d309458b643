"""Fronts as JSON, as tables and as pictures."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import plough_opt as po


def test_json_and_back(broken, tmp_path):
    path = broken.save(tmp_path / "deep" / "front.json")
    back = po.TradeOff.load(path)
    assert back == po.load(path) == replace(broken, versions=dict(broken.versions))
    assert np.array_equal(back.designs, broken.designs)
    text = json.loads(path.read_text(encoding="utf-8"))
    assert text["schema"] == 2
    assert text["kind"] == "trade-off"
    assert text["versions"]["plough_opt"]


def test_a_front_of_one_design_comes_back(tmp_path, plane):
    d, x, y = plane
    front = po.trade_off(d, 1.0 + x**2 + y**2, 3.0 + 2.0 * x**2 + y**2, points=21)
    assert po.TradeOff.load(front.save(tmp_path / "one.json")).points == front.points


def test_files_that_are_no_front(tmp_path):
    path = tmp_path / "other.json"
    path.write_text('{"schema": 2, "kind": "run"}', encoding="utf-8")
    with pytest.raises(po.InputError, match="is not a trade-off of this version"):
        po.TradeOff.load(path)
    with pytest.raises(po.InputError, match="cannot be read"):
        po.TradeOff.load(tmp_path / "none.json")


def test_places_that_cannot_be_written(convex, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    for write in (convex.save, convex.to_csv):
        with pytest.raises(po.InputError, match="cannot be written"):
            write(tmp_path / "file" / "front")


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


def test_picture(broken, tmp_path):
    figure = broken.plot(tmp_path / "front.png")
    assert (tmp_path / "front.png").read_bytes().startswith(b"\x89PNG")
    left, *panels = figure.axes
    varying = [name for name, own in zip("xy", broken.designs.T, strict=True) if np.ptp(own) > 1e-4 * np.max(own)]
    assert [axes.get_ylabel() for axes in panels] == varying
    assert all(f"{name} " in figure.get_suptitle() for name in "xy" if name not in varying)
    assert left.get_xlabel() == "a [N]"
    labels = [text.get_text() for text in left.get_legend().get_texts()]
    assert labels[:4] == ["local optima, dominated", "front, part 1", "front, part 2", "hole: no efficient design"]
    lines = {line.get_label(): line.get_xydata() for line in left.lines}
    drawn = np.vstack([lines["front, part 1"], lines["front, part 2"]])
    assert drawn == pytest.approx(broken.objectives)
    assert len(lines["local optima, dominated"]) == len(broken.dominated)


def test_picture_on_given_axes(convex):
    axes = Figure().subplots()
    assert convex.plot(axes) is axes
    assert len(axes.figure.axes) == 1
    assert axes.lines[0].get_xydata() == pytest.approx(convex.objectives)


def test_picture_of_an_unknown_kind(convex, tmp_path):
    with pytest.raises(po.InputError, match="no known picture format"):
        convex.plot(tmp_path / "front.bmp")
