"""Strength of the soil along the path: waves, random strength by its spectrum with a share's response, and records.

For steady sliding at the tow speed V, the transfer function from relative strength at wave number q to the deflection z
is, with omega = q V,

    H = G/(k0 - M omega^2 + i omega d),    G = F0 (1 + kappa V^2),    d = c + 2 (Fd + kappa F0) V,

and the stationary variances are the integrals of |H|^2 S(q) and omega^2 |H|^2 S(q) over q.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core import expressions as ex
from plough_opt.core.checks import LARGEST, array_of, check_domain, check_kind, check_text, plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import read_fields

Vector = NDArray[np.float64]
PASS = 1000.0
"""Distance [m] of a pass over a field, for which peaks are given."""
EXCEEDED = 0.05
"""Largest part of all passes in which such a peak is exceeded."""
# Most panels of a spectrum; a record's finer ones are merged, or a graph would hold each. That changes an RMS by 3e-4,
# far less than the spectrum's band.
_MOST_PANELS = 48


@dataclass(frozen=True)
class StrengthWave:
    """Soil strength that varies along the path: F0 is multiplied by 1 + amplitude sin(2 pi L/wavelength + phase).

    Args:
        amplitude: epsilon [-], from 0 to 1.
        wavelength: ell [m], above 0.
        phase: phase at travel 0 [rad], from -2 pi to 2 pi. It does not change a start at equilibrium, which uses the
            mean strength.

    Example:
        >>> import plough_opt as po
        >>> po.StrengthWave(amplitude=0.3, wavelength="20 cm").wavelength
        0.2
    """

    amplitude: Expression
    wavelength: Expression
    phase: Expression = 0.0

    def __post_init__(self) -> None:
        read_fields(self, **{name: f"effects.strength_wave.{name}" for name in ("amplitude", "wavelength", "phase")})


def turns_of(waves: Sequence[StrengthWave]) -> tuple[int, ...]:
    """Return how many wavelengths of each wave fit into their common period.

    Raises:
        InputError: a wavelength is a symbol, or there is no common period within a hundred of the longest wavelength.
    """
    if len(waves) == 1:
        return (1,)
    if any(ex.is_symbolic(wave.wavelength) for wave in waves):
        raise InputError("a periodic orbit under several waves needs numeric wavelengths: they determine its period")
    lengths = np.array([float(ex.as_number(wave.wavelength)) for wave in waves])
    for count in range(1, 101):
        turns = count * np.max(lengths) / lengths
        # Files give fewer digits than nine.
        if np.all(np.abs(turns - np.round(turns)) <= 1e-9 * turns):
            return tuple(int(turn) for turn in np.round(turns))
    given = ", ".join(f"{length:g}" for length in lengths)
    raise InputError(f"the strength waves ({given} m) have no common period, as an orbit needs: simulate from a start")


@dataclass(frozen=True)
class Sliding:
    """Linearised steady sliding: the coefficients of the response to relative strength.

    Attributes:
        force: G, change of the resistance per relative change of strength [N].
        stiffness: k0 [N/m].
        inertia: M [kg].
        damping: d of mount and soil [N s/m].
        speed: V [m/s].
    """

    force: Expression
    stiffness: Expression
    inertia: Expression
    damping: Expression
    speed: Expression

    def squared(self, frequency: Expression) -> Expression:
        """Return |H|^2 [m^2] at an angular frequency [rad/s]."""
        spring = self.stiffness - self.inertia * frequency**2
        return self.force**2 / (spring**2 + (self.damping * frequency) ** 2)

    def to_waves(self, waves: Sequence[StrengthWave]) -> tuple[Expression, Expression]:
        """Return the variances of the deflection [m^2] and its rate [m^2/s^2] due to waves of different lengths."""
        found = [(2.0 * math.pi * self.speed / wave.wavelength, wave.amplitude) for wave in waves]
        parts = [(frequency, size**2 / 2.0 * self.squared(frequency)) for frequency, size in found]
        return sum(part for _, part in parts), sum(frequency**2 * part for frequency, part in parts)


@dataclass(frozen=True)
class RandomStrength:
    """Random strength with the correlation exp(-distance/correlation length).

    Its one-sided spectrum is S(q) = 2 rms^2 lambda/(pi (1 + (q lambda)^2)), whose integral over the wave number q is
    rms^2.

    Args:
        rms: standard deviation of strength over its mean [-], from 0 to 1.
        correlation_length: lambda [m], above 0.

    Raises:
        DomainError: a number lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> round(po.RandomStrength(rms=0.2, correlation_length=0.3).density(0.0), 6)
        0.007639
    """

    rms: Expression
    correlation_length: Expression

    def __post_init__(self) -> None:
        read_fields(self, **{name: f"effects.random_strength.{name}" for name in ("rms", "correlation_length")})

    @property
    def variance(self) -> Expression:
        """Variance of relative strength [-]."""
        return self.rms**2

    def density(self, wave_number: Expression) -> Expression:
        """Return the spectrum S [m/rad] at a wave number q [rad/m].

        Example:
            >>> import plough_opt as po
            >>> round(po.RandomStrength(rms=0.2, correlation_length="0.3 m").density(5.0), 6)
            0.002351
        """
        check_domain("wave number", wave_number, "rad/m", at_least=0.0)
        length = self.correlation_length
        return 2.0 * self.rms**2 * length / (math.pi * (1.0 + (wave_number * length) ** 2))

    def response(self, to: Sliding) -> tuple[Expression, Expression]:
        """Return the variances of the deflection [m^2] and its rate [m^2/s^2].

        The closed form is that of white noise through a filter with three poles: two of the mount, and that of
        1/(1 + i omega lambda/V).

        Example:
            >>> import plough_opt as po
            >>> from plough_opt.soil.strength import Sliding
            >>> mount = Sliding(force=2000.0, stiffness=5e4, inertia=30.0, damping=400.0, speed=2.0)
            >>> deflection, rate = po.RandomStrength(rms=0.2, correlation_length="0.3 m").response(mount)
            >>> round(1e3 * deflection**0.5, 2)  # mm
            9.43
        """
        time = self.correlation_length / to.speed
        carried = to.inertia + to.damping * time
        rate = to.force**2 * self.variance * time / (to.damping * (carried + to.stiffness * time**2))
        return rate * carried / to.stiffness, rate


class Spectrum:
    """A tabulated one-sided spectrum of relative strength, linear between its wave numbers.

    Its integral over the wave number is the variance. It is not a dataclass, because its columns are measurements and
    not quantities that a design could vary.

    Attributes:
        wave_number: q [rad/m], increasing.
        density: S(q) [m/rad], at least 0.
        lower: lower end of the 95 % confidence band; default: the density.
        upper: upper end of the band.

    Raises:
        InputError: the columns have different lengths or fewer than two rows, or a number is invalid.

    Example:
        >>> import plough_opt as po
        >>> round(po.Spectrum([0.0, 1.0, 2.0], [0.0, 0.1, 0.0]).variance, 12)
        0.1
    """

    def __init__(
        self, wave_number: ArrayLike, density: ArrayLike, lower: ArrayLike | None = None, upper: ArrayLike | None = None
    ) -> None:
        """Check the columns, and store read-only copies."""
        given = (wave_number, density, density if lower is None else lower, density if upper is None else upper)
        columns = [array_of(values, "a spectrum's wave numbers and densities must be numbers") for values in given]
        q = columns[0]
        if q.ndim != 1 or len(q) < 2 or any(values.shape != q.shape for values in columns):
            raise InputError("a spectrum's wave numbers and densities must be columns of equal length, at least two")
        valid = all(np.isfinite(values).all() and np.all(values >= 0.0) for values in columns)
        if not valid or np.any(np.diff(q) <= 0.0):
            raise InputError("a spectrum's wave numbers must increase, all its numbers be finite and at least 0")
        for values in columns:
            values.setflags(write=False)
        self.wave_number, self.density, self.lower, self.upper = columns

    @property
    def variance(self) -> float:
        """Integral of the density."""
        return float(np.trapezoid(self.density, self.wave_number))

    def response(self, to: Sliding) -> tuple[Expression, Expression]:
        """Return the variances of the deflection [m^2] and its rate [m^2/s^2].

        They are computed by Gauss-Legendre quadrature in every panel, with nodes clustered about the mount's resonance:
        the rule is applied in u, where the frequency is omega0 + (d/2M) sinh(u).

        Example:
            >>> import plough_opt as po
            >>> from plough_opt.soil.strength import Sliding
            >>> mount = Sliding(force=2000.0, stiffness=5e4, inertia=30.0, damping=400.0, speed=2.0)
            >>> deflection, rate = po.Spectrum([0.0, 10.0, 20.0], [0.0, 0.005, 0.0]).response(mount)
            >>> round(1e3 * deflection**0.5, 2)  # mm
            13.35
        """
        q, density = self._panels()
        known = (q[:-1], q[1:], density[:-1], np.diff(density) / np.diff(q))
        panels = (ex.column(x, ex.holds_casadi(to)) for x in known)
        place, rate = _over_panels(*panels, to.force, to.stiffness, to.inertia, to.damping, to.speed)
        return ex.total(place), ex.total(rate)

    def _panels(self) -> tuple[Vector, Vector]:
        """Return ends and densities of the panels; if there are too many, neighbours are averaged at equal variance."""
        q, density = self.wave_number, self.density
        if len(q) <= _MOST_PANELS + 1:
            return q, density
        # Panels are narrower at small wave numbers, where spectra vary most.
        ends = np.r_[q[0], np.geomspace(q[1], q[-1], _MOST_PANELS)]
        between = np.r_[q[0], (ends[:-1] + ends[1:]) / 2.0, q[-1]]
        below = np.r_[0.0, np.cumsum(np.diff(q) * (density[:-1] + density[1:]) / 2.0)]
        means = np.diff(np.interp(between, q, below)) / np.diff(between)
        return ends, means * self.variance / max(float(np.trapezoid(means, ends)), np.finfo(float).tiny)


@dataclass(frozen=True)
class Stationary:
    """Stationary response about steady sliding.

    Attributes:
        force_rms: standard deviation of the mount force [N].
        displacement_rms: standard deviation of the deflection [m].
        speed_rms: standard deviation of the share's speed [m/s].
        force_rate_rms: standard deviation of the mount force's rate of change [N/s].
    """

    force_rms: Expression
    displacement_rms: Expression
    speed_rms: Expression
    force_rate_rms: Expression


def rare_peak(deviation: Expression, rate: Expression, time: Expression) -> Expression:
    """Return the height above its mean that a stationary Gaussian process exceeds in at most `EXCEEDED` of all passes.

    The probability that the largest value in a time T exceeds u is at most that at its start, which is at most
    exp(-u^2/2 s^2)/2, plus the expected number of upcrossings, (T r/2 pi s) exp(-u^2/2 s^2) by S. O. Rice,
    "Mathematical analysis of random noise", Bell System Technical Journal 24 (1945). Upcrossings of a lightly damped
    mount come in clusters, so that the true probability is lower.

    Args:
        deviation: standard deviation s of the process.
        rate: standard deviation r of its rate of change [1/s].
        time: T [s].
    """
    crossings = rate * time / (2.0 * math.pi * ex.maximum(deviation, np.finfo(float).tiny))
    return deviation * ex.sqrt(2.0 * ex.log((0.5 + crossings) / EXCEEDED))


def stationary_response(
    to: Sliding, damper: Expression, waves: Sequence[StrengthWave], random: RandomStrength | Spectrum | None
) -> Stationary:
    """Return the stationary response to strength waves and random strength together.

    Args:
        to: linearised steady sliding.
        damper: c of the mount's damper, whose force is part of the mount force [N s/m].
        waves: strength waves of different lengths.
        random: spectrum of random strength, if any.
    """
    place, rate = to.to_waves(waves)
    if random is not None:
        more = random.response(to)
        place, rate = place + more[0], rate + more[1]
    # Deflection and rate of a stationary motion are uncorrelated.
    force = to.stiffness**2 * place + damper**2 * rate
    # So are rate and acceleration, whose variance follows from M z'' = G s - d z' - k0 z and the stationarity of z^2,
    # z'^2 and z z'; it is at least rate^2/place, whatever the rounding.
    strength = sum((wave.amplitude**2 / 2.0 for wave in waves), 0.0 if random is None else random.variance)
    forced = to.force**2 * strength - to.stiffness**2 * place
    stiff = 2.0 * to.stiffness * to.inertia - to.damping**2
    acceleration = (forced + stiff * rate) / to.inertia**2
    acceleration = ex.maximum(acceleration, rate**2 / ex.maximum(place, np.finfo(float).tiny))
    size, frequency = to.force / to.stiffness, ex.sqrt(to.stiffness / to.inertia)
    return Stationary(
        ex.rms(force, to.force),
        ex.rms(place, size),
        ex.rms(rate, size * frequency),
        ex.rms(to.stiffness**2 * rate + damper**2 * acceleration, to.force * frequency),
    )


@ex.one_node
def _over_panels(*given: Expression) -> tuple[Expression, ...]:
    """Return the integrals of |H|^2 S and omega^2 |H|^2 S over panels.

    Args:
        given: lower and upper ends of the panels, density at the lower end, slope, and the fields of `Sliding`.
    """
    (low, high, start, slope), to = given[:4], Sliding(*given[4:])
    middle, width = ex.sqrt(to.stiffness / to.inertia), to.damping / (2.0 * to.inertia)
    first, last = (ex.arcsinh((end * to.speed - middle) / width) for end in (low, high))
    place, rate = 0.0 * low, 0.0 * low
    # For a panel as wide as the mount's natural frequency the error of 20 nodes is rounding at a tenth of critical
    # damping, 1e-6 at a hundredth and 1e-4 at a thousandth.
    for node, weight in zip(*ex.gauss_legendre(20), strict=True):
        up = ex.exp(first + (last - first) * node)
        frequency = middle + width * (up - 1.0 / up) / 2.0
        there = start + slope * (frequency / to.speed - low)
        part = weight * (last - first) * width * (up + 1.0 / up) / 2.0 / to.speed * there * to.squared(frequency)
        place, rate = place + part, rate + frequency**2 * part
    return place, rate


# Fewest points from which a spectrum can be estimated.
_FEWEST = 32
# Most unevenly spaced points: the time of their periodogram grows with the square of the number.
_MOST_UNEVEN = 10_000


@dataclass(frozen=True)
class StrengthRecord:
    """Soil strength along a path: cone index, or any other measure of strength, over position.

    Args:
        position: position along the path [m], increasing.
        value: cone index [Pa] at each position.
        name: name of the record in messages.

    Raises:
        InputError: there are fewer than 32 points or more than 10,000 at uneven distances, positions do not increase,
            or a number is not finite.

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
    name: str = "the record"

    def __init__(self, position: ArrayLike, value: ArrayLike, name: str = "the record") -> None:
        check_text("the name of a record", name)
        x, y = (array_of(given, f"{name}: positions and values must be numbers") for given in (position, value))
        if x.ndim != 1 or x.shape != y.shape:
            raise InputError(f"{name}: columns must be of equal length, not of shapes {x.shape} and {y.shape}")
        if len(x) < _FEWEST:
            raise InputError(f"{name}: it has {len(x)} points, but a spectrum needs at least {_FEWEST}")
        if not (np.all(np.abs(x) <= LARGEST) and np.all(np.abs(y) <= LARGEST)):
            raise InputError(f"{name}: positions and values must be finite and at most {LARGEST:g} in magnitude")
        if np.any(np.diff(x) <= 0.0):
            place = int(np.argmax(np.diff(x) <= 0.0)) + 1
            raise InputError(f"{name}: positions must increase, but {x[place]:g} m follows {x[place - 1]:g} m")
        vars(self).update(position=x, value=y, name=name)
        if len(x) > _MOST_UNEVEN and not self.even:
            raise InputError(f"{name}: {len(x)} points at uneven distances: make them even, or at most {_MOST_UNEVEN}")

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
        return bool(np.max(np.abs(np.diff(self.position) / self.spacing - 1.0)) <= 1e-3)

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
            raise InputError(f"{self.name}: its linear trend falls to 0: use a part of it in which that stays positive")
        return self.value / trend - 1.0


def strength_spectrum(record: StrengthRecord, *, base_diameter: float = 0.0) -> Spectrum:
    """Return the spectrum of the soil's strength from a record, for use as random strength in `Effects`.

    The estimate and its 95 % band are Welch's or, for uneven spacing, those of a Lomb-Scargle periodogram. Waves
    shorter than two spacings are always left out.

    Args:
        record: strength along a path.
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
    from scipy import signal, stats  # slow to import, and rarely needed

    check_kind("the record", record, StrengthRecord, "a StrengthRecord, as returned by read_strength_record")
    check_domain("base_diameter", base_diameter, "m", at_least=0.0)
    diameter, y = plain_number("base_diameter", base_diameter), record.relative()
    if record.even:
        # Eight segments overlap by half under a Hann window: neighbours' periodograms have a correlation of 1/36.
        size = max(_FEWEST // 2, 2 * len(y) // 9)
        f, density = signal.welch(y, 1.0 / record.spacing, nperseg=min(size, len(y)), detrend="constant")
        count = max(1, (len(y) - size) // (size - size // 2) + 1)
        freedom = 2.0 * count / (1.0 + 2.0 * (count - 1) / count / 36.0)
        q, density = 2.0 * math.pi * f[1:], density[1:] / (2.0 * math.pi)
    else:
        step = 2.0 * math.pi / record.length
        q = step * np.arange(1, len(y) // 2 + 1)
        density, freedom = signal.lombscargle(record.position, y, q) * 2.0 / len(y) / step, 2.0
    usable = q * diameter <= 2.0 * math.pi
    if np.count_nonzero(usable) < 2:
        raise InputError(f"{record.name}: its spectrum has no waves longer than {diameter:.3g} m")
    q, density = q[usable], density[usable]
    low, high = (freedom / stats.chi2.ppf(p, freedom) for p in (0.975, 0.025))
    return Spectrum(q, density, density * low, density * high)
