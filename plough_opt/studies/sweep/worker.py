"""A worker process of a sweep: what it runs, and the messages between it and the pool that started it.

The pool writes to the standard input of the process and reads from its standard output; whatever the work itself prints
goes to the error stream. A message is a pickle behind its length.
"""

from __future__ import annotations

import multiprocessing.spawn
import os
import pickle
import queue
import re
import select
import struct
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from plough_opt.core.notices import Sieve

READY: Final = "ready"
BEGUN: Final = "begun"

# Variables by which MPI's launchers talk to the processes that they started: a child of such a process is none of them.
_OF_LAUNCHERS: Final = re.compile(r"(PMI|PMIX|OMPI|PRTE|HYDI?|PALS|MPI)_")
# What the libraries of linear algebra and OpenMP ask for the number of their threads.
_THREADS: Final = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip
_LENGTH: Final = struct.Struct("<Q")
_PIECE: Final = 1 << 20
# How often to look whether a silent process is still there [s].
_GLANCE: Final = 1.0

# True in a worker that still imports the script which started it.
_preparing = False


def is_preparing() -> bool:
    """Return whether this process is a worker that has not begun: a script without a guard sweeps there again."""
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
    """Return the environment of a worker: this one's, not of an MPI job, with so many threads where none are set."""
    own = {name: text for name, text in os.environ.items() if not _OF_LAUNCHERS.match(name)}
    return {**dict.fromkeys(_THREADS, str(threads)), **own}


def preparation() -> dict[str, Any]:
    """Return what a worker must know of this process to import what stands in its main script."""
    found = multiprocessing.spawn.get_preparation_data("worker of a sweep")
    del found["authkey"]  # which no pickle may hold
    return found


def send(descriptor: int, message: object) -> None:
    """Write a message.

    Raises:
        OSError: nobody reads any more.
    """
    pickled = pickle.dumps(message)
    for part in (_LENGTH.pack(len(pickled)), pickled):
        rest = memoryview(part)
        while rest:
            rest = rest[os.write(descriptor, rest[:_PIECE]) :]


def receive(descriptor: int, alive: Callable[[], bool] = lambda: True) -> Any:
    """Read a message.

    Args:
        descriptor: to read from.
        alive: whether who writes is still there: what it forked may hold the pipe open after its death.

    Raises:
        EOFError: who writes has gone.
    """
    (length,) = _LENGTH.unpack(_read(descriptor, _LENGTH.size, alive))
    return pickle.loads(_read(descriptor, length, alive))


def _read(descriptor: int, count: int, alive: Callable[[], bool]) -> bytes:
    found = bytearray()
    while len(found) < count:
        # Windows' pipes cannot be selected; there a read waits for their end.
        while os.name == "posix" and not select.select([descriptor], [], [], _GLANCE)[0]:
            if not alive():
                raise EOFError
        piece = os.read(descriptor, min(count - len(found), _PIECE))
        if not piece:
            raise EOFError
        found += piece
    return bytes(found)


def serve() -> None:
    """Do what the pool asks until it is gone: what a worker runs."""
    inlet, outlet = os.dup(0), os.dup(1)
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
    """Import what the pool's process has as its main script, and see whether the evaluation arrives."""
    global _preparing
    _preparing = True
    multiprocessing.spawn.prepare(data)
    pickle.loads(evaluation)
    _preparing = False


def _listen(inlet: int, calls: queue.SimpleQueue[Any]) -> None:
    """Take calls in, and end this process with the pool, even where that is killed and whatever is computed here."""
    try:
        while True:
            calls.put(receive(inlet))
    except EOFError:
        os._exit(1)


def _outcome(call: bytes) -> tuple[bool, bytes]:
    """Return whether a call returned, and what it returned or raised, as a pickle."""
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
