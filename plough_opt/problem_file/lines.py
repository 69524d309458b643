"""Where each key of a TOML text stands, and where brackets are too deep, found in one pass."""

import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any, Final

# What may hide brackets and line ends from a reader of TOML, brackets, and line ends.
_TOKEN: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}'
    r"|'''.*?'{3,5}"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*"
    r"|[\[\]{}\n]",
    re.DOTALL,
)


MOST_TABLES: Final = 8
"""Tables and lists in one another that a problem file may have; the schema needs four."""


def lines_of(text: str) -> dict[str, int]:
    """Return the line on which each key and table begins.

    Args:
        text: valid TOML, its lines ended by single line feeds.

    Returns:
        Keys with the names of the tables around them, joined by dots however the text writes them, and their lines.
    """
    found: dict[str, int] = {}
    table: tuple[str, ...] = ()
    for line, statement in _statements(text):
        parsed = tomllib.loads(statement)
        header = statement.startswith("[")
        if header:
            table = ()
        for path in _paths(parsed):
            for count in range(1, len(table) + len(path) + 1):
                found.setdefault(".".join((*table, *path)[:count]), line)
        if header:
            table = max(_paths(parsed), key=len)
    return found


def nested_line(text: str) -> int | None:
    """Return the first line of a TOML text on which more than `MOST_TABLES` brackets are open, or None."""
    depth, line = 0, 1
    for token in _TOKEN.finditer(text):
        depth += (token[0] in "[{") - (token[0] in "]}")
        if depth > MOST_TABLES:
            return line
        line += token[0].count("\n")
    return None


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield each key with its value, and each heading, with the line on which it begins."""
    begin, line, depth, lines = 0, 1, 0, 1
    for token in _TOKEN.finditer(f"{text}\n"):
        mark = token[0]
        if mark in "[{":
            depth += 1
        elif mark in "]}":
            depth -= 1
        elif mark != "\n":
            lines += mark.count("\n")
        else:
            lines += 1
            if depth == 0:
                statement = text[begin : token.start()].strip()
                if statement and not statement.startswith("#"):
                    yield line, statement
                begin, line = token.end(), lines


def _paths(parsed: Any, before: Sequence[str] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the names that lead to each value and table, as deep as these may stand in one another."""
    if len(before) > MOST_TABLES:
        return
    if isinstance(parsed, list):  # of a heading in double brackets
        for one in parsed:
            yield from _paths(one, before)
    elif isinstance(parsed, dict):
        for name, value in parsed.items():
            yield (*before, name)
            yield from _paths(value, (*before, name))
