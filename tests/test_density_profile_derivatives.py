"""A density profile in symbols: values, gradients and Hessians against 75 digits, the profile's parameters included."""

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.density_profiles import DENSITIES, Ground
from helpers.high_precision import mp

import plough_opt as po
from plough_opt.soil import plastic
from plough_opt.soil.plastic import Cavity

NAMES = ("c", "w", "r", "radius", "rate", "acceleration", "friction_angle", "cohesion")
STATE = {"r": 0.06, "radius": 0.05, "rate": 0.5, "acceleration": 3.0, "friction_angle": 0.5, "cohesion": 2e4}

# Some hundred roundings; the largest error found is 1.1e-13, in an entry that is a hundredth of its terms.
DIGITS = 3e-13


# Weights of f(x + n h) - f(x - n h) in h f'(x) for n = 1 to 4.
EIGHTH = (4 / 5, -1 / 5, 4 / 105, -1 / 280)


def toolkit(quantity, name, order):
    """Return a quantity as a function of the numbers or symbols in `NAMES`."""

    def apply(c, w, r, radius, rate, acceleration, friction_angle, cohesion):
        soil, cavity = Ground(name, (c, w), friction_angle, cohesion).soil(order), Cavity(radius, rate, acceleration)
        if quantity in ("radial", "tangential"):
            return -getattr(plastic.stress(r, cavity, soil), quantity)
        if quantity in ("surface_pressure", "front_radius", "front_speed"):
            return getattr(plastic, quantity)(cavity, soil)
        return getattr(plastic, quantity)(r, cavity, soil)

    return apply


PRECISE = {
    "radial": lambda field, r: field.pressure(r),
    "tangential": lambda field, r: field.tangential_pressure(r),
    "surface_pressure": lambda field, _r: field.pressure(mp.mpf(0)) - field.ambient_pressure,
    "front_radius": lambda field, _r: field.front,
    "front_speed": lambda field, _r: field.front_speed,
    "current_radius": lambda field, r: field.current_radius(r),
    "particle_velocity": lambda field, r: field.velocity(r),
    "particle_acceleration": lambda field, r: field.acceleration_of(r),
}


def precise(quantity, name):
    """Return the same quantity as a function computed with 75 digits."""

    def apply(c, w, r, radius, rate, acceleration, friction_angle, cohesion):
        field = Ground(name, (c, w), friction_angle, cohesion).field(radius, rate, acceleration)
        return PRECISE[quantity](field, r)

    return apply


def cases():
    """Yield quantities and profiles: by default a few, each with one profile; with the slow tests all."""
    smooth = [name for name in DENSITIES if name != "bell"]
    default = {("radial", "exponential, b falling")}
    default |= {(quantity, "linear, b falling") for quantity in ("front_speed", "particle_acceleration")}
    for quantity in PRECISE:
        for name in smooth:
            marks = [] if (quantity, name) in default else [pytest.mark.slow]
            yield pytest.param(quantity, name, id=f"{quantity}: {name}", marks=marks)


@pytest.mark.parametrize(("quantity", "name"), [*cases()])
def test_value_gradient_and_hessian(quantity, name):
    point = (*DENSITIES[name][1], *STATE.values())
    function = toolkit(quantity, name, 16)
    value, gradient, hessian = hp.derivatives(precise(quantity, name), point)
    hp.assert_close(function(*point), value, 1e-14, "float")
    for symbol in (ca.SX, ca.MX):
        found = hp.differentiated(function, symbol, len(point))(point)
        hp.assert_close(found[0], value, 1e-14, "value")
        for i, own in enumerate(NAMES):
            # The differences turn an exact zero into numbers below 1e-18.
            assert float(found[1][i]) == pytest.approx(float(gradient[i]), rel=DIGITS, abs=1e-18), own
            for j, other in enumerate(NAMES):
                wanted = float(hessian[i][j])
                assert float(found[2][i, j]) == pytest.approx(wanted, rel=DIGITS, abs=1e-18), f"{own}, {other}"


@pytest.mark.parametrize(
    "name", [pytest.param("exponential, b rising", marks=pytest.mark.slow), "quadratic, b falling"]
)
def test_derivatives_of_the_resistance_in_everything_a_design_varies(name):
    """Compare with central differences of order 8, whose error is the rounding of the value over a step of 2e-3."""
    point = np.array([*DENSITIES[name][1], 0.2, 0.3, 2.0, 3.0, 0.5, 2e4])

    def force(c, w, half_angle, height, speed, acceleration, friction_angle, cohesion):
        soil = Ground(name, (c, w), friction_angle, cohesion).soil(8)
        return po.resistance(po.Cone(half_angle, height), soil, speed, acceleration)

    function = hp.differentiated(force, ca.MX, len(point))
    value, gradient, hessian = function(point)
    assert value == pytest.approx(force(*point), rel=1e-14)
    assert hp.differentiated(force, ca.SX, len(point))(point)[0] == pytest.approx(force(*point), rel=1e-14)
    # Along two directions in which every number varies.
    for along in np.array([[1.0, -0.8, 0.6, 0.9, -0.7, 0.5, 1.0, -0.6], [-0.6, 0.7, 1.0, -0.5, 0.8, 0.9, -1.0, 0.7]]):
        step = 2e-3 * point * along

        def slope(quantity, step=step):
            pairs = (quantity(point + n * step) - quantity(point - n * step) for n in (1, 2, 3, 4))
            return sum(weight * pair for weight, pair in zip(EIGHTH, pairs, strict=True)) / 2e-3

        wanted = slope(lambda at: force(*at))
        assert gradient @ (point * along) == pytest.approx(wanted, rel=1e-11, abs=2e-13 * value)
        column = slope(lambda at: function(at)[1])
        scale = np.abs(hessian) @ np.abs(point * along) + np.abs(gradient)
        np.testing.assert_array_less(np.abs(hessian @ (point * along) - column), 1e-11 * scale + 1e-300)


@pytest.mark.parametrize("place", [0.0, 1.0])
def test_slopes_at_wall_and_front(place):
    """Compare at the ends of the field, where the quadratures have zero length or begin on the axis."""
    name, order = "linear, b rising", 16
    point = [*DENSITIES[name][1], *STATE.values()]
    point[2] = place * float(Ground(name, DENSITIES[name][1]).field(*hp.exact([0.05, 0.5, 3.0])).front)
    first = [0, 1, 2, 3]
    x = ca.SX.sym("x", len(point))
    y = toolkit("radial", name, order)(*ca.vertsplit(x))
    gradient = np.asarray(ca.Function("f", [x], [ca.gradient(y, x)])(point)).ravel()
    exact = hp.exact(point)
    for k in first:
        h = mp.mpf(10) ** -25
        moved = [[*exact[:k], exact[k] + sign * h, *exact[k + 1 :]] for sign in (1, -1)]
        plus, minus = (precise("radial", name)(*values) for values in moved)
        wanted = (plus - minus) / (2 * h)
        size = max(abs(wanted), abs(precise("radial", name)(*exact)) / (10 * max(exact[3], exact[k])))
        assert abs(mp.mpf(gradient[k]) - wanted) <= 1e-14 * size, NAMES[k]
