"""An error stream without CasADi's notices, for the toolkit's own processes: commands and workers of sweeps.

CasADi prints for every integrator with events, and for its derivatives, that they are experimental. A program that uses
the toolkit gets these lines on its own stream; a user of the commands does not need them.
"""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

_BEGINS: Final = "CasADi - "
_NOTICE: Final = "Event support is experimental"


class Sieve:
    """A stream that passes on everything except CasADi's lines about experimental events.

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
