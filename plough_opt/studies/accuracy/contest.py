"""Contest of methods: what each setting costs, how far it is off, and which settings are worth their time.

Each contestant is measured at a few of its settings in any case. Contestants that may be the cheapest are then narrowed
down by halving, to two neighbouring settings that differ by a tenth in cost, of which only the finer one reaches the
wanted error. Where that ends depends on the errors alone, not on the clock or on what else was measured. Last, good
settings that may be the cheapest are timed again in turns, so that other work on the machine disturbs all of them
alike.
"""

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.plain_data import MaybeInfinite
from plough_opt.design.exploring import Progress, silent

# Times that differ by less than this factor are equal within the noise of repetitions.
_EQUAL_TIMES: Final = 1.1
# An error counts as smaller only below this part of another.
_SMALLER: Final = 0.9
# Factor by which the next finer setting may be expected to take longer.
_NEXT_SETTING: Final = 3.0
# Contestants within this factor of the least time are narrowed down; their coarsest good setting is timed again.
_WORTH_NARROWING: Final = 4.0
# Other good settings within this factor of the least time are timed again too.
_CLOSE: Final = 1.6
# Turns in which settings are timed; fewer if they take long, but at least so many of settings that are timed again.
_TURNS: Final = 15
_FEWEST_TURNS: Final = 3
# Least time of one setting in a turn [s]: a shorter use is repeated.
_LEAST_TURN: Final = 3e-3
# Time after which no further turn begins, in allowances of one use: of one setting alone, and of those timed again.
_REPETITIONS: Final = 0.1
_ALL_TURNS: Final = 2.0
# Exponent of the coarsest number of steps, in eighths of a power of two: a 128th of the usual number.
_COARSEST: Final = -56

Use = Callable[[], object]
"""One use of a method, which is timed."""


@dataclass(frozen=True)
class Entry:
    """Result of one method with one setting.

    Attributes:
        family: kind of choice, such as ``"integrator"`` or ``"quadrature"``.
        method: name of the method.
        setting: setting as text, such as ``"tolerance 1e-08"`` or ``"40 steps"``.
        seconds: processor time of one use after a warm-up [s], the least of several; infinite for a failure.
        setup: time to build the method once, with that of a compiler [s].
        errors: relative errors by name [-]; empty for a failure.
        failure: reason why there is no result, or None.
        elsewhere: for a solve that ended in another local optimum than the reference, a clause that says so. It is not
            ranked.
        checked: time of `simulate` with this method, which checks the result [s]; None if not measured.
    """

    family: str
    method: str
    setting: str
    seconds: MaybeInfinite
    setup: float = 0.0
    errors: Mapping[str, MaybeInfinite] = field(default_factory=dict)
    failure: str | None = None
    elsewhere: str = ""
    checked: float | None = None

    @property
    def label(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}" if self.setting else self.method

    def reaches(self, error: str, wanted: float) -> bool:
        """Return whether there is a result whose error of a name is at most a wanted one [-]."""
        return self.failure is None and self.errors.get(error, math.inf) <= wanted


@dataclass(frozen=True)
class Contestant:
    """A method and its settings.

    Attributes:
        family: family of its entries.
        method: name of the method.
        prepare: setting -> function that returns the result; or two functions, one to time and one for the result.
        errors: result -> relative errors by name.
        settings: settings from coarse to fine; neighbours differ by about a tenth in cost.
        always: places of the settings to measure in any case; None for all of them, without narrowing down.
        label: setting -> text.
        least_time: setting -> lower bound of the time of one use [s].
        patience: setting -> factor on the time allowed for one use.
        elsewhere: result -> clause, as in `Entry`.
        check: setting -> use of `simulate` with it; None if the method has no check or checks itself.
    """

    family: str
    method: str
    prepare: Callable[[Any], Use | tuple[Use, Callable[[], Any]]]
    errors: Callable[[Any], Mapping[str, float]]
    settings: Sequence[Any] = ("",)
    always: Sequence[int] | None = None
    label: Callable[[Any], str] = str
    least_time: Callable[[Any], float] = lambda _: 0.0
    patience: Callable[[Any], float] = lambda _: 1.0
    elsewhere: Callable[[Any], str] = lambda _: ""
    check: Callable[[Any], Use] | None = None


def step_counts(usual: float, factors: Sequence[float], unit: int = 1) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return numbers of steps from coarse to fine in ratios of 2^(1/8), and the places of multiples of the usual one.

    Args:
        usual: usual number of steps.
        factors: the multiples, powers of two.
        unit: divisor of every number of steps.
    """

    def steps(eighths: float) -> int:
        return max(1, math.ceil(usual * math.exp2(eighths / 8.0) / unit - 1e-9)) * unit

    counts = list(dict.fromkeys(steps(k) for k in range(_COARSEST, 8 * round(math.log2(max(factors))) + 1)))
    places = dict.fromkeys(counts.index(steps(8.0 * math.log2(factor))) for factor in factors)
    return tuple(counts), tuple(places)


def refuse(reason: str, *_: Any) -> Any:
    """Raise InputError in place of preparing a contestant that cannot take part."""
    raise InputError(reason)


def measured(
    contestants: Sequence[Contestant],
    key: str,
    wanted: float,
    allowance: float,
    *,
    floor: float = 0.0,
    progress: Progress = silent,
) -> list[Entry]:
    """Return the entries of contestants: settings measured in any case, and those that led to the cheapest good one.

    Args:
        contestants: methods that are ranked together.
        key: key of `Entry.errors` that ranks them.
        wanted: error to reach [-].
        allowance: time that one use may take [s].
        floor: error of the reference itself [-].
        progress: called with the method that is next and the fraction done.
    """
    trials = [_Trial(contestant, key, wanted, allowance) for contestant in contestants]
    for k, trial in enumerate(trials):
        progress(f"{trial.contestant.family}: {trial.contestant.method}", k / len(trials))
        trial.measure_always()
    best = min((trial.least for trial in trials), default=math.inf)
    for trial in trials:
        if trial.contestant.always is not None and trial.least <= _WORTH_NARROWING * best < math.inf:
            trial.narrow()
    _time_again(trials, allowance)
    entries = [entry for trial in trials for entry in trial.entries.values()]
    for family in dict.fromkeys(contestant.family for contestant in contestants):
        front = efficient([entry for entry in entries if entry.family == family], key, floor)
        for trial in trials:
            trial.check(front)
    return [trial.entries[place] for trial in trials for place in sorted(trial.entries)]


class _Trial:
    """Measurements of one contestant.

    Attributes:
        contestant: the contestant.
        entries: place of a setting -> entry.
        uses: place of a setting -> what is timed.
    """

    def __init__(self, contestant: Contestant, key: str, wanted: float, allowance: float) -> None:
        self.contestant = contestant
        self.entries: dict[int, Entry] = {}
        self.uses: dict[int, Use] = {}
        self._key, self._wanted, self._allowance = key, wanted, allowance

    def measure_always(self) -> None:
        """Measure the settings that are measured in any case, until one is expected to take too long."""
        contestant, expected = self.contestant, 0.0
        every = range(len(contestant.settings))
        for place in every if contestant.always is None else contestant.always:
            setting = contestant.settings[place]
            expected = max(expected, contestant.least_time(setting))
            allowed = self._allowance * contestant.patience(setting)
            if expected > allowed:
                self._fail(place, f"cut off: expected to take {expected:.2g} s, {allowed:.2g} s allowed")
            else:
                expected = _NEXT_SETTING * self._measure(place)

    def _measure(self, place: int) -> float:
        """Measure a setting; return the time of one use [s], or of its failure."""
        contestant, setting = self.contestant, self.contestant.settings[place]
        started, clock = time.process_time(), time.perf_counter()
        try:
            prepared = contestant.prepare(setting)
            use, find = prepared if isinstance(prepared, tuple) else (prepared, prepared)
            built = time.perf_counter() - clock  # elapsed time, because a compiler is another process
            solving = time.process_time()
            found = find()
            seconds = time.process_time() - solving
            errors, elsewhere = contestant.errors(found), contestant.elsewhere(found)
        except (PloughError, RuntimeError) as error:
            self._fail(place, _reason(error))
            return time.process_time() - started
        first = solving + seconds - started
        seconds = min(seconds, *least_times([use], _REPETITIONS * self._allowance))
        setup, label = max(built, first - seconds), contestant.label(setting)
        entry = Entry(contestant.family, contestant.method, label, seconds, setup, errors, elsewhere=elsewhere)
        self.entries[place], self.uses[place] = entry, use
        return seconds

    def _fail(self, place: int, reason: str) -> None:
        c = self.contestant
        self.entries[place] = Entry(c.family, c.method, c.label(c.settings[place]), math.inf, failure=reason)

    @property
    def good(self) -> dict[int, Entry]:
        """Entries that reach the wanted error, by place."""
        return {place: own for place, own in self.entries.items() if own.reaches(self._key, self._wanted)}

    @property
    def least(self) -> float:
        """Least time of a setting that reaches the wanted error [s]; infinite if none does."""
        return min((entry.seconds for entry in self.good.values()), default=math.inf)

    def narrow(self) -> None:
        """Halve the settings until only the finer one of two neighbours reaches the wanted error.

        The halving covers all settings, so that it ends at the same pair whichever of them were measured before.
        Settings finer than one that is known to be good count as good without being measured, for they may take long.
        """
        known, bad, good = min(self.good), -1, len(self.contestant.settings) - 1
        while good - bad > 1:
            middle = (good + bad) // 2
            measured_before = middle in self.entries
            if middle < known and not measured_before:
                self._measure(middle)
            if middle >= known or middle in self.good:
                good = middle
            else:
                bad = middle
                if self.entries[middle].failure is not None and not measured_before:
                    del self.entries[middle]  # too coarse to have a result, and not one that is always reported

    def check(self, front: Sequence[Entry]) -> None:
        """Time `simulate`, which checks its result, with the settings on an efficient front."""
        check = self.contestant.check
        for place, entry in self.entries.items():
            if check is not None and entry in front:
                with contextlib.suppress(PloughError):
                    use = check(self.contestant.settings[place])
                    use()
                    checked = least_times([use], _REPETITIONS * self._allowance)[0]
                    self.entries[place] = replace(entry, checked=checked)


def _time_again(trials: list[_Trial], allowance: float) -> None:
    """Time the settings that may be the cheapest again, in turns."""
    best = min((trial.least for trial in trials), default=math.inf)
    close = [
        (trial, place)
        for trial in trials
        for place, entry in trial.good.items()
        if entry.seconds <= (_WORTH_NARROWING if place == min(trial.good) else _CLOSE) * best
    ]
    if len(close) > 1:
        seconds = least_times([trial.uses[place] for trial, place in close], _ALL_TURNS * allowance, _FEWEST_TURNS)
        for (trial, place), least in zip(close, seconds, strict=True):
            trial.entries[place] = replace(trial.entries[place], seconds=least)


def _reason(error: Exception) -> str:
    """Return the reason of a failure; of a message of CasADi, which has many lines, only the last one."""
    if isinstance(error, PloughError):
        return str(error)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"CasADi failed: {lines[-1] if lines else type(error).__name__}"


def least_times(uses: Sequence[Use], enough: float, fewest: int = 1) -> list[float]:
    """Return the least processor time of each use in several turns [s]: other work on the machine only adds to it.

    Processor time is that of this process.

    Args:
        uses: what to time, each used before, so that it needs no warm-up.
        enough: time of all turns after which no further turn begins [s].
        fewest: number of turns in any case.
    """
    least, spent = [math.inf] * len(uses), 0.0
    for turn in range(_TURNS):
        if turn >= fewest and spent > enough:
            break
        for k, use in enumerate(uses):
            # Repeat by the clock rather than by the time measured before: a coarse clock shows 0 for a short use.
            often, taken, started = 0, 0.0, time.process_time()
            while taken < _LEAST_TURN:
                # A repetition may exceed a time limit that the first use just kept.
                with contextlib.suppress(PloughError, RuntimeError):
                    use()
                often, taken = often + 1, time.process_time() - started
            least[k] = min(least[k], taken / often)
            spent += taken
    return least


def efficient(entries: Sequence[Entry], error: str, floor: float = 0.0) -> list[Entry]:
    """Return the entries that no other beats in both time and one error, from the fastest to the most exact.

    A slower entry must have an error smaller by at least a tenth.

    Args:
        entries: entries of one contest; failures are left out.
        error: key of `Entry.errors`.
        floor: error of the reference itself [-], below which errors do not differ.
    """
    ranked = sorted(
        (entry for entry in entries if entry.failure is None and error in entry.errors),
        key=lambda entry: (entry.seconds, entry.errors[error]),
    )
    front: list[Entry] = []
    least = math.inf
    for entry in ranked:
        found = max(entry.errors[error], floor)
        if found < _SMALLER * least:
            front.append(entry)
            least = found
    return front


def cheapest(entries: Sequence[Entry], error: str, wanted: float) -> Entry | None:
    """Return the fastest entry whose error is at most the wanted one [-], or None.

    Of each method only the coarsest such setting counts, because a finer one cannot be faster but by the noise of the
    clock. If several methods are equally fast within that noise, it is the first of them, so that the choice is
    repeatable.

    Args:
        entries: entries, those of a method from coarse to fine.
        error: key of `Entry.errors`.
        wanted: error to reach [-].
    """
    good: dict[tuple[str, str], Entry] = {}
    for entry in entries:
        if entry.reaches(error, wanted):
            good.setdefault((entry.family, entry.method), entry)
    least = min((entry.seconds for entry in good.values()), default=math.inf)
    return next((entry for entry in good.values() if entry.seconds <= _EQUAL_TIMES * least), None)


def duration_text(seconds: float) -> str:
    """Return a time with its unit."""
    # Rounding may make a thousandth a little less, which still is one of the larger unit.
    for least, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= 0.99 * least:
            return f"{seconds / least:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"
