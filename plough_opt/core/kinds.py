"""Refusal of arguments of another kind than a function takes: by name, before anything is computed from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import Any

import numpy as np

from plough_opt.core.errors import InputError, nearest, short


def shown(value: object, most: int = 60) -> str:
    """Return what messages show of any value: one line without control characters, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than some thousand digits
        text = f"{type(value).__name__} of very many digits"
    return short(" ".join(text.split()), most)


def check_kind(what: str, value: object, kind: type | UnionType, wanted: str) -> None:
    """Refuse another type.

    Args:
        what: what the value is, as the user calls it.
        value: any.
        kind: the type it must have, or a union of them.
        wanted: that type in words, with its article: "a Soil, for instance named_soil('serozem')".

    Raises:
        InputError: as said.
    """
    if not isinstance(value, kind):
        raise InputError(f"{what} = {shown(value)} must be {wanted}")


def check_callable(what: str, value: object, of: str) -> None:
    """Refuse what cannot be called.

    Args:
        what: what the value is, as the user calls it.
        value: any.
        of: what it is called with, and what it returns: "of a soil that returns results by name".

    Raises:
        InputError: as said.
    """
    if not callable(value):
        raise InputError(f"{what} = {shown(value)} must be a function {of}")


def check_switch(what: str, value: object) -> None:
    """Refuse what is neither True nor False, of Python or NumPy.

    Raises:
        InputError: as said.
    """
    check_kind(what, value, bool | np.bool_, "True or False")


def check_choice(what: str, value: object, choices: Sequence[str | None], more: str = "") -> None:
    """Refuse what is none of a few words.

    Args:
        what: what the value is, as the user calls it.
        value: any.
        choices: the words, None among them where that is one.
        more: said after them.

    Raises:
        InputError: as said.
    """
    if not (isinstance(value, str | None) and value in choices):
        *others, last = map(repr, choices)
        raise InputError(f"{what} = {shown(value)} must be {', '.join(others)} or {last}{more}")


def check_named(refusal: str, name: object, valid: Iterable[str]) -> None:
    """Refuse a name that is none of many, with the nearest.

    Args:
        refusal: the message, with {} in the place of the name: "no loss is named {}".
        name: any.
        valid: the names that there are.

    Raises:
        InputError: as said.
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
        InputError: neither text nor a path, or one that no file can have.
    """
    if isinstance(value, str | PathLike) and "\0" not in str(value):
        return Path(value)
    raise InputError(f"{what} {shown(value)} must be a path: a text, or a pathlib.Path")
