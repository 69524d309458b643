"""Action of the soil on the share: pressure on the face, force with friction and loss of contact."""

import itertools
import math
from functools import partial

import casadi as ca
import numpy as np
import pytest
from helpers import field_cases as cases
from helpers import high_precision as hp
from helpers import oracle
from helpers.differences import order_4
from helpers.field_cases import BODIES, EPS, MU, RHO, SHEAR_WAVE, ground, inputs, nodes_of, slow
from helpers.refusals import refusals

import plough_opt as po

mp = hp.mp

SPEEDS = [0.0, 1e-6, 0.3, 0.9274, 0.95, 0.9999]
FRICTION = 0.3


def exact_nodes(body):
    return [(mp.mpf(a), mp.mpf(b)) for a, b in nodes_of(inputs(0, 0, body))]


def exact_medium(speed=0.3, nu=0.3):
    return oracle.Medium(*inputs(0, 0, "wedge", speed, nu)[2:6])


# --- pressure on a wedge ---------------------------------------------------------------------------------------------


FACES = [
    *cases.thinned(["wedge"], BODIES, SPEEDS, [0.0, 0.3, 0.49], keep=5),
    *cases.thinned(["cone"], BODIES, SPEEDS, [0.0, 0.3, 0.49], keep=7),
]


@pytest.mark.parametrize(("kind", "body", "speed", "nu"), FACES)
def test_pressure(kind, body, speed, nu):
    soil, V0 = ground(speed, nu)
    nodes, is_cone = nodes_of(inputs(0, 0, body)), kind == "cone"
    of_face, stress = (getattr(po.elastic, f"{kind}_{what}") for what in ("pressure", "stress"))
    normal, precisely = ("rr", cases.precise_cone) if is_cone else ("yy", cases.precise_wedge)
    k = (oracle.Cone if is_cone else oracle.Wedge)._fields.index(normal)
    for x in (1e-6 if is_cone else 1e-9, 0.03, 0.15, 0.33, 0.4999):
        away = float(oracle.radius(mp.mpf(x), exact_nodes(body))) if is_cone else 0.0
        # At rest the limit of slow motion.
        wanted, size = cases.precise(precisely, inputs(x, away, body, speed or 1e-15, nu))
        # R(x) is computed from differences of the nodes' radii and so rounded.
        rounded = 4 * abs(wanted[0, k]) * max(BODIES[body][1]) / away if is_cone else 0
        pressure = of_face(x, nodes, soil, V0)
        cases.assert_accurate([pressure], [-wanted[0, k]], [size[0, k] + rounded], [f"p({x})"], 16 if is_cone else 4)
        here = getattr(stress(x, away, nodes, soil, V0), normal)
        assert pressure == pytest.approx(-here, rel=1e-12 if is_cone else 4 * EPS)


# --- force on a wedge ------------------------------------------------------------------------------------------------


def thrust(body, speed, nu=0.3):
    """Return the size of a force: what the pressure of all pieces, without signs, does to the whole face [N/m]."""
    nodes = nodes_of(inputs(0, 0, body))
    slopes = [(d - b) / (c - a) for (a, b), (c, d) in itertools.pairwise(nodes)]
    medium = exact_medium(speed, nu)
    K = medium.rayleigh_function / (medium.alpha * medium.m)
    return float(2 * nodes[-1][0] * (max(map(abs, slopes)) + FRICTION) * MU * (1 + abs(K)) * sum(map(abs, slopes)))


def precise_wedge_force(body, speed, ambient_pressure, separation=True):
    """Return the force on a body to some thirty digits."""
    with mp.workdps(40):
        numbers = mp.mpf(FRICTION), mp.mpf(ambient_pressure)
        return oracle.wedge_force(exact_nodes(body), exact_medium(speed), *numbers, separation)


def straight_force(E, nu, speed, length, thickness, tool_friction, ambient_pressure):
    """2 (t + mu0) l A ln(1 + exp(-p_a/A)), A = mu |K| t/pi, per metre of width."""
    medium, t = oracle.Medium(E, nu, RHO, speed), thickness / length
    A = medium.mu * abs(medium.rayleigh_function) / (medium.alpha * medium.m) * t / mp.pi
    return 2 * (t + tool_friction) * length * A * mp.log(1 + mp.exp(-ambient_pressure / A))


PRESSURES = [0.0, 1e5, 4e6]
# Contact is lost and regained on both sides of concave corners.
MANY = ((0.05, 0.1, 0.2, 0.3, 0.42, 0.5), (0.02, 0.021, 0.05, 0.045, 0.07, 0.071))


@pytest.mark.parametrize(
    ("body", "speed", "ambient_pressure"),
    [(MANY, 0.3, 2e5), *cases.thinned(BODIES, [1e-6, 0.3, 0.95], [*PRESSURES, 1e6, 1e7], keep=7)],
)
def test_force_on_any_wedge_against_precise_integration(body, speed, ambient_pressure):
    soil, V0 = ground(speed, ambient_pressure=ambient_pressure)
    nodes = nodes_of(inputs(0, 0, body))
    size = thrust(body, speed)
    for separation in (True, False):
        wanted = precise_wedge_force(body, speed, ambient_pressure, separation)
        force = po.elastic.wedge_force(nodes, soil, V0, separation=separation)
        assert force == pytest.approx(float(wanted), rel=0, abs=4 * EPS * size)


# Positions and half thicknesses of nodes whose pressure has an extremum inside a straight piece, the speed, and an
# ambient pressure that is nearly the negative of that extremum.
SHORT = [
    (((0.11, 0.38, 0.57), (0.024, 0.047, 0.045)), 0.95),
    (((0.2, 0.38), (0.017, 0.056)), 0.1),
    (((0.16, 0.38, 0.62), (0.004, 0.034, 0.043)), 0.1),
]


@pytest.mark.parametrize("body", [SHORT[0], *slow(SHORT[1:])], ids=str)
def test_contact_lost_or_kept_on_a_short_part_of_a_piece(body):
    body, speed = body
    nodes = nodes_of(inputs(0, 0, body))
    soil, V0 = ground(speed)
    turning = []
    for (a, _), (b, _) in itertools.pairwise(nodes):
        pressure = po.elastic.wedge_pressure(np.linspace(a, b, 1001)[1:-1], nodes, soil, V0)
        slopes = np.diff(pressure)
        turning += list(pressure[1:-1][slopes[1:] * slopes[:-1] < 0.0])
    ambient = [-p * part for p in turning for part in (0.7, 0.95, 1.05) if p < 0.0]
    assert ambient
    for ambient_pressure in ambient:
        exact = precise_wedge_force(body, speed, float(ambient_pressure))
        soil, _ = ground(speed, ambient_pressure=float(ambient_pressure))
        force = po.elastic.wedge_force(nodes, soil, V0)
        assert force == pytest.approx(float(exact), rel=0, abs=4 * EPS * thrust(body, speed)), ambient_pressure


# Hundreds of roundings, and fifty times the rounding of the speed: 95 m/s is 2 % above the Rayleigh speed.
FORCES = 1e-12


def force_of_straight(kind, E, nu, speed, length, thickness, tool_friction, ambient_pressure=1e5):
    soil = po.Soil(RHO, 0.8, 0.0, 0.5, tool_friction, ambient_pressure, youngs_modulus=E, poisson_ratio=nu)
    return getattr(po.elastic, f"{kind}_force")([(0.0, 0.0), (length, thickness)], soil, speed)


@pytest.mark.parametrize("speed", [2.0, *slow([30.0, 95.0])])
def test_gradient_and_hessian_of_the_force_on_a_straight_wedge(speed):
    values = np.array([4.16e7, 0.3, speed, 0.5, 0.05, 0.3, 1e5])
    found = hp.differentiated(partial(force_of_straight, "wedge"), ca.MX, len(values))(values)
    # Derivatives times the inputs that they are taken in, relative to the force.
    for got, wanted, units in zip(
        found, hp.derivatives(straight_force, values), (1.0, values, np.outer(values, values)), strict=True
    ):
        scale = FORCES * abs(found[0])
        np.testing.assert_allclose(got * units, np.array(wanted, float) * units, rtol=FORCES, atol=scale)


# --- pressure and force on a cone ------------------------------------------------------------------------------------


BLUNT = ((0.2,), (0.2,))
"""So steep that the soil would be in tension at the tip."""
MORE_CONES = [
    (((0.2, 0.5), (0.15, 0.02)), 0.1, 8e6),
    ("wedge", 0.3, 1e4),
    ("diamond", 0.95, 1e6),
    ("ogive", 0.3, 1e5),
    ("tapered", 0.95, 1e7),
]


@pytest.mark.parametrize("case", [(BLUNT, 0.1, 1e6), *slow(MORE_CONES)], ids=str)
def test_force_on_a_cone_against_precise_quadrature(case):
    body, speed, ambient_pressure = case
    soil, V0 = ground(speed, ambient_pressure=ambient_pressure)
    nodes = nodes_of(inputs(0, 0, body))
    with mp.workdps(20):
        at = (exact_nodes(body), exact_medium(speed), mp.mpf(FRICTION), mp.mpf(ambient_pressure))
        wanted = oracle.cone_force(*at)
        assert po.elastic.cone_force(nodes, soil, V0) == pytest.approx(float(wanted), rel=2e-14)
        clinging = po.elastic.cone_force(nodes, soil, V0, separation=False)
        assert clinging == pytest.approx(float(oracle.cone_force(*at, False)), rel=2e-14)


@pytest.mark.parametrize("speed", [95.0, *slow([2.0])])
def test_gradient_of_the_force_on_a_cone(speed):
    values = [4.16e7, 0.3, speed, 0.5, 0.05, 0.3]
    v, force_of_cone = ca.MX.sym("v", len(values)), partial(force_of_straight, "cone")
    force = force_of_cone(*ca.vertsplit(v))
    value, gradient = ca.Function("force", [v], [force, ca.gradient(force, v)])(values)
    assert float(value) == pytest.approx(force_of_cone(*values), rel=1e-14)
    for i in (2, 4):
        # With a step of 1e-3 truncation is 1e-12 of the terms, and rounding 1e-13 over the step.
        wanted = order_4(lambda x, i=i: force_of_cone(*values[:i], x, *values[i + 1 :]), values[i], 1e-3 * values[i])
        scale = float(value) / values[i]
        assert float(gradient[i]) == pytest.approx(wanted, rel=1e-9, abs=1e-9 * scale)


# --- refusals ------------------------------------------------------------------------------


GOOD = [(0.0, 0.0), (0.25, 0.025), (0.5, 0.0)]


FAST, BARE = (ground()[0], 1.01 * SHEAR_WAVE), po.Soil(1600.0, 0.8, 0.0, 0.5, 0.3)
test_points_off_the_face_and_impossible_motions_are_refused = refusals(
    (po.DomainError, po.InputError),
    (lambda: po.elastic.wedge_force(GOOD, *FAST), r"speed over shear wave speed = 1\.01"),
    (lambda: po.elastic.cone_force(GOOD, *FAST), r"speed over shear wave speed = 1\.01"),
    (lambda: po.elastic.wedge_force(GOOD, BARE, 1.0), "youngs_modulus"),
    (lambda: po.elastic.cone_force(GOOD, BARE, 1.0), "youngs_modulus"),
    (lambda: po.elastic.wedge_pressure(-0.1, GOOD, *ground()), "the face begins there"),
    (lambda: po.elastic.wedge_pressure(0.6, GOOD, *ground()), "the face ends there"),
    (lambda: po.elastic.wedge_pressure(0.25, GOOD, *ground()), "node 2 of the profile"),
    (lambda: po.elastic.wedge_pressure(math.nan, GOOD, *ground()), "x = nan m must be finite"),
    (lambda: po.elastic.cone_pressure(0.0, GOOD, *ground()), "the face begins there"),
    (lambda: po.elastic.cone_pressure(0.6, GOOD, *ground()), "the face ends there"),
    (lambda: po.elastic.cone_pressure(0.5, GOOD, *ground()), "radius of the cone at x = 0 m must be above 0 m"),
    (lambda: po.elastic.cone_pressure(math.nan, GOOD, *ground()), "x = nan m must be finite"),
)
