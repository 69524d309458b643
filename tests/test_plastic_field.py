"""The field behind the compaction front: the source's own equations as residuals."""

import math

import casadi as ca
import mpmath as mp
import numpy as np
import pytest

import plough_opt as po
from plough_opt.soil import plastic

SOILS = [po.named_soil(name) for name in po.soil_names()] + [
    po.Soil(1400.0, 0.8, 15e3, 0.0, 0.5, 1e4, name="no internal friction"),
    po.Soil(1400.0, 1e-9, 15e3, 0.5, 0.5, 1e4, name="locks at once"),
]
CAVITIES = [plastic.Cavity(0.05, 0.5, 0.0), plastic.Cavity(0.03, 1.5, 40.0), plastic.Cavity(0.05, 0.0, 0.0)]
# A dozen operations on numbers of one sign, in units of rounding.
ROUNDING = 1e-13

soils = pytest.mark.parametrize("soil", SOILS, ids=lambda soil: soil.name)
cavities = pytest.mark.parametrize("cavity", CAVITIES, ids=["steady", "speeding up", "at rest"])


def radii(cavity, soil):
    return np.linspace(0.0, plastic.front_radius(cavity, soil), 7)


@soils
@cavities
def test_wall_carries_the_surface_pressure_of_23(soil, cavity):
    pressure = -plastic.stress(0.0, cavity, soil).radial
    assert pressure == pytest.approx(plastic.surface_pressure(cavity, soil) + soil.ambient_pressure, rel=ROUNDING)


@soils
@cavities
def test_front_conditions_19_to_21(soil, cavity):
    front = plastic.front_radius(cavity, soil)
    speed, velocity = plastic.front_speed(cavity, soil), plastic.particle_velocity(front, cavity, soil)
    locked = soil.density / soil.density_ratio
    assert plastic.current_radius(front, cavity, soil) == pytest.approx(front, rel=ROUNDING)
    # Mass (20), divided by the locked density, which is huge for soil that locks at once.
    assert soil.density / locked * speed == pytest.approx(speed - velocity, rel=ROUNDING, abs=ROUNDING * speed)
    momentum = soil.density * speed * velocity
    pressure = -plastic.stress(front, cavity, soil).radial
    assert pressure == pytest.approx(soil.ambient_pressure + momentum, rel=ROUNDING)


@soils
@cavities
def test_yield_condition_10_holds_everywhere(soil, cavity):
    found = plastic.stress(radii(cavity, soil), cavity, soil)
    mu, tau0 = math.sin(soil.friction_angle), 2.0 * soil.cohesion * math.cos(soil.friction_angle)
    p, q = -found.radial, -found.tangential
    np.testing.assert_allclose(p - q, tau0 + mu * (p + q), rtol=ROUNDING, atol=ROUNDING * np.max(p))


@soils
@cavities
def test_continuity_9_and_momentum_8_are_residuals_of_the_field(soil, cavity):
    r = ca.SX.sym("r")
    y, field = plastic.current_radius(r, cavity, soil), plastic.stress(r, cavity, soil)
    y_r, sigma_r = ca.jacobian(y, r), ca.jacobian(field.radial, r)
    terms = [
        soil.density * r * plastic.particle_acceleration(r, cavity, soil),
        y * sigma_r,
        (field.radial - field.tangential) * y_r,
        field.radial * y_r,
    ]
    evaluate = ca.Function("residuals", [r], [y * y_r - soil.density_ratio * r, ca.vertcat(*terms)])
    for radius in radii(cavity, soil)[1:-1]:
        continuity, (inertia, gradient, hoop, stress) = (np.asarray(x).ravel() for x in evaluate(radius))
        assert abs(continuity[0]) <= ROUNDING * radius
        # The difference of the stresses is rounded as they are themselves; so are the two parts of the inertial
        # pressure, rho0 R'^2 each, which for soil that locks at once cancel down to the order of b1.
        inertial = soil.density * cavity.rate**2 * radius / cavity.radius
        size = abs(inertia) + abs(gradient) + abs(stress) + inertial
        assert abs(inertia - gradient - hoop) <= 10 * ROUNDING * size


def test_particles_move_as_the_wall_makes_them():
    """The cavity R(t) = 0.03 + 1.5 t + 20 t^2, whose particles' paths are differentiated at high precision."""
    soil, r = po.named_soil("serozem"), 0.02

    def path(t):
        return mp.sqrt(soil.density_ratio * r**2 + (mp.mpf("0.03") + mp.mpf("1.5") * t + 20 * t**2) ** 2)

    cavity = plastic.Cavity(0.03, 1.5, 40.0)
    with mp.workdps(40):
        assert plastic.current_radius(r, cavity, soil) == pytest.approx(float(path(0)), rel=ROUNDING)
        assert plastic.particle_velocity(r, cavity, soil) == pytest.approx(float(mp.diff(path, 0)), rel=ROUNDING)
        assert plastic.particle_acceleration(r, cavity, soil) == pytest.approx(float(mp.diff(path, 0, 2)), rel=ROUNDING)


def test_pressure_is_the_integral_14_of_momentum_from_the_front():
    """Quadrature of (14) as it is derived, powers of y and all, at high precision."""
    soil, cavity, r = po.named_soil("hardpan"), plastic.Cavity(0.03, 1.5, 40.0), 0.025
    with mp.workdps(40):
        mu = mp.sin(soil.friction_angle)
        nu, b1, tau0 = 2 * mu / (1 + mu), mp.mpf(soil.density_ratio), 2 * soil.cohesion * mp.cos(soil.friction_angle)
        R, rate, acceleration = (mp.mpf(x) for x in (cavity.radius, cavity.rate, cavity.acceleration))
        front = R / mp.sqrt(1 - b1)

        def y(s):
            return mp.sqrt(b1 * s**2 + R**2)

        def integrand(s):
            return y(s) ** (nu - 1) * s * ((rate**2 + R * acceleration) / y(s) - (R * rate) ** 2 / y(s) ** 3)

        at_front = soil.ambient_pressure + soil.density * (R * rate / front) ** 2 / (1 - b1)
        pressure = front**nu * at_front + soil.density * mp.quad(integrand, [r, front])
        pressure += tau0 / (1 + mu) * (front**nu - y(r) ** nu) / nu
        assert -plastic.stress(r, cavity, soil).radial == pytest.approx(float(pressure / y(r) ** nu), rel=ROUNDING)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_numbers_and_symbols_give_the_same(symbol):
    soil, x = po.named_soil("heavy clay"), symbol.sym("x", 4)
    found = plastic.stress(x[0], plastic.Cavity(x[1], x[2], x[3]), soil)
    values = ca.Function("stress", [x], [found.radial, found.tangential])([0.02, 0.03, 1.5, 40.0])
    numbers = plastic.stress(0.02, plastic.Cavity(0.03, 1.5, 40.0), soil)
    assert float(values[0]) == pytest.approx(numbers.radial, rel=1e-15)
    assert float(values[1]) == pytest.approx(numbers.tangential, rel=1e-15)


@pytest.mark.parametrize(("r", "sentence"), [(-0.01, "at least 0 m"), (0.2, "ahead of the front nothing moves")])
def test_radii_outside_the_field_are_refused(r, sentence):
    with pytest.raises(po.DomainError, match=sentence):
        plastic.stress(r, plastic.Cavity(0.05, 1.0, 0.0), po.named_soil("serozem"))
