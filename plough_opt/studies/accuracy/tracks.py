"""Tracks of a contest: a method over its settings from coarse to fine, and the coarsest that reaches the wanted error.

Of every method some settings are tried in any case. Of those that may be the cheapest all settings are halved again and
again, down to neighbours that differ by a tenth in cost, of which the one misses the wanted error and the other reaches
it: where that ends depends on the method's errors alone, neither on a clock nor on what else was tried. Then each
method's coarsest setting is measured in turns, so that what else the machine does meets all alike.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from plough_opt.core.errors import PloughError
from plough_opt.studies.accuracy.contest import Entry, median_time

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

Use = Callable[[], object]


@dataclass(frozen=True)
class Track:
    """A method over its settings.

    Attributes:
        family: of its entries.
        method: its name.
        rungs: its settings from coarse to fine; neighbours differ by about a tenth in cost.
        shown: places of those that are tried in any case.
        label: setting -> its text.
        prepare: setting -> (what is timed, what returns the result).
        errors: result -> its errors.
        least: setting -> time [s] that it takes at the very least.
        patient: setting -> how many times the allowance it may take.
        narrows: whether settings between those shown may be tried.
    """

    family: str
    method: str
    rungs: tuple[Any, ...]
    shown: tuple[int, ...]
    label: Callable[[Any], str]
    prepare: Callable[[Any], tuple[Use, Callable[[], Any]]]
    errors: Callable[[Any], Mapping[str, float]]
    least: Callable[[Any], float] = lambda _: 0.0
    patient: Callable[[Any], float] = lambda _: 1.0
    narrows: bool = True


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


# The coarsest setting in eighths of a power of two: a 128th of the usual steps.
_COARSEST: Final = -56


class _Tried:
    """The settings of a track that were tried: place -> entry, and what is timed."""

    def __init__(self, track: Track, allowance: float) -> None:
        self.track = track
        self.entries: dict[int, Entry] = {}
        self.uses: dict[int, Use] = {}
        self._allowance = allowance

    def try_shown(self) -> None:
        """Try what is tried in any case, until it takes too long."""
        expected = 0.0
        for place in self.track.shown:
            setting = self.track.rungs[place]
            expected = max(expected, self.track.least(setting))
            allowed = self._allowance * self.track.patient(setting)
            if expected > allowed:
                self.entries[place] = self._failure(
                    place, f"cut off: expected to take {expected:.2g} s, {allowed:.2g} s allowed"
                )
                continue
            expected = _NEXT * self._try(place)

    def _try(self, place: int) -> float:
        """Measure a setting; return the time [s] of one use, or of its failure."""
        track, setting = self.track, self.track.rungs[place]
        started, clock = time.process_time(), time.perf_counter()
        try:
            use, find = track.prepare(setting)
            built = time.perf_counter() - clock  # by a compiler, perhaps, which is another process
            found = find()
        except (PloughError, RuntimeError) as error:
            self.entries[place] = self._failure(place, _first_line(error))
            return time.process_time() - started
        first = time.process_time() - started
        seconds = median_time(use, budget=0.1 * self._allowance, warm=True)
        setup = max(built, first - seconds)
        errors = track.errors(found)
        self.entries[place] = Entry(track.family, track.method, track.label(setting), seconds, setup, errors)
        self.uses[place] = use
        return seconds

    def _failure(self, place: int, reason: str) -> Entry:
        track = self.track
        return Entry(track.family, track.method, track.label(track.rungs[place]), math.inf, failure=reason)

    def reaches(self, place: int, key: str, wanted: float) -> bool:
        """Return whether a setting that was tried reaches an error."""
        entry = self.entries[place]
        return entry.failure is None and entry.errors.get(key, math.inf) <= wanted

    def cheapest(self, key: str, wanted: float) -> float:
        """Return the least time [s] of a setting that reaches an error; infinite where none does."""
        return min((e.seconds for p, e in self.entries.items() if self.reaches(p, key, wanted)), default=math.inf)

    def coarsest(self, key: str, wanted: float) -> int | None:
        """Return the place of the coarsest setting that was tried and reaches an error; None where none does."""
        return min((place for place in self.entries if self.reaches(place, key, wanted)), default=None)

    def narrow(self, key: str, wanted: float) -> None:
        """Halve the settings down to a pair of neighbours of which the finer one alone reaches an error.

        The halving goes over all settings, so that it comes to the same pair whichever of them were tried before; what
        is finer than one that is known to reach the error is not tried, for it may take long.
        """
        known, bad, good = self.coarsest(key, wanted), -1, len(self.track.rungs) - 1
        assert known is not None  # what nothing reaches is not narrowed down
        while good - bad > 1:
            middle = (good + bad) // 2
            if middle >= known:
                good = middle
                continue
            if middle not in self.entries:
                self._try(middle)
            if self.reaches(middle, key, wanted):
                good = middle
            else:
                bad = middle
                if self.entries[middle].failure is not None and middle not in self.track.shown:
                    del self.entries[middle]  # too coarse to have a result, and asked for by nobody


def measured(tracks: Iterable[Track], key: str, wanted: float, allowance: float) -> list[Entry]:
    """Return the entries of tracks: what is shown, and what leads to the cheapest setting that reaches an error.

    Args:
        tracks: of contestants that are ranked together.
        key: of `Entry.errors`, by which.
        wanted: error to reach [-].
        allowance: time [s] that one use may take.
    """
    tried = [_Tried(track, allowance) for track in tracks]
    for one in tried:
        one.try_shown()
    best = min((one.cheapest(key, wanted) for one in tried), default=math.inf)
    for one in tried:
        if one.track.narrows and one.cheapest(key, wanted) <= _WORTH * best < math.inf:
            one.narrow(key, wanted)
    _measure_in_turns(tried, key, wanted, allowance)
    return [one.entries[place] for one in tried for place in sorted(one.entries)]


def _measure_in_turns(tried: list[_Tried], key: str, wanted: float, allowance: float) -> None:
    """Measure again, one after the other and all of them several times, what may be the cheapest.

    That is of every method that was narrowed down the coarsest setting, however long it seemed to take, and what seemed
    to take hardly longer than the cheapest. The least time counts: what else the machine does only adds to it.
    """
    best = min((one.cheapest(key, wanted) for one in tried), default=math.inf)
    close = [
        (one, place)
        for one in tried
        for place, entry in one.entries.items()
        if one.reaches(place, key, wanted)
        and entry.seconds <= (_WORTH if place == one.coarsest(key, wanted) else _CLOSE) * best
    ]
    if len(close) < 2:
        return
    taken: list[list[float]] = [[] for _ in close]
    spent = 0.0
    for turn in range(_TURNS):
        if turn >= _FEWEST_TURNS and spent > _ALL_TURNS * allowance:
            break
        for (one, place), seconds in zip(close, taken, strict=True):
            often = max(1, math.ceil(_LEAST_TURN / max(one.entries[place].seconds, 1e-9)))
            use, started = one.uses[place], time.process_time()
            for _ in range(often):
                use()
            seconds.append((time.process_time() - started) / often)
            spent += often * seconds[-1]
    for (one, place), seconds in zip(close, taken, strict=True):
        one.entries[place] = replace(one.entries[place], seconds=min(seconds))


def _first_line(error: Exception) -> str:
    if isinstance(error, PloughError):
        return str(error)
    return f"CasADi gave up: {str(error).strip().splitlines()[-1]}" if str(error).strip() else "CasADi gave up"
