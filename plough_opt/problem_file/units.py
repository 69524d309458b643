"""Quantities with units, read by pint and kept in SI."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import pint
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from plough_opt.errors import InputError, nearest

# What users write; the nearest of these is suggested for a unit that pint does not know.
_COMMON = (
    "m", "cm", "mm", "km", "deg", "rad", "kg", "g", "t", "s", "ms", "min", "h", "N", "kN", "Pa", "kPa", "MPa",
    "m/s", "km/h", "mph", "N/m", "kN/m", "N/mm", "N*s/m", "kN*s/m", "kg/m^3", "g/cm^3", "W", "kW", "s^2/m^2", "%",
)  # fmt: skip
_EXAMPLES = {
    "m": '"0.3 m"', "rad": '"25 deg"', "kg": '"20 kg"', "s": '"2 s"', "m/s": '"7.2 km/h"', "N/m": '"50 kN/m"',
    "N*s/m": '"400 N*s/m"', "Pa": '"20 kPa"', "kg/m^3": '"1350 kg/m^3"', "N": '"1 kN"', "W": '"1 kW"',
    "s^2/m^2": '"0.01 s^2/m^2"', "": "0.3",
}  # fmt: skip


@lru_cache(maxsize=1)
def registry() -> pint.UnitRegistry[Any]:
    """Return the one registry of units, made when first needed."""
    return pint.UnitRegistry()


@dataclass(frozen=True)
class Unit:
    """The SI unit that a key is kept in; "" for a pure number."""

    symbol: str

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let ``Annotated[float, Unit("m")]`` be the type of a field that parses quantities."""
        return core_schema.no_info_before_validator_function(self.parse, handler(float))

    def example(self) -> str:
        """Return a quantity of this kind as one would write it."""
        return _EXAMPLES[self.symbol]

    def parse(self, value: object) -> float:
        """Return a quantity as a number in this unit.

        Args:
            value: text with a unit, or a plain number where the unit is "".

        Raises:
            InputError: not a quantity, an unknown unit, or one of another dimension.
        """
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise InputError(f"is not a quantity: write it like {self.example()}")
        if not isinstance(value, str):
            if self.symbol:
                raise InputError(f"= {value} has no unit: write it like {self.example()}")
            return _finite(float(value), str(value))
        quantity = _quantity(value, self)
        try:
            number = float(quantity.to(self.symbol or "dimensionless").magnitude)
        except pint.DimensionalityError:
            kind = f"a quantity in {self.symbol}" if self.symbol else "a pure number"
            raise InputError(f'= "{value}" has the wrong unit: expected {kind}, like {self.example()}') from None
        return _finite(number, value)


@dataclass(frozen=True)
class Display:
    """The unit that a user wrote, to give results back in it: value in SI = factor times value displayed."""

    symbol: str
    factor: float

    def text(self, value: float, digits: int = 5) -> str:
        """Return an SI value in this unit as text."""
        return f"{value / self.factor:.{digits}g} {self.symbol}".rstrip()


def display_of(value: object, unit: Unit) -> Display:
    """Return the unit in which a parsed quantity was written."""
    if not isinstance(value, str):
        return Display(unit.symbol, 1.0)
    quantity = _quantity(value, unit)
    factor = float((1.0 * quantity.units).to(unit.symbol or "dimensionless").magnitude)
    return Display(f"{quantity.units:~}".replace(" ", "").replace("**", "^"), factor)


def _quantity(value: str, unit: Unit) -> Any:
    try:
        return registry().Quantity(value)
    except pint.UndefinedUnitError as error:
        names = error.unit_names if isinstance(error.unit_names, str) else ", ".join(error.unit_names)
        raise InputError(f"= \"{value}\" has an unknown unit '{names}': {nearest(names, _COMMON)}") from None
    except Exception:  # pint's parser raises whatever it stumbles over
        raise InputError(f'= "{value}" is not a quantity: write it like {unit.example()}') from None


def _finite(number: float, text: str) -> float:
    if not math.isfinite(number):
        raise InputError(f"= {text} must be finite")
    return number
