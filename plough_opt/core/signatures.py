"""Signatures of public names as a user writes them: `angle: float`, not the type with its converters."""

import re
from inspect import Parameter, formatannotation, isclass, isfunction, ismodule, signature, unwrap
from types import SimpleNamespace
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

# Types as Python writes them -> as a user does. An expression is a number, an array or a CasADi symbol.
_SHORT: Final = {
    r"Annotated\[(.*?), \w+\(\)\]": r"\1",
    r"\b[a-z_]\w*\.(?=\w)": "",  # names of modules
    r"\b(?:_?Expression|MaybeInfinite|IntervalEnd)\b": "float",
    r"\b(?:Array|Column)\b": "ndarray",
    r"\bndarray\[tuple\[Any, \.\.\.\], dtype\[float64\]\]|\bNDArray\[float64\]": "ndarray",
    r"\bNoneType\b": "None",
}
# A union within another type.
_UNION: Final = re.compile(r"\bUnion\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")


class _Words(str):
    """A text that stands in a signature without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Return the text."""
        return str(self)


def readable(thing: Any) -> Any:
    """Return a function, class or module after giving its public functions and methods readable signatures.

    ``dir`` of a module then lists its public names, without those that it imports.
    """
    if isclass(thing):
        inner = [value for kind in thing.__mro__ if _is_here(kind) for value in vars(kind).values()]
        for value in inner:
            if isfunction(own := getattr(value, "__func__", value)):
                _describe(own)
    elif ismodule(thing):
        for name, value in vars(thing).items():
            if not (name.startswith("_") or ismodule(value)) and _is_here(value):
                readable(value)
        if public := getattr(thing, "__all__", None):
            vars(thing)["__dir__"] = lambda: [*public]
    elif isfunction(unwrap(thing)):
        _describe(thing)
    return thing


def _is_here(thing: Any) -> bool:
    """Return whether the toolkit defines a function or class."""
    return str(getattr(thing, "__module__", "")).partition(".")[0] == "plough_opt"


def _describe(function: Any) -> None:
    """Give a function a readable signature, which `help` and editors show; that of `__init__` is its class's too."""
    if "__signature__" in vars(function):
        return
    written = signature(function)
    parameters = [one.replace(annotation=_words(one.annotation)) for one in written.parameters.values()]
    function.__signature__ = written.replace(parameters=parameters, return_annotation=_words(written.return_annotation))


def _words(annotation: Any) -> Any:
    """Return an annotation in words, without what `Annotated` adds for converters."""
    if annotation is Parameter.empty:
        return annotation
    if not isinstance(annotation, str):
        annotation = get_type_hints(SimpleNamespace(__annotations__={"it": annotation}))["it"]
        if get_origin(annotation) is Union:
            return _Words(" | ".join(map(_words, get_args(annotation))))
        annotation = formatannotation(annotation)
    for pattern, words in _SHORT.items():
        annotation = re.sub(pattern, words, annotation)
    return _Words(_UNION.sub(lambda inner: re.sub(r", (?![^\[]*\])", " | ", inner[1]), annotation))
