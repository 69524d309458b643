"""Reading of a problem file, with overrides, into a `Problem`; one error lists all mistakes with their lines.

Checked beyond the schema are missing and unused quantities, results, fronts, and domains of values.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import tomllib
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from plough_opt.core.checks import check_bounds, check_kind, check_limits, check_named, path_of
from plough_opt.core.errors import InputError, about, nearest, short
from plough_opt.core.quantities import IN_FILES, READINGS, quantities
from plough_opt.core.units import PER_CENT, Display, display_of, in_words
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.field_data import average_readings, course_of_file, spectrum_of_file
from plough_opt.problem_file.problem import TRADED, FileVariable, Problem
from plough_opt.problem_file.schema import CONTACTS, RANDOM, WAVES, ProblemFile, ProblemTable, VariableTable, at
from plough_opt.problem_file.source import TOO_DEEP, Source, entries, join_dotted, unreadable
from plough_opt.problem_file.uncertain import check_joint, check_uncertain

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
    if len(text) > _MAX_LENGTH or "\n" in text:
        wrong = f"at most {_MAX_LENGTH} characters can be read, in one line: give --set once for each change"
        raise InputError(f"--set {short(repr(text))}: {wrong}")
    path, _, written = (part.strip() for part in text.partition("="))
    text = short(text, 120)  # as messages quote it
    if not (path and written):
        raise InputError(f'--set {text}: expected KEY=VALUE, like scene.tow_speed="2.5 m/s"')
    with about(f"--set {text}:"):
        keys, value, place = _keys_of(path), _value_of(written), source.data
        for key in keys[:-1]:
            place = place.setdefault(key, {})
            if not isinstance(place, dict):
                raise InputError(f"'{path}' is not a key: '{key}' is a value, not a table")
        place[keys[-1]] = value
        if wrong_value := unreadable({path: value}):
            raise InputError(wrong_value[1])
    source.overridden[keys] = text
    join_dotted(source.data)
    variables, name = source.data.get("variables"), ".".join(keys)
    if not isinstance(variables, dict) or name not in variables:
        return ""
    declared, beyond = variables.pop(name), ""
    with suppress(InputError, KeyError, TypeError):  # mistakes that are reported when the file is read
        x, low, high = map(quantities()[name].parse, (value, declared["lower"], declared["upper"]))
        beyond = "" if low <= x <= high else f", outside its bounds {declared['lower']} to {declared['upper']}"
    return f"'{name}' is a variable of the file and is now fixed at {written}{beyond}"


def _keys_of(path: str) -> tuple[str, ...]:
    """Split a dotted path into keys; the dotted name of a variable remains one key, with or without quotes."""
    try:
        keys = max((keys for keys, _ in entries(tomllib.loads(f"{path} = 0"))), key=len)
    except tomllib.TOMLDecodeError:
        raise InputError(f"'{path}' is not a key: give a table and a key, like scene.tow_speed") from None
    if keys[0] not in ProblemTable.model_fields:
        valid = IN_FILES if len(keys) == 1 else ProblemTable.model_fields
        raise InputError(f"no table is named '{keys[0]}': {nearest(keys[0], valid, ProblemTable.model_fields)}")
    if keys[0] == "variables" and len(keys) > 1:
        rest = ".".join(keys[1:])
        name, _, side = (rest, "", "") if rest in quantities() else rest.rpartition(".")
        check_named("{} cannot be a variable", name or side, quantities())
        return ("variables", name, *([side] if side else []))
    return keys


def _value_of(written: str) -> Any:
    """Return a value as TOML reads it, or the text itself if it is not TOML, so that quotes may be omitted."""
    try:
        return tomllib.loads(f"value = {written}")["value"]
    except tomllib.TOMLDecodeError:
        return written
    except RecursionError:
        raise InputError(TOO_DEEP) from None


def read_source(source: Source, folder: Path) -> Problem:
    """Return the problem of a parsed file; ``folder`` is the one that paths of data files start from."""
    readings, course = average_readings(source, folder), course_of_file(source)
    try:
        table = ProblemFile.model_validate(source.data)
    except ValidationError as error:
        source.note_schema(error)
    source.raise_noted()
    spectrum = spectrum_of_file(source, table, folder)
    variables, displays, fixed = dict[str, FileVariable](), dict[str, Display](), dict[str, float]()
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
    displays |= _check_results(source, table)
    check_uncertain(source, table)
    source.raise_noted()
    problem = Problem(source.name, table, fixed, variables, displays, (), readings, spectrum, course, source.original,
                      source.read_files)  # fmt: skip
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
    step = None if declared.step is None else parsed("step", declared.step)
    values = tuple(parsed("catalogue", written) for written in declared.catalogue or ())
    if step is not None and values:
        raise InputError(f"'{key}' has a catalogue and a step: remove one")
    between = f"between its bounds {declared.lower} to {declared.upper}"
    if step is not None and (step <= 0.0 or math.floor(upper / step) < math.ceil(lower / step)):
        wrong = f"'{key}' step = {declared.step} must be above 0, with a multiple {between}"
        raise source.error((*place, "step"), wrong)
    if values and not any(lower <= value <= upper for value in values):
        raise source.error((*place, "catalogue"), f"no value in the catalogue of '{key}' lies {between}: add one")
    own = unit.symbol, display, IN_FILES[key].domain, tolerance, values or step
    return FileVariable(lower, upper, guess, declared.log, *own)


def check_complete(source: Source, table: ProblemTable, present: set[str]) -> None:
    """Note every missing quantity, and every quantity that nothing in the file uses.

    Args:
        source: the file.
        table: its tables.
        present: keys of the quantities that are given or are variables.
    """
    if not present <= {*quantities()}:
        return  # a misspelt variable is noted already; here it would be reported as missing too
    waves = [name for name in WAVES
             if at(table, name) is not None or {f"{name}.amplitude", f"{name}.wavelength"} <= present]  # fmt: skip
    unused = _unused(table, present, waves)
    for key in sorted({*unused} & present):
        source.note(("variables", key) if key in table.variables else key.split("."), f"'{key}' {unused[key]}")
    soil, effects = table.soil, table.effects
    if present & {*READINGS} and soil.compaction is not None and soil.adjusted == "soil.density_ratio":
        both = "both the cone index and the compaction decide the density ratio"
        source.note(("soil", "adjust"), f"{both}: adjust another property, or remove the compaction")
    if table.scene.average != "run" and (effects.orbit != "transient" or not waves):
        source.note(("scene", "average"), "'scene.average' = \"whole waves\" needs a transient over a strength wave")
    for before, name in itertools.pairwise(WAVES):
        if name in waves and before not in waves:
            source.note(name.split("."), f"'{name}' is given without '{before}': add that, or rename this to it")
    missing = [
        quantity
        for key, quantity in sorted(IN_FILES.items())
        if key not in {*present, *unused}
        and (
            (quantity.required and not (quantity.owner == "soil" and soil.name is not None))
            or (quantity.owner in waves and quantity.key != "phase")
            or quantity.owner == RANDOM
            or (key == "effects.contact_width" and effects.contact == "smooth")
        )
    ]
    for owner, own in itertools.groupby(missing, key=lambda quantity: quantity.owner):
        keys = [quantity.key for quantity in own]
        give = "is missing: give it" if len(keys) == 1 else "are missing: give them"
        rather = "the 'name' of a known soil" if owner == "soil" else f"make '{owner}.{keys[0]}' a variable"
        source.note(owner.split("."), f"{', '.join(map(repr, keys))} {give} in [{owner}] or {rather}")


def _unused(table: ProblemTable, present: set[str], waves: list[str]) -> dict[str, str]:
    """Return every quantity that nothing in the file may use -> the reason and the remedy."""
    soil, effects, record = table.soil, table.effects, at(table, f"{RANDOM}.record")
    by_index = "follows from the cone index: remove it, or set soil.adjust to another property"
    rows: list[tuple[object, str, str]] = [
        (present & {*READINGS}, soil.adjusted, by_index),
        (soil.compaction, "soil.density_ratio", "follows from the compaction: remove one of the two"),
        (effects.orbit != "transient", "scene.duration",
         "is not used by a periodic orbit, whose duration is one wavelength: remove it"),
        *((effects.contact != law, key, f'belongs to contact = "{law}", which is not set in [effects]')
          for law, (_, key) in CONTACTS.items()),
        *((name not in waves, name, f"belongs to {name}, which is missing: add it to [effects]") for name in WAVES),
        (at(table, RANDOM) is None, RANDOM, f"belongs to {RANDOM}, which is missing: add it to [effects]"),
        (record, RANDOM, "and a record are both given: remove one"),
    ]  # fmt: skip
    return {key: why for condition, place, why in rows if condition
            for key, quantity in IN_FILES.items() if place in (key, quantity.owner)}  # fmt: skip


def _check_results(source: Source, table: ProblemTable) -> dict[str, Display]:
    """Note every mistake in objective, requirements and front; return the unit in which each result is written."""
    displays: dict[str, Display] = {}
    for kind, verb, results in (("minimise", "minimised", table.minimise), ("require", "required", table.require),
                                ("trade_off", "traded", table.goals)):  # fmt: skip
        valid = [name for name, measure in MEASURES.items() if kind == "require" or not measure.everywhere]
        for name in results:
            with source.noting((kind, name)):
                check_named(f"{{}} cannot be {verb}", name, valid)
                MEASURES[name].check(name, table.scene.law)
                if kind == "trade_off":
                    continue
                unit, entry = MEASURES[name].unit, getattr(table, kind)[name]
                sides = {"per": entry.per} if kind == "minimise" else entry.sides
                values = {side: source.parsed((kind, name, side), unit, written, f"'{name}' {side}")
                          for side, written in sides.items()}  # fmt: skip
                if kind == "require":
                    show = partial(in_words, unit=unit.symbol)
                    check_limits(f"'{name}'", values.get("at_least"), values.get("at_most"), show)
                elif values["per"] <= 0.0:
                    raise source.error((kind, name, "per"), f"'{name}' per = {entry.per} must be above 0")
                displays[name] = display_of([*sides.values()][-1], unit)
    count = len(table.goals)
    if table.trade_off is not None and count not in (2, 3) and {*table.goals} <= {*MEASURES}:
        more = "put the others into [require]" if count > 3 else f"give {TRADED}"
        source.note(("trade_off",), f"a front needs two or three results, not {count}: {more}")
    return displays


def check_values(source: Source, problem: Problem) -> None:
    """Raise one InputError for all values and bounds outside the model's domain, with the line of each."""
    table, settings = problem.table, problem.table.accuracy.model_dump(exclude_none=True)
    for name in settings:
        with source.noting(("accuracy", name)):
            Accuracy(**{"method": settings["method"], name: settings[name]})
    values = [((*key.split("."),), key, value, f"'{key}'", source.written(key)) for key, value in problem.fixed.items()]
    values += [(("variables", key, side), key, getattr(v, side), f"'{key}' {side}", getattr(table.variables[key], side))
               for key, v in problem.variables.items() for side in ("lower", "upper")]  # fmt: skip
    for keys, key, value, what, written in values:
        with source.noting(keys, prefix=f"{what}: " if written is None else f"{what} = {written}: "):
            IN_FILES[key].check(value)
    source.raise_noted()
    with source.noting(("soil", "compaction")):
        problem.soil(problem.values())
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
