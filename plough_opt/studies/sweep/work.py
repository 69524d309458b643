"""The work of a worker: it evaluates points, each from its own values alone, until its time is up."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import NOT_NUMBERS
from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.notes import merge
from plough_opt.core.process import one_of_several

Array = NDArray[np.float64]

# Largest number of evaluations that a worker keeps, with everything that they have built.
_MOST_KEPT: Final = 4
_kept: dict[str, Evaluation] = {}


class WithNotes(dict[str, float]):
    """Results of a point, with notes on them.

    Attributes:
        notes: sentences; sentences that differ only in numbers become one note, with their ranges.
    """

    def __init__(self, results: Mapping[str, float], notes: Sequence[str] = ()) -> None:
        super().__init__(results)
        self.notes = tuple(notes)


@runtime_checkable
class ManyPoints(Protocol):
    """An evaluation of many points at once, with the same results for each point as if it were alone."""

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results."""

    def many(self, values: Array) -> tuple[Array, dict[int, str], Sequence[tuple[int, int, Sequence[str]]]]:
        """Evaluate points.

        Args:
            values: of the quantities, a row for each point.

        Returns:
            The results, a row for each point; row of a failed point -> reason; and notes, each as (row of the first
            point that has it, number of points that have it, sentences).
        """


Evaluation = Callable[[dict[str, float]], Mapping[str, float]] | ManyPoints


@dataclass
class Done:
    """The outcome of a task.

    Attributes:
        points: number of points done, counted from the first.
        results: a row for each of these, meaningless for failed ones; None if all failed.
        names: of the results.
        reasons: row of a failed point -> reason.
        notes: kind -> (text with the ranges of its numbers, row of the first point, number of points).
        seconds: time taken [s].
    """

    points: int
    results: Array | None = None
    names: tuple[str, ...] = ()
    reasons: dict[int, str] = field(default_factory=dict)
    notes: dict[str, tuple[str, int, int]] = field(default_factory=dict)
    seconds: float = 0.0

    def note(self, place: int, texts: Sequence[str], points: int = 1) -> None:
        """Count notes on a point, or on several points of which the first one is given."""
        notes = {kind: text for kind, (text, _, _) in self.notes.items()}
        for kind in {merge(notes, text): None for text in texts}:
            _, start, count = self.notes.get(kind, ("", place, 0))
            self.notes[kind] = (notes[kind], start, count + points)


def work(key: str, evaluation: Evaluation, names: tuple[str, ...], values: Array, budget: float) -> Done:
    """Evaluate points.

    Args:
        key: identifies the evaluation. A worker keeps the first evaluation with a key, and everything that this built.
        evaluation: the function.
        names: of the quantities.
        values: of the quantities, a row for each point.
        budget: time [s] after which no further point is begun.
    """
    began = time.perf_counter()
    evaluation = _kept.setdefault(key, evaluation)
    while len(_kept) > _MOST_KEPT:
        _kept.pop(next(iter(_kept)))
    with one_of_several():
        if isinstance(evaluation, ManyPoints):
            done = _together(evaluation, values)
        else:
            done = _one_by_one(evaluation, names, values, began + budget)
    if done.results is not None:
        # Negative zero becomes zero, as SQLite stores it.
        done.results += 0.0
    done.seconds = time.perf_counter() - began
    return done


def _together(evaluation: ManyPoints, values: Array) -> Done:
    done = Done(len(values))
    results, reasons, notes = evaluation.many(values)
    done.results, done.names, done.reasons = np.asarray(results, dtype=float), tuple(evaluation.results), dict(reasons)
    for k in np.flatnonzero(~np.isfinite(done.results).all(axis=1)).tolist():
        if k not in done.reasons:
            column = int(np.flatnonzero(~np.isfinite(done.results[k]))[0])
            done.reasons[k] = _not_finite(done.names[column], float(done.results[k, column]))
    for place, points, texts in notes:
        done.note(place, texts, points)
    return done


def _one_by_one(
    evaluation: Callable[[dict[str, float]], Mapping[str, float]],
    names: tuple[str, ...],
    values: Array,
    until: float,
) -> Done:
    done = Done(0)
    rows: list[list[float] | None] = []
    for k, row in enumerate(values.tolist()):
        try:
            results = evaluation(dict(zip(names, row, strict=True)))
            numbers = _numbers(results)
        except Exception as error:
            done.reasons[k] = str(error) if isinstance(error, PloughError) else f"{type(error).__name__}: {error}"
            rows.append(None)
        else:
            done.names = done.names or tuple(numbers)
            if tuple(numbers) != done.names:
                break  # the next task begins here, and the store refuses its names
            rows.append(list(numbers.values()))
            if bad := [name for name, number in numbers.items() if not math.isfinite(number)]:
                done.reasons[k] = _not_finite(bad[0], numbers[bad[0]])
            else:
                done.note(k, getattr(results, "notes", ()))
        done.points += 1
        if time.perf_counter() > until:
            break
    if done.names:
        empty = [math.nan] * len(done.names)
        done.results = np.array([empty if row is None else row for row in rows])
    return done


def _numbers(results: Mapping[str, float]) -> dict[str, float]:
    """Return the results of an evaluation as named floats.

    Raises:
        InputError: they are not a dictionary of numbers.
    """
    if not isinstance(results, Mapping):
        raise InputError(f"the function returned {results!r}: return a dictionary of named numbers")
    numbers = {}
    for name, number in results.items():
        try:
            numbers[name] = float(number)
        except NOT_NUMBERS as error:
            raise InputError(f"{name} = {str(number)[:80]!r} is not a number: {error}") from None
    return numbers


def _not_finite(name: str, number: float) -> str:
    return f"{name} = {number} is not finite"
