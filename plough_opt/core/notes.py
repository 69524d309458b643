"""Notes that differ only in their numbers: one note for all of them, with the range of each number."""

import re
from typing import Final

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


def _merged(one: str, other: str) -> str:
    numbers = (part[0] for part in _PART.finditer(other) if not part[1])
    return _PART.sub(lambda part: part[1] or _range(f"{part[0]} to {next(numbers)}"), one)


def _range(ends: str) -> str:
    """Return the range of several numbers, as they are written, from the least to the largest."""
    low, *_, high = sorted(ends.split(" to "), key=lambda end: (float(end), len(end)))
    return low if float(low) == float(high) else f"{low} to {high}"
