"""The table [shares]: several shares in one frame, each with a table of entries that differ from the rest of the file.

The tables outside [shares] apply to all shares. A table such as [shares.front] overrides entries for one share.
"""

import copy
from collections.abc import Mapping
from typing import Any, Final, TypeVar

from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.quantities import quantities
from plough_opt.problem_file.schema import SHARE_TABLES, ProblemTable
from plough_opt.problem_file.source import Source, entry_at

TABLE: Final = "shares"
# Keys of [scene] that belong to the frame and cannot differ between shares.
_FRAME_KEYS: Final = ("tow_speed", "duration", "outputs")
_EXAMPLE: Final = '[shares.front] with soil.cohesion = "15 kPa"'
_T = TypeVar("_T")


def names_of_shares(source: Source) -> tuple[str, ...]:
    """Return the names of a file's shares; none if it has one unnamed share.

    Raises:
        InputError: an entry of [shares] is not a valid table, or sets a quantity of the whole frame.
    """
    shares = source.data.get(TABLE)
    if shares is None or source.share:
        return ()
    if not isinstance(shares, dict) or not shares or not all(isinstance(own, dict) for own in shares.values()):
        raise source.error((TABLE,), f"'shares' must hold a table for each share, such as {_EXAMPLE}")
    for name, own in shares.items():
        with source.noting((TABLE, name)):
            if not name.isidentifier() or name in ProblemTable.model_fields:
                raise InputError(
                    f"'{name}' cannot be the name of a share: use letters, digits and _, and not the name of a table"
                )
        for table in own:
            with source.noting((TABLE, name, table)):
                if table not in SHARE_TABLES:
                    if table in ProblemTable.model_fields:
                        raise InputError(f"'{table}' cannot differ between shares: give [{table}] for all of them")
                    raise InputError(f"'{table}' is not a table of a share: {nearest(table, SHARE_TABLES)}")
        for key in _FRAME_KEYS:
            with source.noting((TABLE, name, "scene", key)):
                if any(isinstance(own.get(table), dict) and entry in own[table]
                       for table, entry in (("scene", key), ("variables", f"scene.{key}"))):  # fmt: skip
                    raise InputError(f"'scene.{key}' belongs to the frame, not to one share: give it in [scene]")
    with source.noting(("uncertain",)):
        if source.data.get("uncertain") is not None:
            raise InputError("a design for an uncertain soil can have only one share: remove [uncertain] or [shares]")
    source.raise_noted()
    return tuple(shares)


def choose_share(source: Source, name: object) -> set[str]:
    """Reduce a file to one of its shares: the common tables, overridden by the table of the share.

    A variable in the share's table replaces a common value of the same key, and a value replaces a common variable.

    Returns:
        The quantities and results that the share's table sets.

    Raises:
        InputError: the file has no shares, or none of this name.
    """
    shares = names_of_shares(source)
    if name not in shares:
        known = nearest(str(name), shares) if shares else "the file has no table [shares]"
        raise InputError(f"no share is named {short(repr(name))}: {known}")
    data = copy.deepcopy(source.data)
    own = data.pop(TABLE)[name]
    for table in (data, own):
        join_dotted_variables(table)
    chosen = own.get("variables") if isinstance(own.get("variables"), dict) else {}
    fixed = {key for key in quantities() if entry_at(own, key) is not None}
    for key in fixed:
        data.get("variables", {}).pop(key, None)
    for key in chosen:
        _taken(data, key)
    _merge(data, own)
    source.data, source.share = data, (TABLE, str(name))
    return {*fixed, *chosen, *own.get("require", {})}


def join_dotted_variables(data: dict[str, Any]) -> None:
    """Replace unquoted keys such as share.height = {...} under [variables] by "share.height" = {...}."""
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
    """Remove a dotted key from nested tables, and return its value, or None."""
    around, _, name = key.rpartition(".")
    table = entry_at(data, around)
    return table.pop(name, None) if isinstance(table, dict) else None


def _merge(data: dict[str, Any], own: Mapping[str, Any]) -> None:
    """Update the common tables with those of a share, recursively."""
    for key, value in own.items():
        if isinstance(value, dict) and isinstance(data.get(key), dict):
            _merge(data[key], value)
        else:
            data[key] = value


def by_share(parts: Mapping[str, Mapping[str, _T]], own: Mapping[str, set[str]]) -> dict[str, _T]:
    """Return the entries of all shares: an entry that all have in common under its key, others under "share.key".

    Args:
        parts: name of each share -> its entries by key.
        own: name of each share -> keys that its own table sets.
    """
    found: dict[str, _T] = {}
    for name, part in parts.items():
        for key, value in part.items():
            alike = all(key in own[other] or there.get(key, value) == value for other, there in parts.items())
            found[key if alike and key not in own[name] else f"{name}.{key}"] = value
    return found
