"""Overrides of keys in a problem file, such as those of ``--set`` on the command line."""

import tomllib
from typing import Any, Final

from plough_opt.core.checks import check_kind
from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.quantities import quantities
from plough_opt.problem_file.schema import ProblemTable
from plough_opt.problem_file.shares import TABLE, choose_share, join_dotted_variables
from plough_opt.problem_file.source import TOO_DEEP, Source, nested_line, unreadable

# Length in characters: an inline table must fit, and no sensible change is longer.
_MAX_LENGTH: Final = 2_000
# Characters of a change that messages quote.
_SHOWN: Final = 120


def apply_override(source: Source, text: str) -> str:
    """Change one key of a parsed file; return a note if this fixed a variable, else "".

    Args:
        source: the file.
        text: ``key=value``; the value as in the file, where quotes around a quantity may be omitted. Keys of
            variables are written as in the file: ``variables.share.height.upper``.

    Raises:
        InputError: there is no ``=``, or the file cannot have such a key.
    """
    check_kind("a change", text, str, "a text such as 'scene.tow_speed=\"2.5 m/s\"'")
    if len(text) > _MAX_LENGTH:
        raise InputError(f"--set {short(text)}: at most {_MAX_LENGTH} characters can be read")
    if "\n" in text:
        raise InputError(f"--set {short(repr(text))}: a change must be one line: give --set once for each change")
    path, _, written = (part.strip() for part in text.partition("="))
    text = short(text, _SHOWN)  # as messages quote it
    if not (path and written):
        raise InputError(f'--set {text}: expected KEY=VALUE, like scene.tow_speed="2.5 m/s"')
    try:
        keys, value = _split(path), _value(written)
        if keys != [TABLE]:
            return _change(source, keys, value, text)
    except InputError as error:
        raise InputError(f"--set {text}: {error}") from None
    choose_share(source, value)
    return ""


def _change(source: Source, keys: list[str], value: Any, text: str) -> str:
    """Set the value of a key; return a note if this fixed a variable, else ""."""
    path, shares = ".".join(keys), source.data.get(TABLE)
    if not all(key.strip() for key in keys):
        raise InputError(f"'{path}' is not a key: give a table and a key, like scene.tow_speed")
    if keys[0] not in ProblemTable.model_fields:
        raise InputError(f"no table is named '{keys[0]}': {nearest(keys[0], ProblemTable.model_fields)}")
    if keys[0] == TABLE and isinstance(shares, dict) and shares and keys[1] not in shares:
        raise InputError(f"no share is named {short(repr(keys[1]))}: {nearest(keys[1], shares)}")
    place: Any = source.data
    for depth, key in enumerate(keys[:-1], start=1):
        if key not in place:
            source.begun[tuple(keys[:depth])] = text
        place = place.setdefault(key, {})
        if not isinstance(place, dict):
            raise InputError(f"'{path}' is not a key: '{key}' is a value, not a table")
    place[keys[-1]] = value
    if wrong := unreadable({path: value}):
        raise InputError(wrong[1])
    source.overridden[tuple(keys)] = text
    share = 2 if keys[0] == TABLE else 0
    own = source.data[TABLE][keys[1]] if share else source.data  # the table around [variables]
    if isinstance(own, dict):
        join_dotted_variables(own)
        variables = own.get("variables")
        if isinstance(variables, dict) and variables.pop(".".join(keys[share:]), None) is not None:
            return f"'{path}' is a variable of the file and is now fixed at {text.partition('=')[2].strip()}"
    return ""


def _split(path: str) -> list[str]:
    """Split a dotted path into keys; the dotted name of a variable remains one key, with or without quotes."""
    before, found, rest = path.partition("variables.")
    around = before.split(".")[:-1]
    if not found or around not in ([], [TABLE, *around[1:2]]):
        return path.split(".")
    rest = rest.replace('"', "").replace("'", "")
    name, _, side = rest.rpartition(".")
    if rest in quantities():
        return [*around, "variables", rest]
    if name not in quantities():
        raise InputError(f"'{name or rest}' cannot be a variable: {nearest(name or rest, quantities())}")
    return [*around, "variables", name, side]


def _value(written: str) -> Any:
    """Return a value as TOML reads it, or the text itself if it is not TOML, so that quotes may be omitted."""
    if nested_line(written) is not None:
        raise InputError(TOO_DEEP)
    try:
        read = tomllib.loads(f"value = {written}")
    except tomllib.TOMLDecodeError:
        return written
    return read["value"] if len(read) == 1 else written
