"""Evaluation of the points of a sweep by worker processes, any of which may die, or by a dask cluster.

The pool sends pickles to the standard input of a process and receives pickles from its standard output. What the work
itself prints goes to the error stream. Each point is evaluated from its own values alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

import numpy as np

from plough_opt.core.checks import NOT_NUMBERS
from plough_opt.core.errors import Counted, InputError, PloughError, count
from plough_opt.core.plain_data import Array
from plough_opt.core.process import Sieve, available, load_additions, one_of_several

if TYPE_CHECKING:
    import distributed


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
    notes: Counted = field(default_factory=dict)
    seconds: float = 0.0


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
    given, reasons, notes = evaluation.many(values)
    results, names = np.asarray(given, dtype=float), tuple(evaluation.results)
    done = Done(len(values), results, names, dict(reasons))
    for k, column in reversed(np.argwhere(~np.isfinite(results)).tolist()):  # of a row the first counts
        if k not in reasons:
            done.reasons[k] = _not_finite(names[column], float(results[k, column]))
    for place, points, texts in notes:
        count(done.notes, texts, place, points)
    return done


def _one_by_one(
    evaluation: Callable[[dict[str, float]], Mapping[str, float]], names: tuple[str, ...], values: Array, until: float
) -> Done:
    done = Done(0)
    rows: list[dict[str, float]] = []
    for k, row in enumerate(values.tolist()):
        try:
            results = evaluation(dict(zip(names, row, strict=True)))
            rows.append(_numbers(results))
        except Exception as error:
            done.reasons[k] = str(error) if isinstance(error, PloughError) else f"{type(error).__name__}: {error}"
            rows.append({})
        else:
            done.names = done.names or tuple(rows[k])
            if tuple(rows[k]) != done.names:
                rows.pop()
                break  # the next task begins here, and the store refuses its names
            if bad := [name for name, number in rows[k].items() if not math.isfinite(number)]:
                done.reasons[k] = _not_finite(bad[0], rows[k][bad[0]])
            else:
                count(done.notes, getattr(results, "notes", ()), k)
        if time.perf_counter() > until:
            break
    done.points = len(rows)
    if done.names:
        done.results = np.array([[row.get(name, math.nan) for name in done.names] for row in rows])
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


STORED: Final = "finished points are stored, and the same sweep continues from there"
"""Advice for a sweep that ends early."""

# The pool gives up after at least this many deaths in a row, with no result in between. `_PATIENCE` must have passed
# since the first of them, and no live process may be older than that.
_MOST_DEATHS = 3
# Time [s] that the pool waits for a process that survives; for as long a cluster may be without workers, which may be
# restarting.
_PATIENCE = 40.0
# Pause [s] before a dead process is replaced.
_PAUSE: Final = 0.2
# Time [s] in which a process must import the script and become ready. On a busy machine it takes some seconds.
_START: Final = 600.0
# Message of a process that is ready for calls.
_READY: Final = "ready"
# Environment variables by which MPI launchers control their processes; children of these must not inherit them.
_MPI_VARIABLES: Final = re.compile(r"(PMI|PMIX|OMPI|PRTE|HYDI?|PALS|MPI)_")
# Environment variables with the number of threads for OpenMP and libraries of linear algebra.
_THREAD_VARIABLES: Final = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip

# True in a worker while it imports the script that started the sweep. Without a guard the script would sweep again.
_preparing = False


class WorkerDied(BrokenExecutor):
    """The process that worked on a task has died.

    Attributes:
        deaths: number of processes that died at the task.
    """

    def __init__(self, how: str, deaths: int = 1) -> None:
        super().__init__(how)
        self.deaths = deaths


class OutOfTime(Exception):
    """A process did not finish its task within the limit, and was ended."""


def packed(task: object) -> bytes:
    """Return a task as bytes for another process, in an interactive session with the functions defined there.

    Raises:
        InputError: it needs such a function, and cloudpickle is not installed.
    """
    if getattr(sys.modules["__main__"], "__file__", None) is not None and not sys.flags.interactive:
        return pickle.dumps(task)
    with contextlib.suppress(ImportError):
        return bytes(import_module("cloudpickle").dumps(task))
    data = pickle.dumps(task)
    if b"__main__" in data:  # functions are pickled as the names of their modules
        raise InputError(
            "other processes cannot import a function that is defined in an interactive session or a notebook:"
            " install cloudpickle (pip install cloudpickle), or write the function into a module and import it"
        )
    return data


class ProcessPool(Executor):
    """An executor whose processes are replaced when they die; the task of a dead process fails with `WorkerDied`.

    A thread for each process starts it, sends it tasks and waits for their results. Processes are spawned, not forked,
    because the fork of a process with threads (those of NumPy or of a notebook) can hang, and because caches of the
    parent would reach some workers and not others.
    """

    def __init__(self, workers: int, evaluation: Evaluation, limit: float = math.inf) -> None:
        """Start the threads.

        Args:
            workers: number of processes.
            evaluation: unpickled by each process before it reports that it is ready.
            limit: time [s] after which a process that has not finished its task is replaced; the task then fails with
                `OutOfTime`.

        Raises:
            InputError: this process is itself a worker, because its script sweeps when it is imported.
        """
        if _preparing:
            raise InputError(
                "a script must call sweep under if __name__ == '__main__':, because worker processes import it and"
                " would sweep too"
            )
        script = multiprocessing.spawn.get_preparation_data("worker of a sweep")
        del script["authkey"]  # cannot be pickled
        self._first_message = script, packed(evaluation)
        # One thread per core for all workers together; more would slow all of them down.
        self._environment = environment(max(1, available() // workers))
        self._limit = limit
        self._calls: queue.SimpleQueue[tuple[Future[Any], bytes] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._processes: dict[subprocess.Popen[bytes], float] = {}  # process -> time [s] of its start
        self._deaths, self._first_death = 0, 0.0
        self._broken: InputError | None = None
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=self._keep_alive, daemon=True) for _ in range(workers)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call, as any executor does.

        Raises:
            InputError: the pool has given up.
        """
        future: Future[Any] = Future()
        call = packed((fn, args, kwargs))
        with self._lock:
            if self._broken is not None:
                raise self._broken
            self._calls.put((future, call))
        return future

    def proceed(self) -> None:
        """Reset the count of deaths, because a task has returned."""
        with self._lock:
            self._deaths = 0

    def shutdown(self, *_arguments: Any, **_options: Any) -> None:
        """Kill all processes at once, whatever the options, without waiting for the tasks under way."""
        self._closing.set()
        with self._lock:
            for process in self._processes:
                process.kill()
        for future in self._waiting():
            future.cancel()
        for _ in self._threads:
            self._calls.put(None)
        for thread in self._threads:
            thread.join()

    def _keep_alive(self) -> None:
        """Keep one process at work and replace it when it dies; each thread runs this."""
        pause = 0.0
        try:
            while not self._closing.wait(pause):
                pause = _PAUSE
                try:
                    process = self._start()
                except OSError as error:  # too little memory, or too many processes
                    self._note_death(f"could not be started ({error})")
                    continue
                if process is None:
                    return
                try:
                    if (answer := self._begin(process)) != _READY:
                        self._give_up(f"the worker processes could not begin: {answer}")
                        return
                    while (call := self._calls.get()) is not None:
                        self._execute(process, *call)
                    return
                except OutOfTime:
                    pass
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

    def _start(self) -> subprocess.Popen[bytes] | None:
        """Start a process and return it; return None if the pool is closing."""
        with self._lock:
            if self._closing.is_set() or self._broken is not None:
                return None
            pipe = subprocess.PIPE
            process = subprocess.Popen(_command(), stdin=pipe, stdout=pipe, env=self._environment)
            self._processes[process] = time.monotonic()
            return process

    def _begin(self, process: subprocess.Popen[bytes]) -> str:
        """Prepare a process for calls; return `_READY`, or why that failed. Raise OSError or EOFError if it died."""
        try:
            with _limited(_START, process):
                _send(process.stdin, self._first_message)
                return str(_receive(process.stdout))
        except OutOfTime:
            return f"they were not ready after {_START:g} s"

    def _execute(self, process: subprocess.Popen[bytes], future: Future[Any], call: bytes) -> None:
        """Send a task to a process and pass the outcome to its future.

        Raises:
            OSError: the process died.
            EOFError: the process died.
            OutOfTime: the process was ended, because it took too long.
        """
        if process.poll() is not None:
            self._calls.put((future, call))  # the process died before the task reached it
            raise EOFError
        if not future.set_running_or_notify_cancel():
            return
        try:
            with _limited(self._limit, process):
                _send(process.stdin, call)
                result, error = _receive(process.stdout)
        except OutOfTime as late:
            future.set_exception(late)
            raise
        except (OSError, EOFError):
            future.set_exception(WorkerDied(f"the last ended {_end(process)}"))
            raise
        self.proceed()
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)

    def _note_death(self, how: str) -> None:
        """Count a death, and give up if processes keep dying before any task returns."""
        now = time.monotonic()
        with self._lock:
            if self._closing.is_set():
                return
            self._first_death = self._first_death if self._deaths else now
            self._deaths += 1
            deaths, seconds = self._deaths, now - self._first_death
            old = any(now - began > _PATIENCE for process, began in self._processes.items() if process.poll() is None)
        if deaths >= _MOST_DEATHS and seconds > _PATIENCE and not old:
            self._give_up(
                f"{deaths} worker processes ended within {seconds:.0f} s before one of them finished a task, the last"
                f" {how}: check whether they have enough memory, or what ends them; {STORED}"
            )

    def _give_up(self, reason: str) -> None:
        """Make all waiting and all later calls fail."""
        with self._lock:
            self._broken = self._broken or InputError(reason)
        for future in self._waiting():
            if future.set_running_or_notify_cancel():
                future.set_exception(self._broken)

    def _waiting(self) -> list[Future[Any]]:
        """Empty the queue and return the futures of its calls."""
        calls = []
        with contextlib.suppress(queue.Empty):
            while True:
                calls.append(self._calls.get_nowait())
        return [call[0] for call in calls if call is not None]


def environment(threads: int) -> dict[str, str]:
    """Return this environment without MPI variables, and with the given number of threads where none is set."""
    inherited = {name: text for name, text in os.environ.items() if not _MPI_VARIABLES.match(name)}
    return {**dict.fromkeys(_THREAD_VARIABLES, str(threads)), **inherited}


def _command() -> list[str]:
    """Return the command line of a worker that imports modules from the same places as this process."""
    places = [place or str(Path.cwd()) for place in sys.path if isinstance(place, str)]
    begin = (
        "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"  # the pool handles Ctrl-C
        f"import sys; sys.path[:] = {places!r}\n"
        "from plough_opt.studies.sweep.pool import serve; serve()"
    )
    # -P keeps the current folder out of sys.path, unless it is one of the places.
    return [multiprocessing.spawn.get_executable(), "-P", "-c", begin]


@contextlib.contextmanager
def _limited(seconds: float, process: subprocess.Popen[bytes]) -> Iterator[None]:
    """Kill a process if the code inside waits for it longer than this.

    Raises:
        OutOfTime: the process was killed for this reason.
    """
    late = threading.Event()

    def end() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), end)
    timer.daemon = True
    timer.start()
    try:
        yield
    except (OSError, EOFError):
        if late.is_set():
            why = f"no result after {seconds:g} s, so its worker was ended"
            raise OutOfTime(f"{why}: set a longer limit (--limit, limit=...)") from None
        raise
    finally:
        timer.cancel()


def _end(process: subprocess.Popen[bytes]) -> str:
    """Wait for a process that is about to end, and return how it ended."""
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):  # the rest of a message could not be sent
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
    except pickle.UnpicklingError as error:  # the writer ended within a message
        raise EOFError from error


def serve() -> None:
    """Execute the calls of the pool until it ends; this is the main function of a worker."""
    inlet, outlet = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    if hasattr(os, "register_at_fork"):
        # The pool notices the end of this process by its pipe, which a child that lives longer must not hold open.
        os.register_at_fork(after_in_child=outlet.close)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stderr = Sieve(sys.stderr)
    calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(inlet, calls), daemon=True).start()
    try:
        _prepare(*calls.get())
        answer = _READY
    except BaseException as error:  # SystemExit too, because a script may call sys.exit
        answer = f"{type(error).__name__}: {error}"
    try:
        _send(outlet, answer)
        while answer == _READY:
            outlet.write(_outcome(calls.get()))
            outlet.flush()
    except BrokenPipeError:  # the pool has ended
        os._exit(1)


def _prepare(script: dict[str, Any], evaluation: bytes) -> None:
    """Import the main script of the pool's process, and check that the evaluation can be unpickled here."""
    global _preparing
    _preparing = True
    load_additions()
    multiprocessing.spawn.prepare(script)
    pickle.loads(evaluation)
    _preparing = False


def _listen(inlet: IO[bytes], calls: queue.SimpleQueue[Any]) -> None:
    """Queue the calls of the pool, and end this process when the pool ends, even during a computation."""
    try:
        while True:
            calls.put(_receive(inlet))
    except EOFError:
        os._exit(1)


def _outcome(call: bytes) -> bytes:
    """Execute a call and return the pickle of (result, error), one of which is None."""
    try:
        function, arguments, keywords = pickle.loads(call)
        return pickle.dumps((function(*arguments, **keywords), None))
    except BaseException as error:
        # Not every exception can be pickled, so others than InputError become texts.
        picklable = error if type(error) is InputError else RuntimeError(f"{type(error).__name__}: {error}")
        return pickle.dumps((None, picklable))
    finally:
        with contextlib.suppress(OSError):  # nobody reads the error stream any more
            sys.stdout.flush()


# Time [s] between two checks for workers; also the time limit for the scheduler's answer.
_CHECK_EVERY: Final = 3.0


class Cluster(Executor):
    """The executor of a dask client."""

    def __init__(self, client: distributed.Client, options: dict[str, Any]) -> None:
        """Take a client and the options of its executor."""
        self._client, self._options = client, options
        self._checked = self._seen = time.monotonic()

    @classmethod
    def of(cls, executor: Executor) -> Cluster | None:
        """Return the cluster behind an executor of dask, or None for other executors."""
        if type(executor).__module__ != "distributed.cfexecutor":
            return None
        # dask has no public names for these.
        return cls(executor._client, executor._kwargs)  # type: ignore[attr-defined]

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call, as any executor does."""
        future: Future[Any] = Future()
        task = self._client.submit(fn, *args, **self._options, **kwargs)
        assert self._client.loop is not None
        self._client.loop.add_callback(_carry, task, future)
        future.add_done_callback(lambda future: task.cancel() if future.cancelled() else None)
        return future

    def check(self) -> None:
        """Check whether there are workers, unless this was checked a moment ago.

        Raises:
            InputError: for `_PATIENCE` there have been no workers, or no answers from the scheduler.
        """
        if time.monotonic() - self._checked < _CHECK_EVERY:
            return
        assert self._client.scheduler is not None
        try:
            workers = self._client.sync(self._client.scheduler.ncores, callback_timeout=_CHECK_EVERY)
        except (OSError, TimeoutError):
            workers = {}
        now = self._checked = time.monotonic()
        if workers:
            self._seen = now
        elif now - self._seen > _PATIENCE:
            raise InputError(f"the cluster has had no workers for {now - self._seen:.0f} s: start some; {STORED}")


async def _carry(task: distributed.Future[Any], future: Future[Any]) -> None:
    """Pass the result or the error of a task to a future."""
    settle: Callable[[Any], None] = future.set_exception
    outcome: Any
    try:
        settle, outcome = future.set_result, await task
    except (asyncio.CancelledError, CancelledError):
        outcome = InputError(f"the cluster's scheduler is gone, or has dropped a task; {STORED}")
    except Exception as error:
        outcome = error
        if type(error).__name__ == "KilledWorker":  # it killed more workers than dask allows
            outcome = WorkerDied("dask does not say how", outcome.allowed_failures + 1)
    if future.set_running_or_notify_cancel():
        settle(outcome)
