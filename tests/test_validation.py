"""The experiment among particles and the measurements of others, and every number of the page on them."""

import dataclasses
import math
import re
import shutil
from collections import Counter

import numpy as np
import pytest
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported

# --- the experiment among particles: its plan, tools and statistics, a small run in YADE, and the rows on file ---


PARTICLES = PROBLEMS / "particles"


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
    assert {*Counter(one.case for one in runs).values()} == {3}


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


# --- YADE ---


@pytest.mark.thorough
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
WORDS = {"case", "question", "kind", "yade"}


@pytest.mark.parametrize("name", TABLES)
def test_rows_are_numbers_under_documented_columns(script, name):
    rows = script.read_rows(PARTICLES / f"{name}.csv")
    explained = set(re.findall(r"\w+", (PARTICLES / "README.md").read_text(encoding="utf-8")))
    assert {*rows[0]} <= explained
    for row in rows:
        assert {column for column, text in row.items() if not text} <= {"carried"}
        numbers = {column: float(text) for column, text in row.items() if text and column not in WORDS}
        assert np.isfinite([*numbers.values()]).all(), row["case"]
        assert min(numbers[column] for column in TABLES[name]) > 0.0, row["case"]
        assert 0.3 < numbers["porosity"] < 0.5
    assert len({script.key_of(row) for row in rows}) == len(rows)


# --- comparisons with particles and measurements: arithmetic, and every number of the page from the rows on file ---


PAGE = (PROBLEMS.parent / "docs" / "explanation" / "validation.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def validation():
    with imported("validation") as module:
        yield module


@pytest.fixture(scope="module")
def measured(validation):
    return validation.compare


@pytest.fixture(scope="module")
def particles(validation):
    return validation.findings


def test_the_page_holds_the_tables_of_measurements_and_particles(validation):
    for table in validation.tables():
        assert f"\n\n{table}\n\n" in PAGE


# --- every number of the page's words ---


# Numbers that describe the experiment or what was asked of it, and so follow from no row.
GIVEN = {
    *{"15°", "100 mm", "28 cm", "20 mm", "50 kPa", "2 m/s"},  # the reference
    *{"38 cm", "8°", "10°", "20°", "25°", "35°", "15 mm", "25", "200 kPa"},  # cases
    *{"30°", "0.5 m/s", "10 kg", "400 N s/m", "50", "10", "5", "5 %", "2 %", "95 %", "10 %"},  # tools, parts
    *{"1", "0.794", "2013"},  # ratios of one, 1/√(1 − b1); a named soil; a year
}


def test_the_page_says_what_the_rows_say_and_no_other_number(validation):
    said, page = validation.sentences.sentences(), PAGE[: PAGE.index("### Trends")]
    assert [text for text in said if text not in " ".join(page.split())] == []
    words = re.sub(r"(?ms)```.*?```|^(\||#|!)[^\n]*$|\]\([^)]*\)|`[^`]*`", "", page)
    words = " ".join(words.split())
    for text in said:
        words = words.replace(text, "…")
    assert {*re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?:°| mm| cm| kPa| m/s| kg| N s/m| %)?", words)} == GIVEN


def test_the_experiments_page_says_what_the_rows_say(validation):
    page = " ".join((PARTICLES / "README.md").read_text(encoding="utf-8").split())
    assert [text for text in validation.sentences.experiment() if text not in page] == []


def test_thirty_measured_rows_with_sources(measured):
    tables = sorted(path.stem for path in (PROBLEMS / "measured").glob("*.csv"))
    values = [name for name in tables if name not in ("to_obtain", "trends")]
    assert sum(len(measured.rows_of(name)) for name in values) + len(measured.rows_of("trends")) >= 30
    for name in tables:
        assert (PROBLEMS / "measured" / f"{name}.csv").read_text(encoding="utf-8").startswith("#")


def test_the_draft_of_wedges_made_of_plates_is_the_models_within_what_the_table_says(measured):
    plates, model = (np.array(of().split(" : "), dtype=float) for of in (measured.plate_forces, measured.wedge_forces))
    assert model == pytest.approx(plates, rel=0.1)


def test_the_published_sand_against_the_plane_wedge_by_hand(measured):
    """Rankine's passive wedge: without cohesion, tool friction and crescents."""
    law = measured.SwickPerumpral(depth=0.2, width=0.3, rake_angle=math.pi / 2.0)
    scene = measured.blade_scene(measured.SwickPerumpral, 0.0, 0.3, 0.2)
    smooth = measured.dataclasses.replace(scene.soil, tool_friction=0.0)
    still = measured.dataclasses.replace(scene, soil=smooth, medium=law, tow_speed=1e-6)
    passive = math.tan(math.radians(45.0 + 35.0 / 2.0)) ** 2
    assert still.steady_resistance == pytest.approx(1440.0 * 9.81 * 0.2**2 / 2.0 * 0.3 * passive, rel=1e-3)


def test_the_soil_of_triaxial_tests_fails_where_they_failed(particles):
    """The Mohr-Coulomb line of the soil gives back the axial stresses, which lie on it within their scatter."""
    soil = particles.tested_soil(100e3, 50e3)
    strength = math.tan(math.pi / 4.0 + soil.friction_angle / 2.0)
    for pressure in (25e3, 50e3, 100e3, 200e3):
        expected = pressure * strength**2 + 2.0 * soil.cohesion * strength
        found = particles.numbers(dataclasses.replace(particles.TRIAXIAL, pressure=pressure), "axial_stress")
        assert found == pytest.approx(expected, rel=0.15)


def test_the_soils_page_states_what_one_density_ratio_gives(particles, validation):
    following, one = (validation.sentences.over_pressure(following) for following in (True, False))
    deepest = particles.questions()["pressure"]
    assert [following[0], *following[2:]] == pytest.approx([found.model for found in deepest], rel=1e-12)
    page = (PROBLEMS.parent / "docs" / "howto" / "soils.md").read_text(encoding="utf-8")
    assert f"from {one[3]:.2f} to {following[3]:.2f} times" in page
    assert f"the particles' is {np.mean(deepest[-1].values):.2f} times" in page


def test_ratios_compare_cases_that_differ_in_nothing_else(particles, script):
    rows = {script.key_of(row): float(row["draft"]) for row in script.read_rows(PARTICLES / "particles.csv")}
    for question, ratios in particles.questions().items():
        for one in ratios:
            pairs = [[rows[dataclasses.replace(x, seed=seed).key] for x in (one.case, one.other)] for seed in (1, 2, 3)]
            assert np.mean(one.values) == pytest.approx(np.mean([a / b for a, b in pairs]), rel=1e-12)
            differing = [
                x.name for x in dataclasses.fields(one.case) if getattr(one.case, x.name) != getattr(one.other, x.name)
            ]
            assert question == "half angle, equal base" or len(differing) == 1
