"""This process: its processors, its error stream, lines on its progress, and additions from outside the package."""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.metadata import entry_points
from typing import Any, Final

from plough_opt.core.errors import InputError

# A context variable, so that other threads keep their own values.
_one_of_several: ContextVar[bool] = ContextVar("one_of_several", default=False)

# The beginning of CasADi's lines, and what those say that commands leave out.
_BEGINS: Final = "CasADi - "
_NOTICE: Final = "Event support is experimental"

EVERY: Final = 10.0
"""Seconds between the lines: a user who sees nothing for longer may think that the process is dead."""

GROUP: Final = "plough_opt"
"""Group of entry points, as ``[project.entry-points.plough_opt]`` in a package's pyproject.toml names it."""


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


class Sieve:
    """A stream that passes on everything except CasADi's lines about experimental events.

    CasADi prints for every integrator with events, and for its derivatives, that they are experimental. A program that
    uses the toolkit gets these lines on its own stream; a user of the commands does not need them.

    CasADi writes a line in pieces. These are put together, separately for each thread, from the piece with which
    CasADi's lines begin; other text is passed on at once.
    """

    def __init__(self, stream: Any) -> None:
        """Take the stream to pass on to."""
        self._stream = stream
        self._begun = threading.local()

    def write(self, text: str) -> int:
        """Pass text on, or keep it until the line is complete."""
        line = getattr(self._begun, "line", "") + text
        held = line.startswith(_BEGINS) and not line.endswith("\n")
        self._begun.line = line if held else ""
        if not held and not (line.startswith(_BEGINS) and _NOTICE in line):
            self._stream.write(line)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the stream."""
        return getattr(self._stream, name)


@contextmanager
def without_notices() -> Iterator[None]:
    """Remove CasADi's notices from the error stream as long as the context lasts."""
    before = sys.stderr
    if before is not None:  # the process may have been started without one
        sys.stderr = Sieve(before)
    try:
        yield
    finally:
        sys.stderr = before


@contextmanager
def heartbeat(write: Callable[[str], object], every: float | None = None) -> Iterator[Callable[[str], None]]:
    """Write every few seconds the present activity and the time since the start; yield a function that sets it.

    Args:
        write: called with a line, by another thread.
        every: seconds between the lines; default `EVERY`. A shorter computation writes nothing.
    """
    activity, done, started = "working", threading.Event(), time.monotonic()

    def beat() -> None:
        # If the stream is closed, the error is raised where the results are written.
        with contextlib.suppress(OSError, ValueError):
            while not done.wait(EVERY if every is None else every):
                write(f"{activity}: {time.monotonic() - started:.0f} s so far")

    def note(text: str) -> None:
        nonlocal activity
        activity = text

    thread = threading.Thread(target=beat, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield note
    finally:
        done.set()
        thread.join()


def load_additions() -> None:
    """Import every module that an installed package names as an addition: it adds itself to a registry.

    Raises:
        InputError: one cannot be imported; the message names it, its package and the reason.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist is not None else "an installed package"
            raise InputError(
                f"the addition '{entry.name}' = {entry.value} of {package} cannot be imported"
                f" ({type(error).__name__}: {error}): mend it, or uninstall {package}"
            ) from error
