"""Value, gradient and Hessian of the whole field behind the front, against 120 digits of the textbook's formulas."""

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.density_profiles import field
from helpers.precise_field import Constant

import plough_opt as po
from plough_opt.soil import plastic

# Every entry has some fifty roundings of 1.1e-16 of either sign; the largest error found is 1.6e-15.
DIGITS = 4e-15


def toolkit(name):
    """Return the toolkit's function for a quantity; its arguments are in the order of `NAMES`."""

    def at(r, radius, rate, acceleration, b1, friction_angle=0.5, cohesion=0.0, ambient_pressure=0.0, density=1.0):
        soil = po.Soil(density, b1, cohesion, friction_angle, 0.5, ambient_pressure)
        return field(name, r, plastic.Cavity(radius, rate, acceleration), soil)

    return at


ORDINARY = {
    "radius": 0.05, "rate": 0.5, "acceleration": 3.0, "density_ratio": 0.8, "friction_angle": 0.5, "cohesion": 2e4,
    "ambient_pressure": 101325.0, "density": 1400.0,
}  # fmt: skip
NAMES = ("r", *ORDINARY)
STRESS, KINEMATIC = len(NAMES), NAMES.index("density_ratio") + 1
# Quantity -> number of arguments on which it depends.
QUANTITIES = dict.fromkeys(("radial", "tangential", "surface_pressure"), STRESS)
QUANTITIES |= dict.fromkeys(("current_radius", "particle_velocity", "particle_acceleration"), KINEMATIC)
QUANTITIES |= dict.fromkeys(("front_radius", "front_speed"), KINEMATIC)


def point(place, **changes):
    """Return the arguments at a fraction of the front radius."""
    values = ORDINARY | changes
    front = values["radius"] / math.sqrt(1 - values["density_ratio"])
    return (place * front, *values.values())


POINTS = [
    *[point(place) for place in (0.0, 1e-6, 0.6, 1.0)],
    *[point(0.6, density_ratio=b1) for b1 in (1e-9, 1e-3, 0.5, 1 - 1e-6)],
    *[point(0.6, friction_angle=angle) for angle in (0.0, 1e-9, 1.5)],
    point(0.0, density_ratio=1e-9, friction_angle=0.0),
    point(1.0, density_ratio=1e-9, friction_angle=1.5),
    point(1.0, density_ratio=1 - 1e-6, friction_angle=0.0),
    point(0.0, density_ratio=1 - 1e-6, friction_angle=1.5),
    point(0.4, rate=0.0, acceleration=0.0),
    point(0.7, acceleration=-40.0, cohesion=0.0, ambient_pressure=0.0),
    point(0.9, radius=0.2, rate=30.0, acceleration=-500.0, density_ratio=0.95),
]


@pytest.fixture(scope="module", params=QUANTITIES)
def quantity(request):
    """Return the toolkit's function, the precise one, its number of arguments, and its derivatives as SX and MX."""
    function, size = toolkit(request.param), QUANTITIES[request.param]
    return function, request.param, size, [hp.differentiated(function, symbol, size) for symbol in (ca.SX, ca.MX)]


# Arguments on which the fields depend nonlinearly; they are quadratic polynomials in all others.
SHAPED = ("r", "radius", "density_ratio", "friction_angle")


def rates(x):
    """Return the inverse of the change of each argument over which the field changes by its own magnitude."""
    own = dict(zip(NAMES, x, strict=False))
    lengths = {"radius": own["radius"], "r": max(own["r"], own["radius"]), "density_ratio": 1 - own["density_ratio"]}
    return np.array([1 / lengths.get(name, 1) if name in SHAPED else 0 for name in NAMES[: len(x)]])


def natural_sizes(at, wall, per):
    """Return the magnitudes of the terms whose sums are value, gradient and Hessian.

    An entry can be much smaller than its terms: the pressure on the wall does not depend on the cavity's radius, nor
    that at the front on the acceleration. Magnitudes are therefore at least those at the wall, where the logarithm of
    the distance from the front is largest. The terms of a derivative have the magnitude of the differentiated quantity
    divided by the change of the argument over which it varies.
    """
    value, gradient, hessian = (np.maximum(abs(here), abs(there)) for here, there in zip(at, wall, strict=True))
    crossed = np.outer(gradient, per)
    return value, gradient + value * per, hessian + crossed + crossed.T + value * np.outer(per, per)


@cache
def precise(name, x):
    """Return value, gradient and Hessian in 120 digits, as floats."""

    def at(r, radius, rate, acceleration, density_ratio, *strength):
        return getattr(Constant(density_ratio, radius, rate, acceleration, *strength), name)(r)

    return [np.array(one, dtype=float) for one in hp.derivatives(at, x)]


@pytest.mark.parametrize("arguments", POINTS)
def test_value_gradient_and_hessian(quantity, arguments):
    function, name, size, symbolic = quantity
    x = arguments[:size]
    at = precise(name, x)
    sizes = natural_sizes(at, precise(name, (0.0, *x[1:])), rates(x))
    assert function(*x) == pytest.approx(at[0], abs=DIGITS * sizes[0])
    for f in symbolic:
        for found, wanted, own in zip(f(x), at, sizes, strict=True):
            # The differences turn an exact zero into numbers below 1e-35.
            np.testing.assert_array_less(np.abs(found - wanted), DIGITS * own + 1e-35)
