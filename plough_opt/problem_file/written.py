"""Problem files as they are written: a scene of Python as one, and the tables of one."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError, about
from plough_opt.core.expressions import as_number, holds_casadi
from plough_opt.core.quantities import EVERY
from plough_opt.laws import LAWS
from plough_opt.motion.effects import OWN_EFFECTS, Effects
from plough_opt.motion.scene import Scene, quantities_of
from plough_opt.problem_file.problem import FileVariable, Problem
from plough_opt.problem_file.reading import apply_override, read_source, variable_of
from plough_opt.problem_file.schema import CHOICES, CONTACTS, VariableTable
from plough_opt.problem_file.source import Source
from plough_opt.soil.geometry import Wedge
from plough_opt.soil.soil import named_soil, soil_names

_NAME = "design.toml"  # as the page that computes calls what it writes
# Difference that conversions of units leave, relative and, of differences of numbers near 1, absolute.
_UNITS_ROUNDING = 1e-14


def problem_of(scene: Scene, duration: float | None, title: str) -> Problem:
    """Return a numeric scene as the problem of a file without variables.

    Args:
        scene: the scene.
        duration: simulated time [s]; None for a periodic orbit.
        title: the file's title.

    Raises:
        InputError: the scene holds symbols, or something that a problem file cannot say; the message names it.
    """
    if holds_casadi(scene):
        raise InputError("the scene holds symbols: give one of numbers, such as best(scene) of an optimum")
    if not isinstance(scene.share, Wedge):
        raise InputError("a Cone cannot be written into a problem file: give the Wedge")
    values = {name: float(as_number(value)) for name, value in quantities_of(scene).items() if value is not None}
    values |= {"scene.frame_mass": values.pop("scene.mass"), "scene.steel_density": 0.0}
    values |= {} if duration is None else {"scene.duration": duration}
    name = next((name for name in soil_names() if named_soil(name) == scene.soil), None)
    entries: dict[str, Any] = {"title": title} | ({} if name is None else {"soil.name": name})
    for key, value in values.items():
        if EVERY[key].in_files and (name is None or EVERY[key].owner != "soil"):
            entries[key] = f"{value!r} {EVERY[key].unit}" if EVERY[key].unit else value
    if (profile := scene.effects.tow_profile) is not None:
        speeds = [f"{part * values['scene.tow_speed']!r} m/s" for part in profile.speeds]
        entries["scene.tow_speed"] = {"time": [f"{time!r} s" for time in profile.times], "speed": speeds}
    effects = scene.effects
    choices = {name: getattr(effects, name) for name in CHOICES if getattr(effects, name) != getattr(Effects, name)}
    choices |= [("contact", word) for word, (kind, _) in CONTACTS.items() if isinstance(effects.contact, kind)]
    choices |= {"own": [_fields("effect", OWN_EFFECTS, own) for own in effects.own]} if effects.own else {}
    entries |= {f"effects.{name}": value for name, value in choices.items()}
    if scene.medium != Scene.medium:
        entries["scene.medium"] = scene.medium if isinstance(scene.medium, str) else _fields("law", LAWS, scene.medium)
    lines = [f"{key} = {_toml(value)}" for key, value in entries.items()]
    with about("this scene cannot be written as a problem file:"):
        problem = read_source(Source("\n".join(lines) + "\n", _NAME), Path())
    read = problem.scene()
    soil = replace(read.soil, name=scene.soil.name, source=scene.soil.source)
    if different := next(_differences("scene", scene, replace(read, soil=soil)), None):
        raise InputError(f"this scene cannot be written as a problem file: {different}")
    # Units follow the size of the values, as in all results of Python.
    return replace(problem, displays={})


def _fields(key: str, registry: Mapping[str, type], value: Any) -> dict[str, Any]:
    """Return the fields of an effect or a law as a table that names its class."""
    name = next((name for name, kind in registry.items() if kind is type(value)), type(value).__name__)
    table: dict[str, Any] = {key: name}
    for field in fields(value):
        number, unit = getattr(value, field.name), field.metadata.get("unit")
        if number is not None:
            table[field.name] = number if unit is None else f"{float(number)!r} {unit}".strip()
    return table


def _toml(value: Any) -> str:
    """Return a value as TOML in one line."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(each)}' for key, each in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value if isinstance(value, bool | int | float | str) else shown(value))


def _differences(name: str, value: Any, other: Any) -> Iterator[str]:
    """Yield where two scenes differ by more than rounding."""
    if is_dataclass(value) and type(value) is type(other):
        for each in fields(value):
            yield from _differences(f"{name}.{each.name}", getattr(value, each.name), getattr(other, each.name))
    elif isinstance(value, tuple) and isinstance(other, tuple) and len(value) == len(other):
        for k, pair in enumerate(zip(value, other, strict=True)):
            yield from _differences(f"{name}[{k}]", *pair)
    elif isinstance(value, float) and isinstance(other, float):
        if not np.isclose(value, other, rtol=_UNITS_ROUNDING, atol=_UNITS_ROUNDING / 10.0):
            yield f"{name} = {value!r}"
    elif value != other:
        yield f"{name} = {shown(value)}"


def tables_of(problem: Problem) -> dict[str, Any]:
    """Return the tables of a problem's file as they are written, with its overrides; names of variables are keys."""
    source = Source(problem.text, problem.name)
    for text in problem.overrides:
        apply_override(source, text)
    return source.data


def fixed_variables(problem: Problem) -> dict[str, FileVariable]:
    """Return the variables of a problem's file that its overrides fix, as the file declares them."""
    source = Source(problem.text, problem.name)
    declared = {**source.data.get("variables", {})}.items()
    return {key: variable_of(source, key, VariableTable.model_validate(table)) for key, table in declared
            if key not in problem.variables}  # fmt: skip
