"""An error stream without CasADi's notices, for processes that are the toolkit's own: commands and workers of sweeps.

CasADi says of every integrator with events, and of its derivatives, that they are experimental. A program that uses the
toolkit hears it, for its streams are its own; who asked a command for an answer need not.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

_BEGINS: Final = "CasADi - "
_SAYS: Final = "Event support is experimental"


class Sieve:
    """A stream that passes everything on but lines by CasADi that its events are experimental.

    CasADi writes a line in pieces. They are put together, for each thread by itself, from the first that begins as its
    lines do; what others write is passed on at once.
    """

    def __init__(self, stream: Any) -> None:
        """Take the stream to pass on to."""
        self._stream = stream
        self._begun = threading.local()

    def write(self, text: str) -> int:
        """Pass text on, or keep it until it is a line."""
        line = getattr(self._begun, "line", "") + text
        held = line.startswith(_BEGINS) and not line.endswith("\n")
        self._begun.line = line if held else ""
        if not held and not (line.startswith(_BEGINS) and _SAYS in line):
            self._stream.write(line)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Leave all else to the stream."""
        return getattr(self._stream, name)


@contextmanager
def without_notices() -> Iterator[None]:
    """Let the error stream be without CasADi's notices for as long as the context lasts."""
    before = sys.stderr
    if before is not None:  # which whoever starts the process may have closed
        sys.stderr = Sieve(before)
    try:
        yield
    finally:
        sys.stderr = before
