"""The medium around a thin wedge and a slender cone: values, derivatives, boundaries, forces, Fourier integrals."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
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
from plough_opt.soil.elastic import fourier

mp = hp.mp


@dataclass(frozen=True)
class Field:
    """Results of the toolkit around a kind of body, their precise counterparts, and the points of comparison.

    Values and derivatives are compared in units of 2.2e-16 of the effect of rounded inputs: for a wedge some thirty
    operations on each straight piece, for a cone two dozen quadrature nodes at distant points.
    """

    evaluate: Callable
    precise: Callable
    names: tuple
    values: int
    derivatives: int
    points: dict
    quantities: tuple


COMMON_POINTS = {
    "beside": (0.22, 0.1), "ahead": (-0.1, 0.05), "behind": (0.9, 0.3), "above a node": (0.5, 0.02),
    "far": (30.0, 40.0), "far ahead": (-3000.0, 0.01),
}  # fmt: skip
POINTS_OF_WEDGE = {
    "beside a node": (0.5 + 1e-7, 1e-7), "near the tip": (1e-6, 1e-6), "near the face": (0.15, 1e-9),
    "where quadrature takes over": (0.2501, 0.3501),
}  # fmt: skip
POINTS_OF_CONE = {
    "near the face": (0.15, 0.015), "far wake": (2000.0, 0.06), "where quadrature takes over": (0.2501, 0.3124),
    "axis inside": (0.17, 1e-8), "axis ahead": (-0.1, 1e-8), "axis behind": (1.2, 1e-8),
}  # fmt: skip
FIELDS = {
    "wedge": Field(
        cases.wedge, cases.precise_wedge, oracle.Wedge._fields, 4, 64, COMMON_POINTS | POINTS_OF_WEDGE,
        ("wedge_stress", "wedge_gradient", "wedge_displacement"),
    ),
    "cone": Field(
        cases.cone, cases.precise_cone, oracle.Cone._fields, 8, 32, COMMON_POINTS | POINTS_OF_CONE,
        ("cone_stress", "cone_displacement"),
    ),
}  # fmt: skip
# Relative to the shear wave speed; 0.9274 is the Rayleigh speed for a Poisson's ratio of 0.3.
SPEEDS = [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.3, 0.7, 0.9274, 0.99, 0.9999]
RATIOS = [0.0, 0.3, 0.49]
# Near the shear wave speed second derivatives around a cone grow like the distance from it to the power -3/2.
BESIDE_THE_SHEAR_WAVE = 512

fields = pytest.mark.parametrize("kind", FIELDS)
bodies = pytest.mark.parametrize("body", BODIES)


# --- digits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "body", "point", "speed", "nu"),
    [case for kind in FIELDS for case in itertools.product([kind], BODIES, FIELDS[kind].points, SPEEDS, RATIOS)],
)
def test_every_component_is_as_accurate_as_its_inputs(kind, body, point, speed, nu):
    field = FIELDS[kind]
    # At rest the field is the limit of slow motion.
    wanted, size = cases.precise(field.precise, inputs(*field.points[point], body, speed or 1e-15, nu))
    found = field.evaluate(*inputs(*field.points[point], body, speed, nu))
    cases.assert_accurate(found, wanted[0], size[0], field.names, field.values)


CASES = [
    *((kind, "wedge", "beside", 0.3, 0.3) for kind in FIELDS),
    *((kind, "diamond", "behind", 1e-6, 0.3) for kind in FIELDS),
    *((kind, "wedge", "near the face", 0.7, 0.0) for kind in FIELDS),
    *((kind, "wedge", "far ahead", 1e-12, 0.49) for kind in FIELDS),
    ("wedge", "wedge", "far", 0.3, 0.3),
    ("wedge", "wedge", "beside a node", 0.99, 0.3),
    ("cone", "wedge", "above a node", 0.7, 0.0),
    ("cone", "wedge", "where quadrature takes over", 0.02, 0.3),
]


@pytest.mark.parametrize(
    ("symbol", "case"), [*((ca.SX, case) for case in CASES), (ca.MX, CASES[0]), *slow(CASES[1:], ca.MX)], ids=str
)
def test_gradient_and_hessian(symbol, case):
    kind, body, point, speed, nu = case
    field = FIELDS[kind]
    values = inputs(*field.points[point], body, speed, nu)
    # Position, Poisson's ratio, speed, the first half thickness or radius behind the tip, and the modulus.
    chosen = (0, 1, 3, 5, len(values) - len(BODIES[body][0]), 2)
    wanted, size = cases.precise(field.precise, values, chosen)
    multiple = BESIDE_THE_SHEAR_WAVE if kind == "cone" and speed > 0.95 else field.derivatives
    found = cases.differentiated(field.evaluate, symbol, len(values), chosen)(values)
    cases.assert_derivatives(found, wanted, size, field.names, multiple)


@fields
@pytest.mark.parametrize("symbol", [ca.SX, *slow([ca.MX])])
def test_at_rest_derivatives_are_finite_and_even_in_speed(kind, symbol):
    field = FIELDS[kind]
    slowest, rest = inputs(0.2, 0.1, "wedge", 1e-15), inputs(0.2, 0.1, "wedge", 0.0)
    chosen = (0, 5)
    wanted, size = cases.precise(field.precise, slowest, chosen)
    found = cases.differentiated(field.evaluate, symbol, len(rest), chosen)(rest)
    for gradient, hessian in zip(*found[1:], strict=True):
        assert gradient[1] == hessian[0, 1] == hessian[1, 0] == 0.0
    # Value, d/dx, d2/dx2 and d2/dV0^2, which are even in the speed.
    cases.assert_derivatives(found, wanted, size, field.names, field.derivatives, [0, 1, 3, 6])


# --- invariances and special speeds ----------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.0, 0.25, 0.3, 0.49])
def test_rayleigh_speed_solves_its_equation(nu):
    soil, _ = ground(nu=nu)
    modulus = mp.mpf(soil.youngs_modulus)
    exact = mp.findroot(
        lambda speed: oracle.Medium(modulus, nu, RHO, speed).rayleigh_function, (90, 94 if nu < 0.4 else 96)
    )
    assert po.elastic.rayleigh_speed(soil) == pytest.approx(float(exact), rel=4 * EPS)
    assert po.elastic.shear_wave_speed(soil) == pytest.approx(SHEAR_WAVE, rel=4 * EPS)
    if nu == 0.25:
        # Poisson solid: 0.9194017 c2, e.g. Achenbach, Wave Propagation in Elastic Solids, 1973, section 5.11.
        assert po.elastic.rayleigh_speed(soil) / SHEAR_WAVE == pytest.approx(0.9194017, abs=5e-8)


def test_at_the_shear_wave_speed_the_field_of_a_wedge_is_the_limit_from_below():
    """There eta = 0; near it eta is the square root of the relative distance in speed, 1.4e-6 at 1e-12."""
    (soil, _), nodes = ground(), nodes_of(inputs(0, 0, "diamond"))
    speed = po.elastic.shear_wave_speed(soil)
    for name in ("beside", "ahead", "behind"):
        point = FIELDS["wedge"].points[name]
        at, below = (vars(po.elastic.wedge_stress(*point, nodes, soil, V0)) for V0 in (speed, speed * (1.0 - 1e-12)))
        assert at == pytest.approx(below, rel=0, abs=1e-4 * max(map(abs, below.values())))


# --- numbers, arrays and symbols -------------------------------------------------------------------------------------


@fields
@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_arrays_of_points_are_computed_element_by_element_and_with_symbols(kind, symbol):
    field, x, y = FIELDS[kind], np.array([0.3, -0.4, 2.0]), np.array([0.07, 0.1, 0.4])
    speed, values = symbol.sym("V0"), inputs(x, y, "tapered")
    symbols = ca.Function("f", [speed], list(field.evaluate(*values[:5], speed, *values[6:])))(values[5])
    arrays, plane = field.evaluate(*values), field.evaluate(x[:, None], y[:, None], *values[2:])
    singles = [field.evaluate(*point, *values[2:]) for point in zip(x.tolist(), y.tolist(), strict=True)]
    for name, array, expression in zip(field.names, arrays, symbols, strict=True):
        one_by_one = [getattr(single, name) for single in singles]
        assert all(isinstance(value, float) for value in one_by_one)
        np.testing.assert_allclose(array, one_by_one, rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(expression.full().ravel(), one_by_one, rtol=1e-12, err_msg=name)
        np.testing.assert_array_equal(getattr(plane, name), array[:, None], err_msg=name)


@pytest.mark.parametrize("share", [po.Wedge(po.deg(25.0), po.deg(15.0), 0.25), po.Cone(po.deg(10.0), 0.3)])
def test_a_share_is_equivalent_to_its_nodes(share):
    soil, speed = ground(ambient_pressure=1e5)
    body = share.equivalent_cone() if isinstance(share, po.Wedge) else share
    nodes = [(0.0, 0.0), (body.height, body.height * body.slope)]
    for quantity in itertools.chain(*(field.quantities for field in FIELDS.values())):
        of = getattr(po.elastic, quantity)
        assert repr(of(0.1, 0.2, share, soil, speed)) == repr(of(0.1, 0.2, nodes, soil, speed))
    for kind in FIELDS:
        force, pressure = (getattr(po.elastic, f"{kind}_{of}") for of in ("force", "pressure"))
        assert force(share, soil, speed) == force(nodes, soil, speed)
        assert pressure(0.1, share, soil, speed) == pressure(0.1, nodes, soil, speed)


# --- refusals --------------------------------------------------------------------------------------------------------

GOOD = [(0.0, 0.0), (0.25, 0.025), (0.5, 0.0)]
BARE = po.Soil(1600.0, 0.8, 15e3, 0.5, 0.3, poisson_ratio=0.3)
REFUSED = {
    "supersonic": ({"speed": 100.001}, r"speed over shear wave speed = 1\.00001"),
    "point not a number": ({"x": math.nan}, "x = nan"),
    "nodes descending": ({"profile": [(0.0, 0.0), (0.5, 0.05), (0.25, 0.0)]}, "node 3 minus x of node 2.*backwards"),
    "first node thick": ({"profile": [(0.0, 0.01), (0.5, 0.05)]}, "first node"),
    "no Young's modulus": ({"soil": BARE}, "set soil.youngs_modulus"),
    "negative height": ({"profile": [(0.0, 0.0), (0.5, -0.05)]}, "node 2 of the profile = -0.05 m"),
}
OF_WEDGES = {
    "on the tip": ({"x": 0.0, "away": 0.0}, "node"),
    "array with one point on a node": ({"x": np.array([0.1, 0.25]), "away": np.array([0.0, 0.0])}, "node"),
}
OF_CONES = {
    "on the axis": ({"away": 0.0}, "r = 0 m must be above 0 m"),
    "no section": ({"section_factor": 0.0}, "section factor = 0"),
}


def refused():
    for kind, own in (("wedge", OF_WEDGES), ("cone", OF_CONES)):
        for name, (change, sentence) in (REFUSED | own).items():
            yield pytest.param(kind, change, sentence, id=f"{kind} {name}")


@pytest.mark.parametrize(("kind", "change", "sentence"), [*refused()])
def test_arguments_outside_the_theory_are_refused(kind, change, sentence):
    soil, speed = ground()
    for quantity in FIELDS[kind].quantities:
        given = {"x": 0.2, "away": 0.1, "profile": GOOD, "soil": soil, "speed": speed, **change}
        given["y" if kind == "wedge" else "r"] = given.pop("away")
        if quantity == "wedge_displacement" and sentence == "node":
            # The displacement is finite there, with a kink.
            assert np.all(np.isfinite(po.elastic.wedge_displacement(**given)))
            continue
        with pytest.raises((po.DomainError, po.InputError), match=sentence):
            getattr(po.elastic, quantity)(**given)


# --- action of the soil on the share: pressure on the face, force with friction and loss of contact ---

CONTACT_SPEEDS = [0.0, 1e-6, 0.3, 0.9274, 0.95, 0.9999]
FRICTION = 0.3


def exact_nodes(body):
    return [(mp.mpf(a), mp.mpf(b)) for a, b in nodes_of(inputs(0, 0, body))]


def exact_medium(speed=0.3, nu=0.3):
    return oracle.Medium(*inputs(0, 0, "wedge", speed, nu)[2:6])


# --- pressure on a wedge ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
@pytest.mark.parametrize("speed", CONTACT_SPEEDS)
@bodies
@fields
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


# Contact is lost and regained on both sides of concave corners.
MANY = ((0.05, 0.1, 0.2, 0.3, 0.42, 0.5), (0.02, 0.021, 0.05, 0.045, 0.07, 0.071))


@pytest.mark.parametrize(
    ("body", "speed", "ambient_pressure"),
    [(MANY, 0.3, 2e5), *itertools.product(BODIES, [1e-6, 0.3, 0.95], [0.0, 1e5, 4e6, 1e6, 1e7])],
)
def test_force_on_any_wedge_against_precise_integration(body, speed, ambient_pressure):
    soil, V0 = ground(speed, ambient_pressure=ambient_pressure)
    nodes = nodes_of(inputs(0, 0, body))
    size = thrust(body, speed)
    for separation in (True, False):
        wanted = precise_wedge_force(body, speed, ambient_pressure, separation)
        force = po.elastic.wedge_force(nodes, soil, V0, separation=separation)
        assert force == pytest.approx(float(wanted), rel=0, abs=4 * EPS * size)


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


FAST = ground()[0], 1.01 * SHEAR_WAVE
test_points_off_the_face_and_impossible_motions_are_refused = refusals(
    (po.DomainError, po.InputError),
    (lambda: po.elastic.wedge_force(GOOD, *FAST), r"speed over shear wave speed = 1\.01"),
    (lambda: po.elastic.cone_force(GOOD, BARE, 1.0), "youngs_modulus"),
    (lambda: po.elastic.wedge_pressure(-0.1, GOOD, *ground()), "the face begins there"),
    (lambda: po.elastic.wedge_pressure(0.25, GOOD, *ground()), "node 2 of the profile"),
    (lambda: po.elastic.cone_pressure(0.5, GOOD, *ground()), "radius of the cone at x = 0 m must be above 0 m"),
)


# --- the source's Fourier integrals against the closed forms, and knots on smooth profiles against both ---

LENGTH, HALF_THICKNESS = 0.5, 0.05
PROFILES = {
    "straight": lambda x: 0.1 * x,
    "parabolic arc": lambda x: 4.0 * HALF_THICKNESS * x * (LENGTH - x) / LENGTH**2,
    "shoulder": lambda x: HALF_THICKNESS * math.sin(math.pi * x / (2.0 * LENGTH)) ** 2,
}
POINTS = np.array([[0.2, 0.1], [-0.3, 0.2], [0.9, 0.3], [0.5, 0.05]])

INTEGRALS = ("wedge_stress", "cone_displacement", "cone_stress")


def as_columns(found):
    return np.column_stack(list(vars(found).values()))


def relative(found, wanted):
    """Return the largest difference of each point's components, relative to the largest of them."""
    return np.max(np.abs(found - wanted) / np.max(np.abs(wanted), axis=1, keepdims=True))


@pytest.mark.parametrize("speed", [0.7, 1e-6, *slow([0.0, 0.3, 0.95])])
@pytest.mark.parametrize("field", INTEGRALS)
def test_straight_profiles_agree_with_the_closed_form(field, speed):
    soil, V0 = ground(speed)
    factor = {} if field == "wedge_stress" else {"section_factor": 0.8}
    by_waves = getattr(fourier, field)(*POINTS.T, PROFILES["straight"], LENGTH, soil, V0, **factor)
    closed = getattr(po.elastic, field)(*POINTS.T, [(0.0, 0.0), (LENGTH, 0.1 * LENGTH)], soil, V0, **factor)
    assert relative(as_columns(by_waves), as_columns(closed)) < 2e-14


@pytest.mark.parametrize("profile", ["parabolic arc", *slow(["shoulder"])])
@pytest.mark.parametrize("field", INTEGRALS)
def test_knots_converge_with_the_square_of_their_number(field, profile):
    soil, V0 = ground(0.3)
    x, y = POINTS[:3].T
    smooth = as_columns(getattr(fourier, field)(x, y, PROFILES[profile], LENGTH, soil, V0))
    errors = []
    for count in (16, 32, 64):
        nodes = po.elastic.knots(PROFILES[profile], LENGTH, count)
        errors.append(relative(as_columns(getattr(po.elastic, field)(x, y, nodes, soil, V0)), smooth))
        pieces = np.diff([place for place, _ in nodes])
        assert pieces[0] == pytest.approx(pieces[-1], rel=1e-12)
        assert max(pieces) > 10.0 * pieces[0]  # closer together towards both ends
    rates = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert rates == pytest.approx([2.0, 2.0], abs=0.02)
    assert errors[-1] < 2e-3


def waved(x=0.2, y=0.1, profile=PROFILES["straight"], length=LENGTH, order=12):
    return [getattr(fourier, field)(x, y, profile, length, *ground(), order) for field in INTEGRALS]


test_integrals_and_knots_refuse_what_they_cannot_handle = refusals(
    (po.DomainError, po.InputError),
    (lambda: waved(y=0.0), "distance from the axis = 0 m must be above 0 m"),
    (lambda: waved(y=1e-7), "the closed forms have no such limit"),
    (lambda: waved(profile=lambda x: math.nan * x), "profile = nan"),
    (lambda: waved(x=ca.SX.sym("x")), "closed forms"),
    (lambda: po.elastic.knots(lambda x: -x, 0.5, 4), "half thickness or radius at x"),
)
