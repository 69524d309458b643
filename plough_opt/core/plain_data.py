"""Conversion of dataclasses to plain JSON data, and strict conversion back by their type annotations."""

import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass, make_dataclass
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression

# Field (or class and field) that may be infinite -> strings that stand for infinity there, because JSON has none. These
# values may be unknown: errors of unpredictable motions, unknowns that data do not determine, times of failed methods.
_MAY_BE_INFINITE: Final = {
    **dict.fromkeys(("error_estimate", "standard_error", "sigma", "errors", "Entry.seconds"), ("Infinity",)),
    **dict.fromkeys(("Interval.lower", "Interval.upper"), ("Infinity", "-Infinity")),
}
_INFINITIES: Final = ("Infinity", "-Infinity")
# Keys that name a class and a function.
_CLASS, _FUNCTION = "class", "function"
# Annotations that leave a value's type open: saved expressions are numbers, arrays or None.
_OPEN_HINTS: Final = (Any, Expression)


class Misfit(ValueError):
    """Plain data that does not match the annotation; `place` says where."""

    def __init__(self, place: str, why: str) -> None:
        super().__init__(why)
        self.place = place


def to_plain(value: Any, hint: Any = Any) -> Any:
    """Return a value as plain data, with NaN as None and infinities as strings.

    Args:
        value: a dataclass, an array, a number, a string, a module-level function, or containers of these.
        hint: its annotation; the class of a dataclass is recorded if the annotation does not determine it.

    Raises:
        InputError: the value contains something else.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if np.isfinite(value) else None if np.isnan(value) else _INFINITIES[value < 0.0]
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, Mapping):
        inner = get_args(hint)[1] if len(get_args(hint)) == 2 else Any
        return {str(key): to_plain(own, inner) for key, own in value.items()}
    if isinstance(value, list | tuple | set):
        entries = sorted(value) if isinstance(value, set) else value
        return [to_plain(own, _entry(hint, k)) for k, own in enumerate(entries)]
    if inspect.isfunction(value):
        return {_FUNCTION: _path(value)}
    kind, known = type(value), _classes(hint)
    if not (is_dataclass(kind) or kind in known):
        raise InputError(f"a value of type {kind.__name__} cannot be saved: {value!r:.60}")
    hints = annotations_of(kind)
    plain = {name: to_plain(getattr(value, name), hints.get(name, Any)) for name in fields_of(kind)}
    return plain if known == [kind] else {_CLASS: kind.__name__ if kind in known else _path(kind), **plain}


def from_plain(hint: Any, data: Any, place: str = "", infinite: Sequence[str] = ()) -> Any:
    """Return the value that `to_plain` converted.

    Args:
        hint: its annotation.
        data: plain data read from JSON.
        place: location in the file, for messages.
        infinite: strings that are accepted as an infinite number.

    Raises:
        Misfit: the data does not match the annotation.
    """
    misfit = None
    for alternative in _alternatives(hint):
        try:
            return _read(alternative, data, place, infinite)
        except Misfit as error:
            if misfit is None or len(error.place) > len(misfit.place):
                misfit = error
    raise misfit or Misfit(place, f"{data!r:.60} is not expected here")


def _read(hint: Any, data: Any, place: str, infinite: Sequence[str]) -> Any:
    """Return the value of plain data for an annotation that is not a union."""
    origin, inner = get_origin(hint) or hint, get_args(hint)
    if hint in _OPEN_HINTS:
        return _read_any(data, place)
    if hint is object:
        return data
    if origin is Literal:
        _expect(any(data == own and type(data) is type(own) for own in inner), place, f"must be one of {inner}")
        return data
    if origin is np.ndarray:
        return _array(data, place, _INFINITIES)
    if origin is float:
        if isinstance(data, str) and data in infinite:
            return float(data)
        _expect(_is_number(data), place, "Input should be a valid number")
        return float(data)
    if origin in (int, str, bool, NoneType):
        _expect(type(data) is origin, place, f"Input should be {'null' if origin is NoneType else origin.__name__}")
        return data
    if origin is complex:
        return complex(*from_plain(tuple[float, float], data, place))
    if origin in (tuple, list, set, Sequence):
        _expect(isinstance(data, list), place, "Input should be a list")
        if origin is tuple and inner[-1:] != (...,):
            _expect(len(data) == len(inner), place, f"Input should have {len(inner)} entries")
        found = [from_plain(_entry(hint, k), own, _inside(place, k), infinite) for k, own in enumerate(data)]
        return found if origin is Sequence else origin(found)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        _expect(isinstance(data, dict), place, "Input should be an object")
        key = int if inner[0] is int else str
        return {key(name): from_plain(inner[1], own, _inside(place, name), infinite) for name, own in data.items()}
    if origin is Callable:
        path = data.get(_FUNCTION) if isinstance(data, dict) else None
        _expect(isinstance(path, str), place, "must name a function")
        return _imported(path) or _missing(str(path))
    return _object(hint, data, place)


def _object(hint: type, data: Any, place: str) -> Any:
    """Return an instance of a class, or of the subclass that the data names."""
    _expect(isinstance(data, dict), place, "Input should be an object")
    name = data.get(_CLASS, hint.__name__)
    kind = hint if name == hint.__name__ else _imported(name)
    if kind is None and ":" in str(name) and not is_dataclass(hint):
        kind = _stand_in(hint, name, [key for key in data if key != _CLASS])
    _expect(kind is hint or (isinstance(kind, type) and is_dataclass(kind)), place, f"is not of type {hint.__name__}")
    hints, given = annotations_of(kind), {}
    for key, default in fields_of(kind).items():
        if key in data:
            infinite = _MAY_BE_INFINITE.get(key) or _MAY_BE_INFINITE.get(f"{kind.__name__}.{key}", ())
            if data[key] is not None or default is not None:
                given[key] = from_plain(hints.get(key, object), data[key], _inside(place, key), infinite)
        else:
            _expect(default is not MISSING, _inside(place, key), "Field required")
    found = kind(**given, **dict.fromkeys(unsaved_fields(kind)))
    _expect(isinstance(found, hint), place, f"is not of type {hint.__name__}")
    return found


def _read_any(data: Any, place: str) -> Any:
    """Return a number, or an array of numbers."""
    if isinstance(data, list):
        return _array(data, place, ())
    _expect(_is_number(data), place, "Input should be a valid number")
    return data


def _array(data: Any, place: str, infinite: Sequence[str]) -> Any:
    """Return nested lists of numbers as an array; if infinities are accepted, so is None, which stands for NaN."""

    def number(own: Any) -> Any:
        if isinstance(own, list):
            return [number(inner) for inner in own]
        if infinite and (own is None or own in infinite):
            return float(own or "nan")
        _expect(_is_number(own), place, "Input should be a valid number")
        return own

    _expect(isinstance(data, list), place, "Input should be a list")
    return np.array(number(data), dtype=float)


def _is_number(data: Any) -> bool:
    return isinstance(data, int | float) and not isinstance(data, bool)


def _expect(holds: bool, place: str, why: str) -> None:
    if not holds:
        raise Misfit(place, why)


def _inside(place: str, key: object) -> str:
    return f"{place}.{key}" if place else str(key)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _classes(hint: Any) -> list[type]:
    """Return the classes that an annotation allows, without the plain types."""
    plain = (int, float, str, bool, complex, NoneType)
    return [own for own in _alternatives(hint) if isinstance(own, type) and own not in plain]


def _entry(hint: Any, number: int) -> Any:
    """Return the annotation of the entry with a number of a list or a tuple."""
    inner = [own for own in _alternatives(hint) if get_origin(own) in (tuple, list, set, Sequence)]
    entries = get_args(inner[0]) if inner else ()
    if not entries:
        return Any
    return entries[min(number, len(entries) - 1)] if entries[-1] is not ... else entries[0]


def annotations_of(kind: type[Any]) -> dict[str, Any]:
    """Return a dataclass's annotations; empty for other classes, and if local names in them are out of scope."""
    try:
        return get_type_hints(kind) if is_dataclass(kind) else {}
    except NameError:
        return {}


def unsaved_fields(kind: type[Any]) -> frozenset[str]:
    """Return the names of a class's fields that are not saved."""
    return getattr(kind, "unsaved", frozenset())


def fields_of(kind: type[Any]) -> dict[str, Any]:
    """Return the saved fields of a dataclass with their defaults, or the constructor arguments of another class."""
    if not is_dataclass(kind):
        return dict.fromkeys(inspect.signature(kind).parameters, MISSING)
    saved = [one for one in fields(kind) if one.init and one.name not in unsaved_fields(kind)]
    return {one.name: one.default if one.default_factory is MISSING else one.default_factory for one in saved}


def _path(thing: Any) -> str:
    return f"{thing.__module__}:{thing.__qualname__}"


def _imported(path: Any) -> Any:
    """Return a class or function of a user's module, or None if that is not imported; a file must not import code."""
    module, _, names = str(path).partition(":")
    thing = None if module.partition(".")[0] in sys.stdlib_module_names else sys.modules.get(module)
    for name in names.split("."):
        thing = getattr(thing, name, None)
    return thing


def _missing(path: str) -> Callable[..., Any]:
    """Return a replacement for a function that is not defined; calling it raises InputError."""

    def refuse(*_arguments: object, **_more: object) -> Any:
        raise InputError(f"the result holds '{path}', which is not defined here: define or import it, and load again")

    refuse.__module__, _, refuse.__qualname__ = path.partition(":")  # by which it is saved again
    return refuse


def _stand_in(hint: type, path: str, names: Sequence[str]) -> type:
    """Return a replacement for a class that is not defined; it holds and shows the fields but cannot compute."""
    methods = dict.fromkeys(("force", "at_rest", "reaction"), _missing(path))
    made = make_dataclass(path.rpartition(".")[2].rpartition(":")[2], names, bases=(hint,), frozen=True,
                          namespace={**methods, "label": path})  # fmt: skip
    made.__module__, _, made.__qualname__ = path.partition(":")  # by which it is saved again
    return made
