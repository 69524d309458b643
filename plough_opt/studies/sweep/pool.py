"""The worker processes of a sweep on this machine, each of which may die without harm to the others.

The pool writes to the standard input of a process and reads from its standard output; output of the work itself goes
to the error stream. A message is a pickle.
"""

from __future__ import annotations

import contextlib
import multiprocessing.spawn
import os
import pickle
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import IO, Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.process import Sieve, available, load_additions
from plough_opt.studies.sweep.work import Evaluation

# The pool gives up after this many deaths in a row over this time [s], if no process is older and no task returned.
_DEATHS, _PATIENCE = 3, 40.0
STORED: Final = "finished points are stored, and the same sweep continues from there"
"""The results of a sweep that ends early."""

# Pause before a process that died is replaced [s].
_PAUSE: Final = 0.2
# What a process says when it can take calls.
_READY: Final = "ready"
# Variables by which MPI's launchers control the processes that they started; they must not reach a child of those.
_OF_LAUNCHERS: Final = re.compile(r"(PMI|PMIX|OMPI|PRTE|HYDI?|PALS|MPI)_")
# Variables in which libraries of linear algebra and OpenMP look for their number of threads.
_THREADS: Final = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip

# True in a worker while it imports the script that started it, which without a guard would sweep again.
_preparing = False


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
        if _preparing:
            raise InputError(
                "a script must call sweep under if __name__ == '__main__':, as worker processes import it and would"
                " sweep too"
            )
        script = multiprocessing.spawn.get_preparation_data("worker of a sweep")
        del script["authkey"]  # which refuses to be pickled
        self._first = script, pickle.dumps(evaluation)
        # Together one thread for each core: with as many threads in each worker as cores all would be slow.
        self._environment = environment(max(1, available() // workers))
        self._calls: queue.SimpleQueue[tuple[Future[Any], bytes] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._processes: dict[subprocess.Popen[bytes], float] = {}  # with the times [s] of their starts
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
        pause = 0.0
        try:
            while not self._closing.wait(pause):
                pause = _PAUSE
                try:
                    process = self._started()
                except OSError as error:  # no memory for another, or too many there
                    self._note_death(f"none can be started ({error})")
                    continue
                if process is None:
                    return
                try:
                    _send(process.stdin, self._first)
                    if (answer := _receive(process.stdout)) != _READY:
                        self._give_up(f"the worker processes could not begin: {answer}")
                        return
                    while (call := self._calls.get()) is not None:
                        self._execute(process, *call)
                    return
                except (OSError, EOFError):
                    self._note_death(_end(process))
                finally:
                    with self._lock:
                        self._processes.pop(process)
                    process.kill()
                    _end(process)
        except Exception as error:
            self._give_up(f"the worker processes cannot be kept at work: {type(error).__name__}: {error}")
            raise

    def _started(self) -> subprocess.Popen[bytes] | None:
        """Start a process; None if the pool ends."""
        with self._lock:
            if self._closing.is_set() or self._broken is not None:
                return None
            pipe = subprocess.PIPE
            process = subprocess.Popen(_command(), stdin=pipe, stdout=pipe, env=self._environment)
            self._processes[process] = time.monotonic()
            return process

    def _execute(self, process: subprocess.Popen[bytes], future: Future[Any], call: bytes) -> None:
        """Send a task to a process, and give its future the outcome.

        Raises:
            OSError: the process died.
            EOFError: the process died.
        """
        if process.poll() is not None:
            self._calls.put((future, call))  # it was dead before the task reached it
            raise EOFError
        if not future.set_running_or_notify_cancel():
            return
        try:
            _send(process.stdin, call)
            result, error = _receive(process.stdout)
        except (OSError, EOFError):
            future.set_exception(WorkerDied(f"the last ended {_end(process)}"))
            raise
        self.proceed()
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)

    def _note_death(self, how: str) -> None:
        """Count a death, and give up if processes only die."""
        now = time.monotonic()
        with self._lock:
            if self._closing.is_set():
                return
            self._first_death = self._first_death if self._deaths else now
            self._deaths += 1
            deaths, seconds = self._deaths, now - self._first_death
            old = any(now - began > _PATIENCE for process, began in self._processes.items() if process.poll() is None)
        if deaths >= _DEATHS and seconds > _PATIENCE and not old:
            self._give_up(
                f"{deaths} worker processes ended within {seconds:.0f} s before one of them had finished a task, the"
                f" last {how}: check whether they have enough memory, or what ends them; {STORED}"
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


def environment(threads: int) -> dict[str, str]:
    """Return the environment of a worker: this one's without that of MPI, and with a number of threads if unset."""
    own = {name: text for name, text in os.environ.items() if not _OF_LAUNCHERS.match(name)}
    return {**dict.fromkeys(_THREADS, str(threads)), **own}


def _command() -> list[str]:
    """Return the command line of a worker, which finds modules where this process does."""
    places = [place or str(Path.cwd()) for place in sys.path if isinstance(place, str)]
    begin = (
        "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"  # Ctrl-C is the pool's business
        f"import sys; sys.path[:] = {places!r}\n"
        "from plough_opt.studies.sweep.pool import serve; serve()"
    )
    return [multiprocessing.spawn.get_executable(), "-c", begin]


def _end(process: subprocess.Popen[bytes]) -> str:
    """Wait for the end of a process, which must be near, and return how it ended."""
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):  # of what could not be sent
            assert pipe is not None
            pipe.close()
    status = process.wait()
    return f"with exit status {status}" if status >= 0 else f"by signal {-status} ({signal.strsignal(-status)})"


def _send(file: IO[bytes] | None, message: object) -> None:
    """Write a message.

    Raises:
        OSError: the reader has ended.
    """
    assert file is not None
    pickle.dump(message, file)
    file.flush()


def _receive(file: IO[bytes] | None) -> Any:
    """Read a message.

    Raises:
        EOFError: the writer has ended.
    """
    assert file is not None
    try:
        return pickle.load(file)
    except pickle.UnpicklingError as error:  # which ends within a message
        raise EOFError from error


def serve() -> None:
    """Execute the pool's calls until it ends; this is the main function of a worker."""
    inlet, outlet = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    if hasattr(os, "register_at_fork"):
        # A child that outlives this process must not hold its pipe open, by which the pool sees its end.
        os.register_at_fork(after_in_child=outlet.close)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stderr = Sieve(sys.stderr)
    try:
        _prepare(*_receive(inlet))
    except EOFError:
        return
    except BaseException as error:  # a script may also end itself
        _send(outlet, f"{type(error).__name__}: {error}")
        return
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(inlet, calls), daemon=True).start()
    _send(outlet, _READY)
    while True:
        outlet.write(_outcome(calls.get()))
        outlet.flush()


def _prepare(script: dict[str, Any], evaluation: bytes) -> None:
    """Import the main script of the pool's process, and check that the evaluation can be unpickled."""
    global _preparing
    _preparing = True
    load_additions()
    multiprocessing.spawn.prepare(script)
    pickle.loads(evaluation)
    _preparing = False


def _listen(inlet: IO[bytes], calls: queue.SimpleQueue[bytes]) -> None:
    """Queue the pool's calls, and end this process with the pool, even if that is killed during a computation here."""
    try:
        while True:
            calls.put(_receive(inlet))
    except EOFError:
        os._exit(1)


def _outcome(call: bytes) -> bytes:
    """Return the result of a call and its error as a pickle; one of the two is None."""
    try:
        function, arguments, keywords = pickle.loads(call)
        return pickle.dumps((function(*arguments, **keywords), None))
    except BaseException as error:
        # Not every exception can be pickled.
        own = error if type(error) is InputError else RuntimeError(f"{type(error).__name__}: {error}")
        return pickle.dumps((None, own))
    finally:
        sys.stdout.flush()
