"""Text of a problem file: the parsed tables, and the line of each key for errors."""

from __future__ import annotations

import contextlib
import difflib
import re
import tomllib
from collections.abc import Iterator, Sequence
from functools import cached_property, reduce
from pathlib import Path
from typing import Any, Final, cast

from pydantic import ValidationError

from plough_opt.core.errors import DomainError, InputError, nearest, short, unprintable
from plough_opt.core.files import BYTE_ORDER_MARK, read_text
from plough_opt.core.tables import raise_listed
from plough_opt.core.units import Unit
from plough_opt.problem_file.schema import valid_keys

Keys = tuple[str, ...]

# Type of a pydantic error -> the rest of a sentence that begins with the key.
_SCHEMA_MESSAGES: Final = {
    **dict.fromkeys(("model_type", "dict_type", "model_attributes_type"), "must be a table of keys, not {written}"),
    "bool_type": "= {written} must be true or false, without quotes",
    "int_type": "= {written} must be a whole number, without quotes",
    "float_type": "= {written} must be a number, without quotes",
    "string_type": "= {written} must be a text in quotes",
    "greater_than_equal": "= {written} must be at least {ge}",
    "less_than_equal": "= {written} must be at most {le}",
    "list_type": "= {written} must be a list in brackets",
    "missing": "is missing: add it",
}
# A number with a decimal comma where TOML expects a value.
_DECIMAL_COMMA: Final = re.compile(r"^[^#\"']*=\s*([+-]?[0-9]+,[0-9]+)(?![\w\"'])")
# Nesting depth of tables and lists that a problem file may have; the schema needs four.
MOST_TABLES: Final = 8
TOO_DEEP: Final = f"tables or lists are nested more than {MOST_TABLES} deep: write them flat"
# Size limits: far above any file written by hand, and low enough that any content is read within a second.
_MAX_BYTES: Final = 100_000
_MAX_LINE_LENGTH: Final = 1_000  # below the 4300 digits beyond which Python refuses to parse an integer
_MAX_INTEGER_BITS: Final = 1_024  # an integer with more bits exceeds the largest float
# Longer lists of mistakes usually repeat one mistake.
_MAX_LISTED: Final = 20


class Source:
    """A parsed TOML text that knows the line of each key.

    Attributes:
        name: the name of the file in messages.
        original: the text as it is in the file.
        text: the text without byte order mark, its lines ended by single line feeds.
        data: the parsed tables, with overrides applied; dotted names of variables are single keys.
        overridden: path of each key that an override set -> the override as the user wrote it.
        read_files: name of each data file, as the problem file writes it -> its text.
    """

    def __init__(self, text: str, name: str) -> None:
        """Parse a text; messages call it ``name``.

        Raises:
            InputError: the text is not TOML or exceeds a size limit; the message gives the line.
        """
        self.name, self.original = name, text
        self.text = text.removeprefix(BYTE_ORDER_MARK).replace("\r\n", "\n")
        self.overridden: dict[Keys, str] = {}
        self.read_files: dict[str, str] = {}
        self._noted: list[PlacedError] = []
        for number, line in enumerate(self.text.split("\n"), start=1):
            if len(line) > _MAX_LINE_LENGTH:
                raise InputError(f"{name}, line {number}: {len(line)} characters; at most {_MAX_LINE_LENGTH}: split it")
        self.data = _parsed_toml(self.text, name)
        if wrong := unreadable(self.data):
            raise self.error(*wrong)
        join_dotted(self.data)

    @classmethod
    def read(cls, path: Path) -> Source:
        """Read a file.

        Raises:
            InputError: the file does not exist (the message suggests similar names), is a folder, is JSON, is too
                long, or is not text.
        """
        missing = "plough-opt init FILE writes one"
        return cls(read_text(path, "a problem file", ".toml", _MAX_BYTES, missing), str(path))

    def written(self, key: str) -> Any:
        """Return the value of a dotted key as the file writes it, or None."""
        parts, whole = key.split("."), self.data
        return reduce(lambda table, part: table.get(part) if isinstance(table, dict) else None, parts, cast(Any, whole))

    def line_of(self, keys: Sequence[str]) -> int:
        """Return the line on which a key begins, or else the innermost table around it that is found; 0 if none is."""
        places = (".".join(keys[:count]) for count in range(len(keys), 0, -1))
        return next((self._line_of[place] for place in places if place in self._line_of), 0)

    @cached_property
    def _line_of(self) -> dict[str, int]:
        """Dotted name of each key and table, however the text writes it -> the line on which it begins."""
        lines: dict[str, int] = {}
        table: Keys = ()
        statement, begun = "", 1
        for number, line in enumerate(self.text.split("\n"), start=1):
            statement += f"{line}\n"
            try:
                paths = [keys for keys, _ in entries(tomllib.loads(statement))]
            except tomllib.TOMLDecodeError:  # it goes on in the next line
                continue
            heading = statement.lstrip().startswith("[")
            for keys in paths:
                lines.setdefault(".".join(keys if heading else (*table, *keys)), begun)
            table = max(paths, key=len) if heading else table
            statement, begun = "", number + 1
        return lines

    def error(self, keys: Sequence[str], message: str) -> PlacedError:
        """Return an error about a key that names its line, or the override that set it or a part of it."""
        for path, text in self.overridden.items():
            if path == tuple(keys[: len(path)]) or (len(keys) > 1 and path[: len(keys)] == tuple(keys)):
                return PlacedError(f"--set {text}: {message}", 0)
        line = self.line_of(keys)
        return PlacedError(f"{self.name}{f', line {line}' if line else ''}: {message}", line)

    def note(self, keys: Sequence[str], message: str) -> None:
        """Note a mistake in a key, with file and line, for `raise_noted`."""
        self._noted.append(self.error(keys, message))

    @contextlib.contextmanager
    def noting(self, keys: Sequence[str], prefix: str = "") -> Iterator[None]:
        """Catch an error raised inside, and note it with file and line for `raise_noted`.

        Args:
            keys: path of the key that the message names.
            prefix: text before the message.
        """
        try:
            yield
        except PlacedError as error:
            self._noted.append(error)
        except (DomainError, InputError) as error:
            self.note(keys, f"{prefix}{error}")
        except ArithmeticError:  # overflow, or a difference of huge numbers that is 0
            self.note(keys, f"{prefix}too large or too small to compute with: check its unit")

    def parsed(self, keys: Keys, unit: Unit, written: object, what: str, more: str = "") -> float:
        """Return a written quantity in SI.

        Args:
            keys: path of its key.
            unit: its SI unit.
            written: the value as the file writes it.
            what: name of the quantity, with which messages begin.
            more: text added to the end of the message.

        Raises:
            InputError: the value is not a quantity of this unit; the message has the line.
        """
        try:
            return unit.parse(written)
        except InputError as error:
            raise self.error(keys, f"{what} {error}{more}") from None

    def note_schema(self, error: ValidationError) -> None:
        """Note every error that the schema found, with its line."""
        # A union reports one error for each alternative, whose name it adds to the path; the first is enough.
        items = {tuple(str(key) for key in item["loc"] if key not in ("str", "int", "float")): item
                 for item in reversed(error.errors())}  # fmt: skip
        unknown = [keys for keys, item in items.items() if item["type"] == "extra_forbidden"]
        # A misspelt key is reported as unknown; do not report the key that it stands for as missing too.
        meant = {(*keys[:-1], name) for keys in unknown[:_MAX_LISTED]
                 for name in difflib.get_close_matches(keys[-1], valid_keys(keys[:-1]), n=2, cutoff=0.55)}  # fmt: skip
        for keys, item in items.items():
            missing = item["type"] == "missing"
            if not (missing and keys in meant):
                self.note(keys[:-1] if missing else keys, f"'{'.'.join(keys)}'{_explained(keys, item)}")

    def raise_noted(self) -> None:
        """Raise one InputError that lists all noted mistakes in order of their lines, if there are any."""
        in_order = sorted(self._noted, key=lambda error: error.args[1])
        raise_listed([*dict.fromkeys(map(str, in_order))], _MAX_LISTED)


class PlacedError(InputError):
    """An error whose second argument is its line number; 0 for an override."""


def _explained(keys: Keys, item: Any) -> str:
    """Return one error of the schema in plain words, with what to do about it, to follow the key."""
    written = short(repr(item["input"]))
    if item["type"] == "extra_forbidden":
        return f" is not a known key: {nearest(keys[-1], valid_keys(keys[:-1]))}"
    if item["type"] == "literal_error":
        choices = re.findall(r"'([^']*)'", item["ctx"]["expected"])
        return f" = {written} is unknown: {nearest(str(item['input']), choices)}"
    if words := _SCHEMA_MESSAGES.get(item["type"]):
        other = len(keys) == 2 and keys[0] in ("trade_off", "uncertain") and "table of keys" in words
        rather = f", or another key: {nearest(keys[1], valid_keys(keys[:1]))}" if other else ""
        return f" {words.format(written=written, **item.get('ctx', {}))}{rather}"
    message = item["msg"].removeprefix("Value error, ")
    joint = " " if message.startswith(("=", "is not", "has ")) else ": "
    return f"{joint}{message[0].lower() + message[1:]}"


def _parsed_toml(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text; raise InputError that gives the line and what to do."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{name}: {TOO_DEEP}") from None
    except tomllib.TOMLDecodeError as error:
        lines, at = text.split("\n"), re.search(r"at line (\d+)", str(error))
        number = min(int(at[1]), len(lines)) if at else len(lines)
        remedy = 'write each key once, on its own line, as tow_speed = "7.2 km/h", with text in quotes'
        if comma := _DECIMAL_COMMA.search(lines[number - 1]):
            remedy = f"{comma[1]} has a decimal comma: write {comma[1].replace(',', '.')}"
        said = short(str(error).split(" (at")[0], 100)
        raise InputError(f"{name}, line {number}: not valid TOML: {said}; {remedy}") from None


def entries(data: Any) -> Iterator[tuple[Keys, Any]]:
    """Yield path and value of the whole and of all tables, lists and values in it, one level beyond the deepest."""
    rest: list[tuple[Keys, Any]] = [((), data)]
    while rest:  # a loop, because deep nesting would exhaust recursion
        keys, value = rest.pop()
        yield keys, value
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        if len(keys) <= MOST_TABLES:
            rest += [((*keys, str(name)), each) for name, each in inner]


def unreadable(data: Any) -> tuple[Keys, str] | None:
    """Return the path and description of a parsed value that cannot be printed or computed with, or None."""
    for keys, value in entries(data):
        if len(keys) > MOST_TABLES:
            return keys[:MOST_TABLES], TOO_DEEP
        if isinstance(value, int) and value.bit_length() > _MAX_INTEGER_BITS:
            return keys, f"'{'.'.join(keys)}' is larger than any number that can be computed with: check it"
        for text in (*keys[-1:], value):
            if isinstance(text, str) and (wrong := unprintable(text)) is not None:
                return keys, f"'{'.'.join(keys)}' holds {wrong}, a character that cannot be printed: remove it"
    return None


def join_dotted(data: dict[str, Any]) -> None:
    """Replace unquoted keys such as share.height = {...} in [variables] and [uncertain] by "share.height" = {...}."""

    def joined(name: str, value: Any) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict) and value and all(isinstance(each, dict) for each in value.values()):
            for key, each in value.items():
                yield from joined(f"{name}.{key}", each)
        else:
            yield name, value

    for table in (data[name] for name in ("variables", "uncertain") if isinstance(data.get(name), dict)):
        pairs = [pair for name, value in table.items() for pair in joined(name, value)]
        table.clear()
        for name, value in pairs:  # an override may have added keys to a table under the quoted name
            own = table.get(name)
            table[name] = own | value if isinstance(own, dict) and isinstance(value, dict) else value
