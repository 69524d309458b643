"""Entries of a contest: medians, the efficient front, and the cheapest that is good enough."""

import itertools
import math

import pytest

from plough_opt.studies.accuracy import contest
from plough_opt.studies.accuracy.contest import Entry, cheapest, efficient, median_time


def entry(seconds, error, method="m", failure=None, setting=""):
    return Entry("integrator", method, setting, seconds, errors={} if failure else {"e": error}, failure=failure)


class TestEfficient:
    """The entries that no other beats in both time and error."""

    def test_from_the_fastest_to_the_most_exact(self):
        a, b, c, slower, both = entry(1, 1e-2), entry(2, 1e-5), entry(4, 1e-9), entry(3, 1e-4), entry(5, 1e-8)
        assert efficient([both, c, slower, a, b], "e") == [a, b, c]

    def test_a_failure_or_another_error_does_not_count(self):
        good = entry(2, 1e-3)
        other = Entry("model", "q", "", 0.1, errors={"other": 0.0})
        assert efficient([entry(1, 0.0, failure="no"), other, good], "e") == [good]

    def test_errors_below_the_floor_are_one(self):
        first, second = entry(1, 3e-16), entry(2, 1e-17)
        assert efficient([first, second], "e", floor=1e-15) == [first]
        assert efficient([first, second], "e") == [first, second]

    def test_of_equal_times_the_more_exact(self):
        better, worse = entry(1, 1e-6), entry(1, 1e-3)
        assert efficient([worse, better], "e") == [better]

    def test_a_little_more_exact_is_no_gain(self):
        first, second, third = entry(1, 1e-9), entry(2, 0.95e-9), entry(3, 0.85e-9)
        assert efficient([first, second, third], "e") == [first, third]

    def test_none(self):
        assert efficient([], "e") == []

    def test_no_entry_beats_one_of_the_front_and_each_other_is_beaten(self):
        entries = [entry(t, 10.0 ** -((7 * t) % 11)) for t in range(1, 12)]
        front = efficient(entries, "e")

        def beaten(one):
            return any(o.seconds <= one.seconds and o.errors["e"] <= one.errors["e"] and o is not one for o in entries)

        assert [beaten(one) for one in entries] == [one not in front for one in entries]


class TestCheapest:
    """The fastest entry that meets a wanted error."""

    def test_it_meets_the_error_just(self):
        good, exact = entry(2, 1e-6), entry(9, 1e-12)
        assert cheapest([entry(1, 1.1e-6), exact, good], "e", 1e-6) is good

    def test_none_reaches_it(self):
        assert cheapest([entry(1, 1e-3), entry(1, 0.0, failure="no")], "e", 1e-6) is None


class TestMedianTime:
    """The median of repetitions after a warm-up, by a clock that the test winds."""

    @pytest.fixture
    def clock(self, monkeypatch):
        now = itertools.count()
        times = iter(())

        class Clock:
            calls = 0

        def start(*seconds):
            nonlocal times
            ends = list(itertools.accumulate(itertools.chain.from_iterable((0.0, s) for s in seconds)))
            times = iter(ends)

        monkeypatch.setattr(contest.time, "process_time", lambda: next(times, float(next(now))))
        Clock.start = staticmethod(start)
        return Clock

    def test_the_warm_up_does_not_count(self, clock):
        done = []
        clock.start(0.1, 0.3, 0.2)
        assert median_time(lambda: done.append(1), budget=0.5) == pytest.approx(0.2)
        assert len(done) == 4

    def test_what_was_done_before_needs_no_warm_up(self, clock):
        done = []
        clock.start(0.1, 0.3, 0.2)
        assert median_time(lambda: done.append(1), budget=0.5, warm=True) == pytest.approx(0.2)
        assert len(done) == 3

    def test_the_most_repetitions(self, clock):
        clock.start(0.001, 0.003, 0.002)
        assert median_time(lambda: None, budget=0.5, most=3) == pytest.approx(0.002)

    def test_what_outlasts_the_budget_is_still_a_median_of_three(self, clock):
        done = []
        clock.start(0.9, 0.7, 0.8)
        assert median_time(lambda: done.append(1), budget=0.5) == pytest.approx(0.8)
        assert len(done) == 4

    @pytest.mark.parametrize(("seconds", "median"), [((6.0,), 6.0), ((3.0, 4.0), 3.5)])
    def test_what_takes_ten_budgets_is_repeated_no_more(self, clock, seconds, median):
        done = []
        clock.start(*seconds)
        assert median_time(lambda: done.append(1), budget=0.5) == pytest.approx(median)
        assert len(done) == 1 + len(seconds)


def test_a_label_has_method_and_setting():
    assert entry(1, 1, method="erk", setting="tolerance 1e-06").label == "erk, tolerance 1e-06"
    assert entry(1, 1, method="linearised").label == "linearised"
    assert Entry("model", "m", "", math.inf, failure="why").errors == {}
