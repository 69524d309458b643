"""An SQLite file: opened to write or, from any place, to read; statements, transactions, and errors that name it."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from plough_opt.core.errors import InputError

# How long [s] to wait for another run's transaction.
_BUSY: Final = 60.0


class Database:
    """An SQLite file, open.

    Attributes:
        path: of the file, or None for one that is deleted when it is closed.
    """

    def __init__(self, path: str | Path | None, write: bool = True) -> None:
        """Open a file, and make it where it is to be written and is not there.

        Raises:
            InputError: a file that cannot be made or read.
        """
        self.path = None if path is None else Path(path)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        with self.telling():
            if write:
                self._connection = self._to_write()
            else:
                self._connection = self._to_read()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()
        if self._folder is not None:
            self._folder.cleanup()

    def run(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        """Carry out a statement; return all its rows.

        Raises:
            InputError: the file cannot be used, or is damaged.
        """
        with self.telling():
            return self._connection.execute(statement, values).fetchall()

    def run_many(self, statement: str, rows: Iterator[tuple[object, ...]]) -> int:
        """Carry out a statement for each row; return how many rows it changed."""
        with self.telling():
            return int(self._connection.executemany(statement, rows).rowcount)

    def rows(self, statement: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query without holding more than a few."""
        with self.telling():
            yield from self._connection.execute(statement)

    def tables(self) -> set[str]:
        """Return the names of the tables."""
        return {row[0] for row in self.run("SELECT name FROM sqlite_master WHERE type = 'table'")}

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """Do everything inside or nothing; others wait."""
        self.run("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            # A full disk may have ended the transaction already.
            with contextlib.suppress(InputError):
                self.run("ROLLBACK")
            raise
        self.run("COMMIT")

    def write_ahead(self) -> None:
        """Let others read while one writes; several runs may ask for it at the same moment."""
        with self.telling():
            for trial in range(100):
                try:
                    self._connection.execute("PRAGMA journal_mode = WAL")
                    break
                except sqlite3.OperationalError as error:
                    if "locked" not in str(error) or trial == 99:
                        raise
                    time.sleep(0.05)
        # The end of the process loses nothing; a power cut may lose the last transactions, and spoils nothing.
        self.run("PRAGMA synchronous = NORMAL")

    def make_whole(self) -> None:
        """Put everything into the one file, which can then be read from any medium; not while others have it open."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA busy_timeout = 0")
            self._connection.execute("PRAGMA journal_mode = DELETE")

    @contextlib.contextmanager
    def telling(self) -> Iterator[None]:
        """Say which file it is that fails."""
        try:
            yield
        except (sqlite3.Error, OverflowError) as error:
            raise InputError(f"the store '{self.path}' cannot be used: {error}") from None
        except OSError as error:
            raise InputError(f"the store '{self.path}' cannot be written: {error.strerror}") from None

    def _to_write(self) -> sqlite3.Connection:
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        # An empty name is SQLite's for a file that nobody else sees and that goes with the connection.
        # Whichever thread lets go of a result closes its store.
        return sqlite3.connect(self.path or "", timeout=_BUSY, isolation_level=None, check_same_thread=False)

    def _to_read(self) -> sqlite3.Connection:
        """Open without writing anything, from a medium that cannot be written too."""
        assert self.path is not None
        here = self.path.resolve()
        try:
            return _reader(here, "mode=ro")
        except sqlite3.OperationalError:
            log = here.with_name(f"{here.name}-wal")
            if not log.exists() or not log.stat().st_size:
                return _reader(here, "immutable=1")
        # What a killed run left beside the file belongs to it, and SQLite must write to put the two together.
        self._folder = tempfile.TemporaryDirectory()
        for part in (here, log):
            shutil.copy(part, self._folder.name)
        return _reader(Path(self._folder.name, here.name), "mode=rw")


def _reader(path: Path, mode: str) -> sqlite3.Connection:
    """Open a file and see whether it can be read."""
    connection = sqlite3.connect(
        f"{path.as_uri()}?{mode}", uri=True, timeout=_BUSY, isolation_level=None, check_same_thread=False
    )
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
    except BaseException:
        connection.close()
        raise
    return connection


def quoted(name: str) -> str:
    """Return a name as SQL writes it."""
    return '"' + name.replace('"', '""') + '"'
