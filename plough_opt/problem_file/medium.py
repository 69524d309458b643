"""The law of resistance of a problem file: its name, or a table with its name and its own quantities."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from plough_opt.core.errors import InputError, nearest
from plough_opt.core.kinds import shown
from plough_opt.core.units import Unit
from plough_opt.laws.law import ResistanceLaw
from plough_opt.laws.registry import LAWS, law_of

_EXAMPLE = '"plastic", or { law = "mckyes_ali", depth = "0.35 m" }'


def medium_of(written: object) -> str | ResistanceLaw:
    """Return what `Scene` takes as its medium: a name, or a law with its own quantities in SI units.

    Raises:
        InputError: an unknown law or key, or a value that the law does not take; begins with what follows the key.
    """
    if isinstance(written, str):
        law_of(written)
        return written
    if not isinstance(written, Mapping) or not isinstance(written.get("law"), str):
        raise InputError(f"= {shown(written)} must be a resistance law, such as {_EXAMPLE}")
    law_of(written["law"])
    kind = LAWS[written["law"]]
    given = {key: _value(kind, key, value) for key, value in written.items() if key != "law"}
    try:
        return kind(**given)
    except TypeError as error:  # what the class needs and the table lacks
        raise InputError(f"= {shown(written)} lacks something: {error}") from None


def _value(kind: type[ResistanceLaw], key: str, value: Any) -> Any:
    """Return the value of one of a law's fields, which has a unit where the law's class says so."""
    known = {each.name: each for each in dataclasses.fields(kind)}  # type: ignore[arg-type]  # laws are dataclasses
    if key not in known:
        raise InputError(f"'{key}' is not a quantity of that law: {nearest(key, known)}")
    unit = known[key].metadata.get("unit")
    if unit is None:
        return value
    try:
        return Unit(unit).parse(value)
    except InputError as error:
        raise InputError(f"'{key}' {error}") from None
