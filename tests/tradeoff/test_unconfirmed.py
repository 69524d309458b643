"""Unconfirmed designs: if an optimum is a needle, the best designs that can be made lie at its edge."""

import csv

import casadi as ca
import numpy as np
import pytest
from helpers.small_designs import design
from matplotlib.figure import Figure

import plough_opt as po

# The search around needles takes a minute.
pytestmark = pytest.mark.slow

# Depth and width of a dip in the second objective. The tolerance, 0.3 % of a range of 1, is 1.5 times the width.
DEPTH, WIDTH = 0.5, 0.002


@pytest.fixture(scope="module")
def front():
    """Front of x against 2 - x, with lower values in a dip along z that is too narrow to hit."""
    d, x, z = design(x=(0.4, 0.0, 1.0), z=(0.47, 0.0, 1.0))
    dip = DEPTH * ca.exp(-(((z - 0.5) / WIDTH) ** 2))
    return po.trade_off(d, po.Goal("a", x), po.Goal("b", 2.0 - x - dip), points=9)


def test_designs_at_the_edge_of_a_needle_are_part_of_the_front_and_marked(front):
    assert len(front.needles) > 2
    for needle in front.needles:
        # A design is better than 2 - x only in the dip.
        assert abs(needle.variables["z"] - 0.5) < 3.0 * WIDTH
    edge = [point for point in front.points if not point.confirmed]
    assert len(edge) > 2
    for point in edge:
        x, z = point.variables["x"], point.variables["z"]
        assert not point.needle
        assert point.rate is None
        assert point.doubt == ""
        # Objectives are those of a simulation, to rounding.
        assert point.objectives == pytest.approx((x, 2.0 - x - DEPTH * np.exp(-(((z - 0.5) / WIDTH) ** 2))), rel=1e-12)
        # 5 % of a value of at most 2 is the limit for a needle.
        assert point.medians[1] - point.objectives[1] <= 0.05 * 2.0
    assert any(f"{len(edge)} of {len(front.points)} designs are unconfirmed" in note for note in front.notes)
    assert not any("are needles" in note and note.startswith(f"{len(front.points)} of") for note in front.notes)


def test_files_tables_and_pictures_mark_them(front, tmp_path):
    count = sum(not point.confirmed for point in front.points)
    with front.to_csv(tmp_path / "front.csv").open(encoding="utf-8", newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)].count("unconfirmed") == count
    assert po.load(front.save(tmp_path / "front.json")).points == front.points
    assert str(front).count("unconfirmed") > 1
    axes = front.plot(Figure().subplots())
    (drawn,) = [line for line in axes.lines if line.get_label() == "unconfirmed"]
    assert len(drawn.get_xdata()) == count
