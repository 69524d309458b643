"""Records of soil strength along a path, the rig that measured them, and the spectrum of a record."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core.checks import LARGEST, array_of, check_domain, check_kind, check_text, plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import read_fields
from plough_opt.soil.random_strength import Spectrum, Vector

# Fewest points from which a wave can be estimated.
_FEWEST = 32
# Most points of an evenly and an unevenly spaced record; a wave takes minutes to find in a longer one.
_MOST = 200_000
_MOST_UNEVEN = 10_000
# Spacings count as even up to this relative difference.
_EVEN = 1e-3
# Segments of Welch's method, which overlap by half under a Hann window.
_SEGMENTS = 8
# Correlation of the periodograms of neighbouring segments under that window.
_NEIGHBOURS = 1.0 / 36.0
# Within this fraction of the rig's resonance its force shows its own oscillation rather than the soil.
NEAR_RESONANCE = 0.2
# Smallest response of the rig that can be divided out; below it the quotient is noise.
_LEAST_RESPONSE = 0.1

LEVEL = 0.95
"""Level of the two-sided confidence intervals."""


@dataclass(frozen=True)
class Rig:
    """The mount on which a force was recorded; its response is divided out of the record.

    Args:
        mass: moving mass [kg].
        stiffness: spring stiffness [N/m].
        damping: damping coefficient [N s/m], at least 0.
        tow_speed: speed at which it was pulled [m/s], above 0.

    Raises:
        DomainError: a number lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> po.Rig(mass=40.0, stiffness=2e5, damping=400.0, tow_speed=1.5).tow_speed
        1.5
    """

    mass: float
    stiffness: float
    damping: float
    tow_speed: float

    def __post_init__(self) -> None:
        read_fields(
            self, damping="effects.damping", **{name: f"scene.{name}" for name in ("mass", "stiffness", "tow_speed")}
        )
        check_domain("tow speed of a rig", self.tow_speed, "m/s", above=0.0)

    def response(self, wave_number: Vector) -> NDArray[np.complex128]:
        """Return mount force over soil resistance [-] at wave numbers [rad/m]: (k + i w c)/(k - m w^2 + i w c).

        Example:
            >>> import plough_opt as po
            >>> rig = po.Rig(mass=40.0, stiffness=2e5, damping=400.0, tow_speed=1.5)
            >>> round(float(abs(rig.response(40.0))), 4)
            3.3062
        """
        turn = wave_number * self.tow_speed
        damped = 1j * turn * self.damping
        return (self.stiffness + damped) / (self.stiffness - self.mass * turn**2 + damped)

    @property
    def resonance(self) -> float:
        """Wave number [rad/m] of its resonance."""
        return math.sqrt(self.stiffness / self.mass) / self.tow_speed


@dataclass(frozen=True)
class StrengthRecord:
    """Soil strength along a path: cone index over position, or force over position with the rig that measured it.

    Args:
        position: position along the path [m], increasing.
        value: cone index [Pa], force [N], or any other measure of strength.
        rig: mount on which a force was recorded; None if the values are strength itself.
        name: name of the record in messages.

    Raises:
        InputError: there are fewer than 32 or more than 200,000 points (10,000 at uneven distances), positions do not
            increase, or a number is not finite.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> x = np.linspace(0.0, 8.0, 161)
        >>> record = po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x))
        >>> len(record.position)
        161
    """

    position: Vector
    value: Vector
    rig: Rig | None = None
    name: str = "the record"

    def __init__(self, position: ArrayLike, value: ArrayLike, rig: Rig | None = None, name: str = "the record") -> None:
        check_text("the name of a record", name)
        x, y = (array_of(given, f"{name}: positions and values must be numbers") for given in (position, value))
        check_kind("the rig", rig, Rig | None, "a Rig, or None if the values are strength itself")
        if x.ndim != 1 or x.shape != y.shape:
            raise InputError(
                f"{name}: positions and values must be columns of equal length, not of shapes {x.shape} and {y.shape}"
            )
        if not _FEWEST <= len(x) <= _MOST:
            raise InputError(f"{name}: it has {len(x)} points, but a spectrum needs {_FEWEST} to {_MOST}")
        if not (np.all(np.abs(x) <= LARGEST) and np.all(np.abs(y) <= LARGEST)):
            raise InputError(
                f"{name}: every position and value must be finite and at most {LARGEST:g} in magnitude: omit the others"
            )
        if np.any(np.diff(x) <= 0.0):
            place = int(np.argmax(np.diff(x) <= 0.0)) + 1
            raise InputError(f"{name}: positions must increase, but {x[place]:g} m follows {x[place - 1]:g} m")
        for key, given in (("position", x), ("value", y), ("rig", rig), ("name", name)):
            object.__setattr__(self, key, given)
        if len(x) > _MOST_UNEVEN and not self.even:
            raise InputError(
                f"{name}: it has {len(x)} points at uneven distances: resample it, or use at most {_MOST_UNEVEN}"
            )

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.position[-1] - self.position[0])

    @property
    def spacing(self) -> float:
        """Mean distance between points [m]."""
        return self.length / (len(self.position) - 1)

    @property
    def even(self) -> bool:
        """Whether the points are evenly spaced."""
        return bool(np.max(np.abs(np.diff(self.position) / self.spacing - 1.0)) <= _EVEN)

    def relative(self) -> Vector:
        """Return strength divided by its linear trend, minus 1.

        Raises:
            InputError: the trend falls to 0.

        Example:
            >>> import numpy as np
            >>> import plough_opt as po
            >>> x = np.linspace(0.0, 8.0, 161)
            >>> record = po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x))
            >>> round(float(np.std(record.relative())), 3)
            0.14
        """
        x = self.position - self.position[0]
        trend = np.polyval(np.polyfit(x, self.value, 1), x)
        if np.min(trend) <= 0.0:
            raise InputError(
                f"{self.name}: its linear trend falls to 0, so strength relative to it is not defined: use a"
                " part of the record in which it stays positive"
            )
        return self.value / trend - 1.0


def spectrum_of(record: StrengthRecord) -> Spectrum:
    """Return the spectrum of a record with its 95 % band, by Welch's method or, for uneven spacing, Lomb-Scargle."""
    from scipy import signal, stats  # slow to import, and rarely needed

    y = record.relative()
    if record.even:
        size = max(_FEWEST // 2, 2 * len(y) // (_SEGMENTS + 1))
        f, density = signal.welch(y, 1.0 / record.spacing, nperseg=min(size, len(y)), detrend="constant")
        count = max(1, (len(y) - size) // (size - size // 2) + 1)
        freedom = 2.0 * count / (1.0 + 2.0 * (count - 1) / count * _NEIGHBOURS)
        q, density = 2.0 * math.pi * f[1:], density[1:] / (2.0 * math.pi)
    else:
        step = 2.0 * math.pi / record.length
        q = step * np.arange(1, len(y) // 2 + 1)
        density, freedom = signal.lombscargle(record.position, y, q) * 2.0 / len(y) / step, 2.0
    band = [freedom / stats.chi2.ppf(p, freedom) for p in ((1.0 + LEVEL) / 2.0, (1.0 - LEVEL) / 2.0)]
    return Spectrum(q, density, density * band[0], density * band[1])


def strength_spectrum(record: StrengthRecord, *, base_diameter: float = 0.0) -> Spectrum:
    """Return the spectrum of the soil's strength from a record, for use as random strength in `Effects`.

    If the record is a force, the rig's response is divided out. The spectrum is then interpolated linearly across the
    rig's resonance, and wave numbers that the rig hardly passes on are left out. Waves shorter than two spacings are
    always left out.

    Args:
        record: strength or force along a path.
        base_diameter: diameter of the share's base [m]; shorter waves are left out, because the base averages them.

    Raises:
        DomainError: the diameter is not a finite number of at least 0.
        InputError: it leaves nothing of the spectrum, or the record's linear trend falls to 0.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> x = np.linspace(0.0, 8.0, 161)
        >>> record = po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x))
        >>> po.strength_spectrum(record).variance > 0.0
        True
    """
    diameter = checked_diameter(record, base_diameter)
    found = spectrum_of(record)
    usable, gain = found.wave_number * diameter <= 2.0 * math.pi, np.ones(len(found.wave_number))
    if record.rig is not None:
        resonant, damped = unresolved(record.rig, found.wave_number)
        usable, gain = usable & ~resonant & ~damped, np.abs(record.rig.response(found.wave_number)) ** 2
    if np.count_nonzero(usable) < 2:
        raise InputError(f"{record.name}: its spectrum has no waves longer than {diameter:.3g} m that its rig measured")
    columns = ((values / gain)[usable] for values in (found.density, found.lower, found.upper))
    return Spectrum(found.wave_number[usable], *columns)


def checked_diameter(record: StrengthRecord, base_diameter: float) -> float:
    """Return the diameter of a base [m] as a float; raise an error if it or the record is invalid."""
    check_kind("the record", record, StrengthRecord, "a StrengthRecord, as returned by read_strength_record")
    check_domain("base_diameter", base_diameter, "m", at_least=0.0)
    return plain_number("base_diameter", base_diameter)


def unresolved(rig: Rig, wave_number: Vector) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the wave numbers near a rig's resonance, and of those that it hardly passes on to its force."""
    resonant = np.abs(wave_number / rig.resonance - 1.0) < NEAR_RESONANCE
    return resonant, np.abs(rig.response(wave_number)) < _LEAST_RESPONSE
