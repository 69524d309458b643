"""Parts that a problem file gives by name with their quantities: the law of resistance, and own effects."""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from plough_opt.core.checks import check_named, shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.units import Unit
from plough_opt.laws.law import ResistanceLaw
from plough_opt.laws.registry import LAWS, law_of
from plough_opt.motion.effects import OWN_EFFECTS, OwnResistance

_Kind = TypeVar("_Kind")
_LAW = '"plastic", or { law = "mckyes_ali", depth = "0.35 m" }'
_EFFECTS = 'a list of tables with a name, such as [{ effect = "shank", static = "150 N" }]'


def medium_of(written: object) -> str | ResistanceLaw:
    """Return what `Scene` takes as its medium: a name, or a law with its own quantities in SI units.

    Raises:
        InputError: an unknown law or key, or a value that the law does not take; begins with what follows the key.
    """
    if isinstance(written, str):
        law_of(written)
        return written
    if not isinstance(written, Mapping) or not isinstance(written.get("law"), str):
        raise InputError(f"= {shown(written)} must be a resistance law, such as {_LAW}")
    law_of(written["law"])
    return _made(LAWS[written["law"]], "law", written)


def own_effects_of(written: object) -> tuple[OwnResistance, ...]:
    """Return own effects with their quantities in SI units.

    Raises:
        InputError: an unknown effect or key, or a value that it does not take; begins with what follows the key.
    """
    if not isinstance(written, list | tuple) or not all(
        isinstance(one, Mapping) and "effect" in one for one in written
    ):
        raise InputError(f"= {shown(written)} must be {_EFFECTS}")
    for one in written:
        check_named("no own effect is named {}", one["effect"], OWN_EFFECTS)
    return tuple(_made(OWN_EFFECTS[one["effect"]], "effect", one) for one in written)


def _made(kind: type[_Kind], key: str, written: Mapping[str, Any]) -> _Kind:
    """Return an instance of a class with the quantities of a table, but for the key that names the class."""
    given = {name: _value(kind, name, value) for name, value in written.items() if name != key}
    try:
        return kind(**given)
    except TypeError as error:  # what the class needs and the table lacks
        raise InputError(f"= {shown(written)} lacks something: {error}") from None


def _value(kind: type, key: str, value: Any) -> Any:
    """Return the value of one field, which has a unit where its class says so."""
    known = {each.name: each for each in dataclasses.fields(kind)}
    if key not in known:
        raise InputError(f"'{key}' is not a quantity of {kind.__name__}: {nearest(key, known)}")
    unit = known[key].metadata.get("unit")
    if unit is None:
        return value
    try:
        return Unit(unit).parse(value)
    except InputError as error:
        raise InputError(f"'{key}' {error}") from None
