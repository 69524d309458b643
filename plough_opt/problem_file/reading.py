"""Reading of a problem file, with overrides, into a `Problem`; one error lists all mistakes with their lines."""

import copy
import dataclasses
import math
import re
import tomllib
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from plough_opt.core.checks import check_kind, path_of
from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.quantities import IN_FILES, quantities
from plough_opt.core.units import Display, display_of
from plough_opt.design import Over
from plough_opt.problem_file.checking import check_complete, check_front, check_measures, check_values
from plough_opt.problem_file.own_measures import check_own, measures_of
from plough_opt.problem_file.problem import FileVariable, Problem
from plough_opt.problem_file.readings import average_readings, spectrum_of_file
from plough_opt.problem_file.schema import ProblemFile, ProblemTable, VariableTable, at, valid_keys
from plough_opt.problem_file.shares import TABLE, by_share, choose_share, join_dotted_variables, names_of_shares
from plough_opt.problem_file.source import TOO_DEEP, Source, nested_line, unreadable
from plough_opt.problem_file.uncertain import check_uncertain, join_dotted

_PER_CENT = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*%\s*")
# Length of a change in characters: an inline table must fit, and no sensible change is longer.
_MAX_LENGTH: Final = 2_000
# Characters of a change that messages quote.
_SHOWN: Final = 120


def read_problem(path: str | Path, overrides: Iterable[str] = ()) -> Problem:
    """Read and check a problem file.

    Args:
        path: the file.
        overrides: changes such as ``'scene.tow_speed="2.5 m/s"'``; a change of a variable's value fixes the variable.

    Raises:
        InputError: the file does not exist, is not TOML, or has invalid content; for every mistake the message gives
            file, line, key, what was expected and the nearest valid name.

    Example:
        >>> import plough_opt as po
        >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.tow_speed=9 km/h"])
        >>> problem.scene().tow_speed
        2.5
    """
    source = Source.read(path_of("the problem file", path))
    check_kind("overrides", overrides, list | tuple, "a list of texts such as 'scene.tow_speed=\"2.5 m/s\"'")
    overrides = tuple(overrides)
    notes = tuple(note for text in overrides if (note := apply_override(source, text)))
    names = names_of_shares(source)
    if not names:
        return _read(source, Path(path).parent, notes, overrides)
    parts, own = {}, {}
    for name in names:
        view = copy.copy(source)
        own[name] = choose_share(view, name)
        parts[name] = _read(view, Path(path).parent, notes, (*overrides, f"{TABLE}={name}"))
    return _joined(parts, own, overrides)


def _joined(parts: Mapping[str, Problem], own: Mapping[str, set[str]], overrides: tuple[str, ...]) -> Problem:
    """Return the problem of several shares in one frame.

    Args:
        parts: name of each share -> the problem of this share alone.
        own: name of each share -> quantities and results that its own table sets.
        overrides: changes that were made to the file.
    """

    def gathered(what: str) -> Any:
        return by_share({name: getattr(part, what) for name, part in parts.items()}, own)

    first = next(iter(parts.values()))
    require = {}
    for name, part in parts.items():
        for result, limit in part.table.require.items():
            together = measures_of(part.table)[result].adds and result not in own[name]
            require[result if together else f"{name}.{result}"] = limit
    displays = gathered("displays")
    displays |= {key: parts[key.partition(".")[0]].displays[key.partition(".")[2]] for key in require if "." in key}
    return dataclasses.replace(
        first, table=first.table.model_copy(update={"require": require}), fixed=gathered("fixed"),
        variables=gathered("variables"), displays=displays, shares=parts, overrides=overrides,
    )  # fmt: skip


def _read(source: Source, folder: Path, notes: tuple[str, ...], overrides: tuple[str, ...]) -> Problem:
    """Return the problem of one share; ``folder`` is the one that paths of data files start from."""
    join_dotted_variables(source.data)
    join_dotted(source.data)
    over = _over(source)
    readings = average_readings(source, folder)
    spectrum = spectrum_of_file(source, folder)
    try:
        table = ProblemFile.model_validate(source.data)
    except ValidationError as error:
        source.note_schema(error, valid_keys)
    source.raise_noted()
    problem = dataclasses.replace(
        _checked(source, table, notes), over=over, readings=readings, spectrum=spectrum, text=source.original,
        data=source.read_files, overrides=overrides,
    )  # fmt: skip
    source.raise_noted()
    check_values(source, problem)
    return problem


def check_changed(problem: Problem) -> None:
    """Check a problem whose quantities were changed after it was read.

    Raises:
        InputError: a quantity that belongs to an effect that is off, or one outside the model's domain.
    """
    if problem.shares:
        problem.scene()  # raises InputError: one share must be chosen
    source = Source("", problem.name)
    check_complete(source, problem.table, {*problem.fixed, *problem.variables})
    source.raise_noted()
    check_values(source, problem)


def _over(source: Source) -> Over | None:
    """Remove the key "over" from [minimise], whose other keys are results, and return its value."""
    table, place = source.data.get("minimise"), ("minimise", "over")
    written = table.pop("over", None) if isinstance(table, dict) else None
    if written not in (None, "worst", "mean"):
        source.note(place, f'over = {short(repr(written))} must be "worst" or "mean" (within the tolerances)')
    elif written is not None and source.data.get("uncertain") is not None:
        source.note(place, "'over' is for tolerances in one soil: remove it, or the table [uncertain]")
    return typing.cast("Over | None", written)


def _checked(source: Source, table: ProblemTable, notes: tuple[str, ...]) -> Problem:
    """Return the problem, after noting mistakes in names and bounds that the schema cannot find."""
    units = quantities()
    variables: dict[str, FileVariable] = {}
    displays: dict[str, Display] = {}
    for key, declared in table.variables.items():
        with source.noting(("variables", key)):
            if key not in units:
                raise InputError(f"'{key}' cannot be a variable: {nearest(key, units)}")
            variables[key] = _variable(source, key, declared)
            displays[key] = variables[key].display
    fixed: dict[str, float] = {}
    for key, unit in units.items():
        value, written = at(table, key), source.written(key)
        if key in table.variables:
            if written is not None:
                source.note(("variables", key), f"'{key}' is a variable and also has a fixed value: remove one")
        elif value is not None:
            fixed[key] = value
            if written is not None:
                displays[key] = display_of(written, unit)
    check_complete(source, table, {*fixed, *table.variables})
    if check_own(source, table):  # the checks below need the names of all results
        known = measures_of(table)
        displays |= {name: display_of(f"1 {own.unit}", known[name].unit) for name, own in table.measures.items()}
        check_measures(source, table, displays)
        check_uncertain(source, table)
        check_front(source, table)
    return Problem(source.name, table, fixed, variables, displays, notes)


def _variable(source: Source, key: str, declared: VariableTable) -> FileVariable:
    """Return a variable with its bounds in SI; raise InputError if they contradict each other."""
    unit = quantities()[key]
    bounds = {
        side: source.parsed(("variables", key, side), unit, written, f"'{key}' {side}")
        for side in ("lower", "upper", "guess")
        if (written := getattr(declared, side)) is not None
    }
    lower, upper = bounds["lower"], bounds["upper"]
    if not lower < upper:
        raise InputError(
            f"the bounds of '{key}' contradict each other: lower {declared.lower} is not below upper {declared.upper}"
        )
    if declared.log and lower <= 0.0:
        raise InputError(f"'{key}' is log-scaled and needs a lower bound above 0, not {declared.lower}")
    guess = bounds.get("guess", math.sqrt(lower * upper) if declared.log else (lower + upper) / 2.0)
    if not lower <= guess <= upper:
        raise InputError(
            f"the guess {declared.guess} of '{key}' lies outside its bounds {declared.lower} to {declared.upper}"
        )
    display, tolerance = display_of(declared.lower, unit), _tolerance(source, key, declared.tolerance)
    return FileVariable(lower, upper, guess, declared.log, unit.symbol, display, IN_FILES[key].domain, tolerance)


def _tolerance(source: Source, key: str, written: str | float | None) -> float | str | None:
    """Return the half width of a tolerance: a number in SI, or a percentage of the value as text."""
    place = ("variables", key, "tolerance")
    if written is None or (isinstance(written, str) and _PER_CENT.fullmatch(written)):
        return written
    more = ', or a percentage of the value like "0.5 %"'
    half = source.parsed(place, quantities()[key], written, f"'{key}' tolerance", more)
    if half < 0.0:
        raise source.error(place, f"'{key}' tolerance = {written} must not be below 0")
    return half


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
        keys, value = _keys_of(path), _toml_value(written)
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


def _keys_of(path: str) -> list[str]:
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


def _toml_value(written: str) -> Any:
    """Return a value as TOML reads it, or the text itself if it is not TOML, so that quotes may be omitted."""
    if nested_line(written) is not None:
        raise InputError(TOO_DEEP)
    try:
        read = tomllib.loads(f"value = {written}")
    except tomllib.TOMLDecodeError:
        return written
    return read["value"] if len(read) == 1 else written
