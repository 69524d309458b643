"""Variables, parameters and requirements of a design, checked when they are declared."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_bounds, check_limits, check_named, check_switch, plain_number, shown
from plough_opt.core.errors import InputError, short
from plough_opt.core.expressions import Expression, absolute, exp, log, maximum, minimum
from plough_opt.core.units import PER_CENT, Display, customary, in_si, in_words

# A saved result quotes at most this many characters of an expression: a whole one fills pages.
_MOST_CHARACTERS = 400
# The domain of a quantity without known limits.
EVERYWHERE = (-math.inf, math.inf)


class Scaled:
    """A quantity that is 0 to 1 between its bounds, evenly in its value or in its logarithm."""

    lower: float
    upper: float
    log: bool

    def scaled(self, value: Expression) -> Expression:
        """Return the scaled quantity from a value."""
        if self.log:
            return log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def unscaled(self, y: Expression) -> Expression:
        """Return the value from the scaled quantity."""
        if self.log:
            return self.lower * exp(y * math.log(self.upper / self.lower))
        return self.lower + (self.upper - self.lower) * y

    def slope(self, y: float) -> float:
        """Return d value / d scaled quantity."""
        return float(self.unscaled(y)) * math.log(self.upper / self.lower) if self.log else self.upper - self.lower


@dataclass(frozen=True)
class Variable(Scaled):
    """A quantity that the optimiser may choose, between finite bounds."""

    name: str
    symbol: ca.MX
    guess: float
    lower: float
    upper: float
    unit: str
    log: bool
    tolerance: float | str | None = None
    domain: tuple[float, float] = EVERYWHERE
    display: Display | None = None  # unit in reports, if the user chose one

    def __post_init__(self) -> None:
        text = f"variable '{self.name}'"
        check_switch(f"{text}: log", self.log)
        show = partial(in_words, unit=self.unit)
        check_bounds(text, self.lower, self.upper, self.guess, log=self.log, show=show)
        self._half_width(self.guess)  # raises InputError if the tolerance is not valid

    @property
    def shown(self) -> Display:
        """The unit in reports."""
        return self.display or customary(self.unit, self.lower, self.upper)

    def value(self, y: float) -> float:
        """Return the value from the scaled variable, and exactly the bound at or beyond 0 and 1."""
        if y <= 0.0:
            return self.lower
        if y >= 1.0:
            return self.upper
        return float(self.unscaled(y))

    def tolerance_interval(self, y: Expression) -> tuple[Expression, Expression]:
        """Return the ends of the tolerance interval around a scaled variable, scaled and clipped at the bounds."""
        if self.tolerance is None:
            return maximum(y - _DEFAULT_TOLERANCE, 0.0), minimum(y + _DEFAULT_TOLERANCE, 1.0)
        value = self.unscaled(y)
        half = self._half_width(value)
        return self.scaled(maximum(value - half, self.lower)), self.scaled(minimum(value + half, self.upper))

    def _half_width(self, value: Expression) -> Expression:
        """Return the declared tolerance at a value, in the variable's unit; 0 if none was declared.

        Raises:
            InputError: the tolerance is neither a half width nor a percentage.
        """
        given = self.tolerance
        part: Expression = 1.0
        if isinstance(given, str) and (number := PER_CENT.fullmatch(given)):
            given, part = float(number[1]), absolute(value) / 100.0
        # A NumPy float of few bytes could not be compared with the largest float.
        given = float(given) if isinstance(given, np.floating) else given
        is_number = isinstance(given, int | float | np.number) and not isinstance(given, bool)
        if self.tolerance is not None and not (is_number and 0.0 <= cast(float, given) <= sys.float_info.max):
            raise InputError(
                f"variable '{self.name}': tolerance = {shown(self.tolerance)} must be a half width in"
                f" {self.unit or '1'}, not below 0, or a percentage of the value such as '0.5 %'"
            )
        return float(given or 0.0) * part


# Half width of the tolerance interval if none is declared, as a part of the range of the scaled variable.
_DEFAULT_TOLERANCE = 0.003


@dataclass(frozen=True)
class Parameter:
    """A quantity with a fixed value in each solve, which may differ between solves."""

    name: str
    symbol: ca.MX
    value: float
    unit: str
    domain: tuple[float, float] = EVERYWHERE

    def __post_init__(self) -> None:
        if not self.domain[0] <= self.value <= self.domain[1]:
            low, high, value = (in_words(x, self.unit) for x in (*self.domain, self.value))
            raise InputError(f"parameter '{self.name}': {value} lies outside its domain {low} to {high}")

    def at(self, value: Any) -> Parameter:
        """Return the parameter with another value: a number in its SI unit, a text with a unit, or a pint quantity."""
        what = f"parameter '{self.name}'"
        return replace(self, value=plain_number(what, in_si(what, value, self.unit)))


@dataclass(frozen=True)
class Requirement:
    """A named limit on an expression; every entry of a column must keep it."""

    name: str
    expression: ca.MX
    at_least: float | None
    at_most: float | None
    unit: str
    display: Display | None = None  # unit in reports, if the user chose one
    inside: float = 0.0  # distance that is kept from limits of 0

    def __post_init__(self) -> None:
        text = f"requirement '{self.name}'"
        if self.expression.numel() == 0:
            raise InputError(f"{text} has no value to limit: its expression is empty")
        check_limits(text, self.at_least, self.at_most, partial(in_words, unit=self.unit))

    @property
    def scale(self) -> float:
        """Size of the larger limit, by which the optimiser divides the expression; 0 for limits of zero."""
        return max(abs(limit) for limit in (self.at_least, self.at_most) if limit is not None)

    @property
    def low(self) -> float:
        """Lower limit; minus infinity if there is none."""
        return -math.inf if self.at_least is None else self.at_least or self.inside

    @property
    def high(self) -> float:
        """Upper limit; infinity if there is none."""
        return math.inf if self.at_most is None else self.at_most or -self.inside

    @property
    def shown(self) -> Display:
        """The unit in reports."""
        return self.display or customary(self.unit, *(x for x in (self.at_least, self.at_most) if x is not None))

    def limits_text(self) -> str:
        """Return the limits in words."""
        sides = (("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{word} {self.shown.text(limit, 6)}" for word, limit in sides if limit is not None)

    def margins(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of each value from its limit, positive inside the limits."""
        return np.minimum(values - self.low, self.high - values)


@dataclass(frozen=True)
class Declarations:
    """All declarations of a design, in the order in which they were made."""

    variables: tuple[Variable, ...]
    parameters: tuple[Parameter, ...]
    objective: ca.MX
    requirements: tuple[Requirement, ...]

    def symbols(self) -> list[ca.MX]:
        """Return the symbols of the variables, followed by those of the parameters."""
        return [*(v.symbol for v in self.variables), *(p.symbol for p in self.parameters)]

    def expressions(self) -> list[ca.MX]:
        """Return objective and requirements."""
        return [self.objective, *(r.expression for r in self.requirements)]

    def named(self, numbers: Iterable[float]) -> dict[str, float]:
        """Return name -> number from a number for each variable."""
        return {v.name: float(x) for v, x in zip(self.variables, numbers, strict=True)}

    def parameter_values(self, changed: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the values of all parameters.

        Args:
            changed: name -> value of the parameters that differ from their declaration: a number in the parameter's SI
                unit, a text such as "50 kN/m", or a pint quantity.

        Raises:
            InputError: a name is not a parameter, or a value is not a finite number, has another unit, or lies outside
                the parameter's domain.
        """
        names = [p.name for p in self.parameters]
        for name in changed:
            check_named("{} is not a parameter of this design", name, names)
        return np.array([p.at(changed[p.name]).value if p.name in changed else p.value for p in self.parameters])

    def plain(self, values: Sequence[float] | NDArray[np.float64]) -> dict[str, dict[str, str | float | None]]:
        """Return all declarations as plain data, to be saved with a result.

        Args:
            values: of the parameters.
        """
        plain: dict[str, dict[str, str | float | None]] = {
            v.name: {
                "kind": "variable", "guess": v.guess, "lower": v.lower, "upper": v.upper, "unit": v.unit,
                "scale": "log" if v.log else "linear", "tolerance": v.tolerance,
            }
            for v in self.variables
        }  # fmt: skip
        for p, value in zip(self.parameters, values, strict=True):
            plain[p.name] = {"kind": "parameter", "value": float(value), "unit": p.unit}
        for r in self.requirements:
            plain[r.name] = {"kind": "requirement", "at_least": r.at_least, "at_most": r.at_most, "unit": r.unit,
                             "expression": short(str(r.expression), _MOST_CHARACTERS)}  # fmt: skip
        name = "objective" if "objective" not in plain else "objective (minimised)"
        return plain | {name: {"kind": "objective", "expression": short(str(self.objective), _MOST_CHARACTERS)}}

    def strangers(self, expression: ca.MX) -> list[str]:
        """Return the names of an expression's symbols that were not declared here, even if the name was."""
        known = {hash(symbol) for symbol in self.symbols()}
        return sorted({s.name() for s in ca.symvar(expression) if hash(s) not in known})

    def ranges(self) -> str:
        """Return the bounds of the variables in words."""
        return ", ".join(
            f"{v.name} from {in_words(v.lower, v.unit)} to {in_words(v.upper, v.unit)}" for v in self.variables
        )

    def describe(self, values: NDArray[np.float64]) -> str:
        """Return the variables with certain values in words."""
        return values_in_words(self.named(values), {v.name: v.unit for v in self.variables})


def values_in_words(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return values of variables with their units."""
    return ", ".join(f"{name} = {in_words(value, units[name])}" for name, value in values.items())
