"""The worker processes of a sweep on this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from plough_opt.errors import InputError
from plough_opt.notices import Sieve
from plough_opt.processors import available
from plough_opt.study.work import Evaluation

# The most that ProcessPoolExecutor takes on Windows.
_MOST_WORKERS = 61


class ProcessPool(Executor):
    """Processes that begin afresh when one of them dies.

    They are spawned, not forked: a copy of a process that has threads, as those of NumPy's or of a notebook, can hang,
    and what a parent has cached would reach some of its workers and not others.
    """

    def __init__(self, workers: int, evaluation: Evaluation) -> None:
        """Take the number of processes, and what they shall evaluate."""
        self.workers = workers
        self._evaluation = evaluation
        self._began = False
        self._start()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call, as every executor."""
        return self._pool.submit(fn, *args, **kwargs)

    def restart(self) -> None:
        """Replace the processes after one of them died.

        Raises:
            InputError: none of them ever began.
        """
        if not self._began and not self._has_begun():
            raise InputError(
                "the worker processes could not begin; what they say stands above. A script that sweeps does so under"
                " if __name__ == '__main__':, and what is swept stands in a file that they can import, not at a prompt"
            )
        self.kill()
        self._start()

    def kill(self) -> None:
        """End the processes at once, whatever they do."""
        for process in self._context.processes:
            with contextlib.suppress(ValueError):  # of a process that is closed already
                process.kill()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """End the processes: when they are done, or after an error or an interruption at once."""
        if kind is None:
            self.shutdown()
        else:
            self.kill()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when they are done."""
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)

    def _start(self) -> None:
        self._context = _RememberingContext()
        self._pool = ProcessPoolExecutor(self.workers, mp_context=self._context, initializer=_begin)
        self._first = self._pool.submit(_understood, self._evaluation)

    def _has_begun(self) -> bool:
        try:
            self._began = self._first.result()
        except BrokenExecutor:
            self._began = False
        return self._began


class _RememberingContext(SpawnContext):
    """Spawned processes, remembered so that an interrupted sweep can end them."""

    def __init__(self) -> None:
        super().__init__()
        self.processes: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        """Make a process."""
        self.processes.append(SpawnProcess(*args, **kwargs))
        return self.processes[-1]


def default_workers() -> int:
    """Return the number of processor cores that this process may use."""
    return min(available(), _MOST_WORKERS)


def _understood(evaluation: Evaluation) -> bool:
    """Return whether the evaluation arrived."""
    return evaluation is not None


def _begin() -> None:
    """Leave Ctrl-C to the parent, and end with it, even where it is killed; keep CasADi's notices to itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stderr = Sieve(sys.stderr)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
