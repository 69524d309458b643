"""The quantities of a scene by the names that problem files give them, such as "share.height"."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import QUANTITIES
from plough_opt.motion.scene import Scene


def quantity_of(scene: Scene, name: str) -> Expression:
    """Return a scene's quantity by name.

    Raises:
        InputError: the name is unknown, or the scene does not have the quantity.
    """
    if name not in QUANTITIES:
        raise InputError(f"a scene has no quantity '{name}': {nearest(name, QUANTITIES)}")
    value: Expression | None = _at(scene, QUANTITIES[name].path)
    if value is None:
        raise InputError(f"the scene has no '{name}': add it to the scene, or omit the name")
    return value


def quantities_of(scene: Scene) -> dict[str, Expression | None]:
    """Return all quantities by name; those that the scene does not have are None."""
    return {name: _at(scene, quantity.path) for name, quantity in QUANTITIES.items()}


def _at(value: Any, path: tuple[str | int, ...]) -> Any:
    for step in path:
        if isinstance(step, int):  # a single wave is not in a tuple, several are
            several = value if isinstance(value, tuple) else (value,)
            value = several[step] if step < len(several) else None
        else:
            value = getattr(value, step, None)
    return value


def with_quantities(scene: Scene, changes: Mapping[str, Expression]) -> Scene:
    """Return a copy of a scene in which some quantities, by name, have new values: numbers or expressions.

    Raises:
        InputError: a name is unknown, or the scene does not have the quantity.
        DomainError: a number outside the model's domain.
    """
    for name, value in changes.items():
        quantity_of(scene, name)
        scene = _replaced(scene, QUANTITIES[name].path, value)
    return scene


def _replaced(value: Any, path: tuple[str | int, ...], new: Expression) -> Any:
    if not path:
        return new
    step, rest = path[0], path[1:]
    if isinstance(step, int):
        if not isinstance(value, tuple):
            return _replaced(value, rest, new)
        return (*value[:step], _replaced(value[step], rest, new), *value[step + 1 :])
    return dataclasses.replace(value, **{step: _replaced(getattr(value, step), rest, new)})
