"""Schema of a problem file: its tables in SI units, and the results of [measures]; as a JSON schema for editors too."""

import ast
import dataclasses
import math
import operator
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, reduce
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar, get_args

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, create_model
from pydantic.json_schema import GenerateJsonSchema

from plough_opt.core import expressions
from plough_opt.core.checks import check_named, shown
from plough_opt.core.errors import InputError, about, short
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import EVERY, IN_FILES, MOST_WAVES, QUANTITIES, wave_table
from plough_opt.core.units import Unit, registry
from plough_opt.laws import LAWS, law_of
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion import Run
from plough_opt.motion.effects import (
    OWN_EFFECTS,
    Effects,
    OwnResistance,
    Smooth,
    SpeedProfile,
    StickSlip,
)
from plough_opt.motion.scene import quantity_of
from plough_opt.motion.vocabulary import MEASURES, Measure
from plough_opt.problem_file.source import Source
from plough_opt.soil.soil import Adjust
from plough_opt.soil.strength import RandomStrength, Spectrum, StrengthWave

Written = str | float
RANDOM = "effects.random_strength"
"""Dotted name of the table of random strength."""
SHARE_TABLES = ("soil", "share", "scene", "effects", "variables", "require")
"""Tables that [shares.NAME] may repeat to override entries for one share."""

WAVES = tuple(map(wave_table, range(1, MOST_WAVES + 1)))
"""Dotted names of the tables of strength waves, in order; all have the same keys."""

CHOICES = ("motion", "inertial_drag", "added_mass", "ambient_pressure", "start", "entry", "formulation")
"""Keys of [effects] with the values of the fields of `Effects` that have their names."""

CONTACTS: Final = {"smooth": (Smooth, "effects.contact_width"), "stick_slip": (StickSlip, "effects.breakaway")}
"""Word for a law of contact -> its class, and the key of its one number."""

_T = TypeVar("_T", bound="Table")
_Kind = TypeVar("_Kind")
_LAW = '"plastic", or { law = "mckyes_ali", depth = "0.35 m" }'
_EFFECTS = 'a list of tables with a name, such as [{ effect = "shank", static = "150 N" }]'


def medium_of(written: object) -> str | ResistanceLaw:
    """Return the medium of a `Scene`: the name of a law, or a law with its own quantities in SI units.

    Raises:
        InputError: an unknown law or key, or a value that the law refuses; the message continues after the key's name.
    """
    if isinstance(written, str):
        law_of(written)
        return written
    if not isinstance(written, Mapping) or not isinstance(written.get("law"), str):
        raise InputError(f"= {shown(written)} must be a resistance law, such as {_LAW}")
    law_of(written["law"])
    return _made(LAWS[written["law"]], "law", written)


def own_effects_of(written: Sequence[Mapping[str, Any]]) -> tuple[OwnResistance, ...]:
    """Return user-defined effects with their quantities in SI units.

    Raises:
        InputError: an unknown effect or key, or a value that the effect refuses; the message continues after the key's
            name.
    """
    if not all("effect" in one for one in written):
        raise InputError(f"= {shown(written)} must be {_EFFECTS}")
    for one in written:
        check_named("no effect is named {}", one["effect"], OWN_EFFECTS)
    return tuple(_made(OWN_EFFECTS[one["effect"]], "effect", one) for one in written)


def _made(kind: type[_Kind], key: str, written: Mapping[str, Any]) -> _Kind:
    """Return an instance of a class with the quantities of a table; ``key`` is the entry that names the class."""
    given = {name: _value(kind, name, value) for name, value in written.items() if name != key}
    try:
        return kind(**given)
    except TypeError as error:  # a field without a default is missing in the table
        raise InputError(f"= {shown(written)} is incomplete: {error}") from None


def _value(kind: type, key: str, value: Any) -> Any:
    """Return the value of one field, converted to SI if the field has a unit."""
    known = {each.name: each for each in dataclasses.fields(kind)}
    check_named(f"{{}} is not a quantity of {kind.__name__}", key, known)
    unit = known[key].metadata.get("unit")
    if unit is None:
        return value
    with about(f"'{key}'"):
        return Unit(unit).parse(value)


def _readable_by(read: Callable[[Any], object]) -> AfterValidator:
    """Return a validator that leaves a value as written, after checking that a function can read it."""

    def checked(written: Any) -> Any:
        read(written)
        return written

    return AfterValidator(checked)


def describe_media(schema: dict[str, Any]) -> None:
    """Add the names of the resistance laws to a JSON schema, and allow a table instead of a name."""
    table = {"type": "object", "properties": {"law": {"enum": [*LAWS]}}, "required": ["law"]}
    schema["anyOf"] = [{"enum": [*LAWS]}, table]


class Table(BaseModel):
    """A table in which an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class CompactionTable(Table):
    """A compression test, from which the density ratio at the ambient pressure follows."""

    pressure: list[Written]
    """pressures of the test"""
    volume_lost: list[float]
    """fraction of the volume that is lost at each of them"""


class SoilTable(Table):
    """The soil: the name of a known soil, its properties, or both.

    A cone index may decide one property, and a compression test the density ratio.
    """

    name: str | None = None
    """a named soil; properties beside it replace its values"""
    adjust: Adjust = "strength factor"
    """the property that the cone index decides"""
    penetrometer: str | None = None
    """CSV file of cone index over depth, beside the problem file"""
    depth: str | None = None
    """depths over which its readings are averaged, such as 25..45 cm"""
    compaction: CompactionTable | None = None
    """a compression test, which decides the density ratio"""

    @property
    def adjusted(self) -> str:
        """The quantity that the cone index decides."""
        return f"soil.{self.adjust.replace(' ', '_')}"


class ShareTable(Table):
    """The share; any quantity that is missing must be a variable."""


class SceneTable(Table):
    """Mount, masses, speed and time."""

    medium: Annotated[Any, _readable_by(medium_of), Field(json_schema_extra=describe_media)] = "plastic"
    """the law of resistance: its name, or a table with its name and its quantities"""
    outputs: Annotated[int, Field(ge=1, le=100_000)] = 400
    """number of equal intervals between output times"""
    average: Literal["run", "whole waves"] = "run"
    """average over the run, or shorten it to whole waves"""

    @property
    def law(self) -> ResistanceLaw:
        """The law of resistance."""
        return law_of(medium_of(self.medium))


class EffectsTable(Table):
    """Effects that differ from the defaults."""

    motion: bool = Effects.motion
    """whether the share moves on its mount; if not it follows the strut"""
    inertial_drag: bool = Effects.inertial_drag
    """the force Fd, which grows with the squared speed"""
    added_mass: bool = Effects.added_mass
    """the soil that accelerates with the share"""
    ambient_pressure: bool = Effects.ambient_pressure
    """the pressure ahead of the compaction front"""
    contact: Literal["resisting", "smooth", "stick_slip"] = "resisting"
    """whether the soil always resists, only a share that advances, or lets it stick and slip"""
    start: Literal["equilibrium", "rest", "towed"] = Effects.start
    """at the steady deflection, at rest, or moving with the strut"""
    entry: bool = Effects.entry
    """whether the share enters the soil tip first"""
    orbit: Literal["transient", "periodic"] = "transient"
    """the motion from the start, or the orbit that repeats with every wave"""
    formulation: Literal["derived", "printed"] = "derived"
    """the corrected equations, or those of the source with its misprints"""
    own: Annotated[list[dict[str, Any]], _readable_by(own_effects_of)] = []
    """effects of your own classes"""

    def effects(
        self, values: Mapping[str, Expression], spectrum: Spectrum | None, course: SpeedProfile | None
    ) -> Effects:
        """Return the effects of the file.

        Args:
            values: key of every quantity in the file -> its value, a number or symbol in SI.
            spectrum: spectrum of the strength record, if the file names one.
            course: tow speed over time relative to the largest one, if it varies.
        """
        waves = [
            StrengthWave(values[f"{name}.amplitude"], values[f"{name}.wavelength"], values.get(f"{name}.phase", 0.0))
            for name in WAVES
            if f"{name}.amplitude" in values
        ]
        random: list[Any] = [values.get(f"{RANDOM}.{key}") for key in ("rms", "correlation_length")]
        contact: Any = self.contact
        if self.contact in CONTACTS:
            kind, key = CONTACTS[self.contact]
            contact = kind(values[key]) if key in values else kind()
        numbers = ("tow_ramp", "damping", "speed_term", "rate_term")
        plain: dict[str, Any] = {name: getattr(self, name) for name in CHOICES}
        return Effects(
            **(plain | {name: values.get(f"effects.{name}") for name in numbers}),
            contact=contact,
            strength_wave=waves[0] if len(waves) == 1 else tuple(waves) or None,
            random_strength=RandomStrength(*random) if None not in random else spectrum,
            tow_profile=course,
            orbit=self.orbit,
            own=own_effects_of(self.own),
        )


class RandomStrengthTable(Table):
    """Random strength: its RMS and correlation length, or a file with a measured record."""

    record: str | None = None
    """CSV file of a record along the path, beside the problem file"""
    base_diameter: str | None = None
    """diameter over which the strength is averaged"""


class VariableTable(Table):
    """Bounds of a variable as written, and values or a step to choose from; its name decides the unit."""

    lower: Written
    """lower bound"""
    upper: Written
    """upper bound"""
    guess: Written | None = None
    """start of the search"""
    log: bool = False
    """whether it is scaled by its logarithm"""
    tolerance: Written | None = None
    """half the width of the tolerance band, in its unit or per cent"""
    catalogue: Annotated[list[Written], Field(min_length=1)] | None = None
    """values to choose from"""
    step: Written | None = None
    """step whose multiples are to choose from"""


class TermTable(Table):
    """A term of the objective: a result, or in an uncertain soil a measure of it, divided by ``per``."""

    per: Written
    """amount that counts as 1 in the objective"""
    measure: str | None = None
    """measure over an uncertain soil"""


class LimitTable(Table):
    """Limits of a result as written; in an uncertain soil they may apply to a measure or hold with a probability."""

    at_least: Written | None = None
    """lower limit"""
    at_most: Written | None = None
    """upper limit"""
    measure: str | None = None
    """measure over an uncertain soil"""
    probability: float | None = None
    """fraction of the soils in which the limit holds"""

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
        low, high = (None if side is None else unit.parse(side) for side in (self.at_least, self.at_most))
        return low, high


class GoalTable(Table):
    """A result that a front trades."""

    maximise: bool = False
    """whether it is maximised"""


def _check_goal(written: object) -> object:
    if isinstance(written, dict):
        return written
    raise InputError(f"= {shown(written)} must be {{}} or {{ maximise = true }}; the key of a number is 'points'")


class TradeOffTable(Table):
    """The results that a front trades, by name."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[GoalTable, BeforeValidator(_check_goal)]]

    points: Annotated[int, Field(ge=5, le=1000)] = 40
    """number of positions on the front"""


class MeasureTable(Table):
    """A result that the file defines: an expression of other results, and its unit."""

    value: str
    """expression of other results"""
    unit: str = ""
    """its unit"""


class AccuracyTable(Table):
    """Integration method and its setting, or the relative error to reach."""

    method: str = "auto"
    """integration method"""
    error: float | None = None
    """relative error to reach"""
    steps: int | None = None
    """number of steps of a method with fixed steps"""
    tolerance: float | None = None
    """tolerance of an adaptive method"""


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
    measures: dict[str, MeasureTable] = {}
    trade_off: TradeOffTable | None = None
    uncertain: dict[str, Any] | None = None  # read by plough_opt.problem_file.uncertain
    shares: dict[str, dict[str, Any]] = {}  # read by plough_opt.problem_file.reading

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
"""The complete schema, by which problem files are read."""


def valid_keys(path: tuple[str, ...]) -> list[str]:
    """Return the valid keys of the table at a path of a problem file."""
    table: Any = ProblemFile
    for key in path:
        # A dictionary maps any name to tables of one class, the last argument of its annotation.
        fields = {**table.model_fields} if hasattr(table, "model_fields") else {}
        further = dict[str, GoalTable] if table is TradeOffTable else table
        table = fields[key].annotation if key in fields else get_args(further)[-1]
        table = get_args(table)[0] if type(None) in get_args(table) else table
    return [*table.model_fields]


def at(table: Any, key: str) -> Any:
    """Return the value of a dotted key, or None."""
    return reduce(lambda inner, part: getattr(inner, part, None), key.split("."), table)


_DIALECT = "https://json-schema.org/draft/2020-12/schema"


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
    tables["variables"] = _of(IN_FILES, "VariableTable", {name: EVERY[name].meaning for name in IN_FILES})
    tables["minimise"] = _of(single, "TermTable", others=True)
    tables["minimise"]["properties"]["over"] = {"enum": ["worst", "mean"]}
    tables["require"] = _of(MEASURES, "LimitTable", others=True)
    definitions["TradeOffTable"]["properties"] |= _of(single, "GoalTable")["properties"]
    tables["uncertain"] = {"type": "object"}
    speeds = definitions["SceneFile"]["properties"]
    times = {"type": "array", "items": {"type": "string"}, "minItems": 2}
    course = {"type": "object", "properties": {"time": times, "speed": times}, "required": ["time", "speed"]}
    constant = speeds["tow_speed"]
    speeds["tow_speed"] = {"description": constant.pop("description"), "anyOf": [constant, course]}
    # A share inherits what its own table omits, so even the bounds of its variables are optional.
    definitions["VariableOfShare"] = {k: own for k, own in definitions["VariableTable"].items() if k != "required"}
    own = {name: {"$ref": f"#/properties/{name}"} for name in SHARE_TABLES}
    own["variables"] = _of(IN_FILES, "VariableOfShare")
    share = {"type": "object", "properties": own, "additionalProperties": False}
    tables["shares"] = {"type": "object", "additionalProperties": share}
    return {"$schema": _DIALECT, **schema, "title": "plough_opt problem file"}


class _WithoutNull(GenerateJsonSchema):
    """A schema without null, which pydantic allows for optional keys but TOML does not have."""

    def nullable_schema(self, schema: Any) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: Any) -> dict[str, Any]:
        found = super().default_schema(schema)
        return {key: part for key, part in found.items() if (key, part) != ("default", None)}


def _of(
    names: Iterable[str], table: str, meanings: dict[str, str] | None = None, *, others: bool = False
) -> dict[str, Any]:
    """Return the schema of a table that maps names to tables of one kind.

    Args:
        names: valid names; a dotted name may also be written as nested tables.
        table: name of the kind of table among the definitions.
        meanings: name -> description.
        others: whether other names are valid too.
    """
    described = {name: {"description": text} for name, text in (meanings or {}).items()}
    properties: dict[str, Any] = {name: {"$ref": f"#/$defs/{table}"} | described.get(name, {}) for name in names}
    outer = {name.partition(".")[0] for name in properties if "." in name}
    return {
        "type": "object",
        "properties": properties | {name: {"type": "object"} for name in sorted(outer)},
        "additionalProperties": {"$ref": f"#/$defs/{table}"} if others else False,
    }


TABLE = "measures"
# Longer or more deeply nested expressions belong in a script.
_MAX_LENGTH: Final = 300
_MAX_DEPTH: Final = 20
# No physical result needs a higher power.
_MAX_POWER: Final = 8.0
# Type of an operator, or name of a function -> function from the values of the operands to the result.
_Rules: TypeAlias = dict[Any, Callable[..., Any]]
_ARITHMETIC: Final[_Rules] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
} | {name: getattr(expressions, name) for name in ("sqrt", "exp", "log", "absolute", "minimum", "maximum")}
_FUNCTIONS: Final = tuple(name for name in _ARITHMETIC if isinstance(name, str))
_EXAMPLE: Final = '"tow_power / (2 * loosened_radius)"'


@lru_cache(maxsize=128)
def defined_measure(text: str, unit: str) -> Measure:
    """Return a measure that an expression computes from other results and quantities.

    Args:
        text: an expression of results such as mean_draft and quantities such as share.height, with + - * / **, sqrt,
            exp, log, absolute, minimum and maximum.
        unit: unit of the result, "" if it is dimensionless.

    Raises:
        InputError: the text is not such an expression, a name is unknown, or the units do not agree.
    """
    if len(text) > _MAX_LENGTH:
        raise InputError(f"the expression has {len(text)} characters; at most {_MAX_LENGTH} can be read")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError):
        raise InputError(f"= {short(repr(text))} cannot be read: write an expression like {_EXAMPLE}") from None
    Unit(unit).split(f"1 {unit}")  # raises InputError for an unreadable unit
    parts = [MEASURES[name] for name in _checked_names(tree, text, unit) if name in MEASURES]

    def of(run: Run) -> Expression:
        def leaf(what: str | float) -> Expression:
            if isinstance(what, float):
                return what
            return MEASURES[what].of(run) if what in MEASURES else quantity_of(run.scene, what)

        try:
            with np.errstate(all="ignore"):
                value: Expression = _computed(tree, leaf, _ARITHMETIC)
        except ArithmeticError:  # division by 0, overflow
            value = math.nan
        if isinstance(value, complex) or (isinstance(value, float) and not math.isfinite(value)):
            raise InputError(f"{short(repr(text))} has no finite value in this run: check divisions, roots, logs")
        return value

    needs = tuple(dict.fromkeys(what for one in parts for what in one.needs))
    return Measure(Unit(_si(unit)), of, needs, random=any(one.random for one in parts))


def _si(unit: str) -> str:
    """Return the SI unit of the same dimension, or the unit itself if its factor to SI is 1."""
    base = registry().Quantity(1.0, unit or "dimensionless").to_base_units()
    return unit if base.magnitude == 1.0 else f"{base.units:~C}"


def _checked_names(tree: ast.expr, text: str, unit: str) -> dict[str, None]:
    """Return the names of results and quantities in an expression, in order.

    Raises:
        InputError: a name is unknown, unlike units are added, or the result's unit differs from the stated one.
    """
    unit_of, names = registry().Unit, dict[str, None]()
    plain, zero = unit_of("dimensionless"), unit_of("dimensionless")  # a plain 0 has any unit

    def leaf(what: str | float) -> Any:
        if isinstance(what, float):
            return plain if what else zero
        single = [name for name, measure in MEASURES.items() if not measure.everywhere]
        check_named("{} has no single value to compute with", what, [*single, *QUANTITIES])
        names[what] = None
        return unit_of((MEASURES[what].unit.symbol if what in MEASURES else QUANTITIES[what].unit) or "dimensionless")

    def alike(one: Any, other: Any = plain) -> Any:
        if one is zero or other is zero:
            return other if one is zero else one
        if one.dimensionality != other.dimensionality:
            raise InputError(f"= {short(repr(text))} combines unlike units, {one} and {other}")
        return one

    rules = dict.fromkeys((ast.Add, ast.Sub, "exp", "log", "minimum", "maximum"), alike)
    powers = {"sqrt": lambda own: own**0.5, "absolute": lambda own: own}
    found = _computed(tree, leaf, _ARITHMETIC | rules | powers)
    if found.dimensionality != unit_of(unit or "dimensionless").dimensionality:
        stated, given = (f"the unit '{one}'" if one else "no unit" for one in (unit, f"{found:~P}"))
        raise InputError(f"has {stated}, but its expression has {given}: change one of the two")
    return names


def _computed(tree: ast.expr, leaf: Callable[[str | float], Any], rules: _Rules, depth: int = 0) -> Any:
    """Return the value of an expression: a number, a symbol, or its unit.

    Args:
        tree: the expression.
        leaf: function from a name, such as "mean_draft" or "share.height", or a number to its value.
        rules: how operators and functions compute.
        depth: how deep the expression is nested in others.
    """
    if depth > _MAX_DEPTH:
        raise InputError(f"the expression is nested more than {_MAX_DEPTH} deep: define its parts as separate results")

    def inner(part: ast.expr) -> Any:
        return _computed(part, leaf, rules, depth + 1)

    match tree:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            if number > sys.float_info.max:
                raise InputError(f"the number {short(ast.unparse(tree))} is too large")
            return leaf(float(number))
        case ast.Name() | ast.Attribute():
            return leaf(ast.unparse(tree))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return rules[ast.Mult](leaf(-1.0), inner(operand))
        case ast.BinOp(left=base, op=ast.Pow(), right=power):
            return inner(base) ** _power(power)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in rules:
            return rules[type(op)](inner(left), inner(right))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in _FUNCTIONS:
            if len(arguments) != (2 if name in ("minimum", "maximum") else 1):
                raise InputError(f"'{ast.unparse(tree)}' has the wrong number of arguments")
            return rules[name](*map(inner, arguments))
    functions = ", ".join(_FUNCTIONS)
    raise InputError(f"'{short(ast.unparse(tree), 60)}' cannot be computed: use + - * / **, and {functions}")


def _power(tree: ast.expr) -> float:
    """Return the exponent of a power, which must be a number."""
    sign = 1.0
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
        sign, tree = -1.0, tree.operand
    if not isinstance(tree, ast.Constant) or isinstance(tree.value, bool) or not isinstance(tree.value, int | float):
        raise InputError(f"the power '{ast.unparse(tree)}' must be a number")
    if tree.value > _MAX_POWER:
        raise InputError(f"the power {tree.value} must be at most {_MAX_POWER:g}")
    return sign * float(tree.value)


def measures_of(table: ProblemTable) -> Mapping[str, Measure]:
    """Return name -> measure of every result that a file can name: those of plough_opt and those it defines."""
    return MEASURES | {name: defined_measure(entry.value, entry.unit) for name, entry in table.measures.items()}


def check_definitions(source: Source, table: ProblemTable) -> bool:
    """Note every invalid result in [measures]; return True if all are valid."""
    valid = 0
    for name, entry in table.measures.items():
        with source.noting((TABLE, name), prefix=f"'{name}' "):
            if name in MEASURES or name in EVERY:
                raise InputError("is the name of a built-in result or quantity: choose another")
            if not name.isidentifier():
                raise InputError("cannot be a name: use letters, digits and _")
            defined_measure(entry.value, entry.unit)
            valid += 1
    return valid == len(table.measures)


def total_of(measure: Measure, runs: Sequence[Run]) -> Expression:
    """Return the sum of a result over runs."""
    first, *rest = map(measure.of, runs)
    return sum(rest, first)
