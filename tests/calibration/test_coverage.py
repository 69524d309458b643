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
        assert min(own.rate("profile"), own.rate("linearised")) >= least
        # The mean of twenty fits lies within 0.8 standard deviations of the truth, 3.6 of its own.
        assert abs(own.bias) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("number", range(5))
def test_coverage_of_500_trials_is_95_per_cent_within_3(script, number):
    found = script.CASES[number].run(500)
    for own in identifiable(found):
        assert abs(own.rate("profile") - 0.95) <= 0.03, own


def test_the_page_has_the_table_of_the_script(script):
    """A row for each case and unknown, with rates of 95 % within 3, and every parameter identifiable in some case."""
    page = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\|(.*)\| `([\w.]+)` \| in (\d+) \| (.*) \|$", page, flags=re.MULTILINE)
    found = [(own.name, own.identifiable) for case in script.CASES for own in case.run(1)]
    assert [(name, int(count) / 500) for _, name, count, _ in rows] == found
    assert {name for name, identifiable in found if identifiable} == set(script.BOUNDS)
    for _, _, count, rest in rows:
        rates = [float(text) for text in re.findall(r"([\d.]+) %", rest)[:2]]
        assert rates == pytest.approx([95.0, 95.0] if int(count) else [], abs=3.0)
