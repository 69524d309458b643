"""Unknowns: quantities to find between bounds, scaled to the interval from 0 to 1."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from plough_opt.core.checks import check_domain, check_named, mapping_of, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, exp
from plough_opt.core.quantities import every_quantity

CUSTOMARY: Final = {
    "rad": ("deg", math.pi / 180.0),
    "Pa": ("kPa", 1e3),
    "N": ("kN", 1e3),
    "N/m": ("kN/m", 1e3),
    "W": ("kW", 1e3),
}
"""SI unit -> the unit in which amounts are shown, and its factor."""
# From this ratio of the bounds on an unknown is scaled logarithmically.
_WIDE = 10.0


@dataclass(frozen=True)
class Unknown:
    """A quantity to be found.

    Attributes:
        name: its key in a problem file, such as "soil.cohesion".
        unit: SI unit.
        lower: least value.
        upper: largest value.
        guess: start of the search.
        log: whether its logarithm is scaled, for a quantity above 0 of unknown order of magnitude.
    """

    name: str
    unit: str
    lower: float
    upper: float
    guess: float
    log: bool

    def value(self, y: Expression) -> Expression:
        """Return the quantity at a scaled value from 0 to 1, a number or a symbol."""
        if self.log:
            return self.lower * exp(y * math.log(self.upper / self.lower))
        return self.lower + y * (self.upper - self.lower)

    def slope(self, y: float) -> float:
        """Return the derivative of the quantity by its scaled value."""
        if self.log:
            return float(self.value(y)) * math.log(self.upper / self.lower)
        return self.upper - self.lower

    def scaled(self, value: float) -> float:
        """Return the scaled value of a quantity."""
        if self.log:
            return math.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)


def amount(value: float, unit: str) -> str:
    """Return an SI value in a customary unit as text of three digits."""
    symbol, factor = CUSTOMARY.get(unit, (unit, 1.0))
    return f"{value / factor:.3g} {symbol}".rstrip()


def unknowns_of(given: Mapping[str, Any], current: Mapping[str, float]) -> tuple[Unknown, ...]:
    """Return checked unknowns.

    Args:
        given: key -> (lower, upper) or (lower, upper, guess), SI numbers or text with a unit such as "5 kPa".
        current: values of the scene, which are the guesses if they lie between the bounds.

    Raises:
        InputError: an unknown name, or invalid bounds.
    """
    if not mapping_of("unknown", given, "{'soil.cohesion': (1e3, 80e3)}"):
        raise InputError("there are no unknowns: name each with its bounds, as {'soil.cohesion': (1e3, 80e3)}")
    return tuple(_unknown(name, bounds, current.get(name)) for name, bounds in given.items())


def _unknown(name: str, bounds: Any, current: float | None) -> Unknown:
    units = every_quantity()
    check_named("{} cannot be an unknown", name, units)
    if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) not in (2, 3):
        raise InputError(f"'{name}' = {shown(bounds)} must be (lower, upper) or (lower, upper, guess)")
    numbers = []
    for side, written in zip(("lower", "upper", "guess"), bounds, strict=False):
        try:
            number = units[name].parse(written) if isinstance(written, str) else written
        except InputError as error:
            raise InputError(f"{side} bound of '{name}' {error}") from None
        check_domain(f"{side} bound of '{name}'", number, units[name].symbol)
        numbers.append(float(number))
    lower, upper = numbers[:2]
    if not lower < upper:
        raise InputError(f"'{name}': the lower bound {lower:g} must be below the upper bound {upper:g}")
    log = lower > 0.0 and upper / lower >= _WIDE
    middle = math.sqrt(lower * upper) if log else (lower + upper) / 2.0
    guess = numbers[2] if len(numbers) == 3 else current
    if guess is None or (len(numbers) == 2 and not lower < guess < upper):
        guess = middle
    if not lower <= guess <= upper:
        raise InputError(f"'{name}': the guess {guess:g} must lie between {lower:g} and {upper:g}")
    return Unknown(name, units[name].symbol, lower, upper, guess, log)
