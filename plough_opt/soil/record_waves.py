"""Strength waves that carry most of a record's variance, with confidence intervals and a picture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from plough_opt.core.checks import plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.files import COLOURS, save_figure
from plough_opt.core.quantities import MOST_WAVES
from plough_opt.soil.random_strength import Spectrum, Vector
from plough_opt.soil.record_noise import Continuum, Windows
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
# A further wave is accepted only if random strength without it would be improved as much with at most this probability.
_FALSE_ALARM = 0.01
# Least part of the variance of a further wave: in very smooth random strength (squared exponential correlation over 6
# to 12 lags, nugget 1e-6 and less) false waves carried up to 5e-5.
_LEAST_PART = 1e-4
# Wave numbers at which the level of the noise is computed; it is smooth between them.
_LEVELS = 32


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

    The record is divided by its linear trend. Its random part, the continuum, has the correlation of a variogram model
    (exponential, Matern 3/2 or squared exponential, with a nugget), estimated by maximum likelihood. Waves are added
    one by one at the highest peak over the continuum; after each addition all waves are refitted together by
    generalised least squares, and the continuum anew. The search stops once the waves carry the required part, eight
    are found, or the next peak may be random or carries less than 1e-4 of the variance: of records of exponentially
    correlated random strength alone, one to three in a hundred give one. Random strength that oscillates about a
    wavelength often gives waves.
    If the record is a force, every wave is divided by the rig's response.

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
    part = plain_number("part of the variance", part)
    if not 0.0 < part <= 1.0:
        raise InputError(f"part = {shown(part)} of the variance must be above 0 and at most 1")
    diameter = checked_diameter(record, base_diameter)
    x, y = record.position - record.position[0], record.relative()
    variance = float(np.mean(y**2))
    if variance < _ROUNDING**2:
        raise InputError(f"{record.name}: its strength does not vary: give a record that does")
    grid, notes = _wave_numbers(record, diameter)
    model = _Model(x, y, (), Windows(record).fitted(y))
    while len(model.numbers) < MOST_WAVES and model.carried < part:
        tried = [model.extended(peak, grid) for peak in _peaks(record, model, grid)]
        best = max(tried, key=lambda one: one.log_likelihood)
        # Without the wave, the continuum found with it may be the more likely one.
        without = max(model.log_likelihood, replace(model, continuum=best.continuum).log_likelihood)
        alarm = _false_alarm(best.log_likelihood - without, len(x), len(best.numbers), grid)
        if alarm > _FALSE_ALARM or best.least_power < _LEAST_PART * variance:
            notes.append("the search stopped because no peak of the residual stands out from noise")
            break
        model = best
    found = _with_intervals(record, model.refined(grid), variance)
    if any(one.wave.amplitude == 1.0 for one in found):
        notes.append("an amplitude above 1, more than the whole strength, was limited to 1: check the record")
    if model.carried < part:
        carried = f"carry {model.carried:.3g} of the variance instead of the requested {part:g}"
        notes.append(f"these {len(found)} waves {carried}")
    return RecordWaves(found, spectrum_of(record), variance, 1.0 - model.carried, tuple(notes))


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


def _false_alarm(gain: float, points: int, waves: int, grid: Vector) -> float:
    """Return the probability that a wave fitted to noise alone raises the log-likelihood by as much.

    At a given wave number the gain is exponentially distributed; the largest of all wave numbers exceeds it about as
    often as a crossing is expected (Baluev 2008, doi 10.1111/j.1365-2966.2008.12689.x).
    """
    # The fit uses up three parameters for each wave and two for the trend.
    z = max(gain, 0.0) * max(points - 3 * waves - 2, 1) / points
    crossings = len(grid) / _OVERSAMPLING * math.sqrt(math.pi / 3.0 * z)
    return (1.0 + crossings) * math.exp(-min(z, 700.0))


def _design(x: Vector, numbers: Sequence[float]) -> Vector:
    """Return the design matrix: columns of sines, of cosines, of ones, and of positions (the trend's error)."""
    angle = np.outer(x, numbers)
    return np.hstack([np.sin(angle), np.cos(angle), np.ones((len(x), 1)), x[:, None]])


@dataclass(frozen=True)
class _Model:
    """Waves with given wave numbers in random strength, fitted by generalised least squares.

    Attributes:
        x: positions from the first.
        y: relative strength.
        numbers: wave numbers of the waves.
        continuum: random part of the strength.
    """

    x: Vector
    y: Vector
    numbers: tuple[float, ...]
    continuum: Continuum

    @cached_property
    def design(self) -> Vector:
        """Whitened design matrix."""
        return self.continuum.whitened(_design(self.x, self.numbers))

    @cached_property
    def target(self) -> Vector:
        """Whitened relative strength."""
        return self.continuum.whitened(self.y[:, None])[:, 0]

    @cached_property
    def coefficients(self) -> Vector:
        """Coefficients of the design matrix's columns."""
        # The normal equations are a hundred times faster than the tall system, and the digits they lose for close wave
        # numbers are far below the noise.
        normal, right = self.design.T @ self.design, self.design.T @ self.target
        return np.asarray(np.linalg.lstsq(normal, right, rcond=None)[0], dtype=float)

    @property
    def slopes(self) -> Vector:
        """Derivatives of the whitened waves by their wave numbers, at fixed coefficients."""
        count, angle = len(self.numbers), np.outer(self.x, self.numbers)
        a, b = self.coefficients[:count], self.coefficients[count : 2 * count]
        return self.continuum.whitened(self.x[:, None] * (a * np.cos(angle) - b * np.sin(angle)))

    @cached_property
    def residual(self) -> Vector:
        """Relative strength without the waves and the trend's error."""
        return np.asarray(self.y - _design(self.x, self.numbers) @ self.coefficients)

    @cached_property
    def log_likelihood(self) -> float:
        """Logarithm of the likelihood."""
        return self.continuum.log_likelihood(self.residual)

    @property
    def carried(self) -> float:
        """Part of the variance that the waves carry."""
        return max(0.0, 1.0 - float(np.mean(self.residual**2) / np.mean(self.y**2)))

    @property
    def least_power(self) -> float:
        """Mean square of the smallest wave."""
        a, b = self.coefficients[: 2 * len(self.numbers)].reshape(2, -1)
        return float(np.min(a**2 + b**2)) / 2.0

    def extended(self, peak: float, grid: Vector) -> "_Model":
        """Return the model with a further wave near a peak."""
        more = replace(self, numbers=(*self.numbers, peak)).refined(grid)
        return replace(more, continuum=self.continuum.windows.fitted(more.residual))

    def refined(self, grid: Vector) -> "_Model":
        """Return the model with the wave numbers at which all waves together fit best."""
        from scipy import optimize  # slow to import, and rarely needed

        if not self.numbers:
            return self
        start = np.array(self.numbers)
        step = float(grid[1] - grid[0]) * _OVERSAMPLING / 2.0  # half the resolution 2 pi/length

        def moved(shift: Vector) -> _Model:
            return replace(self, numbers=tuple(start + step * shift))

        def residual(shift: Vector) -> Vector:
            there = moved(shift)
            return there.target - there.design @ there.coefficients

        def slopes(shift: Vector) -> Vector:
            there = moved(shift)
            along = np.linalg.lstsq(there.design, there.slopes, rcond=None)[0]
            # What the amplitudes, fitted anew, leave of a change (Kaufman 1975).
            return step * (there.design @ along - there.slopes)

        # Rounding may have put an earlier wave beyond the ends of the grid, but the start must lie within the bounds.
        low, high = np.clip((grid[0] - start) / step, -1.0, 0.0), np.clip((grid[-1] - start) / step, 0.0, 1.0)
        found = optimize.least_squares(residual, np.zeros(len(start)), slopes, bounds=(low, high))
        return replace(self, numbers=tuple((start + step * found.x).tolist()))


def _peaks(record: StrengthRecord, model: _Model, grid: Vector) -> list[float]:
    """Return the wave numbers of the residual's highest peaks, relative to its continuum and in absolute terms.

    The second finds a long wave to which the continuum was fitted.
    """
    nodes = np.geomspace(grid[0], grid[-1], _LEVELS)
    level = [float(np.sum(model.continuum.whitened(_design(model.x, [q])[:, :2]) ** 2)) for q in nodes]
    relative = _power(record, model.continuum.weighted(model.residual), grid)
    relative /= np.exp(np.interp(np.log(grid), np.log(nodes), np.log(level)))
    first, second = (int(np.argmax(power)) for power in (relative, _power(record, model.residual, grid)))
    # Within a resolution they are the same peak.
    return [float(grid[first])] if abs(second - first) < _OVERSAMPLING else [float(grid[k]) for k in (first, second)]


def _power(record: StrengthRecord, values: Vector, grid: Vector) -> Vector:
    """Return the squared Fourier transform of values at a record's points, up to a factor."""
    if record.even:
        step = 2.0 * math.pi / (_OVERSAMPLING * record.spacing * len(values))
        power = np.abs(np.fft.rfft(values, _OVERSAMPLING * len(values)))[np.round(grid / step).astype(int)] ** 2
        return np.asarray(power, dtype=float)
    from scipy import signal  # as above

    return np.asarray(signal.lombscargle(record.position - record.position[0], values, grid), dtype=float)


def _with_intervals(record: StrengthRecord, model: _Model, variance: float) -> tuple[FoundWave, ...]:
    """Return the waves with their intervals, which follow from the noise at their wave numbers."""
    from scipy import stats  # as above

    numbers = model.numbers
    if not numbers:
        return ()
    count = len(numbers)
    a, b = model.coefficients[:count], model.coefficients[count : 2 * count]
    freedom = max(1, len(model.x) - 3 * count - 2)
    inverse = np.linalg.pinv(np.hstack([model.design, model.slopes]))
    covariance = inverse @ inverse.T * float(np.sum((model.target - model.design @ model.coefficients) ** 2)) / freedom
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
        relative = quantile * math.sqrt(float(covariance[2 * count + 2 + k, 2 * count + 2 + k])) / number
        wave = StrengthWave(min(size / gain, 1.0), 2.0 * math.pi / number, phase)
        found = FoundWave(wave, errors[0] / gain, 2.0 * math.pi / number * relative, errors[1], size**2 / 2 / variance)
        waves.append(found)
    return tuple(sorted(waves, key=lambda one: -float(one.wave.amplitude)))
