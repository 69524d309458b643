"""The text of a problem file: where each key stands, what overrides change, and errors that say so."""

from __future__ import annotations

import contextlib
import difflib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plough_opt.errors import DomainError, InputError, nearest

Keys = tuple[str, ...]

# What the schema calls a wrong type -> what the file must have there.
_EXPECTED = {
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "a text in quotes",
}
_LIMITS = {"greater_than_equal": "at least", "less_than_equal": "at most"}
_QUOTED = re.compile(r"'([^']*)'")


class Source:
    """A parsed TOML text that knows its lines."""

    def __init__(self, text: str, name: str) -> None:
        """Parse a text; ``name`` is what errors call it.

        Raises:
            InputError: the text is not TOML; the message gives the line.
        """
        self.name = name
        self._lines = text.split("\n")
        self.overridden: dict[Keys, str] = {}
        self.begun: dict[Keys, str] = {}  # tables that an override had to make
        self._noted: list[InputError] = []
        try:
            self.data: dict[str, Any] = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            at = re.search(r"at line (\d+)", str(error))
            line = f", line {at[1]}" if at else f", line {len(text.splitlines()) or 1}"
            raise InputError(f"{name}{line}: not valid TOML: {str(error).split(' (at')[0]}") from None

    @classmethod
    def read(cls, path: Path) -> Source:
        """Read a file.

        Raises:
            InputError: no such file (the message names the nearest), a folder, or not text.
        """
        try:
            return cls(path.read_text(encoding="utf-8-sig"), str(path))
        except FileNotFoundError:
            there = sorted(p.name for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
            hint = _nearest_file(path, there) if there else "plough-opt init FILE writes one"
            raise InputError(f"there is no file '{path}': {hint}") from None
        except IsADirectoryError:
            raise InputError(f"'{path}' is a folder: name a problem file in it") from None
        except UnicodeDecodeError:
            raise InputError(f"'{path}' cannot be read as text: it is not UTF-8") from None
        except OSError as error:
            raise InputError(f"'{path}' cannot be read: {error.strerror}") from None

    def line_of(self, keys: Sequence[str]) -> int | None:
        """Return the line on which a key, or failing that the table around it, begins."""
        for count in range(len(keys), 0, -1):
            complete = 0
            for number in range(1, len(self._lines) + 1):
                place = _parsed(self._lines[:number])
                if place is None:
                    continue
                if _holds(place, keys[:count]):
                    return self._first_line(complete, number)
                complete = number
        return None

    def _first_line(self, before: int, end: int) -> int:
        """Return the first line between two that is neither empty nor a comment."""
        texts = (line.strip() for line in self._lines[before:end])
        return next((before + k for k, text in enumerate(texts, start=1) if text and not text.startswith("#")), end)

    def error(self, keys: Sequence[str], message: str) -> InputError:
        """Return an error about a key, with its line or the override that set it."""
        for path, text in self.overridden.items():
            within_entry = keys[0] in ("variables", "minimise", "require") and len(keys) >= 2
            if path == tuple(keys[: len(path)]) or (within_entry and path[:2] == tuple(keys) and path[2] != "log"):
                return PlacedError(f"--set {text}: {message}", 0)
        line = self.line_of(keys)
        return PlacedError(f"{self.name}{'' if line is None else f', line {line}'}: {message}", line or 0)

    @contextlib.contextmanager
    def noting(self, keys: Sequence[str], prefix: str = "") -> Iterator[None]:
        """Note a refusal inside, with file and line, for `raise_noted`.

        Args:
            keys: the key to blame.
            prefix: what to say before the refusal.
        """
        try:
            yield
        except PlacedError as error:
            self._noted.append(error)
        except (DomainError, InputError) as error:
            self._noted.append(self.error(keys, f"{prefix}{error}"))
        except OverflowError:
            self._noted.append(self.error(keys, f"{prefix}too large to compute with"))

    def raise_noted(self) -> None:
        """Raise one error that lists everything noted, in the order of the lines; nothing if nothing was."""
        if self._noted:
            unique = {str(error): error for error in self._noted}
            ordered = sorted(unique.values(), key=lambda error: getattr(error, "line", 0))
            raise InputError("\n".join(map(str, ordered)))

    def note_schema(self, error: ValidationError, valid: Mapping[str, Sequence[str]]) -> None:
        """Note everything a schema refused, each with its line.

        Args:
            error: what the schema found.
            valid: table -> its valid keys, for suggestions; "" is the file's top level.
        """
        # A union reports each alternative that it tried: the first says enough.
        items = list({_keys(item): item for item in reversed(error.errors())}.values())
        meant = set()
        for item in items:
            if item["type"] == "extra_forbidden":
                keys = _keys(item)
                close = difflib.get_close_matches(keys[-1], _known(keys, valid), n=2, cutoff=0.55)
                meant |= {(*keys[:-1], name) for name in close}
        for item in items:
            # A misspelt key is missing too: say it once.
            if item["type"] != "missing" or _keys(item) not in meant:
                self._noted.append(self._explained(item, valid))

    def _explained(self, item: Any, valid: Mapping[str, Sequence[str]]) -> InputError:
        keys = _keys(item)
        dotted = ".".join(keys)
        if item["type"] == "extra_forbidden":
            return self.error(keys, f"'{dotted}' is not a known key: {nearest(keys[-1], _known(keys, valid))}")
        if item["type"] == "missing":
            began = next((text for path, text in self.begun.items() if path == keys[: len(path)]), None)
            if began is not None:
                return PlacedError(f"--set {began}: '{dotted}' is missing", 0)
            return self.error(keys, f"'{dotted}' is missing")
        if item["type"] in ("model_type", "dict_type", "model_attributes_type"):
            return self.error(keys, f"'{dotted}' must be a table of keys, not {item['input']!r}")
        if kind := _EXPECTED.get(item["type"]):
            return self.error(keys, f"'{dotted}' = {item['input']!r} must be {kind}")
        if limit := _LIMITS.get(item["type"]):
            side = next(iter(item["ctx"].values()))
            return self.error(keys, f"'{dotted}' = {item['input']!r} must be {limit} {side}")
        if item["type"] == "literal_error":
            valid_values = _QUOTED.findall(item["ctx"]["expected"])
            return self.error(keys, f"'{dotted}' = {item['input']!r} is unknown:"
                              f" {nearest(str(item['input']), valid_values)}")  # fmt: skip
        message = item["msg"].removeprefix("Value error, ")
        joint = " " if message.startswith(("=", "is not", "has ")) else ": "
        return self.error(keys, f"'{dotted}'{joint}{message[0].lower() + message[1:]}")


def _nearest_file(path: Path, names: Sequence[str]) -> str:
    """Return a clause that suggests files beside a path."""
    close = difflib.get_close_matches(path.name, names, n=2, cutoff=0.7)
    if not close:
        return f"in that folder are {', '.join(names)}"
    return f"did you mean {' or '.join(repr(str(path.parent / name)) for name in close)}?"


class PlacedError(InputError):
    """An error that knows its line."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


def _keys(item: Any) -> Keys:
    """Return the path of a schema error, without the alternatives that a union tried."""
    return tuple(str(key) for key in item["loc"] if key not in ("str", "int", "float"))


def _known(keys: Keys, valid: Mapping[str, Sequence[str]]) -> Sequence[str]:
    """Return the valid keys of the table that a path's last key stands in."""
    return valid.get(".".join(keys[:-1]), valid.get(keys[0], ()) if len(keys) > 1 else ())


def _parsed(lines: Sequence[str]) -> dict[str, Any] | None:
    """Return lines as TOML, or None where they are not TOML on their own."""
    try:
        return tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError:
        return None


def _holds(place: Any, keys: Sequence[str]) -> bool:
    """Return whether a key is set; a dotted name may stand in quotes or as nested tables."""
    for position, key in enumerate(keys):
        if isinstance(place, dict) and key in place:
            place = place[key]
        elif "." in key and position > 0:
            return _holds(place, [*key.split("."), *keys[position + 1 :]])
        else:
            return False
    return True
