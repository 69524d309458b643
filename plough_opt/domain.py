"""Refusal of numbers outside the domain in which the equations hold."""

from __future__ import annotations

import math

import numpy as np

from plough_opt.errors import DomainError
from plough_opt.expressions import Expression, as_number, is_casadi, is_symbolic


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
    if not is_casadi(value) and np.asarray(value).dtype.kind not in "iuf":
        raise DomainError(f"{name} = {value!r} must be a number, in {unit or 'no unit'}")
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
