"""Checks of the types of arguments, before anything is computed from them; messages name the argument."""

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import Any, Final

import numpy as np

from plough_opt.core.errors import InputError, nearest, short

NOT_NUMBERS: Final = (TypeError, ValueError, OverflowError, RuntimeError)
"""Errors of Python, NumPy and CasADi for a value that is not a number; CasADi's is for symbols and columns."""


def shown(value: object, most: int = 60) -> str:
    """Return any value as text for messages: one line without control characters, cut if it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write whole numbers of several thousand digits
        text = f"{type(value).__name__} of very many digits"
    return short(" ".join(text.split()), most)


def check_kind(what: str, value: object, kind: type | UnionType, wanted: str) -> None:
    """Raise InputError for a value of another type.

    Args:
        what: name of the value, for the user.
        value: any.
        kind: the type it must have, or a union of types.
        wanted: that type in words, with its article: "a Soil, for instance named_soil('serozem')".
    """
    if not isinstance(value, kind):
        raise InputError(f"{what} = {shown(value)} must be {wanted}")


def check_callable(what: str, value: object, of: str) -> None:
    """Raise InputError for a value that is not callable.

    Args:
        what: name of the value, for the user.
        value: any.
        of: its arguments and result in words: "of a soil that returns results by name".
    """
    if not callable(value):
        raise InputError(f"{what} = {shown(value)} must be a function {of}")


def check_switch(what: str, value: object) -> None:
    """Raise InputError for a value that is neither True nor False, of Python or NumPy."""
    check_kind(what, value, bool | np.bool_, "True or False")


def check_choice(what: str, value: object, choices: Sequence[str | None], more: str = "") -> None:
    """Raise InputError for a value that is not among a few words.

    Args:
        what: name of the value, for the user.
        value: any.
        choices: the valid words; None may be one of them.
        more: added to the message.
    """
    if not (isinstance(value, str | None) and value in choices):
        *others, last = map(repr, choices)
        raise InputError(f"{what} = {shown(value)} must be {', '.join(others)} or {last}{more}")


def check_named(refusal: str, name: object, valid: Iterable[str]) -> None:
    """Raise InputError for a name that is not valid, with the nearest valid one.

    Args:
        refusal: the message, with {} for the name: "no loss is named {}".
        name: any.
        valid: the valid names.
    """
    names = tuple(valid)
    if not (isinstance(name, str) and name in names):
        raise InputError(
            f"{refusal.format(shown(name))}: {nearest(name if isinstance(name, str) else shown(name), names)}"
        )


def mapping_of(what: str, value: Mapping[Any, Any] | None, wanted: str) -> Mapping[Any, Any]:
    """Return a mapping, empty for None.

    Raises:
        InputError: another type.
    """
    if value is None:
        return {}
    check_kind(what, value, Mapping, f"a dictionary: {wanted}")
    return value


def path_of(what: str, value: object) -> Path:
    """Return a path.

    Raises:
        InputError: neither text nor a path, or one with a null character.
    """
    if isinstance(value, str | PathLike) and "\0" not in str(value):
        return Path(value)
    raise InputError(f"{what} {shown(value)} must be a path: a text, or a pathlib.Path")
