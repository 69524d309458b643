"""The experiment among particles: its plan, tools and statistics, a small run in YADE, and the rows on file."""

import math
import re
import shutil
from collections import Counter

import numpy as np
import pytest
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported

PARTICLES = PROBLEMS / "particles"
MAIN = "half angle, equal height"


@pytest.fixture(scope="module")
def script():
    with imported("particles/run_plan") as module:
        yield module


def case(script, **changes):
    return script.Case(case="test", question="test", **changes)


# --- plan ---


def test_the_plan_has_every_run_once_and_three_packings_of_each_case(script):
    runs = script.plan()
    assert len({one.key for one in runs}) == len(runs) == len({(one.case, one.seed) for one in runs})
    packings = Counter(one.case for one in runs)
    assert {name for name, count in packings.items() if count != 3} == {"diameter-slender-0.01"}


def test_an_interrupted_plan_continues_where_it_ended(script, tmp_path, monkeypatch, capsys):
    runs = script.plan()[:30]
    failing, interrupted = runs[1], [runs[25]]
    done = []

    def pretended(one):
        if one in interrupted:
            interrupted.clear()
            raise KeyboardInterrupt
        if one == failing:
            raise RuntimeError("no result")
        done.append(one)
        return {**vars(one), "draft": 1.0 / 3.0}

    monkeypatch.setattr(script, "plan", lambda: runs)
    monkeypatch.setattr(script, "run", pretended)
    with pytest.raises(KeyboardInterrupt):
        script.main([], tmp_path)
    for _ in range(2):
        script.main([], tmp_path)
    assert done == [one for one in runs if one != failing]
    assert capsys.readouterr().out.count("FAILED: no result") == 3
    rows = [row for name in ("particles", "triaxial") for row in script.read_rows(tmp_path / f"{name}.csv")]
    assert {row["kind"] for row in rows} == {"cone", "triaxial"}
    assert Counter(map(script.key_of, rows)) == Counter(one.key for one in done)
    assert {row["draft"] for row in rows} == {"0.333333"}


# --- tools ---


def area(faces):
    corners = np.array(faces)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2.0


@pytest.mark.parametrize("angle", [10.0, 15.0, 20.0, 25.0])
def test_tools_of_one_half_angle_have_the_surface_of_the_cone(script, angle):
    radius = 0.1 * math.tan(math.radians(angle))
    surface = math.pi * radius * math.hypot(radius, 0.1)  # equation (6)
    for kind in ("wedge", "closed_share", "open_share"):
        tool = script.faces_of(case(script, kind=kind, half_angle=angle))
        assert area(tool["working"]) == pytest.approx(surface, rel=1e-12), kind
    cone = script.faces_of(case(script, half_angle=angle))
    # The pyramid that replaces the cone has its base area; its faces are a little flatter.
    assert area(cone["base"]) == pytest.approx(math.pi * radius**2, rel=1e-12)
    assert area(cone["working"]) == pytest.approx(surface, rel=0.015)


def test_closed_tools_leave_no_gap(script):
    for kind in ("cone", "wedge", "closed_share"):
        groups = script.faces_of(case(script, kind=kind)).values()
        triangles = [t for group in groups for t in group]
        edges = Counter(frozenset((t[i], t[i - 1])) for t in triangles for i in range(3))
        assert set(edges.values()) == {2}, kind


# --- statistics ---


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_the_standard_error_of_a_first_order_process(script, memory):
    rng = np.random.default_rng(4)
    length, trials = 1000, 400
    noise = rng.standard_normal((trials, length + 200))
    series = np.zeros_like(noise)
    for i in range(1, noise.shape[1]):
        series[:, i] = memory * series[:, i - 1] + noise[:, i]
    series = series[:, 200:]
    # Var(mean) of x_i = memory x_(i-1) + e_i, exact for a finite length.
    lags = np.arange(1, length)
    spread = 1.0 + 2.0 * np.sum((1.0 - lags / length) * memory**lags)
    truth = math.sqrt(spread / (1.0 - memory**2) / length)
    errors = np.array([script.standard_error(one) for one in series])
    # 400 trials: a standard error of 4 % in what they scatter by, and of 1 to 2 % in the mean of their estimates.
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(truth, rel=0.08)
    assert series.mean(axis=1).std() == pytest.approx(truth, rel=0.12)


def test_the_displaced_zone_of_incompressible_soil(script):
    rng = np.random.default_rng(5)
    base, end = 0.02, 0.14
    before = rng.uniform(-end, end, (200_000, 3))
    radius = np.hypot(before[:, 1], before[:, 2])
    # Incompressible soil around a cylinder that has grown from nothing: y^2 = r^2 + R^2.
    moved = before * ((np.sqrt(radius**2 + base**2) - radius) / radius)[:, None]
    radii = script.zone_radii(before, moved, 0.0, base, 0.01, end)
    truth = [base * (1.0 - share**2) / (2.0 * share) for share in script.ZONE_SHARES]
    assert truth[0] > end
    assert truth[1] > end
    assert radii[:2] == [end, end]
    assert radii[3] == pytest.approx(truth[3], rel=0.02)
    assert script.zone_radii(before, 0.0 * moved, 0.0, base, 0.01, end) == [base] * 4


# --- YADE ---


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("yade") is None, reason="YADE is not installed (Debian: apt-get install yade)")
def test_small_runs_repeat_exactly_and_balance(script, tmp_path):
    # About 200 spheres of 50 mm.
    pull = case(script, diameter=0.05, half_angle=25.0, height=0.07, stiffness=2e5, bands=1)
    first, again = (script.run(pull, tmp_path / name) for name in ("first", "again"))
    assert {**first, "cpu": 0} == {**again, "cpu": 0}
    assert first["spheres"] in range(150, 250)
    # The spring's mean stretch carries the mean draft, but for what little the share's speed changes.
    assert first["deflection"] * 2e5 == pytest.approx(first["draft"], rel=0.05)
    assert first["working"] == pytest.approx(first["draft"], rel=0.15)
    test = script.run(case(script, kind="triaxial", diameter=0.05), tmp_path / "first")
    assert 3.0 < test["axial_stress"] / 50e3 < 6.0
    assert 0.0 < test["compaction"] < 0.05


# --- rows on file ---

TABLES = {"particles": ("draft", "standard_error", "path", "zone_10"), "triaxial": ("axial_stress", "compaction")}
CONES = ("cone-15", "cone-35", "wide-15", "wide-35")
WORDS = {"case", "question", "kind", "yade"}


@pytest.mark.parametrize("name", TABLES)
def test_rows_are_numbers_under_documented_columns(script, name):
    rows = script.read_rows(PARTICLES / f"{name}.csv")
    explained = set(re.findall(r"\w+", (PARTICLES / "README.md").read_text(encoding="utf-8")))
    assert {*rows[0]} <= explained
    for row in rows:
        numbers = {column: float(text) for column, text in row.items() if column not in WORDS}
        assert np.isfinite([*numbers.values()]).all(), row["case"]
        assert min(numbers[column] for column in TABLES[name]) > 0.0, row["case"]
        assert 0.3 < numbers["porosity"] < 0.5
    assert len({script.key_of(row) for row in rows}) == len(rows)


def test_cases_were_run_in_every_packing_of_the_plan(script):
    planned = Counter(one.case for one in script.plan())
    for name in TABLES:
        cases = [row["case"] for row in script.read_rows(PARTICLES / f"{name}.csv")]
        # The plan may have been interrupted in the middle of its last case.
        complete = Counter(one for one in cases if one != cases[-1])
        assert complete == {one: planned[one] for one in complete}
        if name == "particles":
            assert {one.case for one in script.plan() if one.question == MAIN} <= {*complete}


def test_the_page_states_the_effect_of_the_box(script):
    rows = script.read_rows(PARTICLES / "particles.csv")
    mean = {name: np.mean([float(row["draft"]) for row in rows if row["case"] == name]) for name in CONES}
    slender, blunt = (mean[f"wide-{angle}"] / mean[f"cone-{angle}"] for angle in (15, 35))
    page = " ".join((PARTICLES / "README.md").read_text(encoding="utf-8").split())
    assert f"15° draws {slender:.2f} and 35° {blunt:.2f} times the force" in page
