"""The number of processors that a computation may use: those of its process, or one in each of several workers."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# A context variable, so that other threads keep their own values.
_one_of_several: ContextVar[bool] = ContextVar("one_of_several", default=False)


def available() -> int:
    """Return the number of processors, at least 1, that the calling code may use.

    It follows the process's affinity, which `taskset`, containers and batch systems set, not the machine.
    """
    if _one_of_several.get():
        return 1
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on; it respects -X cpu_count too
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_of_several() -> Iterator[None]:
    """Leave the other processors to the other workers of a sweep as long as the context lasts."""
    token = _one_of_several.set(True)
    try:
        yield
    finally:
        _one_of_several.reset(token)
