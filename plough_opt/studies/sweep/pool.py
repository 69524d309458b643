"""The worker processes of a sweep on this machine, each of which may die without harm to the others."""

from __future__ import annotations

import contextlib
import pickle
import queue
import signal
import subprocess
import threading
import time
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, BinaryIO, Final, cast

from plough_opt.core.errors import InputError
from plough_opt.core.process import available
from plough_opt.studies.sweep.work import Evaluation
from plough_opt.studies.sweep.worker import BEGUN, READY, command, environment, is_preparing, preparation, receive, send

# The pool gives up after this many deaths in a row over this time [s], if no process is older and no task returned.
_DEATHS, _PATIENCE = 3, 40.0
# Pause before a process that could not start is replaced [s].
_PAUSE: Final = 0.2
_UNGUARDED: Final = (
    "a script must call sweep under if __name__ == '__main__':, as worker processes import it and would sweep too"
)
_Call = tuple[Future[Any], bytes]


class WorkerDied(BrokenExecutor):
    """The process that worked on a task has ended.

    Attributes:
        deaths: number of processes that ended at the same task.
    """

    def __init__(self, how: str, deaths: int = 1) -> None:
        super().__init__(how)
        self.deaths = deaths


class ProcessPool(Executor):
    """Processes that are replaced when they die; the task under way in one that dies fails with `WorkerDied`.

    Each process has a thread here that starts it, sends it tasks and waits for their results. Processes are started
    afresh, not forked: the copy of a process with threads, such as those of NumPy or of a notebook, can hang, and
    caches of the parent would reach some of its workers and not others.
    """

    def __init__(self, workers: int, evaluation: Evaluation) -> None:
        """Take the number of processes, and the evaluation.

        Raises:
            InputError: this process is itself a worker, because its script sweeps when it is imported.
        """
        if is_preparing():
            raise InputError(_UNGUARDED)
        self._first = preparation(), pickle.dumps(evaluation)
        # Together one thread for each core: with as many threads in each worker as cores all would be slow.
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
        """Submit a call, as any executor does.

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
        """Reset the count of deaths, because a task has returned."""
        with self._lock:
            self._deaths = 0

    def __exit__(self, *_: object) -> None:
        """End the processes."""
        self.shutdown()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes at once, without waiting for the tasks under way."""
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
        """Keep one process at work, and replace it when it dies; this is the function of a thread."""
        try:
            while (process := self._ready()) is not None:
                try:
                    while (call := self._calls.get()) is not None:
                        self._execute(process, *call)
                    return
                except (OSError, EOFError):
                    self._note_death(process.end())
                finally:
                    self._remove(process)
        except Exception as error:
            self._give_up(f"the worker processes cannot be kept at work: {type(error).__name__}: {error}")
            raise

    def _ready(self) -> _Process | None:
        """Start a process, and again until one is ready; None if the pool ends."""
        while not self._closing.is_set():
            try:
                process = self._started()
            except OSError as error:  # no memory for another, or too many there
                self._note_death(f"none can be started ({error})")
            else:
                if process is None:
                    break
                try:
                    process.send(self._first)
                    answer = process.receive()
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
        """Start a process; None if the pool ends."""
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

    def _execute(self, process: _Process, future: Future[Any], call: bytes) -> None:
        """Send a task to a process, and give its future the outcome.

        Raises:
            OSError: the process died.
            EOFError: the process died.
        """
        if future.cancelled():
            return
        try:
            process.send(call)
            assert process.receive() == BEGUN
        except (OSError, EOFError):
            self._calls.put((future, call))  # it was dead before the task reached it
            raise
        wanted = future.set_running_or_notify_cancel()
        try:
            returned, pickled = process.receive()
        except (OSError, EOFError):
            if wanted:
                future.set_exception(WorkerDied(f"the last ended {process.end()}"))
            raise
        self.proceed()
        if wanted:
            _resolve(future, returned, pickled)

    def _note_death(self, how: str) -> None:
        """Count a death, and give up if processes only die."""
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
                f" last {how}: check whether they have enough memory, or what ends them; finished points are stored,"
                " and the same sweep continues from there"
            )

    def _give_up(self, reason: str) -> None:
        """Let all waiting calls fail, and all later ones."""
        with self._lock:
            self._broken = self._broken or InputError(reason)
        for future in self._waiting():
            if future.set_running_or_notify_cancel():
                future.set_exception(self._broken)

    def _waiting(self) -> list[Future[Any]]:
        """Take out and return the futures of calls that no process has begun."""
        futures = []
        with contextlib.suppress(queue.Empty):
            while True:
                call = self._calls.get_nowait()
                if call is not None:
                    futures.append(call[0])
        return futures


class _Process:
    """A worker process.

    Attributes:
        began: when it was started [s].
    """

    def __init__(self, environment: dict[str, str]) -> None:
        pipe = subprocess.PIPE
        self.began = time.monotonic()
        self._process = subprocess.Popen(command(), stdin=pipe, stdout=pipe, env=environment)

    def lives(self) -> bool:
        """Return whether the process runs."""
        return self._process.poll() is None

    def send(self, message: object) -> None:
        """Send a message to the process."""
        send(cast(BinaryIO, self._process.stdin), message)

    def receive(self) -> Any:
        """Wait for a message from the process."""
        return receive(cast(BinaryIO, self._process.stdout))

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def end(self) -> str:
        """Wait for the end of the process, which must be near, and return how it ended."""
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):  # of what could not be sent
                cast(BinaryIO, pipe).close()
        status = self._process.wait()
        if status >= 0:
            return f"with exit status {status}"
        return f"by signal {-status} ({signal.strsignal(-status)})"


def _resolve(future: Future[Any], returned: bool, pickled: bytes) -> None:
    """Give a future the result or the error of a call."""
    try:
        outcome = pickle.loads(pickled)
    except Exception as error:
        returned, outcome = False, error
    if returned:
        future.set_result(outcome)
    else:
        future.set_exception(outcome)
