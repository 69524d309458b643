"""Schema of a problem file: its tables in SI units; as a JSON schema for editors too."""

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import reduce
from typing import Annotated, Any, Final, Literal, TypeVar, cast, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model
from pydantic.json_schema import GenerateJsonSchema

from plough_opt.core.checks import check_named, shown
from plough_opt.core.errors import InputError, about
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import EVERY, IN_FILES, MOST_WAVES, wave_table
from plough_opt.core.units import Unit
from plough_opt.laws import LAWS, law_of
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.effects import OWN_EFFECTS, Effects, OwnResistance, Smooth, SpeedProfile, StickSlip
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.soil.soil import Adjust, named_soil
from plough_opt.soil.strength import RandomStrength, Spectrum, StrengthWave

Written = str | float
# Dotted names of the table of random strength, and of those of strength waves, which all have the same keys.
RANDOM = "effects.random_strength"
WAVES = tuple(map(wave_table, range(1, MOST_WAVES + 1)))

# Keys of [effects] with the values of the fields of `Effects` that have their names.
CHOICES = ("motion", "inertial_drag", "added_mass", "ambient_pressure", "start", "entry", "formulation", "orbit")

# Word for a law of contact -> its class, and the key of its one number.
CONTACTS: Final = {"smooth": (Smooth, "effects.contact_width"), "stick_slip": (StickSlip, "effects.breakaway")}

_T = TypeVar("_T", bound="Table")
_Kind = TypeVar("_Kind")


def medium_of(written: object) -> str | ResistanceLaw:
    """Return the medium of a `Scene`: the name of a law, or a law with its own quantities in SI units.

    Raises:
        InputError: an unknown law or key, or a value that the law refuses; the message continues after the key's name.
    """
    if isinstance(written, str):
        law_of(written)
        return written
    return _made(
        written, "law", LAWS, 'a resistance law, such as "plastic", or { law = "mckyes_ali", depth = "0.35 m" }'
    )


def own_effect_of(written: object) -> OwnResistance:
    """Return a user-defined effect with its quantities in SI units.

    Raises:
        InputError: an unknown effect or key, or a value that the effect refuses; the message continues after the key's
            name.
    """
    return _made(written, "effect", OWN_EFFECTS, 'a table such as { effect = "shank", static = "150 N" }')


def _made(written: object, key: str, kinds: Mapping[str, type[_Kind]], wanted: str) -> _Kind:
    """Return an instance of the class that a table names under a key, with the quantities of the table."""
    if not isinstance(written, Mapping) or not isinstance(written.get(key), str):
        raise InputError(f"= {shown(written)} must be {wanted}")
    check_named(f"no {key} is named {{}}", written[key], kinds)
    kind = kinds[written[key]]
    units: dict[str, Any] = {field.name: field.metadata.get("unit") for field in dataclasses.fields(cast(Any, kind))}
    values = {name: value for name, value in written.items() if name != key}
    for name, value in values.items():
        check_named(f"{{}} is not a quantity of {kind.__name__}", name, units)
        if units[name] is not None:
            with about(f"'{name}'"):
                values[name] = Unit(units[name]).parse(value)
    try:
        return kind(**values)
    except TypeError as error:  # a field without a default is missing in the table
        raise InputError(f"= {shown(written)} is incomplete: {error}") from None


def describe_media(schema: dict[str, Any]) -> None:
    """Add the names of the resistance laws to a JSON schema, and allow a table instead of a name."""
    table = {"type": "object", "properties": {"law": {"enum": [*LAWS]}}, "required": ["law"]}
    schema["anyOf"] = [{"enum": [*LAWS]}, table]


class Table(BaseModel):
    """A table in which an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class CompactionTable(Table):
    """A compression test, from which the density ratio at the ambient pressure follows.

    Attributes:
        pressure: pressures of the test
        volume_lost: fraction of the volume that is lost at each of them
    """

    pressure: list[Annotated[float, Unit("Pa")]]
    volume_lost: list[float]


class SoilTable(Table):
    """The soil: the name of a known soil, its properties, or both.

    A cone index may decide one property, and a compression test the density ratio.

    Attributes:
        name: a named soil; properties beside it replace its values
        adjust: the property that the cone index decides
        penetrometer: CSV file of cone index over depth, beside the problem file
        depth: depths over which its readings are averaged, such as 25..45 cm
        compaction: a compression test, which decides the density ratio
    """

    name: Annotated[str, AfterValidator(lambda name: named_soil(name) and name)] | None = None
    adjust: Adjust = "strength factor"
    penetrometer: str | None = None
    depth: str | None = None
    compaction: CompactionTable | None = None

    @property
    def adjusted(self) -> str:
        """The quantity that the cone index decides."""
        return f"soil.{self.adjust.replace(' ', '_')}"


class ShareTable(Table):
    """The share; any quantity that is missing must be a variable."""


class SceneTable(Table):
    """Mount, masses, speed and time.

    Attributes:
        medium: the law of resistance: its name, or a table with its name and its quantities
        outputs: number of equal intervals between output times
        average: average over the run, or shorten it to whole waves
    """

    medium: Annotated[Any, AfterValidator(medium_of), Field(json_schema_extra=describe_media)] = "plastic"
    outputs: Annotated[int, Field(ge=1, le=100_000)] = 400
    average: Literal["run", "whole waves"] = "run"

    @property
    def law(self) -> ResistanceLaw:
        """The law of resistance."""
        return law_of(self.medium)


class EffectsTable(Table):
    """Effects that differ from the defaults.

    Attributes:
        motion: whether the share moves on its mount; if not it follows the strut
        inertial_drag: the force Fd, which grows with the squared speed
        added_mass: the soil that accelerates with the share
        ambient_pressure: the pressure ahead of the compaction front
        contact: whether the soil always resists, only a share that advances, or lets it stick and slip
        start: at the steady deflection, at rest, or moving with the strut
        entry: whether the share enters the soil tip first
        orbit: the motion from the start, or the orbit that repeats with every wave
        formulation: the corrected equations, or those of the source with its misprints
        own: effects of your own classes
    """

    motion: bool = Effects.motion
    inertial_drag: bool = Effects.inertial_drag
    added_mass: bool = Effects.added_mass
    ambient_pressure: bool = Effects.ambient_pressure
    contact: Literal["resisting", "smooth", "stick_slip"] = "resisting"
    start: Literal["equilibrium", "rest", "towed"] = Effects.start
    entry: bool = Effects.entry
    orbit: Literal["transient", "periodic"] = "transient"
    formulation: Literal["derived", "printed"] = "derived"
    own: list[Annotated[Any, AfterValidator(own_effect_of)]] = []

    def effects(
        self, values: Mapping[str, Expression], spectrum: Spectrum | None, course: SpeedProfile | None
    ) -> Effects:
        """Return the effects of the file.

        Args:
            values: key of every quantity in the file -> its value, a number or symbol in SI.
            spectrum: spectrum of the strength record, if the file names one.
            course: tow speed over time relative to the largest one, if it varies.
        """
        tables: dict[str, dict[str, Any]] = defaultdict(dict)
        for name, value in values.items():
            table, _, key = name.rpartition(".")
            tables[table][key] = value
        waves = tuple(StrengthWave(**tables[name]) for name in WAVES if name in tables)
        contact: Any = self.contact
        for word, (kind, name) in CONTACTS.items():
            number = tables["effects"].pop(name.removeprefix("effects."), None)
            if self.contact == word:
                contact = kind() if number is None else kind(number)
        return Effects(
            **{name: getattr(self, name) for name in CHOICES},
            **tables["effects"],
            contact=contact,
            strength_wave=waves[0] if len(waves) == 1 else waves or None,
            random_strength=RandomStrength(**tables[RANDOM]) if RANDOM in tables else spectrum,
            tow_profile=course,
            own=tuple(self.own),
        )


class RandomStrengthTable(Table):
    """Random strength: its RMS and correlation length, or a file with a measured record.

    Attributes:
        record: CSV file of a record along the path, beside the problem file
        base_diameter: diameter over which the strength is averaged
    """

    record: str | None = None
    base_diameter: Annotated[float, Unit("m")] | None = None


class VariableTable(Table):
    """Bounds of a variable as written, and values or a step to choose from; its name decides the unit.

    Attributes:
        lower: lower bound
        upper: upper bound
        guess: start of the search
        log: whether it is scaled by its logarithm
        tolerance: half the width of the tolerance band, in its unit or per cent
        catalogue: values to choose from
        step: step whose multiples are to choose from
    """

    lower: Written
    upper: Written
    guess: Written | None = None
    log: bool = False
    tolerance: Written | None = None
    catalogue: Annotated[list[Written], Field(min_length=1)] | None = None
    step: Written | None = None


class TermTable(Table):
    """A term of the objective: a result, or in an uncertain soil a measure of it, divided by ``per``.

    Attributes:
        per: amount that counts as 1 in the objective
        measure: measure over an uncertain soil
    """

    per: Written
    measure: str | None = None


class LimitTable(Table):
    """Limits of a result as written; in an uncertain soil they may apply to a measure or hold with a probability.

    Attributes:
        at_least: lower limit
        at_most: upper limit
        measure: measure over an uncertain soil
        probability: fraction of the soils in which the limit holds
    """

    at_least: Written | None = None
    at_most: Written | None = None
    measure: str | None = None
    probability: float | None = None

    @property
    def sides(self) -> dict[str, str | float]:
        """Limits that are given: "at_least" or "at_most" -> as written."""
        both = {"at_least": self.at_least, "at_most": self.at_most}
        return {side: written for side, written in both.items() if written is not None}

    @property
    def words(self) -> str:
        """The limits in words, such as "at least 0.15 m"."""
        return ", ".join(f"{side.replace('_', ' ')} {written}" for side, written in self.sides.items())

    def ends(self, unit: Unit) -> tuple[float | None, float | None]:
        """Return the lower and upper limit in SI; None if absent."""
        values = {side: unit.parse(written) for side, written in self.sides.items()}
        return values.get("at_least"), values.get("at_most")


class GoalTable(Table):
    """A result that a front trades.

    Attributes:
        maximise: whether it is maximised
    """

    maximise: bool = False


class TradeOffTable(Table):
    """The results that a front trades, by name.

    Attributes:
        points: number of positions on the front
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, GoalTable]

    points: Annotated[int, Field(ge=5, le=1000)] = 40


class DistributionTable(Table):
    """Distribution of an uncertain property of the soil, its quantities as written.

    Attributes:
        distribution: its kind
        mean: mean
        std: standard deviation
        lower: lower end
        mode: most likely value
        upper: upper end
    """

    distribution: Literal["normal", "lognormal", "uniform", "triangular", "beta"]
    mean: Written | None = None
    std: Written | None = None
    lower: Written | None = None
    mode: Written | None = None
    upper: Written | None = None


class UncertainTable(Table):
    """Distributions of soil properties by name, and how soils are drawn from them.

    Attributes:
        samples: number of soils that the optimiser uses
        fresh: number of soils that are drawn anew to verify the optimum
        seed: seed of the soils
        correlation: pairs of properties with the correlation of their normal scores
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, DistributionTable]

    samples: Annotated[int, Field(ge=8, le=1024)] = 64
    fresh: Annotated[int, Field(ge=100, le=100_000)] = 4096
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 1
    correlation: list[Annotated[list[str | float], Field(min_length=3, max_length=3)]] = []

    @property
    def soil(self) -> dict[str, DistributionTable]:
        """Name of each uncertain property -> its distribution."""
        return self.__pydantic_extra__


class AccuracyTable(Table):
    """Integration method and its setting, or the relative error to reach.

    Attributes:
        method: integration method
        error: relative error to reach
        steps: number of steps of a method with fixed steps
        tolerance: tolerance of an adaptive method
    """

    method: str = "auto"
    error: float | None = None
    steps: int | None = None
    tolerance: float | None = None


class ProblemTable(Table):
    """A whole problem file without its quantities, which `ProblemFile` adds."""

    title: str = "untitled problem"
    soil: SoilTable
    share: ShareTable
    scene: SceneTable
    effects: EffectsTable
    accuracy: AccuracyTable = AccuracyTable()
    variables: dict[str, VariableTable] = {}
    minimise: dict[str, TermTable] = {}
    require: dict[str, LimitTable] = {}
    trade_off: TradeOffTable | None = None
    uncertain: UncertainTable | None = None

    @property
    def goals(self) -> dict[str, bool]:
        """Name of each result in [trade_off] -> True if it is maximised."""
        traded = {} if self.trade_off is None else self.trade_off.__pydantic_extra__
        return {name: goal.maximise for name, goal in traded.items()}


def _with_quantities(name: str, table: type[_T], owner: str = "", **fields: Any) -> type[_T]:
    """Return a table with a field for each quantity that it owns.

    The name must equal the module variable that holds the class, by which other processes unpickle it.
    """
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
EffectsFile = _with_quantities(
    "EffectsFile", EffectsTable, "effects",
    random_strength=(RandomStrengthFile | None, None),
    **{name.removeprefix("effects."): (StrengthWaveFile | None, None) for name in WAVES},
)  # fmt: skip
# The complete schema, by which problem files are read.
ProblemFile = _with_quantities(
    "ProblemFile", ProblemTable, soil=(SoilFile, ...), share=(ShareFile, ShareFile()), scene=(SceneFile, ...),
    effects=(EffectsFile, EffectsFile()),
)  # fmt: skip


def valid_keys(path: tuple[str, ...]) -> list[str]:
    """Return the valid keys of the table at a path of a problem file."""
    table: Any = ProblemFile
    for key in path:
        # A dictionary maps any name to tables of one class, the last argument of its annotation.
        fields = {**table.model_fields} if hasattr(table, "model_fields") else {}
        further = {TradeOffTable: GoalTable, UncertainTable: DistributionTable}.get(table)
        table = fields[key].annotation if key in fields else further or get_args(table)[-1]
        table = get_args(table)[0] if type(None) in get_args(table) else table
    return [*table.model_fields]


def at(table: Any, key: str) -> Any:
    """Return the value of a dotted key, or None."""
    return reduce(lambda inner, part: getattr(inner, part, None), key.split("."), table)


def file_schema() -> dict[str, Any]:
    """Return the JSON schema of a problem file: its tables and keys, with their meanings and an example of each unit.

    The schema describes each key by itself. Only `read_problem` finds contradictions between keys, such as a variable
    that also has a fixed value.

    Example:
        >>> from plough_opt.problem_file.schema import file_schema
        >>> file_schema()["properties"]["title"]["type"]
        'string'
    """
    schema = ProblemFile.model_json_schema(schema_generator=_WithoutNull)
    single = [name for name, measure in MEASURES.items() if not measure.everywhere]
    definitions, tables = schema["$defs"], schema["properties"]
    tables["variables"] = _named(IN_FILES, "VariableTable")
    tables["minimise"] = _named(single, "TermTable")
    tables["require"] = _named(MEASURES, "LimitTable")
    soil = [name for name in IN_FILES if IN_FILES[name].owner == "soil"]
    for table, names, kind in (("TradeOff", single, "GoalTable"), ("Uncertain", soil, "DistributionTable")):
        definitions[f"{table}Table"]["properties"] |= _named(names, kind)["properties"]
    speeds = definitions["SceneFile"]["properties"]
    times = {"type": "array", "items": {"type": "string"}, "minItems": 2}
    course = {"type": "object", "properties": {"time": times, "speed": times}, "required": ["time", "speed"]}
    constant = speeds["tow_speed"]
    speeds["tow_speed"] = {"description": constant.pop("description"), "anyOf": [constant, course]}
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": dialect, **schema, "title": "plough_opt problem file"}


def _named(names: Iterable[str], table: str) -> dict[str, Any]:
    """Return the schema of a table that maps names, dotted or as nested tables, to tables of one kind."""
    meanings = {name: EVERY[name].meaning if name in EVERY else called(name) for name in names}
    entries = {name: {"$ref": f"#/$defs/{table}", "description": meaning} for name, meaning in meanings.items()}
    nested = {name.partition(".")[0]: {"type": "object"} for name in meanings if "." in name}
    return {"type": "object", "properties": entries | nested, "additionalProperties": False}


class _WithoutNull(GenerateJsonSchema):
    """A schema without null, which pydantic allows for optional keys but TOML does not have."""

    def nullable_schema(self, schema: Any) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: Any) -> dict[str, Any]:
        described = super().default_schema(schema)
        return {key: part for key, part in described.items() if (key, part) != ("default", None)}
