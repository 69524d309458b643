"""Random soil strength: its spectrum over the wave number, and what a share in steady sliding makes of it.

About steady sliding at the tow speed V the deflection z answers to relative strength of wave number q, omega = q V, by

    H = G/(k0 - M omega^2 + i omega d),    G = F0 (1 + kappa V^2),    d = c + 2 (Fd + kappa F0) V,

and the stationary variances are the integrals of |H|^2 S(q) and omega^2 |H|^2 S(q) over q.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plough_opt.core.checks import NOT_NUMBERS, check_domain
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import (
    Expression,
    arcsinh,
    column,
    exp,
    gauss_legendre,
    holds_casadi,
    one_node,
    rms,
    sqrt,
    total,
)
from plough_opt.core.quantities import read_fields
from plough_opt.soil.waves import StrengthWave

Vector = NDArray[np.float64]

# Nodes in every panel of a tabulated spectrum. In a panel as wide as the mount's frequency a damping of a tenth of the
# critical one is integrated to rounding, of a hundredth to 1e-6, of a thousandth to 1e-4.
_NODES = 20
# Most panels: those of a record are joined to so many, by which an RMS changes by 3e-4, far within a spectrum's band.
_MOST_PANELS = 48


@dataclass(frozen=True)
class Sliding:
    """Steady sliding, linearised: all that the response to relative strength depends on.

    Attributes:
        force: G, by which the resistance changes for a relative change of strength [N].
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
        """Return the variances of deflection [m^2] and of its rate [m^2/s^2] under strength waves of unequal length."""
        found = [(2.0 * math.pi * self.speed / wave.wavelength, wave.amplitude) for wave in waves]
        parts = [(frequency, size**2 / 2.0 * self.squared(frequency)) for frequency, size in found]
        return sum(part for _, part in parts), sum(frequency**2 * part for frequency, part in parts)


@dataclass(frozen=True)
class RandomStrength:
    """Random strength whose correlation falls as exp(-distance/correlation length), as a one-sided spectrum.

    S(q) = 2 rms^2 lambda/(pi (1 + (q lambda)^2)), whose integral over the wave number q is rms^2.

    Args:
        rms: standard deviation of strength over its mean [-], from 0 to 1.
        correlation_length: lambda [m], above 0.

    Raises:
        DomainError: a number outside its domain.

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
        """Return S [m/rad] at a wave number q [rad/m]."""
        check_domain("wave number", wave_number, "rad/m", at_least=0.0)
        length = self.correlation_length
        return 2.0 * self.rms**2 * length / (math.pi * (1.0 + (wave_number * length) ** 2))

    def response(self, to: Sliding) -> tuple[Expression, Expression]:
        """Return the variances of deflection [m^2] and of its rate [m^2/s^2].

        In closed form: that of white noise behind the three poles of the mount and of 1/(1 + i omega lambda/V).
        """
        time = self.correlation_length / to.speed
        carried = to.inertia + to.damping * time
        rate = to.force**2 * self.variance * time / (to.damping * (carried + to.stiffness * time**2))
        return rate * carried / to.stiffness, rate


class Spectrum:
    """One-sided density of relative strength over the wave number, whose integral is the variance; linear between.

    It is not a dataclass: its columns are a measurement, not quantities that a design or a map of scenes could vary.

    Attributes:
        wave_number: q [rad/m], rising.
        density: S(q) [m/rad], at least 0.
        lower: lower end of its 95 % confidence band; default: the density.
        upper: upper end.

    Raises:
        InputError: columns that are not alike, fewer than two places, or numbers that cannot be.

    Example:
        >>> import plough_opt as po
        >>> round(po.Spectrum([0.0, 1.0, 2.0], [0.0, 0.1, 0.0]).variance, 12)
        0.1
    """

    def __init__(
        self, wave_number: ArrayLike, density: ArrayLike, lower: ArrayLike | None = None, upper: ArrayLike | None = None
    ) -> None:
        """Check the columns, and keep copies that cannot be written to."""
        given = (wave_number, density, density if lower is None else lower, density if upper is None else upper)
        try:
            columns = [np.array(values, dtype=float) for values in given]
        except NOT_NUMBERS:
            raise InputError("a spectrum's wave numbers and densities must be numbers") from None
        q = columns[0]
        if q.ndim != 1 or len(q) < 2 or any(values.shape != q.shape for values in columns):
            raise InputError("a spectrum's wave numbers and densities must be alike columns of two numbers or more")
        sound = all(np.isfinite(values).all() and np.all(values >= 0.0) for values in columns)
        if not sound or np.any(np.diff(q) <= 0.0):
            raise InputError("a spectrum's wave numbers must rise, and be finite and at least 0 as its densities")
        for values in columns:
            values.setflags(write=False)
        self.wave_number, self.density, self.lower, self.upper = columns

    @property
    def variance(self) -> float:
        """Integral of the density."""
        return float(np.trapezoid(self.density, self.wave_number))

    def response(self, to: Sliding) -> tuple[Expression, Expression]:
        """Return the variances of deflection [m^2] and of its rate [m^2/s^2].

        By Gauss-Legendre nodes in every panel of the spectrum, which lie dense about the mount's resonance: the wave
        number's frequency is omega0 + (d/2M) sinh(u), and the nodes are even in u.
        """
        q, density = self._panels()
        known = (q[:-1], q[1:], density[:-1], np.diff(density) / np.diff(q))
        panels = (column(x, holds_casadi(to)) for x in known)
        place, rate = _over_panels(*panels, to.force, to.stiffness, to.inertia, to.damping, to.speed)
        return total(place), total(rate)

    def _panels(self) -> tuple[Vector, Vector]:
        """Return ends and densities of its panels: of very many the means of neighbours, with the same variance."""
        q, density = self.wave_number, self.density
        if len(q) <= _MOST_PANELS + 1:
            return q, density
        # Finer at small wave numbers, where a spectrum varies.
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
        displacement_rms: of the deflection [m].
        speed_rms: of the share's speed [m/s].
    """

    force_rms: Expression
    displacement_rms: Expression
    speed_rms: Expression


def stationary_response(
    to: Sliding, damper: Expression, waves: Sequence[StrengthWave], random: RandomStrength | Spectrum | None
) -> Stationary:
    """Return the stationary response to strength waves and random strength together.

    Args:
        to: steady sliding, linearised.
        damper: c of the mount's part of the damping, whose force the mount passes on [N s/m].
        waves: of unequal length.
        random: spectrum of random strength, if any.
    """
    place, rate = to.to_waves(waves)
    if random is not None:
        more = random.response(to)
        place, rate = place + more[0], rate + more[1]
    # Deflection and rate of a stationary motion are uncorrelated.
    force = to.stiffness**2 * place + damper**2 * rate
    size = to.force / to.stiffness
    return Stationary(rms(force, to.force), rms(place, size), rms(rate, size * sqrt(to.stiffness / to.inertia)))


@one_node
def _over_panels(*given: Expression) -> tuple[Expression, ...]:
    """Return the integrals of |H|^2 S and omega^2 |H|^2 S over panels: ends, densities, slopes, then `Sliding`."""
    (low, high, start, slope), to = given[:4], Sliding(*given[4:])
    middle, width = sqrt(to.stiffness / to.inertia), to.damping / (2.0 * to.inertia)
    first, last = (arcsinh((end * to.speed - middle) / width) for end in (low, high))
    place, rate = 0.0 * low, 0.0 * low
    for node, weight in zip(*gauss_legendre(_NODES), strict=True):
        up = exp(first + (last - first) * node)
        frequency = middle + width * (up - 1.0 / up) / 2.0
        there = start + slope * (frequency / to.speed - low)
        part = weight * (last - first) * width * (up + 1.0 / up) / 2.0 / to.speed * there * to.squared(frequency)
        place, rate = place + part, rate + frequency**2 * part
    return place, rate
