"""Strength waves in a record, beside its random part: most likely covariance, and the linear map that makes it white.

Soil without waves varies at random, and more at long wavelengths than at short ones. Its covariance is taken from
variogram models (a correlation that decays with distance, and a nugget), as the rig that measured it passes it on.
The likelihood is a product over windows, each given the points of the window before it (Vecchia 1988).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.files import COLOURS, figure_with_panels, written
from plough_opt.core.quantities import MOST_WAVES
from plough_opt.soil.strength import (
    LEVEL,
    NEAR_RESONANCE,
    Spectrum,
    StrengthRecord,
    StrengthWave,
    Vector,
    checked_diameter,
    spectrum_of,
    unresolved,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Points of a window, half of which it shares with the one before.
_WINDOW: Final = 64
# Most windows from which the covariance is estimated, at even and at uneven distances, where each has its own factors.
_MOST_WINDOWS: Final = {True: 512, False: 24}
# Spectra over (wave number x correlation length): exponential correlation, Matern's of order 3/2, squared exponential.
_SHAPES: Final[tuple[Callable[[Vector], Vector], ...]] = (
    lambda x: 1.0 / (1.0 + x**2),
    lambda x: 1.0 / (1.0 + x**2) ** 2,
    lambda x: np.exp(-(x**2) / 4.0),
)
# Nuggets that are tried, as parts of the variance: with less than the first, rounding would make the covariance of
# smooth records singular.
_NUGGETS: Final = (1e-9, 1e-7, 1e-5, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
# Number of correlation lengths that are tried, in geometric progression from one lag to this number of windows, over
# which an exponential correlation is that of a random walk.
_LENGTHS: Final = 37
_LONGEST: Final = 16
# The search starts from every sixth length and every fourth nugget.
_COARSE: Final = (6, 4)
# Places and log-likelihood have settled when they change by less than this: waves are decided on by differences of ten.
_SETTLED: Final = 0.1
# Lags of the tabulated correlation per spacing.
_LAGS: Final = 4
# Least mean square, so that its logarithm is finite where the waves leave nothing.
_LEAST: Final = float(np.finfo(float).tiny)

Parameters = tuple[int, float, float]
"""Places of a shape, a correlation length and a nugget in their lists; between two entries a place is interpolated."""

# Factors for windows of a number of points at even distances: their correlation depends on no more than the parameters,
# as lengths are parts of the window's.
_EVEN: dict[int, dict[Parameters, Vector]] = {}
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


class Windows:
    """The windows of a record, and the factors of their covariances for all parameters that were tried."""

    def __init__(self, record: StrengthRecord) -> None:
        """Divide a record into windows of equal numbers of points."""
        count = len(record.position)
        size = min(_WINDOW, count)
        starts = np.array([*range(0, count - size, size // 2), count - size])
        self.rows: NDArray[np.intp] = starts[:, None] + np.arange(size)
        self.new: NDArray[np.bool_] = self.rows >= np.r_[0, self.rows[:-1, -1] + 1][:, None]
        """Which points of a window the one before does not have."""
        self.every = math.ceil(len(starts) / _MOST_WINDOWS[record.even])
        place = record.position[self.rows[:1] if record.even else self.rows]
        self._distances: Vector = np.abs(place[:, :, None] - place[:, None, :])
        self._record, self._lag = record, record.spacing / _LAGS
        self._factors = _EVEN.setdefault(size, {}) if record.even and record.rig is None else {}

    def factors(self, parameters: Parameters, every: int = 1) -> Vector:
        """Return the inverse Cholesky factors of windows' covariances: one for all at even distances, or one each."""
        shape, length, nugget = parameters
        distances = self._distances[::every]
        longest = float(np.max(self._distances))
        # The tabulated correlation has a period of four windows, so that neither end of a window feels the next period.
        count = 2 ** math.ceil(math.log2(4.0 * longest / self._lag))
        q: Vector = (2.0 * math.pi * np.fft.rfftfreq(count, self._lag)).astype(np.float64)
        density = _SHAPES[shape](q * self._lag * (_LONGEST * longest / self._lag) ** (length / (_LENGTHS - 1)))
        if self._record.rig is not None:
            density = density * np.abs(self._record.rig.response(q)) ** 2
        table = np.fft.irfft(density)[: count // 2]
        correlation = np.interp(distances, self._lag * np.arange(len(table)), table / table[0])
        part = math.exp(np.interp(nugget, range(len(_NUGGETS)), np.log(_NUGGETS)))
        covariance = (1.0 - part) * correlation + part * np.eye(distances.shape[-1])
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def fitted(self, residual: Vector) -> Continuum:
        """Return the most likely continuum of a residual (n)."""
        from scipy import optimize  # slow to import, and rarely needed

        losses: dict[Parameters, float] = {}

        def loss(tried: Parameters) -> float:
            if tried not in losses:
                if tried not in self._factors:
                    self._factors[tried] = self.factors(tried, self.every)
                losses[tried] = -self.log_likelihood(self._factors[tried], residual, self.every)
            return losses[tried]

        for shape in range(len(_SHAPES)):
            coarse = product([shape], range(0, _LENGTHS, _COARSE[0]), range(0, len(_NUGGETS), _COARSE[1]))
            place, before = min(coarse, key=loss), None
            while place != before:
                _, length, nugget = before = place
                beside = [(shape, near, nugget) for near in _beside(length, _LENGTHS)]
                beside += [(shape, length, near) for near in _beside(nugget, len(_NUGGETS))]
                place = min(beside, key=loss)
        shape, *start = min(losses, key=loss)
        found = optimize.minimize(
            lambda place: -self.log_likelihood(self.factors((shape, *place), self.every), residual, self.every),
            start,
            method="Nelder-Mead",
            bounds=[(0.0, _LENGTHS - 1.0), (0.0, len(_NUGGETS) - 1.0)],
            options={"xatol": _SETTLED, "fatol": _SETTLED},
        )
        return Continuum(self, self.factors((shape, *found.x)))

    def log_likelihood(self, factors: Vector, residual: Vector, every: int = 1) -> float:
        """Return the logarithm of a residual's likelihood at the most likely variance, over all or some windows."""
        new = self.new[::every]
        parts = residual[self.rows[::every]].reshape(len(factors), -1, new.shape[1])
        white = (parts @ np.swapaxes(factors, 1, 2)).reshape(new.shape)
        determinant = float(np.sum(np.log(np.diagonal(factors, axis1=1, axis2=2)) * new))
        count = np.count_nonzero(new)
        return determinant - 0.5 * count * math.log(max(float(np.sum(white**2 * new)) / count, _LEAST))


def _beside(index: int, count: int) -> range:
    """Return an index and its neighbours."""
    return range(max(index - 1, 0), min(index + 2, count))


@dataclass(frozen=True)
class Continuum:
    """A covariance of a record's points (n), up to a factor.

    Attributes:
        windows: the windows of the record.
        factors: inverse Cholesky factors of their covariances.
    """

    windows: Windows
    factors: Vector = field(repr=False)

    def whitened(self, columns: Vector) -> Vector:
        """Return columns (n, c) multiplied by the matrix that makes the noise in them white."""
        return np.asarray((self.factors @ columns[self.windows.rows])[self.windows.new])

    def weighted(self, values: Vector) -> Vector:
        """Return the inverse of the covariance, times values (n)."""
        parts = self.factors @ values[self.windows.rows][..., None]
        parts = np.swapaxes(self.factors, 1, 2) @ np.where(self.windows.new[..., None], parts, 0.0)
        total = np.zeros(len(values))
        np.add.at(total, self.windows.rows, parts[..., 0])
        return total


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

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the spectrum with its confidence band and the waves.

        Args:
            path: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the ending is not a picture format, or the file cannot be written.

        Example:
            >>> import numpy as np
            >>> import plough_opt as po
            >>> x = np.linspace(0.0, 8.0, 161)
            >>> found = po.strength_waves(po.StrengthRecord(x, 1e6 + 2e5 * np.sin(9.0 * x)))
            >>> found.plot().axes[0].get_xlabel()
            'wavelength [m]'
        """
        figure, (axes,) = figure_with_panels(1, 1, (7.0, 4.2))
        s = self.spectrum
        length = 2.0 * math.pi / s.wave_number
        axes.fill_between(length, s.lower, s.upper, color=COLOURS[5], alpha=0.4, label="95 % band")
        axes.loglog(length, s.density, color=COLOURS[0], label="spectrum")
        for number, one in enumerate(self.found, start=1):
            label = f"{number}: {one.wave.wavelength:.3g} m, amplitude {one.wave.amplitude:.2g}"
            axes.axvline(float(one.wave.wavelength), color=COLOURS[1], lw=1.0, ls=(0, (4, number)), label=label)
        axes.set(xlabel="wavelength [m]", ylabel="spectrum of relative strength [m/rad]")
        axes.legend(fontsize=8)
        return written(figure, path)


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
    part = plain_number("part of the variance", part, above=0.0, at_most=1.0)
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
            notes.append(f"waves shorter than {longest:.3g} m are left out, because the rig hardly passes them on")
        grid = np.asarray(grid[~resonant & ~damped], dtype=float)
    if len(grid) < 2:
        raise InputError(f"{record.name}: no waves lie between {shortest:.3g} m and its length {record.length:.3g} m")
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
        """Logarithm of the likelihood at the most likely variance."""
        return self.continuum.windows.log_likelihood(self.continuum.factors, self.residual)

    @property
    def carried(self) -> float:
        """Part of the variance that the waves carry."""
        return max(0.0, 1.0 - float(np.mean(self.residual**2) / np.mean(self.y**2)))

    @property
    def least_power(self) -> float:
        """Mean square of the smallest wave."""
        a, b = self.coefficients[: 2 * len(self.numbers)].reshape(2, -1)
        return float(np.min(a**2 + b**2)) / 2.0

    def extended(self, peak: float, grid: Vector) -> _Model:
        """Return the model with a further wave near a peak."""
        more = replace(self, numbers=(*self.numbers, peak)).refined(grid)
        return replace(more, continuum=self.continuum.windows.fitted(more.residual))

    def refined(self, grid: Vector) -> _Model:
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
