"""Comparisons with particles and measurements: their arithmetic, and the tables of the page from the rows on file."""

import math

import numpy as np
import pytest
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported

PAGE = (PROBLEMS.parent / "docs" / "validation.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def measured():
    with imported("measured/compare") as module:
        yield module


@pytest.fixture(scope="module")
def particles():
    with imported("particles/findings") as module:
        yield module


def test_the_page_holds_the_tables_of_measurements(measured):
    for headings, table in measured.TABLES.values():
        assert measured.markdown(headings, table()) in PAGE


def test_the_page_holds_the_tables_of_the_particles(particles):
    for headings, table in particles.TABLES.values():
        assert particles.markdown(headings, table()) in PAGE


def test_thirty_measured_rows_with_sources(measured):
    tables = sorted(path.stem for path in (PROBLEMS / "measured").glob("*.csv"))
    values = [name for name in tables if name not in ("to_obtain", "trends")]
    assert sum(len(measured.rows_of(name)) for name in values) + len(measured.rows_of("trends")) >= 30
    for name in tables:
        assert (PROBLEMS / "measured" / f"{name}.csv").read_text(encoding="utf-8").startswith("#")


def test_the_published_sand_against_the_plane_wedge_by_hand(measured):
    """Rankine's passive wedge: without cohesion, tool friction and crescents."""
    law = measured.SwickPerumpral(depth=0.2, width=0.3, rake_angle=math.pi / 2.0)
    scene = measured.blade_scene(measured.SwickPerumpral, 0.0, 0.3, 0.2)
    smooth = measured.dataclasses.replace(scene.soil, tool_friction=0.0)
    still = measured.dataclasses.replace(scene, soil=smooth, medium=law, tow_speed=1e-6)
    passive = math.tan(math.radians(45.0 + 35.0 / 2.0)) ** 2
    assert still.steady_resistance == pytest.approx(1440.0 * 9.81 * 0.2**2 / 2.0 * 0.3 * passive, rel=1e-3)


def test_mean_and_error(particles):
    values = np.random.default_rng(4).normal(3.0, 0.5, 400).tolist()
    mean, error = particles.mean_and_error(values)
    assert mean == pytest.approx(3.0, abs=4.0 * error)
    # The standard deviation of 400 normal values is known to 3.5 %.
    assert error == pytest.approx(0.5 / 20.0, rel=0.15)


def test_the_soil_of_triaxial_tests_fails_where_they_failed(particles):
    """The Mohr-Coulomb line of the soil gives back the axial stresses, which lie on it within their scatter."""
    soil = particles.tested_soil(30.0, 100e3, 50e3)
    strength = math.tan(math.pi / 4.0 + soil.friction_angle / 2.0)
    for row in particles.table("triaxial"):
        case = particles.case_of(row)
        if (case.friction, case.cohesion) == (30.0, 100e3):
            expected = case.pressure * strength**2 + 2.0 * soil.cohesion * strength
            assert float(row["axial_stress"]) == pytest.approx(expected, rel=0.15)


def test_ratios_compare_cases_that_differ_in_nothing_else(particles):
    for question in particles.QUESTIONS:
        for one in particles.ratios(question):
            drafts = particles.drafts(one.case)
            reference = particles.dataclasses.replace(one.case, **question.varied)
            seeds = drafts.keys() & particles.drafts(reference).keys()
            by_hand = np.mean([drafts[seed] / particles.drafts(reference)[seed] for seed in seeds])
            assert one.mean == pytest.approx(by_hand, rel=1e-12)
