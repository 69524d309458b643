"""The spherical cavity: its closed form against the differential equation, the published form and known limits."""

import dataclasses
import math

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import plough_opt as po
from plough_opt.laws.cones import spherical_cavity
from plough_opt.studies.crosscheck import spherical_cavity_draft

NAMED = [po.named_soil(name) for name in po.soil_names()]
CONE = po.Cone(po.deg(15.0), 0.25)
RIGID = dataclasses.replace(NAMED[2], youngs_modulus=None)


def yield_line(soil):
    """Return lambda and tau0 of sigma_r - sigma_t = lambda p + tau0, Mohr and Coulomb's, in gauge pressures."""
    s, c = math.sin(soil.friction_angle), math.cos(soil.friction_angle)
    slope = 6 * s / (3 - s)
    return slope, 6 * soil.cohesion * c / (3 - s) + slope * soil.ambient_pressure


def integrated(soil, speed):
    """Return the gauge pressure on the wall [Pa] at a cavity radius of 1 m, by integrating the equation of motion."""
    slope, tau = yield_line(soil)
    rho0, rho1 = soil.density, soil.density / soil.density_ratio
    strain = tau / (2 * soil.youngs_modulus) if soil.youngs_modulus else 0.0
    # Volume: soil that filled the front's sphere r0 now lies, locked, between the cavity and r0 (1 + strain).
    r0 = float(mp.findroot(lambda r: rho0 * r**3 - rho1 * ((r * (1 + strain)) ** 3 - 1), 2.0))
    r1 = r0 * (1 + strain)
    front = speed * r0
    # Ahead: displacement strain r0^3/r^2, whose acceleration is 6 strain front^2 r0/r^2 and deviator tau (r0/r)^3.
    ahead = 0.0
    if strain:
        ahead = quad(lambda q: 2 * tau * q**2 + 6 * strain * rho0 * front**2, 0.0, 1.0, epsabs=0.0, epsrel=1e-13)[0]
    start = ahead + rho0 * front * (speed / r1**2 - 3 * strain * front)

    def slope_of(r, sigma):
        # p = sigma_r - (2/3) D, so that D = (lambda sigma_r + tau)/(1 + 2 lambda/3); v = V/r^2 at a cavity radius of 1.
        deviator = (slope * sigma + tau) / (1 + 2 * slope / 3)
        acceleration = 2 * speed**2 * (1 / r**2 - 1 / r**5)
        return -2 * deviator / r - rho1 * acceleration

    done = solve_ivp(slope_of, (r1, 1.0), [start], method="DOP853", rtol=1e-12, atol=1e-6)
    return done.y[0, -1]


@pytest.mark.parametrize("speed", [0.0, 2.0, 20.0])
@pytest.mark.parametrize("soil", [*NAMED, RIGID], ids=lambda s: s.name)
def test_the_closed_form_solves_the_equation_of_motion(soil, speed):
    cavity = spherical_cavity(soil)
    found = cavity.static + cavity.inertia * soil.density * speed**2
    # The integrator's tolerance is 1e-12 per step.
    assert found == pytest.approx(integrated(soil, speed), rel=1e-10)


def test_elastic_soil_ahead_is_the_published_form():
    """A equals the published one; B differs by terms of the order of the strain 1.6e-8 over eta = 0.05.

    The soil is that of a published port: lambda = 1.47, tau0 = 31 549 Pa, rho0/rho1 = 1834/1930.
    """
    eta, alpha, slope, tau = 96 / 1930, 3 * 1.47 / (3 + 2 * 1.47), 1.47, 31549.0
    s = 3 * slope / (6 + slope)
    cohesion = tau * (3 - s) / (6 * math.sqrt(1 - s * s))
    soil = po.Soil(1834.0, 1 - eta, cohesion, math.asin(s), 0.3, ambient_pressure=0.0, youngs_modulus=1e12)
    strain = tau / 2e12
    g = ((1 + strain) ** 3 - (1 - eta)) ** (1 / 3)
    x = ((1 + strain) / g) ** (2 * alpha)
    c1 = 6 * strain + eta * (1 - 3 * strain) ** 2
    k = (1 - eta) * (1 - 2 * alpha) * (2 - alpha)
    c2 = -(g**3) * (2 * (1 - eta) * (2 - alpha) + 3 * g**3) / (k * (1 + strain) ** 4)
    cavity = spherical_cavity(soil)
    assert cavity.static == pytest.approx(tau * (x / alpha - 1 / slope), rel=1e-12)
    assert cavity.inertia == pytest.approx(3 / k + x / g**2 * (c1 + c2), rel=3e-6)


def test_without_friction_and_compaction_it_is_the_cavity_of_bishop_hill_and_mott_and_of_rayleigh():
    """(2Y/3)(1 + ln(2E/3Y)) with Y = 2k, less the order of strain Y/2E = 1e-6; Rayleigh's cavity in a fluid has 3/2."""
    solid = po.Soil(1500.0, 1 - 1e-13, 10e3, 0.0, 0.0, ambient_pressure=0.0, youngs_modulus=1e10)
    expected = 2 * 20e3 / 3 * (1 + math.log(2 * 1e10 / (3 * 20e3)))
    assert spherical_cavity(solid).static == pytest.approx(expected, rel=1e-6)
    fluid = dataclasses.replace(solid, cohesion=0.0, youngs_modulus=None)
    # The front at x = 2e4 leaves terms of 1/x.
    assert spherical_cavity(fluid).inertia == pytest.approx(1.5, rel=1e-3)


@pytest.mark.parametrize("soil", [NAMED[2], RIGID])
def test_the_draft_is_the_pressure_over_the_face(soil):
    speed, b = 2.0, CONE.half_angle
    cavity = spherical_cavity(soil)
    pressure = cavity.static + cavity.inertia * soil.density * (speed * math.sin(b)) ** 2
    expected = pressure * CONE.area * (math.sin(b) + soil.tool_friction * math.cos(b))
    assert spherical_cavity_draft(CONE, soil, speed) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbols_and_arrays_give_the_numbers(kind):
    """At lambda = 0.75, 2 alpha = 1 and the quotient of powers has a removable singularity."""
    s = 3 * 0.75 / (6 + 0.75)
    theta = kind.sym("theta")

    def at(angle):
        return spherical_cavity_draft(CONE, dataclasses.replace(NAMED[2], friction_angle=angle), 2.0)

    value = at(theta)
    f = ca.Function("f", [theta], [value, ca.gradient(value, theta)])
    for angle in (math.asin(s), 0.0, 0.5):
        found, slope = map(float, f(angle))
        assert found == pytest.approx(at(angle), rel=1e-14)
        if angle:
            # Central differences with a step of 1e-5: truncation 1e-10, rounding 1e-11.
            assert slope == pytest.approx((at(angle + 1e-5) - at(angle - 1e-5)) / 2e-5, rel=1e-8)
    angles = np.array([0.3, 0.5])
    assert at(angles) == pytest.approx([at(a) for a in angles], rel=1e-14)


def test_refusals():
    soft = dataclasses.replace(NAMED[2], youngs_modulus=1e6)
    for soil, speed, words in ((NAMED[2], -1.0, "speed"), (soft, 1.0, "strain"), (NAMED[2], 300.0, "compaction front")):
        with pytest.raises(po.DomainError, match=words):
            spherical_cavity_draft(CONE, soil, speed)
