"""Equality of results, which hold arrays, mappings and expressions."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from plough_opt.core.expressions import is_casadi


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, with NaN equal to NaN and expressions equal only to themselves."""
    if one is other:
        return True
    if is_casadi(one) or is_casadi(other):
        return False
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        numbers = one.dtype.kind in "fc" and other.dtype.kind in "fc"
        return one.shape == other.shape and bool(np.array_equal(one, other, equal_nan=numbers))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if type(one) is type(other) and is_dataclass(one):
        return all(same(getattr(one, own.name), getattr(other, own.name)) for own in fields(one) if own.compare)
    return bool(one == other or (one != one and other != other))


class ByValue:
    """A dataclass, declared with ``eq=False``, whose objects are equal if their fields are, arrays included."""

    def __eq__(self, other: object) -> bool:
        """Return whether another object has the same class and equal fields."""
        return same(self, other) if type(self) is type(other) else NotImplemented

    def __hash__(self) -> int:
        """Return a number that equal objects share; their arrays and mappings have none."""
        return hash(type(self))
