"""The field behind the compaction front in 120-digit arithmetic: equations (14)-(22) in textbook form.

The formulas are not rearranged against cancellation, and the toolkit is not imported.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from mpmath.calculus.quadrature import GaussLegendre

from helpers.high_precision import mp

# Digits of a profile's integrals and roots; second differences with a step of 1e-25 keep 20 of them.
_DIGITS = 75
# Quadrature nodes; the error for the profiles below is at most 1e-50.
_NODES = 96


def _friction(friction_angle, cohesion):
    mu = mp.sin(friction_angle)
    return mu, 2 * mu / (1 + mu), 2 * cohesion * mp.cos(friction_angle)


def _power_integral(low, high, exponent):
    """Integral of t^(exponent - 1)."""
    return (high**exponent - low**exponent) / exponent if exponent else mp.log(high / low)


class Particle(NamedTuple):
    """A particle of Lagrangian radius r behind the front in soil of a constant locked density."""

    r: Any
    radius: Any
    rate: Any
    acceleration: Any
    density_ratio: Any
    friction_angle: Any = None
    cohesion: Any = None
    ambient_pressure: Any = None
    density: Any = None

    @property
    def front_radius(self):
        """Equation (16): r*^2 = b1 r*^2 + R^2."""
        return self.radius / mp.sqrt(1 - self.density_ratio)

    @property
    def front_speed(self):
        """Time derivative of (16)."""
        return self.rate / mp.sqrt(1 - self.density_ratio)

    @property
    def current_radius(self):
        """Equation (15)."""
        return mp.sqrt(self.density_ratio * self.r**2 + self.radius**2)

    @property
    def particle_velocity(self):
        """Equation (17)."""
        return self.radius * self.rate / self.current_radius

    @property
    def particle_acceleration(self):
        """Equation (18) as printed, a difference."""
        y = self.current_radius
        return (self.rate**2 + self.radius * self.acceleration) / y - (self.radius * self.rate) ** 2 / y**3

    @property
    def pressure(self):
        """Radial pressure by the integral (14), with s ds = y dy/b1 and (18) and (21) in it."""
        mu, nu, tau0 = _friction(self.friction_angle, self.cohesion)
        y, front = self.current_radius, self.front_radius
        at_front = self.density * (self.radius * self.rate / front) ** 2 / (1 - self.density_ratio)
        carried = (self.rate**2 + self.radius * self.acceleration) * _power_integral(y, front, nu)
        carried -= (self.radius * self.rate) ** 2 * _power_integral(y, front, nu - 2)
        shear = tau0 / (1 + mu) * _power_integral(y, front, nu)
        inside = front**nu * (self.ambient_pressure + at_front) + self.density / self.density_ratio * carried + shear
        return inside / y**nu

    @property
    def radial(self):
        """Radial stress, tension positive."""
        return -self.pressure

    @property
    def tangential(self):
        """Tangential stress from the yield condition (10), tension positive."""
        mu, _, tau0 = _friction(self.friction_angle, self.cohesion)
        return -((1 - mu) * self.pressure - tau0) / (1 + mu)

    @property
    def surface_pressure(self):
        """Gauge pressure on the wall."""
        return self._replace(r=mp.mpf(0)).pressure - self.ambient_pressure


class Profile(NamedTuple):
    """A density behind the front with two parameters c and w, and results that do not need quadrature.

    ``ratio`` is b = rho0/rho at (s, c, w); ``swept`` is the integral of 2 b s ds from 0 to s.
    """

    ratio: Callable
    swept: Callable


def _exponential(sign):
    def ratio(s, c, w):
        return c + sign * mp.exp(-s / w) / 4

    def swept(s, c, w):
        return c * s**2 + sign * w * (w - (w + s) * mp.exp(-s / w)) / 2

    return Profile(ratio, swept)


def _quadratic(sign):
    def ratio(s, c, w):
        return 1 / (c * (1 + sign * (s / w) ** 2))

    def swept(s, c, w):
        return sign * w**2 / c * mp.log(1 + sign * (s / w) ** 2)

    return Profile(ratio, swept)


def _bell(s, c, w):
    return 1 / (c * (1 + mp.exp(-((s / w) ** 2)) / 4))


def _bell_swept(s, c, w):
    return w**2 / c * mp.log((4 * mp.exp((s / w) ** 2) + 1) / 5)


PROFILES = {
    "exponential, b rising": _exponential(-1),
    "exponential, b falling": _exponential(1),
    "quadratic, b rising": _quadratic(-1),
    "quadratic, b falling": _quadratic(1),
    "bell": Profile(_bell, _bell_swept),
}


@cache
def _gauss_legendre():
    """Return nodes and weights between -1 and 1."""
    with mp.workdps(_DIGITS + 5):
        found = GaussLegendre(mp).calc_nodes(6, mp.prec)
    assert len(found) == _NODES
    return found


class Field:
    """The field around a cavity in soil of a density profile; arguments are numbers of `high_precision.exact`.

    Quantities have the toolkit's names, and all take a Lagrangian radius.
    """

    def __init__(self, profile, c, w, radius, rate, acceleration, friction_angle, cohesion, ambient_pressure, density):
        self.profile, self.parameters = profile, (c, w)
        self.radius, self.rate, self.acceleration = radius, rate, acceleration
        self.mu, self.nu, self.tau0 = _friction(friction_angle, cohesion)
        self.ambient_pressure, self.undisturbed = ambient_pressure, density
        self.front = self._front()

    def ratio(self, s):
        return self.profile.ratio(s, *self.parameters)

    def swept(self, s):
        """Return 2 psi."""
        return self.profile.swept(s, *self.parameters)

    def _front(self):
        """Root of r*^2 = 2 psi(r*) + R^2 by Newton's method."""
        r = 2 * self.radius
        with mp.workdps(_DIGITS + 10):
            for _ in range(100):
                step = (r**2 - self.swept(r) - self.radius**2) / (2 * r * (1 - self.ratio(r)))
                r -= step
                if abs(step) < mp.mpf(10) ** -_DIGITS:
                    return r
        raise AssertionError("no front")

    def density(self, r):
        """Equation (9)."""
        return self.undisturbed / self.ratio(r)

    def front_radius(self, _):
        """Equation (16)."""
        return self.front

    def front_speed(self, _):
        """Equations (19)-(21)."""
        return self.radius * self.rate / (self.front * (1 - self.ratio(self.front)))

    def current_radius(self, r):
        """Equation (15)."""
        return mp.sqrt(self.swept(r) + self.radius**2)

    def particle_velocity(self, r):
        """Equation (17)."""
        return self.radius * self.rate / self.current_radius(r)

    def particle_acceleration(self, r):
        """Equation (18)."""
        y = self.current_radius(r)
        return (self.rate**2 + self.radius * self.acceleration) / y - (self.radius * self.rate) ** 2 / y**3

    def pressure(self, r):
        """Equation (14) by quadrature in the Lagrangian radius."""
        nu, front, y = self.nu, self.front, self.current_radius(r)

        def momentum(s):
            return self.current_radius(s) ** (nu - 1) * s * self.particle_acceleration(s)

        with mp.workdps(_DIGITS + 5):
            middle, half = (front + r) / 2, (front - r) / 2
            carried = self.undisturbed * half * mp.fsum(w * momentum(middle + half * x) for x, w in _gauss_legendre())
            jump = self.undisturbed * (self.radius * self.rate / front) ** 2 / (1 - self.ratio(front))
            shear = self.tau0 / (1 + self.mu) * _power_integral(y, front, nu)
            return (front**nu * (self.ambient_pressure + jump) + carried + shear) / y**nu

    def radial(self, r):
        """Radial stress, tension positive."""
        return -self.pressure(r)

    def tangential(self, r):
        """Tangential stress from the yield condition (10), tension positive."""
        return -((1 - self.mu) * self.pressure(r) - self.tau0) / (1 + self.mu)

    def surface_pressure(self, _):
        """Gauge pressure on the wall."""
        return self.pressure(mp.mpf(0)) - self.ambient_pressure
