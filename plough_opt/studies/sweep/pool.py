"""The worker processes of a sweep on this machine: each may die at any moment without harm to the others."""

from __future__ import annotations

import contextlib
import pickle
import queue
import signal
import subprocess
import threading
import time
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.processors import available
from plough_opt.studies.sweep.work import Evaluation
from plough_opt.studies.sweep.worker import BEGUN, READY, command, environment, is_preparing, preparation, receive, send

# Deaths in a row over this time [s], while nothing is returned and no process is older, are no accidents.
_DEATHS, _PATIENCE = 3, 40.0
# Between the death of a process that had not begun and its successor [s].
_PAUSE: Final = 0.2
_UNGUARDED: Final = (
    "a script that sweeps does so under if __name__ == '__main__':, as worker processes import it and would sweep too"
)
_Call = tuple[Future[Any], bytes]


class WorkerDied(BrokenExecutor):
    """The process ended that worked on a task.

    Attributes:
        deaths: how many of them did, one after the other.
    """

    def __init__(self, how: str, deaths: int = 1) -> None:
        super().__init__(how)
        self.deaths = deaths


class ProcessPool(Executor):
    """Processes that are replaced when they die; the task under way in one that dies fails with `WorkerDied`.

    Each process has a thread here that starts it, hands it tasks and waits for their results. Processes begin afresh
    and are not forked: a copy of a process that has threads, as those of NumPy's or of a notebook, can hang, and what a
    parent has cached would reach some of its workers and not others.
    """

    def __init__(self, workers: int, evaluation: Evaluation) -> None:
        """Take the number of processes, and what they shall evaluate.

        Raises:
            InputError: this process is itself a worker, whose script sweeps when it is imported.
        """
        if is_preparing():
            raise InputError(_UNGUARDED)
        self._first = preparation(), pickle.dumps(evaluation)
        # One thread for each core, whatever their libraries take: a worker for each, with threads of its own, is slow.
        self._environment = environment(max(1, available() // workers))
        self._calls: queue.SimpleQueue[_Call | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._processes: set[_Process] = set()
        self._deaths, self._first_death = 0, 0.0
        self._broken: InputError | None = None
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=self._keep, daemon=True) for _ in range(workers)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call, as every executor.

        Raises:
            InputError: the pool gave up.
        """
        future: Future[Any] = Future()
        call = pickle.dumps((fn, args, kwargs))
        with self._lock:
            if self._broken is not None:
                raise self._broken
            self._calls.put((future, call))
        return future

    def proceed(self) -> None:
        """Note that work gets done, whatever died before."""
        with self._lock:
            self._deaths = 0

    def __exit__(self, *_: object) -> None:
        """End the processes."""
        self.shutdown()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes at once: what has not returned by now is not wanted any more."""
        self._closing.set()
        with self._lock:
            for process in self._processes:
                process.kill()
        for future in self._waiting() if cancel_futures else ():
            future.cancel()
        for _ in self._threads:
            self._calls.put(None)
        for thread in self._threads if wait else ():
            thread.join()

    def _keep(self) -> None:
        """Keep one process at work, and replace it when it dies: what a thread runs."""
        try:
            while (process := self._begun()) is not None:
                try:
                    while (call := self._calls.get()) is not None:
                        self._carry_out(process, *call)
                    return
                except (OSError, EOFError):
                    self._note_death(process.end())
                finally:
                    self._remove(process)
        except Exception as error:
            self._give_up(f"the worker processes cannot be kept at work: {type(error).__name__}: {error}")
            raise

    def _begun(self) -> _Process | None:
        """Start a process, again until one reports in; None where the pool ends."""
        while not self._closing.is_set():
            try:
                process = self._started()
            except OSError as error:  # no memory for another, or too many there
                self._note_death(f"none can be started ({error})")
            else:
                if process is None:
                    break
                try:
                    process.tell(self._first)
                    answer = process.hear()
                except (OSError, EOFError):
                    self._note_death(process.end())
                    self._remove(process)
                else:
                    if answer == READY:
                        return process
                    self._remove(process)
                    self._give_up(f"the worker processes could not begin: {answer}")
            self._closing.wait(_PAUSE)
        return None

    def _started(self) -> _Process | None:
        """Start a process; None where the pool ends."""
        with self._lock:
            if self._closing.is_set() or self._broken is not None:
                return None
            process = _Process(self._environment)
            self._processes.add(process)
            return process

    def _remove(self, process: _Process) -> None:
        with self._lock:
            self._processes.discard(process)
        process.kill()
        process.end()

    def _carry_out(self, process: _Process, future: Future[Any], call: bytes) -> None:
        """Let a process do a task.

        Raises:
            OSError: the process died.
            EOFError: the process died.
        """
        if future.cancelled():
            return
        try:
            process.tell(call)
            assert process.hear() == BEGUN
        except (OSError, EOFError):
            self._calls.put((future, call))  # it was dead before the task reached it
            raise
        wanted = future.set_running_or_notify_cancel()
        try:
            returned, pickled = process.hear()
        except (OSError, EOFError):
            if wanted:
                future.set_exception(WorkerDied(f"the last ended {process.end()}"))
            raise
        self.proceed()
        if wanted:
            _resolve(future, returned, pickled)

    def _note_death(self, how: str) -> None:
        """Count a death, and give up where nothing else happens any more."""
        now = time.monotonic()
        with self._lock:
            if self._closing.is_set():
                return
            self._first_death = self._first_death if self._deaths else now
            self._deaths += 1
            deaths, seconds = self._deaths, now - self._first_death
            old = any(now - process.began > _PATIENCE for process in self._processes if process.lives())
        if deaths >= _DEATHS and seconds > _PATIENCE and not old:
            self._give_up(
                f"{deaths} worker processes ended within {seconds:.0f} s before one of them had finished a task, the"
                f" last {how}: see whether they have the memory that they need, or what ends them; what is stored is"
                " stored, and the same sweep goes on from there"
            )

    def _give_up(self, reason: str) -> None:
        """Fail what waits, and whatever comes."""
        with self._lock:
            self._broken = self._broken or InputError(reason)
        for future in self._waiting():
            if future.set_running_or_notify_cancel():
                future.set_exception(self._broken)

    def _waiting(self) -> list[Future[Any]]:
        """Take out and return what no process has begun."""
        found = []
        with contextlib.suppress(queue.Empty):
            while True:
                call = self._calls.get_nowait()
                if call is not None:
                    found.append(call[0])
        return found


class _Process:
    """A worker process.

    Attributes:
        began: when it was started [s].
    """

    def __init__(self, environment: dict[str, str]) -> None:
        pipe = subprocess.PIPE
        self.began = time.monotonic()
        self._process = subprocess.Popen(command(), stdin=pipe, stdout=pipe, bufsize=0, env=environment)

    def lives(self) -> bool:
        """Return whether it is there."""
        return self._process.poll() is None

    def tell(self, message: object) -> None:
        """Send it a message."""
        assert self._process.stdin is not None
        send(self._process.stdin.fileno(), message)

    def hear(self) -> Any:
        """Wait for its message."""
        assert self._process.stdout is not None
        return receive(self._process.stdout.fileno(), self.lives)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def end(self) -> str:
        """Wait for its end, which must be near, and return how it ended."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        status = self._process.wait()
        if status >= 0:
            return f"with exit status {status}"
        return f"by signal {-status} ({signal.strsignal(-status)})"


def _resolve(future: Future[Any], returned: bool, pickled: bytes) -> None:
    """Give a future what a worker found."""
    try:
        found = pickle.loads(pickled)
    except Exception as error:
        returned, found = False, error
    if returned:
        future.set_result(found)
    else:
        future.set_exception(found)
