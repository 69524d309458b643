"""Checks of arguments before anything is computed from them: type, and for numbers the domain."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from numbers import Integral
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError, InputError, nearest, unprintable
from plough_opt.core.errors import shown as shown
from plough_opt.core.expressions import Expression, as_number, holds_several, is_casadi, is_symbolic

NOT_NUMBERS: Final = (TypeError, ValueError, OverflowError, RuntimeError)
"""Errors raised by ``float`` and NumPy for a value that is not a number; CasADi raises RuntimeError."""

LARGEST: Final = 1e60
"""Largest magnitude of a number in SI units: fourth powers and products of several numbers do not overflow."""

LEAST: Final = 1.0 / LARGEST
"""Smallest magnitude of a number whose powers are denominators, which must not underflow."""

INSIDE: Final = 1e-9
"""Part of a limit by which designs stay inside it: more than the 1e-10 by which the optimiser may exceed a limit."""

_OVERFLOW = "beyond that, products of quantities overflow or underflow: check its unit"

# NumPy types with fewer bytes have only three digits, or overflow when squared.
_LEAST_BYTES = 4


def array_of(values: Any, refusal: str) -> NDArray[np.float64]:
    """Return a copy of values as an array of floats.

    Args:
        values: any.
        refusal: message for values that are not numbers, with {} for the values, which are printed only then.

    Raises:
        InputError: the values are not numbers.
    """
    try:
        return np.array(values, dtype=float)
    except NOT_NUMBERS:
        raise InputError(refusal.replace("{}", shown(values))) from None


def check_kind(what: str, value: object, kind: type | UnionType, wanted: str) -> None:
    """Raise InputError if a value has the wrong type.

    Args:
        what: name of the value, for the user.
        value: any.
        kind: the required type, or a union of types.
        wanted: that type in words, with its article: "a Soil, for instance named_soil('serozem')".
    """
    if not isinstance(value, kind):
        raise InputError(f"{what} = {shown(value)} must be {wanted}")


def check_callable(what: str, value: object, of: str) -> None:
    """Raise InputError if a value is not callable.

    Args:
        what: name of the value, for the user.
        value: any.
        of: its arguments and result in words: "of a soil that returns results by name".
    """
    if not callable(value):
        raise InputError(f"{what} = {shown(value)} must be a function {of}")


def check_switch(what: str, value: object) -> None:
    """Raise InputError if a value is not a bool of Python or NumPy."""
    check_kind(what, value, bool | np.bool_, "True or False")


def check_choice(what: str, value: object, choices: Sequence[str | None], more: str = "") -> None:
    """Raise InputError if a value is not one of a few options.

    Args:
        what: name of the value, for the user.
        value: any.
        choices: the valid words; None may be one of them.
        more: text appended to the message.
    """
    if not (isinstance(value, str | None) and value in choices):
        *others, last = map(repr, choices)
        raise InputError(f"{what} = {shown(value)} must be {', '.join(others)} or {last}{more}")


def check_named(refusal: str, name: object, valid: Iterable[str]) -> None:
    """Raise InputError if a name is not valid; the message suggests the nearest valid one.

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
    """Return a mapping as it is, and an empty one for None.

    Raises:
        InputError: the value has another type.
    """
    if value is None:
        return {}
    check_kind(what, value, Mapping, f"a dictionary: {wanted}")
    return value


def path_of(what: str, value: object) -> Path:
    """Return a path.

    Raises:
        InputError: the value is neither a string nor a path, or contains a null character.
    """
    if isinstance(value, str | PathLike) and "\0" not in str(value):
        return Path(value)
    raise InputError(f"{what} {shown(value)} must be a path: a string or a pathlib.Path")


@dataclass(frozen=True)
class DomainLimit:
    """The limits of a named value: those of `check_domain`, which describes the attributes."""

    name: str
    unit: str = ""
    above: float = -np.inf
    below: float = np.inf
    at_least: float = -np.inf
    at_most: float = np.inf
    why: str = ""
    inside: float = INSIDE

    @property
    def kept(self) -> tuple[float | None, float | None]:
        """Smallest and largest value in a design, None without a limit; a limit of 0 itself stays 0."""
        low, high = max(self.above, self.at_least), min(self.below, self.at_most)
        if abs(low) <= LEAST:  # a limit only against underflow is that of 0
            low = 0.0
        least = None if low <= -LARGEST else low + self.inside * abs(low)
        return least, None if high >= LARGEST else high - self.inside * abs(high)

    def holds(self, values: Expression) -> NDArray[np.bool_]:
        """Return for each number whether it lies inside the limits; NaN does not."""
        numbers = as_number(values)
        inside: NDArray[np.bool_] = (
            (numbers > self.above) & (numbers < self.below) & (numbers >= self.at_least) & (numbers <= self.at_most)
        )
        return inside

    def check(self, value: Expression) -> None:
        """Raise DomainError if a number, or one of an array, lies outside."""
        _check_kind(self.name, value, self.unit)
        numbers = np.atleast_1d(as_number(value))
        rules = [
            (np.isfinite(numbers), "finite", None),
            (numbers > self.above, "above", self.above),
            (numbers < self.below, "below", self.below),
            (numbers >= self.at_least, "at least", self.at_least),
            (numbers <= self.at_most, "at most", self.at_most),
        ]
        suffix = f" {self.unit}" if self.unit else ""
        for holds, relation, limit in rules:
            # A missing limit is infinite: only the first rule can then fail.
            if not np.all(holds):
                bad = numbers[~holds][0]
                # With six digits a number close to its limit would look like the limit itself.
                digits = 6 if limit is None or f"{bad:.6g}" != f"{limit:.6g}" else 17
                bound = "" if limit is None else f" {limit:.{digits}g}{suffix}"
                extreme = limit in (LEAST, LARGEST, -LARGEST)
                why = _OVERFLOW if extreme else self.why
                reason = f": {why}" if why else ""
                raise DomainError(f"{self.name} = {bad:.{digits}g}{suffix} must be {relation}{bound}{reason}")


Recorded: TypeAlias = list[tuple[DomainLimit, Any]]
"""Limits, each with the value that it limits."""

# What `check_domain` returns as it is.
_FLOATS: Final = (float, np.float64)

_OF_SYMBOLS: ContextVar[Recorded | None] = ContextVar("of_symbols", default=None)
_OF_NUMBERS: ContextVar[Recorded | None] = ContextVar("of_numbers", default=None)


@contextmanager
def _recorded(record: ContextVar[Recorded | None]) -> Iterator[Recorded]:
    found: Recorded = []
    token = record.set(found)
    try:
        yield found
    finally:
        record.reset(token)


def limits_of_symbols() -> AbstractContextManager[Recorded]:
    """Return a context whose value collects the limits that `check_domain` finds on symbols in it."""
    return _recorded(_OF_SYMBOLS)


def limits_of_numbers() -> AbstractContextManager[Recorded]:
    """Return a context in which `check_domain` collects the limits of numbers and arrays, and raises no error."""
    return _recorded(_OF_NUMBERS)


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
    inside: float = INSIDE,
) -> Any:
    """Return a number as float, an array as array of floats, and a CasADi expression as it is, if inside the domain.

    Formulas use what is returned: integers and short floats would overflow in powers. Longer floats stay as they are.
    A symbol passes; if the call is part of a resistance law, a design keeps its limits: see
    `plough_opt.core.labels.limited_in_designs`. Numbers larger than `LARGEST` are outside every domain.

    Args:
        name: name of the value, for the user.
        value: number, array or CasADi expression.
        unit: unit of the value and of the limits.
        above: exclusive lower limit.
        below: exclusive upper limit.
        at_least: inclusive lower limit.
        at_most: inclusive upper limit.
        why: reason for the limit or what to do, appended to the message.
        inside: part of a limit by which designs stay inside it.

    Raises:
        DomainError: the value is not a finite number or lies outside; the message gives name, value and limit.
    """
    at_least, at_most = max(at_least, -LARGEST), min(at_most, LARGEST)
    if type(value) in _FLOATS and above < value < below and at_least <= value <= at_most:
        return value
    symbolic = is_symbolic(value)
    record = (_OF_SYMBOLS if symbolic else _OF_NUMBERS).get()
    if symbolic and record is None:
        return value
    limit = DomainLimit(name, unit, above, below, at_least, at_most, why, inside)
    if record is not None:
        record.append((limit, value))
        return value
    limit.check(value)
    if is_casadi(value) or isinstance(value, np.float64 | np.longdouble):
        return value
    return value.astype(np.result_type(value, float), copy=False) if isinstance(value, np.ndarray) else float(value)


def _check_kind(name: str, value: Expression, unit: str) -> None:
    """Raise DomainError for anything but real numbers and arrays, and for numbers of one or two bytes.

    A pint quantity or a column of pandas would lose its unit or its index, or return results of its own type.
    """
    if is_casadi(value):
        return
    if not isinstance(value, int | float | np.generic | np.ndarray):
        raise DomainError(f"{name} = {shown(value)} must be a number or a NumPy array, in {unit or 'no unit'}")
    kind = np.asarray(value).dtype
    if kind.kind not in "iuf":
        raise DomainError(f"{name} = {shown(value)} must be a number, in {unit or 'no unit'}")
    if kind.itemsize < _LEAST_BYTES:
        raise DomainError(f"{name} has type {kind}, in which squares and cubes overflow: convert it to float")


def plain_number(what: str, value: Any) -> float:
    """Return a number as a float.

    Args:
        what: name of the value, for the user.
        value: a number, or a 0-d array or CasADi matrix with one element; not a string, bool or symbol.

    Raises:
        InputError: the value is not a finite number, or is larger than `LARGEST` in magnitude.
    """
    try:
        if isinstance(value, str | bytes | bool | np.bool_) or (isinstance(value, np.ndarray) and value.ndim > 0):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, RuntimeError):  # CasADi raises the last for a column or a symbol
        text = f"{what}: {shown(value)} is not a number (in SI units; po.deg converts degrees)"
        raise InputError(text) from None
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{what}: {shown(value)} must be a finite number")
    if abs(number) > LARGEST:
        raise InputError(f"{what}: {shown(value)} must be at most {LARGEST:g} in magnitude: check its unit")
    return number


def whole_number(what: str, value: Any) -> int:
    """Return an integer, also one of NumPy, as an int; raise InputError if it is not a whole number of at least 0."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 0:
        raise InputError(f"{what} = {shown(value)} must be a whole number of at least 0")
    return int(value)


def check_text(what: str, value: Any) -> None:
    """Raise InputError if a value is not a string of printable characters."""
    if not isinstance(value, str) or unprintable(value, allowed=""):
        raise InputError(f"{what} = {shown(value)} must be a string of printable characters")


def check_single(what: str, values: Any) -> None:
    """Raise InputError if any value is an array or a column; for functions that accept scalars only.

    Args:
        what: name of that function, for the user.
        values: numbers and expressions, alone or nested in dataclasses, lists, tuples and dictionaries.
    """
    if holds_several(values):
        raise InputError(
            f"{what} accepts one number per quantity, not arrays: call it once per element, or build a"
            " casadi.Function from it with symbols and map that"
        )
