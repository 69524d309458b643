"""Results that a frozen object keeps, because they follow from it alone."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

_Result = TypeVar("_Result")


def kept(function: Callable[[Any], _Result]) -> Callable[[Any], _Result]:
    """Decorate a function of a frozen dataclass; the object itself keeps the result, as a cached property does."""
    name = f"{function.__module__}.{function.__qualname__}"

    @wraps(function)
    def apply(frozen: Any) -> _Result:
        known: dict[str, Any] = frozen.__dict__
        if name not in known:
            known[name] = function(frozen)
        found: _Result = known[name]
        return found

    return apply
