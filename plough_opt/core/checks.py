"""Checks of arguments before anything is computed from them: type, and for numbers the domain.

A symbol has no value to check. Labels in CasADi graphs therefore tell a design which limits the values in a graph have:
a label is a call node that returns its first argument unchanged, its second argument carries further expressions, and
its meaning says what they are for.
"""

import math
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import wraps
from numbers import Integral
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import Any, Final, ParamSpec, TypeAlias, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError, InputError, listed, nearest, unprintable
from plough_opt.core.errors import shown as shown
from plough_opt.core.expressions import (
    Expression,
    as_number,
    holds_casadi,
    holds_several,
    is_casadi,
    is_symbolic,
    key_of,
    map_expressions,
    template_of,
)

NOT_NUMBERS: Final = (TypeError, ValueError, OverflowError, RuntimeError)
"""Errors raised by ``float`` and NumPy for a value that is not a number; CasADi raises RuntimeError."""

LARGEST: Final = 1e60
"""Largest magnitude of a number in SI units: fourth powers and products of several numbers do not overflow."""

LEAST: Final = 1.0 / LARGEST
"""Smallest magnitude of a number whose powers are denominators, which must not underflow."""

INSIDE: Final = 1e-9
"""Part of a limit by which designs stay inside it: more than the 1e-10 by which the optimiser may exceed a limit."""

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")

_OVERFLOW = "beyond that, products of quantities overflow or underflow: check its unit"

# NumPy types with fewer bytes have only three digits, or overflow when squared.
_LEAST_BYTES = 4


def array_of(
    values: Any, refusal: str, valid: Callable[[NDArray[np.float64]], object] = lambda _: True
) -> NDArray[np.float64]:
    """Return a copy of values as an array of floats.

    Args:
        values: any.
        refusal: message for values that are refused, with {} for the values, which are printed only then.
        valid: whether an array is accepted; default: any.

    Raises:
        InputError: the values are not numbers, or not valid.
    """
    array = None
    with suppress(*NOT_NUMBERS):
        array = np.array(values, dtype=float)
    if array is None or not valid(array):
        raise InputError(refusal.replace("{}", shown(values)))
    return array


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
        raise InputError(f"{what} = {shown(value)} must be {listed([*map(repr, choices)], 'or')}{more}")


def check_named(refusal: str, name: object, valid: Iterable[str]) -> None:
    """Raise InputError if a name is not valid; the message suggests the nearest valid one.

    Args:
        refusal: the message, with {} for the name: "no loss is named {}".
        name: any.
        valid: the valid names.
    """
    names = tuple(valid)
    if not (isinstance(name, str) and name in names):
        word = name if isinstance(name, str) else shown(name)
        raise InputError(f"{refusal.replace('{}', shown(name))}: {nearest(word, names)}")


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
    """The limits of a named value: those of `check_domain`, which describes the attributes, and the law's name."""

    name: str
    unit: str = ""
    above: float = -np.inf
    below: float = np.inf
    at_least: float = -np.inf
    at_most: float = np.inf
    why: str = ""
    inside: float = INSIDE
    law: str = ""

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
        _check_number(self.name, value, self.unit)
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

_RECORD: ContextVar[Recorded | None] = ContextVar("record", default=None)


@contextmanager
def recorded_limits() -> Iterator[Recorded]:
    """Return a context whose value collects the limits that `check_domain` meets in it; it raises no error then."""
    record: Recorded = []
    token = _RECORD.set(record)
    try:
        yield record
    finally:
        _RECORD.reset(token)


def limits_of_law(label: str, law: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Return a function whose recorded limits carry the name of a law; within it, those of another law keep theirs."""

    @wraps(law)
    def named(*arguments: _Given.args, **more: _Given.kwargs) -> _Result:
        if (record := _RECORD.get()) is None:
            return law(*arguments, **more)
        start = len(record)
        result = law(*arguments, **more)
        record[start:] = [(limit if limit.law else replace(limit, law=label), x) for limit, x in record[start:]]
        return result

    return named


def declared(record: Recorded) -> Recorded:
    """Return the limits that laws declare on single values, with the name of the law before that of the value."""
    # Columns are points at which a law is evaluated, such as nodes of a quadrature.
    return [
        (replace(limit, name=f"{limit.law}: {limit.name}"), value)
        for limit, value in record
        if limit.law and limit.kept != (None, None) and (not hasattr(value, "shape") or math.prod(value.shape) == 1)
    ]


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
    A symbol passes; if the call is part of a resistance law, a design keeps its limits: see `Scene.limits`. Numbers
    larger than `LARGEST` are outside every domain.

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
    record = _RECORD.get()
    if record is None and type(value) in _FLOATS and above < value < below and at_least <= value <= at_most:
        return value
    if record is None and is_symbolic(value):
        return value
    limit = DomainLimit(name, unit, above, below, at_least, at_most, why, inside)
    if record is not None:
        record.append((limit, value))
        return value
    limit.check(value)
    if is_casadi(value) or isinstance(value, np.float64 | np.longdouble):
        return value
    return value.astype(np.result_type(value, float), copy=False) if isinstance(value, np.ndarray) else float(value)


def _check_number(name: str, value: Expression, unit: str) -> None:
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


def plain_number(what: str, value: Any, unit: str = "", **limits: Any) -> float:
    """Return a number as a float.

    Args:
        what: name of the value, for the user.
        value: a number, or a 0-d array or CasADi matrix with one element; not a string, bool or symbol.
        unit: unit of the value and of the limits.
        limits: those of `check_domain`, with their reason.

    Raises:
        InputError: the value is not a finite number, outside its limits, or larger than `LARGEST` in magnitude.
    """
    try:
        if isinstance(value, str | bytes | bool | np.bool_) or (isinstance(value, np.ndarray) and value.ndim > 0):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, RuntimeError):  # CasADi raises the last for a column or a symbol
        text = f"{what}: {shown(value)} is not a number (in SI units; po.deg converts degrees)"
        raise InputError(text) from None
    except OverflowError:
        raise InputError(f"{what}: {shown(value)} must be at most {LARGEST:g} in magnitude: check its unit") from None
    if limits or not abs(number) <= LARGEST:
        try:
            DomainLimit(what, unit, **({"at_least": -LARGEST, "at_most": LARGEST} | limits)).check(number)
        except DomainError as error:
            raise InputError(str(error)) from None
    return number


def bound_of(what: str, value: Any) -> float:
    """Return a bound as a float, which may be infinite; raise InputError if it is no number."""
    return float(value) if isinstance(value, float | np.floating) and np.isinf(value) else plain_number(what, value)


def pair_of(what: str, value: Any) -> tuple[float, float]:
    """Return the ends of a range, either of which may be infinite.

    Raises:
        InputError: the value is not a pair of numbers, or the first is not below the second.
    """
    ends = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(ends, list | tuple) or len(ends) != 2:
        raise InputError(f"{what} = {shown(value)} must be a pair of numbers, such as (0.0, 0.5)")
    low, high = (bound_of(what, end) for end in ends)
    check_bounds(what, low, high)
    return low, high


def check_bounds(
    what: str,
    lower: float,
    upper: float,
    guess: float | None = None,
    *,
    log: bool = False,
    show: Callable[[float], str] = "{:g}".format,
) -> None:
    """Raise InputError if bounds contradict each other, a guess or a logarithmic scale.

    Args:
        what: name of the bounded quantity, for the user.
        lower: lower bound.
        upper: upper bound.
        guess: a value that must lie between them, if any.
        log: whether the scale is logarithmic, so that the bounds must be above 0.
        show: function that returns a number as text, with its unit.
    """
    if not lower < upper:
        equal = "; to fix a quantity, use the number itself" * (lower == upper and guess is not None)
        ends = f"lower {show(lower)} is not below upper {show(upper)}{equal}"
        raise InputError(f"{what}: its bounds contradict each other: {ends}")
    if log and lower <= 0.0:
        raise InputError(f"{what}: a logarithmic scale needs a lower bound above 0, not {show(lower)}")
    if guess is not None and not lower <= guess <= upper:
        raise InputError(f"{what}: its guess {show(guess)} lies outside its bounds {show(lower)} to {show(upper)}")


def check_limits(
    what: str, at_least: float | None, at_most: float | None, show: Callable[[float], str] = "{:g}".format
) -> None:
    """Raise InputError if there is no limit, or if the lower one is above the upper one.

    Args:
        what: name of the limited quantity, for the user.
        at_least: lower limit, or None.
        at_most: upper limit, or None.
        show: function that returns a number as text, with its unit.
    """
    if at_least is None and at_most is None:
        raise InputError(f"{what} has no limit: give at_least, at_most or both")
    if at_least is not None and at_most is not None and at_least > at_most:
        ends = f"at least {show(at_least)} is above at most {show(at_most)}"
        raise InputError(f"{what}: its limits contradict each other: {ends}")


def whole_number(what: str, value: Any, least: int = 0, most: float = math.inf) -> int:
    """Return an integer, also one of NumPy, as an int; raise InputError for another value or one beyond its limits."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= most:
        ends = f"of at least {least}" if math.isinf(most) else f"from {least} to {most}"
        raise InputError(f"{what} = {shown(value)} must be a whole number {ends}")
    return int(value)


def check_text(what: str, value: Any, *, blank: bool = True) -> None:
    """Raise InputError if a value is not a string of printable characters, or if it is blank where it may not be."""
    if not isinstance(value, str) or unprintable(value, allowed="") or not (blank or value.strip()):
        more = "" if blank else ", and not blank"
        raise InputError(f"{what} = {shown(value)} must be a string of printable characters{more}")


def check_single(what: str, values: Any) -> None:
    """Raise InputError if any value is an array or a column; for functions that accept scalars only.

    Args:
        what: name of that function, for the user.
        values: numbers and expressions, alone or nested in dataclasses, lists, tuples and dictionaries.
    """
    if holds_several(values):
        raise InputError(f"{what} accepts one number per quantity, not arrays: call it once per element")


# Functions kept alive for reuse even if no graph calls them any more; enough for several designs.
_MOST_RECENT: Final = 64


@dataclass(frozen=True)
class Call:
    """A meaning: the labelled value was returned by a law, and the carried expressions are its arguments' quantities.

    Attributes:
        law: the function.
        template: its positional and named arguments, with a placeholder for each quantity in them.
        limited: whether designs keep the limits that it declares, so that bounds may lie outside them.
    """

    law: Callable[..., object]
    template: tuple[tuple[Any, ...], dict[str, Any]]
    limited: bool = False

    def run(self, arguments: tuple[tuple[Any, ...], dict[str, Any]]) -> object:
        """Return what the law returns for arguments like those of the template."""
        return self.law(*arguments[0], **arguments[1])


_lock = threading.RLock()
# Address of a labelled or embedded Function -> the Function, as long as a graph calls it, and its meaning.
_meanings: dict[int, tuple[ca.WeakRef, Any]] = {}
_recent: dict[Hashable, ca.Function] = {}


def shared(key: Hashable, make: Callable[[], tuple[ca.Function, object]]) -> ca.Function:
    """Return the Function of a key, or make it together with its meaning, which lives as long as the Function."""
    with _lock:
        function = _recent.pop(key, None)
        if function is None:
            function, meaning = make()
            _meanings[hash(function)] = ca.WeakRef(function), meaning
        _recent[key] = function  # as the last one
        if len(_recent) > _MOST_RECENT:
            del _recent[next(iter(_recent))]
            for at in [at for at, (reference, _) in _meanings.items() if not reference.alive()]:
                del _meanings[at]
        return function


def meaning_of(function: ca.Function) -> Any:
    """Return the meaning of a Function in a graph; None if it has none."""
    reference, meaning = _meanings.get(hash(function), (None, None))
    # The hash is an address in memory, which another Function may have taken over.
    return meaning if reference is not None and reference.alive() else None


def attach(value: Expression, carried: Expression, meaning: object, key: Hashable) -> Expression:
    """Return a value with a label if it and the carried expressions depend on MX symbols, else unchanged.

    Args:
        value: value to label.
        carried: a column of expressions.
        meaning: meaning of the carried expressions.
        key: identifies the meaning; labels with equal keys share one Function.
    """
    if not (isinstance(value, ca.MX) and isinstance(carried, ca.MX) and is_symbolic(carried)):
        return value
    layout = ("label", key, value.shape, carried.numel())

    def make() -> tuple[ca.Function, object]:
        x, c = ca.MX.sym("x", *value.shape), ca.MX.sym("c", carried.numel())
        names = ["value", "carried"], ["value_again"]
        return ca.Function("label", [x, c], [x], *names, {"never_inline": True}), meaning

    return shared(layout, make)(ca.densify(value), carried)


def without_labels(expressions: list[ca.MX], labels: list[ca.MX]) -> list[ca.MX]:
    """Return expressions with every label replaced by its value, which makes them faster to evaluate.

    Args:
        expressions: expressions of one graph.
        labels: calls of labels in it, inner ones first, as `labels_in` returns them.
    """
    old: list[ca.MX] = []
    new: list[ca.MX] = []
    for node in labels:
        value = node.dep(0)
        new.append(ca.graph_substitute([value], old, new)[0] if old else value)
        old.append(node.get_output(0))
    return list(ca.graph_substitute(expressions, old, new))


def labels_in(function: ca.Function) -> list[ca.MX]:
    """Return the calls of labels in a Function's MX graph, inner ones first."""
    places = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL]
    calls = {hash(node): node for node in map(function.instruction_MX, places)}
    functions = [(node, node.which_function()) for node in calls.values()]
    return [node for node, of in functions if of.name() == "label" and meaning_of(of) is not None]


# Whether the current computation is part of a law that is labelled as a whole.
_INSIDE: ContextVar[bool] = ContextVar("inside", default=False)


class unlabelled:  # noqa: N801 (a context, entered too often for a generator)
    """Return laws' values without labels inside this context, because the calling law is labelled itself."""

    def __enter__(self) -> None:
        self._before = _INSIDE.set(True)

    def __exit__(self, *error: object) -> None:
        _INSIDE.reset(self._before)


def checked_in_designs(
    law: Callable[_Given, _Result], check: Callable[_Given, object] | None = None, *, limited: bool = False
) -> Callable[_Given, _Result]:
    """Decorate a law so that a design can check whether its bounds lie inside the law's domain.

    The law itself checks numbers. If its arguments hold symbols, the result is labelled with the call, and a design
    repeats the call with the numbers at its bounds.

    Args:
        law: the function.
        check: function called with the bounds in place of the law.
        limited: as in `Call`.
    """

    @wraps(law)
    def labelled(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        if _INSIDE.get():
            return law(*arguments, **named)
        with unlabelled():
            result = law(*arguments, **named)
        if not holds_casadi(result):
            return result
        with recorded_limits():  # limits of placeholders mean nothing
            template, quantities = template_of((arguments, named))
        carried = ca.vertcat(*quantities)
        # An array has one placeholder for all its elements; CasADi constants need no label.
        several = not isinstance(carried, ca.MX) or carried.numel() != len(quantities)
        if several or not any(map(is_symbolic, quantities)):
            return result
        key = law.__module__, law.__qualname__, key_of(template)
        meaning = Call(check or law, template, limited)
        checked: _Result = map_expressions(result, lambda value: attach(value, carried, meaning, key))
        return checked

    return labelled


def limited_in_designs(label: str) -> Callable[[Callable[_Given, _Result]], Callable[_Given, _Result]]:
    """Return a decorator of a law, with which a design keeps the limits that `check_domain` meets in it.

    Each limit becomes a requirement of the design. A limit on a symbol by itself does not: the bounds of that variable
    must keep it.

    Args:
        label: name of the law in the requirements' names.
    """
    return lambda law: checked_in_designs(limits_of_law(label, law), limited=True)
