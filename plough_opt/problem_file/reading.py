"""Reading of a problem file, with overrides, into a `Problem`; one error lists all mistakes with their lines.

Checked beyond the schema are missing and unused quantities, results, fronts, and domains of values.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from plough_opt.core.checks import check_bounds, check_kind, check_limits, check_named, path_of
from plough_opt.core.errors import DomainError, InputError, about, nearest, short
from plough_opt.core.expressions import as_number
from plough_opt.core.quantities import IN_FILES, READINGS, quantities
from plough_opt.core.units import PER_CENT, Display, Unit, display_of, in_words
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.field_data import average_readings, course_of_file, spectrum_of_file
from plough_opt.problem_file.problem import TRADED, FileVariable, Problem
from plough_opt.problem_file.schema import (
    CONTACTS,
    RANDOM,
    WAVES,
    EffectsFile,
    ProblemFile,
    ProblemTable,
    VariableTable,
    at,
    valid_keys,
)
from plough_opt.problem_file.source import TOO_DEEP, Keys, Source, entry_at, nested_line, unreadable
from plough_opt.problem_file.uncertain import check_joint, check_uncertain, join_dotted
from plough_opt.soil.soil import STANDARD_ATMOSPHERE, Soil, compression_test, named_soil

# Length of a change in characters: an inline table must fit, and no sensible change is longer.
_MAX_LENGTH: Final = 2_000
# Characters of a change that messages quote.
_SHOWN: Final = 120
_BY_READING: Final = "follows from the cone index: remove it, or set soil.adjust to another property"


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
    found = read_source(source, Path(path).parent, notes, overrides)
    return dataclasses.replace(found, notes=(*found.notes, *_soil_notes(found, path, overrides)))


def read_source(source: Source, folder: Path, notes: tuple[str, ...] = (), overrides: tuple[str, ...] = ()) -> Problem:
    """Return the problem of a file; ``folder`` is the one that paths of data files start from."""
    join_dotted_variables(source.data)
    join_dotted(source.data)
    readings = average_readings(source, folder)
    spectrum, course = spectrum_of_file(source, folder), course_of_file(source)
    try:
        table = ProblemFile.model_validate(source.data)
    except ValidationError as error:
        source.note_schema(error, valid_keys)
    source.raise_noted()
    problem = dataclasses.replace(
        _checked(source, table, notes), readings=readings, spectrum=spectrum, course=course,
        text=source.original, data=source.read_files, overrides=overrides,
    )  # fmt: skip
    source.raise_noted()
    check_values(source, problem)
    return problem


def _soil_notes(problem: Problem, path: str | Path, overrides: tuple[str, ...]) -> tuple[str, ...]:
    """Return a note if overrides change a soil that has been measured, with what they do to the draft."""
    own = [text for text in overrides if text.strip().startswith("soil.")]
    if not own or problem.table.soil.penetrometer is None:
        return ()
    try:
        before = read_problem(path, [text for text in overrides if text not in own])
        drafts = [float(as_number(one.scene().steady_resistance)) for one in (before, problem)]
    except (InputError, DomainError):  # the file holds no soil without the overrides
        return ()
    unused = "" if problem.readings else ", and the penetrometer's readings are not used"
    low, high = (in_words(draft, "N", 4) for draft in drafts)
    percent = 100.0 * (drafts[1] / drafts[0] - 1.0)
    changed = f"the steady draft at the guesses changes from {low} to {high} ({percent:+.2g} %)"
    return (f"{', '.join(own)} changes a soil that a penetrometer has measured: {changed}{unused}",)


def check_changed(problem: Problem) -> None:
    """Check a problem whose quantities were changed after it was read.

    Raises:
        InputError: a quantity that belongs to an effect that is off, or one outside the model's domain.
    """
    source = Source("", problem.name)
    check_complete(source, problem.table, {*problem.fixed, *problem.variables})
    source.raise_noted()
    check_values(source, problem)


def _checked(source: Source, table: ProblemTable, notes: tuple[str, ...]) -> Problem:
    """Return the problem, after noting mistakes in names and bounds that the schema cannot find."""
    units = quantities()
    variables: dict[str, FileVariable] = {}
    displays: dict[str, Display] = {}
    for key, declared in table.variables.items():
        with source.noting(("variables", key)):
            check_named("{} cannot be a variable", key, units)
            if table.uncertain is not None and (declared.catalogue or declared.step) is not None:
                raise InputError(f"'{key}' has a catalogue, which is for one soil: remove it, or the table [uncertain]")
            variables[key] = variable_of(source, key, declared)
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
    check_measures(source, table, displays)
    check_uncertain(source, table)
    check_front(source, table)
    return Problem(source.name, table, fixed, variables, displays, notes)


def variable_of(source: Source, key: str, declared: VariableTable) -> FileVariable:
    """Return a variable with its bounds in SI; raise InputError if they contradict each other."""
    unit = quantities()[key]
    bounds = {
        side: source.parsed(("variables", key, side), unit, written, f"'{key}' {side}")
        for side in ("lower", "upper", "guess")
        if (written := getattr(declared, side)) is not None
    }
    lower, upper = bounds["lower"], bounds["upper"]
    display, tolerance = display_of(declared.lower, unit), _tolerance(source, key, declared.tolerance)
    check_bounds(f"'{key}'", lower, upper, bounds.get("guess"), log=declared.log, show=display.text)
    guess = bounds.get("guess", math.sqrt(lower * upper) if declared.log else (lower + upper) / 2.0)
    catalogue = _catalogue(source, key, declared, lower, upper)
    own = unit.symbol, display, IN_FILES[key].domain, tolerance, catalogue
    return FileVariable(lower, upper, guess, declared.log, *own)


def _catalogue(
    source: Source, key: str, declared: VariableTable, lower: float, upper: float
) -> tuple[float, ...] | float | None:
    """Return the values or the step of a variable, in SI; raise InputError if none lies between its bounds."""
    unit, ends = quantities()[key], f"{declared.lower} to {declared.upper}"
    place = ("variables", key, "catalogue" if declared.step is None else "step")
    if declared.step is not None:
        if declared.catalogue is not None:
            raise InputError(f"'{key}' has a catalogue and a step: remove one")
        step = source.parsed(place, unit, declared.step, f"'{key}' step")
        if step <= 0.0 or math.floor(upper / step) < math.ceil(lower / step):
            raise source.error(place, f"'{key}' step = {declared.step} must be above 0, with a multiple in {ends}")
        return step
    if declared.catalogue is None:
        return None
    found = tuple(source.parsed(place, unit, one, f"'{key}' catalogue") for one in declared.catalogue)
    if not any(lower <= value <= upper for value in found):
        raise source.error(place, f"no value in the catalogue of '{key}' lies between its bounds {ends}: add one")
    return found


def _tolerance(source: Source, key: str, written: str | float | None) -> float | str | None:
    """Return the half width of a tolerance: a number in SI, or a percentage of the value as text."""
    place = ("variables", key, "tolerance")
    if written is None or (isinstance(written, str) and PER_CENT.fullmatch(written)):
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
    with about(f"--set {text}:"):
        return _change(source, _keys_of(path), _toml_value(written), text)


def _change(source: Source, keys: list[str], value: Any, text: str) -> str:
    """Set the value of a key; return a note if this fixed a variable, else ""."""
    path = ".".join(keys)
    if not all(key.strip() for key in keys):
        raise InputError(f"'{path}' is not a key: give a table and a key, like scene.tow_speed")
    if keys[0] not in ProblemTable.model_fields:
        valid = IN_FILES if len(keys) == 1 else ProblemTable.model_fields
        raise InputError(f"no table is named '{keys[0]}': {nearest(keys[0], valid, ProblemTable.model_fields)}")
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
    join_dotted_variables(source.data)
    variables = source.data.get("variables")
    if isinstance(variables, dict) and (declared := variables.pop(path, None)) is not None:
        outside = _outside(path, value, declared)
        return f"'{path}' is a variable of the file and is now fixed at {text.partition('=')[2].strip()}{outside}"
    return ""


def _outside(key: str, value: Any, declared: Any) -> str:
    """Return a clause about a value outside the bounds of its variable, or ""."""
    try:
        x, lower, upper = (quantities()[key].parse(one) for one in (value, declared["lower"], declared["upper"]))
    except (InputError, KeyError, TypeError):  # a mistake that is reported when the file is read
        return ""
    return "" if lower <= x <= upper else f", outside its bounds {declared['lower']} to {declared['upper']}"


def _keys_of(path: str) -> list[str]:
    """Split a dotted path into keys; the dotted name of a variable remains one key, with or without quotes."""
    if not path.startswith("variables."):
        return path.split(".")
    rest = path.removeprefix("variables.").replace('"', "").replace("'", "")
    name, _, side = rest.rpartition(".")
    if rest in quantities():
        return ["variables", rest]
    check_named("{} cannot be a variable", name or rest, quantities())
    return ["variables", name, side]


def _toml_value(written: str) -> Any:
    """Return a value as TOML reads it, or the text itself if it is not TOML, so that quotes may be omitted."""
    if nested_line(written) is not None:
        raise InputError(TOO_DEEP)
    try:
        read = tomllib.loads(f"value = {written}")
    except tomllib.TOMLDecodeError:
        return written
    return read["value"] if len(read) == 1 else written


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


def check_complete(source: Source, table: ProblemTable, known: set[str]) -> None:
    """Note every missing quantity, and every quantity that nothing in the file uses.

    Args:
        source: the file.
        table: its tables.
        known: keys of the quantities that are given or are variables.
    """
    if not known <= {*quantities()}:
        return  # a misspelt variable is noted already; here it would be reported as missing too
    decided = dict.fromkeys([table.soil.adjusted] if known & {*READINGS} else [], _BY_READING)
    if table.soil.compaction is not None:
        with source.noting(("soil", "compaction")):
            _check_compaction(table, known)
        if "soil.density_ratio" in decided:
            source.note(("soil", "adjust"), "both the cone index and the compaction decide the density ratio: adjust"
                        " another property, or remove the compaction")  # fmt: skip
        decided["soil.density_ratio"] = "follows from the compaction: remove one of the two"
    if table.soil.name is not None:
        with source.noting(("soil", "name")):
            named_soil(table.soil.name)
    elif missing := [name for name in _required("soil") if name not in known and name not in decided]:
        names = ", ".join(f"'{IN_FILES[name].key}'" for name in missing)
        verb = "is" if len(missing) == 1 else "are"
        source.note(("soil",), f"{names} {verb} missing: give them in [soil], or the 'name' of a known soil")
    effects = table.effects
    random = [key for key in IN_FILES if IN_FILES[key].owner == RANDOM]
    excess = dict(decided)
    for law, (_, key) in CONTACTS.items():
        if effects.contact != law:
            excess[key] = f'belongs to contact = "{law}", which is not set in [effects]'
    if effects.orbit != "transient":
        excess["scene.duration"] = "is not used by a periodic orbit, whose duration is one wavelength: remove it"
    waves = [key for key in known if IN_FILES[key].owner in WAVES]
    if table.scene.average != "run" and (effects.orbit != "transient" or not waves):
        source.note(("scene", "average"), "'scene.average' = \"whole waves\" needs a transient over a strength wave")
    if at(table, RANDOM) is None:
        excess |= dict.fromkeys(random, f"belongs to {RANDOM}, which is missing: add it to [effects]")
    elif at(table, f"{RANDOM}.record") is not None:
        excess |= dict.fromkeys(random, "and a record are both given: remove one")
    for key in sorted({*excess} & known):
        source.note(("variables", key) if key in table.variables else key.split("."), f"'{key}' {excess[key]}")
    needed = [*_required("share", "scene"), *_wave_keys(source, table, known), *random]
    needed += ["effects.contact_width"] if effects.contact == "smooth" else []
    for key in needed:
        owner, _, name = key.rpartition(".")
        if key not in known | {*excess}:
            source.note(owner.split("."), f"'{name}' is missing: give it in [{owner}] or make '{key}' a variable")


def _wave_keys(source: Source, table: ProblemTable, known: set[str]) -> list[str]:
    """Return the quantities that the file's strength waves need; note a wave whose predecessor is missing."""
    keys: list[str] = []
    missing = ""
    for name in WAVES:
        own = sorted(key for key in known if IN_FILES[key].owner == name)
        given = at(table, name) is not None
        needed = [f"{name}.amplitude", f"{name}.wavelength"]
        if own and not given and not {*needed} <= {*own}:
            source.note(("variables", own[0]), f"'{own[0]}' belongs to {name}, which is missing: add it to [effects]")
        elif not own and not given:
            missing = missing or name
        else:
            keys += needed
            if missing:
                source.note(name.split("."), f"'{name}' is given without '{missing}': add that, or rename this to it")
    return keys


def _required(*owners: str) -> list[str]:
    """Return the quantities that a file must give in some of its tables."""
    return [name for name, quantity in IN_FILES.items() if quantity.required and quantity.owner in owners]


def check_measures(source: Source, table: ProblemTable, displays: dict[str, Display]) -> None:
    """Check objective and requirements, and record their units in ``displays``."""
    terms = [(("minimise", name), {"per": term.per}) for name, term in table.minimise.items()]
    limits = [(("require", name), limit.sides) for name, limit in table.require.items()]
    for place, sides in (*terms, *limits):
        with source.noting(place):
            _check_measure(source, place, table.scene.law, sides)
            for written in sides.values():
                displays[place[1]] = display_of(written, MEASURES[place[1]].unit)


def _check_measure(source: Source, place: Keys, law: ResistanceLaw, sides: Mapping[str, Any]) -> None:
    """Raise InputError if one term of the objective, or one requirement, is invalid."""
    kind, name = place
    _check_name(name, law, "minimised" if kind == "minimise" else "required", everywhere=kind == "require")
    unit = MEASURES[name].unit
    values = {side: source.parsed((*place, side), unit, one, f"'{name}' {side}") for side, one in sides.items()}
    if kind == "minimise" and values["per"] <= 0.0:
        raise source.error((*place, "per"), f"'{name}' per = {sides['per']} must be above 0")
    if kind == "require":
        check_limits(f"'{name}'", values.get("at_least"), values.get("at_most"), partial(in_words, unit=unit.symbol))


def _check_name(name: str, law: ResistanceLaw, verb: str, *more: str, everywhere: bool = False) -> None:
    """Raise InputError unless a name is a result that the law of resistance provides.

    Args:
        name: the name to check.
        law: the law of resistance.
        verb: what the file does with the result, for the message.
        *more: further valid names, for suggestions.
        everywhere: accept results that have a value at every output time.
    """
    allowed = [one for one, measure in MEASURES.items() if everywhere or not measure.everywhere]
    check_named(f"{{}} cannot be {verb}", name, [*allowed, *more])
    MEASURES[name].check(name, law)


def check_front(source: Source, table: ProblemTable) -> None:
    """Note every mistake in [trade_off], which must have two or three results."""
    count = len(table.goals)
    for name in table.goals:
        with source.noting(("trade_off", name)):
            _check_name(name, table.scene.law, "traded", "points")
    if table.trade_off is not None and count not in (2, 3) and {*table.goals} <= {*MEASURES}:
        more = "put the others into [require]" if count > 3 else f"give {TRADED}"
        source.note(("trade_off",), f"a front needs two or three results, not {count}: {more}")


def check_values(source: Source, problem: Problem) -> None:
    """Raise one InputError for all values and bounds outside the model's domain, with the line of each."""
    settings = problem.table.accuracy.model_dump(exclude_none=True)
    for name in settings:
        with source.noting(("accuracy", name)):
            Accuracy(**{"method": settings["method"], name: settings[name]})
    for key, value in problem.fixed.items():
        with source.noting(tuple(key.split(".")), prefix=f"{_quoted(source, key)}: "):
            _check_value(problem, key, value)
    for key, variable in problem.variables.items():
        for side in ("lower", "upper"):
            written = getattr(problem.table.variables[key], side)
            with source.noting(("variables", key, side), prefix=f"'{key}' {side} = {written}: "):
                _check_value(problem, key, getattr(variable, side))
    source.raise_noted()
    # Every value is valid by itself, so a remaining error is due to effects that exclude each other.
    with source.noting(("effects", "motion")):
        problem.scene()
    source.raise_noted()
    for kind, names in (("minimise", problem.table.minimise), ("require", problem.table.require),
                        ("trade_off", problem.table.goals)):  # fmt: skip
        for name in {*names} & {name for name in MEASURES if MEASURES[name].random}:
            with source.noting((kind, name), prefix=f"'{name}': "):
                problem.scene().check_stationary()
    source.raise_noted()
    check_joint(source, problem.table, lambda: problem.scene().soil)
    source.raise_noted()


def _check_value(problem: Problem, key: str, value: float) -> None:
    """Raise DomainError if a value is outside its domain.

    All other quantities take typical values and all effects their defaults, so that the message concerns this value.
    """
    IN_FILES[key].check(value)
    scene = problem.table.scene.model_copy(update={"medium": "plastic"})
    plain = problem.table.model_copy(update={"effects": EffectsFile(), "scene": scene})
    typical = {name: IN_FILES[name].typical for name in problem.values()}
    dataclasses.replace(problem, table=plain, fixed=typical, variables={}, course=None).scene({key: value})


def _quoted(source: Source, key: str) -> str:
    """Return a key with its value as written, for messages."""
    written = source.written(key)
    return f"'{key}'" if written is None else f"'{key}' = {written}"
