"""Strength waves from a record along a field: its spectrum, and the waves that carry most of its variance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core.checks import LARGEST, NOT_NUMBERS, check_domain, check_kind, check_text, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import MOST_WAVES
from plough_opt.soil.random_strength import Spectrum
from plough_opt.soil.record_waves import FoundWave, RecordWaves
from plough_opt.soil.rig import Rig
from plough_opt.soil.waves import StrengthWave

Vector = NDArray[np.float64]

# Points without which no wave is worth the name, and points, evenly spaced or not, beyond which one takes minutes.
_FEWEST, _MOST, _MOST_UNEVEN = 32, 200_000, 10_000
# Relative difference of spacings up to which they count as even.
_EVEN = 1e-3
# Segments of Welch's method, half overlapping under Hann's window, and the correlation of neighbours' squares under it.
_SEGMENTS, _NEIGHBOURS = 8, 1.0 / 36.0
# Wave numbers per resolution 2 pi/length at which peaks are looked for.
_FINE = 8
# Two-sided 95 %.
_LEVEL = 0.95
# How near to the rig's resonance its response no longer depends on the soil, as a part of that frequency.
_NEAR_RESONANCE = 0.2
# Least part of the soil's fluctuation that the rig must pass on: a quotient of less is noise.
_LEAST_RESPONSE = 0.1
# Probability that noise alone gives the largest peak, above which a further wave is none.
_BY_CHANCE = 0.01


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


def strength_waves(record: StrengthRecord, part: float = 0.8, *, base_diameter: float = 0.0) -> RecordWaves:
    """Return the strength waves that carry a wanted part of a record's variance.

    The record is taken relative to its linear trend. Waves are taken one by one where the least-squares spectrum of
    what is left peaks, and all are fitted together by least squares after each, until they carry the part, eight are
    found, or the next peak may be noise. Of a force the rig's response is divided out of every wave.

    Args:
        record: strength or force along a path.
        part: of the variance, above 0 and at most 1.
        base_diameter: of the share [m]: shorter waves are left out, which its base averages. A cone's base is 20 mm.

    Returns:
        The waves with 95 % intervals, the spectrum with its band, and the part left out.

    Raises:
        InputError: a part that cannot be, or a record without fluctuation.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> x = np.linspace(0.0, 8.0, 161)
        >>> record = po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x))
        >>> po.strength_waves(record).variance > 0.0
        True
    """
    if isinstance(part, bool) or not (isinstance(part, int | float) and 0.0 < part <= 1.0):
        raise InputError(f"part = {shown(part)} of the variance must be above 0 and at most 1")
    diameter = _checked(record, base_diameter)
    x, y = record.position - record.position[0], record.relative()
    variance = float(np.mean(y**2))
    if not variance > 0.0:
        raise InputError(f"{record.name}: its strength does not vary, so it holds no wave: give a record that does")
    grid, notes = _wave_numbers(record, diameter)
    numbers: list[float] = []
    left = y
    while len(numbers) < MOST_WAVES and float(np.mean(left**2)) > (1.0 - part) * variance:
        peak, height = _peak(record, x, left, grid)
        # Of white noise every ordinate over its mean is exponential; some length/spacing of them are independent.
        if math.exp(-min(height, 700.0)) * len(grid) / _FINE > _BY_CHANCE:
            notes.append("what is left has no peak that stands out of noise: no further wave was taken")
            break
        numbers = _refined(x, y, [*numbers, peak], grid)
        left = y - _design(x, numbers) @ _coefficients(x, y, numbers)
    carried = 1.0 - float(np.mean(left**2)) / variance
    found = _found(record, x, y, left, numbers, variance)
    if any(one.wave.amplitude == 1.0 for one in found):
        notes.append("an amplitude above 1, more than all the strength there is, is given as 1: look at the record")
    if carried < part:
        notes.append(f"these {len(found)} waves carry {carried:.3g} of the variance, and {part:g} was asked for")
    return RecordWaves(found, spectrum_of(record), variance, 1.0 - carried, tuple(notes))


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
    band = [freedom / stats.chi2.ppf(p, freedom) for p in ((1.0 + _LEVEL) / 2.0, (1.0 - _LEVEL) / 2.0)]
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
    diameter = _checked(record, base_diameter)
    found = spectrum_of(record)
    kept, gain = found.wave_number * diameter <= 2.0 * math.pi, np.ones(len(found.wave_number))
    if record.rig is not None:
        near, deaf = _not_heard(record.rig, found.wave_number)
        kept, gain = kept & ~near & ~deaf, np.abs(record.rig.response(found.wave_number)) ** 2
    if np.count_nonzero(kept) < 2:
        raise InputError(f"{record.name}: its spectrum holds no waves longer than {diameter:.3g} m that its rig felt")
    rest = ((values / gain)[kept] for values in (found.density, found.lower, found.upper))
    return Spectrum(found.wave_number[kept], *rest)


def _checked(record: StrengthRecord, base_diameter: float) -> float:
    """Raise InputError for anything but a record, and return a base's diameter [m]."""
    check_kind("the record", record, StrengthRecord, "a StrengthRecord, as read_strength_record returns one")
    check_domain("base_diameter", base_diameter, "m", at_least=0.0)
    return plain_number("base_diameter", base_diameter)


def _not_heard(rig: Rig, wave_number: Vector) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return at which wave numbers a rig resonates, and which it hardly passes on to its force."""
    near = np.abs(wave_number / rig.resonance - 1.0) < _NEAR_RESONANCE
    return near, np.abs(rig.response(wave_number)) < _LEAST_RESPONSE


def _wave_numbers(record: StrengthRecord, base_diameter: float) -> tuple[Vector, list[str]]:
    """Return the wave numbers at which waves may be, and what is left out."""
    shortest = max(2.0 * record.spacing, base_diameter)
    # The frequencies of a transform of the record with eight times as many zeros behind it.
    step = 2.0 * math.pi / (_FINE * record.spacing * len(record.position))
    # Longer waves than the record are part of its trend.
    grid: Vector = step * np.arange(_FINE, math.ceil(2.0 * math.pi / shortest / step), dtype=float)
    notes = [f"waves shorter than {shortest:.3g} m are left out"]
    if record.rig is not None:
        near, deaf = _not_heard(record.rig, grid)
        if np.any(near):
            notes.append(
                f"waves of {2 * math.pi / record.rig.resonance:.3g} m are left out, give or take"
                f" {100 * _NEAR_RESONANCE:.0f} %: there the rig resonates, and its force shows its own oscillation"
            )
        if np.any(deaf):
            longest = 2 * math.pi / float(np.min(grid[deaf]))
            notes.append(
                f"waves shorter than {longest:.3g} m are left out, which the rig hardly passes on to its force"
            )
        grid = np.asarray(grid[~near & ~deaf], dtype=float)
    if len(grid) < 2:
        raise InputError(
            f"{record.name}: between {shortest:.3g} m and its length of {record.length:.3g} m fits no wave"
        )
    return grid, notes


def _design(x: Vector, numbers: Sequence[float]) -> Vector:
    """Return sines and cosines of the wave numbers at positions, and a constant, a column each."""
    angle = np.outer(x, numbers)
    return np.hstack([np.sin(angle), np.cos(angle), np.ones((len(x), 1))])


def _coefficients(x: Vector, y: Vector, numbers: Sequence[float]) -> Vector:
    design = _design(x, numbers)
    # By the normal equations: what close wave numbers cost in digits is far below what noise does, and a long thin
    # system takes a hundred times as long.
    found: Vector = np.asarray(np.linalg.lstsq(design.T @ design, design.T @ y, rcond=None)[0], dtype=float)
    return found


def _peak(record: StrengthRecord, x: Vector, y: Vector, grid: Vector) -> tuple[float, float]:
    """Return the wave number at which a least-squares spectrum peaks, and its height over the mean."""
    power: NDArray[Any]
    if record.even:
        step = 2.0 * math.pi / (_FINE * record.spacing * len(x))
        power = np.abs(np.fft.rfft(y, _FINE * len(x)))[np.round(grid / step).astype(int)] ** 2
    else:
        from scipy import signal  # as above

        power = np.asarray(signal.lombscargle(x, y, grid))
    best = int(np.argmax(power))
    return float(grid[best]), float(power[best] / np.mean(power))


def _refined(x: Vector, y: Vector, numbers: list[float], grid: Vector) -> list[float]:
    """Return the wave numbers with which all waves together leave the least squares."""
    from scipy import optimize  # as above

    start = np.array(numbers)
    step = float(grid[1] - grid[0]) * _FINE / 2.0  # half the resolution 2 pi/length

    def left(shift: Vector) -> Vector:
        shifted: list[float] = (start + step * shift).tolist()
        rest: Vector = y - _design(x, shifted) @ _coefficients(x, y, shifted)
        return rest

    low, high = (np.clip((end - start) / step, -1.0, 1.0) for end in (grid[0], grid[-1]))
    # Bounds must leave room on both sides of the start.
    found = optimize.least_squares(left, np.zeros(len(start)), bounds=(low - 1e-9, high + 1e-9))
    return [float(number) for number in start + step * found.x]


def _found(
    record: StrengthRecord, x: Vector, y: Vector, left: Vector, numbers: Sequence[float], variance: float
) -> tuple[FoundWave, ...]:
    """Return the waves with their intervals, which follow from the scatter of what is left."""
    from scipy import stats  # as above

    if not numbers:
        return ()
    count, coefficients = len(numbers), _coefficients(x, y, numbers)
    a, b = coefficients[:count], coefficients[count : 2 * count]
    angle = np.outer(x, numbers)
    slopes = x[:, None] * (a * np.cos(angle) - b * np.sin(angle))
    freedom = max(1, len(x) - 3 * count - 1)
    inverse = np.linalg.pinv(np.hstack([_design(x, numbers), slopes]))
    covariance = inverse @ inverse.T * float(np.sum(left**2)) / freedom
    wide = float(stats.t.ppf((1.0 + _LEVEL) / 2.0, freedom))
    response = np.ones(count, complex) if record.rig is None else record.rig.response(np.array(numbers))
    waves = []
    for k, number in enumerate(numbers):
        size = math.hypot(a[k], b[k])
        own = covariance[np.ix_([k, count + k], [k, count + k])]
        along, across = np.array([a[k], b[k]]) / size, np.array([-b[k], a[k]]) / size**2
        errors = [wide * math.sqrt(float(d @ own @ d)) for d in (along, across)]
        gain = abs(response[k])
        # A phase is defined up to turns, and is given between minus and plus half of one.
        phase = math.remainder(math.atan2(b[k], a[k]) - float(np.angle(response[k])), 2.0 * math.pi)
        relative = wide * math.sqrt(float(covariance[2 * count + 1 + k, 2 * count + 1 + k])) / number
        wave = StrengthWave(min(size / gain, 1.0), 2.0 * math.pi / number, phase)
        found = FoundWave(wave, errors[0] / gain, 2.0 * math.pi / number * relative, errors[1], size**2 / 2 / variance)
        waves.append(found)
    return tuple(sorted(waves, key=lambda one: -float(one.wave.amplitude)))
