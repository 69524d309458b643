"""An SQLite file, opened to write or, on any medium, to read; statements, transactions, and errors that name it."""

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
        """Open a file; a missing one is made if it is to be written.

        Raises:
            InputError: a file that cannot be made or read.
        """
        self.path = None if path is None else Path(path)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        with self.naming_errors():
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
        """Execute a statement; return all its rows.

        Raises:
            InputError: the file cannot be used, or is damaged.
        """
        with self.naming_errors():
            return self._connection.execute(statement, values).fetchall()

    def run_many(self, statement: str, rows: Iterator[tuple[object, ...]]) -> int:
        """Execute a statement for each row; return the number of rows that it changed."""
        with self.naming_errors():
            return int(self._connection.executemany(statement, rows).rowcount)

    def rows(self, statement: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query, of which only a few are in memory at once."""
        with self.naming_errors():
            yield from self._connection.execute(statement)

    def tables(self) -> set[str]:
        """Return the names of the tables."""
        return {row[0] for row in self.run("SELECT name FROM sqlite_master WHERE type = 'table'")}

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit everything done inside, or nothing if it fails; other processes wait."""
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
        """Allow others to read while one writes; several runs may call this at the same moment."""
        with self.naming_errors():
            for trial in range(100):
                try:
                    self._connection.execute("PRAGMA journal_mode = WAL")
                    break
                except sqlite3.OperationalError as error:
                    if "locked" not in str(error) or trial == 99:
                        raise
                    time.sleep(0.05)
        # If the process dies nothing is lost; a power cut may lose the last transactions, but damages nothing.
        self.run("PRAGMA synchronous = NORMAL")

    def make_whole(self) -> None:
        """Move everything into the one file, which can then be read from any medium, unless others have it open."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA busy_timeout = 0")
            self._connection.execute("PRAGMA journal_mode = DELETE")

    @contextlib.contextmanager
    def naming_errors(self) -> Iterator[None]:
        """Raise errors inside as InputError with the name of the file."""
        try:
            yield
        except (sqlite3.Error, OverflowError) as error:
            raise InputError(f"the store '{self.path}' cannot be used: {error}") from None
        except OSError as error:
            raise InputError(f"the store '{self.path}' cannot be written: {error.strerror}") from None

    def _to_write(self) -> sqlite3.Connection:
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        # With an empty name SQLite makes a temporary file that is deleted with the connection.
        # The store may be closed by any thread, that in which a result is collected as garbage.
        return sqlite3.connect(self.path or "", timeout=_BUSY, isolation_level=None, check_same_thread=False)

    def _to_read(self) -> sqlite3.Connection:
        """Open without writing anything, so that the medium may be read-only."""
        assert self.path is not None
        here = self.path.resolve()
        try:
            return _reader(here, "mode=ro")
        except sqlite3.OperationalError:
            log = here.with_name(f"{here.name}-wal")
            if not log.exists() or not log.stat().st_size:
                return _reader(here, "immutable=1")
        # A killed run has left a log beside the file, and SQLite must write to merge the two.
        self._folder = tempfile.TemporaryDirectory()
        for part in (here, log):
            shutil.copy(part, self._folder.name)
        return _reader(Path(self._folder.name, here.name), "mode=rw")


def _reader(path: Path, mode: str) -> sqlite3.Connection:
    """Return a connection to a file, after a query that fails if the file cannot be read."""
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
    """Return a name as a quoted identifier of SQL."""
    return '"' + name.replace('"', '""') + '"'
