"""Contests: times in turns, the efficient front, and the cheapest setting that is good enough."""

import itertools
from collections import Counter
from dataclasses import dataclass, field, replace

import pytest

import plough_opt as po
from plough_opt.studies.accuracy import contest
from plough_opt.studies.accuracy.contest import Contestant, Entry, cheapest, efficient, measured, step_counts
from plough_opt.studies.accuracy.methods import FACTORS, Task


def entry(seconds, error, failure=None):
    return Entry("integrator", "m", "", seconds, errors={} if failure else {"e": error}, failure=failure)


FAST, MORE_EXACT, MOST_EXACT = entry(1, 1e-2), entry(2, 1e-5), entry(4, 1e-9)
TINY = [entry(1, 3e-16), entry(2, 1e-17)]


@pytest.mark.parametrize(
    ("entries", "floor", "front"),
    [
        pytest.param([entry(5, 1e-8), MOST_EXACT, entry(3, 1e-4), FAST, entry(1, 1e-1), MORE_EXACT], 0.0,
                     [FAST, MORE_EXACT, MOST_EXACT], id="from the fastest to the most exact"),
        pytest.param([entry(1, 0.0, failure="no"), Entry("model", "q", "", 0.1, errors={"other": 0.0}), FAST], 0.0,
                     [FAST], id="failures and other errors do not count"),
        pytest.param(TINY, 1e-15, TINY[:1], id="errors below the floor are one"),
        pytest.param(TINY, 0.0, TINY, id="without a floor they are two"),
        pytest.param([entry(1, 1e-9), entry(2, 0.95e-9), entry(3, 0.85e-9)], 0.0, [entry(1, 1e-9), entry(3, 0.85e-9)],
                     id="a little more exact is no gain"),
    ],
)  # fmt: skip
def test_the_front_holds_what_no_other_beats_in_both(entries, floor, front):
    assert efficient(entries, "e", floor) == front


def test_the_cheapest_just_meets_the_error():
    good, exact = entry(2, 1e-6), entry(9, 1e-12)
    assert cheapest([entry(1, 1.1e-6), good, exact], "e", 1e-6) is good
    assert cheapest([entry(1, 1e-3), entry(1, 0.0, failure="no")], "e", 1e-6) is None
    # A finer setting of one method is faster by noise alone.
    assert cheapest([good, entry(1.5, 1e-12)], "e", 1e-6) is good
    # Of two methods that are equally fast within the noise of the clock, the first.
    other = replace(good, method="n")
    assert cheapest([replace(other, seconds=2.1), good], "e", 1e-6).method == "n"
    assert cheapest([replace(other, seconds=2.3), good], "e", 1e-6) is good


@dataclass
class Clock:
    """Processor time that uses wind, and the steps of all settings built and of all uses so far."""

    now: float = 0.0
    built: list = field(default_factory=list)
    used: list = field(default_factory=list)

    def contestant(self, method="fast", order=8, factors=FACTORS, *, error=lambda _: 0.5, seconds=None):
        """Return a contestant of some order.

        Args:
            method: its name.
            order: order of its error over the steps.
            factors: multiples of 40 steps that are measured in any case.
            error: steps -> factor on the error.
            seconds: (steps, number of the use of that setting) -> time of a use [s].
        """
        seconds = seconds or (lambda steps, _: 1e-3 * steps / 40.0)

        def prepare(steps):
            self.built.append((method, steps))
            numbers = itertools.count()

            def use():
                self.used.append(steps)
                assert len(self.used) < 100_000, "the contest does not end"
                self.now += seconds(steps, next(numbers))

            return use, lambda: (use(), {"error": error(steps) * (40.0 / steps) ** order})[1]

        rungs, shown = step_counts(40, factors)
        return Contestant("family", method, prepare, lambda found: found, rungs, shown, "{} steps".format)


@pytest.fixture
def clock(monkeypatch):
    own = Clock()
    monkeypatch.setattr(contest.time, "process_time", lambda: own.now)
    return own


def winner(contestants, wanted, allowance=1e3):
    return cheapest(measured(contestants, "error", wanted, allowance), "error", wanted)


@pytest.mark.parametrize(("order", "wanted"), [(4, 1e-1), (4, 1e-6), (8, 1e-4), (8, 1e-9)])
def test_it_is_within_a_tenth_of_the_least_steps_in_thin_and_in_full_mode(clock, wanted, order):
    true = 40.0 * (0.5 / wanted) ** (1.0 / order)
    found = []
    for thin in (False, True):
        clock.built.clear()
        factors = Task(None, 0.2, 4, 1.0, thin=thin).some(FACTORS)
        found.append(winner([clock.contestant("fast", order, factors)], wanted))
    full, thin = (best and best.setting for best in found)
    assert full == thin
    assert (full is not None) == (true <= 40.0 * max(FACTORS))
    if full is not None:
        assert int(full.split()[0]) == pytest.approx(true, rel=0.1, abs=1.0)
        # The halvings of some seventy settings, and those measured in any case.
        assert len(clock.built) <= 4 + 7


def test_errors_that_do_not_fall_evenly_lead_both_modes_to_the_same(clock):
    # Every fifth setting is a hundred times as exact by chance.
    lucky = dict(zip(step_counts(40, FACTORS)[0], itertools.cycle((0.5, 0.5, 5e-3, 0.5, 0.5)), strict=False))
    tracks = (clock.contestant("fast", 4, factors, error=lucky.get) for factors in (FACTORS, (0.125, 0.5, 2.0, 4.0)))
    full, thin = (winner([track], 3e-3).setting for track in tracks)
    assert full == thin


def test_what_may_still_win_is_narrowed_down_and_what_is_too_slow_is_not(clock):
    fast = clock.contestant(error=lambda n: 25.0 if n > 50 else contest.refuse("too coarse"))
    # The coarsest of its settings measured in any case is slower, but far too exact.
    slow = clock.contestant("slow", factors=(1, 2, 4), error=lambda _: 5e-10, seconds=lambda n, _: 2.5e-3 * n / 40.0)
    slower = clock.contestant("slower", seconds=lambda n, _: 0.03 * n / 40.0)
    entries = measured([fast, slow, slower], "error", 1e-3, 1e3)
    assert cheapest(entries, "error", 1e-3).method == "slow"
    # Of the settings without a result only those measured in any case are reported.
    assert [e.setting for e in entries if e.failure == "too coarse"] == [f"{n} steps" for n in (5, 10, 20, 40)]
    counts = Counter(name for name, _ in clock.built)
    assert counts["fast"] > len(fast.always)
    assert counts["slower"] == len(slower.always)


def test_one_slow_measurement_changes_no_advice(clock):
    """A good setting is timed again, even if it seemed slow at first."""
    wanted = 0.5 * 0.5**8

    def seconds(steps, number):
        # Slow at first, and now and then in turns.
        slow = steps == 80 and (number < 16 or number % 5 == 0)
        return 1e-3 * steps / 40.0 * (3.0 if slow else 1.0)

    best = winner([clock.contestant(seconds=seconds)], wanted, 1.0)
    assert (best.setting, best.seconds) == ("80 steps", pytest.approx(2e-3))


@pytest.mark.parametrize(("allowance", "turns"), [(10.0, 4), (1.0, 3)])
def test_turns_of_what_takes_long_are_few(clock, allowance, turns):
    for count in (1, 2):
        slow = [clock.contestant(name, factors=(1,), seconds=lambda *_: 3.0) for name in "ab"[:count]]
        measured(slow, "error", 0.5, allowance)
        # Once for its result and once again. What may win takes turns until all have taken twice the allowance.
        assert len(clock.used) == 2 * len(clock.built) + 2 * turns * (count == 2)


def test_a_clock_that_ticks_coarsely_still_tells_short_uses_apart(clock, monkeypatch):
    """On Windows, and under a limit of processor time, a use between two ticks seems to take no time."""
    monkeypatch.setattr(contest.time, "process_time", lambda: clock.now // 0.016 * 0.016)
    entries = measured([clock.contestant(factors=(1, 2), seconds=lambda n, _: 1e-4 * n / 40.0)], "error", 1.0, 10.0)
    # A turn is one tick: some 160 uses of one setting and 80 of the other.
    times = {e.setting: e.seconds for e in entries}
    assert [times["40 steps"], times["80 steps"]] == pytest.approx([1e-4, 2e-4], rel=0.05)


def test_a_repetition_that_takes_too_long_leaves_the_first_time(clock):
    def seconds(_steps, number):
        if number:
            clock.now += 5.0
            raise po.NotConverged("no optimum after 5 s", "Maximum_WallTime_Exceeded")
        return 1.0

    (only,) = measured([clock.contestant(factors=(0.0078125,), seconds=seconds)], "error", 1e9, 10.0)
    assert (only.failure, only.seconds) == (None, 1.0)
