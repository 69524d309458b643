"""Functions of floats, NumPy arrays and CasADi expressions, written to avoid cancellation.

CasADi symbols must never be passed to ``math.*`` or ``np.*``, because ``math.sin`` of a symbol silently returns NaN.
Every formula of the toolkit therefore uses the functions of this file. It also compares and copies objects that hold
expressions, and keeps with them what follows from them.
"""

import dataclasses
import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, wraps
from typing import Annotated, Any, Protocol, TypeAlias, TypeVar, overload

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, short
from plough_opt.core.plain_data import NUMBERS


class _Expression(Protocol):
    """The operators that floats, NumPy arrays and CasADi ``SX``, ``MX`` and ``DM`` share."""

    def __add__(self, other: Any, /) -> "Expression": ...
    def __radd__(self, other: Any, /) -> "Expression": ...
    def __sub__(self, other: Any, /) -> "Expression": ...
    def __rsub__(self, other: Any, /) -> "Expression": ...
    def __mul__(self, other: Any, /) -> "Expression": ...
    def __rmul__(self, other: Any, /) -> "Expression": ...
    def __truediv__(self, other: Any, /) -> "Expression": ...
    def __rtruediv__(self, other: Any, /) -> "Expression": ...
    def __pow__(self, other: Any, /) -> "Expression": ...
    def __neg__(self) -> "Expression": ...
    def __abs__(self) -> "Expression": ...
    def __lt__(self, other: Any, /) -> "Expression": ...
    def __le__(self, other: Any, /) -> "Expression": ...
    def __gt__(self, other: Any, /) -> "Expression": ...
    def __ge__(self, other: Any, /) -> "Expression": ...
    def __float__(self) -> float: ...


Expression: TypeAlias = Annotated[_Expression, NUMBERS]
"""A float, a NumPy array, or a CasADi ``SX``, ``MX`` or ``DM``; every physical function accepts any of them."""

Column: TypeAlias = Annotated[Any, NUMBERS]
"""Column of values, a NumPy array or a CasADi matrix; it is ``Any`` because the two share too few signatures."""


class Elementary(Protocol):
    """An elementwise function of one variable: a number gives a number, an array an array."""

    @overload
    def __call__(self, x: float, /) -> float: ...
    @overload
    def __call__(self, x: NDArray[np.float64], /) -> NDArray[np.float64]: ...
    @overload
    def __call__(self, x: Expression, /) -> Expression: ...


_Function = TypeVar("_Function", bound=Callable[..., Any])
_SYMBOLIC = (ca.SX, ca.MX)
_CASADI = (ca.SX, ca.MX, ca.DM)
_MATRICES = (np.ndarray, *_CASADI)
# Types that cannot contain an expression.
_PLAIN = frozenset((float, int, str, bool, type(None)))
# Terms of the power series. At the far end of its interval each series has a relative error of at most 1e-17 in the
# value and 1e-14 in the second derivative.
_EXPM1_TERMS = 24
_ATANH_TERMS = 32
# Largest |x| for which the series of artanh is used.
_SERIES_BELOW = 0.5
# Near zero variance the square root has no derivative, so a symbolic RMS is smoothed there. This fraction of the
# steady force bounds the change.
_LEAST_RMS = 1e-12


COUNT = {"quantity": False}
"""Metadata of a dataclass field that holds a count, which a design cannot vary."""


def is_symbolic(value: Any) -> bool:
    """Return whether ``value`` is a CasADi expression that depends on symbols (``SX`` or ``MX``)."""
    return isinstance(value, _SYMBOLIC) and not value.is_constant()


def is_casadi(value: Any) -> bool:
    """Return whether ``value`` is any CasADi matrix type: ``SX``, ``MX`` or ``DM``."""
    return isinstance(value, _CASADI)


def as_number(value: Any) -> NDArray[np.float64]:
    """Return a number, an array or a constant CasADi matrix as a NumPy array without axes of length 1.

    Raises:
        InputError: the expression holds symbols.
    """
    if isinstance(value, float):
        return np.asarray(value)
    if is_symbolic(value):
        raise InputError(f"'{short(str(value))}' holds symbols and so has no value yet: evaluate it with best(...)")
    if isinstance(value, ca.SX):
        value = ca.DM(value)
    elif isinstance(value, ca.MX):
        value = value.to_DM()
    return np.squeeze(np.asarray(value, dtype=float))


def holds_casadi(value: Any) -> bool:
    """Return whether ``value`` is a CasADi expression, or a container with one nested in it.

    Containers are dataclasses, lists, tuples and dictionaries.
    """
    return any(map(is_casadi, _nested(value)))


def holds_symbols(value: Any) -> bool:
    """Return whether ``value`` is a CasADi expression that depends on symbols, or a container holds one."""
    return any(map(is_symbolic, _nested(value)))


def holds_several(value: Any) -> bool:
    """Return whether ``value`` is, or a container holds, an array or CasADi matrix without exactly one element."""
    return any(isinstance(item, _MATRICES) and math.prod(item.shape) != 1 for item in _nested(value))


def key_of(template: Any) -> tuple[str, tuple[Any, ...]]:
    """Return what tells a template, as `template_of` returns it, from those that differ in more than numbers.

    Different classes, and different functions, such as density profiles, can have the same repr.
    """
    parts = [*_nested(template)]
    classes = tuple(type(part) for part in parts if dataclasses.is_dataclass(type(part)))
    return repr(template), (*classes, *(id(part) for part in parts if callable(part)))


def _nested(value: Any) -> Iterator[Any]:
    """Yield a value and everything nested in it, except plain numbers and strings."""
    waiting = [value]
    while waiting:
        item = waiting.pop()
        kind: type = type(item)
        if kind in _PLAIN:
            continue
        yield item
        if names := _own_fields(kind):
            waiting += [getattr(item, name) for name in names]
        elif isinstance(item, Mapping):
            waiting += item.values()
        elif isinstance(item, list | tuple):
            waiting += item


@lru_cache(maxsize=256)
def _own_fields(kind: type) -> tuple[str, ...]:
    """Return the names of a dataclass's fields that its constructor accepts; an empty tuple for other types."""
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return tuple(field.name for field in fields if field.init)


def is_quantity(value: Any) -> bool:
    """Return whether a value is a number or a CasADi expression; a bool is neither."""
    return is_casadi(value) or (isinstance(value, int | float | np.number) and not isinstance(value, bool))


def map_expressions(value: Any, function: Callable[[Any], Any], leaf: Callable[[Any], bool] = is_casadi) -> Any:
    """Return a copy of ``value`` with ``function`` applied to every CasADi expression nested in it.

    The search descends into dataclasses, dictionaries, lists and tuples; anything else is kept. With
    ``leaf=is_quantity`` plain numbers are replaced too, except in fields marked as `COUNT`.
    """
    if leaf(value):
        return function(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {
            field.name: map_expressions(getattr(value, field.name), function, leaf)
            for field in dataclasses.fields(value)
            if field.init and field.metadata != COUNT
        }
        # What holds no expression need not be built and checked again.
        untouched = all(new is getattr(value, name) for name, new in changed.items())
        return value if untouched else dataclasses.replace(value, **changed)
    if isinstance(value, Mapping):
        return {key: map_expressions(item, function, leaf) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = [map_expressions(item, function, leaf) for item in value]
        return value if all(map(operator.is_, items, value)) else type(value)(items)
    return value


def template_of(value: Any) -> tuple[Any, list[Any]]:
    """Return a copy of ``value`` with a placeholder for every nested quantity, and the quantities in order.

    All placeholders have the same repr, so values that differ only in numbers have templates with equal reprs.
    """
    quantities: list[Any] = []

    def placeholder(quantity: Any) -> ca.SX:
        quantities.append(quantity)
        return ca.SX.sym("quantity")

    return map_expressions(value, placeholder, is_quantity), quantities


def with_numbers(template: Any, quantities: Sequence[float]) -> Any:
    """Return a template filled with numbers, in the order in which `template_of` returned its quantities."""
    numbers = iter(quantities)
    return map_expressions(template, lambda _: float(next(numbers)), is_quantity)


def column(values: Column, symbolic: bool) -> Column:
    """Return an array as it is, or as a CasADi column that can be combined with symbols."""
    return ca.DM(values) if symbolic else values


def stacked(*parts: Column) -> Column:
    """Return expressions stacked into one CasADi column."""
    return ca.vertcat(*parts)


def total(values: Column) -> Expression:
    """Return the sum of an array or a CasADi column."""
    return _sum(values) if is_casadi(values) else float(np.sum(values))


def dot(weights: Column, values: Column) -> Expression:
    """Return the sum of values times their weights."""
    return ca.dot(weights, values) if is_casadi(values) else float(weights @ values)


def one_node(function: Callable[..., tuple[Any, ...]]) -> Callable[..., tuple[Any, ...]]:
    """Decorate a function of scalars so that an MX graph holds it as one node instead of all its operations.

    Numbers, arrays and SX are passed to the function itself. MX arguments may be scalars or columns of one length; a
    scalar applies to every element.
    """

    @lru_cache(maxsize=1)
    def graph(count: int) -> ca.Function:
        arguments = [ca.SX.sym(f"x{k}") for k in range(count)]
        return ca.Function(function.__name__.strip("_"), arguments, list(function(*arguments)))

    @wraps(function)
    def apply(*arguments: Any) -> tuple[Any, ...]:
        if not any(isinstance(argument, ca.MX) for argument in arguments):
            return function(*arguments)
        columns = [ca.MX(argument) for argument in arguments]
        count = max(argument.numel() for argument in columns)
        rows = [a.T if a.numel() > 1 else ca.repmat(a, 1, count) for a in columns]
        return tuple(result.T for result in graph(len(rows)).map(count).call(rows))

    return apply


# The same functions typed for any operand: CasADi and NumPy declare signatures for their own types only.
_if_else: Callable[..., Expression] = ca.if_else
_sum: Callable[..., Expression] = ca.sum1
_choose: Callable[..., NDArray[np.float64]] = np.where


def _described(apply: _Function, numpy_function: Any, *example: float) -> _Function:
    """Return a function with the name of NumPy's, and with an example of its value."""
    name = apply.__name__ = apply.__qualname__ = numpy_function.__name__
    call = f"{name}({', '.join(map(repr, example))})"
    apply.__doc__ = f"""Return {name} of floats, arrays or CasADi expressions; angles are in rad.

    Example:
        >>> from plough_opt.core.expressions import {name}
        >>> round(float({call}), 6)
        {round(float(numpy_function(*example)), 6)!r}
    """
    return apply


def _unary(casadi_function: Any, numpy_function: Any) -> Elementary:
    def apply(x: Any, /) -> Any:
        return casadi_function(x) if is_casadi(x) else numpy_function(x)

    return _described(apply, numpy_function, 0.5)


def _binary(casadi_function: Any, numpy_function: Any) -> Callable[[Expression, Expression], Expression]:
    def apply(x: Any, y: Any, /) -> Any:
        return casadi_function(x, y) if is_casadi(x) or is_casadi(y) else numpy_function(x, y)

    return _described(apply, numpy_function, 0.5, 1.5)


sin = _unary(ca.sin, np.sin)
cos = _unary(ca.cos, np.cos)
tan = _unary(ca.tan, np.tan)
arctan = _unary(ca.atan, np.arctan)
sqrt = _unary(ca.sqrt, np.sqrt)
arcsinh = _unary(ca.asinh, np.arcsinh)
arctanh = _unary(ca.atanh, np.arctanh)
exp = _unary(ca.exp, np.exp)
log = _unary(ca.log, np.log)
log1p = _unary(ca.log1p, np.log1p)
expm1 = _unary(ca.expm1, np.expm1)
absolute = _unary(ca.fabs, np.abs)
floor = _unary(ca.floor, np.floor)
minimum = _binary(ca.fmin, np.minimum)
maximum = _binary(ca.fmax, np.maximum)
arctan2 = _binary(ca.atan2, np.arctan2)


def where(condition: Expression, yes: Expression, no: Expression) -> Expression:
    """Return ``yes`` where ``condition`` holds, else ``no``; both are evaluated, so both must be finite.

    Example:
        >>> from plough_opt.expressions import where
        >>> import plough_opt as po
        >>> where(True, 1.0, 2.0)
        1.0
    """
    if isinstance(condition, bool | np.bool_) and isinstance(yes, float) and isinstance(no, float):
        return float(yes if condition else no)
    if is_casadi(condition) or is_casadi(yes) or is_casadi(no):
        return _if_else(condition, yes, no)
    chosen = _choose(condition, yes, no)
    return chosen if chosen.ndim else float(chosen)


def rms(variance: Expression, scale: Expression) -> Expression:
    """Return the square root of a variance; for an expression its derivatives are finite even at variance 0."""
    if isinstance(variance, float):
        return math.sqrt(max(variance, 0.0))
    if not is_casadi(variance):
        return sqrt(maximum(variance, 0.0))
    least = _LEAST_RMS * scale + 1e-100
    return sqrt(variance + least**2) - least


def expm1_ratio(x: Expression) -> Expression:
    """Return E(x) = (exp(x) - 1)/x with E(0) = 1.

    A power series is used for |x| < 1, because automatic differentiation of ``expm1(x)/x`` loses up to half the digits
    near zero. The relative accuracy is 1e-15 for the value and 1e-13 for gradient and Hessian.
    """
    near_zero, small, large = _split(x, 1.0)
    series: Expression = 1.0 / math.factorial(_EXPM1_TERMS)
    for n in range(_EXPM1_TERMS - 1, 0, -1):
        series = 1.0 / math.factorial(n) + small * series
    return where(near_zero, series, expm1(large) / large)


def log1p_ratio(x: Expression) -> Expression:
    """Return log(1 + x)/x with the value 1 at x = 0, for x > -1.

    The series of 2 artanh(x/(2 + x))/x is used for |x| < 0.5, for the same reason and with the same accuracy as in
    `expm1_ratio`.
    """
    near_zero, small, large = _split(x)
    series = 2.0 * _arctanh_series((small / (2.0 + small)) ** 2) / (2.0 + small)
    return where(near_zero, series, log1p(large) / large)


def arctanh_ratio(x: Expression) -> Expression:
    """Return artanh(x)/x with the value 1 at x = 0, for |x| < 1; as accurate as `expm1_ratio`."""
    near_zero, small, large = _split(x)
    return where(near_zero, _arctanh_series(small**2), arctanh(large) / large)


def arctan_ratio(x: Expression) -> Expression:
    """Return arctan(x)/x with the value 1 at x = 0; as accurate as `expm1_ratio`."""
    near_zero, small, large = _split(x)
    return where(near_zero, _arctanh_series(-(small**2)), arctan(large) / large)


def arcsinh_ratio(x: Expression) -> Expression:
    """Return arsinh(x)/x with the value 1 at x = 0; as accurate as `expm1_ratio`.

    Near zero it equals artanh(t)/x with t = x/sqrt(1 + x^2).
    """
    near_zero, small, large = _split(x)
    scale = 1.0 / (1.0 + small**2)
    return where(near_zero, sqrt(scale) * _arctanh_series(small**2 * scale), arcsinh(large) / large)


def _split(x: Expression, below: float = _SERIES_BELOW) -> tuple[Expression, Expression, Expression]:
    """Return whether the series applies to x, x for the series (else 0), and x for the function (else a safe value)."""
    near_zero = absolute(x) < below
    return near_zero, where(near_zero, x, 0.0), where(near_zero, below, x)


def _arctanh_series(square: Expression) -> Expression:
    """Return artanh(t)/t given t^2 <= 1/4, or arctan(t)/t given -t^2."""
    series: Expression = 1.0 / (2 * _ATANH_TERMS + 1)
    for n in range(_ATANH_TERMS - 1, -1, -1):
        series = 1.0 / (2 * n + 1) + square * series
    return series


@lru_cache(maxsize=64)
def gauss_legendre(order: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return quadrature nodes and weights on [0, 1]; exact for polynomials up to degree 2 order - 1.

    Args:
        order: number of nodes, at least 1.
    """
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return tuple((nodes / 2.0 + 0.5).tolist()), tuple((weights / 2.0).tolist())


def same(a: Any, b: Any) -> bool:
    """Return whether two values are equal, with NaN equal to NaN and expressions equal only to themselves."""
    if a is b:
        return True
    if is_casadi(a) or is_casadi(b):
        return False
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        a, b = np.asarray(a), np.asarray(b)
        numbers = a.dtype.kind in "fc" and b.dtype.kind in "fc"
        return a.shape == b.shape and bool(np.array_equal(a, b, equal_nan=numbers))
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(same(value, b[key]) for key, value in a.items())
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if type(a) is type(b) and dataclasses.is_dataclass(a):
        fields = (field for field in dataclasses.fields(a) if field.compare)
        return all(same(getattr(a, field.name), getattr(b, field.name)) for field in fields)
    return bool(a == b or (a != a and b != b))


class ByValue:
    """A dataclass, declared with ``eq=False``, whose objects are equal if their fields are, arrays included."""

    def __eq__(self, other: object) -> bool:
        """Return whether another object has the same class and equal fields."""
        return same(self, other) if type(self) is type(other) else NotImplemented

    def __hash__(self) -> int:
        """Return a number that equal objects share; their arrays and mappings have none."""
        return hash(type(self))


_Result = TypeVar("_Result")


def kept(function: Callable[[Any], _Result]) -> Callable[[Any], _Result]:
    """Decorate a function of a frozen dataclass; the object itself keeps the result, as a cached property does."""
    name = f"{function.__module__}.{function.__qualname__}"

    @wraps(function)
    def apply(frozen: Any) -> _Result:
        stored: dict[str, Any] = frozen.__dict__
        if name not in stored:
            stored[name] = function(frozen)
        result: _Result = stored[name]
        return result

    return apply
