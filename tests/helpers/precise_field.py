"""The field behind the compaction front in 120-digit arithmetic: equations (14)-(22) in textbook form.

The formulas are not rearranged against cancellation, and the toolkit is not imported.
"""

from functools import cache

from mpmath.calculus.quadrature import GaussLegendre

from helpers.equations import friction, mp

# Digits of a profile's integrals and roots; second differences with a step of 1e-25 keep 20 of them.
_DIGITS = 75
# Quadrature nodes; the error for the profiles below is at most 1e-50.
_NODES = 96

# Shape -> b = rho0/rho at (s, c, w), and the integral of 2 b s ds from 0 to s, where b falls (sign 1) or rises (-1).
_SHAPES = {
    "exponential": (
        lambda s, c, w, sign: c + sign * mp.exp(-s / w) / 4,
        lambda s, c, w, sign: c * s**2 + sign * w * (w - (w + s) * mp.exp(-s / w)) / 2,
    ),
    "quadratic": (
        lambda s, c, w, sign: 1 / (c * (1 + sign * (s / w) ** 2)),
        lambda s, c, w, sign: sign * w**2 / c * mp.log(1 + sign * (s / w) ** 2),
    ),
    "bell": (
        lambda s, c, w, _: 1 / (c * (1 + mp.exp(-((s / w) ** 2)) / 4)),
        lambda s, c, w, _: w**2 / c * mp.log((4 * mp.exp((s / w) ** 2) + 1) / 5),
    ),
}


@cache
def _gauss_legendre():
    """Return nodes and weights between -1 and 1."""
    with mp.workdps(_DIGITS + 5):
        found = GaussLegendre(mp).calc_nodes(6, mp.prec)
    assert len(found) == _NODES
    return found


def _power_integral(low, high, exponent):
    """Integral of t^(exponent - 1)."""
    return (high**exponent - low**exponent) / exponent if exponent else mp.log(high / low)


class Field:
    """The field around a cavity in soil of a density profile, by the profile's name and precise numbers.

    Quantities have the toolkit's names, and all take a Lagrangian radius.
    """

    def __init__(
        self, name, c, w, radius, rate, acceleration, friction_angle=0, cohesion=0, ambient_pressure=0, density=0
    ):
        self.name, self.parameters = name, (c, w)
        self.radius, self.rate, self.acceleration = radius, rate, acceleration
        self.mu, self.nu = friction(friction_angle)
        self.tau0 = 2 * cohesion * mp.cos(friction_angle)
        self.ambient_pressure, self.undisturbed = ambient_pressure, density
        self.front = self._front()

    def _shaped(self, which, s):
        shape, _, way = self.name.partition(", b ")
        return _SHAPES[shape][which](s, *self.parameters, -1 if way == "rising" else 1)

    def ratio(self, s):
        return self._shaped(0, s)

    def swept(self, s):
        """Return 2 psi."""
        return self._shaped(1, s)

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

    def momentum(self, r):
        """Return the integral of y^(nu - 1) s y'' ds from r to the front, by quadrature."""
        with mp.workdps(_DIGITS + 5):
            middle, half = (self.front + r) / 2, (self.front - r) / 2
            places = [(middle + half * x, weight) for x, weight in _gauss_legendre()]
            terms = (w * self.current_radius(s) ** (self.nu - 1) * s * self.particle_acceleration(s) for s, w in places)
            return half * mp.fsum(terms)

    def pressure(self, r):
        """Equation (14), with (21) in it."""
        nu, front, y = self.nu, self.front, self.current_radius(r)
        jump = self.undisturbed * (self.radius * self.rate / front) ** 2 / (1 - self.ratio(front))
        shear = self.tau0 / (1 + self.mu) * _power_integral(y, front, nu)
        carried = self.undisturbed * self.momentum(r)
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


class Constant(Field):
    """The field in soil of a constant ratio b1 behind the front, in closed form."""

    def __init__(self, density_ratio, *others):
        self.b1 = density_ratio
        super().__init__(None, None, None, *others)

    def ratio(self, _):
        return self.b1

    def swept(self, s):
        return self.b1 * s**2

    def _front(self):
        return self.radius / mp.sqrt(1 - self.b1)

    def momentum(self, r):
        """With s ds = y dy/b1 and (18)."""
        ends = self.current_radius(r), self.front
        steady = (self.rate**2 + self.radius * self.acceleration) * _power_integral(*ends, self.nu)
        return (steady - (self.radius * self.rate) ** 2 * _power_integral(*ends, self.nu - 2)) / self.b1
