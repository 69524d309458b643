"""How thoroughly a search over a design's variables is carried out."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError, listed, nearest
from plough_opt.core.units import in_si
from plough_opt.design.declarations import Variable

Search = str | int | Sequence[str]
"""One of `WORDS`, a time such as "20 s" or "5 min", a number of designs, or names of the variables to search."""

WORDS = ("auto", "thorough", "near", "local")
"""The words accepted as `search`; "local" means the same as "near"."""

AUTO_SECONDS = 20.0
"""Processor time after which no further part of an automatic search begins [s]; what has begun may take ten more."""


# Sample size with one, two, ... variables; the last one with more of them, too.
_DESIGNS: Final = (512, 2048, 4096)
# Runs in a sample if they are integrated one by one, each for milliseconds.
_ONE_BY_ONE: Final = 256
# Descents of a sample, to which those for each variable are added.
_DESCENTS: Final = 4


# Largest number of designs accepted as `search`: it takes days.
_MOST_ACCEPTED = 1_000_000_000
# A text that begins like a number, "nan" and "inf" included.
_NUMBER = re.compile(r"\s*[-+]?(\.?[0-9]|(nan|inf(inity)?)\b)", re.IGNORECASE)


@dataclass(frozen=True)
class Effort:
    """The extent of a search. Each of its rounds consists of a sample, descents, and looks around their ends.

    Attributes:
        designs: sample size in a round.
        rounds: number of rounds, unless one of the following is given.
        most_designs: number of designs after which to stop, or None.
        seconds: time after which to stop [s], or None.
        descents: most descents from local minima of the sample, lowest first.
        followed: most descents from the local minima below uniform designs.
        looks: most looks around the ends, which stop after two in a row that find nothing lower.
    """

    designs: int
    rounds: int = 1
    most_designs: int | None = None
    seconds: float | None = None
    descents: int = 16
    followed: int = 0
    looks: int = 8

    def more(self, rounds: int, designs: int, began: float) -> bool:
        """Return whether to start another round.

        Args:
            rounds: completed rounds.
            designs: designs tried so far.
            began: time at which the search began, by `time.perf_counter` [s].
        """
        if self.seconds is not None:
            return time.perf_counter() - began < self.seconds
        return rounds < self.rounds if self.most_designs is None else designs < self.most_designs


class TimeLimit:
    """Processor time that a solve may take before it leaves out the rest of its search.

    Attributes:
        left_out: names of the parts that were left out.
    """

    def __init__(self, search: Search) -> None:
        """Begin to count the time; only an automatic search has a limit."""
        self._end = time.process_time() + AUTO_SECONDS if isinstance(search, str) and search == "auto" else math.inf
        self.left_out: dict[str, None] = {}

    def passed(self, part: str) -> bool:
        """Return whether a part of the search must be left out."""
        late = time.process_time() >= self._end
        if late:
            self.left_out[part] = None
        return late

    def warnings(self, rest: str) -> tuple[str, ...]:
        """Return a sentence on what was left out, if anything was; ``rest`` is its end, with {} for the parts."""
        if not self.left_out:
            return ()
        return (f"after {AUTO_SECONDS:g} s of processor time {rest.format(listed([*self.left_out]))}",)


def effort_of(search: Search, dimensions: int, runs: int, vectorised: bool) -> Effort:
    """Return the extent of a search.

    Args:
        search: see `plough_opt.Design.solve`.
        dimensions: number of variables that are searched.
        runs: number of runs in a design.
        vectorised: whether the runs of many designs are integrated together.
    """
    if vectorised:
        usual = _DESIGNS[min(dimensions, len(_DESIGNS)) - 1]
        # Samples of designs with many runs take some seconds.
        designs = min(usual, max(_ONE_BY_ONE, 60_000 // max(runs, 1)))
    else:
        designs = max(32, _ONE_BY_ONE // max(runs, 1))
    number = number_of(search)
    if number is not None:
        designs = max(8, min(designs, number))
    descents = _DESCENTS + 3 * dimensions
    rounds = 4 if isinstance(search, str) and search == "thorough" else 1
    return Effort(designs, rounds, number, seconds_of(search), descents, _DESCENTS + dimensions)


def number_of(search: Search) -> int | None:
    """Return the number of designs, also one of NumPy, or None if `search` is anything else."""
    return int(search) if isinstance(search, int | np.integer) and not isinstance(search, bool) else None


def seconds_of(search: Search) -> float | None:
    """Return the number of seconds in a text such as "20 s" or "5 min", or None if `search` is anything else."""
    if not isinstance(search, str) or not _NUMBER.match(search):
        return None
    with contextlib.suppress(InputError):
        seconds = float(in_si("search", search, "s"))
        return seconds if 0.0 <= seconds < math.inf else None
    return None


def searched(search: Search, variables: Sequence[Variable]) -> tuple[int, ...]:
    """Return the numbers of the variables to search; none for a search of the guess's basin only.

    Raises:
        InputError: `search` is neither valid nor the name of a variable.
    """
    names = [v.name for v in variables]
    every = tuple(range(len(variables)))
    number = number_of(search)
    if number is not None:
        if not 1 <= number <= _MOST_ACCEPTED:
            raise InputError(f"search = {shown(search)} must be a number of designs, from 1 to {_MOST_ACCEPTED}")
        return every
    begins_with_number = isinstance(search, str) and _NUMBER.match(search) and search not in names
    if (
        not isinstance(search, str | Sequence)
        or isinstance(search, bytes)
        or len(search) == 0
        or (begins_with_number and seconds_of(search) is None)
    ):
        raise InputError(f"search = {shown(search)} must be 'auto', 'thorough', 'near', a number of designs, a time"
                         " such as '20 s', or names of variables")  # fmt: skip
    if search in ("near", "local"):
        return ()
    if search in ("auto", "thorough") or seconds_of(search) is not None:
        return every
    wanted = [search] if isinstance(search, str) else list(search)
    for name in wanted:
        if name not in names:
            known = nearest(str(name), [*WORDS, *names])
            raise InputError(f"search = {shown(name)} is not a variable of this design: {known}")
    return tuple(names.index(name) for name in dict.fromkeys(wanted))
