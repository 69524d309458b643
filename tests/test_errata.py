"""Errata of the source: the printed form fails where the derived form holds."""

import math

import casadi as ca
import numpy as np
import pytest
import test_source_equations as source
from helpers.printed_equations import printed_coefficients, printed_resistance
from test_source_equations import CAVITY, CONE, FRONT, MU, NU, PA, RHO0, SHARE, SOIL, SPEED, TAU0, A

import plough_opt as po
from plough_opt.soil import elastic, plastic

AWAY, LENGTH, SLOPE = source.AWAY, source.LENGTH, source.SLOPE


def imbalance_across(factor):
    """Return the residual of d sigma_xy/dx + d sigma_yy/dy = rho V0^2 uy_xx over its largest term.

    The shear stress sigma_xy is multiplied by a factor.
    """
    at = ca.SX.sym("at", 2)
    found = elastic.wedge_stress(at[0], at[1], source.PROFILE, SOIL, SPEED)
    slope = elastic.wedge_gradient(at[0], at[1], source.PROFILE, SOIL, SPEED).uy_x
    shear_x, stress_y = ca.jacobian(factor * found.xy, at)[0], ca.jacobian(found.yy, at)[1]
    inertia = RHO0 * SPEED**2 * ca.jacobian(slope, at)[0]
    terms = ca.Function("f", [at], [ca.vertcat(shear_x, stress_y, -inertia)])([0.0, AWAY]).full()
    return abs(np.sum(terms)) / np.max(np.abs(terms))


def test_2_lacks_a_factor_2():
    assert imbalance_across(1.0) < 1e-13
    assert imbalance_across(0.5) > 0.4


def test_3_and_4_are_the_axial_and_the_radial_displacement():
    # With the names exchanged the body would pull the soil inwards, because the first is not S/r near the axis.
    near = 1e-5
    found = elastic.cone_displacement(source.X, near, source.PROFILE, SOIL, SPEED)
    section = 0.5 * (SLOPE * source.X) ** 2
    assert near * found.radial == pytest.approx(section, rel=1e-6)
    assert near * found.axial < 0.01 * section


def test_4_lacks_what_keeps_the_soil_far_ahead_at_rest():
    ahead = elastic.cone_displacement(-1e4 * LENGTH, AWAY, source.PROFILE, SOIL, SPEED).radial
    missing = 0.5 * (SLOPE * LENGTH) ** 2 / (2.0 * AWAY)
    assert abs(ahead) < 1e-8 * missing  # and the printed integral is ahead - missing, which is not small


def test_text_before_6_has_the_wrong_angle():
    assert CONE.area == pytest.approx(SHARE.area, rel=1e-14)
    assert po.Cone(po.deg(15), 0.25).area > 1.3 * CONE.area


def test_10_as_printed_lets_cohesion_lower_the_pressure():
    def pressure(sign):
        phi = (A ** (NU / 2.0) - 1.0) / NU
        return phi * (NU * PA + sign * TAU0 / (1.0 + MU))

    rest = plastic.Cavity(0.05, 0.0, 0.0)
    assert pressure(1.0) == pytest.approx(plastic.surface_pressure(rest, SOIL), rel=1e-13)
    assert pressure(-1.0) < 0.0 < plastic.surface_pressure(rest, SOIL)


def test_14_with_13_as_printed_contradict_each_other_by_twice_tau0():
    """Equation (13) is correct as printed; (14) as printed is then wrong by 2 tau0/(1 + mu) (r*^nu - y^nu)/nu."""
    r = 0.6 * FRONT
    y, sigma = source.y(r), source.sigma
    cohesive = TAU0 / (1 + MU) * (FRONT**NU - y**NU) / NU
    left = y**NU * sigma(r) - FRONT**NU * sigma(FRONT)
    assert -source.work(r, FRONT) + cohesive - left == pytest.approx(2.0 * cohesive, rel=1e-10)


def test_22_to_the_letter_is_far_off():
    """The errors: the sign, R for R^2 in the powers, h for r* as upper limit, and the tau0 term without 1/nu."""
    r = 0.5 * FRONT
    y, sigma = source.y(r), source.sigma(r)
    printed = source.pressure_22(r, CONE.height, CAVITY.radius, TAU0 / (1.0 + MU) * (FRONT**NU - y**NU)) / y**NU
    assert printed > 0.0 > sigma  # the print would have the soil pull
    assert abs(printed + sigma) > 0.04 * abs(sigma)  # and of another size


def test_24_needs_the_ambient_pressure():
    # The net force on a share at rest in soil without strength is zero, because face and back are under equal pressure.
    weak = po.Soil(1350.0, 0.6, 0.0, 0.0, 0.5, PA)
    assert po.resistance(CONE, weak, 0.0, 0.0) == pytest.approx(0.0, abs=1e-12 * PA * CONE.height**2)


def test_25_and_26_count_pi_twice():
    ratio = printed_resistance(CONE, SOIL, 2.0, 0.0) / po.resistance(CONE, SOIL, 2.0, 0.0)
    assert ratio == pytest.approx(math.pi, rel=1e-12)


def test_26_has_a_third_for_two_thirds():
    printed, derived = printed_coefficients(CONE, SOIL), po.resistance_coefficients(CONE, SOIL)
    assert printed[2] / (math.pi * derived.C) == pytest.approx(0.5, rel=1e-12)
    # The inertial part of (24) is an integral of x^2, h^3/3; the factored h^2/2 leaves 2 h/3.
    assert source.integral(lambda x: x**2, 0.0, 1.0) / (1.0 / 2.0) == pytest.approx(2.0 / 3.0, rel=1e-14)


def motion(formulation, duration):
    effects = po.Effects(start="rest", inertial_drag=False, formulation=formulation)
    scene = po.Scene(SOIL, SHARE, 5e4, 20.0, 2.0, effects)
    return scene, po.simulate(scene, duration)


def test_27_with_its_printed_spring_runs_away():
    scene, printed = motion(po.Printed(pi_twice=False, one_third=False), 0.3)
    _, derived = motion("derived", 0.3)
    omega = scene.natural_frequency
    # The solution of z'' = F0/M + omega^2 z grows without bound, like cosh and sinh of omega t.
    rest = scene.reaction.static / 5e4
    grown = rest * (math.cosh(omega * 0.3) - 1.0) + 2.0 / omega * math.sinh(omega * 0.3)
    assert printed.deflection[-1] == pytest.approx(grown, rel=1e-7)
    assert np.max(np.abs(derived.deflection)) <= rest + math.hypot(rest, 2.0 / omega)
    assert grown > 10.0 * np.max(np.abs(derived.deflection))
