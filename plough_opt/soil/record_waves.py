"""Strength waves that carry most of a record's variance, with confidence intervals and a picture."""

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
    spectrum_of,
    unresolved,
)
from plough_opt.soil.waves import StrengthWave

# Points of the search grid per resolution 2 pi/length.
_OVERSAMPLING = 8
# Relative strength whose standard deviation is below this varies by rounding alone.
_ROUNDING = 1e-10
# A further wave is accepted only if noise alone would give its peak with at most this probability.
_FALSE_ALARM = 0.01


@dataclass(frozen=True)
class FoundWave:
    """A strength wave found in a record, with 95 % confidence intervals.

    Attributes:
        wave: amplitude [-], wavelength [m], phase [rad] at the record's first position.
        amplitude: half width of the amplitude's interval [-].
        wavelength: half width of the wavelength's interval [m].
        phase: half width of the phase's interval [rad].
        part: fraction of the record's variance that the wave carries.
    """

    wave: StrengthWave
    amplitude: float
    wavelength: float
    phase: float
    part: float


@dataclass(frozen=True)
class RecordWaves:
    """The strength waves and the spectrum of a record.

    Attributes:
        found: waves, largest first.
        spectrum: spectrum of the record.
        variance: variance of relative strength [-].
        left_out: fraction of the variance that the waves do not carry.
        notes: remarks for the reader.

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
        """The waves, in the form that `Effects` accepts."""
        return tuple(one.wave for one in self.found)

    def plot(self, path: str | Path) -> Path:
        """Draw the spectrum with its confidence band and the waves; the file's ending determines the format.

        Raises:
            InputError: the ending is not a picture format, or the file cannot be written.
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
    """Return the strength waves that carry a given part of a record's variance.

    The record is divided by its linear trend. Waves are added one by one at the highest peak of the residual's
    least-squares spectrum, and after each addition all waves are refitted together by least squares. The search stops
    once the waves carry the required part, eight are found, or the next peak may be noise. If the record is a force,
    every wave is divided by the rig's response.

    Args:
        record: strength or force along a path.
        part: fraction of the variance, above 0 and at most 1.
        base_diameter: diameter of the share's base [m]; shorter waves are left out, because the base averages them. A
            penetrometer's base is 20 mm wide.

    Returns:
        The waves with 95 % intervals, the spectrum with its band, and the fraction left out.

    Raises:
        DomainError: the diameter is not a finite number of at least 0.
        InputError: the part is invalid, the record does not vary, or no waves are left to search.

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
    if variance < _ROUNDING**2:
        raise InputError(f"{record.name}: its strength does not vary: give a record that does")
    grid, notes = _wave_numbers(record, diameter)
    numbers: list[float] = []
    residual = y
    while len(numbers) < MOST_WAVES and float(np.mean(residual**2)) > (1.0 - part) * variance:
        peak, height = _peak(record, x, residual, grid)
        # For white noise each ordinate over the mean is exponentially distributed, and about one in _OVERSAMPLING is
        # independent of the others.
        if math.exp(-min(height, 700.0)) * len(grid) / _OVERSAMPLING > _FALSE_ALARM:
            notes.append("the search stopped because no peak of the residual stands out from noise")
            break
        numbers = _refined(x, y, [*numbers, peak], grid)
        residual = _residual(x, y, numbers)
    carried = 1.0 - float(np.mean(residual**2)) / variance
    found = _with_intervals(record, x, y, residual, numbers, variance)
    if any(one.wave.amplitude == 1.0 for one in found):
        notes.append("an amplitude above 1, more than the whole strength, was limited to 1: check the record")
    if carried < part:
        notes.append(f"these {len(found)} waves carry {carried:.3g} of the variance instead of the requested {part:g}")
    return RecordWaves(found, spectrum_of(record), variance, 1.0 - carried, tuple(notes))


def _wave_numbers(record: StrengthRecord, base_diameter: float) -> tuple[Vector, list[str]]:
    """Return the wave numbers to search, and notes on those left out."""
    shortest = max(2.0 * record.spacing, base_diameter)
    # The frequencies of the zero-padded discrete Fourier transform.
    step = 2.0 * math.pi / (_OVERSAMPLING * record.spacing * len(record.position))
    # Waves longer than the record are part of its trend.
    grid: Vector = step * np.arange(_OVERSAMPLING, math.ceil(2.0 * math.pi / shortest / step), dtype=float)
    notes = [f"waves shorter than {shortest:.3g} m are left out"]
    if record.rig is not None:
        resonant, damped = unresolved(record.rig, grid)
        if np.any(resonant):
            notes.append(
                f"waves within {100 * NEAR_RESONANCE:.0f} % of {2 * math.pi / record.rig.resonance:.3g} m are left out,"
                " because the rig resonates there and the force shows its own oscillation"
            )
        if np.any(damped):
            longest = 2 * math.pi / float(np.min(grid[damped]))
            notes.append(
                f"waves shorter than {longest:.3g} m are left out, because the rig hardly passes them on to its force"
            )
        grid = np.asarray(grid[~resonant & ~damped], dtype=float)
    if len(grid) < 2:
        raise InputError(
            f"{record.name}: there are no waves between {shortest:.3g} m and its length of {record.length:.3g} m"
        )
    return grid, notes


def _design(x: Vector, numbers: Sequence[float]) -> Vector:
    """Return the design matrix: columns of sines, of cosines, and of ones."""
    angle = np.outer(x, numbers)
    return np.hstack([np.sin(angle), np.cos(angle), np.ones((len(x), 1))])


def _coefficients(x: Vector, y: Vector, numbers: Sequence[float]) -> Vector:
    design = _design(x, numbers)
    # The normal equations are a hundred times faster than the tall system, and the digits they lose for close wave
    # numbers are far below the noise.
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ y, rcond=None)[0], dtype=float)


def _residual(x: Vector, y: Vector, numbers: Sequence[float]) -> Vector:
    """Return strength without the best fit of waves with these wave numbers."""
    return y - _design(x, numbers) @ _coefficients(x, y, numbers)


def _peak(record: StrengthRecord, x: Vector, y: Vector, grid: Vector) -> tuple[float, float]:
    """Return the wave number of the highest peak of the least-squares spectrum, and its height over the mean."""
    power: NDArray[Any]
    if record.even:
        step = 2.0 * math.pi / (_OVERSAMPLING * record.spacing * len(x))
        power = np.abs(np.fft.rfft(y, _OVERSAMPLING * len(x)))[np.round(grid / step).astype(int)] ** 2
    else:
        from scipy import signal  # as above

        power = np.asarray(signal.lombscargle(x, y, grid))
    best = int(np.argmax(power))
    return float(grid[best]), float(power[best] / np.mean(power))


def _refined(x: Vector, y: Vector, numbers: list[float], grid: Vector) -> list[float]:
    """Return the wave numbers at which all waves together fit best by least squares."""
    from scipy import optimize  # as above

    start = np.array(numbers)
    step = float(grid[1] - grid[0]) * _OVERSAMPLING / 2.0  # half the resolution 2 pi/length

    def residual(shift: Vector) -> Vector:
        return _residual(x, y, (start + step * shift).tolist())

    # Rounding may have put an earlier wave beyond the ends of the grid, but the start must lie within the bounds.
    low, high = np.clip((grid[0] - start) / step, -1.0, 0.0), np.clip((grid[-1] - start) / step, 0.0, 1.0)
    found = optimize.least_squares(residual, np.zeros(len(start)), bounds=(low, high))
    return [float(number) for number in start + step * found.x]


def _with_intervals(
    record: StrengthRecord, x: Vector, y: Vector, residual: Vector, numbers: Sequence[float], variance: float
) -> tuple[FoundWave, ...]:
    """Return the waves with their intervals, which follow from the scatter of the residual."""
    from scipy import stats  # as above

    if not numbers:
        return ()
    count, coefficients = len(numbers), _coefficients(x, y, numbers)
    a, b = coefficients[:count], coefficients[count : 2 * count]
    angle = np.outer(x, numbers)
    slopes = x[:, None] * (a * np.cos(angle) - b * np.sin(angle))
    freedom = max(1, len(x) - 3 * count - 1)
    inverse = np.linalg.pinv(np.hstack([_design(x, numbers), slopes]))
    covariance = inverse @ inverse.T * float(np.sum(residual**2)) / freedom
    quantile = float(stats.t.ppf((1.0 + LEVEL) / 2.0, freedom))
    response = np.ones(count, complex) if record.rig is None else record.rig.response(np.array(numbers))
    waves = []
    for k, number in enumerate(numbers):
        size = math.hypot(a[k], b[k])
        own = covariance[np.ix_([k, count + k], [k, count + k])]
        along, across = np.array([a[k], b[k]]) / size, np.array([-b[k], a[k]]) / size**2
        errors = [quantile * math.sqrt(float(d @ own @ d)) for d in (along, across)]
        gain = float(abs(response[k]))
        # Phases are reduced to the range from -pi to pi.
        phase = math.remainder(math.atan2(b[k], a[k]) - float(np.angle(response[k])), 2.0 * math.pi)
        relative = quantile * math.sqrt(float(covariance[2 * count + 1 + k, 2 * count + 1 + k])) / number
        wave = StrengthWave(min(size / gain, 1.0), 2.0 * math.pi / number, phase)
        found = FoundWave(wave, errors[0] / gain, 2.0 * math.pi / number * relative, errors[1], size**2 / 2 / variance)
        waves.append(found)
    return tuple(sorted(waves, key=lambda one: -float(one.wave.amplitude)))
