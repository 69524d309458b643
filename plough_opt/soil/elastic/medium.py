"""The elastic soil at a given speed: wave speeds, and functions of the speed that all formulas share."""

from dataclasses import dataclass
from typing import Any, Final

from plough_opt.core.checks import check_domain
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import (
    Expression,
    absolute,
    arctan2,
    arctan_ratio,
    arctanh_ratio,
    log,
    sqrt,
    where,
)
from plough_opt.core.labels import checked_in_designs, limited_in_designs, unlabelled
from plough_opt.soil.soil import Soil, check_soil

medium_law = limited_in_designs("elastic medium")
"""Decorator of functions of an elastic soil and a speed, whose limits designs keep."""

BELOW_SHEAR_WAVES: Final = 1e-4
"""Part by which designs stay below the shear wave speed, where the fields are finite but their derivatives are not."""

# Newton steps for the cubic of the Rayleigh speed: each doubles the number of correct digits, which is three at first.
_RAYLEIGH_STEPS = 5


@checked_in_designs
def shear_modulus(soil: Soil) -> Expression:
    """Return the shear modulus mu = E/(2 (1 + nu)) [Pa].

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.
    """
    modulus, ratio = _constants(soil)
    return modulus / (2.0 * (1.0 + ratio))


@checked_in_designs
def shear_wave_speed(soil: Soil) -> Expression:
    """Return c2 = sqrt(mu/rho) [m/s], the largest speed for which the elastic medium is solved.

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.
    """
    return sqrt(shear_modulus(soil) / soil.density)


@checked_in_designs
def longitudinal_wave_speed(soil: Soil) -> Expression:
    """Return c1 = c2/sqrt(kappa) [m/s] with kappa = (1 - 2 nu)/(2 (1 - nu)).

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.
    """
    return shear_wave_speed(soil) / sqrt(_kappa(_constants(soil)[1]))


@checked_in_designs
def rayleigh_speed(soil: Soil) -> Expression:
    """Return the Rayleigh speed c_R [m/s], at which the pressure on a wedge vanishes.

    It satisfies (1 + eta^2)^2 = 4 alpha eta, which is equivalent to the cubic
    m^3 - 8 m^2 + 8 (3 - 2 kappa) m - 16 (1 - kappa) = 0 in m = (c_R/c2)^2.

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.
    """
    speed = shear_wave_speed(soil)
    _, ratio = _constants(soil)
    kappa = _kappa(ratio)
    m = ((0.87 + 1.12 * ratio) / (1.0 + ratio)) ** 2
    for _ in range(_RAYLEIGH_STEPS):
        value = ((m - 8.0) * m + 8.0 * (3.0 - 2.0 * kappa)) * m - 16.0 * (1.0 - kappa)
        m = m - value / ((3.0 * m - 16.0) * m + 8.0 * (3.0 - 2.0 * kappa))
    return speed * sqrt(m)


@dataclass(frozen=True)
class Ratios:
    """Dimensionless numbers of an elastic soil at a speed, from which all fields follow.

    Attributes:
        m: (V0/c2)^2 [-], from 0 to 1.
        kappa: (c2/c1)^2 [-].
        stiffening: 1 - 2 kappa = nu/(1 - nu) = lambda/(lambda + 2 mu) [-].
        alpha: sqrt(1 - V0^2/c1^2) [-].
        eta: sqrt(1 - V0^2/c2^2) [-].
    """

    m: Expression
    kappa: Expression
    stiffening: Expression
    alpha: Expression
    eta: Expression

    @property
    def in_order(self) -> tuple[Expression, ...]:
        """The five numbers in the order of the constructor's arguments."""
        return self.m, self.kappa, self.stiffening, self.alpha, self.eta

    @property
    def lateral(self) -> Expression:
        """Return 1 + eta^2 = 2 - m."""
        return 2.0 - self.m

    @property
    def slowing(self) -> Expression:
        """Return c = (alpha - eta)/m = (1 - kappa)/(alpha + eta)."""
        return (1.0 - self.kappa) / (self.alpha + self.eta)

    @property
    def product(self) -> Expression:
        """Return q1 = (1 - alpha eta)/m = (1 + kappa - kappa m)/(1 + alpha eta)."""
        return (1.0 + self.kappa - self.kappa * self.m) / (1.0 + self.alpha * self.eta)

    @property
    def rayleigh(self) -> Expression:
        """Return R/m = ((1 + eta^2)^2 - 4 alpha eta)/m, which changes sign at the Rayleigh speed."""
        return 4.0 * self.product - 4.0 + self.m


@dataclass(frozen=True)
class Medium(Ratios):
    """An elastic soil that streams past the body.

    Attributes:
        shear_modulus: mu [Pa].
        mach: V0/c2 [-].
    """

    shear_modulus: Expression
    mach: Expression


def medium(soil: Soil, speed: Expression) -> Medium:
    """Return the medium at a speed [m/s].

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.
        DomainError: the speed is negative or above the shear wave speed.
    """
    with unlabelled():
        modulus, fastest = shear_modulus(soil), shear_wave_speed(soil)
    speed = check_domain("speed", speed, "m/s", at_least=0.0)
    mach = speed / fastest
    check_domain(
        "speed over shear wave speed",
        mach,
        at_most=1.0,
        why="the elastic medium is solved up to the shear wave speed; see elastic.shear_wave_speed(soil)",
        inside=BELOW_SHEAR_WAVES,
    )
    _, ratio = _constants(soil)
    kappa = _kappa(ratio)
    m = mach**2
    # Near the shear wave speed 1 - m cancels; at low speed the derivative of the product does.
    eta_squared = where(m < 0.5, 1.0 - m, (fastest - speed) * (fastest + speed) / fastest**2)
    return Medium(
        shear_modulus=modulus,
        m=m,
        kappa=kappa,
        stiffening=ratio / (1.0 - ratio),
        alpha=sqrt(1.0 - kappa * m),
        eta=sqrt(eta_squared),
        mach=mach,
    )


def _constants(soil: Soil) -> tuple[Expression, Expression]:
    """Return Young's modulus [Pa] and Poisson's ratio."""
    check_soil(soil)
    known: dict[str, Any] = {name: getattr(soil, name) for name in ("youngs_modulus", "poisson_ratio")}
    for name, value in known.items():
        if value is None:
            raise InputError(f"the elastic medium needs {name}, but {soil.name} does not have it: set soil.{name}")
    return known["youngs_modulus"], known["poisson_ratio"]


def _kappa(poisson_ratio: Expression) -> Expression:
    """Return (c2/c1)^2 = (1 - 2 nu)/(2 (1 - nu))."""
    return (1.0 - 2.0 * poisson_ratio) / (2.0 * (1.0 - poisson_ratio))


# --- differences divided by m, which is small at low speed, without cancellation -------------------------------------


FAR = 1.6
"""A Gauss rule replaces the closed form if the distances from both ends of a piece sum to more than this many lengths.

It is then the more accurate of the two.
"""

FAR_NODES = 24
"""Nodes of that rule."""

# Largest argument for which the ratio functions replace the logarithm and the angle.
_SERIES_BELOW = 0.5


def log_difference(a: Expression, b: Expression, change: Expression, m: Expression = 1.0) -> Expression:
    """Return ln(a/b)/m for positive a and b whose difference a - b = m change is known to rounding."""
    w = change / (a + b)
    near = absolute(m * w) < _SERIES_BELOW
    close = 2.0 * w * arctanh_ratio(where(near, m * w, 0.0))
    return where(near, close, log(a / b) / where(near, 1.0, m))


def angle_difference(rise: Expression, run: Expression, m: Expression) -> Expression:
    """Return the angle of the point (run, m rise), divided by m, without cancellation for small m."""
    near = absolute(m * rise) < _SERIES_BELOW * run
    safe_run = where(near, run, 1.0)
    close = rise / safe_run * arctan_ratio(where(near, m * rise / safe_run, 0.0))
    return where(near, close, arctan2(m * rise, where(near, 1.0, run)) / where(near, 1.0, m))
