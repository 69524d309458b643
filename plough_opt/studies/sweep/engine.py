"""`sweep`: evaluates a function of named numbers at every point of a grid or a sample."""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind, check_switch, path_of, plain_number, shown, whole_number
from plough_opt.core.errors import InputError
from plough_opt.core.plain_data import Array
from plough_opt.core.process import available
from plough_opt.core.saving import versions
from plough_opt.core.screen import Screen, progress_on
from plough_opt.studies.sweep.pool import (
    STORED,
    Cluster,
    Done,
    Evaluation,
    ManyPoints,
    OutOfTime,
    ProcessPool,
    WorkerDied,
    packed,
    work,
)
from plough_opt.studies.sweep.question import PointGrid, PointSample, axis_of, digest_of, points_of
from plough_opt.studies.sweep.result import Sweep
from plough_opt.studies.sweep.store import About, State, Store, check_columns, closed_on_error

Progress = Callable[[int, int, int], object]
"""Called with the numbers of stored points, of all points, and of failed ones."""

# Target duration [s] of a task. The number of points in a task follows from it.
_TASK_SECONDS = 0.25
# Time [s] after which a worker returns the points done so far.
_BUDGET = 0.5
# Numbers of points of the first task and of the largest one.
_SIZES: Final = (1, 4096)
# The same for evaluations of many points at once.
_SIZES_OF_MANY: Final = (64, 2048)
# A task has at most this many times as many points as the one before.
_GROWTH: Final = 4
# Time [s] for which the loop waits for results before it looks at the cluster.
_WAIT = 0.25
# Workers that may die at a task before it is halved. Halving ends at single points, which are then tried alone.
_DEATHS_WHOLE: Final = 2
# Workers that may die at a point that is tried alone.
_DEATHS_ALONE: Final = 3


@dataclass
class _Task:
    """Points that a worker evaluates together.

    Attributes:
        numbers: of the points.
        values: of the quantities, a row for each point.
        deaths: number of workers that died while they worked on it.
        alone: whether it is a single point to be tried while no other task is under way.
    """

    numbers: NDArray[np.int64]
    values: Array
    deaths: int = 0
    alone: bool = False

    def part(self, which: slice, deaths: int = 0, alone: bool = False) -> _Task:
        """Return a task of some of the points."""
        return _Task(self.numbers[which], self.values[which], deaths, alone)


class SweepLoop:
    """A sweep under way.

    It submits more tasks than there are workers, so that no worker waits. Tasks whose workers died are submitted again,
    and points that may have killed them are tried alone at the end.
    """

    def __init__(
        self,
        evaluation: Evaluation,
        points: PointGrid | PointSample,
        store: Store,
        executor: Executor,
        workers: int,
        progress: Progress,
    ) -> None:
        """Take what to evaluate, where to store it, who works on it, and a callback that shows progress."""
        self._evaluation, self._points, self._store, self._executor = evaluation, points, store, executor
        self._most_under_way = 2 * workers + 2
        self._progress = progress
        self._key = uuid.uuid4().hex
        self._size, self._largest = _SIZES_OF_MANY if isinstance(evaluation, ManyPoints) else _SIZES
        # A batch of few designs takes about as long as one of many, so its tasks do not shrink.
        self._least = self._size
        self._under_way: dict[Future[Done], _Task] = {}
        self._retries: deque[_Task] = deque()
        self._single_points: deque[_Task] = deque()
        self._returned = False  # whether a task has returned

    def run(self) -> None:
        """Evaluate every point that is not stored yet.

        Raises:
            InputError: the executor fails, or the names of results differ between points.
        """
        self._stored, self._failed, _ = self._store.counts()
        self._progress(self._stored, self._points.count, self._failed)
        try:
            while self._fill():
                self._collect(wait(self._under_way, timeout=_WAIT, return_when=FIRST_COMPLETED).done)
                if isinstance(self._executor, Cluster):
                    self._executor.check()
        finally:
            self._stop()

    def _fill(self) -> bool:
        """Submit tasks until enough are under way for all workers; return whether any are."""
        while len(self._under_way) < self._most_under_way and (task := self._next_task()) is not None:
            try:
                arguments = self._key, self._evaluation, self._points.names, task.values, _BUDGET
                future = self._executor.submit(work, *arguments)
            except Exception as error:  # the executor is broken or shut down, or cannot send the task
                future = Future()
                future.set_exception(error)
            self._under_way[future] = task
        return bool(self._under_way)

    def _next_task(self) -> _Task | None:
        """Return the next task to submit, or None."""
        if any(task.alone for task in self._under_way.values()):
            return None
        if self._retries:
            return self._retries.popleft()
        if (numbers := self._store.claim(self._size)) is not None:
            first = int(numbers[0])
            return _Task(numbers, self._points.block(first, int(numbers[-1]) + 1)[numbers - first])
        return self._single_points.popleft() if self._single_points and not self._under_way else None

    def _collect(self, done: set[Future[Done]]) -> None:
        """Store the results of finished tasks, in the order of their points."""
        for future in sorted(done, key=lambda future: int(self._under_way[future].numbers[0])):
            task = self._under_way.pop(future)
            error = CancelledError("cancelled") if future.cancelled() else future.exception()
            if error is None:
                self._take(task, future.result())
            elif isinstance(error, WorkerDied):
                self._try_again(task, error.deaths, str(error))
            elif isinstance(error, OutOfTime) and len(task.numbers) == 1:
                self._keep(task, Done(1, reasons={0: str(error)}))
            elif isinstance(error, OutOfTime):  # try the points one by one
                self._retries.extend(task.part(slice(k, k + 1)) for k in range(len(task.numbers)))
            elif isinstance(error, InputError):
                raise error
            elif isinstance(error, BrokenExecutor):
                raise InputError(f"the executor is broken: {error}; {STORED} with a new one") from error
            else:
                raise InputError(f"the executor failed at a task: {type(error).__name__}: {error}; {STORED}") from error

    def _take(self, task: _Task, done: Done) -> None:
        """Store the points of a task that a worker has finished, and queue the others again."""
        if done.names and done.names != self._store.about.results:
            self._store.name_results(done.names)
        self._keep(task.part(slice(done.points)), done)
        if done.points < len(task.numbers):
            self._retries.appendleft(task.part(slice(done.points, None)))
        self._returned = True
        each = done.seconds / done.points
        wanted = int(min(_TASK_SECONDS / max(each, 1e-9), _GROWTH * self._size))
        self._size = max(self._least, min(wanted, self._largest))

    def _keep(self, task: _Task, done: Done, without: State = "failed") -> None:
        """Store finished points; those without results get the given state."""
        self._store.keep(task.numbers, task.values, done, without)
        self._stored += len(task.numbers)
        self._failed += len(done.reasons) if without == "failed" else 0
        self._progress(self._stored, self._points.count, self._failed)

    def _try_again(self, task: _Task, deaths: int, how: str) -> None:
        """Queue a task whose worker died: first whole, then in halves, and finally as points to be tried alone."""
        task.deaths += deaths
        half = len(task.numbers) // 2
        if task.alone and task.deaths >= _DEATHS_ALONE:
            reason = f"{task.deaths} workers ended while each worked on this point alone; {how}"
            self._keep(task, Done(1, reasons={0: reason}), without="undetermined")
            if self._returned and isinstance(self._executor, ProcessPool):
                # Other tasks have returned, so it is the point that kills workers.
                self._executor.proceed()
        elif task.alone:
            self._single_points.append(task)
        elif task.deaths < _DEATHS_WHOLE:
            self._retries.append(task)
        elif half:
            parts = (slice(half), slice(half, None))
            self._retries.extend(task.part(which, deaths=_DEATHS_WHOLE - 1) for which in parts)
        else:
            self._single_points.append(task.part(slice(None), alone=True))

    def _stop(self) -> None:
        """Store the results at hand."""
        for future, task in self._under_way.items():
            if not future.cancel() and future.done() and future.exception() is None:
                self._take(task, future.result())


LIMIT: Final = 3600.0
"""Time [s] after which a point has failed. A whole optimisation takes seconds to minutes."""


def sweep(
    evaluation: Evaluation,
    over: Mapping[str, object],
    *,
    samples: int | None = None,
    seed: int = 0,
    store: str | Path | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    retry: bool = False,
    limit: float | None = None,
    progress: bool | Progress = False,
    question: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Sweep:
    """Evaluate a function at every point of a grid or a sample, and store the results.

    On one machine the results do not depend on the executor and the number of workers, not even in the last bit,
    because each point is computed from its own values alone.

    Args:
        evaluation: function of a dictionary of the quantities at a point. It returns named finite numbers, with the
            same names at every point. An error that it raises becomes the reason why the point failed. It must
            be picklable.
        over: name -> `Range` or list of numbers, in the units that the function expects.
        samples: number of points of a scrambled Sobol sample of the ranges, best a power of two; None for a grid.
        seed: seed of the sample.
        store: SQLite file that receives every finished point at once. Points of the same sweep that it already holds
            are not computed again. One run at a time fills it, and others may read it. None for a temporary file,
            which is deleted with the result.
        executor: any `concurrent.futures.Executor`, such as that of a dask client or of mpi4py; it is left running.
            Default: processes on all cores of this machine, which end with the sweep.
        workers: number of workers of the executor, so that enough tasks are submitted (default: cores of this machine).
        retry: compute the points again that failed or are undetermined.
        limit: time [s] after which a point has failed, and its worker is replaced (default: `LIMIT`, an hour). The
            first point of each worker includes its preparation, such as compiling. Only for the processes of this
            machine, because those of another executor cannot be ended from here.
        progress: True for a bar on the error stream (lines, if that is not a terminal), or a function that is called
            with the numbers of stored points, of all points, and of failed ones.
        question: everything else that the results depend on, as texts. A store with other texts is refused. By
            default they are the function's name and a digest of its code, arguments and state.
        units: name -> unit, for quantities and results in the headings of tables.

    Raises:
        InputError: the arguments cannot be swept; the function depends on something that a store cannot recognise
            again, such as an open file; the store holds another sweep, is filled by another run, is damaged or
            loses rows; the executor is broken, or all workers die.
        KeyboardInterrupt: the sweep was interrupted; the message says how many points are stored.
    """
    _check_arguments(evaluation, over, executor, workers, units)
    check_switch("retry", retry)
    seconds = _limit(limit, executor)
    points = points_of({name: axis_of(name, given) for name, given in over.items()}, samples, seed)
    check_columns(points.names)
    asked = {"function": getattr(evaluation, "__qualname__", type(evaluation).__qualname__)}
    if store is not None and not question:
        asked["code of the function"] = digest_of(evaluation)
    packages = {f"version of {name}": text for name, text in {**versions(), "scipy": version("scipy")}.items()}
    full_question = {**points.question(), **(question or asked), **packages}
    store = None if store is None else path_of("the store", store)
    if not retry and store is not None and (finished := _finished(store, full_question)) is not None:
        return finished
    opened = Store(store)
    with closed_on_error(opened):
        try:
            about = About.model_construct(
                names=points.names, results=(), units=dict(units or {}), question=full_question, count=points.count
            )
            opened.prepare(about, retry)
            already = opened.counts().stored
            count = workers or available()
            if already < points.count:
                with ExitStack() as stack:
                    callback = progress if callable(progress) else lambda *_: None
                    if progress is True:
                        callback = stack.enter_context(bar(Screen(stderr=True)))
                    if executor is None:
                        used: Executor = stack.enter_context(ProcessPool(count, evaluation, seconds))
                    else:
                        used = Cluster.of(executor) or executor
                    SweepLoop(evaluation, points, opened, used, count, callback).run()
            opened.finish()
        except KeyboardInterrupt:
            where = f"in '{store}': the same sweep continues from there" if store else "lost, because there is no store"
            raise KeyboardInterrupt(f"{opened.counts().stored} of {points.count} points are {where}") from None
    return Sweep(opened, already)


@contextmanager
def bar(screen: Screen) -> Iterator[Progress]:
    """Show the progress of a sweep, as a bar on a terminal or as lines; yield the function that updates it."""
    with progress_on(screen) as show:
        yield lambda stored, count, failed: show(
            f"sweep: {stored} of {count} points{f', {failed} failed' if failed else ''}", stored / count
        )


def _finished(path: Path, question: Mapping[str, str]) -> Sweep | None:
    """Return the sweep in a store if it is complete and has this question; the medium may be read-only."""
    if not path.is_file() or not path.stat().st_size:
        return None
    store = Store(path, write=False)
    # The store may be empty, because another run has created the file and not yet its tables.
    if not store.empty and store.about.question == dict(question) and store.counts().stored == store.about.count:
        return Sweep(store, store.about.count)
    store.close()
    return None


def _check_arguments(evaluation: object, over: object, executor: object, workers: object, units: object) -> None:
    """Raise InputError if an argument has the wrong type."""
    if not callable(evaluation) and not isinstance(evaluation, ManyPoints):
        raise InputError(f"{shown(evaluation)} cannot be swept: use a problem, or a function of named numbers")
    check_kind("over", over, Mapping, "a dictionary with names as keys")
    check_kind("units", units, Mapping | None, "a dictionary with names as keys")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        what = "an executor of concurrent.futures, or have a method submit"
        raise InputError(f"executor = {shown(executor)} must be {what}")
    if workers is not None:
        whole_number("workers", workers, 1)
    try:
        if executor is None:
            packed(evaluation)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{shown(evaluation)} cannot be sent to other processes ({error}): use a function at the top level of a"
            " module, an instance of a class at the top level, or an executor that works in this process"
        ) from None


def _limit(limit: object, executor: object) -> float:
    """Return the time limit [s] of a point.

    Raises:
        InputError: it is not a number above 0, or an executor is given too.
    """
    if limit is not None and executor is not None:
        raise InputError("limit is for the processes of this machine: remove it, or the executor")
    return LIMIT if limit is None else plain_number("the limit of a point", limit, "s", above=0.0)
