"""The [shares] table: several shares in one frame, each as the file says but for what its own table says."""

import copy
from collections.abc import Mapping
from typing import Any, Final, TypeVar

from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.quantities import quantities
from plough_opt.problem_file.schema import SHARE_TABLES, ProblemTable
from plough_opt.problem_file.source import Source

TABLE: Final = "shares"
# What the frame has, and so every share alike.
_OF_FRAME: Final = ("tow_speed", "duration", "outputs")
_EXAMPLE: Final = '[shares.front] with soil.cohesion = "15 kPa"'
_T = TypeVar("_T")


def names_of_shares(source: Source) -> tuple[str, ...]:
    """Return the names of a file's shares, none where it has one share without a name.

    Raises:
        InputError: a table that is not a share, or says of a share what the whole frame has.
    """
    shares = source.data.get(TABLE)
    if shares is None or source.share:
        return ()
    if not isinstance(shares, dict) or not shares or not all(isinstance(own, dict) for own in shares.values()):
        raise source.error((TABLE,), f"'shares' must hold a table for each share, such as {_EXAMPLE}")
    for name, own in shares.items():
        with source.noting((TABLE, name)):
            if not name.isidentifier() or name in ProblemTable.model_fields:
                raise InputError(f"'{name}' cannot be the name of a share: take letters, digits and _, and no table's")
        for table in own:
            with source.noting((TABLE, name, table)):
                if table not in SHARE_TABLES:
                    where = "stands above for all shares" if table in ProblemTable.model_fields else "is not known"
                    raise InputError(f"'{table}' of a share {where}: {nearest(table, SHARE_TABLES)}")
        for key in _OF_FRAME:
            with source.noting((TABLE, name, "scene", key)):
                if any(isinstance(own.get(table), dict) and entry in own[table]
                       for table, entry in (("scene", key), ("variables", f"scene.{key}"))):  # fmt: skip
                    raise InputError(f"'scene.{key}' is of the frame, and so of every share: give it in [scene]")
    with source.noting(("uncertain",)):
        if source.data.get("uncertain") is not None:
            raise InputError("a design for an uncertain soil has one share: leave out [uncertain], or [shares]")
    source.raise_noted()
    return tuple(shares)


def choose_share(source: Source, name: object) -> set[str]:
    """Make a file one of a single share of its several: what stands above, but for what the share's own table says.

    A variable of the share alone takes the place of a value that stands above, and a value that of a variable.

    Returns:
        The quantities and results of which the share's own table says something.

    Raises:
        InputError: a file without shares, or without this one.
    """
    shares = names_of_shares(source)
    if name not in shares:
        raise InputError(f"no share is named {short(repr(name))}: {nearest(str(name), shares)}")
    data = copy.deepcopy(source.data)
    own = data.pop(TABLE)[name]
    for table in (data, own):
        join_dotted_variables(table)
    chosen = own.get("variables") if isinstance(own.get("variables"), dict) else {}
    fixed = {key for key in quantities() if _taken(copy.deepcopy(own), key)}
    for key in fixed:
        data.get("variables", {}).pop(key, None)
    for key in chosen:
        _taken(data, key)
    _merge(data, own)
    source.data, source.share = data, (TABLE, str(name))
    return {*fixed, *chosen, *own.get("require", {})}


def join_dotted_variables(data: dict[str, Any]) -> None:
    """Read share.height = {...} under [variables], without quotes, as "share.height" = {...}."""
    variables = data.get("variables")
    if not isinstance(variables, dict):
        return
    for key in quantities():
        entry = _taken(variables, key) if key not in variables else None
        if entry is not None:
            variables[key] = entry
    for table in ("soil", "share", "scene", "effects"):
        left = variables.get(table)
        if isinstance(left, dict) and not any(left.values()):
            del variables[table]


def _taken(data: Any, key: str) -> Any:
    """Take a dotted key out of nested tables, and return what stood there, or None."""
    *tables, name = key.split(".")
    for table in tables:
        data = data.get(table) if isinstance(data, dict) else None
    return data.pop(name, None) if isinstance(data, dict) else None


def _merge(data: dict[str, Any], own: Mapping[str, Any]) -> None:
    """Put what a share's table says over what stands above, key by key."""
    for key, value in own.items():
        if isinstance(value, dict) and isinstance(data.get(key), dict):
            _merge(data[key], value)
        else:
            data[key] = value


def by_share(parts: Mapping[str, Mapping[str, _T]], own: Mapping[str, set[str]]) -> dict[str, _T]:
    """Return what shares have: under its own key what all have alike, else under "share.key".

    Args:
        parts: name of a share -> key -> what it has.
        own: name of a share -> keys of which its own table says something.
    """
    found: dict[str, _T] = {}
    for name, part in parts.items():
        for key, value in part.items():
            alike = all(key in own[other] or there.get(key, value) == value for other, there in parts.items())
            found[key if alike and key not in own[name] else f"{name}.{key}"] = value
    return found
