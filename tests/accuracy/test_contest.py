"""Contests: median times, the efficient front, and the cheapest setting that is good enough."""

import dataclasses
import itertools

import pytest

from plough_opt.studies.accuracy import contest
from plough_opt.studies.accuracy.contest import (
    Contestant,
    Entry,
    cheapest,
    efficient,
    measured,
    median_time,
    step_counts,
)
from plough_opt.studies.accuracy.methods import FACTORS, Task


def entry(seconds, error, method="m", failure=None, setting=""):
    return Entry("integrator", method, setting, seconds, errors={} if failure else {"e": error}, failure=failure)


FAST, MORE_EXACT, MOST_EXACT = entry(1, 1e-2), entry(2, 1e-5), entry(4, 1e-9)
TINY = [entry(1, 3e-16), entry(2, 1e-17)]


@pytest.mark.parametrize(
    ("entries", "floor", "front"),
    [
        pytest.param([entry(5, 1e-8), MOST_EXACT, entry(3, 1e-4), FAST, MORE_EXACT], 0.0,
                     [FAST, MORE_EXACT, MOST_EXACT], id="from the fastest to the most exact"),
        pytest.param([entry(1, 0.0, failure="no"), Entry("model", "q", "", 0.1, errors={"other": 0.0}), FAST], 0.0,
                     [FAST], id="failures and other errors do not count"),
        pytest.param(TINY, 1e-15, TINY[:1], id="errors below the floor are one"),
        pytest.param(TINY, 0.0, TINY, id="without a floor they are two"),
        pytest.param([entry(1, 1e-1), FAST], 0.0, [FAST], id="of equal times the more exact"),
        pytest.param([entry(1, 1e-9), entry(2, 0.95e-9), entry(3, 0.85e-9)], 0.0, [entry(1, 1e-9), entry(3, 0.85e-9)],
                     id="a little more exact is no gain"),
        pytest.param([], 0.0, [], id="none"),
    ],
)  # fmt: skip
def test_the_front_holds_what_no_other_beats_in_both(entries, floor, front):
    assert efficient(entries, "e", floor) == front


def test_the_cheapest_just_meets_the_error():
    good, exact = entry(2, 1e-6), entry(9, 1e-12)
    assert cheapest([entry(1, 1.1e-6), exact, good], "e", 1e-6) is good
    assert cheapest([entry(1, 1e-3), entry(1, 0.0, failure="no")], "e", 1e-6) is None


@pytest.mark.parametrize(
    ("seconds", "median"),
    [
        pytest.param((0.1, 0.3, 0.2), 0.2, id="three"),
        pytest.param((0.9, 0.7, 0.8), 0.8, id="three beyond the budget too"),
        pytest.param((6.0,), 6.0, id="one beyond ten budgets"),
        pytest.param((3.0, 4.0), 3.5, id="or two"),
        pytest.param((0.001, 0.003, 0.002) * 5, 0.002, id="fifteen at most"),
    ],
)
@pytest.mark.parametrize("warm", [False, True])
def test_the_median_of_repetitions_by_a_clock_that_they_wind(monkeypatch, seconds, warm, median):
    now, course = [0.0], iter(seconds if warm else (9.0, *seconds))
    monkeypatch.setattr(contest.time, "process_time", lambda: now[0])

    def action():
        now[0] += next(course)

    # The warm-up does not count.
    assert median_time(action, budget=0.5, warm=warm) == pytest.approx(median)
    assert next(course, None) is None


CLOCKED = {"fast": 1.0, "slow": 2.5, "slower": 30.0}


def clocked(method, counts, order, *, factor=1.0, fixed=False):
    """Return a contestant of some order, whose uses return name and steps, and a list of the settings tried."""
    tried = []

    def prepare(steps):
        tried.append(steps)
        return (lambda: (method, steps)), lambda: {"error": 0.5 * factor * (40.0 / steps) ** order}

    rungs, shown = step_counts(40, counts)
    label = "{} steps".format
    if fixed:
        rungs, shown = [rungs[place] for place in shown], None
    return Contestant("family", method, prepare, lambda found: found, rungs, shown, label), tried


def counted(seconds):
    """Return a contestant of two settings, a clock in a list that its uses wind, and the steps of all uses so far.

    Args:
        seconds: steps -> time of a use [s].
    """
    now, done = [0.0], []

    def prepare(steps):
        def use():
            done.append(steps)
            assert len(done) < 10_000, "the contest does not end"
            now[0] += seconds(steps)

        return use, lambda: {"error": 1.0 / steps}

    return dataclasses.replace(clocked("fast", (1, 2), 8, fixed=True)[0], prepare=prepare), now, done


class TestTracks:
    """The cheapest good setting between those measured in any case, by a clock that knows the time of a step."""

    @pytest.fixture(autouse=True)
    def clock(self, monkeypatch):
        # A use returns its name and steps, from which its time follows.
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
            # The halvings of some seventy settings, and those measured in any case.
            assert fewer <= 4 + 7

    def test_errors_that_do_not_fall_evenly_lead_both_modes_to_the_same(self):
        # Every fifth setting is a hundred times as exact by chance.
        found = []
        for factors in (FACTORS, (0.125, 0.5, 2.0, 4.0)):
            track, _ = clocked("fast", factors, 4)
            lucky = dict(zip(track.settings, itertools.cycle((1.0, 1.0, 1e-2, 1.0, 1.0)), strict=False))
            uneven = dataclasses.replace(
                track, prepare=lambda steps, lucky=lucky: (lambda: ("fast", steps),
                                             lambda: {"error": lucky[steps] * 0.5 * (40.0 / steps) ** 4})
            )  # fmt: skip
            found.append(cheapest(measured([uneven], "error", 1.5e-3, 1e3), "error", 1.5e-3))
        assert found[0] == found[1]

    def test_what_is_too_slow_is_not_narrowed_down(self):
        (fast, of_fast), (slower, of_slower) = clocked("fast", (0.5, 1, 2, 4), 8), clocked("slower", (0.5, 1, 2, 4), 8)
        measured([fast, slower], "error", 1e-2, 1e3)
        assert len(of_fast) > len(fast.always)
        assert len(of_slower) == len(slower.always)

    def test_what_may_still_win_is(self):
        # The coarsest of its settings measured in any case is slower, but far too exact.
        (fast, _), (slow, _) = clocked("fast", (1, 2, 4), 8, factor=50.0), clocked("slow", (1, 2, 4), 8, factor=1e-9)
        entries = measured([fast, slow], "error", 1e-3, 1e3)
        assert cheapest(entries, "error", 1e-3).method == "slow"

    def test_one_slow_measurement_changes_no_advice(self, monkeypatch):
        """The coarsest setting that reaches the error is timed again, even if it seemed slow at first."""
        monkeypatch.undo()
        now = [0.0]

        def prepare(steps):
            uses = itertools.count()

            def use():
                # Slow at first, and now and then in turns.
                number = next(uses)
                slow = steps == 80 and (number < 16 or number % 5 == 0)
                now[0] += 1e-3 * steps / 40.0 * (5.0 if slow else 1.0)

            return use, lambda: (use(), {"error": 0.5 * (40.0 / steps) ** 8})[1]

        monkeypatch.setattr(contest.time, "process_time", lambda: now[0])
        track = dataclasses.replace(clocked("fast", FACTORS, 8)[0], prepare=prepare)
        entries = measured([track], "error", 0.5 * 0.5**8, 1.0)
        best = cheapest(entries, "error", 0.5 * 0.5**8)
        assert (best.setting, best.seconds) == ("80 steps", pytest.approx(2e-3))

    def test_turns_of_what_takes_long_are_few(self, monkeypatch):
        monkeypatch.undo()
        contestant, now, done = counted(lambda _steps: 3.0)
        monkeypatch.setattr(contest.time, "process_time", lambda: now[0])
        measured([contestant], "error", 1.0, 10.0)
        # Three times for a median, and in turns until both have taken twice the allowance of one use.
        assert len(done) == 2 * (3 + 4)

    def test_a_clock_that_ticks_coarsely_still_tells_short_uses_apart(self, monkeypatch):
        """On Windows, and under a limit of processor time, a use between two ticks seems to take no time."""
        monkeypatch.undo()
        contestant, now, _ = counted(lambda steps: 1e-4 * steps / 40.0)
        monkeypatch.setattr(contest.time, "process_time", lambda: now[0] // 0.016 * 0.016)
        entries = measured([contestant], "error", 1.0, 10.0)
        # A turn is one tick: some 160 uses of one setting and 80 of the other.
        assert [entry.seconds for entry in entries] == pytest.approx([1e-4, 2e-4], rel=0.05)
