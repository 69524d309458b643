"""The main loop of a sweep: claims points, keeps workers busy, stores results, and continues when workers die."""

from __future__ import annotations

import time
import uuid
from collections import deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.studies.sweep.cluster import Cluster
from plough_opt.studies.sweep.database import State
from plough_opt.studies.sweep.points import Grid, Sample
from plough_opt.studies.sweep.pool import STORED, OutOfTime, ProcessPool, WorkerDied
from plough_opt.studies.sweep.store import Store
from plough_opt.studies.sweep.work import Array, Done, Evaluation, ManyPoints, work

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
# Time [s] for which the loop waits for results before it looks at the clock and at other runs.
_WAIT = 0.25
# Time [s] between two renewals of the lease.
_RENEWAL = 3.0
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


class Engine:
    """A sweep under way.

    It submits more tasks than there are workers, so that no worker waits. Tasks whose workers died are submitted again,
    and points that may have killed them are tried alone at the end.
    """

    def __init__(
        self,
        evaluation: Evaluation,
        points: Grid | Sample,
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
        self._renewed = time.monotonic()
        self._returned = False  # whether a task has returned

    def run(self) -> None:
        """Evaluate every point that is not stored yet.

        Raises:
            InputError: the executor fails, or the names of results differ between points.
        """
        self._count()
        try:
            while self._fill():
                if self._under_way:
                    self._collect(wait(self._under_way, timeout=_WAIT, return_when=FIRST_COMPLETED).done)
                    if isinstance(self._executor, Cluster):
                        self._executor.check()
                else:  # other runs still work on the last points
                    time.sleep(_WAIT)
                    self._count()
                if time.monotonic() - self._renewed > _RENEWAL:
                    self._store.renew()
                    if self._store.waiting():
                        self._count()
                    self._renewed = time.monotonic()
            self._count()
        finally:
            self._stop()

    def _fill(self) -> bool:
        """Submit tasks until enough are under way for all workers; return whether there is anything to wait for."""
        while len(self._under_way) < self._most_under_way and (task := self._next_task()) is not None:
            try:
                arguments = self._key, self._evaluation, self._points.names, task.values, _BUDGET
                future = self._executor.submit(work, *arguments)
            except Exception as error:  # the executor is broken or shut down, or cannot send the task
                future = Future()
                future.set_exception(error)
            self._under_way[future] = task
        return bool(self._under_way) or self._store.waiting()

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
            elif isinstance(error, OutOfTime):
                self._single_out(task, str(error))
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
        new = self._store.keep(task.numbers, task.values, done, without)
        self._stored += new
        if without == "failed" and new == len(task.numbers):
            self._failed += len(done.reasons)
        self._show()

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

    def _single_out(self, task: _Task, reason: str) -> None:
        """Queue the points of a task that took too long one by one; a single point has failed."""
        if len(task.numbers) == 1:
            self._keep(task, Done(1, reasons={0: reason}))
        else:
            self._retries.extend(task.part(slice(k, k + 1)) for k in range(len(task.numbers)))

    def _count(self) -> None:
        """Show the counts of the store, because other runs store points too."""
        self._stored, self._failed, _ = self._store.counts()
        self._show()

    def _show(self) -> None:
        self._progress(self._stored, self._points.count, self._failed)

    def _stop(self) -> None:
        """Store the results at hand, and release all other points for the run that resumes the sweep."""
        try:
            for future, task in self._under_way.items():
                if not future.cancel() and future.done() and future.exception() is None:
                    self._take(task, future.result())
        finally:
            self._store.renew(0.0)
