"""The registry of quantities: name, unit, domain and meaning of every number in a scene.

Files, designs, components, exports, calibration, distributions, sweeps and the documentation's table all read it. A
quantity's name is its key in problem files, such as "soil.cohesion".
"""

import math
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from types import FrameType
from typing import Any, Final

import numpy as np

from plough_opt.core.checks import LARGEST, check_domain
from plough_opt.core.errors import DomainError, ImplausibleValue
from plough_opt.core.expressions import Expression
from plough_opt.core.units import Unit, has_unit, in_si

# SI unit -> units that users often have in mind when they pass a plain number, with factors, likeliest first.
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


def _warn_implausible(question: str, stacklevel: int) -> None:
    """Warn of an implausible number if the user's own code passed it, not when the toolkit copies a scene.

    Args:
        question: names the value and asks whether another unit was meant.
        stacklevel: stack level of the warning; 2 is the line that calls the caller of this function.
    """
    frame: FrameType | None = sys._getframe(stacklevel)
    while frame is not None and frame.f_globals.get("__name__") == "dataclasses":  # skip `dataclasses.replace`
        frame, stacklevel = frame.f_back, stacklevel + 1
    if frame is not None and str(frame.f_globals.get("__name__")).partition(".")[0] != "plough_opt":
        text = f"{question} Plain numbers are in SI units; write the value as a string with its unit to be explicit"
        warnings.warn(text, ImplausibleValue, stacklevel=stacklevel + 1)


@dataclass(frozen=True)
class Quantity:
    """A number in a scene, or one that determines the scene's mass or duration.

    Attributes:
        name: key in problem files.
        meaning: description, with the symbol.
        unit: SI unit, "" for a pure number.
        typical: a value inside the domain.
        called: name in messages (default: its key in words).
        place: attributes and tuple indices that lead to it from a scene (default: as its name says); () for a number
            outside the scene.
        low: lower end of the model's domain.
        high: upper end of the domain.
        above: whether the lower end is excluded.
        below: whether the upper end is excluded.
        shown: unit in which readers expect it, if not the SI unit.
        why: reason for the limits, appended to messages.
        required: whether a problem file must give it or make it a variable.
        in_files: whether problem files have it.
        default: value if a problem file omits it.
        plausible: generous range of values found in practice. A value outside it that another unit would bring inside
            is taken for a slip.
    """

    name: str
    meaning: str
    unit: str
    typical: float
    called: str = ""
    place: tuple[str | int, ...] | None = None
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "called", self.called or self.key.replace("_", " "))

    @cached_property
    def path(self) -> tuple[str | int, ...]:
        """Attributes and tuple indices that lead to it from a scene."""
        return tuple(self.name.removeprefix("scene.").split(".")) if self.place is None else self.place

    @property
    def owner(self) -> str:
        """Table of a problem file that holds it, such as "soil" or "effects.strength_wave_2"."""
        return self.name.rpartition(".")[0]

    @property
    def key(self) -> str:
        """Name within that table."""
        return self.name.rpartition(".")[2]

    @property
    def domain(self) -> tuple[float, float]:
        """Ends of the model's domain."""
        return self.low, self.high

    @cached_property
    def ordinary(self) -> tuple[float, float]:
        """Range inside both the domain and the plausible range; numbers in it need no further check."""
        return max(self.low, self.plausible[0]), min(self.high, self.plausible[1])

    def read(self, value: Any, stacklevel: int = 2) -> Expression:
        """Return a checked value in SI; warn if a plain number looks like a slip of the unit.

        Args:
            value: a string such as "50 kN/m", a pint quantity, or a number, array or expression in SI.
            stacklevel: stack level of the warning, 2 for the caller's line.

        Raises:
            InputError: the string is not a quantity, or the unit has the wrong dimension.
            DomainError: as `check`.
        """
        plain, value = not has_unit(value), in_si(self.called, value, self.unit)
        slip = self.slip(value) if plain else ""
        try:
            read: Expression = self.check(value)
        except DomainError as error:
            raise DomainError(f"{error}; {slip}" if slip else str(error)) from None
        if slip:
            _warn_implausible(f"{self.called} = {value:g} {self.unit}: {slip}", stacklevel + 1)
        return read

    def slip(self, value: Any) -> str:
        """Return a question if a number is implausible in SI but plausible in another customary unit, else ""."""
        low, high = self.plausible
        # As a Python number: NumPy's short types cannot be compared with numbers beyond their range.
        value = value.item() if isinstance(value, np.integer | np.floating) else value
        # An integer may be larger than any float.
        comparable = isinstance(value, int | float) and -LARGEST <= value <= LARGEST
        if not comparable or low <= value <= high or not value:
            return ""
        for symbol, factor in _SLIPS.get(self.unit, ()):
            if max(low, self.low) <= value * factor <= min(high, self.high):
                return f"did you mean {value:g} {symbol}?"
        return ""

    def check(self, value: Expression) -> Any:
        """Return what `check_domain` returns.

        Raises:
            DomainError: the value is not a finite number inside the domain; a symbol passes.
        """
        ends: dict[str, Any] = {"above" if self.above else "at_least": self.low,
                                "below" if self.below else "at_most": self.high}  # fmt: skip
        return check_domain(self.called, value, self.unit, why=self.why, **ends)


def _angle(name: str, meaning: str, typical: float, **more: Any) -> Quantity:
    """Return an angle below 90 degrees."""
    return Quantity(name, meaning, "rad", typical, high=math.pi / 2, below=True, plausible=(0.0, math.pi / 2),
                    shown="deg", **more)  # fmt: skip


def _by_name(*listed: Quantity) -> dict[str, Quantity]:
    return {quantity.name: quantity for quantity in listed}


_NO_PUSH = "soil cannot push the share forward"
_COMPACTS = "it is the ratio of undisturbed to locked density, and the plastic gas model needs soil that compacts"
MOST_WAVES = 8
"""Largest number of strength waves in a scene."""


def wave_table(number: int) -> str:
    """Return the table of a problem file that holds a strength wave, numbered from 1."""
    return "effects.strength_wave" if number == 1 else f"effects.strength_wave_{number}"


def _wave(number: int) -> tuple[Quantity, ...]:
    """Return the quantities of a strength wave."""
    table, path = wave_table(number), ("effects", "strength_wave", number - 1)
    which = "" if number == 1 else f" {number}"
    return (
        Quantity(f"{table}.amplitude", "amplitude epsilon of the soil's strength", "", 0.3, high=1.0,
                 why=_NO_PUSH, called=f"strength wave amplitude{which}", place=(*path, "amplitude")),
        Quantity(f"{table}.wavelength", "wavelength of the soil's strength along the path", "m", 0.2, above=True,
                 plausible=(0.0, 50.0), called=f"strength wavelength{which}", place=(*path, "wavelength")),
        Quantity(f"{table}.phase", "phase of the soil's strength at travel 0", "rad", 0.0, low=-2.0 * math.pi,
                 high=2.0 * math.pi, shown="deg", called=f"strength wave phase{which}", place=(*path, "phase")),
    )  # fmt: skip


QUANTITIES: dict[str, Quantity] = _by_name(
    Quantity("soil.density", "density rho0 of the undisturbed soil", "kg/m^3", 1350.0, called="soil density",
             above=True, required=True, plausible=(500.0, 4e3)),
    Quantity("soil.density_ratio", "ratio b1 of undisturbed to locked density", "", 0.8, called="density ratio b1",
             high=1.0, above=True, below=True, why=_COMPACTS, required=True),
    Quantity("soil.cohesion", "cohesion k", "Pa", 2e4, shown="kPa", required=True, plausible=(200.0, 1e6)),
    _angle("soil.friction_angle", "angle of internal friction theta", 0.5, required=True),
    Quantity("soil.tool_friction", "friction mu0 of soil on metal", "", 0.5, required=True),
    Quantity("soil.ambient_pressure", "pressure p_a ahead of the compaction front", "Pa", 1e5, shown="kPa",
             plausible=(200.0, 1e6)),
    Quantity("soil.youngs_modulus", "Young's modulus E", "Pa", 1e7, called="Young's modulus", above=True,
             shown="MPa", plausible=(1e5, 1e10)),
    Quantity("soil.poisson_ratio", "Poisson's ratio", "", 0.3, called="Poisson's ratio", high=0.5, below=True),
    Quantity("soil.strength_factor", "ratio of measured to computed static resistance", "", 1.0, above=True),
    _angle("share.wedge_angle", "wedge angle lambda at the top of the share", 0.5, place=("share", "angle"),
           above=True, required=True),
    _angle("share.chisel_angle", "angle beta_pl of the chisel point to the base", 0.25, required=True),
    _angle("share.half_angle", "half angle beta of the cone", 0.25, above=True, in_files=False),
    Quantity("share.height", "height h of the share", "m", 0.25, called="share height", above=True, required=True,
             plausible=(0.02, 3.0)),
    Quantity("scene.stiffness", "stiffness k0 of the mount", "N/m", 5e4, above=True, shown="kN/m", required=True,
             plausible=(1e3, 1e9)),
    Quantity("scene.mass", "mass m of all moving parts, without the soil", "kg", 20.0, above=True,
             why="the share itself moves", in_files=False, plausible=(0.2, 5e4)),
    Quantity("scene.tow_speed", "speed V0 of the strut", "m/s", 2.0, high=1e40, shown="km/h", required=True,
             why="a faster motion cannot be integrated in floating point", plausible=(0.0, 6.0)),
    *(quantity for number in range(1, MOST_WAVES + 1) for quantity in _wave(number)),
    Quantity("effects.random_strength.rms", "standard deviation of the soil's random strength, relative to the mean",
             "", 0.2, called="RMS of random strength", high=1.0, why=_NO_PUSH),
    Quantity("effects.random_strength.correlation_length",
             "distance over which the correlation of the soil's random strength falls to 1/e", "m", 0.3, above=True),
    Quantity("effects.tow_ramp", "time over which the strut's speed rises from 0", "s", 0.5),
    Quantity("effects.damping", "viscous damper c in the mount", "N*s/m", 400.0, plausible=(5.0, math.inf)),
    Quantity("effects.speed_term", "lambda of the static resistance F0 (1 + lambda L')", "s/m", 0.1),
    Quantity("effects.rate_term", "kappa of the static resistance F0 (1 + kappa L'^2)", "s^2/m^2", 0.01),
    Quantity("effects.contact_width", "speed of the share above which the soil offers its full resistance", "m/s", 0.1,
             called="width of the smooth contact", place=("effects", "contact", "width"), above=True),
    Quantity("effects.breakaway", "ratio of the resistance that frees a sticking share to the static resistance", "",
             1.2, called="breakaway ratio", place=("effects", "contact", "breakaway"), low=1.0),
)  # fmt: skip
"""Quantities of a scene by name; "share.half_angle" belongs to a share given as a cone."""

BESIDE: dict[str, Quantity] = _by_name(
    Quantity("scene.duration", "simulated time", "s", 2.0, place=(), above=True, required=True),
    Quantity("scene.frame_mass", "mass of all moving parts, without share and soil", "kg", 20.0, place=(),
             required=True, plausible=(0.0, 5e4)),
    Quantity("scene.steel_density", "density of the share's material, from which its mass follows", "kg/m^3", 7850.0,
             called="density of the share's material", place=(), default=7850.0, plausible=(500.0, 25e3)),
)  # fmt: skip
"""Quantities outside a scene: its duration, and those that determine its mass."""

READINGS: dict[str, Quantity] = _by_name(
    Quantity("soil.cone_index", "pressure on a penetrometer's cone", "Pa", 1e6, place=(), above=True, shown="MPa",
             plausible=(1e4, 1e8)),
)  # fmt: skip
"""Measured values in a problem file that determine another property of its soil."""

EVERY: dict[str, Quantity] = {**QUANTITIES, **BESIDE, **READINGS}
"""Every quantity by name."""

IN_FILES: dict[str, Quantity] = {name: quantity for name, quantity in EVERY.items() if quantity.in_files}
"""Quantities of a problem file by name."""


def quantities() -> dict[str, Unit]:
    """Return the key of every quantity in problem files, such as "share.height", with its unit."""
    return {name: Unit(quantity.unit) for name, quantity in IN_FILES.items()}


def warn_of_slips(what: str, unit: str, values: Iterable[Any]) -> None:
    """Warn of plain numbers that are implausible for every quantity with their unit.

    The warning names the line that calls the caller of this function.

    Args:
        what: name of the values, for the user.
        unit: SI unit.
        values: numbers, strings, pint quantities.
    """
    alike = [q for q in EVERY.values() if q.unit == unit and q.plausible != (-math.inf, math.inf)]
    for value in values:
        if alike and not has_unit(value) and all(slips := [quantity.slip(value) for quantity in alike]):
            _warn_implausible(f"{what} = {value:g} {unit}: {slips[0]}", stacklevel=3)
            return


def read_fields(owner: object, **names: str) -> None:
    """Replace fields of a frozen dataclass by their checked values in SI; called in its ``__post_init__``.

    Args:
        owner: the object.
        names: field -> name of its quantity; a field whose default is None may be None.

    Raises:
        InputError, DomainError: as `Quantity.read`.
    """
    for field, name in names.items():
        value = getattr(owner, field)
        quantity = EVERY[name]
        if type(value) is float and quantity.ordinary[0] < value < quantity.ordinary[1]:
            continue
        if value is None and getattr(type(owner), field, "none") is None:
            continue
        # Three frames lie between `read` and the user's code: this function, __post_init__ and the generated __init__.
        checked = quantity.read(value, stacklevel=4)
        if checked is not value:
            object.__setattr__(owner, field, checked)
