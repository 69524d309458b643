"""Notes that differ only in their numbers: one note for all of them, with the range of each number, and counted."""

import re
from collections.abc import Iterable, Sequence
from typing import Final, TypeAlias

Counted: TypeAlias = dict[str, tuple[str, int, int]]
"""Kind of note -> (text with the ranges of its numbers, number of the first point that has it, number of points)."""

# Atomic, so that no part of "12.5m", "1,000" or a date counts as a number.
_NUMBER: Final = r"(?<![\w.])(?<!\d[-+,:/])(?>[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?!\w|[-+,.:/]\d)"
# A quoted name, whose digits are not numbers, or else a number or a range of numbers.
_PART: Final = re.compile(rf"((?<!\w)'[^']*'(?!\w))|{_NUMBER}(?: to {_NUMBER})?")


def merge(notes: dict[str, str], text: str) -> str:
    """Add a note to others, merging it with the one that differs only in its numbers; return the kind of note.

    Args:
        notes: kind of note -> note, in which numbers are ranges, such as "38 to 92 %", if they differ.
        text: the note, which may hold ranges too.
    """
    kind = _PART.sub(lambda part: part[1] or "\0", text)
    notes[kind] = _merged(notes[kind], text) if kind in notes else text
    return kind


def count(notes: Counted, texts: Sequence[str], first: int = 0, points: int = 1) -> None:
    """Count notes on a point, or on several points of which the first one is given."""
    merged = {kind: text for kind, (text, _, _) in notes.items()}
    for kind in {merge(merged, text): None for text in texts}:
        _, start, before = notes.get(kind, ("", first, 0))
        notes[kind] = merged[kind], start, before + points


def counted(notes: Iterable[tuple[str, int]], of: int, what: str) -> tuple[str, ...]:
    """Return (text, number of points) as sentences: "at 3 of 40 designs: text", where ``what`` is "designs"."""
    return tuple(f"at {points} of {of} {what}: {text}" for text, points in notes)


def listed(words: Sequence[str]) -> str:
    """Return words as "a", "a and b" or "a, b and c"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _merged(one: str, other: str) -> str:
    numbers = (part[0] for part in _PART.finditer(other) if not part[1])
    return _PART.sub(lambda part: part[1] or _range(f"{part[0]} to {next(numbers)}"), one)


def _range(ends: str) -> str:
    """Return the range of several numbers, as they are written, from the least to the largest."""
    low, *_, high = sorted(ends.split(" to "), key=lambda end: (float(end), len(end)))
    return low if float(low) == float(high) else f"{low} to {high}"
