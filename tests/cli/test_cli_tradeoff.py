"""`plough-opt tradeoff`, and the [trade_off] table of a problem file."""

import json

import numpy as np
import pytest
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS

import plough_opt as po
from plough_opt.studies.tradeoff.surface import distances

LOOSENING = PROBLEMS / "draft_against_loosening.toml"
BRIEF = ("--set", "scene.duration=0.1 s", "--points", "5")


def test_table_and_files(tmp_path):
    picture, table, output = tmp_path / "front.svg", tmp_path / "front.csv", tmp_path / "deep" / "front.json"
    done = call("tradeoff", LOOSENING, *BRIEF, "--plot", picture, "--csv", table, "--output", output)
    assert done.status == 0
    assert "Front of 5 designs" in done.out
    assert "Limits that decide every design: half angle." in done.out
    # A warning that holds for every design is given once, whatever its figures.
    assert done.out.count("Note: ") == 1, done.out
    assert "Note: at 5 of 5 designs: ambient pressure (101.3 kPa) carries 73 % of the static draft" in done.out
    assert "1 % costs: of loosened radius for 1 % less mean draft" in done.out
    for path in (picture, table, output):
        assert f"wrote {path}" in done.err.replace("\n", "")
    assert picture.read_text(encoding="utf-8").lstrip().startswith("<?xml")
    front = po.TradeOff.load(output)
    assert front.title == "Draft against loosened radius on serozem"
    # The last position is that of an anchor on a bound, where no other design lies.
    assert front.failures == ()
    assert front.objectives[0, 1] == pytest.approx(0.08, rel=1e-6)
    assert len(table.read_text(encoding="utf-8").splitlines()) == 1 + len(front.points) + len(front.dominated)


def test_json():
    front = json.loads(printed("tradeoff", LOOSENING, *BRIEF, "--json", "--set", "effects.strength_wave.amplitude=0"))
    assert front["kind"] == "trade-off"
    assert [goal["maximise"] for goal in front["goals"]] == [False, True]
    # Without waves the draft is steady and proportional to the height squared, the radius to the height. So 1 % less
    # draft costs half a per cent of the radius.
    for point in front["points"][1:-1]:
        assert point["rate"] * point["objectives"][0] / point["objectives"][1] == pytest.approx(0.5, rel=1e-6)


def test_a_trading_file_is_valid_and_says_what_next():
    assert "plough-opt tradeoff" in printed("check", PROBLEMS / "draft_oscillation_loosening.toml").replace("\n", " ")


def test_a_problem_without_solution():
    done = call("tradeoff", LOOSENING, *BRIEF, "--set", "require.loosened_radius.at_least=2 m")
    assert done.status == 1
    assert "'loosened_radius' (at least 2 m) fails by" in done.err


@pytest.mark.slow
def test_the_shipped_surface_is_even_and_certified():
    front = po.read_problem(PROBLEMS / "draft_oscillation_loosening.toml").trade_off()
    assert len(front.points) > 25
    # One anchor is apart: the widest share with the least draft, stiff and slow. Stiff designs between it and the rest
    # have less than 1e-4 less draft than softer ones, too little for points of their own.
    body, (alone,) = front.parts
    assert len(body) == len(front.points) - 1
    assert front.points[alone].branch == "stiff"
    assert front.objectives[alone, 2] == pytest.approx(0.22, rel=1e-9)
    assert max(point.gap for point in front.points) < 1e-8
    assert max(point.residual for point in front.points) < 1e-9
    assert {point.branch for point in front.points} == {"soft", "stiff"}
    # All are as blunt as allowed: a slender share pays in friction twice what it saves in oscillation.
    assert all("half_angle" in point.active for point in front.points)
    normalised = front.objectives * [1.0, 1.0, -1.0] / np.ptp(front.objectives, axis=0)
    apart = distances(normalised) + np.eye(len(normalised))
    # 45 positions lie an eighth of the range apart, other points at 0.7 of that. Anchors stay, however near.
    assert np.min(apart) > 0.5 / 8.0
    assert np.max(np.min(apart[list(body)], axis=1)) < 1.75 / 8.0
