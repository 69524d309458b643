"""Records of soil strength along a field, the rig that felt a force, and the spectrum of a record."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core.checks import LARGEST, NOT_NUMBERS, check_domain, check_kind, check_text, plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import read_fields
from plough_opt.soil.random_strength import Spectrum, Vector

# Points without which no wave is worth the name, and points, evenly spaced or not, beyond which one takes minutes.
_FEWEST, _MOST, _MOST_UNEVEN = 32, 200_000, 10_000
# Relative difference of spacings up to which they count as even.
_EVEN = 1e-3
# Segments of Welch's method, half overlapping under Hann's window, and the correlation of neighbours' squares under it.
_SEGMENTS, _NEIGHBOURS = 8, 1.0 / 36.0
# How near to the rig's resonance its response no longer depends on the soil, as a part of that frequency.
NEAR_RESONANCE = 0.2
# Least part of the soil's fluctuation that the rig must pass on: a quotient of less is noise.
_LEAST_RESPONSE = 0.1

LEVEL = 0.95
"""Of confidence intervals, two-sided."""


@dataclass(frozen=True)
class Rig:
    """The mount on which a force was recorded, whose own response is divided out of the record.

    Args:
        mass: moving mass [kg].
        stiffness: of its spring [N/m].
        damping: of its damper [N s/m], at least 0.
        tow_speed: speed at which it was pulled [m/s].

    Raises:
        DomainError: a number outside its domain.

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

    def response(self, wave_number: Vector) -> NDArray[np.complex128]:
        """Return mount force over soil resistance [-] at wave numbers [rad/m]: (k + i w c)/(k - m w^2 + i w c)."""
        turn = wave_number * self.tow_speed
        damped = 1j * turn * self.damping
        ratio: NDArray[np.complex128] = (self.stiffness + damped) / (self.stiffness - self.mass * turn**2 + damped)
        return ratio

    @property
    def resonance(self) -> float:
        """Wave number [rad/m] at which it resonates."""
        return math.sqrt(self.stiffness / self.mass) / self.tow_speed


@dataclass(frozen=True)
class StrengthRecord:
    """Soil strength along a path: cone index over position, or force over position with the rig that it was felt by.

    Args:
        position: along the path [m], rising.
        value: cone index [Pa], force [N], or any other measure of strength.
        rig: mount on which a force was recorded; None: the values are strength itself.
        name: what messages call it.

    Raises:
        InputError: fewer than 32 points or more than a million, positions that do not rise, or numbers that are not
            finite.

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
        try:
            x, y = (np.asarray(given, dtype=float).copy() for given in (position, value))
        except NOT_NUMBERS:
            raise InputError(f"{name}: positions and values must be numbers") from None
        check_kind("the rig", rig, Rig | None, "a Rig, or None of strength itself")
        if x.ndim != 1 or x.shape != y.shape:
            raise InputError(
                f"{name}: positions and values of the shapes {x.shape} and {y.shape} must be alike columns"
            )
        if not _FEWEST <= len(x) <= _MOST:
            raise InputError(
                f"{name}: it has {len(x)} points, and a spectrum takes at least {_FEWEST} and at most {_MOST}"
            )
        if not (np.all(np.abs(x) <= LARGEST) and np.all(np.abs(y) <= LARGEST)):
            raise InputError(
                f"{name}: every position and value must be finite, and within {LARGEST:g} in size: leave the others out"
            )
        if np.any(np.diff(x) <= 0.0):
            place = int(np.argmax(np.diff(x) <= 0.0)) + 1
            raise InputError(f"{name}: positions must rise, and {x[place]:g} m follows {x[place - 1]:g} m")
        for key, given in (("position", x), ("value", y), ("rig", rig), ("name", name)):
            object.__setattr__(self, key, given)
        if len(x) > _MOST_UNEVEN and not self.even:
            raise InputError(
                f"{name}: it has {len(x)} points at uneven distances: resample it, or take {_MOST_UNEVEN} of them"
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
        """Return strength over its linear trend, less 1.

        Raises:
            InputError: a trend that reaches 0.
        """
        trend = np.polyval(
            np.polyfit(self.position - self.position[0], self.value, 1), self.position - self.position[0]
        )
        if np.min(trend) <= 0.0:
            raise InputError(f"{self.name}: its linear trend falls to 0: strength cannot be given relative to it")
        found: Vector = self.value / trend - 1.0
        return found


def spectrum_of(record: StrengthRecord) -> Spectrum:
    """Return the spectrum of a record: Welch's for even spacing, else that of Lomb and Scargle, with its 95 % band."""
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
    """Return the spectrum of the soil's strength from a record, as `Effects` takes it for random strength.

    Of a force the rig's response is divided out, and the spectrum is taken as linear across the wave numbers of the
    rig's resonance; those that it hardly passes on are left out, and so are waves shorter than two spacings.

    Args:
        record: strength or force along a path.
        base_diameter: of the share [m]: shorter waves are left out, which its base averages.

    Raises:
        InputError: a diameter that is not a number of metres, or one beside which nothing of the record is left.

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
    kept, gain = found.wave_number * diameter <= 2.0 * math.pi, np.ones(len(found.wave_number))
    if record.rig is not None:
        near, deaf = not_heard(record.rig, found.wave_number)
        kept, gain = kept & ~near & ~deaf, np.abs(record.rig.response(found.wave_number)) ** 2
    if np.count_nonzero(kept) < 2:
        raise InputError(f"{record.name}: its spectrum holds no waves longer than {diameter:.3g} m that its rig felt")
    rest = ((values / gain)[kept] for values in (found.density, found.lower, found.upper))
    return Spectrum(found.wave_number[kept], *rest)


def checked_diameter(record: StrengthRecord, base_diameter: float) -> float:
    """Raise InputError for anything but a record, and return a base's diameter [m]."""
    check_kind("the record", record, StrengthRecord, "a StrengthRecord, as read_strength_record returns one")
    check_domain("base_diameter", base_diameter, "m", at_least=0.0)
    return plain_number("base_diameter", base_diameter)


def not_heard(rig: Rig, wave_number: Vector) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return at which wave numbers a rig resonates, and which it hardly passes on to its force."""
    near = np.abs(wave_number / rig.resonance - 1.0) < NEAR_RESONANCE
    return near, np.abs(rig.response(wave_number)) < _LEAST_RESPONSE
