"""Refusal of numbers outside the domain in which the equations hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from plough_opt.core.errors import DomainError, InputError, unprintable
from plough_opt.core.expressions import Expression, as_number, holds_several, is_casadi, is_symbolic
from plough_opt.core.kinds import shown

# Numbers of fewer bytes overflow, or have three digits.
_LEAST_BYTES = 4


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
    """Refuse a number outside its domain; a symbol passes, its number is checked when it has one.

    Args:
        name: what the value is, as the user calls it.
        value: number, array or CasADi expression.
        unit: unit of the value and of the limits.
        above: value must be strictly larger.
        below: value must be strictly smaller.
        at_least: value must not be smaller.
        at_most: value must not be larger.
        why: where the limit comes from or what to do, added to the message.

    Raises:
        DomainError: not a number, or one that is not finite or lies outside; the message gives name, value
            and limit.
    """
    if isinstance(value, float) and math.isfinite(value) and above < value < below and at_least <= value <= at_most:
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
        # An absent limit is infinite: only the rule of finiteness can then fail.
        if not np.all(holds):
            bad = numbers[~holds][0]
            # A number beside its limit would read as the limit itself with six digits.
            digits = 6 if limit is None or f"{bad:.6g}" != f"{limit:.6g}" else 17
            bound = "" if limit is None else f" {limit:.{digits}g}{suffix}"
            reason = f": {why}" if why else ""
            raise DomainError(f"{name} = {bad:.{digits}g}{suffix} must be {relation}{bound}{reason}")


def _check_kind(name: str, value: Expression, unit: str) -> None:
    """Refuse what is no number, or one of a type in which squares and cubes overflow.

    Raises:
        DomainError: text, a list, a switch, or numbers of one or two bytes.
    """
    if is_casadi(value):
        return
    if isinstance(value, list | tuple):
        raise DomainError(f"{name} = {shown(value)} must be a number or a NumPy array of them, in {unit or 'no unit'}")
    kind = np.asarray(value).dtype
    if kind.kind not in "iuf":
        raise DomainError(f"{name} = {shown(value)} must be a number, in {unit or 'no unit'}")
    if kind.itemsize < _LEAST_BYTES:
        raise DomainError(f"{name} is of type {kind}, in which squares and cubes overflow: give it as float")


def plain_number(what: str, value: Any) -> float:
    """Return a number as a float.

    Args:
        what: what the value is, as the user calls it.
        value: a number, an array or CasADi matrix of one, and no text, switch or expression.

    Raises:
        InputError: not a number, or one that is not finite.
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
    return number


def check_text(what: str, value: Any) -> None:
    """Refuse what is no text, or holds characters that cannot be printed.

    Raises:
        InputError: as said.
    """
    if not isinstance(value, str) or unprintable(value, allowed=""):
        raise InputError(f"{what} = {shown(value)} must be a text that can be printed")


def check_single(what: str, values: Any) -> None:
    """Refuse arrays, and columns of symbols, where formulas hold for one number at a time.

    Args:
        what: what takes them, as the user calls it.
        values: numbers and expressions, alone or nested in dataclasses, lists, tuples and dictionaries.

    Raises:
        InputError: one of them has not exactly one element.
    """
    if holds_several(values):
        raise InputError(
            f"{what} takes one number for each quantity and no arrays: call it once for each, or build it of CasADi"
            " symbols and map the casadi.Function"
        )
