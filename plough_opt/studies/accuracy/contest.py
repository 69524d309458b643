"""A contest of methods: what each costs, how far it is from the reference, and which are worth their time."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

AUTO, COMPILED, BARE = "auto", "auto, compiled", "dop853, compiled"
"""Names of what chooses and checks by itself, interpreted and in machine code, and of bare steps in machine code."""

# Ratio of times that a repetition may give to what takes equally long.
_AS_CHEAP = 1.1
# Part of an error by which another must differ from it to count as different.
_TELLING = 0.9


@dataclass(frozen=True)
class Entry:
    """One method with one setting in a contest.

    Attributes:
        family: what kind of choice it is: ``"integrator"``, ``"model"``, ``"quadrature"``, ``"transcription"``,
            ``"derivatives"``.
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


def error_text(error: float) -> str:
    """Return an error that is asked for as text, with no more digits than it has."""
    return min((f"{error:.{digits}e}" for digits in range(3)), key=lambda text: (float(text) != error, len(text)))


def median_time(
    action: Callable[[], object], *, budget: float = 0.5, least: int = 3, most: int = 15, warm: bool = False
) -> float:
    """Return the median processor time [s] of an action after a warm-up.

    Processor time is that of this process: what else the machine does meanwhile is not in it.

    Args:
        action: what is timed.
        budget: time [s] after which no repetition begins beyond the least, and after ten of which none at all.
        least: smallest number of repetitions of an action that does not take long beside the budget; else it is one.
        most: largest number of repetitions.
        warm: whether the action was done before: there is no warm-up then.
    """
    if not warm:
        action()
    seconds: list[float] = []
    while not seconds or (len(seconds) < most and sum(seconds) < (budget if len(seconds) >= least else 10.0 * budget)):
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
        floor: error [-] of the reference itself, below which errors cannot be told apart.
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
