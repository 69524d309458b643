"""Conversion of results to plain JSON data and strictly back, by pydantic; annotations for what it does not know."""

from __future__ import annotations

import json
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from functools import lru_cache, partial, reduce
from inspect import isfunction, signature
from operator import or_
from pathlib import Path
from types import ModuleType, SimpleNamespace, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, short
from plough_opt.core.process import additions

# pydantic is slow to import, and most programs save nothing: it is imported on first use.
if TYPE_CHECKING:
    from pydantic import ConfigDict, GetCoreSchemaHandler, TypeAdapter
    from pydantic_core import CoreSchema

# Texts and switches are not numbers, and numbers are finite; `to_plain` replaces the constants that JSON lacks; fields
# of a user's class may have types that pydantic does not know.
_SETTINGS: Final[ConfigDict] = {
    "strict": True, "allow_inf_nan": False, "ser_json_inf_nan": "constants", "arbitrary_types_allowed": True,
}  # fmt: skip
# Keys that name a class and a function.
_CLASS, _FUNCTION = "class", "function"
# A class or function in a file: its module and its qualified name, which may hold "<locals>".
_PATH: Final = re.compile(r"[\w.-]+:[\w.<>]+")
# The top-level module of this package.
_TOOLKIT: Final = "plough_opt"


def json_text(plain: object) -> str:
    """Return plain data as JSON in lines, as everything that the toolkit prints or saves."""
    return json.dumps(plain, indent=2, allow_nan=False)


def to_plain(value: Any, hint: Any = Any) -> Any:
    """Return a value as plain data, with NaN as None and infinities as strings.

    Args:
        value: a dataclass, an array, a number, a string, or containers of these.
        hint: its annotation.

    Raises:
        InputError: the value contains something else.
    """
    from pydantic_core import PydanticSerializationError

    try:
        text = _adapter(hint).serializer.to_json((value,), warnings=False, fallback=_plain)
    except PydanticSerializationError as error:
        raise InputError(str(error).rpartition(f"{InputError.__name__}: ")[2]) from None
    return json.loads(text, parse_constant=lambda name: None if name == "NaN" else name)[0]


def from_plain(hint: Any, data: Any) -> Any:
    """Return the value that `to_plain` converted.

    Raises:
        ValueError: the data does not match the annotation; the message says where.
    """
    from pydantic import ValidationError

    try:
        return _read(hint, data)
    except ValidationError as error:
        worst = max(error.errors(), key=lambda one: len(one["loc"]))
    place = ""
    for key in worst["loc"]:  # some are not keys but alternatives of a union
        if not isinstance(data, str):
            with suppress(LookupError, TypeError):
                place, data = f"{place}.{key}", data[key]
    place += f".{worst['loc'][-1]}" if worst["type"] == "missing" else ""
    why = worst.get("ctx", {}).get("error", worst["msg"])
    raise ValueError(f"at {place[1:]}: {why}" if place else why)


def _read(hint: Any, data: Any) -> Any:
    """Return the value of plain data, as JSON again, because strict pydantic takes a list for a tuple only there."""
    return _adapter(hint).validate_json(json.dumps([data]))[0]


@lru_cache(maxsize=256)
def _adapter(hint: Any) -> TypeAdapter[Any]:
    """Return the converter of a tuple of one value, because pydantic accepts no settings for a dataclass itself."""
    from pydantic import TypeAdapter

    return TypeAdapter(tuple[hint], config=_SETTINGS)


def _plain(value: Any) -> Any:
    """Return plain data for a value that pydantic does not know."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isfunction(value):
        return {_FUNCTION: _path(value)}
    if isinstance(value, float | int | None):
        return value
    raise InputError(f"a value of type {type(value).__name__} cannot be saved: {value!r:.60}")


@dataclass(frozen=True)
class Saved:
    """Annotation of a value that pydantic does not know.

    Attributes:
        form: annotation of its plain data.
        read: function that returns it from data of this form.
        write: function that returns its plain data.
    """

    form: Any
    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = _plain

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the conversion for pydantic."""
        from pydantic_core import core_schema

        write = core_schema.plain_serializer_function_ser_schema(self.write)
        return core_schema.no_info_after_validator_function(self.read, handler(self.form), serialization=write)


class Unsaved:
    """Annotation of a field that is needed only for further computations, and is None in a result that was read."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the conversion for pydantic."""
        from pydantic_core import core_schema

        nothing = Saved(None, lambda _: None, lambda _: None).__get_pydantic_core_schema__(source, handler)
        return core_schema.with_default_schema(nothing, default=None)


class ByName:
    """Annotation of an object of several classes, or of a user's class, which its plain data names."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the conversion for pydantic."""
        known = {kind.__name__: kind for kind in get_args(source) or (source,)}
        saved = Saved(dict[str, Any], partial(_read_object, known), partial(_write_object, known))
        return saved.__get_pydantic_core_schema__(source, handler)


def _write_object(known: dict[str, type], value: object) -> Any:
    """Return the fields of an object after the name of its class."""
    kind: Any = type(value)
    form = _form(kind)
    name = kind.__name__ if kind in known.values() else _path(kind)
    return {_CLASS: name} | to_plain(form(**{key: getattr(value, key) for key in form.__annotations__}), form)


def _read_object(known: dict[str, type], data: dict[str, Any]) -> Any:
    """Return an object of the class that its data names."""
    hint = next(iter(known.values()))
    name = str(data.get(_CLASS, hint.__name__))
    kind: Any = known.get(name) or (_class(name, known.values()) if ":" in name else None)
    if kind is None and ":" in name and not is_dataclass(hint) and not _is_at_hand(name):
        kind = _stand_in(hint, name, tuple(key for key in data if key != _CLASS))
    if kind is None:
        raise ValueError(f"is not of type {' or '.join(known)}")
    return kind(**vars(_read(_form(kind), data)))


@lru_cache(maxsize=256)
def _form(kind: Any) -> Any:
    """Return a dataclass with the fields of a class, of any type if it is not a dataclass or its type is local."""
    hints = _hints(kind) if is_dataclass(kind) else {}
    saved: list[Any] = []
    for name, one in signature(kind).parameters.items():
        hint = _with_functions(hints.get(name, Any))
        hint = hint | None if one.default is None else hint
        saved.append((name, hint) if one.default is one.empty else (name, hint, one.default))
    return make_dataclass(kind.__name__, saved, kw_only=True)


def _hints(kind: Any) -> dict[str, Any]:
    """Return name -> type of the fields of a dataclass, without types that are local to a function."""
    with suppress(NameError):
        return get_type_hints(kind, include_extras=True)
    found: dict[str, Any] = {}
    for one in fields(kind):
        alone = SimpleNamespace(__annotations__={one.name: one.type})
        with suppress(NameError):
            found |= get_type_hints(alone, vars(sys.modules[kind.__module__]), include_extras=True)
    return found


def _with_functions(hint: Any) -> Any:
    """Return a user's annotation in which functions have the annotation `FUNCTION`."""
    if Callable in (hint, get_origin(hint)):
        return Annotated[hint, FUNCTION]
    inner = tuple(map(_with_functions, get_args(hint)))
    if inner == get_args(hint):
        return hint
    return reduce(or_, inner) if get_origin(hint) is UnionType else get_origin(hint)[inner]


_array: Final = partial(np.array, dtype=float)
_Entry = float | Literal["Infinity", "-Infinity"] | None
NUMBERS: Final = Saved(float | int | list[float] | list[list[float]], lambda data: _numbers(data))
FUNCTION: Final = Saved(dict[Literal["function"], str], lambda data: _function(data[_FUNCTION]))
Array: TypeAlias = Annotated[NDArray[np.float64], Saved(list[_Entry] | list[list[_Entry]], _array)]
Complex: TypeAlias = Annotated[complex, Saved(tuple[float, float], lambda parts: complex(*parts))]
# Numbers that are infinite where unknown: errors of unpredictable motions, undetermined values, times of failures.
MaybeInfinite: TypeAlias = Annotated[float, Saved(float | Literal["Infinity"], float)]
IntervalEnd: TypeAlias = Annotated[float, Saved(float | Literal["Infinity", "-Infinity"], float)]


def _numbers(data: Any) -> Any:
    """Return a number, or an array of at least one; raise ValueError if there is none, or if rows differ in length."""
    if isinstance(data, list) and not _array(data).size:
        raise ValueError("holds no number")
    return _array(data) if isinstance(data, list) else data


def _path(thing: Any) -> str:
    return f"{thing.__module__}:{thing.__qualname__}"


def _imported(path: str) -> Any:
    """Return the class or function that an imported module defines under this name, or None.

    Nothing is imported, and names that a module itself only imports do not count.

    Raises:
        ValueError: the text is not a name with its module.
    """
    if _PATH.fullmatch(path) is None:
        raise ValueError(f"{short(path)!r} does not name a class or a function, as 'module:name' would")
    module, _, names = path.partition(":")
    holder: Any = None
    thing: Any = sys.modules.get(module)
    for name in names.split("."):
        holder, thing = thing, vars(thing).get(name) if isinstance(thing, ModuleType | type) else None
    if isinstance(holder, type) and not isinstance(thing, type):  # other methods need an object
        thing = thing.__func__ if isinstance(thing, staticmethod) else None
    return thing if (isfunction(thing) or isinstance(thing, type)) and _path(thing) == path else None


def _class(path: str, hints: Iterable[type]) -> type | None:
    """Return the dataclass that a file names if it may be in the place of some classes, or None.

    It must inherit from one of them; a class of the user's own needs only their methods.
    """
    found = _imported(path)
    if not (isinstance(found, type) and is_dataclass(found)):
        return None
    if any(hint in found.__mro__ for hint in hints):
        return found
    with suppress(TypeError):  # a protocol with attributes must be inherited
        return found if _is_users(found.__module__) and issubclass(found, tuple(hints)) else None
    return None


def _is_at_hand(path: str) -> bool:
    """Return whether a name is one of this package, or of the user's own and defined, so that nothing replaces it."""
    return _top(path) == _TOOLKIT or (_imported(path) is not None and _is_users(path.partition(":")[0]))


def _function(path: str) -> Callable[..., Any]:
    """Return a function of the user's own that a file names; any other is replaced by one that refuses to run."""
    found = _imported(path)
    return found if isfunction(found) and _is_users(found.__module__) else _missing(path)


def _is_users(module: str) -> bool:
    """Return whether an imported module is the user's own: not of Python, of this package or of an installed library.

    An installed package that declares itself as an addition is the user's own too.
    """
    top = _top(module)
    if top in sys.stdlib_module_names or top == _TOOLKIT:
        return False
    # `python -m` runs a module of Python or of a library as __main__; a session has no file.
    file = Path(getattr(sys.modules[module], "__file__", None) or "")
    installed = {"site-packages", "dist-packages"} & {*file.parts} or file.is_relative_to(sysconfig.get_path("stdlib"))
    return not installed or top in additions()


def _top(path: str) -> str:
    """Return the first package of a module or of a name in it."""
    return path.partition(":")[0].partition(".")[0]


@lru_cache(maxsize=256)  # so that a result that is loaded twice is equal
def _missing(path: str) -> Callable[..., Any]:
    """Return a replacement for a function that is not defined; calling it raises InputError."""

    def refuse(*_arguments: object, **_more: object) -> Any:
        raise InputError(f"the result holds '{path}', which is not defined here: import your module, and load again")

    refuse.__module__, _, refuse.__qualname__ = path.partition(":")  # by which it is saved again
    return refuse


@lru_cache(maxsize=256)
def _stand_in(hint: type, path: str, names: tuple[str, ...]) -> type:
    """Return a replacement for a class that is not defined; it holds and shows the fields but cannot compute.

    Raises:
        ValueError: a name cannot be that of a field.
    """
    methods = dict.fromkeys(("force", "at_rest", "reaction"), _missing(path))
    if wrong := [name for name in names if name in methods or name.startswith("__")]:
        raise ValueError(f"{short(wrong[0])!r} cannot be the name of a field")
    title, typed = path.rpartition(".")[2].rpartition(":")[2], [(name, Any) for name in names]
    try:
        made = make_dataclass(
            title, typed, bases=(hint,), frozen=True, kw_only=True, namespace={**methods, "label": path}
        )
    except TypeError as error:
        raise ValueError(f"{error}") from None
    made.__module__, _, made.__qualname__ = path.partition(":")  # by which it is saved again
    return made
