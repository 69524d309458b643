"""The medium around a slender cone: the equations of motion, the boundary conditions and the digits of every form."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest
from helpers import oracle
from helpers.field_cases import (
    BODIES,
    EPS,
    MU,
    assert_accurate,
    assert_derivatives,
    cone,
    differentiated,
    ground,
    inputs,
    nodes_of,
    precise,
    precise_cone,
    slow,
    thinned,
)

import plough_opt as po

NAMES = oracle.Cone._fields

# Closed form and, farther off, two dozen quadrature nodes on each straight piece, in units of 2.2e-16 of what rounding
# of the inputs does.
VALUES = 8
DERIVATIVES = 32
# Second derivatives in a speed that is within a few per cent of the shear wave's go as the gap to the power -3/2.
DERIVATIVES_BESIDE_THE_SHEAR_WAVE = 512

POINTS = {
    "beside": (0.22, 0.1),
    "ahead": (-0.1, 0.05),
    "behind": (0.9, 0.3),
    "above a node": (0.5, 0.02),
    "on the face": (0.15, 0.015),
    "far": (30.0, 40.0),
    "where quadrature takes over": (0.2501, 0.3124),
    "far ahead": (-3000.0, 0.01),
    "far wake": (2000.0, 0.06),
    "axis inside": (0.17, 1e-8),
    "axis ahead": (-0.1, 1e-8),
    "axis behind": (1.2, 1e-8),
}
DIFFERENTIATED = [name for name in POINTS if not name.startswith("axis")]
SPEEDS = [1e-12, 1e-9, 1e-6, 1e-3, 0.3, 0.7, 0.9274, 0.99, 0.9999]
RATIOS = [0.0, 0.3, 0.49]

everywhere = pytest.mark.parametrize("point", POINTS.values(), ids=POINTS)
bodies = pytest.mark.parametrize("body", BODIES)


# --- digits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("body", "point", "speed", "nu"), thinned(BODIES, POINTS, SPEEDS, RATIOS, keep=37))
def test_every_component_to_the_digits_that_its_inputs_have(body, point, speed, nu):
    values = inputs(*POINTS[point], body, speed, nu)
    wanted, size = precise(precise_cone, values)
    assert_accurate(cone(*values), wanted[0], size[0], NAMES, VALUES)


CASES = [
    ("wedge", "beside", 0.3, 0.3),
    ("diamond", "behind", 1e-6, 0.3),
    ("wedge", "on the face", 0.7, 0.0),
    ("wedge", "above a node", 0.7, 0.0),
    ("wedge", "where quadrature takes over", 0.02, 0.3),
    ("wedge", "far ahead", 1e-12, 0.49),
]
MORE_CASES = [case for case in itertools.product(BODIES, DIFFERENTIATED, SPEEDS, RATIOS) if case not in CASES][::7]


def check_gradient_and_hessian(symbol, body, point, speed, nu, modulus=False):
    values = inputs(*POINTS[point], body, speed, nu)
    # Place, Poisson's ratio, speed, the first radius after the tip and, last, the modulus.
    chosen = (0, 1, 3, 5, len(values) - len(BODIES[body][0]), *([2] if modulus else []))
    wanted, size = precise(precise_cone, values, chosen)
    multiple = DERIVATIVES if speed < 0.95 else DERIVATIVES_BESIDE_THE_SHEAR_WAVE
    assert_derivatives(differentiated(cone, symbol, len(values), chosen)(values), wanted, size, NAMES, multiple)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_gradient_and_hessian(case):
    check_gradient_and_hessian(ca.SX, *case)


@pytest.mark.slow
@pytest.mark.parametrize("case", [*CASES, *MORE_CASES], ids=str)
def test_gradient_and_hessian_in_the_modulus_too(case):
    check_gradient_and_hessian(ca.SX, *case, modulus=True)


@pytest.mark.parametrize("case", slow(CASES), ids=str)
def test_gradient_and_hessian_of_matrix_expressions(case):
    check_gradient_and_hessian(ca.MX, *case)


@pytest.mark.parametrize("body", ["diamond", *slow(["wedge", "ogive", "tapered"])])
def test_second_derivatives_above_every_node(body):
    """The field is analytic there, though its parts, the displaced section and the rest, are not."""
    for node in (0.0, *BODIES[body][0]):
        values = inputs(node, 0.07, body, 0.7)
        wanted, size = precise(precise_cone, values, (0, 1))
        found = differentiated(cone, ca.SX, len(values), (0, 1))(values)
        assert_derivatives(found, wanted, size, NAMES, DERIVATIVES)


@bodies
@pytest.mark.parametrize("speed", [0.0, *slow([1e-9])])
def test_at_rest_the_field_is_the_limit_of_slow_motion(body, speed):
    for point in POINTS.values():
        slowest, size = precise(precise_cone, inputs(*point, body, 1e-15))
        assert_accurate(cone(*inputs(*point, body, speed)), slowest[0], size[0], NAMES, VALUES)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_at_rest_derivatives_are_finite_and_even_in_speed(symbol):
    slowest, rest = inputs(0.2, 0.1, "wedge", 1e-15), inputs(0.2, 0.1, "wedge", 0.0)
    chosen = (0, 5)
    wanted, size = precise(precise_cone, slowest, chosen)
    found = differentiated(cone, symbol, len(rest), chosen)(rest)
    for gradient, hessian in zip(*found[1:], strict=True):
        assert gradient[1] == 0.0
        assert hessian[0, 1] == hessian[1, 0] == 0.0
    # Value, d/dx, d2/dx2 and d2/dV0^2: what is even in speed.
    assert_derivatives(found, wanted, size, NAMES, DERIVATIVES, [0, 1, 3, 6])


# --- equations -------------------------------------------------------------------------------------------------------


def grid():
    """Return points beside, ahead and behind, as rows that a function of symbols takes one by one."""
    x, r = np.meshgrid(np.linspace(-0.6, 1.1, 9), np.geomspace(1e-2, 2.0, 7))
    return x.reshape(1, -1), r.reshape(1, -1)


@pytest.mark.parametrize("body", ["wedge", "tapered", *slow(["diamond", "ogive"])])
def test_equations_of_motion_and_hookes_law(body):
    x, r, speed, nu = symbols = ca.vertsplit(ca.SX.sym("v", 4))
    values = inputs(x, r, body, speed, nu)
    field, inertia = cone(*values), values[4] * values[5] ** 2
    lam = 2.0 * MU * nu / (1.0 - 2.0 * nu)

    def d(f, *along):
        for s in along:
            f = ca.jacobian(f, s)
        return f

    ux_x, ur_r, hoop = d(field.axial, x), d(field.radial, r), field.radial / r
    stiff = lam + 2.0 * MU
    of_motion = [
        (d(field.xx, x), d(field.rx, r), field.rx / r, -inertia * d(field.axial, x, x)),
        (d(field.rx, x), d(field.rr, r), (field.rr - field.tt) / r, -inertia * d(field.radial, x, x)),
    ]
    of_stress = [
        (field.xx, -stiff * ux_x, -lam * ur_r, -lam * hoop),
        (field.rr, -stiff * ur_r, -lam * ux_x, -lam * hoop),
        (field.tt, -stiff * hoop, -lam * ux_x, -lam * ur_r),
        (field.rx, -MU * d(field.axial, r), -MU * d(field.radial, x)),
    ]
    # On lines of symmetry all terms of a balance vanish; the share of each node alone in strains and slopes does not.
    strain = bend = 0
    for (a, left), (b, right) in itertools.pairwise(nodes_of(values)):
        g = abs(right - left) / (b - a)
        for radius, distance in ((left, ca.hypot(x - a, r)), (right, ca.hypot(x - b, r))):
            strain += g * radius / distance
            bend += g * radius / distance**2 + g**2 / distance
    groups = [(of_stress, stiff * strain), (of_motion, MU * bend)]
    residual = [sum(terms) for balances, _ in groups for terms in balances]
    size = [sum(map(ca.fabs, terms)) + share for balances, share in groups for terms in balances]
    evaluate = ca.Function("balances", symbols, [ca.vertcat(*residual), ca.vertcat(*size)])
    for speed_ratio, poisson_ratio in itertools.product([0.0, 1e-6, 0.3, 0.9274, 0.999], RATIOS):
        residual, size = map(np.asarray, evaluate(*grid(), speed_ratio, poisson_ratio))
        assert np.max(np.abs(residual) / size) <= BALANCE, (speed_ratio, poisson_ratio)


# A few dozen roundings in a derivative.
BALANCE = 64 * EPS


@bodies
@pytest.mark.parametrize("speed", [0.0, 0.3, 0.99])
def test_on_the_axis_the_soil_is_moved_aside_by_the_section(body, speed):
    """As r -> 0, r u_r -> S(x) = R^2/2, the error being of order r^2 ln r; the shear stress vanishes with r."""
    x, r = np.array([-0.3, 0.07, 0.15, 0.22, 0.35, 0.47, 0.6, 0.9]), 1e-9
    positions, radii = [0.0, *BODIES[body][0]], [0.0, *BODIES[body][1]]
    found = cone(*inputs(x, np.full_like(x, r), body, speed))
    section = np.interp(x, positions, radii) ** 2 / 2.0
    np.testing.assert_allclose(r * found.radial, section, rtol=4 * EPS, atol=r**2)
    nearby = cone(*inputs(x, np.full_like(x, 1e3 * r), body, speed))
    np.testing.assert_allclose(1e3 * found.rx, nearby.rx, rtol=1e-4, atol=0.0)


@bodies
def test_far_ahead_nothing_moves(body):
    """The print's (4) leaves -S(inf)/(2r) there."""
    length, radii = BODIES[body][0][-1], BODIES[body][1]
    for distance in (1e2, 1e4, 1e6):
        found = cone(*inputs(-distance * length, 0.01, body, 0.3))
        away = distance * length
        assert abs(found.axial) < 2.0 * max(radii) ** 2 / away
        assert abs(found.radial) < 2.0 * max(radii) ** 2 * 0.01 / away**2
        assert max(map(abs, found[2:])) < 4.0 * MU * max(radii) ** 2 / away**2


# --- invariances -----------------------------------------------------------------------------------------------------


@everywhere
def test_section_factor_is_a_factor(point):
    soil, speed = ground(0.6)
    nodes = nodes_of(inputs(0, 0, "ogive"))
    for quantity in (po.elastic.cone_displacement, po.elastic.cone_stress):
        by_volume, by_energy = (vars(quantity(*point, nodes, soil, speed, factor)) for factor in (0.5, 1.0))
        assert by_energy == {name: 2.0 * value for name, value in by_volume.items()}
        assert vars(quantity(*point, nodes, soil, speed)) == by_volume


# --- numbers, arrays and symbols -------------------------------------------------------------------------------------


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", ["beside", *slow(["axis inside"])])
def test_numbers_arrays_and_symbols_give_the_same(point, symbol):
    values = inputs(*POINTS[point], "tapered")
    numbers = cone(*values)
    # An array of points, among others that would expose a mix-up.
    x, r = np.array([0.3, values[0], -2.0]), np.array([0.07, values[1], 0.4])
    arrays = cone(x, r, *values[2:])
    v = symbol.sym("v", len(values))
    symbols = ca.Function("f", [v], list(cone(*ca.vertsplit(v))))(values)
    size = precise(precise_cone, values)[1][0]
    for name, number, array, expression, s in zip(NAMES, numbers, arrays, symbols, size, strict=True):
        assert isinstance(number, float)
        assert array.shape == x.shape
        assert number == pytest.approx(array[1], rel=0, abs=VALUES * EPS * float(s)), name
        assert number == pytest.approx(float(expression), rel=0, abs=VALUES * EPS * float(s)), name


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_arrays_of_points_meet_symbols(symbol):
    soil, V0 = ground()
    speed, nodes = symbol.sym("V0"), nodes_of(inputs(0, 0, "wedge"))
    x, r = np.array([0.3, -0.4, 2.0]), np.array([0.07, 0.1, 0.4])
    column = po.elastic.cone_stress(x, r, nodes, soil, speed).rx
    found = np.asarray(ca.Function("rx", [speed], [column])(V0)).ravel()
    np.testing.assert_allclose(found, po.elastic.cone_stress(x, r, nodes, soil, V0).rx, rtol=1e-12)


@pytest.mark.parametrize("share", [po.Wedge(po.deg(25.0), po.deg(15.0), 0.25), po.Cone(po.deg(10.0), 0.3)])
def test_a_share_stands_for_its_nodes(share):
    soil, speed = ground()
    cone = share.equivalent_cone() if isinstance(share, po.Wedge) else share
    nodes = [(0.0, 0.0), (cone.height, cone.height * cone.slope)]
    for quantity in (po.elastic.cone_stress, po.elastic.cone_displacement):
        assert vars(quantity(0.1, 0.2, share, soil, speed)) == vars(quantity(0.1, 0.2, nodes, soil, speed))


# --- refusals --------------------------------------------------------------------------------------------------------

GOOD = [(0.0, 0.0), (0.25, 0.025), (0.5, 0.0)]
REFUSED = {
    "at the shear wave's speed": ({"speed": 100.001}, "speed over shear wave speed = 1.00001"),
    "far too fast": ({"speed": 250.0}, "speed over shear wave speed = 2.5"),
    "backwards": ({"speed": -1.0}, "speed = -1 m/s"),
    "speed not a number": ({"speed": math.nan}, "speed = nan"),
    "on the axis": ({"r": 0.0}, "r = 0 m must be above 0 m"),
    "below the axis": ({"r": -0.1}, "r = -0.1 m must be above 0 m"),
    "array with one point on the axis": ({"x": np.array([0.1, 0.2]), "r": np.array([0.1, 0.0])}, "r = 0 m"),
    "point not a number": ({"x": math.nan}, "x = nan"),
    "point at infinity": ({"r": math.inf}, "r = inf m must be finite"),
    "nodes descending": ({"profile": [(0.0, 0.0), (0.5, 0.05), (0.25, 0.0)]}, "node 3 minus x of node 2"),
    "nodes coincide": ({"profile": [(0.0, 0.0), (0.5, 0.05), (0.5, 0.0)]}, "= 0 m must be above 0 m"),
    "blunt": ({"profile": [(0.0, 0.01), (0.5, 0.05)]}, "first node"),
    "negative radius": ({"profile": [(0.0, 0.0), (0.5, -0.05)]}, "node 2 of the profile = -0.05 m"),
    "single node": ({"profile": [(0.0, 0.0)]}, "two"),
    "node not a number": ({"profile": [(0.0, 0.0), (0.5, math.nan)]}, "= nan m must be finite"),
    "no section": ({"section_factor": 0.0}, "section factor = 0"),
}


@pytest.mark.parametrize("quantity", ["cone_stress", "cone_displacement"])
@pytest.mark.parametrize(("change", "sentence"), REFUSED.values(), ids=REFUSED)
def test_what_the_theory_does_not_cover_is_refused(quantity, change, sentence):
    soil, speed = ground()
    given = {"x": 0.2, "r": 0.1, "profile": GOOD, "soil": soil, "speed": speed, **change}
    with pytest.raises((po.DomainError, po.InputError), match=sentence):
        getattr(po.elastic, quantity)(**given)


@pytest.mark.parametrize("missing", ["youngs_modulus", "poisson_ratio"])
def test_a_soil_without_moduli_is_refused_with_a_remedy(missing):
    known = {"youngs_modulus": 4e7, "poisson_ratio": 0.3}
    known[missing] = None
    soil = po.Soil(1600.0, 0.8, 15e3, 0.5, 0.3, **known)
    with pytest.raises(po.InputError, match=f"set soil.{missing}"):
        po.elastic.cone_stress(0.2, 0.1, GOOD, soil, 1.0)
