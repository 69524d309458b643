"""Entries of a contest: medians, the efficient front, and the cheapest that is good enough."""

import dataclasses
import itertools
import math

import pytest

from plough_opt.studies.accuracy import contest
from plough_opt.studies.accuracy.contest import Entry, Track, cheapest, efficient, measured, median_time, rungs_of
from plough_opt.studies.accuracy.methods import FACTORS, Task


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


CLOCKED = {"fast": 1.0, "slow": 2.5, "slower": 30.0}


def clocked(method, counts, order, *, factor=1.0, fixed=False):
    """Return a track of a method of an order, whose uses are told by name, and what was tried of it."""
    tried = []

    def prepare(steps):
        tried.append(steps)
        return (lambda: (method, steps)), lambda: {"error": 0.5 * factor * (40.0 / steps) ** order}

    rungs, shown = rungs_of(40, counts)
    label = "{} steps".format
    if fixed:
        rungs, shown = [rungs[place] for place in shown], None
    return Track("family", method, prepare, lambda found: found, rungs, shown, label), tried


class TestTracks:
    """The cheapest setting between those that are tried in any case, by a clock that knows what a step takes."""

    @pytest.fixture(autouse=True)
    def clock(self, monkeypatch):
        # A use reports its name and its steps; nobody needs to wait for it.
        monkeypatch.setattr(contest, "median_time", lambda use, **_: CLOCKED[use()[0]] * 1e-3 * use()[1] / 40.0)
        monkeypatch.setattr(contest, "_measure_in_turns", lambda *_: None)

    @pytest.mark.parametrize("wanted", [1e-1, 1e-4, 1e-6, 1e-9])
    @pytest.mark.parametrize("order", [4, 8])
    def test_it_is_within_a_tenth_of_the_least_steps_in_thin_and_in_full_mode(self, wanted, order):
        true = 40.0 * (0.5 / wanted) ** (1.0 / order)
        found = []
        for thin in (False, True):
            factors = Task(None, 0.2, 4, 1.0, thin=thin).some(FACTORS)
            track, tried = clocked("fast", factors, order)
            entries = measured([track], "error", wanted, 1e3)
            best = cheapest(entries, "error", wanted)
            found.append((best and best.setting, len(tried)))
        (full, _), (thin, fewer) = found
        assert full == thin
        assert (full is not None) == (true <= 40.0 * max(FACTORS))
        if full is not None:
            assert int(full.split()[0]) == pytest.approx(true, rel=0.1, abs=1.0)
            # The halvings of some seventy settings, and those that are shown.
            assert fewer <= 4 + 7

    def test_errors_that_do_not_fall_evenly_lead_both_modes_to_the_same(self):
        # Whichever of neighbours reaches the error by chance: every fifth is a hundred times as exact.
        found = []
        for factors in (FACTORS, (0.125, 0.5, 2.0, 4.0)):
            track, _ = clocked("fast", factors, 4)
            lucky = dict(zip(track.rungs, itertools.cycle((1.0, 1.0, 1e-2, 1.0, 1.0)), strict=False))
            uneven = dataclasses.replace(
                track, prepare=lambda steps, lucky=lucky: (lambda: ("fast", steps),
                                             lambda: {"error": lucky[steps] * 0.5 * (40.0 / steps) ** 4})
            )  # fmt: skip
            found.append(cheapest(measured([uneven], "error", 1.5e-3, 1e3), "error", 1.5e-3))
        assert found[0] == found[1]

    def test_what_is_too_slow_is_not_narrowed_down(self):
        (fast, of_fast), (slower, of_slower) = clocked("fast", (0.5, 1, 2, 4), 8), clocked("slower", (0.5, 1, 2, 4), 8)
        measured([fast, slower], "error", 1e-2, 1e3)
        assert len(of_fast) > len(fast.shown)
        assert len(of_slower) == len(slower.shown)

    def test_what_may_still_win_is(self):
        # Its coarsest setting that is tried in any case is slower, and far too exact.
        (fast, _), (slow, _) = clocked("fast", (1, 2, 4), 8, factor=50.0), clocked("slow", (1, 2, 4), 8, factor=1e-9)
        entries = measured([fast, slow], "error", 1e-3, 1e3)
        assert cheapest(entries, "error", 1e-3).method == "slow"

    def test_a_track_that_shall_not_is_left_as_it_is(self):
        track, tried = clocked("fast", (0.5, 1, 2), 8, fixed=True)
        assert len(measured([track], "error", 1e-2, 1e3)) == len(tried) == 3

    def test_one_slow_measurement_changes_no_advice(self, monkeypatch):
        """The coarsest setting that reaches the error is measured again, though at first it seemed slow."""
        monkeypatch.undo()
        now = [0.0]

        def prepare(steps):
            uses = itertools.count()

            def use():
                # Twice when it is tried, and then in turns.
                now[0] += 1e-3 * steps / 40.0 * (3.0 if steps == 80 and next(uses) < 3 else 1.0)

            return use, lambda: (use(), {"error": 0.5 * (40.0 / steps) ** 8})[1]

        monkeypatch.setattr(contest.time, "process_time", lambda: now[0])
        track = dataclasses.replace(clocked("fast", FACTORS, 8)[0], prepare=prepare)
        entries = measured([track], "error", 0.5 * 0.5**8, 1.0)
        best = cheapest(entries, "error", 0.5 * 0.5**8)
        assert (best.setting, best.seconds) == ("80 steps", pytest.approx(2e-3))

    def test_turns_of_what_takes_long_are_few(self, monkeypatch):
        monkeypatch.undo()
        now, done = [0.0], []

        def prepare(steps):
            def use():
                done.append(steps)
                now[0] += 3.0

            return use, lambda: {"error": 1.0 / steps}

        monkeypatch.setattr(contest.time, "process_time", lambda: now[0])
        track, _ = clocked("fast", (1, 2), 8, fixed=True)
        measured([dataclasses.replace(track, prepare=prepare)], "error", 1.0, 10.0)
        # Thrice when it is tried, for a median, and in turns until both have taken twice what one may.
        assert len(done) == 2 * (3 + 4)

    def test_rungs_lie_a_tenth_apart_and_hold_the_multiples(self):
        rungs, shown = rungs_of(1000, FACTORS)
        assert [rungs[place] for place in shown] == [125, 250, 500, 1000, 2000, 4000]
        assert all(finer / coarser <= 1.1 for coarser, finer in itertools.pairwise(rungs) if coarser >= 40)
        assert all(count % 40 == 0 for count in rungs_of(1000, FACTORS, unit=40)[0])
