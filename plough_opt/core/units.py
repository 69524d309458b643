"""Quantities with units: parsed by pint, converted to SI, and displayed in the unit that the user wrote."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, cast

from plough_opt.core.errors import InputError, about, nearest, short, unprintable

if TYPE_CHECKING:
    import pint
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

# pint and pydantic are slow to import, and most programs pass plain numbers: both are imported on first use.

_QUANTITY = re.compile(
    r"\s*(?P<number>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*"
    r"(?P<unit>(?:[^\W\d_]|[°%])(?:[\w°%/*^.·³²()-]| (?=\S))*|)\s*"
)
PER_CENT: Final = re.compile(r"\s*((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*%\s*")
"""A percentage that is not negative; its group is the number."""
_THOUSANDS: Final = re.compile(r"\s*[+-]?[0-9]{1,3},[0-9]{3}(?![0-9])")
# Most characters of a quantity.
_LONGEST: Final = 100
# A power that is not a single digit: pint would compute 9^9^9 before rejecting it as a unit.
_POWER = re.compile(r"(?:\^|\*\*)(?!\s*-?[0-9](?:\.[0-9])?(?![\w.^]|\s*(?:\^|\*\*)))")
# Common units by what they measure, in pint's root units, with their factors. They are parsed without pint, whose
# registry takes longer to build than a simulation; for a unit that pint does not know, the nearest are suggested.
_COMMON: Final = {
    "dimensionless": {"": 1.0, "%": 0.01},
    "radian": {"rad": 1.0, "deg": 0.017453292519943295, "°": 0.017453292519943295},
    "meter": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254},
    "second": {"s": 1.0, "ms": 0.001, "min": 60.0, "h": 3600.0},
    "gram": {"kg": 1e3, "g": 1.0, "t": 1e6},
    "meter / second": {"m/s": 1.0, "km/h": 0.2777777777777778, "mph": 0.44704},
    "gram * meter / second ** 2": {"N": 1e3, "daN": 1e4, "kN": 1e6, "kgf": 9806.65, "tf": 9806650.0,
                                   "lbf": 4448.221615260501},
    "gram * meter ** 2 / second ** 3": {"W": 1e3, "kW": 1e6},
    "gram / meter / second ** 2": {"Pa": 1e3, "kPa": 1e6, "MPa": 1e9, "bar": 1e8, "psi": 6894757.293168363},
    "gram / meter ** 3": {"kg/m^3": 1e3, "g/cm^3": 999999.9999999999},
    "gram / second ** 2": {"N/m": 1e3, "kN/m": 1e6, "N/mm": 1e6},
    "gram / second": {"N*s/m": 1e3, "kN*s/m": 1e6},
    "second ** 2 / meter ** 2": {"s^2/m^2": 1.0},
}  # fmt: skip
# Names of units that mean different things in different trades.
_AMBIGUOUS: Final = {"tonf": '"tf" is the metric ton-force, "2000 lbf" the American one'}
_ROOTS: Final = {unit: (factor, root) for root, units in _COMMON.items() for unit, factor in units.items()}
_EXAMPLES = {
    "m": '"0.3 m"', "rad": '"25 deg"', "kg": '"20 kg"', "s": '"2 s"', "m/s": '"7.2 km/h"', "N/m": '"50 kN/m"',
    "N*s/m": '"400 N*s/m"', "Pa": '"20 kPa"', "kg/m^3": '"1350 kg/m^3"', "N": '"1 kN"', "W": '"1 kW"',
    "s^2/m^2": '"0.01 s^2/m^2"', "": "0.3",
}  # fmt: skip


@lru_cache(maxsize=1)
def registry() -> pint.UnitRegistry[Any]:
    """Return the registry of units, created on first use."""
    import pint

    return pint.UnitRegistry()


@dataclass(frozen=True)
class Unit:
    """The SI unit in which a quantity is stored; "" for a pure number."""

    symbol: str

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let ``Annotated[float, Unit("m")]`` declare a field that parses quantities."""
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(self.parse, handler(float))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the JSON schema of such a field: a string with number and unit, or also a number for a pure one."""
        example = self.example()
        if self.symbol:
            return {"type": "string", "pattern": r"^\s*[+-]?[0-9.]", "examples": [example.strip('"')]}
        return {"type": ["number", "string"], "examples": [float(example)]}

    def example(self) -> str:
        """Return an example of a quantity in this unit, as a user would write it."""
        return _EXAMPLES.get(self.symbol, f'"1 {self.symbol}"')

    def parse(self, value: object) -> float:
        """Return a quantity as a number in this unit.

        Args:
            value: string with a number and a unit; also a plain number if the unit is "".

        Raises:
            InputError: the value is not a quantity, or its unit is unknown or of the wrong dimension.
        """
        number, factor = self.split(value)
        try:
            in_unit = float(number) * factor
        except OverflowError:
            raise InputError("must be finite: it is too large") from None
        if not math.isfinite(in_unit):
            raise InputError(f"= {value} must be finite")
        return in_unit

    def split(self, value: Any) -> tuple[Any, float]:
        """Return a quantity's number as written, and the conversion factor from its unit to this one.

        Raises:
            InputError: as `parse`.
        """
        if _is_pint(value):
            return value.magnitude, self._factor(str(value.units), value)
        if isinstance(value, str):
            number, written = _parsed(value, self.example())
            if self.symbol and not written:
                raise InputError(f'= "{value}" has no unit: write it like {self.example()}')
            return number, self._factor(written, value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"is not a quantity: write it like {self.example()}")
        if self.symbol:
            raise InputError(f"= {value} has no unit: write it like {self.example()}")
        return value, 1.0

    def _factor(self, written: str, value: object) -> float:
        """Return the conversion factor from a written unit to this one."""
        own_factor, own_kind = _root(self.symbol, value)
        factor, kind = _root(written, value, _COMMON.get(own_kind))
        if kind != own_kind:
            expected = f"a quantity in {self.symbol}" if self.symbol else "a pure number"
            raise InputError(f'= "{value}" has the wrong unit: expected {expected}, like {self.example()}')
        return factor / own_factor


def _is_pint(value: Any) -> bool:
    """Return whether a value is a pint quantity, from any registry."""
    return hasattr(value, "dimensionality") and hasattr(value, "magnitude")


def has_unit(value: Any) -> bool:
    """Return whether a value states its unit: a string such as "50 kN/m", or a pint quantity."""
    return isinstance(value, str) or _is_pint(value)


def _parsed(text: str, example: str) -> tuple[float, str]:
    """Return number and unit of a quantity, as written.

    Raises:
        InputError: the text is not a quantity; the message continues a sentence that begins with the value's name.
    """
    if unprintable(text):
        raise InputError(f"= {short(ascii(text))} is not a quantity: write it like {example}")
    if len(text) > _LONGEST:
        length = f"has {len(text)} characters; a quantity may have at most {_LONGEST}"
        raise InputError(f'= "{short(text)}" {length}: write it like {example}')
    match = _QUANTITY.fullmatch(text)
    if match is None and _QUANTITY.fullmatch(text.replace(",", ".")):
        thousands = f', or "{text.replace(",", "")}" if it separates thousands' if _THOUSANDS.match(text) else ""
        point = text.replace(",", ".")
        raise InputError(f'= "{text}" has a comma: write "{point}" with a decimal point{thousands}')
    if match is None:
        raise InputError(f'= "{text}" is not a quantity: write it like {example}')
    if _POWER.search(match["unit"]):
        raise InputError(f'= "{text}" has an unreadable unit: write powers as one digit, like "kg/m^3"')
    return float(match["number"]), match["unit"]


def in_si(what: str, value: Any, unit: str) -> Any:
    """Return a string or a pint quantity as a number in an SI unit, and anything else as it is.

    Args:
        what: name of the value, for the user.
        value: a string such as "50 kN/m", a pint quantity, or a value in SI units.
        unit: SI unit.

    Raises:
        InputError: the string is not a quantity, or the unit has the wrong dimension.
    """
    if not has_unit(value):
        return value
    with about(what):
        number, factor = Unit(unit).split(value)
        return number * factor if factor != 1.0 else number


def unit_of(what: str, unit: str, *values: Any) -> tuple[str, Display | None]:
    """Return the SI unit of related values, and the unit in which to report them if the user wrote one.

    Args:
        what: name of the values, for the user.
        unit: unit given as an argument beside them, or "".
        values: strings, pint quantities and plain numbers; None for one that was left out.

    Raises:
        InputError: a unit is unknown, or plain numbers come with a unit that is not SI and would be taken as SI.
    """
    written = next((value for value in values if has_unit(value)), None)
    plain = next((value for value in values if value is not None and not has_unit(value)), None)
    factor, symbol = _to_si(unit)
    if plain is not None and factor != 1.0:
        raise InputError(
            f"{what}: {plain} is a plain number, but '{unit}' is not an SI unit: write \"{plain} {unit}\" as a string,"
            f' or {plain * factor:.6g} with unit="{symbol}"'
        )
    if written is None:
        return unit, None
    own = _written_unit(what, written)
    symbol_in_si = (symbol if factor != 1.0 else unit) if unit else _to_si(own)[1]
    try:
        return symbol_in_si, display_of(f"1 {own}", Unit(symbol_in_si)) if own else None
    except InputError:  # wrong dimension: reported when the number itself is parsed
        return symbol_in_si, None


def _written_unit(what: str, value: Any) -> str:
    """Return the unit of a string or a pint quantity, as written."""
    if _is_pint(value):
        return f"{value.units:~}".replace(" ", "").replace("**", "^")
    with about(what):
        unit = _parsed(value, '"50 kN/m"')[1]
        _root(unit, value)  # raises if the unit is unknown
    return unit


@lru_cache(maxsize=128)
def _to_si(unit: str) -> tuple[float, str]:
    """Return a unit's factor to SI, and the SI unit; a unit unknown to pint, such as a currency, stays as it is."""
    if unit in _EXAMPLES or unit in ("1", "-"):
        return 1.0, unit
    try:
        factor, kind = _root(unit, unit)
    except InputError:
        return 1.0, unit
    for symbol in _EXAMPLES:
        if _ROOTS[symbol][1] == kind:
            return factor / _ROOTS[symbol][0], symbol
    base_factor, base = registry().get_base_units(registry().parse_units(unit))
    return float(cast(float, base_factor)), f"{base:~}".replace(" ", "").replace("**", "^")


RESULT_DIGITS: Final = 4
"""Significant digits of printed results: tolerances are at best some 0.1 %, and the model does not deserve more."""
OBJECTIVE_DIGITS: Final = 6
"""Significant digits of printed objectives, which tell local optima apart."""


@dataclass(frozen=True)
class Display:
    """A unit in which results are displayed, usually the one that the user wrote.

    Attributes:
        symbol: of the unit.
        factor: value in SI over displayed value.
    """

    symbol: str
    factor: float

    def text(self, value: float, digits: int = 5) -> str:
        """Return an SI value in this unit as text."""
        return f"{value / self.factor:.{digits}g} {self.symbol}".rstrip()

    def result(self, value: float) -> str:
        """Return a result, SI, in this unit as text."""
        return self.text(value, RESULT_DIGITS)

    def heading(self, name: str) -> str:
        """Return a column heading for values in this unit."""
        return f"{name} [{self.symbol}]" if self.symbol else name


# Units that take the prefix kilo from 1000 on.
_KILO: Final = ("N", "W", "Pa", "N/m")
# Lengths all below this [m] are displayed in millimetres.
_SHORT: Final = 0.01


def customary(unit: str, *values: float) -> Display:
    """Return the unit in which an engineer expects values: degrees, kN from 1000 N on, mm for short lengths.

    Args:
        unit: SI unit.
        values: all values displayed together, SI; the largest decides.
    """
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    if unit == "rad":
        return Display("deg", math.pi / 180.0)
    if unit in _KILO and largest >= 1e3:
        return Display(f"k{unit}", 1e3)
    if unit == "m" and 0.0 < largest < _SHORT:
        return Display("mm", 1e-3)
    return Display("" if unit in ("1", "-") else unit, 1.0)


def in_words(value: float, unit: str, digits: int = 6) -> str:
    """Return a single value as text in its customary unit."""
    return customary(unit, value).text(value, digits)


def display_of(value: object, unit: Unit) -> Display:
    """Return the unit in which a valid quantity was written."""
    _, factor = unit.split(value)
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    return Display(match["unit"] if match else unit.symbol, factor)


def _root(written: str, value: object, wanted: Iterable[str] | None = None) -> tuple[float, str]:
    """Return a unit's factor to pint's root units, and those units, which distinguish an angle from a number.

    Args:
        written: the unit.
        value: the quantity, for messages.
        wanted: units to list if nothing like the written one is known (default: all common ones).
    """
    if written in _ROOTS:
        return _ROOTS[written]
    try:
        factor, root = registry().get_root_units(registry().parse_units(written.replace("%", "percent")))
    except Exception as error:  # pint's parser raises errors of many types
        names = getattr(error, "unit_names", None)  # set if the unit is unknown
        if names is None:
            text = f'= "{value}" is not a quantity: its unit cannot be read; write one like "kN*s/m"'
            raise InputError(text) from None
        names = names if isinstance(names, str) else ", ".join(names)
        valid = _AMBIGUOUS.get(names) or nearest(names, filter(None, _ROOTS), filter(None, wanted or _ROOTS))
        raise InputError(f"= \"{value}\" has an unknown unit '{names}': {valid}") from None
    return float(cast(float, factor)), str(root)
