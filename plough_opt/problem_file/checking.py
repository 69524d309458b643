"""Checks of a problem file that its schema cannot make: what needs what, measures, fronts, domains."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import is_count
from plough_opt.core.quantities import IN_FILES, READINGS, quantities
from plough_opt.core.units import Display, display_of
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.vocabulary import Measure
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import TRADED, Problem
from plough_opt.problem_file.schema import RANDOM, WAVES, EffectsFile, ProblemTable, at
from plough_opt.problem_file.source import Keys, Source
from plough_opt.problem_file.uncertain import check_joint
from plough_opt.soil.soil import named_soil

_FEWEST, _MOST = 5, 1000  # positions on a front


def check_complete(source: Source, table: ProblemTable, known: set[str]) -> None:
    """Note every quantity that is neither given nor a variable, and every one that nothing in the file needs."""
    if not known <= {*quantities()}:
        return  # a misspelt variable is noted already, and would be missing here once more
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
    excess = dict.fromkeys(decided, "follows from the cone index: leave it out, or let that adjust another property")
    for key, law in (("effects.contact_width", "smooth"), ("effects.breakaway", "stick_slip")):
        if effects.contact != law:
            excess[key] = f'belongs to contact = "{law}", which [effects] does not ask for'
    if effects.orbit != "transient":
        orbit = "is needless: a lasting orbit has a duration of its own, one wavelength: leave it out"
        excess["scene.duration"] = orbit
    if at(table, RANDOM) is None:
        excess |= dict.fromkeys(random, f"has no {RANDOM} to belong to: give that in [effects]")
    elif at(table, f"{RANDOM}.record") is not None:
        excess |= dict.fromkeys(random, "and a record are given: take one")
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
    """Return the quantities that the file's strength waves must have; note a wave that misses those before it."""
    keys: list[str] = []
    missing = ""
    for name in WAVES:
        own = sorted(key for key in known if IN_FILES[key].owner == name)
        given = at(table, name) is not None
        needed = [f"{name}.amplitude", f"{name}.wavelength"]
        if own and not given and not {*needed} <= {*own}:
            source.note(("variables", own[0]), f"'{own[0]}' has no {name} to belong to: give that in [effects]")
        elif not own and not given:
            missing = missing or name
        else:
            keys += needed
            if missing:
                source.note(name.split("."), f"'{name}' is there without '{missing}': give that one first")
    return keys


def _required(*owners: str) -> list[str]:
    """Return the quantities that a file must have in some of its tables."""
    return [name for name, quantity in IN_FILES.items() if quantity.required and quantity.owner in owners]


def check_measures(source: Source, table: ProblemTable, displays: dict[str, Display]) -> None:
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
    """Refuse a name that is not a result which a law gives, or which has a value at every output time."""
    allowed = [one for one, measure in known.items() if everywhere or not measure.everywhere]
    if name not in allowed:
        raise InputError(f"'{name}' cannot be {verb}: {nearest(name, [*allowed, *more])}")
    known[name].check(name, law)


def check_front(source: Source, table: ProblemTable) -> None:
    """Note everything that is wrong in [trade_off]: two or three results, and a number of points."""
    known, front = measures_of(table), table.trade_off or {}
    for name, entry in front.items():
        with source.noting(("trade_off", name)):
            if name != "points":
                _check_goal(source, table, known, name, entry)
            elif isinstance(entry, bool) or not is_count(entry) or not _FEWEST <= entry <= _MOST:
                raise InputError(f"'trade_off.points' = {entry!r} must be a whole number from {_FEWEST} to {_MOST}")
    count = sum(name != "points" for name in front)
    if table.trade_off is not None and count not in (2, 3) and {*front} <= {*known, "points"}:
        how = {0: "of nothing", 1: "of one alone"}.get(count, f"of {count} results")
        more = ": put the others into [require]" if count > 3 else f": give {TRADED}"
        source.note(("trade_off",), f"a front is drawn of two or three results, not {how}{more}")


def _check_goal(source: Source, table: ProblemTable, known: Mapping[str, Measure], name: str, entry: Any) -> None:
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
    for kind in ("minimise", "require", "trade_off"):
        for name in {*(getattr(problem.table, kind) or ())} & {name for name in known if known[name].random}:
            with source.noting((kind, name), prefix=f"'{name}': "):
                problem.scene().check_stationary()
    source.raise_noted()
    check_joint(source, problem.table, lambda: problem.scene().soil)
    source.raise_noted()


def _check_value(problem: Problem, key: str, value: float) -> None:
    """Refuse a value outside its domain, whatever the others are."""
    IN_FILES[key].check(value)
    scene = problem.table.scene.model_copy(update={"medium": "plastic"})
    plain = problem.table.model_copy(update={"effects": EffectsFile(), "scene": scene})
    typical = {name: IN_FILES[name].typical for name in problem.values()}
    dataclasses.replace(problem, table=plain, fixed=typical, variables={}).scene({key: value})


def _quoted(source: Source, key: str) -> str:
    """Return a key with what the file says at it."""
    written = source.written(key)
    return f"'{key}'" if written is None else f"'{key}' = {written}"
