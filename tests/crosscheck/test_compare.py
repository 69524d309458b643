"""Comparison of draft models: arguments, estimates, table and picture; and the numbers in docs/crosscheck.md."""

import dataclasses
import io
import math
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from rich.console import Console

import plough_opt as po
from plough_opt.laws import LAWS
from plough_opt.laws.cones import spherical_cavity_draft
from plough_opt.laws.tines import POINTS, TEXTURES, asabe_draft, godwin_draft, mckyes_ali_draft
from plough_opt.studies.crosscheck import Tine, compare

PROBLEMS = Path(__file__).parents[2] / "problems"
PAGE = (Path(__file__).parents[2] / "docs" / "crosscheck.md").read_text(encoding="utf-8")
SPEEDS = [3.0 / 3.6, 9.0 / 3.6]
SOIL = po.named_soil("serozem")
SHARE = po.Wedge(angle=po.deg(39.1), chisel_angle=po.deg(15.0), height=0.254)


def scene(soil=SOIL, share=SHARE, medium="plastic", **effects):
    return po.Scene(soil, share, 5e4, 25.0, 2.0, po.Effects(**effects), medium=medium)


@pytest.fixture(scope="module")
def full():
    """Return a comparison with all arguments given."""
    return compare(
        scene(), depth=[0.25, 0.4], width=0.08, rake_angle=po.deg(45.0), texture="medium", speeds=[1.0, 2.5],
        rupture_ratio=2.3, surcharge=1e3, adhesion=2e3,
    )  # fmt: skip


def row(comparison, model, depth=None):
    (found,) = (r for r in comparison.others if r.model == model and (depth is None or r.depth == depth))
    return found


def printed(comparison):
    stream = io.StringIO()
    Console(file=stream, width=160).print(comparison.table())
    return stream.getvalue()


def test_every_row_is_its_models_draft(full):
    assert full.depths == (0.25, 0.4)
    for depth in full.depths:
        tine = Tine(0.08, depth, po.deg(45.0), 1e3, 2e3)
        for model, draft in (
            ("ASABE D497, narrow, medium", lambda v, d=depth: asabe_draft(d, v, "medium")),
            ("McKyes-Ali", lambda v, t=tine: mckyes_ali_draft(SOIL, t, v)),
            ("universal earthmoving equation", lambda v, t=tine: godwin_draft(SOIL, t, v, rupture_ratio=2.3)),
        ):
            # The law splits the formula into a static part and one with the squared speed.
            assert row(full, model, depth).drafts == pytest.approx([draft(v) for v in (1.0, 2.5)], rel=4e-15)
    for other in full.others:
        assert full.ratios(other) == pytest.approx(np.array(other.drafts) / full.own.drafts, rel=1e-15)
    cavity = row(full, "spherical cavity (Forrestal-Luk)")
    assert cavity.depth is None
    assert cavity.drafts == tuple(spherical_cavity_draft(SHARE.equivalent_cone(), SOIL, v) for v in (1.0, 2.5))
    assert not full.refusals


def test_its_own_row_is_the_quasi_static_mean_draft(full):
    """Averaged over whole waves: in 2 s at 1 and 2.5 m/s the share passes 10 and 25 wavelengths of 0.2 m."""
    wavy = scene(motion=False, strength_wave=po.StrengthWave(0.3, 0.2))
    found = compare(wavy, speeds=(1.0, 2.5)).own.drafts
    runs = [po.simulate(dataclasses.replace(wavy, tow_speed=v), duration=2.0).mean_draft for v in (1.0, 2.5)]
    assert found == pytest.approx(runs, rel=1e-12)
    assert full.own.drafts == pytest.approx(found, rel=1e-14)


def test_estimates_are_reported_with_their_values(full):
    assert "surcharge 1 kPa and adhesion 2 kPa" in " ".join(full.estimates)
    found = compare(scene())
    base = 2 * SHARE.height * math.tan(SHARE.equivalent_cone().half_angle)
    text = " ".join(found.estimates)
    for sentence in (
        "working depth 0.254 m: the share's height",
        f"tool width {base:.3g} m: base diameter of the equivalent cone",
        "rake angle 15 deg: the share's chisel angle",
        "soil texture: none was given",
        "a plane wedge instead of the charts",
    ):
        assert sentence in text
    assert [round(3.6 * v, 9) for v in found.speeds] == [3.0, 5.0, 7.0, 7.2, 9.0]
    assert [r.model for r in found.others[:3]] == [f"ASABE D497, narrow, {t}" for t in ("fine", "medium", "coarse")]
    expected = [godwin_draft(SOIL, Tine(base, 0.254, po.deg(15.0)), v) for v in found.speeds]
    assert row(found, "universal earthmoving equation").drafts == pytest.approx(expected, rel=1e-14)


def test_a_model_outside_its_domain_gives_nan_and_a_reason():
    found = compare(scene(), depth=0.25, width=0.08, rake_angle=po.deg(15.0), speeds=[2.0, 6.0])
    flat = row(found, "McKyes-Ali")
    assert all(map(math.isnan, flat.drafts))
    assert "end of the possible angles" in flat.refusal
    fast = row(found, "Swick-Perumpral")
    assert [math.isnan(draft) for draft in fast.drafts] == [False, True]
    assert any("Swick-Perumpral at 0.25 m: speed = 6" in text for text in found.refusals)
    assert "-" in printed(found)


def test_a_cone_needs_a_rake_angle():
    cone = scene(share=po.Cone(po.deg(12.0), 0.25))
    assert "give rake_angle" in row(compare(cone), "Swick-Perumpral").refusal
    assert not row(compare(cone, rake_angle=po.deg(60.0)), "Swick-Perumpral").refusal


def test_switching_ambient_pressure_off_affects_the_spherical_cavity_too():
    found = compare(scene(ambient_pressure=False), speeds=[2.0])
    bare = dataclasses.replace(SOIL, ambient_pressure=0.0)
    expected = spherical_cavity_draft(SHARE.equivalent_cone(), bare, 2.0)
    assert row(found, "spherical cavity (Forrestal-Luk)").drafts == (expected,)


LEVEL = po.Soil.from_cone_index(2e6, soil=po.named_soil("firm sandy loam"))


OTHERWISE = [
    {"soil": po.named_soil("heavy clay")},
    {"soil": SOIL.with_density_profile(lambda r: 1700.0 + 0.0 * r)},
    {"soil": LEVEL},
    {"medium": "elastic", "motion": False},
]


@pytest.mark.parametrize("changed", OTHERWISE)
def test_its_own_row_is_the_scenes_steady_resistance(changed):
    found = compare(scene(**changed), speeds=[2.0])
    assert found.own.drafts == pytest.approx((float(scene(**changed).steady_resistance),), rel=1e-14)


def test_a_strength_factor_affects_this_model_only():
    level, plain = (compare(scene(soil), width=0.08) for soil in (LEVEL, po.named_soil("firm sandy loam")))
    # Compared as text, because NaN is not equal to itself.
    assert str([row.drafts for row in level.others]) == str([row.drafts for row in plain.others])
    assert level.own.drafts[0] > 5.0 * plain.own.drafts[0]


def test_the_table_has_drafts_in_kilonewtons_ratios_and_rises(full):
    text = printed(full)
    assert "calculated, not measured" in text
    assert "validated" not in text
    assert "ASABE D497: coefficients not verified against the standard's text" in " ".join(full.standings)
    deep = row(full, "McKyes-Ali", 0.4)
    assert f"{100.0 * (deep.drafts[1] / deep.drafts[0] - 1.0):.2g} %" in text
    assert math.isnan(compare(scene(), speeds=[2.0]).own.rise)
    assert f"{deep.drafts[0] / 1e3:.3g} ({full.ratios(deep)[0]:.2f})" in text
    # This model, four models at two depths, the standard's band at both depths, the cavity.
    assert len([line for line in text.splitlines() if line.startswith("│")]) == 1 + 2 * 4 + 2 + 1


def test_the_picture_has_a_panel_for_each_depth(full, tmp_path):
    figure = full.plot(tmp_path / "drafts.svg")
    left, right = figure.axes
    assert [left.get_title(), right.get_title()] == ["working depth 0.25 m", "working depth 0.4 m"]
    assert (left.get_xlabel(), left.get_ylabel()) == ("speed [km/h]", "mean draft [kN]")
    assert (left.get_yscale(), left.get_ylim()) == (right.get_yscale(), right.get_ylim())
    for axes, depth in ((left, 0.25), (right, 0.4)):
        lines = {line.get_label(): line for line in axes.lines}
        assert set(lines) == {"this model", *(r.model for r in full.others)}
        shown = lines["McKyes-Ali"]
        assert shown.get_ydata() == pytest.approx(np.array(row(full, "McKyes-Ali", depth).drafts) / 1e3)
        assert shown.get_xdata() == pytest.approx([3.6, 9.0])
    # A model without values is marked.
    (legend,) = compare(scene()).plot().legends
    assert "McKyes-Ali: outside its domain" in [text.get_text() for text in legend.get_texts()]


REFUSED = [
    ({"scene": dataclasses.replace(scene(), tow_speed=ca.SX.sym("speed"))}, po.InputError, "comparison needs numbers"),
    ({"texture": "clay"}, po.InputError, "texture = 'clay' does not exist in D497"),
    ({"depth": 0.0}, po.DomainError, "working depth"),
    ({"depth": []}, po.InputError, "at least one depth"),
    ({"width": -0.1}, po.DomainError, "tool width"),
    ({"width": np.array([0.1, 0.2])}, po.InputError, "a comparison accepts one number per quantity"),
    ({"rake_angle": po.deg(95.0)}, po.DomainError, "rake angle"),
    ({"speeds": []}, po.InputError, "at least one speed"),
]


@pytest.mark.parametrize(("options", "error", "words"), REFUSED)
def test_invalid_arguments_of_a_comparison_are_refused(options, error, words):
    with pytest.raises(error, match=words):
        compare(**{"scene": scene()} | options)


def test_a_scene_with_another_law_is_named_after_it():
    tined = dataclasses.replace(scene(), medium=po.laws.McKyesAli(width=0.08, rake_angle=po.deg(45.0)))
    found = compare(tined, width=0.08, rake_angle=po.deg(45.0), speeds=[1.0, 2.0])
    assert found.own.model == "this scene, McKyes-Ali"
    # Its own row equals that of the same law among the others.
    assert found.ratios(row(found, "McKyes-Ali")) == pytest.approx([1.0, 1.0], rel=1e-14)
    alike = dataclasses.replace(found, others=(row(found, "McKyes-Ali"),)).plot().axes[0]
    assert (alike.get_yscale(), alike.get_ylim()[0]) == ("linear", 0.0)
    fast = compare(tined, width=0.08, rake_angle=po.deg(45.0), speeds=[1.0, 6.0]).own
    assert [math.isnan(draft) for draft in fast.drafts] == [False, True]
    assert "speed = 6" in fast.refusal


# --- docs/crosscheck.md ---


def test_the_page_states_the_effect_of_speed():
    """Increase of draft from 3 to 9 km/h in per cent, for the share of the cotton problem and similar tines."""
    problem = po.read_problem(PROBLEMS / "cotton_subsoiler.toml")
    guess, steeper = problem.scene(), problem.scene({"share.wedge_angle": po.deg(39.0)})
    for share, most in ((guess, 0.6), (steeper, 1.45)):
        own = compare(share, speeds=SPEEDS).own.drafts
        assert 0.45 < 100.0 * (own[1] / own[0] - 1.0) < most
    for rake in (30.0, 45.0):
        others = compare(guess, rake_angle=po.deg(rake), speeds=SPEEDS).others
        more = {row.model: 100.0 * (row.drafts[1] / row.drafts[0] - 1.0) for row in others}
        assert 11.5 < more["Swick-Perumpral"] < 15.0
        assert 3.0 < more["universal earthmoving equation"] < 5.0
        assert 53.0 < more["ASABE D497, narrow, medium"] < 54.0
    assert 3.0 < more["McKyes-Ali"] < 5.0  # refuses a rake of 30 degrees
    assert f"({100.0 * float(guess.ambient_share):.0f} % in serozem" in PAGE


def test_the_table_of_laws_matches_the_laws():
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (.*?) *\|(.*?)\|(.*?)\|(.*?)\|$", PAGE, flags=re.MULTILINE)
    assert [name for name, *_ in rows] == list(LAWS)
    for name, kind, *cells in rows:
        law = LAWS[name]()
        assert type(law).__name__ == kind
        for cell, what in zip(cells, ("motion", "added_mass", "loosened_radius", "entry"), strict=True):
            assert (cell.strip() == "yes") != law.lacks(what), (name, what)


def test_the_rows_of_the_standard_match_the_code():
    rows = re.findall(r"^\| (narrow|winged) point.* \| (\S+) \| (\S+) \| (\S+) \| (.+) \|$", PAGE, flags=re.MULTILINE)
    assert {name: tuple(map(float, found[:3])) for name, *found in rows} == POINTS
    for *_, factors in rows:
        assert tuple(map(float, factors.split(", "))) == tuple(TEXTURES.values())
