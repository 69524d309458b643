"""How many processors a computation may keep busy: those that its process is given, or one beside other workers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Of a context, not of the process: other threads keep theirs.
_one_of_several: ContextVar[bool] = ContextVar("one_of_several", default=False)


def available() -> int:
    """Return the number of processors, at least 1, that the code which asks may keep busy.

    The process's affinity counts (as `taskset`, containers and batch systems set it), and not what the machine has.
    """
    if _one_of_several.get():
        return 1
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on; it heeds -X cpu_count too
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_of_several() -> Iterator[None]:
    """Leave the other processors to the other workers of a sweep for as long as the context lasts."""
    token = _one_of_several.set(True)
    try:
        yield
    finally:
        _one_of_several.reset(token)
