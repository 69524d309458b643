"""Services of the running process: processors, error stream, progress lines, additions, libraries."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Final

from plough_opt.core.errors import InputError

# A context variable, so that other threads keep their own values.
_one_of_several: ContextVar[bool] = ContextVar("one_of_several", default=False)

# Prefix of every line that CasADi prints.
_PREFIX: Final = "CasADi - "
# Text of the lines that commands suppress.
_NOTICE: Final = "Event support is experimental"

INTERVAL: Final = 10.0
"""Seconds between progress lines; after a longer silence a user may think that the process hangs."""

GROUP: Final = "plough_opt"
"""Group of entry points: ``[project.entry-points.plough_opt]`` in a package's pyproject.toml."""


def available() -> int:
    """Return the number of processors, at least 1, that the calling code may use.

    It is the process's affinity, which `taskset`, containers and batch systems restrict.
    """
    if _one_of_several.get():
        return 1
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on; it respects -X cpu_count too
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_of_several() -> Iterator[None]:
    """Make `available` return 1 inside this context, because other workers use the other processors."""
    token = _one_of_several.set(True)
    try:
        yield
    finally:
        _one_of_several.reset(token)


class Sieve:
    """A stream that forwards everything except CasADi's notices that event support is experimental.

    CasADi prints one for every integrator with events and for each of its derivatives, in pieces. Every run is checked
    by a second one, so users do not need them.
    """

    def __init__(self, stream: Any) -> None:
        """Set the stream to forward to."""
        self.stream, self._line = stream, ""

    def write(self, text: str) -> int:
        """Forward text; a line of CasADi's only once it is complete, and if it is no notice."""
        line, self._line = self._line + text, ""
        if line.startswith(_PREFIX) and not line.endswith("\n"):
            self._line = line
        elif not (line.startswith(_PREFIX) and _NOTICE in line):
            self.stream.write(line)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the stream."""
        return getattr(self.stream, name)


@contextmanager
def without_notices() -> Iterator[None]:
    """Suppress CasADi's notices on the error stream, which a process may lack, inside this context."""
    if sys.stderr is None or isinstance(sys.stderr, Sieve):
        yield
    else:
        with contextlib.redirect_stderr(Sieve(sys.stderr)):
            yield


@contextmanager
def heartbeat(write: Callable[[str], object]) -> Iterator[Callable[[str], None]]:
    """Write the current activity and the elapsed time every few seconds; yield a function that sets the activity.

    A computation shorter than `INTERVAL` writes nothing.

    Args:
        write: called with each line, from another thread.
    """
    activity, done, started = "working", threading.Event(), time.monotonic()

    def beat() -> None:
        # If the stream is closed, writing the results raises the error.
        with contextlib.suppress(OSError, ValueError):
            while not done.wait(INTERVAL):
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
    """Import the modules that installed packages declare as additions; each adds itself to a registry.

    Raises:
        InputError: a module cannot be imported; the message gives it, its package and the reason.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist is not None else "an installed package"
            raise InputError(
                f"the addition '{entry.name}' = {entry.value} of {package} cannot be imported"
                f" ({type(error).__name__}: {error}): repair it, or uninstall {package}"
            ) from error


# Module of a library -> the extra of this package that installs it.
_EXTRAS: Final = {
    "build123d": "step", "distributed": "cluster", "ezdxf": "parts", "jinja2": "report", "openmdao.api": "openmdao",
    "pandas": "pandas", "trimesh": "parts",
}  # fmt: skip


def optional(name: str) -> Any:
    """Return a module of a library that an extra of this package installs, or that users install themselves.

    Raises:
        InputError: the library, or one that it needs, is not installed; the message names the extra.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as missing:
        wanted = f"plough_opt[{_EXTRAS[name]}]" if name in _EXTRAS else name
        raise InputError(f"{missing.name or name} is not installed: pip install '{wanted}'") from None
