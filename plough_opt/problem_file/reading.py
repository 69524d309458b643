"""Reading of a problem file, with overrides, into a `Problem`; one error lists all mistakes with their lines.

Checked beyond the schema are missing and unused quantities, results, fronts, and domains of values.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from plough_opt.core.checks import check_bounds, check_kind, check_limits, check_named, path_of
from plough_opt.core.errors import InputError, about, nearest, short
from plough_opt.core.quantities import IN_FILES, READINGS, quantities
from plough_opt.core.units import PER_CENT, Display, Unit, display_of, in_words
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.field_data import average_readings, course_of_file, spectrum_of_file
from plough_opt.problem_file.problem import TRADED, FileVariable, Problem
from plough_opt.problem_file.schema import (
    CONTACTS,
    RANDOM,
    WAVES,
    ProblemFile,
    ProblemTable,
    VariableTable,
    at,
    valid_keys,
)
from plough_opt.problem_file.source import Source, entry_at, parsed_toml, unreadable
from plough_opt.problem_file.uncertain import check_joint, check_uncertain
from plough_opt.soil.soil import STANDARD_ATMOSPHERE, Soil, compression_test, named_soil

# Length of a change in characters: an inline table must fit, and no sensible change is longer.
_MAX_LENGTH: Final = 2_000


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
    notes = tuple(note for text in overrides if (note := apply_override(source, text)))
    return dataclasses.replace(read_source(source, Path(path).parent), notes=notes, overrides=tuple(overrides))


def read_source(source: Source, folder: Path) -> Problem:
    """Return the problem of a parsed file; ``folder`` is the one that paths of data files start from."""
    join_dotted(source.data)
    readings = average_readings(source, folder)
    spectrum, course = spectrum_of_file(source, folder), course_of_file(source)
    try:
        table = ProblemFile.model_validate(source.data)
    except ValidationError as error:
        source.note_schema(error, valid_keys)
    source.raise_noted()
    problem = dataclasses.replace(_checked(source, table), readings=readings, spectrum=spectrum,
                                  course=course, text=source.original, data=source.read_files)  # fmt: skip
    source.raise_noted()
    check_values(source, problem)
    return problem


def check_changed(problem: Problem) -> None:
    """Check a problem whose quantities were changed after it was read.

    Raises:
        InputError: a quantity that belongs to an effect that is off, or one outside the model's domain.
    """
    source = Source("", problem.name)
    check_complete(source, problem.table, {*problem.fixed, *problem.variables})
    source.raise_noted()
    check_values(source, problem)


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
    text = short(text, 120)  # as messages quote it
    if not (path and written):
        raise InputError(f'--set {text}: expected KEY=VALUE, like scene.tow_speed="2.5 m/s"')
    with about(f"--set {text}:"):
        keys, value = _keys_of(path), _toml_value(written)
        _set(source.data, keys, value)
    source.overridden[tuple(keys)] = text
    join_dotted(source.data)
    variables, path = source.data.get("variables"), ".".join(keys)
    declared = variables.pop(path, None) if isinstance(variables, dict) else None
    if declared is None:
        return ""
    return f"'{path}' is a variable of the file and is now fixed at {written}{_outside(path, value, declared)}"


def _keys_of(path: str) -> list[str]:
    """Split a dotted path into keys; the dotted name of a variable remains one key, with or without quotes."""
    if path.startswith("variables."):
        rest = path.removeprefix("variables.").replace('"', "").replace("'", "")
        name, _, side = (rest, "", "") if rest in quantities() else rest.rpartition(".")
        check_named("{} cannot be a variable", name or side, quantities())
        return ["variables", name, *([side] if side else [])]
    keys = path.split(".")
    if not all(key.strip() for key in keys):
        raise InputError(f"'{path}' is not a key: give a table and a key, like scene.tow_speed")
    if keys[0] not in ProblemTable.model_fields:
        valid = IN_FILES if len(keys) == 1 else ProblemTable.model_fields
        raise InputError(f"no table is named '{keys[0]}': {nearest(keys[0], valid, ProblemTable.model_fields)}")
    return keys


def _toml_value(written: str) -> Any:
    """Return a value as TOML reads it, or the text itself if it is not TOML, so that quotes may be omitted."""
    try:
        read = tomllib.loads(f"value = {written}")
    except tomllib.TOMLDecodeError:
        return written
    except RecursionError:
        return parsed_toml(f"value = {written}", "the value")  # raises InputError
    return read["value"] if len(read) == 1 else written


def _set(data: dict[str, Any], keys: list[str], value: Any) -> None:
    """Set the value of a key in nested tables."""
    place, path = data, ".".join(keys)
    for key in keys[:-1]:
        place = place.setdefault(key, {})
        if not isinstance(place, dict):
            raise InputError(f"'{path}' is not a key: '{key}' is a value, not a table")
    place[keys[-1]] = value
    if wrong := unreadable({path: value}):
        raise InputError(wrong[1])


def _outside(key: str, value: Any, declared: Any) -> str:
    """Return a clause about a value outside the bounds of its variable, or ""."""
    try:
        x, lower, upper = (quantities()[key].parse(one) for one in (value, declared["lower"], declared["upper"]))
    except (InputError, KeyError, TypeError):  # a mistake that is reported when the file is read
        return ""
    return "" if lower <= x <= upper else f", outside its bounds {declared['lower']} to {declared['upper']}"


def join_dotted(data: dict[str, Any]) -> None:
    """Replace unquoted keys such as share.height = {...} in [variables] and [uncertain] by "share.height" = {...}."""
    for table in [table for name in ("variables", "uncertain") if isinstance(table := data.get(name), dict)]:
        for key in quantities():
            around, _, name = key.rpartition(".")
            inner = entry_at(table, around)
            if isinstance(inner, dict) and name in inner:
                entry, own = inner.pop(name), table.get(key)
                # An override may have added keys to a table under the quoted name.
                table[key] = own | entry if isinstance(own, dict) and isinstance(entry, dict) else entry
        for outer in ("soil", "share", "scene", "effects"):
            if isinstance(table.get(outer), dict) and not any(table[outer].values()):
                del table[outer]


def _checked(source: Source, table: ProblemTable) -> Problem:
    """Return the problem, after noting mistakes in names and bounds that the schema cannot find."""
    variables: dict[str, FileVariable] = {}
    displays: dict[str, Display] = {}
    fixed: dict[str, float] = {}
    for key, declared in table.variables.items():
        with source.noting(("variables", key)):
            check_named("{} cannot be a variable", key, quantities())
            if table.uncertain is not None and (declared.catalogue or declared.step) is not None:
                raise InputError(f"'{key}' has a catalogue, which is for one soil: remove it, or the table [uncertain]")
            variables[key] = variable_of(source, key, declared)
            displays[key] = variables[key].display
    for key, unit in quantities().items():
        value, written = at(table, key), source.written(key)
        if key in table.variables and written is not None:
            source.note(("variables", key), f"'{key}' is a variable and also has a fixed value: remove one")
        elif key not in table.variables and value is not None:
            fixed[key] = value
            displays |= {} if written is None else {key: display_of(written, unit)}
    check_complete(source, table, {*fixed, *table.variables})
    for kind in ("minimise", "require"):
        for name in getattr(table, kind):
            with source.noting((kind, name)):
                displays[name] = _checked_result(source, table, kind, name)
    check_uncertain(source, table)
    _check_front(source, table)
    return Problem(source.name, table, fixed, variables, displays, ())


def variable_of(source: Source, key: str, declared: VariableTable) -> FileVariable:
    """Return a variable with its bounds in SI; raise InputError if they contradict each other."""
    unit, place = quantities()[key], ("variables", key)

    def parsed(side: str, written: Any, more: str = "") -> float:
        return source.parsed((*place, side), unit, written, f"'{key}' {side}", more)

    lower, upper = parsed("lower", declared.lower), parsed("upper", declared.upper)
    guess = math.sqrt(lower * upper) if declared.log and lower > 0.0 < upper else (lower + upper) / 2.0
    guess = guess if declared.guess is None else parsed("guess", declared.guess)
    display, tolerance = display_of(declared.lower, unit), declared.tolerance
    if tolerance is not None and not (isinstance(tolerance, str) and PER_CENT.fullmatch(tolerance)):
        tolerance = parsed("tolerance", tolerance, ', or a percentage of the value like "0.5 %"')
        if tolerance < 0.0:
            raise source.error((*place, "tolerance"), f"'{key}' tolerance = {declared.tolerance} must not be below 0")
    check_bounds(f"'{key}'", lower, upper, guess, log=declared.log, show=display.text)
    ends = f"{declared.lower} to {declared.upper}"
    catalogue: tuple[float, ...] | float | None = None
    if declared.catalogue is not None and declared.step is not None:
        raise InputError(f"'{key}' has a catalogue and a step: remove one")
    if declared.step is not None:
        catalogue = step = parsed("step", declared.step)
        if step <= 0.0 or math.floor(upper / step) < math.ceil(lower / step):
            wrong = f"'{key}' step = {declared.step} must be above 0, with a multiple in {ends}"
            raise source.error((*place, "step"), wrong)
    if declared.catalogue is not None:
        catalogue = tuple(parsed("catalogue", one) for one in declared.catalogue)
        if not any(lower <= value <= upper for value in catalogue):
            wrong = f"no value in the catalogue of '{key}' lies between its bounds {ends}: add one"
            raise source.error((*place, "catalogue"), wrong)
    own = unit.symbol, display, IN_FILES[key].domain, tolerance, catalogue
    return FileVariable(lower, upper, guess, declared.log, *own)


def check_complete(source: Source, table: ProblemTable, known: set[str]) -> None:
    """Note every missing quantity, and every quantity that nothing in the file uses.

    Args:
        source: the file.
        table: its tables.
        known: keys of the quantities that are given or are variables.
    """
    if not known <= {*quantities()}:
        return  # a misspelt variable is noted already; here it would be reported as missing too
    unused = dict(_unused(source, table, known))
    for key in sorted({*unused} & known):
        source.note(("variables", key) if key in table.variables else key.split("."), f"'{key}' {unused[key]}")
    if table.soil.name is not None:
        with source.noting(("soil", "name")):
            named_soil(table.soil.name)
    elif missing := [f"'{IN_FILES[key].key}'" for key in _required("soil") if key not in known and key not in unused]:
        verb = "is" if len(missing) == 1 else "are"
        given = "give them in [soil], or the 'name' of a known soil"
        source.note(("soil",), f"{', '.join(missing)} {verb} missing: {given}")
    waves = [
        name for name in WAVES if at(table, name) is not None or {f"{name}.amplitude", f"{name}.wavelength"} <= known
    ]
    if table.scene.average != "run" and (table.effects.orbit != "transient" or not waves):
        source.note(("scene", "average"), "'scene.average' = \"whole waves\" needs a transient over a strength wave")
    for name, before in zip(WAVES[1:], WAVES, strict=False):
        if name in waves and before not in waves:
            source.note(name.split("."), f"'{name}' is given without '{before}': add that, or rename this to it")
    needed = [*_required("share", "scene"), *(key for name in waves for key in _of_wave(name))]
    needed += [key for key in IN_FILES if IN_FILES[key].owner == RANDOM]
    needed += ["effects.contact_width"] if table.effects.contact == "smooth" else []
    for key in needed:
        owner, _, name = key.rpartition(".")
        if key not in known and key not in unused:
            source.note(owner.split("."), f"'{name}' is missing: give it in [{owner}] or make '{key}' a variable")


def _unused(source: Source, table: ProblemTable, known: set[str]) -> Iterator[tuple[str, str]]:
    """Yield every quantity that nothing in the file uses, with the reason; note an invalid compression test."""
    if by_reading := bool(known & {*READINGS}):
        yield table.soil.adjusted, "follows from the cone index: remove it, or set soil.adjust to another property"
    if table.soil.compaction is not None:
        with source.noting(("soil", "compaction")):
            _check_compaction(table, known)
        if by_reading and table.soil.adjusted == "soil.density_ratio":
            remedy = "adjust another property, or remove the compaction"
            source.note(
                ("soil", "adjust"), f"both the cone index and the compaction decide the density ratio: {remedy}"
            )
        yield "soil.density_ratio", "follows from the compaction: remove one of the two"
    for law, (_, key) in CONTACTS.items():
        if table.effects.contact != law:
            yield key, f'belongs to contact = "{law}", which is not set in [effects]'
    if table.effects.orbit != "transient":
        yield "scene.duration", "is not used by a periodic orbit, whose duration is one wavelength: remove it"
    owned = {name: [key for key in IN_FILES if IN_FILES[key].owner == name] for name in (*WAVES, RANDOM)}
    for name, keys in owned.items():
        if at(table, name) is None and (name == RANDOM or not {*_of_wave(name)} <= known):
            yield from ((key, f"belongs to {name}, which is missing: add it to [effects]") for key in keys)
    if at(table, f"{RANDOM}.record") is not None:
        yield from (
            (key, "and a record are both given: remove one") for key in IN_FILES if IN_FILES[key].owner == RANDOM
        )


def _of_wave(name: str) -> tuple[str, str]:
    """Return the quantities that a strength wave needs."""
    return f"{name}.amplitude", f"{name}.wavelength"


def _required(*owners: str) -> list[str]:
    """Return the quantities that a file must give in some of its tables."""
    return [name for name, quantity in IN_FILES.items() if quantity.required and quantity.owner in owners]


def _check_compaction(table: ProblemTable, known: set[str]) -> None:
    """Raise InputError if a compression test is invalid, or does not reach an ambient pressure that is fixed."""
    test, key = table.soil.compaction, "soil.ambient_pressure"
    assert test is not None
    with about("'pressure'"):
        pressure = [Unit("Pa").parse(written) for written in test.pressure]
    compression_test(pressure, test.volume_lost)
    if key not in table.variables:
        fixed = float(at(table, key)) if key in known else STANDARD_ATMOSPHERE  # that of the named soils, too
        soil = dataclasses.replace(named_soil("serozem"), ambient_pressure=fixed)
        Soil.from_compaction(pressure, test.volume_lost, soil)


def _checked_result(source: Source, table: ProblemTable, kind: str, name: str) -> Display:
    """Return the unit in which one term of the objective or one requirement is written; raise InputError if invalid."""
    _check_name(table, name, "minimised" if kind == "minimise" else "required", everywhere=kind == "require")
    entry, unit = getattr(table, kind)[name], MEASURES[name].unit
    sides: Mapping[str, Any] = {"per": entry.per} if kind == "minimise" else entry.sides
    values = {side: source.parsed((kind, name, side), unit, one, f"'{name}' {side}") for side, one in sides.items()}
    if kind == "require":
        check_limits(f"'{name}'", values.get("at_least"), values.get("at_most"), partial(in_words, unit=unit.symbol))
    elif values["per"] <= 0.0:
        raise source.error((kind, name, "per"), f"'{name}' per = {sides['per']} must be above 0")
    return display_of([*sides.values()][-1], unit)


def _check_name(table: ProblemTable, name: str, verb: str, *more: str, everywhere: bool = False) -> None:
    """Raise InputError unless a name is a result that the law of resistance provides.

    Args:
        table: the file's tables.
        name: the name to check.
        verb: what the file does with the result, for the message.
        *more: further valid names, for suggestions.
        everywhere: accept results that have a value at every output time.
    """
    allowed = [one for one, measure in MEASURES.items() if everywhere or not measure.everywhere]
    check_named(f"{{}} cannot be {verb}", name, [*allowed, *more])
    MEASURES[name].check(name, table.scene.law)


def _check_front(source: Source, table: ProblemTable) -> None:
    """Note every mistake in [trade_off], which must have two or three results."""
    for name in table.goals:
        with source.noting(("trade_off", name)):
            _check_name(table, name, "traded", "points")
    count = len(table.goals)
    if table.trade_off is not None and count not in (2, 3) and {*table.goals} <= {*MEASURES}:
        more = "put the others into [require]" if count > 3 else f"give {TRADED}"
        source.note(("trade_off",), f"a front needs two or three results, not {count}: {more}")


def check_values(source: Source, problem: Problem) -> None:
    """Raise one InputError for all values and bounds outside the model's domain, with the line of each."""
    table = problem.table
    settings = table.accuracy.model_dump(exclude_none=True)
    for name in settings:
        with source.noting(("accuracy", name)):
            Accuracy(**{"method": settings["method"], name: settings[name]})
    for key, value in problem.fixed.items():
        written = source.written(key)
        with source.noting(tuple(key.split(".")), prefix=f"'{key}'{'' if written is None else f' = {written}'}: "):
            IN_FILES[key].check(value)
    for key, variable in problem.variables.items():
        for side in ("lower", "upper"):
            written = getattr(table.variables[key], side)
            with source.noting(("variables", key, side), prefix=f"'{key}' {side} = {written}: "):
                IN_FILES[key].check(getattr(variable, side))
    source.raise_noted()
    # Every value is valid by itself, so a remaining error is due to effects that exclude each other.
    with source.noting(("effects", "motion")):
        problem.scene()
    source.raise_noted()
    for kind, names in (("minimise", table.minimise), ("require", table.require), ("trade_off", table.goals)):
        for name in [name for name in names if MEASURES[name].random]:
            with source.noting((kind, name), prefix=f"'{name}': "):
                problem.scene().check_stationary()
    check_joint(source, table, lambda: problem.scene().soil)
    source.raise_noted()
