"""The points of a sweep on any executor, and the file that receives a row for each and is continued."""

from __future__ import annotations

import hashlib
import io
import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cache
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import Any, Final, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import path_of, shown, whole_number
from plough_opt.core.errors import InputError
from plough_opt.core.plain_data import Array
from plough_opt.core.process import available, load_additions, one_of_several, without_notices
from plough_opt.core.saving import Origin, versions
from plough_opt.core.screen import Screen, progress_on
from plough_opt.core.tables import write_rows
from plough_opt.studies.sweep.result import BETWEEN, Sweep, headings, read_sweep

Progress = Callable[[str, float], object]
"""Called with a sentence and the part of the points that are finished."""

# Most points of a task: a killed run loses the tasks under way, and a batch of fewer points takes as long.
_MOST: Final = 1024
_load_additions = cache(load_additions)


class Answer(NamedTuple):
    """Outcome at a point.

    Attributes:
        results: name -> number; empty if the point failed.
        warnings: sentences about it.
        reason: why it failed, or "".
    """

    results: Mapping[str, float]
    warnings: Sequence[str] = ()
    reason: str = ""


@dataclass(frozen=True)
class Plan:
    """What a sweep computes at which points.

    Attributes:
        function: picklable; it takes a dictionary of the quantities at a point, and returns named numbers or an
            `Answer`. One with a method ``many`` is called by that instead: it takes the dictionaries of several points
            and returns an `Answer` for each.
        names: names of the quantities.
        points: their values, a row for each point, SI.
        question: what else the results depend on, as text.
        units: name -> SI unit of quantities and results.
        origin: title of the question, and the units in which it is written.
        how: sentence that says how the points are computed.
        notes: what the reader should know before.
    """

    function: Any
    names: tuple[str, ...]
    points: Array
    question: str
    units: Mapping[str, str]
    origin: Origin = field(default_factory=Origin)
    how: str = ""
    notes: tuple[str, ...] = ()

    def run(
        self,
        *,
        file: str | Path | None = None,
        executor: Executor | None = None,
        workers: int | None = None,
        progress: bool | Progress = False,
    ) -> Sweep:
        """Return the results at every point; arguments and errors as in `plough_opt.sweep`."""
        if executor is not None and not callable(getattr(executor, "submit", None)):
            raise InputError(f"executor = {shown(executor)} must be an executor of concurrent.futures")
        hands = available() if workers is None else whole_number("workers", workers, 1)
        headings(self.names, (), {})
        digest = hashlib.sha256(f"{self.question} {versions()}".encode(errors="surrogatepass")).hexdigest()[:12]
        path = None if file is None else path_of("the file", file)
        results, done = self._before(path, digest)
        waiting: list[tuple[int, Answer]] = []  # failures, until a point names the results
        with ExitStack() as stack:
            stream: TextIO = path.open("a", encoding="utf-8", newline="") if path else io.StringIO(newline="")
            stack.enter_context(stream)
            tell: Progress = progress if callable(progress) else lambda *_: None
            if progress is True:
                tell = stack.enter_context(progress_on(Screen(stderr=True)))
            if executor is None and not done.all():
                # Spawned, because the fork of a process with threads can hang.
                executor = stack.enter_context(
                    ProcessPoolExecutor(hands, multiprocessing.get_context("spawn"), _prepare)
                )
            try:
                for numbers, answers in self._answers(np.flatnonzero(~done), executor, hands):
                    waiting += zip(numbers.tolist(), answers, strict=True)
                    done[numbers] = True
                    if results is None and (done.all() or any(answer.results for answer in answers)):
                        results = next((tuple(answer.results) for answer in answers if answer.results), ())
                        write_rows(stream, [headings(self.names, results, self.units)])
                    if results is not None:
                        write_rows(stream, (self._row(k, digest, results, answer) for k, answer in waiting))
                        stream.flush()
                        waiting.clear()
                    tell(f"sweep: {done.sum()} of {len(done)} points", done.mean())
            except KeyboardInterrupt:
                where = f"in '{path}': the same sweep goes on there" if path else "lost, because there is no file"
                raise KeyboardInterrupt(f"{done.sum() - len(waiting)} of {len(done)} points are {where}") from None
            stream.seek(0)
            swept = Sweep.load(path) if path else read_sweep(stream)
        return replace(swept, units=self.units, origin=self.origin, how=self.how)

    def _before(self, path: Path | None, digest: str) -> tuple[tuple[str, ...] | None, NDArray[np.bool_]]:
        """Return the names of results in a file, None if they are not known, and which points it holds.

        Raises:
            InputError: the file cannot be used, or holds another sweep.
        """
        done = np.zeros(len(self.points), dtype=bool)
        if path is None or not path.exists() or not path.stat().st_size:
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
            return None, done
        there = Sweep.load(path)
        numbers, other = there.table["point"], ""
        if there.names != self.names:
            other = f"over {', '.join(there.names)} and not {', '.join(self.names)}"
        elif numbers.max(initial=0) >= len(done) or np.any(
            [there.table[n] for n in self.names] != self.points[numbers].T
        ):
            other = f"with other values of {', '.join(self.names)}"
        elif (there.table["question"] != digest).any():
            other = "of another problem, function, option or version"
        if other:
            raise InputError(f"the file '{path}' belongs to another sweep, {other}: name another file")
        with path.open("rb+") as file:  # a killed run may have left a part of a line
            file.truncate(file.read().rfind(b"\n") + 1)
        done[numbers] = True
        return there.results, done

    def _answers(
        self, left: NDArray[np.int64], executor: Any, workers: int
    ) -> Iterator[tuple[NDArray[np.int64], list[Answer]]]:
        """Yield the numbers of points with their answers as they come; a task takes about a quarter of a second.

        Raises:
            InputError: the executor fails.
        """
        many, tasks = hasattr(self.function, "many"), dict[Future[Any], NDArray[np.int64]]()
        size = _MOST if many else 1
        try:
            while len(left) or tasks:
                while len(left) and len(tasks) < 2 * workers:
                    part, left = left[:size], left[size:]
                    tasks[executor.submit(_work, self.function, self.names, self.points[part].tolist())] = part
                wait(tasks, return_when=FIRST_COMPLETED)
                for task in [task for task in tasks if task.done()]:
                    answers, seconds = task.result()
                    if not many:
                        size = max(1, min(4 * size, _MOST, int(0.25 * len(answers) / max(seconds, 1e-9))))
                    yield tasks.pop(task), answers
        except Exception as error:
            raise InputError(
                f"the executor failed ({type(error).__name__}: {error}); the same sweep goes on from its file. Workers"
                " need memory, a function to import, and a script that sweeps under if __name__ == '__main__':"
            ) from error
        finally:
            for task in tasks:
                task.cancel()

    def _row(self, number: int, digest: str, results: tuple[str, ...], answer: Answer) -> list[object]:
        """Return the row of a point; one whose results have other names than those of others has failed."""
        own, reason = tuple(answer.results), answer.reason
        if own and own != results:
            reason = f"its results are {', '.join(own)}, those of other points {', '.join(results)}"
        numbers = ["nan"] * len(results) if reason else [*answer.results.values()]
        return [number, *self.points[number].tolist(), digest, *numbers, BETWEEN.join(answer.warnings), reason]


def _prepare() -> None:
    """Leave Ctrl-C, which at a terminal reaches workers too, to the leading process, and end with that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    leader: Any = multiprocessing.parent_process()
    threading.Thread(target=lambda: os._exit(bool(wait_for([leader.sentinel]))), daemon=True).start()


def _work(function: Any, names: Sequence[str], points: list[list[float]]) -> tuple[list[Answer], float]:
    """Return the answers at points, in a worker, and the time that they took [s]."""
    began = time.perf_counter()
    _load_additions()
    places = [dict(zip(names, values, strict=True)) for values in points]
    with one_of_several(), without_notices():
        if hasattr(function, "many"):
            answers = [_finite(answer) for answer in function.many(places)]
        else:
            answers = [_answer(function, place) for place in places]
    return answers, time.perf_counter() - began


def _answer(function: Any, place: dict[str, float]) -> Answer:
    """Return what a function answers at a point, or why it fails there."""
    try:
        answer = function(place)
        if isinstance(answer, Answer):
            return _finite(answer)
        if not isinstance(answer, Mapping):
            raise InputError(f"the function returned {shown(answer)}: return a dictionary of named numbers")
        return _finite(Answer({name: float(number) for name, number in answer.items()}))
    except Exception as error:
        return _finite(Answer({}, (), f"{type(error).__name__}: {error}"))


def _finite(answer: Answer) -> Answer:
    """Return an answer as it is if all its numbers are finite, else as a failure whose reason is one line."""
    odd = [f"{name} = {number} is not finite" for name, number in answer.results.items() if not math.isfinite(number)]
    reason = " ".join((answer.reason or "".join(odd[:1])).split())
    return Answer({}, (), reason.encode("utf-8", "backslashreplace").decode()) if reason else answer
