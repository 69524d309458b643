"""The strength waves that carry most of a record's variance, with their intervals, and their picture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.files import COLOURS, save_figure
from plough_opt.core.quantities import MOST_WAVES
from plough_opt.soil.random_strength import Spectrum, Vector
from plough_opt.soil.strength_record import (
    LEVEL,
    NEAR_RESONANCE,
    StrengthRecord,
    checked_diameter,
    not_heard,
    spectrum_of,
)
from plough_opt.soil.waves import StrengthWave

# Wave numbers per resolution 2 pi/length at which peaks are looked for.
_FINE = 8
# Probability that noise alone gives the largest peak, above which a further wave is none.
_BY_CHANCE = 0.01


@dataclass(frozen=True)
class FoundWave:
    """A strength wave of a record with its 95 % interval.

    Attributes:
        wave: amplitude [-], wavelength [m], phase [rad] at the record's first position.
        amplitude: half width of its interval [-].
        wavelength: half width [m].
        phase: half width [rad].
        part: of the record's variance that it carries.
    """

    wave: StrengthWave
    amplitude: float
    wavelength: float
    phase: float
    part: float


@dataclass(frozen=True)
class RecordWaves:
    """The contents of a record.

    Attributes:
        found: waves, the largest first.
        spectrum: of the record.
        variance: of relative strength [-].
        left_out: part of the variance that the waves do not carry.
        notes: what a reader must know.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> x = np.linspace(0.0, 8.0, 161)
        >>> record = po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x))
        >>> found = po.strength_waves(record)
        >>> 0.69 < found.found[0].wave.wavelength < 0.71
        True
    """

    found: tuple[FoundWave, ...]
    spectrum: Spectrum
    variance: float
    left_out: float
    notes: tuple[str, ...] = ()

    @property
    def waves(self) -> tuple[StrengthWave, ...]:
        """The waves, as `Effects` takes them."""
        return tuple(one.wave for one in self.found)

    def plot(self, path: str | Path) -> Path:
        """Draw the spectrum with its confidence band and the waves; the file's ending chooses the format.

        Raises:
            InputError: an ending that is not a picture format, or a place that cannot be written.
        """
        from matplotlib.figure import Figure  # slow to import, and rarely needed

        figure = Figure(figsize=(7.0, 4.2), layout="constrained")
        axes, s = figure.subplots(), self.spectrum
        length = 2.0 * math.pi / s.wave_number
        axes.fill_between(length, s.lower, s.upper, color=COLOURS[5], alpha=0.4, label="95 % band")
        axes.loglog(length, s.density, color=COLOURS[0], label="spectrum")
        for number, one in enumerate(self.found, start=1):
            label = f"{number}: {one.wave.wavelength:.3g} m, amplitude {one.wave.amplitude:.2g}"
            axes.axvline(float(one.wave.wavelength), color=COLOURS[1], lw=1.0, ls=(0, (4, number)), label=label)
        axes.set_xlabel("wavelength [m]")
        axes.set_ylabel("spectrum of relative strength [m/rad]")
        axes.legend(fontsize=8)
        return save_figure(figure, path)


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
    diameter = checked_diameter(record, base_diameter)
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


def _wave_numbers(record: StrengthRecord, base_diameter: float) -> tuple[Vector, list[str]]:
    """Return the wave numbers at which waves may be, and what is left out."""
    shortest = max(2.0 * record.spacing, base_diameter)
    # The frequencies of a transform of the record with eight times as many zeros behind it.
    step = 2.0 * math.pi / (_FINE * record.spacing * len(record.position))
    # Longer waves than the record are part of its trend.
    grid: Vector = step * np.arange(_FINE, math.ceil(2.0 * math.pi / shortest / step), dtype=float)
    notes = [f"waves shorter than {shortest:.3g} m are left out"]
    if record.rig is not None:
        near, deaf = not_heard(record.rig, grid)
        if np.any(near):
            notes.append(
                f"waves of {2 * math.pi / record.rig.resonance:.3g} m are left out, give or take"
                f" {100 * NEAR_RESONANCE:.0f} %: there the rig resonates, and its force shows its own oscillation"
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
    wide = float(stats.t.ppf((1.0 + LEVEL) / 2.0, freedom))
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
