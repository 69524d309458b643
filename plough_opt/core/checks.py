"""Checks of arguments before anything is computed from them: their types, and the domain of numbers."""

import math
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import Any, Final

import numpy as np

from plough_opt.core.errors import DomainError, InputError, nearest, short, unprintable
from plough_opt.core.expressions import Expression, as_number, holds_several, is_casadi, is_symbolic

NOT_NUMBERS: Final = (TypeError, ValueError, OverflowError, RuntimeError)
"""Errors of Python, NumPy and CasADi for a value that is not a number; CasADi's is for symbols and columns."""

LARGEST: Final = 1e60
"""Largest size of a number, in SI units: fourth powers and products of several stay within floating point."""

LEAST: Final = 1.0 / LARGEST
"""Least size of a number: its powers are denominators, and must not underflow."""

# Numbers of fewer bytes have three digits, or overflow when squared.
_LEAST_BYTES = 4


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


def check_domain(
    name: str,
    value: Expression,
    unit: str = "",
    *,
    above: float = -np.inf,
    below: float = np.inf,
    at_least: float = -np.inf,
    at_most: float = np.inf,
    why: str = "",
) -> None:
    """Raise DomainError for a number outside its domain; a symbol passes, as its value is checked later.

    Beyond `LARGEST` in size every number is refused.

    Args:
        name: of the value, for the user.
        value: number, array or CasADi expression.
        unit: unit of the value and of the limits.
        above: value must be strictly larger.
        below: value must be strictly smaller.
        at_least: value must not be smaller.
        at_most: value must not be larger.
        why: reason of the limit, or what to do, added to the message.

    Raises:
        DomainError: not a number, or one that is not finite or lies outside; the message gives name, value
            and limit.
    """
    at_least, at_most = max(at_least, -LARGEST), min(at_most, LARGEST)
    if isinstance(value, float) and above < value < below and at_least <= value <= at_most:
        return
    if is_symbolic(value):
        return
    _check_kind(name, value, unit)
    numbers = np.atleast_1d(as_number(value))
    rules = [
        (np.isfinite(numbers), "finite", None),
        (numbers > above, "above", above),
        (numbers < below, "below", below),
        (numbers >= at_least, "at least", at_least),
        (numbers <= at_most, "at most", at_most),
    ]
    suffix = f" {unit}" if unit else ""
    for holds, relation, limit in rules:
        # A missing limit is infinite: only the first rule can then fail.
        if not np.all(holds):
            bad = numbers[~holds][0]
            # With six digits a number close to its limit would look like the limit itself.
            digits = 6 if limit is None or f"{bad:.6g}" != f"{limit:.6g}" else 17
            bound = "" if limit is None else f" {limit:.{digits}g}{suffix}"
            if limit in (LEAST, LARGEST, -LARGEST):
                why = "what is larger or smaller cannot be computed with: check its unit"
            reason = f": {why}" if why else ""
            raise DomainError(f"{name} = {bad:.{digits}g}{suffix} must be {relation}{bound}{reason}")


def _check_kind(name: str, value: Expression, unit: str) -> None:
    """Raise DomainError for text, a list, a switch, or numbers of one or two bytes, whose squares overflow."""
    if is_casadi(value):
        return
    if isinstance(value, list | tuple):
        raise DomainError(f"{name} = {shown(value)} must be a number or a NumPy array, in {unit or 'no unit'}")
    kind = np.asarray(value).dtype
    if kind.kind not in "iuf":
        raise DomainError(f"{name} = {shown(value)} must be a number, in {unit or 'no unit'}")
    if kind.itemsize < _LEAST_BYTES:
        raise DomainError(f"{name} is of type {kind}, in which squares and cubes overflow: give it as float")


def plain_number(what: str, value: Any) -> float:
    """Return a number as a float.

    Args:
        what: name of the value, for the user.
        value: a number, or an array or CasADi matrix with one element; not text, a switch or an expression.

    Raises:
        InputError: not a number, or one that is not finite or beyond `LARGEST` in size.
    """
    try:
        if isinstance(value, str | bytes | bool | np.bool_) or (isinstance(value, np.ndarray) and value.ndim > 0):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, RuntimeError):  # the last is CasADi's of a column or a symbol
        text = f"{what}: {shown(value)} is not a number (in SI units; po.deg converts degrees)"
        raise InputError(text) from None
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{what}: {shown(value)} must be a finite number")
    if abs(number) > LARGEST:
        raise InputError(f"{what}: {shown(value)} must lie within {LARGEST:g} in size: check its unit")
    return number


def check_text(what: str, value: Any) -> None:
    """Raise InputError for anything but text of printable characters."""
    if not isinstance(value, str) or unprintable(value, allowed=""):
        raise InputError(f"{what} = {shown(value)} must be a text that can be printed")


def check_single(what: str, values: Any) -> None:
    """Raise InputError if any value is an array or a column, where formulas hold for one number at a time.

    Args:
        what: the function that takes them, for the user.
        values: numbers and expressions, alone or nested in dataclasses, lists, tuples and dictionaries.
    """
    if holds_several(values):
        raise InputError(
            f"{what} takes one number for each quantity and no arrays: call it once for each, or build it with CasADi"
            " symbols and map the casadi.Function"
        )
