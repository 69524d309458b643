"""Lines that say what a long computation is doing, for whoever reads a stream that is no terminal."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

EVERY: Final = 10.0
"""Seconds between the lines: a reader who waits longer for a sign takes the process for dead."""


@contextmanager
def heartbeat(write: Callable[[str], object], every: float | None = None) -> Iterator[Callable[[str], None]]:
    """Write every few seconds what is being done and for how long; yield what is told what that is.

    Args:
        write: takes a line; it is called by another thread.
        every: seconds between the lines; default `EVERY`. What takes less writes nothing.
    """
    doing, done, started = ["working"], threading.Event(), time.monotonic()

    def beat() -> None:
        # A reader that went away is noticed where the results are written.
        with contextlib.suppress(OSError, ValueError):
            while not done.wait(EVERY if every is None else every):
                write(f"{doing[0]}: {time.monotonic() - started:.0f} s so far")

    def told(what: str) -> None:
        doing[0] = what

    thread = threading.Thread(target=beat, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield told
    finally:
        done.set()
        thread.join()
