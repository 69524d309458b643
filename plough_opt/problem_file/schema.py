"""What a problem file may contain, table by table; every quantity is kept in SI."""

from __future__ import annotations

import typing
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictFloat, StrictInt, StrictStr

from plough_opt.effects import MOST_HARMONICS, Effects, HarmonicBalance
from plough_opt.problem_file.units import Unit
from plough_opt.scene import Scene
from plough_opt.vocabulary import QUANTITIES

Length = Annotated[float, Unit("m")]
Angle = Annotated[float, Unit("rad")]
Mass = Annotated[float, Unit("kg")]
Time = Annotated[float, Unit("s")]
Speed = Annotated[float, Unit("m/s")]
Stiffness = Annotated[float, Unit("N/m")]
Damping = Annotated[float, Unit("N*s/m")]
Pressure = Annotated[float, Unit("Pa")]
Density = Annotated[float, Unit("kg/m^3")]
RateTerm = Annotated[float, Unit("s^2/m^2")]
Number = Annotated[float, Unit("")]
Written = StrictStr | StrictFloat


class Table(BaseModel):
    """A table in which an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SoilTable(Table):
    """The soil: a name, the properties themselves, or a name and what differs from it."""

    name: str | None = None
    density: Density | None = None
    density_ratio: Number | None = None
    cohesion: Pressure | None = None
    friction_angle: Angle | None = None
    tool_friction: Number | None = None
    ambient_pressure: Pressure | None = None
    youngs_modulus: Pressure | None = None
    poisson_ratio: Number | None = None


class ShareTable(Table):
    """The share; what is left out must be a variable."""

    wedge_angle: Angle | None = None
    chisel_angle: Angle | None = None
    height: Length | None = None


class SceneTable(Table):
    """Mount, masses, speed and time."""

    tow_speed: Speed | None = None
    frame_mass: Mass | None = None
    steel_density: Density = 7850.0
    stiffness: Stiffness | None = None
    duration: Time | None = None
    medium: Literal["plastic", "elastic"] = Scene.medium
    outputs: Annotated[StrictInt, Field(ge=1, le=100_000)] = 400


class StrengthWaveTable(Table):
    """Periodic soil strength along the path."""

    amplitude: Number | None = None
    wavelength: Length | None = None


class EffectsTable(Table):
    """Effects beside the default ones."""

    motion: StrictBool = Effects.motion
    inertial_drag: StrictBool = Effects.inertial_drag
    added_mass: StrictBool = Effects.added_mass
    ambient_pressure: StrictBool = Effects.ambient_pressure
    contact: Literal["resisting", "smooth", "stick_slip"] = "resisting"
    contact_width: Speed | None = None
    breakaway: Number | None = None
    start: Literal["equilibrium", "rest", "towed"] = Effects.start
    entry: StrictBool = Effects.entry
    strength_wave: StrengthWaveTable | None = None
    tow_ramp: Time | None = None
    damping: Damping | None = None
    rate_term: RateTerm | None = None
    orbit: Literal["transient", "periodic", "linearised", "harmonic_balance"] = "transient"
    harmonics: Annotated[StrictInt, Field(ge=1, le=MOST_HARMONICS)] = HarmonicBalance.harmonics
    formulation: Literal["derived", "printed"] = "derived"


class VariableTable(Table):
    """Bounds of a variable as they are written; the unit depends on which variable it is."""

    lower: Written
    upper: Written
    guess: Written | None = None
    log: StrictBool = False
    tolerance: Written | None = None


class TermTable(Table):
    """A term of the objective: the result divided by ``per``, in an uncertain soil a measure of it."""

    per: Written
    measure: StrictStr | None = None
    width: Written | None = None


class LimitTable(Table):
    """Limits of a result as they are written, in an uncertain soil of a measure of it or with a probability."""

    at_least: Written | None = None
    at_most: Written | None = None
    measure: StrictStr | None = None
    probability: StrictFloat | None = None
    width: Written | None = None

    @property
    def sides(self) -> dict[str, str | float]:
        """The limits that are given, by "at_least" and "at_most"."""
        both = {"at_least": self.at_least, "at_most": self.at_most}
        return {side: written for side, written in both.items() if written is not None}


class AccuracyTable(Table):
    """Integration method and its setting, or an error to reach."""

    method: StrictStr = "auto"
    error: StrictFloat | None = None
    steps: StrictInt | None = None
    tolerance: StrictFloat | None = None


class ProblemTable(Table):
    """A whole problem file."""

    title: str = "untitled problem"
    soil: SoilTable
    share: ShareTable = ShareTable()
    scene: SceneTable
    effects: EffectsTable = EffectsTable()
    accuracy: AccuracyTable = AccuracyTable()
    variables: dict[str, VariableTable] = {}
    minimise: dict[str, TermTable] = {}
    require: dict[str, LimitTable] = {}
    trade_off: dict[str, Any] | None = None  # read by plough_opt.problem_file.front
    uncertain: dict[str, Any] | None = None  # read by plough_opt.problem_file.uncertain


def unit_of(annotation: Any) -> Unit | None:
    """Return the unit in a field's type, or None for a field that is no quantity."""
    if isinstance(annotation, Unit):
        return annotation
    return next((unit for part in typing.get_args(annotation) if (unit := unit_of(part))), None)


def every_quantity() -> dict[str, Unit]:
    """Return every quantity of a scene by its one name: those of files, and what scenes of Python's alone have."""
    return {**quantities(), **{name: Unit(quantity.unit) for name, quantity in QUANTITIES.items()}}


def quantities() -> dict[str, Unit]:
    """Return every key that a quantity can stand at, such as "share.height", with its unit."""
    found: dict[str, Unit] = {}
    for table, model in (("soil", SoilTable), ("share", ShareTable), ("scene", SceneTable), ("effects", EffectsTable)):
        for name, annotation in typing.get_type_hints(model, include_extras=True).items():
            if unit := unit_of(annotation):
                found[f"{table}.{name}"] = unit
    for name, annotation in typing.get_type_hints(StrengthWaveTable, include_extras=True).items():
        if unit := unit_of(annotation):
            found[f"effects.strength_wave.{name}"] = unit
    return found
