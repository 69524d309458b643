"""How often the intervals contain the true values: the benchmark behind the table in docs/calibration.md."""

import re
from pathlib import Path

import pytest
from helpers.scripts import imported
from scipy import stats

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def script():
    """Yield problems/calibration_coverage.py as a module."""
    with imported("calibration_coverage") as module:
        yield module


def identifiable(found):
    """Return the unknowns that the data determined in every trial, and check that the others never were."""
    determined = [own for own in found if own.identifiable]
    assert all(own.identifiable == own.trials for own in determined)
    assert determined
    return determined


def test_intervals_hold_the_truth_as_often_as_they_say(script):
    """A thin version: twenty trials tell a coverage of 95 % from one below some 70 %."""
    found = script.CASES[0].run(20)
    # With correct intervals, this many or fewer of twenty cover in one case of two thousand; all twenty do so often.
    least = stats.binom.ppf(5e-4, 20, 0.95) / 20
    for own in identifiable(found):
        assert own.rate("profile") >= least
        assert own.rate("linearised") >= least
        # The mean of twenty fits lies within 0.8 standard deviations of the truth, 3.6 of its own.
        assert abs(own.bias) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("number", range(5))
def test_coverage_of_500_trials_is_95_per_cent_within_3(script, number):
    found = script.CASES[number].run(500)
    for own in identifiable(found):
        assert abs(own.rate("profile") - 0.95) <= 0.03, own


def test_every_parameter_is_identifiable_in_some_case(script):
    """Cohesion, friction angle, density ratio, tool friction, ambient pressure and rate term."""
    found = [case.run(1) for case in script.CASES]
    assert {own.name for case in found for own in case if own.identifiable} == set(script.BOUNDS)


def test_the_page_has_the_table_of_the_script(script):
    """The page's table has a row for each case and unknown, with rates of 95 % within 3."""
    page = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\|(.*)\| `([\w.]+)` \| in (\d+) \| (.*) \|$", page, flags=re.MULTILINE)
    assert [name for _, name, _, _ in rows] == [name for case in script.CASES for name in case.unknown]
    for _, _, count, rest in rows:
        if count == "0":
            assert "not identifiable" in rest
            continue
        assert count == "500"
        profile, linearised = (float(text) for text in re.findall(r"([\d.]+) %", rest)[:2])
        assert abs(profile - 95.0) <= 3.0
        assert abs(linearised - 95.0) <= 3.0
