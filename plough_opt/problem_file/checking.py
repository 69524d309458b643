"""Checks of a problem file beyond its schema: missing and unused quantities, results, fronts, domains of values."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import is_count
from plough_opt.core.quantities import IN_FILES, READINGS, quantities
from plough_opt.core.units import Display, display_of
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.vocabulary import Measure
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import TRADED, Problem
from plough_opt.problem_file.schema import RANDOM, WAVES, EffectsFile, ProblemTable, at
from plough_opt.problem_file.source import Keys, Source
from plough_opt.problem_file.uncertain import check_joint
from plough_opt.soil.soil import named_soil

_FEWEST, _MOST = 5, 1000  # positions on a front


def check_complete(source: Source, table: ProblemTable, known: set[str]) -> None:
    """Note every missing quantity, and every quantity that nothing in the file uses.

    Args:
        source: the file.
        table: its tables.
        known: keys of the quantities that are given or are variables.
    """
    if not known <= {*quantities()}:
        return  # a misspelt variable is noted already; here it would be reported as missing too
    decided = {table.soil.adjusted} if known & {*READINGS} else set()
    if table.soil.name is not None:
        with source.noting(("soil", "name")):
            named_soil(table.soil.name)
    elif missing := [name for name in _required("soil") if name not in known | decided]:
        names = ", ".join(f"'{IN_FILES[name].key}'" for name in missing)
        verb = "is" if len(missing) == 1 else "are"
        source.note(("soil",), f"{names} {verb} missing: give them in [soil], or the 'name' of a known soil")
    effects = table.effects
    random = [key for key in IN_FILES if IN_FILES[key].owner == RANDOM]
    excess = dict.fromkeys(decided, "follows from the cone index: remove it, or set soil.adjust to another property")
    for key, law in (("effects.contact_width", "smooth"), ("effects.breakaway", "stick_slip")):
        if effects.contact != law:
            excess[key] = f'belongs to contact = "{law}", which is not set in [effects]'
    if effects.orbit != "transient":
        excess["scene.duration"] = "is not used by a periodic orbit, whose duration is one wavelength: remove it"
    if at(table, RANDOM) is None:
        excess |= dict.fromkeys(random, f"belongs to {RANDOM}, which is missing: add it to [effects]")
    elif at(table, f"{RANDOM}.record") is not None:
        excess |= dict.fromkeys(random, "and a record are both given: remove one")
    for key in sorted({*excess} & known):
        source.note(("variables", key) if key in table.variables else key.split("."), f"'{key}' {excess[key]}")
    if effects.orbit != "harmonic_balance" and "harmonics" in effects.model_fields_set:
        source.note(("effects", "harmonics"), "'effects.harmonics' belongs to orbit = \"harmonic_balance\"")
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
    """Raise InputError if one term of the objective, or one requirement, is invalid."""
    kind, name = place
    _check_name(known, name, law, "minimised" if kind == "minimise" else "required", everywhere=kind == "require")
    unit = known[name].unit
    values = {side: source.parsed((*place, side), unit, one, f"'{name}' {side}") for side, one in sides.items()}
    if kind == "minimise" and values["per"] <= 0.0:
        raise source.error((*place, "per"), f"'{name}' per = {sides['per']} must be above 0")
    if kind == "require" and not values:
        raise InputError(f"'{name}' has no limit: give at_least, at_most or both")
    if values.get("at_least", -math.inf) > values.get("at_most", math.inf):
        ends = f"at least {sides['at_least']} is above at most {sides['at_most']}"
        raise InputError(f"the limits of '{name}' contradict each other: {ends}")


def _check_name(
    known: Mapping[str, Measure], name: str, law: ResistanceLaw, verb: str, *more: str, everywhere: bool = False
) -> None:
    """Raise InputError unless a name is a result that the law of resistance provides.

    Args:
        known: name -> each result.
        name: the name to check.
        law: the law of resistance.
        verb: what the file does with the result, for the message.
        *more: further valid names, for suggestions.
        everywhere: accept results that have a value at every output time.
    """
    allowed = [one for one, measure in known.items() if everywhere or not measure.everywhere]
    if name not in allowed:
        raise InputError(f"'{name}' cannot be {verb}: {nearest(name, [*allowed, *more])}")
    known[name].check(name, law)


def check_front(source: Source, table: ProblemTable) -> None:
    """Note every mistake in [trade_off], which must have two or three results and may have a number of points."""
    known, front = measures_of(table), table.trade_off or {}
    for name, entry in front.items():
        with source.noting(("trade_off", name)):
            if name != "points":
                _check_goal(source, table, known, name, entry)
            elif isinstance(entry, bool) or not is_count(entry) or not _FEWEST <= entry <= _MOST:
                raise InputError(f"'trade_off.points' = {entry!r} must be a whole number from {_FEWEST} to {_MOST}")
    count = sum(name != "points" for name in front)
    if table.trade_off is not None and count not in (2, 3) and {*front} <= {*known, "points"}:
        more = "put the others into [require]" if count > 3 else f"give {TRADED}"
        source.note(("trade_off",), f"a front needs two or three results, not {count}: {more}")


def _check_goal(source: Source, table: ProblemTable, known: Mapping[str, Measure], name: str, entry: Any) -> None:
    """Raise InputError if one result in [trade_off] is invalid."""
    _check_name(known, name, table.scene.law, "traded", "points")
    if not isinstance(entry, dict):
        raise InputError(f"'trade_off.{name}' must be {{}} or {{ maximise = true }}, not {entry!r}")
    for key, value in entry.items():
        if key != "maximise":
            wrong = f"is not a known key: {nearest(key, ['maximise'])}"
        elif not isinstance(value, bool):
            wrong = f"= {value!r} must be true or false"
        else:
            continue
        raise source.error(("trade_off", name, key), f"'trade_off.{name}.{key}' {wrong}")


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
    known = measures_of(problem.table)
    for kind in ("minimise", "require", "trade_off"):
        for name in {*(getattr(problem.table, kind) or ())} & {name for name in known if known[name].random}:
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
    dataclasses.replace(problem, table=plain, fixed=typical, variables={}).scene({key: value})


def _quoted(source: Source, key: str) -> str:
    """Return a key with its value as written, for messages."""
    written = source.written(key)
    return f"'{key}'" if written is None else f"'{key}' = {written}"
