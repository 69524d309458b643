"""A worker process of a sweep, and the messages between it and the pool that started it.

The pool writes to the standard input of the process and reads from its standard output; output of the work itself goes
to the error stream. A message is a pickle.
"""

import multiprocessing.spawn
import os
import pickle
import queue
import re
import sys
import threading
from pathlib import Path
from typing import Any, BinaryIO, Final

from plough_opt.core.process import Sieve, load_additions

READY: Final = "ready"
BEGUN: Final = "begun"

# Variables by which MPI's launchers control the processes that they started; they must not reach a child of those.
_OF_LAUNCHERS: Final = re.compile(r"(PMI|PMIX|OMPI|PRTE|HYDI?|PALS|MPI)_")
# Variables in which libraries of linear algebra and OpenMP look for their number of threads.
_THREADS: Final = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip

# True in a worker while it imports the script that started it.
_preparing = False


def is_preparing() -> bool:
    """Return whether this process is a worker that imports its script, which without a guard would sweep again."""
    return _preparing


def command() -> list[str]:
    """Return the command line of a worker, which finds modules where this process does."""
    places = [place or str(Path.cwd()) for place in sys.path if isinstance(place, str)]
    begin = (
        "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"  # Ctrl-C is the pool's business
        f"import sys; sys.path[:] = {places!r}\n"
        "from plough_opt.studies.sweep.worker import serve; serve()"
    )
    return [multiprocessing.spawn.get_executable(), "-c", begin]


def environment(threads: int) -> dict[str, str]:
    """Return the environment of a worker: this one's without that of MPI, and with a number of threads if unset."""
    own = {name: text for name, text in os.environ.items() if not _OF_LAUNCHERS.match(name)}
    return {**dict.fromkeys(_THREADS, str(threads)), **own}


def preparation() -> dict[str, Any]:
    """Return the data with which a worker can import this process's main script."""
    data = multiprocessing.spawn.get_preparation_data("worker of a sweep")
    del data["authkey"]  # which refuses to be pickled
    return data


def send(file: BinaryIO, message: object) -> None:
    """Write a message.

    Raises:
        OSError: the reader has ended.
    """
    pickle.dump(message, file)
    file.flush()


def receive(file: BinaryIO) -> Any:
    """Read a message.

    Raises:
        EOFError: the writer has ended.
    """
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
        _prepare(*receive(inlet))
    except EOFError:
        return
    except BaseException as error:  # a script may also end itself
        send(outlet, f"{type(error).__name__}: {error}")
        return
    calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(inlet, calls), daemon=True).start()
    send(outlet, READY)
    while True:
        call = calls.get()
        send(outlet, BEGUN)
        send(outlet, _outcome(call))


def _prepare(data: dict[str, Any], evaluation: bytes) -> None:
    """Import the main script of the pool's process, and check that the evaluation can be unpickled."""
    global _preparing
    _preparing = True
    load_additions()
    multiprocessing.spawn.prepare(data)
    pickle.loads(evaluation)
    _preparing = False


def _listen(inlet: BinaryIO, calls: queue.SimpleQueue[Any]) -> None:
    """Queue the pool's calls, and end this process with the pool, even if that is killed during a computation here."""
    try:
        while True:
            calls.put(receive(inlet))
    except EOFError:
        os._exit(1)


def _outcome(call: bytes) -> tuple[bool, bytes]:
    """Return whether a call returned, and its result or error as a pickle."""
    try:
        function, arguments, keywords = pickle.loads(call)
        return True, pickle.dumps(function(*arguments, **keywords))
    except BaseException as error:
        try:
            pickled = pickle.dumps(error)
            pickle.loads(pickled)
        except Exception:  # not every exception can be sent
            pickled = pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
        return False, pickled
    finally:
        sys.stdout.flush()
