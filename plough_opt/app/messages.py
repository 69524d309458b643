"""Messages on the error stream: notes and files written, with -v each step of a computation, with -q only errors."""

import argparse
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console

from plough_opt.core.errors import unprintable

# Messages of commands themselves, which are shown unless -q silences them; those of the library need -v.
LOG = logging.getLogger(__name__)
_LIBRARY = logging.getLogger("plough_opt")
_LEVELS: Final = (logging.WARNING, logging.INFO, logging.DEBUG)


class _ErrorStream(logging.Handler):
    """Writes each message in a line of its own, with the time since the start where steps are shown."""

    def __init__(self, timed: bool) -> None:
        super().__init__()
        self._timed = timed

    def emit(self, record: logging.LogRecord) -> None:
        """Write a message; one that the reader's terminal would take for commands is quoted."""
        time = f"{record.relativeCreated / 1e3:8.2f} s  " if self._timed else ""
        Console(stderr=True, highlight=False, soft_wrap=True).print(
            f"{time}{printable(record.getMessage())}", markup=False
        )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add -q and -v."""
    how_much = parser.add_mutually_exclusive_group()
    how_much.add_argument("-q", "--quiet", action="store_true", help="no progress, notes or names of files written")
    how_much.add_argument(
        "-v", "--verbose", action="count", default=0, help="each step with its time; twice: every solve and run too"
    )


@contextmanager
def messages(options: argparse.Namespace) -> Iterator[None]:
    """Show messages as -q and -v ask for, for the time of one command."""
    verbose = min(options.verbose, len(_LEVELS) - 1)
    handler = _ErrorStream(timed=verbose > 0)
    before = _LIBRARY.level, LOG.level
    _LIBRARY.addHandler(handler)
    _LIBRARY.setLevel(_LEVELS[verbose])
    LOG.setLevel(logging.ERROR if options.quiet else logging.DEBUG if verbose else logging.INFO)
    try:
        yield
    finally:
        _LIBRARY.removeHandler(handler)
        _LIBRARY.setLevel(before[0])
        LOG.setLevel(before[1])


def printable(text: str) -> str:
    """Return a user's text in which what a terminal would take for a command is written as Python writes it."""
    return "".join(repr(character)[1:-1] if unprintable(character) else character for character in text)


def quiet() -> bool:
    """Return True under -q."""
    return not LOG.isEnabledFor(logging.INFO)


def stepwise() -> bool:
    """Return True under -v, where each step is a line."""
    return LOG.isEnabledFor(logging.DEBUG)
