"""A contest: methods over their settings, what each costs, how far it is off, and which are worth their time.

Of every method some settings are tried in any case. Of those that may be the cheapest all settings are halved again and
again, down to neighbours that differ by a tenth in cost, of which the one misses the wanted error and the other reaches
it: where that ends depends on the method's errors alone, neither on a clock nor on what else was tried. Then each
method's coarsest setting is measured in turns, so that what else the machine does meets all alike.
"""

import contextlib
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from plough_opt.core.errors import PloughError

# Ratio of times that a repetition may give to what takes equally long.
_AS_CHEAP = 1.1
# Part of an error by which another must differ from it to count as different.
_TELLING = 0.9
# How much longer the next finer setting may be expected to take.
_NEXT: Final = 3.0
# Methods are narrowed down whose time is within so many times the least, and measured again in turns within this.
_WORTH: Final = 4.0
_CLOSE: Final = 1.6
# Turns in which the closest are measured again, and the time [s] of one turn of one of them at the least; the fewest
# turns where they take long, and how many times the allowance of one use all of them may.
_TURNS: Final = 15
_LEAST_TURN: Final = 3e-3
_FEWEST_TURNS: Final = 3
_ALL_TURNS: Final = 2.0
# Repetitions of which a time is the median.
_LEAST, _MOST = 3, 15
# The coarsest number of steps in eighths of a power of two: a 128th of the usual one.
_COARSEST: Final = -56

Use = Callable[[], object]
Progress = Callable[[str, float], None]
"""Called with what is being done, and with the part that is done."""


@dataclass(frozen=True)
class Entry:
    """One method with one setting in a contest.

    Attributes:
        family: what kind of choice it is, such as ``"integrator"`` or ``"quadrature"``.
        method: its name.
        setting: its setting as text, such as ``"tolerance 1e-08"`` or ``"40 steps"``.
        seconds: median processor time of one use after a warm-up [s], of what may be the cheapest the least of several
            turns; infinite of a failure.
        setup: time to build it, once [s], that of a compiler included.
        errors: relative errors [-] by what is wrong; empty of a failure.
        failure: why it has no result, or None.
        elsewhere: of a solve that ended in another local optimum than the reference's, a clause that says so; its
            errors are those from that optimum, and it is not ranked.
        checked: median time of `simulate` by a named integrator, which checks it [s], where that was measured.
    """

    family: str
    method: str
    setting: str
    seconds: float
    setup: float = 0.0
    errors: Mapping[str, float] = field(default_factory=dict)
    failure: str | None = None
    elsewhere: str = ""
    checked: float | None = None

    @property
    def label(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}" if self.setting else self.method


@dataclass(frozen=True)
class Track:
    """A method over its settings.

    Attributes:
        family: of its entries.
        method: its name.
        prepare: setting -> what returns its result, or (what is timed, what returns its result).
        errors: result -> its errors.
        rungs: its settings from coarse to fine; neighbours differ by about a tenth in cost.
        shown: places of those that are tried in any case; None of all, and then of no others.
        label: setting -> its text.
        least: setting -> time [s] that it takes at the very least.
        patience: setting -> how many times the allowance it may take.
        elsewhere: result -> a clause as of `Entry`.
        check: setting -> the use of `simulate` by it; None of what has no check, or is one.
    """

    family: str
    method: str
    prepare: Callable[[Any], Use | tuple[Use, Callable[[], Any]]]
    errors: Callable[[Any], Mapping[str, float]]
    rungs: Sequence[Any] = ("",)
    shown: Sequence[int] | None = None
    label: Callable[[Any], str] = str
    least: Callable[[Any], float] = lambda _: 0.0
    patience: Callable[[Any], float] = lambda _: 1.0
    elsewhere: Callable[[Any], str] = lambda _: ""
    check: Callable[[Any], Use] | None = None


def rungs_of(usual: float, factors: Sequence[float], unit: int = 1) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return numbers of steps from coarse to fine in ratios of 2^(1/8), and the places of some multiples of a number.

    Args:
        usual: number of steps.
        factors: multiples of it that are tried in any case, powers of two.
        unit: of which every number is a multiple.
    """

    def steps(eighths: float) -> int:
        return max(1, math.ceil(usual * math.exp2(eighths / 8.0) / unit - 1e-9)) * unit

    rungs = list(dict.fromkeys(steps(k) for k in range(_COARSEST, 8 * round(math.log2(max(factors))) + 1)))
    shown = dict.fromkeys(rungs.index(steps(8.0 * math.log2(factor))) for factor in factors)
    return tuple(rungs), tuple(shown)


def failure(family: str, method: str, reason: object, setting: str = "") -> Entry:
    """Return the entry of a contestant without a result."""
    return Entry(family, method, setting, math.inf, failure=str(reason))


def measured(
    tracks: Sequence[Track],
    key: str,
    wanted: float,
    allowance: float,
    *,
    floor: float = 0.0,
    progress: Progress = lambda _stage, _part: None,
) -> list[Entry]:
    """Return the entries of tracks: what is shown, and what leads to the cheapest setting that reaches an error.

    Args:
        tracks: of contestants that are ranked together.
        key: of `Entry.errors`, by which.
        wanted: error to reach [-].
        allowance: time [s] that one use may take.
        floor: error [-] of the reference itself.
        progress: called with the method that is next and the part done.
    """
    tried = [_Tried(track, key, wanted, allowance) for track in tracks]
    for k, one in enumerate(tried):
        progress(f"{one.track.family}: {one.track.method}", k / len(tried))
        one.try_shown()
    best = min((one.least for one in tried), default=math.inf)
    for one in tried:
        if one.track.shown is not None and one.least <= _WORTH * best < math.inf:
            one.narrow()
    _measure_in_turns(tried, allowance)
    entries = [entry for one in tried for entry in one.entries.values()]
    for family in dict.fromkeys(track.family for track in tracks):
        front = efficient([entry for entry in entries if entry.family == family], key, floor)
        for one in tried:
            one.check(front)
    return [one.entries[place] for one in tried for place in sorted(one.entries)]


class _Tried:
    """The settings of a track that were tried: place -> entry, and what is timed."""

    def __init__(self, track: Track, key: str, wanted: float, allowance: float) -> None:
        self.track = track
        self.entries: dict[int, Entry] = {}
        self.uses: dict[int, Use] = {}
        self._key, self._wanted, self._allowance = key, wanted, allowance

    def try_shown(self) -> None:
        """Try what is tried in any case, until it takes too long."""
        track, expected = self.track, 0.0
        for place in range(len(track.rungs)) if track.shown is None else track.shown:
            setting = track.rungs[place]
            expected = max(expected, track.least(setting))
            allowed = self._allowance * track.patience(setting)
            if expected > allowed:
                self._fail(place, f"cut off: expected to take {expected:.2g} s, {allowed:.2g} s allowed")
            else:
                expected = _NEXT * self._try(place)

    def _try(self, place: int) -> float:
        """Measure a setting; return the time [s] of one use, or of its failure."""
        track, setting = self.track, self.track.rungs[place]
        started, clock = time.process_time(), time.perf_counter()
        try:
            prepared = track.prepare(setting)
            use, find = prepared if isinstance(prepared, tuple) else (prepared, prepared)
            built = time.perf_counter() - clock  # by a compiler, perhaps, which is another process
            solving = time.process_time()
            found = find()
            seconds = time.process_time() - solving
            errors, elsewhere = track.errors(found), track.elsewhere(found)
        except (PloughError, RuntimeError) as error:
            self._fail(place, _reason(error))
            return time.process_time() - started
        first = solving + seconds - started
        # A repetition may take just longer than a limit that the first just kept.
        with contextlib.suppress(PloughError, RuntimeError):
            seconds = median_time(use, budget=0.1 * self._allowance, warm=True)
        setup, label = max(built, first - seconds), track.label(setting)
        self.entries[place] = Entry(track.family, track.method, label, seconds, setup, errors, elsewhere=elsewhere)
        self.uses[place] = use
        return seconds

    def _fail(self, place: int, reason: str) -> None:
        track = self.track
        self.entries[place] = failure(track.family, track.method, reason, track.label(track.rungs[place]))

    @property
    def good(self) -> dict[int, Entry]:
        """The settings that were tried and reach the error."""
        reached = (
            (place, entry) for place, entry in self.entries.items() if cheapest([entry], self._key, self._wanted)
        )
        return dict(reached)

    @property
    def least(self) -> float:
        """The least time [s] of a setting that reaches the error; infinite where none does."""
        return min((entry.seconds for entry in self.good.values()), default=math.inf)

    def narrow(self) -> None:
        """Halve the settings down to a pair of neighbours of which the finer one alone reaches the error.

        The halving goes over all settings, so that it comes to the same pair whichever of them were tried before; what
        is finer than one that is known to reach the error is not tried, for it may take long.
        """
        known, bad, good = min(self.good), -1, len(self.track.rungs) - 1
        while good - bad > 1:
            middle = (good + bad) // 2
            if middle >= known:
                good = middle
                continue
            shown = middle in self.entries
            if not shown:
                self._try(middle)
            if middle in self.good:
                good = middle
            else:
                bad = middle
                if self.entries[middle].failure is not None and not shown:
                    del self.entries[middle]  # too coarse to have a result, and not among those shown

    def check(self, front: Sequence[Entry]) -> None:
        """Measure `simulate` by the settings that are efficient, which checks them."""
        check = self.track.check
        for place, entry in self.entries.items():
            if check is not None and entry in front:
                with contextlib.suppress(PloughError):
                    seconds = median_time(check(self.track.rungs[place]), budget=0.1 * self._allowance)
                    self.entries[place] = replace(entry, checked=seconds)


def _measure_in_turns(tried: list[_Tried], allowance: float) -> None:
    """Measure again, one after the other and all of them several times, what may be the cheapest.

    That is of every method that was narrowed down the coarsest setting, however long it seemed to take, and what seemed
    to take hardly longer than the cheapest. The least time counts: what else the machine does only adds to it.
    """
    best = min((one.least for one in tried), default=math.inf)
    taken: dict[tuple[int, int], list[float]] = {}
    for number, one in enumerate(tried):
        good = one.good
        for place, entry in good.items():
            if entry.seconds <= (_WORTH if place == min(good) else _CLOSE) * best:
                taken[number, place] = []
    if len(taken) < 2:
        return
    spent = 0.0
    for turn in range(_TURNS):
        if turn >= _FEWEST_TURNS and spent > _ALL_TURNS * allowance:
            break
        for (number, place), seconds in taken.items():
            # By the clock, not by the time that was measured: where that is coarse a short use seems to take none.
            use, often, started = tried[number].uses[place], 0, time.process_time()
            while not often or time.process_time() - started < _LEAST_TURN:
                with contextlib.suppress(PloughError, RuntimeError):
                    use()
                often += 1
            seconds.append((time.process_time() - started) / often)
            spent += often * seconds[-1]
    for (number, place), seconds in taken.items():
        entries = tried[number].entries
        entries[place] = replace(entries[place], seconds=min(seconds))


def _reason(error: Exception) -> str:
    """Return a failure's reason; of CasADi's own, which go over many lines, the last."""
    if isinstance(error, PloughError):
        return str(error)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"CasADi gave up: {lines[-1] if lines else type(error).__name__}"


def median_time(action: Use, *, budget: float = 0.5, warm: bool = False) -> float:
    """Return the median processor time [s] of an action after a warm-up.

    Processor time is that of this process: what else the machine does meanwhile is not in it.

    Args:
        action: what is timed; at least thrice, if it does not take long beside the budget, and at most 15 times.
        budget: time [s] after which no repetition begins beyond the third, and after ten of which none at all.
        warm: whether the action was done before: there is no warm-up then.
    """
    if not warm:
        action()
    seconds: list[float] = []
    while not seconds or (len(seconds) < _MOST and sum(seconds) < budget * (1.0 if len(seconds) >= _LEAST else 10.0)):
        started = time.process_time()
        action()
        seconds.append(time.process_time() - started)
    return statistics.median(seconds)


def efficient(entries: Sequence[Entry], error: str, floor: float = 0.0) -> list[Entry]:
    """Return the entries that no other beats in both time and one error, from the fastest to the most exact.

    What takes longer for an error smaller by less than a tenth is beaten too.

    Args:
        entries: of one contest; failures are left out.
        error: the key of `Entry.errors` that counts.
        floor: error [-] of the reference itself, below which errors do not differ.
    """
    ranked = sorted(
        (entry for entry in entries if entry.failure is None and error in entry.errors),
        key=lambda entry: (entry.seconds, entry.errors[error]),
    )
    front: list[Entry] = []
    least = math.inf
    for entry in ranked:
        found = max(entry.errors[error], floor)
        if found < _TELLING * least:
            front.append(entry)
            least = found
    return front


def cheapest(entries: Sequence[Entry], error: str, wanted: float) -> Entry | None:
    """Return the fastest entry whose error [-] is at most the wanted one, or None.

    Of entries that take equally long within the noise of a clock it is the first, so that a repetition finds it again.
    """
    good = [entry for entry in entries if entry.failure is None and entry.errors.get(error, math.inf) <= wanted]
    least = min((entry.seconds for entry in good), default=math.inf)
    return next((entry for entry in good if entry.seconds <= _AS_CHEAP * least), None)


def duration_text(seconds: float) -> str:
    """Return a time with its unit."""
    # A thousandth that rounding makes a little less is one still.
    for least, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= 0.99 * least:
            return f"{seconds / least:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"
