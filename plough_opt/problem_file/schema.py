"""Contents of a problem file, table by table; every quantity is kept in SI."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    create_model,
)

from plough_opt.core.quantities import IN_FILES, MOST_WAVES, wave_table
from plough_opt.core.units import Unit
from plough_opt.laws.law import ResistanceLaw
from plough_opt.laws.registry import LAWS, law_of
from plough_opt.motion.effects import MOST_HARMONICS, Effects, HarmonicBalance
from plough_opt.problem_file.named import medium_of, own_effects_of
from plough_opt.soil.soil import Adjust

Written = StrictStr | StrictFloat
RANDOM = "effects.random_strength"
"""The table of random strength."""
SHARE_TABLES = ("soil", "share", "scene", "effects", "variables", "require")
"""The tables that may say something else of one share of several."""


_T = TypeVar("_T", bound="Table")


def checked_medium(written: object) -> object:
    """Return a medium as it is written, which `medium_of` can read."""
    medium_of(written)
    return written


def checked_effects(written: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return own effects as they are written, which `own_effects_of` can read."""
    own_effects_of(written)
    return written


def describe_media(schema: dict[str, Any]) -> None:
    """Tell editors the names of the resistance laws, and that a table may stand in the place of a name."""
    table = {"type": "object", "properties": {"law": {"enum": [*LAWS]}}, "required": ["law"]}
    schema["anyOf"] = [{"enum": [*LAWS]}, table]


class Table(BaseModel):
    """A table in which an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SoilTable(Table):
    """The soil: a name, the properties themselves, or a name and what differs from it, or a cone index decides."""

    name: str | None = None
    adjust: Adjust = "strength factor"
    penetrometer: str | None = None
    depth: str | None = None

    @property
    def adjusted(self) -> str:
        """The quantity that a cone index decides."""
        return f"soil.{self.adjust.replace(' ', '_')}"


class ShareTable(Table):
    """The share; what is left out must be a variable."""


class SceneTable(Table):
    """Mount, masses, speed and time."""

    medium: Annotated[Any, AfterValidator(checked_medium), Field(json_schema_extra=describe_media)] = "plastic"
    outputs: Annotated[StrictInt, Field(ge=1, le=100_000)] = 400

    @property
    def law(self) -> ResistanceLaw:
        """The law of resistance."""
        return law_of(medium_of(self.medium))


class EffectsTable(Table):
    """Effects beside the default ones."""

    motion: StrictBool = Effects.motion
    inertial_drag: StrictBool = Effects.inertial_drag
    added_mass: StrictBool = Effects.added_mass
    ambient_pressure: StrictBool = Effects.ambient_pressure
    contact: Literal["resisting", "smooth", "stick_slip"] = "resisting"
    start: Literal["equilibrium", "rest", "towed"] = Effects.start
    entry: StrictBool = Effects.entry
    orbit: Literal["transient", "periodic", "linearised", "harmonic_balance"] = "transient"
    harmonics: Annotated[StrictInt, Field(ge=1, le=MOST_HARMONICS)] = HarmonicBalance.harmonics
    formulation: Literal["derived", "printed"] = "derived"
    own: Annotated[list[dict[str, Any]], AfterValidator(checked_effects)] = []


class RandomStrengthTable(Table):
    """Random strength: its RMS and correlation length, or a record of it."""

    record: StrictStr | None = None
    base_diameter: StrictStr | None = None


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


class MeasureTable(Table):
    """A result of the file's own: an expression of others, and its unit."""

    value: StrictStr
    unit: StrictStr = ""


class AccuracyTable(Table):
    """Integration method and its setting, or an error to reach."""

    method: StrictStr = "auto"
    error: StrictFloat | None = None
    steps: StrictInt | None = None
    tolerance: StrictFloat | None = None


class ProblemTable(Table):
    """A whole problem file, the quantities of its tables apart."""

    title: str = "untitled problem"
    soil: SoilTable
    share: ShareTable
    scene: SceneTable
    effects: EffectsTable
    accuracy: AccuracyTable = AccuracyTable()
    variables: dict[str, VariableTable] = {}
    minimise: dict[str, TermTable] = {}
    require: dict[str, LimitTable] = {}
    measures: dict[str, MeasureTable] = {}
    trade_off: dict[str, Any] | None = None  # read by plough_opt.problem_file.front
    uncertain: dict[str, Any] | None = None  # read by plough_opt.problem_file.uncertain
    shares: dict[str, dict[str, Any]] = {}  # read by plough_opt.problem_file.shares


def _with_quantities(name: str, table: type[_T], owner: str = "", **fields: Any) -> type[_T]:
    """Return a table with a field for each of its quantities; its name here is what other processes find it by."""
    for quantity in IN_FILES.values():
        if quantity.owner == owner:
            declared = Field(default=quantity.default, description=quantity.meaning)
            fields[quantity.key] = (Annotated[float, Unit(quantity.unit)] | None, declared)
    return create_model(name, __base__=table, __module__=__name__, **fields)


SoilFile = _with_quantities("SoilFile", SoilTable, "soil")
ShareFile = _with_quantities("ShareFile", ShareTable, "share")
SceneFile = _with_quantities("SceneFile", SceneTable, "scene")
StrengthWaveFile = _with_quantities("StrengthWaveFile", Table, wave_table(1))
RandomStrengthFile = _with_quantities("RandomStrengthFile", RandomStrengthTable, RANDOM)
WAVES = tuple(map(wave_table, range(1, MOST_WAVES + 1)))
"""The tables of strength waves, in order; all hold the same keys."""
EffectsFile = _with_quantities(
    "EffectsFile",
    EffectsTable,
    "effects",
    random_strength=(RandomStrengthFile | None, None),
    **{name.removeprefix("effects."): (StrengthWaveFile | None, None) for name in WAVES},
)
ProblemFile = _with_quantities(
    "ProblemFile",
    ProblemTable,
    soil=(SoilFile, ...),
    share=(ShareFile, ShareFile()),
    scene=(SceneFile, ...),
    effects=(EffectsFile, EffectsFile()),
)
"""The schema that problem files are read by."""
