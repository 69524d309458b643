"""Quantity: the domain of a number, how it is read, and which slip of its unit is likely."""

import math
import sys
import warnings
from dataclasses import dataclass
from functools import cached_property
from types import FrameType
from typing import Any, Final

import numpy as np

from plough_opt.core.domain import LARGEST, check_domain
from plough_opt.core.errors import DomainError, ImplausibleValue
from plough_opt.core.expressions import Expression
from plough_opt.core.units import has_unit, in_si

# SI unit -> units that are often meant by a number in it, with their factors, the likeliest first.
_SLIPS: Final = {
    "N/m": (("kN/m", 1e3),),
    "m": (("mm", 1e-3), ("cm", 1e-2)),
    "rad": (("deg", math.pi / 180.0),),
    "Pa": (("kPa", 1e3), ("MPa", 1e6)),
    "kg/m^3": (("g/cm^3", 1e3),),
    "kg": (("t", 1e3), ("g", 1e-3)),
    "m/s": (("km/h", 1.0 / 3.6),),
    "N*s/m": (("kN*s/m", 1e3),),
    "s": (("ms", 1e-3),),
}


def warn_of(question: str, stacklevel: int) -> None:
    """Warn of an implausible number that a user's program gives; what the toolkit makes again says nothing new.

    Args:
        question: with the name and the value.
        stacklevel: of the warning, 2 for the line that calls the caller of this function.
    """
    frame: FrameType | None = sys._getframe(stacklevel)
    while frame is not None and frame.f_globals.get("__name__") == "dataclasses":  # `replace` makes it for its caller
        frame, stacklevel = frame.f_back, stacklevel + 1
    if frame is not None and str(frame.f_globals.get("__name__")).partition(".")[0] != "plough_opt":
        text = f"{question} Plain numbers are SI; a text with its unit says what is meant"
        warnings.warn(text, ImplausibleValue, stacklevel=stacklevel + 1)


@dataclass(frozen=True)
class Quantity:
    """A number that a scene holds, or that its mass and duration follow from.

    Attributes:
        name: key in problem files.
        called: what messages call it.
        meaning: what it is, with its symbol.
        unit: SI unit, "" for a pure number.
        typical: a value inside the domain.
        path: attributes, and places in tuples, that lead to it from a scene; () for a number beside the scene.
        low: lower end of the model's domain.
        high: upper end of the domain.
        above: whether the lower end is excluded.
        below: whether the upper end is excluded.
        shown: unit in which a reader expects it, if not the SI one.
        why: where the limits come from, added to messages.
        required: whether a problem file must give it or make it a variable.
        in_files: whether problem files have it.
        default: value in a problem file that leaves it out.
        plausible: from and to which values are found in practice, wide; a value outside that another unit would bring
            inside is taken for a slip.
    """

    name: str
    called: str
    meaning: str
    unit: str
    typical: float
    path: tuple[str | int, ...]
    low: float = 0.0
    high: float = math.inf
    above: bool = False
    below: bool = False
    shown: str = ""
    why: str = ""
    required: bool = False
    in_files: bool = True
    default: float | None = None
    plausible: tuple[float, float] = (-math.inf, math.inf)

    @property
    def owner(self) -> str:
        """The table of a problem file that holds it, as "soil" or "effects.strength_wave_2"."""
        return self.name.rpartition(".")[0]

    @property
    def key(self) -> str:
        """Its name within that table."""
        return self.name.rpartition(".")[2]

    @property
    def domain(self) -> tuple[float, float]:
        """The ends of the model's domain."""
        return self.low, self.high

    @cached_property
    def ordinary(self) -> tuple[float, float]:
        """Between which a number lies that is in the domain and plausible: almost every one, so it is read at once."""
        return max(self.low, self.plausible[0]), min(self.high, self.plausible[1])

    def read(self, value: Any, stacklevel: int = 2) -> Expression:
        """Return a value in SI, checked; a plain number that looks like a slip of the unit carries a warning.

        Args:
            value: a text such as "50 kN/m", a pint quantity, or what is in SI: a number, an array or an expression.
            stacklevel: of the warning, 2 for the caller's line.

        Raises:
            InputError: a text that is not a quantity, or a unit of another kind.
            DomainError: as `check`.
        """
        if type(value) is not float:
            plain, value = not has_unit(value), in_si(self.called, value, self.unit)
        else:
            plain = True
        slip = self.slip(value) if plain else ""
        try:
            self.check(value)
        except DomainError as error:
            raise DomainError(f"{error}; {slip}" if slip else str(error)) from None
        if slip:
            warn_of(f"{self.called} = {value:g} {self.unit}: {slip}", stacklevel + 1)
        return value

    def slip(self, value: Any) -> str:
        """Return a question if a number is implausible in SI but plausible in another customary unit, else ""."""
        low, high = self.plausible
        # In Python's own floats: NumPy's short ones cannot be compared with numbers beyond their range.
        value = value.item() if isinstance(value, np.integer | np.floating) else value
        # A whole number may be larger than any float.
        known = isinstance(value, int | float) and -LARGEST <= value <= LARGEST
        if not known or low <= value <= high or not value:
            return ""
        for symbol, factor in _SLIPS.get(self.unit, ()):
            if max(low, self.low) <= value * factor <= min(high, self.high):
                return f"did you mean {value:g} {symbol}?"
        return ""

    def check(self, value: Expression) -> None:
        """Refuse a number outside the domain; a symbol passes.

        Raises:
            DomainError: not a number, or one that is not finite or lies outside.
        """
        check_domain(
            self.called,
            value,
            self.unit,
            above=self.low if self.above else -math.inf,
            at_least=-math.inf if self.above else self.low,
            below=self.high if self.below else math.inf,
            at_most=math.inf if self.below else self.high,
            why=self.why,
        )
