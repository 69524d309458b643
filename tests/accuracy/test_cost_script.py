"""The script that studies five scenes: its scenes, picture and output."""

import dataclasses
import math

import matplotlib.image
import pytest
from helpers.scripts import imported

import plough_opt as po


@pytest.fixture
def cost():
    with imported("accuracy_cost") as module:
        yield module


def test_the_scenes_are_what_they_are_called(cost):
    smooth, stiff, resonant, sticks, entry = cost.scenes().values()
    assert float(stiff[0].natural_frequency) * stiff[1] / (2.0 * math.pi) == pytest.approx(1400, rel=0.05)
    assert float(resonant[0].natural_frequency) == pytest.approx(float(resonant[0].wave_frequency), rel=1e-12)
    assert set(po.simulate(*sticks, outputs=300).mode) == {0.0, 1.0}
    travel = po.simulate(*entry).travel
    assert travel[0] == 0.0 < entry[0].cone.height < travel[-1]
    assert float(smooth[0].natural_frequency) * smooth[1] < 100


@pytest.mark.slow
def test_short_versions_of_the_scenes(cost, tmp_path, monkeypatch, capsys):
    soft = {name: dataclasses.replace(s, stiffness=min(s.stiffness, 2e5)) for name, (s, _) in cost.scenes().items()}
    short = {name: (soft[name], duration / 20.0) for name, (_, duration) in cost.scenes().items()}
    monkeypatch.setattr(cost, "scenes", lambda: short)
    cost.main(["--thin", "--folder", str(tmp_path)])
    printed = capsys.readouterr().out
    for words in ("averages of the motion: for 1e-06 take ", "averages of the motion: relative error against time"):
        assert printed.count(words) == 5
    assert "cannot locate events" in printed
    assert "casadi 3" in printed
    assert matplotlib.image.imread(tmp_path / "accuracy_cost.png").shape[:2] == (1014, 1560)
    for word, name in zip(("smooth", "stiff", "resonant", "stick", "entry"), cost.scenes(), strict=True):
        study = po.AccuracyStudy.load(tmp_path / f"accuracy_cost_{word}.json")
        assert study.title == name
        assert study.advice in printed
