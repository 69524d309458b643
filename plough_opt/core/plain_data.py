"""Conversion of results to plain JSON data and strictly back, by pydantic; annotations for what it does not know.

Plain data hold numbers and texts. They name a class only where one of a few of this package may be, and nothing is
imported to read them; a function or a class of the user's own is only named.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, NoReturn, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, shown

# pydantic is slow to import, and most programs save nothing: it is imported on first use.
if TYPE_CHECKING:
    from pydantic import ConfigDict, GetCoreSchemaHandler, TypeAdapter
    from pydantic_core import CoreSchema

# Texts and switches are not numbers, and numbers are finite; `to_plain` replaces the constants that JSON lacks.
_SETTINGS: Final[ConfigDict] = {
    "strict": True, "allow_inf_nan": False, "ser_json_inf_nan": "constants", "arbitrary_types_allowed": True,
}  # fmt: skip
# Keys that name a class of this package, and what is not saved.
_CLASS, _NAME = "class", "not saved"


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
        worst = max(error.errors(), key=lambda mistake: len(mistake["loc"]))
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


@dataclass(frozen=True)
class NotSaved:
    """In a result that was read, the place of a function, an effect or a law of the user's own.

    Attributes:
        name: of what was not saved.
    """

    name: str
    label: ClassVar[str] = "a law of the user's own"

    def __call__(self, *_arguments: object, **_more: object) -> NoReturn:
        """Raise InputError, because only the name was saved."""
        raise InputError(f"a saved result only names '{self.name}': make the scene again to compute with it")

    force = at_rest = reaction = __call__

    @classmethod
    def write(cls, value: object) -> dict[str, str]:
        """Return the name of a function or an object as plain data."""
        name = value.name if isinstance(value, cls) else getattr(value, "__qualname__", None)
        return {_NAME: name or shown(value, 200)}

    @classmethod
    @lru_cache(maxsize=256)  # so that a result that is loaded twice is equal
    def read(cls, hint: type, name: str) -> Any:
        """Return the place of an object that has the methods of a class."""
        return type(cls.__name__, (cls, hint), {})(name)


class ByName:
    """Annotation of an object of several classes of this package, which its plain data name.

    They are those of a union, or else those that inherit from a class of which users may write their own, too.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the conversion for pydantic."""
        saved = Saved(dict[str, Any], partial(_read_object, source), partial(_write_object, source))
        return saved.__get_pydantic_core_schema__(source, handler)


def _classes(source: Any) -> dict[str, type]:
    """Return name -> class of the classes that an annotation allows."""
    return {kind.__name__: kind for kind in get_args(source) or _subclasses(source)}


def _subclasses(kind: type) -> Iterator[type]:
    own: type
    for own in kind.__subclasses__():
        if own.__module__.startswith("plough_opt.") and is_dataclass(own):
            yield own
        yield from _subclasses(own)


def _write_object(source: Any, value: object) -> Any:
    """Return the fields of an object after the name of its class."""
    kind = type(value)
    if isinstance(value, NotSaved) or _classes(source).get(kind.__name__) is not kind:
        return NotSaved.write(value)
    plain = to_plain(value, kind) if is_dataclass(kind) else to_plain(vars(value))
    return {_CLASS: kind.__name__, **plain}


def _read_object(source: Any, data: dict[str, Any]) -> Any:
    """Return an object of the class that its data name."""
    kinds, name = _classes(source), data.pop(_CLASS, None)
    if not get_args(source) and isinstance(data.get(_NAME), str):
        return NotSaved.read(source, data[_NAME])
    if name not in kinds:
        raise ValueError(f"is not of type {' or '.join(kinds)}")
    kind = kinds[name]
    return _read(kind, data) if is_dataclass(kind) else kind(**_read(dict[str, Array], data))


_array: Final = partial(np.array, dtype=float)
_Entry = float | Literal["Infinity", "-Infinity"] | None
NUMBERS: Final = Saved(float | int | list[float] | list[list[float]], lambda data: _numbers(data))
FUNCTION: Final = Saved(dict[Literal["not saved"], str], lambda data: NotSaved(data[_NAME]), NotSaved.write)
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
