"""The text of a problem file: where each key stands, what overrides change, and errors that say so."""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plough_opt.errors import DomainError, InputError, nearest

Keys = tuple[str, ...]


class Source:
    """A parsed TOML text that knows its lines."""

    def __init__(self, text: str, name: str) -> None:
        """Parse a text; ``name`` is what errors call it.

        Raises:
            InputError: the text is not TOML; the message gives the line.
        """
        self.name = name
        self._lines = text.splitlines()
        self.overridden: dict[Keys, str] = {}
        try:
            self.data: dict[str, Any] = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            at = re.search(r"at line (\d+)", str(error))
            line = f", line {at[1]}" if at else f", line {len(self._lines)}"
            raise InputError(f"{name}{line}: not valid TOML: {str(error).split(' (at')[0]}") from None

    @classmethod
    def read(cls, path: Path) -> Source:
        """Read a file.

        Raises:
            InputError: no such file (the message names the nearest), a folder, or not text.
        """
        try:
            return cls(path.read_text(encoding="utf-8"), str(path))
        except FileNotFoundError:
            folder = path.parent
            there = [str(folder / p.name) for p in folder.glob("*.toml")] if folder.is_dir() else []
            hint = nearest(str(path), there) if there else "plough-opt init FILE writes one to start from"
            raise InputError(f"there is no file '{path}': {hint}") from None
        except IsADirectoryError:
            raise InputError(f"'{path}' is a folder: name a problem file in it") from None
        except (PermissionError, UnicodeDecodeError) as error:
            raise InputError(f"'{path}' cannot be read as text: {error}") from None

    def line_of(self, keys: Sequence[str]) -> int | None:
        """Return the line on which a key, or failing that the table around it, is complete."""
        wanted = tuple(keys)
        while wanted:
            for number in range(1, len(self._lines) + 1):
                if _holds(self._lines[:number], wanted):
                    return number
            wanted = wanted[:-1]
        return None

    def error(self, keys: Sequence[str], message: str) -> InputError:
        """Return an error about a key, with its line or the override that set it."""
        for path, text in self.overridden.items():
            if path[: len(keys)] == tuple(keys)[: len(path)]:
                return InputError(f"--set {text}: {message}")
        line = self.line_of(keys)
        return InputError(f"{self.name}{'' if line is None else f', line {line}'}: {message}")

    @contextlib.contextmanager
    def blaming(self, keys: Sequence[str], places: Mapping[str, Keys] | None = None) -> Iterator[None]:
        """Turn a refusal inside into one that names file and line.

        Args:
            keys: the key to blame.
            places: for refusals of a quantity's value, the quantity's name and the key that set it.
        """
        try:
            yield
        except DomainError as error:
            raise self.error((places or {}).get(error.quantity, tuple(keys)), str(error)) from None
        except InputError as error:
            raise self.error(keys, str(error)) from None

    def explain(self, error: ValidationError, valid: Mapping[str, Sequence[str]]) -> InputError:
        """Return one error that lists everything a schema refused, each with its line.

        Args:
            error: what the schema found.
            valid: table -> its valid keys, for suggestions; "" is the file's top level.
        """
        return InputError("\n".join(sorted({str(self._explained(item, valid)) for item in error.errors()})))

    def _explained(self, item: Any, valid: Mapping[str, Sequence[str]]) -> InputError:
        keys = [str(key) for key in item["loc"] if key not in ("str", "float")]
        dotted, table = ".".join(keys), ".".join(keys[:-1])
        if item["type"] == "extra_forbidden":
            known = valid.get(table, valid.get(keys[0], ()))
            return self.error(keys, f"'{dotted}' is not a known key: {nearest(keys[-1], known)}")
        if item["type"] == "missing":
            return self.error(keys, f"'{dotted}' is missing")
        message = item["msg"].removeprefix("Value error, ")
        joint = " " if message.startswith(("=", "is not", "has ")) else ": "
        return self.error(keys, f"'{dotted}'{joint}{message[0].lower() + message[1:]}")


def _holds(lines: Sequence[str], keys: Keys) -> bool:
    """Return whether lines are TOML on their own in which a key is set."""
    try:
        place: Any = tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError:
        return False
    for key in keys:
        if not isinstance(place, dict) or key not in place:
            return False
        place = place[key]
    return True
