"""Reading a problem file: everything that is wrong in it is listed, each mistake with its line."""

import copy
import dataclasses
import math
import re
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plough_opt.core.checks import check_kind, path_of
from plough_opt.core.errors import InputError, nearest, short
from plough_opt.core.quantities import IN_FILES, READINGS, quantities
from plough_opt.core.units import Display, display_of
from plough_opt.design import Over
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.vocabulary import Measure
from plough_opt.problem_file.frame import joined
from plough_opt.problem_file.front import TABLE, check_front
from plough_opt.problem_file.overrides import apply_override
from plough_opt.problem_file.own_measures import check_own, display_of_own, measures_of
from plough_opt.problem_file.penetrometer import average_readings
from plough_opt.problem_file.problem import FileVariable, Problem
from plough_opt.problem_file.schema import (
    RANDOM,
    WAVES,
    EffectsFile,
    LimitTable,
    ProblemFile,
    ProblemTable,
    RandomStrengthFile,
    StrengthWaveFile,
    TermTable,
    VariableTable,
)
from plough_opt.problem_file.shares import TABLE as TABLE_OF_SHARES
from plough_opt.problem_file.shares import choose_share, join_dotted_variables, names_of_shares
from plough_opt.problem_file.source import Keys, Source
from plough_opt.problem_file.strength_file import spectrum_of_file
from plough_opt.problem_file.uncertain import check_joint, check_uncertain, join_dotted
from plough_opt.soil.soil import named_soil

_PER_CENT = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*%\s*")


def read_problem(path: str | Path, overrides: Iterable[str] = ()) -> Problem:
    """Read and check a problem file.

    Args:
        path: the file.
        overrides: changes such as ``'scene.tow_speed="2.5 m/s"'``; one that names a variable fixes it.

    Raises:
        InputError: the file does not exist, is not TOML, or holds something that cannot be; the message gives file,
            line, key, what was expected and the nearest valid name, for everything that is wrong in a table.

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
        parts[name] = _read(view, Path(path).parent, notes, (*overrides, f"{TABLE_OF_SHARES}={name}"))
    return joined(parts, own, overrides)


def _read(source: Source, folder: Path, notes: tuple[str, ...], overrides: tuple[str, ...]) -> Problem:
    """Return what a file says of one share."""
    join_dotted_variables(source.data)
    join_dotted(source.data)
    over = _over(source)
    readings = average_readings(source, folder)
    spectrum = spectrum_of_file(source, folder)
    try:
        table = ProblemFile.model_validate(source.data)
    except ValidationError as error:
        source.note_schema(error, _valid_keys())
    source.raise_noted()
    problem = dataclasses.replace(
        _checked(source, table, notes), over=over, readings=readings, spectrum=spectrum, text=source.text,
        data=source.read_files, overrides=overrides,
    )  # fmt: skip
    source.raise_noted()
    _check_values(source, problem)
    source.raise_noted()
    return problem


def check_changed(problem: Problem) -> None:
    """Refuse a problem whose quantities were changed after it was read, as a file that has them is refused.

    Raises:
        InputError: a quantity that belongs to an effect that is off, or one outside the model's domain.
    """
    if problem.shares:
        problem.scene()  # which says to choose one
    source = Source("", problem.name)
    _check_complete(source, problem.table, {*problem.fixed, *problem.variables})
    source.raise_noted()
    _check_values(source, problem)
    source.raise_noted()


def _over(source: Source) -> Over | None:
    """Take over = "worst" or "mean" out of [minimise], whose other keys are results."""
    table = source.data.get("minimise")
    written = table.pop("over", None) if isinstance(table, dict) else None
    with source.noting(("minimise", "over")):
        if written not in (None, "worst", "mean"):
            raise InputError(f'over = {short(repr(written))} must be "worst" or "mean", within the tolerances')
        if written is not None and source.data.get("uncertain") is not None:
            raise InputError("over takes the design within its tolerances in one soil: leave it out, or [uncertain]")
    return typing.cast("Over | None", written)


def _valid_keys() -> dict[str, list[str]]:
    valid = {"": list(ProblemFile.model_fields)}
    for name, field in ProblemFile.model_fields.items():
        model = field.annotation
        if isinstance(model, type) and hasattr(model, "model_fields"):
            valid[name] = list(model.model_fields)
    valid[RANDOM] = list(RandomStrengthFile.model_fields)
    valid |= {name: list(StrengthWaveFile.model_fields) for name in WAVES}
    for table, model in (("variables", VariableTable), ("minimise", TermTable), ("require", LimitTable)):
        valid[table] = list(model.model_fields)
    return valid


def _checked(source: Source, table: ProblemTable, notes: tuple[str, ...]) -> Problem:
    """Check names and bounds that the schema cannot, and collect the quantities."""
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
        value, written = _at(table, key), _raw(source.data, key)
        if key in table.variables:
            with source.noting(("variables", key)):
                if written is not None:
                    raise InputError(f"'{key}' is a variable and has a fixed value too: remove one")
        elif value is not None:
            fixed[key] = value
            if written is not None:
                displays[key] = display_of(written, unit)
    _check_complete(source, table, {*fixed, *table.variables})
    if check_own(source, table):  # what names results needs to know them
        displays |= {name: display_of_own(own.unit) for name, own in table.measures.items()}
        _check_measures(source, table, displays)
        check_uncertain(source, table)
        if table.trade_off is not None:
            check_front(source, table.trade_off, table.scene.law, measures_of(table))
    return Problem(source.name, table, fixed, variables, displays, notes)


def _at(table: Any, key: str) -> Any:
    """Return what a dotted key holds, or None."""
    for part in key.split("."):
        table = getattr(table, part) if table is not None else None
    return table


def _raw(data: Any, key: str) -> object:
    """Return what the file says at a dotted key, or None."""
    for part in key.split("."):
        data = data.get(part) if isinstance(data, dict) else None
    return data


def _variable(source: Source, key: str, declared: VariableTable) -> FileVariable:
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
    middle = math.sqrt(lower * upper) if declared.log else (lower + upper) / 2.0
    guess = bounds.get("guess", middle)
    if not lower <= guess <= upper:
        raise InputError(
            f"the guess {declared.guess} of '{key}' lies outside its bounds {declared.lower} to {declared.upper}"
        )
    tolerance = _tolerance(source, key, declared.tolerance)
    return FileVariable(lower, upper, guess, declared.log, unit.symbol, display_of(declared.lower, unit), tolerance)


def _tolerance(source: Source, key: str, written: str | float | None) -> float | str | None:
    """Return a half width in SI, or a part of the value in per cent as it is written."""
    place = ("variables", key, "tolerance")
    if written is None or (isinstance(written, str) and _PER_CENT.fullmatch(written)):
        return written
    more = ', or as a part of the value like "0.5 %"'
    half = source.parsed(place, quantities()[key], written, f"'{key}' tolerance", more)
    if half < 0.0:
        raise source.error(place, f"'{key}' tolerance = {written} must not be below 0")
    return half


def _check_complete(source: Source, table: ProblemTable, known: set[str]) -> None:
    """Note every quantity that is neither given nor a variable, and every one that nothing in the file needs."""
    if not known <= {*quantities()}:
        return  # a misspelt variable is noted already, and would be missing here once more
    decided = {table.soil.adjusted} if known & {*READINGS} else set()
    if table.soil.name is not None:
        with source.noting(("soil", "name")):
            named_soil(table.soil.name)
    elif missing := [name for name in _required("soil") if name not in known | decided]:
        with source.noting(("soil",)):
            names = ", ".join(f"'{IN_FILES[name].key}'" for name in missing)
            verb = "is" if len(missing) == 1 else "are"
            raise InputError(f"{names} {verb} missing: give them in [soil], or the 'name' of a known soil")
    effects = table.effects
    random = [key for key in IN_FILES if IN_FILES[key].owner == RANDOM]
    excess = dict.fromkeys(decided, "follows from the cone index: leave it out, or let that adjust another property")
    for key, law in (("effects.contact_width", "smooth"), ("effects.breakaway", "stick_slip")):
        if effects.contact != law:
            excess[key] = f'belongs to contact = "{law}", which [effects] does not ask for'
    if effects.orbit != "transient":
        excess["scene.duration"] = (
            "is needless: a lasting orbit has a duration of its own, one wavelength: leave it out"
        )
    if _at(table, RANDOM) is None:
        excess |= dict.fromkeys(random, f"has no {RANDOM} to belong to: give that in [effects]")
    elif _at(table, f"{RANDOM}.record") is not None:
        excess |= dict.fromkeys(random, "and a record are given: take one")
    for key in sorted({*excess} & known):
        with source.noting(("variables", key) if key in table.variables else tuple(key.split("."))):
            raise InputError(f"'{key}' {excess[key]}")
    if effects.orbit != "harmonic_balance" and "harmonics" in effects.model_fields_set:
        with source.noting(("effects", "harmonics")):
            raise InputError("'effects.harmonics' belongs to orbit = \"harmonic_balance\"")
    needed = [*_required("share", "scene"), *_wave_keys(source, table, known), *random]
    needed += ["effects.contact_width"] if effects.contact == "smooth" else []
    for key in needed:
        owner, _, name = key.rpartition(".")
        if key not in known | {*excess}:
            with source.noting(tuple(owner.split("."))):
                raise InputError(f"'{name}' is missing: give it in [{owner}] or make '{key}' a variable")


def _wave_keys(source: Source, table: ProblemTable, known: set[str]) -> list[str]:
    """Return the quantities that the file's strength waves must have; note a wave that misses those before it."""
    keys: list[str] = []
    missing = ""
    for name in WAVES:
        own = sorted(key for key in known if IN_FILES[key].owner == name)
        given = _at(table, name) is not None
        needed = [f"{name}.amplitude", f"{name}.wavelength"]
        if own and not given and not {*needed} <= {*own}:
            with source.noting(("variables", own[0])):
                raise InputError(f"'{own[0]}' has no {name} to belong to: give that in [effects]")
            continue
        if (own or given) and missing:
            with source.noting(tuple(name.split("."))):
                raise InputError(f"'{name}' is there without '{missing}': give that one first")
        missing = missing or ("" if own or given else name)
        keys += needed if own or given else []
    return keys


def _required(*owners: str) -> list[str]:
    """Return the quantities that a file must have in some of its tables."""
    return [name for name, quantity in IN_FILES.items() if quantity.required and quantity.owner in owners]


def _check_measures(source: Source, table: ProblemTable, displays: dict[str, Display]) -> None:
    """Check objective and requirements, and note the units they are written in."""
    known = measures_of(table)
    terms = [(("minimise", name), {"per": term.per}) for name, term in table.minimise.items()]
    limits = [(("require", name), limit.sides) for name, limit in table.require.items()]
    for place, sides in (*terms, *limits):
        with source.noting(place):
            _check_measure(source, place, table.scene.law, sides, known)
            for written in sides.values():
                displays[place[1]] = display_of(written, known[place[1]].unit)


def _check_measure(
    source: Source, place: Keys, law: ResistanceLaw, sides: Mapping[str, Any], known: Mapping[str, Measure]
) -> None:
    """Check one term of the objective, or one requirement."""
    kind, name = place
    allowed = [m for m, measure in known.items() if kind == "require" or not measure.everywhere]
    if name not in allowed:
        verb = "minimised" if kind == "minimise" else "required"
        raise InputError(f"'{name}' cannot be {verb}: {nearest(name, allowed)}")
    known[name].check(name, law)
    unit = known[name].unit
    values = {side: source.parsed((*place, side), unit, one, f"'{name}' {side}") for side, one in sides.items()}
    if kind == "minimise" and values["per"] <= 0.0:
        raise source.error((*place, "per"), f"'{name}' per = {sides['per']} must be above 0")
    if kind == "require" and not values:
        raise InputError(f"'{name}' has no limit: give at_least, at_most or both")
    if values.get("at_least", -math.inf) > values.get("at_most", math.inf):
        raise InputError(
            f"the limits of '{name}' contradict each other: at least {sides['at_least']} is above at most"
            f" {sides['at_most']}"
        )


def _check_values(source: Source, problem: Problem) -> None:
    """Refuse values, guesses and bounds outside the model's domain, each with the line that sets it."""
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
    # What is left are effects that exclude each other.
    with source.noting(("effects", "motion")):
        problem.scene()
    source.raise_noted()
    known = measures_of(problem.table)
    for kind in ("minimise", "require", TABLE):
        for name in {*(getattr(problem.table, kind) or ())} & {name for name in known if known[name].random}:
            with source.noting((kind, name), prefix=f"'{name}': "):
                problem.scene().check_stationary()
    source.raise_noted()
    check_joint(source, problem.table, lambda: problem.scene().soil)


def _check_value(problem: Problem, key: str, value: float) -> None:
    """Refuse a value outside its domain, whatever the others are."""
    IN_FILES[key].check(value)
    alone = dataclasses.replace(problem, fixed={k: IN_FILES[k].typical for k in problem.values()}, variables={})
    scene = problem.table.scene.model_copy(update={"medium": "plastic"})
    plain = problem.table.model_copy(update={"effects": EffectsFile(), "scene": scene})
    alone = dataclasses.replace(alone, table=plain)
    alone.scene({key: value})


def _quoted(source: Source, key: str) -> str:
    """Return a key with what the file says at it."""
    written = _raw(source.data, key)
    return f"'{key}'" if written is None else f"'{key}' = {written}"
