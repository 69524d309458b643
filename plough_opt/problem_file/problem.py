"""Problem: a file read, checked and turned into a scene or a design."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plough_opt.accuracy import Accuracy
from plough_opt.design import Design, Optimum, Progress
from plough_opt.errors import InputError, nearest
from plough_opt.expressions import Expression
from plough_opt.geometry import Wedge
from plough_opt.motion import Run, simulate
from plough_opt.problem_file.measures import MEASURES
from plough_opt.problem_file.overrides import apply_override
from plough_opt.problem_file.schema import ProblemTable, quantities
from plough_opt.problem_file.source import Keys, Source
from plough_opt.problem_file.units import Display, display_of
from plough_opt.scene import Effects, Scene, StrengthWave
from plough_opt.soil import Soil, named_soil

# Names by which the physics refuses a value -> the key that sets it.
_PLACES: dict[str, Keys] = {
    "soil density": ("soil", "density"),
    "density ratio b1": ("soil", "density_ratio"),
    "cohesion": ("soil", "cohesion"),
    "friction angle": ("soil", "friction_angle"),
    "tool friction": ("soil", "tool_friction"),
    "ambient pressure": ("soil", "ambient_pressure"),
    "Young's modulus": ("soil", "youngs_modulus"),
    "Poisson's ratio": ("soil", "poisson_ratio"),
    "wedge angle": ("share", "wedge_angle"),
    "chisel angle": ("share", "chisel_angle"),
    "share height": ("share", "height"),
    "stiffness": ("scene", "stiffness"),
    "mass": ("scene", "frame_mass"),
    "tow speed": ("scene", "tow_speed"),
    "duration": ("scene", "duration"),
    "density of the share's material": ("scene", "steel_density"),
    "strength wave amplitude": ("effects", "strength_wave", "amplitude"),
    "strength wavelength": ("effects", "strength_wave", "wavelength"),
    "tow ramp": ("effects", "tow_ramp"),
    "damping": ("effects", "damping"),
    "rate term": ("effects", "rate_term"),
}
_REQUIRED = ("share.wedge_angle", "share.chisel_angle", "share.height", "scene.stiffness", "scene.frame_mass",
             "scene.tow_speed")  # fmt: skip
_SOIL_REQUIRED = ("density", "density_ratio", "cohesion", "friction_angle", "tool_friction")


@dataclass(frozen=True)
class FileVariable:
    """A variable as the file declares it, SI."""

    lower: float
    upper: float
    guess: float
    log: bool
    unit: str
    display: Display


@dataclass(frozen=True)
class Problem:
    """A design question from a file.

    Attributes:
        name: the file's name.
        table: the file's tables, validated, quantities in SI.
        fixed: key such as "share.height" -> its value, SI, for every quantity that is no variable.
        variables: key -> bounds and guess.
        displays: key or measure -> the unit in which the file writes it.
        notes: what overrides changed beyond their own key.
    """

    name: str
    table: ProblemTable
    fixed: Mapping[str, float]
    variables: Mapping[str, FileVariable]
    displays: Mapping[str, Display]
    notes: tuple[str, ...]
    source: Source

    @property
    def title(self) -> str:
        """The file's title."""
        return self.table.title

    @property
    def accuracy(self) -> Accuracy:
        """Method and setting, or error to reach."""
        return Accuracy(**self.table.accuracy.model_dump())

    def values(self, changes: Mapping[str, Expression] | None = None) -> dict[str, Expression]:
        """Return every quantity by key: fixed values, guesses of variables, and changes to either."""
        return {**self.fixed, **{key: v.guess for key, v in self.variables.items()}, **(changes or {})}

    def scene(self, changes: Mapping[str, Expression] | None = None) -> Scene:
        """Return the scene with the variables at their guesses, or with changed values, numbers or symbols."""
        values = self.values(changes)
        share = Wedge(
            angle=values["share.wedge_angle"],
            chisel_angle=values["share.chisel_angle"],
            height=values["share.height"],
        )
        steel = share.equivalent_cone().solid_mass(values["scene.steel_density"])
        return Scene(
            soil=self._soil(values),
            share=share,
            stiffness=values["scene.stiffness"],
            mass=values["scene.frame_mass"] + steel,
            tow_speed=values["scene.tow_speed"],
            effects=self._effects(values),
        )

    def _soil(self, values: Mapping[str, Expression]) -> Soil:
        own = {key.removeprefix("soil."): value for key, value in values.items() if key.startswith("soil.")}
        name = self.table.soil.name
        if name is None:
            return Soil(**own, name="the soil of this file", source=f"values in {self.name}")
        base = named_soil(name)
        if not own:
            return base
        changed = ", ".join(sorted(own))
        properties = {f: getattr(base, f) for f in base.__dataclass_fields__} | own
        return Soil(**(properties | {"source": f"{base.source}; changed in {self.name}: {changed}"}))

    def _effects(self, values: Mapping[str, Expression]) -> Effects:
        table = self.table.effects
        wave = None
        if table.strength_wave is not None:
            wave = StrengthWave(
                amplitude=values["effects.strength_wave.amplitude"],
                wavelength=values["effects.strength_wave.wavelength"],
            )
        return Effects(
            motion=table.motion,
            inertial_drag=table.inertial_drag,
            added_mass=table.added_mass,
            ambient_pressure=table.ambient_pressure,
            contact=table.contact,
            start=table.start,
            strength_wave=wave,
            tow_ramp=values.get("effects.tow_ramp"),
            damping=values.get("effects.damping"),
            rate_term=values.get("effects.rate_term"),
        )

    def simulate(self, changes: Mapping[str, float] | None = None) -> Run:
        """Simulate the scene of `scene`."""
        values = self.values(changes)
        return simulate(
            self.scene(changes), values["scene.duration"], accuracy=self.accuracy, outputs=self.table.scene.outputs
        )

    def design(self) -> tuple[Design, Run]:
        """Return the design and its symbolic run.

        Raises:
            InputError: the file has no variables or nothing to minimise.
        """
        if not self.variables:
            raise InputError(f"{self.name}: nothing to choose: a [variables] table is missing")
        if not self.table.minimise:
            raise InputError(f"{self.name}: nothing to minimise: a [minimise] table is missing")
        design = Design()
        symbols = {
            key: design.variable(key, guess=v.guess, lower=v.lower, upper=v.upper, unit=v.unit, log=v.log)
            for key, v in self.variables.items()
        }
        values = self.values(symbols)
        run = simulate(
            self.scene(symbols), values["scene.duration"], accuracy=self.accuracy, outputs=self.table.scene.outputs
        )
        objective: Expression = 0.0
        for name, term in self.table.minimise.items():
            objective = objective + MEASURES[name].of(run) / MEASURES[name].unit.parse(term.per)
        design.minimise(objective)
        for name, limit in self.table.require.items():
            measure = MEASURES[name]
            low, high = (None if side is None else measure.unit.parse(side) for side in (limit.at_least, limit.at_most))
            design.require(name, measure.of(run), at_least=low, at_most=high, unit=measure.unit.symbol)
        return design, run

    def optimise(self, progress: Progress | None = None) -> tuple[Optimum, Run]:
        """Return the optimum and its run of numbers."""
        design, run = self.design()
        best = design.solve(progress=progress)
        return best, best(run)


def read_problem(path: str | Path, overrides: Iterable[str] = ()) -> Problem:
    """Read and check a problem file.

    Args:
        path: the file.
        overrides: changes such as ``'scene.tow_speed="2.5 m/s"'``; one that names a variable fixes it.

    Raises:
        InputError: the file does not exist, is not TOML, or holds something that cannot be; the message gives file,
            line, key, what was expected and the nearest valid name, for everything that is wrong in a table.
    """
    source = Source.read(Path(path))
    notes = tuple(note for text in overrides if (note := apply_override(source, text)))
    try:
        table = ProblemTable.model_validate(source.data)
    except ValidationError as error:
        raise source.explain(error, _valid_keys()) from None
    problem = _checked(source, table, notes)
    _check_values(problem)
    return problem


def _valid_keys() -> dict[str, list[str]]:
    valid = {"": list(ProblemTable.model_fields)}
    for name, field in ProblemTable.model_fields.items():
        model = field.annotation
        if isinstance(model, type) and hasattr(model, "model_fields"):
            valid[name] = list(model.model_fields)
    valid["effects.strength_wave"] = ["amplitude", "wavelength"]
    for table, keys in (("variables", ["lower", "upper", "guess", "log"]), ("minimise", ["per"]),
                        ("require", ["at_least", "at_most"])):  # fmt: skip
        valid[table] = keys
    return valid


def _checked(source: Source, table: ProblemTable, notes: tuple[str, ...]) -> Problem:
    """Check names and bounds that the schema cannot, and collect the quantities."""
    units = quantities()
    variables: dict[str, FileVariable] = {}
    displays: dict[str, Display] = {}
    for key, declared in table.variables.items():
        place = ("variables", key)
        if key not in units:
            raise source.error(place, f"'{key}' cannot be a variable: {nearest(key, units)}")
        with source.blaming(place):
            variables[key] = _variable(key, declared)
        displays[key] = variables[key].display
    fixed: dict[str, float] = {}
    for key, unit in units.items():
        value, written = _at(table, key), _raw(source.data, key)
        if value is None:
            continue
        if key in variables:
            if written is not None:
                raise source.error(("variables", key), f"'{key}' is a variable and has a fixed value too: remove one")
            continue
        fixed[key] = value
        if written is not None:
            displays[key] = display_of(written, unit)
    _check_complete(source, table, {*fixed, *variables})
    _check_measures(source, table, displays)
    return Problem(source.name, table, fixed, variables, displays, notes, source)


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


def _variable(key: str, declared: Any) -> FileVariable:
    unit = quantities()[key]
    bounds = {}
    for side in ("lower", "upper", "guess"):
        written = getattr(declared, side)
        if written is None:
            continue
        try:
            bounds[side] = unit.parse(written)
        except InputError as error:
            raise InputError(f"'{key}' {side} {error}") from None
    lower, upper = bounds["lower"], bounds["upper"]
    if not lower < upper:
        raise InputError(f"the bounds of '{key}' contradict each other: lower {declared.lower} is not below upper"
                         f" {declared.upper}")  # fmt: skip
    if declared.log and lower <= 0.0:
        raise InputError(f"'{key}' is log-scaled and needs a lower bound above 0, not {declared.lower}")
    middle = math.sqrt(lower * upper) if declared.log else (lower + upper) / 2.0
    guess = bounds.get("guess", middle)
    if not lower <= guess <= upper:
        raise InputError(f"the guess {declared.guess} of '{key}' lies outside its bounds {declared.lower} to"
                         f" {declared.upper}")  # fmt: skip
    display = display_of(declared.lower, unit)
    return FileVariable(lower, upper, guess, declared.log, unit.symbol, display)


def _check_complete(source: Source, table: ProblemTable, known: set[str]) -> None:
    for key in _REQUIRED:
        if key not in known:
            owner, name = key.split(".")
            raise source.error((owner,), f"'{name}' is missing: give it in [{owner}] or make '{key}' a variable")
    if table.soil.name is None:
        for name in _SOIL_REQUIRED:
            if f"soil.{name}" not in known:
                raise source.error(("soil",), f"'{name}' is missing: give it, or the 'name' of a known soil")
    else:
        with source.blaming(("soil", "name")):
            named_soil(table.soil.name)


def _check_measures(source: Source, table: ProblemTable, displays: dict[str, Display]) -> None:
    """Check objective and requirements, and note the units they are written in."""
    for kind, entries in (("minimise", table.minimise), ("require", table.require)):
        for name, entry in entries.items():
            place = (kind, name)
            allowed = [m for m, measure in MEASURES.items() if kind == "require" or not measure.everywhere]
            if name not in allowed:
                verb = "minimised" if kind == "minimise" else "required"
                raise source.error(place, f"'{name}' cannot be {verb}: {nearest(name, allowed)}")
            for side, written in entry.model_dump().items():
                if written is None:
                    continue
                with source.blaming((*place, side)):
                    try:
                        value = MEASURES[name].unit.parse(written)
                    except InputError as error:
                        raise InputError(f"'{name}' {side} {error}") from None
                    if side == "per" and value <= 0.0:
                        raise InputError(f"'{name}' per = {written} must be above 0")
                displays[name] = display_of(written, MEASURES[name].unit)
    for name, limit in table.require.items():
        low, high = (None if x is None else MEASURES[name].unit.parse(x) for x in (limit.at_least, limit.at_most))
        if low is None and high is None:
            raise source.error(("require", name), f"'{name}' has no limit: give at_least, at_most or both")
        if low is not None and high is not None and low > high:
            raise source.error(
                ("require", name),
                f"the limits of '{name}' contradict each other: at least {limit.at_least} is above at most"
                f" {limit.at_most}",
            )


def _check_values(problem: Problem) -> None:
    """Refuse values, guesses and bounds outside the model's domain, each with the line that sets it."""
    places = {name: ("variables", ".".join(keys)) if ".".join(keys) in problem.variables else keys
              for name, keys in _PLACES.items()}  # fmt: skip
    source = problem.source
    with source.blaming(("accuracy",)):
        _ = problem.accuracy
    with source.blaming(("effects",), places):
        problem.scene()
    for key, variable in problem.variables.items():
        for bound in (variable.lower, variable.upper):
            with source.blaming(("variables", key), places):
                problem.scene({key: bound})
