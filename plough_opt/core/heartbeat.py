"""Lines on the progress of a long computation, for streams that are not terminals."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

EVERY: Final = 10.0
"""Seconds between the lines: a user who sees nothing for longer may think that the process is dead."""


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
