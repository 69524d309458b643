"""The toolkit's errors, all subclasses of `PloughError`, and the words of messages and notes."""

import difflib
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final, TypeAlias

# Most characters of a name that are compared with valid ones, because the time grows with the square of the length.
_LONGEST_NAME: Final = 100
# Least similarity, by difflib, of a name that is suggested.
_SIMILAR: Final = 0.55
# Categories of Unicode: control, format (such as the order of writing), surrogate, line and paragraph separator.
_ODD: Final = ("Cc", "Cf", "Cs", "Zl", "Zp")
# Format characters that spelling needs: a hyphen where a word may be broken, and two joiners of letters.
_JOINERS: Final = "\u00ad\u200c\u200d"


class PloughError(Exception):
    """Base class of every error that the toolkit raises on purpose.

    Example:
        >>> import plough_opt as po
        >>> issubclass(po.InputError, po.PloughError)
        True
    """

    def __str__(self) -> str:
        """Return the message, without the further arguments of a subclass, as text that a terminal can show."""
        return printable(str(self.args[0])) if self.args else ""


class DomainError(PloughError, ValueError):
    """A value lies outside the domain in which the model's equations hold.

    Example:
        >>> import plough_opt as po
        >>> try:
        ...     po.Cone("10 deg", -1.0)
        ... except po.DomainError as error:
        ...     print(error)
        share height = -1 m must be above 0 m
    """


class ImplausibleValue(UserWarning):
    """A plain number is valid but so unusual in SI units that another unit was probably meant.

    Example:
        >>> import plough_opt as po
        >>> po.StrengthWave(0.3, "200 m").wavelength  # the number 200.0, without a unit, would cause the warning
        200.0
        >>> issubclass(po.ImplausibleValue, UserWarning)
        True
    """


class InputError(PloughError, ValueError):
    """An option, a name or a file is invalid.

    Example:
        >>> import plough_opt as po
        >>> try:
        ...     po.named_soil("serozen")
        ... except po.InputError as error:
        ...     print("did you mean 'serozem'" in str(error))
        True
    """


@contextmanager
def about(what: str, kind: type[PloughError] = InputError) -> Iterator[None]:
    """Put what an error is about in front of the message of any InputError that is raised inside.

    Args:
        what: the first words of the message, such as "'lower'".
        kind: errors that are meant, if others than InputErrors; they become InputErrors.
    """
    try:
        yield
    except kind as error:
        raise InputError(f"{what} {error}") from None


class IntegrationError(PloughError, RuntimeError):
    """The equation of motion could not be integrated; the message gives scene, time and likely cause.

    Example:
        >>> import plough_opt as po
        >>> issubclass(po.IntegrationError, po.PloughError)
        True
    """


class InfeasibleDesign(PloughError, RuntimeError):
    """No design meets all requirements; ``conflicts`` maps each unmet requirement to its shortfall.

    Attributes:
        conflicts: name of the requirement -> smallest possible violation, in the requirement's own unit.
        blockers: names of the requirements and bounds that conflict with them.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.require("more than there is", height, at_least="2 m")
        >>> design.minimise(height)
        >>> try:
        ...     best = design.solve()
        ... except po.InfeasibleDesign as error:
        ...     print("more than there is" in str(error))
        True
    """

    def __init__(self, message: str, conflicts: dict[str, float], blockers: list[str]) -> None:
        # Exceptions are pickled by these arguments, for instance when a worker process returns one.
        super().__init__(message, conflicts, blockers)
        self.conflicts = conflicts
        self.blockers = blockers


class NotConverged(PloughError, RuntimeError):
    """The optimiser stopped before it reached an optimum; ``status`` is IPOPT's return status.

    Example:
        >>> import plough_opt as po
        >>> issubclass(po.NotConverged, po.PloughError)
        True
    """

    def __init__(self, message: str, status: str) -> None:
        super().__init__(message, status)
        self.status = status


def shown(value: object, most: int = 60) -> str:
    """Return any value as text for messages: one line without control characters, truncated if long."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers of several thousand digits
        text = f"{type(value).__name__} of very many digits"
    return short(" ".join(text.split()), most)


def short(text: str, most: int = 60) -> str:
    """Return a text for quotation in messages, truncated if long."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def unprintable(text: str, *, allowed: str = "\t\n") -> str | None:
    """Return the first character of a text that files and terminals cannot show, such as "U+001B", or None.

    Control characters (some are terminal commands), separators of lines, characters that change the order of others or
    nothing visible, lone surrogates (which cannot be encoded) and code points that are not characters cannot be shown.

    Args:
        text: user's text.
        allowed: control characters that it may contain.
    """
    for character in text:
        code = ord(character)
        odd = unicodedata.category(character) in _ODD or code & 0xFFFE == 0xFFFE
        if odd and character not in allowed and character not in _JOINERS:
            return f"U+{code:04X}"
    return None


def printable(text: str) -> str:
    """Return a text whose characters that a terminal would obey or hide are escaped as in Python.

    Everything that the toolkit prints passes here: pages, tables, messages and errors.
    """
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() or not unprintable(character) else repr(character)[1:-1]
        for character in text
    )


def nearest(name: str, valid: Iterable[str], fitting: Iterable[str] = ()) -> str:
    """Return a clause that suggests the nearest valid names.

    Args:
        name: as written.
        valid: all valid names; a dotted one is near if its last part is.
        fitting: the names to suggest if none is near (default: all valid ones).
    """
    names, name, rest = sorted(valid), str(name)[:_LONGEST_NAME], sorted(fitting)
    close = difflib.get_close_matches(name, names, n=2, cutoff=_SIMILAR)
    if not close:
        last = {full.rpartition(".")[2]: full for full in reversed(names) if "." in full}
        close = [last[part] for part in difflib.get_close_matches(name, last, n=2, cutoff=_SIMILAR)]
    if close or len(rest) == 1:
        return f"did you mean {' or '.join(map(repr, close or rest))}?"
    return f"valid names: {', '.join(rest or names)}" if names else "there are none"


Counted: TypeAlias = dict[str, tuple[str, int, int]]
"""Kind of note -> (text with the ranges of its numbers, number of the first point that has it, number of points)."""

# Atomic, so that no part of "12.5m" or "1,000" counts as a number.
_NUMBER: Final = r"(?<![\w.,])(?>[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?!\w|,\d)"
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


def listed(words: Sequence[str], by: str = "and") -> str:
    """Return words as "a", "a and b" or "a, b and c"."""
    return f" {by} ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _merged(note: str, other: str) -> str:
    numbers = (part[0] for part in _PART.finditer(other) if not part[1])
    return _PART.sub(lambda part: part[1] or _range(f"{part[0]} to {next(numbers)}"), note)


def _range(ends: str) -> str:
    """Return the range of several numbers, as they are written, from the least to the largest."""
    low, *_, high = sorted(ends.split(" to "), key=lambda end: (float(end), len(end)))
    return low if float(low) == float(high) else f"{low} to {high}"
