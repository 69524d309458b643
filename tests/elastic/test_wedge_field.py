"""The medium around a thin wedge: the equations of motion, the boundary conditions and the digits of every form."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers import oracle
from helpers.field_cases import (
    BODIES,
    EPS,
    MU,
    RHO,
    SHEAR_WAVE,
    assert_accurate,
    assert_derivatives,
    differentiated,
    ground,
    inputs,
    nodes_of,
    precise,
    precise_wedge,
    slow,
    thinned,
    wedge,
)

import plough_opt as po

mp = hp.mp
NAMES = oracle.Wedge._fields

# Some thirty operations on each straight piece, in units of 2.2e-16 of what rounding of the inputs does.
VALUES = 4
DERIVATIVES = 64

POINTS = {
    "beside": (0.2, 0.1),
    "ahead": (-0.1, 0.05),
    "behind": (0.9, 0.3),
    "beside a node": (0.5 + 1e-7, 1e-7),
    "near the tip": (1e-6, 1e-6),
    "near the face": (0.15, 1e-9),
    "above a node": (0.5, 0.02),
    "far": (30.0, 40.0),
    "far ahead": (-3000.0, 0.01),
    "where quadrature takes over": (0.2501, 0.3501),
}
# In units of the shear wave's; 0.9274 is the Rayleigh wave's for a Poisson's ratio of 0.3.
SPEEDS = [1e-12, 1e-9, 1e-6, 1e-3, 0.3, 0.7, 0.9274, 0.99, 0.9999]
RATIOS = [0.0, 0.3, 0.49]

everywhere = pytest.mark.parametrize("point", POINTS.values(), ids=POINTS)
bodies = pytest.mark.parametrize("body", BODIES)


# --- digits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("body", "point", "speed", "nu"), thinned(BODIES, POINTS, SPEEDS, RATIOS, keep=31))
def test_every_component_to_the_digits_that_its_inputs_have(body, point, speed, nu):
    values = inputs(*POINTS[point], body, speed, nu)
    wanted, size = precise(precise_wedge, values)
    assert_accurate(wedge(*values), wanted[0], size[0], NAMES, VALUES)


CASES = [
    ("wedge", "beside", 0.3, 0.3),
    ("diamond", "beside", 1e-6, 0.3),
    ("wedge", "near the face", 0.7, 0.0),
    ("wedge", "far", 0.3, 0.3),
    ("wedge", "beside a node", 0.99, 0.3),
    ("wedge", "far ahead", 1e-12, 0.49),
]
MORE_CASES = [case for case in itertools.product(BODIES, POINTS, SPEEDS, RATIOS) if case not in CASES][::7]


def check_gradient_and_hessian(symbol, body, point, speed, nu, modulus=False):
    values = inputs(*POINTS[point], body, speed, nu)
    # Place, Poisson's ratio, speed, the first half thickness after the tip and, last, the modulus.
    chosen = (0, 1, 3, 5, len(values) - len(BODIES[body][0]), *([2] if modulus else []))
    wanted, size = precise(precise_wedge, values, chosen)
    assert_derivatives(differentiated(wedge, symbol, len(values), chosen)(values), wanted, size, NAMES, DERIVATIVES)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_gradient_and_hessian(case):
    check_gradient_and_hessian(ca.SX, *case)


@pytest.mark.slow
@pytest.mark.parametrize("case", [*CASES, *MORE_CASES], ids=str)
def test_gradient_and_hessian_in_the_modulus_too(case):
    check_gradient_and_hessian(ca.SX, *case, modulus=True)


@pytest.mark.parametrize("case", [*CASES[:1], *slow(CASES[1:])], ids=str)
def test_gradient_and_hessian_of_matrix_expressions(case):
    check_gradient_and_hessian(ca.MX, *case)


@bodies
@pytest.mark.parametrize("speed", [0.0, *slow([1e-9])])
def test_at_rest_the_field_is_the_limit_of_slow_motion(body, speed):
    for point in POINTS.values():
        slow, size = precise(precise_wedge, inputs(*point, body, 1e-15))
        assert_accurate(wedge(*inputs(*point, body, speed)), slow[0], size[0], NAMES, VALUES)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_at_rest_derivatives_are_finite_and_even_in_speed(symbol):
    slowest, rest = inputs(0.2, 0.1, "wedge", 1e-15), inputs(0.2, 0.1, "wedge", 0.0)
    chosen = (0, 1, 3, 5)
    wanted, size = precise(precise_wedge, slowest, chosen)
    found = differentiated(wedge, symbol, len(rest), chosen)(rest)
    odd = np.array([[0, 0, 0, 0, 1], *[[0, 0, 0, 0, 1]] * 3, [1, 1, 1, 1, 0]], dtype=bool)[:, 1:]
    # Odd in speed: zero at rest, and not compared with what they are at 1e-15 of the shear wave's.
    _, gradients, hessians = found
    for gradient, hessian in zip(gradients, hessians, strict=True):
        assert not np.any(np.vstack([gradient, hessian])[odd])
    even = np.concatenate([[True], ~odd.ravel()])
    assert_derivatives(found, wanted, size, NAMES, DERIVATIVES, even)


# --- equations -------------------------------------------------------------------------------------------------------


def grid():
    """Return points beside, ahead and behind, as rows that a function of symbols takes one by one."""
    x, y = np.meshgrid(np.linspace(-0.6, 1.1, 9), np.geomspace(3e-3, 2.0, 7))
    return x.reshape(1, -1), y.reshape(1, -1)


@pytest.mark.parametrize("body", ["wedge", "tapered", *slow(["diamond", "ogive"])])
def test_equations_of_motion_and_hookes_law(body):
    x, y, speed, nu = symbols = ca.vertsplit(ca.SX.sym("v", 4))
    values = inputs(x, y, body, speed, nu)
    field, inertia = wedge(*values), values[4] * values[5] ** 2
    lam = 2.0 * MU * nu / (1.0 - 2.0 * nu)

    def d(f, s):
        return ca.jacobian(f, s)

    of_motion = [
        (d(field.xx, x), d(field.xy, y), -inertia * d(field.ux_x, x)),
        (d(field.xy, x), d(field.yy, y), -inertia * d(field.uy_x, x)),
        # Compatibility: the gradient is one of a displacement.
        (MU * d(field.ux_x, y), -MU * d(field.ux_y, x)),
        (MU * d(field.uy_x, y), -MU * d(field.uy_y, x)),
    ]
    of_strain = [(field.uy_x, -d(field.uy, x)), (field.uy_y, -d(field.uy, y))]
    of_stress = [
        (field.xx, -(lam + 2.0 * MU) * field.ux_x, -lam * field.uy_y),
        (field.yy, -(lam + 2.0 * MU) * field.uy_y, -lam * field.ux_x),
        (field.zz, -lam * field.ux_x, -lam * field.uy_y),
        (field.xy, -MU * field.ux_y, -MU * field.uy_x),
    ]
    # On lines of symmetry all terms of a balance vanish; the share of each node alone in strains and slopes does not.
    nodes = np.array(nodes_of(values))
    slopes = np.abs(np.diff(nodes[:, 1]) / np.diff(nodes[:, 0])) / np.pi
    distance = [ca.hypot(x - node, y) for node in nodes[:, 0]]
    bend = sum(g * (1 / a + 1 / b) for g, a, b in zip(slopes, distance, distance[1:], strict=False))
    groups = [(of_strain, sum(slopes)), (of_stress, (lam + 2.0 * MU) * sum(slopes)), (of_motion, MU * bend)]
    residual = [sum(terms) for balances, _ in groups for terms in balances]
    size = [sum(map(ca.fabs, terms)) + share for balances, share in groups for terms in balances]
    evaluate = ca.Function("balances", symbols, [ca.vertcat(*residual), ca.vertcat(*size)])
    for speed_ratio, poisson_ratio in itertools.product([0.0, 1e-6, 0.3, 0.9274, 0.999], RATIOS):
        residual, size = map(np.asarray, evaluate(*grid(), speed_ratio, poisson_ratio))
        assert np.max(np.abs(residual) / size) <= BALANCE, (speed_ratio, poisson_ratio)


# A few dozen roundings in a derivative.
BALANCE = 32 * EPS


@bodies
@pytest.mark.parametrize("speed", [0.0, 1e-6, 0.3, 0.9274, 0.999])
def test_boundary_conditions_on_the_whole_line(body, speed):
    """The face is moved by the half thickness, and slides without shear; ahead and behind the line is straight."""
    x = np.array([-5.0, -0.3, 0.01, 0.15, 0.22, 0.35, 0.47, 0.6, 0.71, 3.0])
    values = inputs(x, np.zeros_like(x), body, speed)
    positions, thicknesses = [0.0, *BODIES[body][0]], [0.0, *BODIES[body][1]]
    slopes = np.array([0.0, *np.diff(thicknesses) / np.diff(positions), 0.0])
    field = wedge(*values)
    half_thickness = np.interp(x, positions, thicknesses)
    # The kernels' antiderivatives are lengths of up to 5 m times a slope of 0.1.
    np.testing.assert_allclose(field.uy, half_thickness, rtol=0, atol=8 * EPS * 0.5)
    np.testing.assert_allclose(field.uy_x, slopes[np.searchsorted(positions, x)], rtol=0, atol=4 * EPS)
    np.testing.assert_allclose(field.xy, 0.0, atol=4 * EPS * MU)
    # At the nodes themselves, where the strains are infinite, the face is what it was made.
    soil, V0 = ground(speed)
    moved = po.elastic.wedge_displacement(np.array(positions), np.zeros(len(positions)), nodes_of(values), soil, V0)
    np.testing.assert_allclose(moved, thicknesses, rtol=0, atol=8 * EPS * 0.5)


@bodies
@everywhere
def test_upper_and_lower_half_mirror_each_other(body, point):
    above, below = wedge(*inputs(*point, body)), wedge(*inputs(point[0], -point[1], body))
    for name in ("xx", "yy", "zz", "ux_x", "uy_y"):
        assert getattr(above, name) == getattr(below, name)
    for name in ("xy", "ux_y", "uy_x", "uy"):
        assert getattr(above, name) == -getattr(below, name)


# --- special speeds --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.0, 0.25, 0.3, 0.49])
def test_rayleigh_speed_solves_its_equation(nu):
    soil, _ = ground(nu=nu)
    modulus = mp.mpf(soil.youngs_modulus)

    def equation(speed):
        return oracle.Medium(modulus, nu, RHO, speed).rayleigh_function

    exact = mp.findroot(equation, (90, 94 if nu < 0.4 else 96))
    assert po.elastic.rayleigh_speed(soil) == pytest.approx(float(exact), rel=4 * EPS)
    assert po.elastic.shear_wave_speed(soil) == pytest.approx(SHEAR_WAVE, rel=4 * EPS)


def test_rayleigh_speed_of_the_literature():
    soil, _ = ground(nu=0.25)
    # Poisson solid: 0.9194017 c2, e.g. Achenbach, Wave Propagation in Elastic Solids, 1973, section 5.11.
    assert po.elastic.rayleigh_speed(soil) / po.elastic.shear_wave_speed(soil) == pytest.approx(0.9194017, abs=5e-8)


def test_at_the_shear_wave_speed_the_field_is_the_limit_from_below():
    """There eta = 0, and what hangs on it goes as the root of the distance in speed, 1.4e-6 at 1e-12."""
    (soil, _), nodes = ground(), nodes_of(inputs(0, 0, "diamond"))
    speed = po.elastic.shear_wave_speed(soil)
    for point in POINTS["beside"], POINTS["ahead"], POINTS["behind"]:
        at, below = (vars(po.elastic.wedge_stress(*point, nodes, soil, V0)) for V0 in (speed, speed * (1.0 - 1e-12)))
        largest = max(map(abs, below.values()))
        assert at == pytest.approx(below, rel=0, abs=1e-4 * largest)


# --- numbers, arrays and symbols -------------------------------------------------------------------------------------


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize("point", [POINTS["ahead"], *slow([POINTS["near the face"], POINTS["far"]])])
def test_numbers_arrays_and_symbols_give_the_same(point, symbol):
    values = inputs(*point, "tapered")
    numbers = wedge(*values)
    # An array of points, among others that would expose a mix-up.
    x, y = np.array([0.3, point[0], -2.0]), np.array([0.07, point[1], 0.4])
    arrays = wedge(x, y, *values[2:])
    v = symbol.sym("v", len(values))
    symbols = ca.Function("f", [v], list(wedge(*ca.vertsplit(v))))(values)
    size = precise(precise_wedge, values)[1][0]
    for name, number, array, expression, s in zip(NAMES, numbers, arrays, symbols, size, strict=True):
        assert isinstance(number, float)
        assert array.shape == x.shape
        assert number == pytest.approx(array[1], rel=0, abs=4 * EPS * float(s)), name
        assert number == pytest.approx(float(expression), rel=0, abs=4 * EPS * float(s)), name


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_arrays_of_points_meet_symbols(symbol):
    soil, V0 = ground()
    speed, nodes = symbol.sym("V0"), nodes_of(inputs(0, 0, "tapered"))
    x, y = np.array([0.3, -0.4, 2.0]), np.array([0.07, 0.1, 0.4])
    column = po.elastic.wedge_stress(x, y, nodes, soil, speed).xy
    found = np.asarray(ca.Function("xy", [speed], [column])(V0)).ravel()
    np.testing.assert_allclose(found, po.elastic.wedge_stress(x, y, nodes, soil, V0).xy, rtol=1e-13)


def test_points_in_a_plane_keep_their_shape():
    soil, speed = ground()
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 4), np.linspace(0.1, 1.0, 3))
    nodes = [(0.0, 0.0), (0.5, 0.05)]
    plane = po.elastic.wedge_stress(x, y, nodes, soil, speed).yy
    assert plane.shape == (3, 4)
    assert plane[2, 1] == pytest.approx(po.elastic.wedge_stress(x[2, 1], y[2, 1], nodes, soil, speed).yy, rel=1e-14)


@pytest.mark.parametrize("share", [po.Wedge(po.deg(25.0), po.deg(15.0), 0.25), po.Cone(po.deg(10.0), 0.3)])
def test_a_share_stands_for_its_nodes(share):
    soil, speed = ground()
    cone = share.equivalent_cone() if isinstance(share, po.Wedge) else share
    nodes = [(0.0, 0.0), (cone.height, cone.height * cone.slope)]
    for quantity in (po.elastic.wedge_stress, po.elastic.wedge_gradient):
        assert vars(quantity(0.1, 0.2, share, soil, speed)) == vars(quantity(0.1, 0.2, nodes, soil, speed))
    assert po.elastic.wedge_displacement(0.1, 0.2, share, soil, speed) == po.elastic.wedge_displacement(
        0.1, 0.2, nodes, soil, speed
    )


# --- refusals --------------------------------------------------------------------------------------------------------

GOOD = [(0.0, 0.0), (0.25, 0.025), (0.5, 0.0)]
REFUSED = {
    "supersonic": ({"speed": 100.001}, "speed"),
    "far too fast": ({"speed": 250.0}, "speed"),
    "backwards": ({"speed": -1.0}, "speed"),
    "speed not a number": ({"speed": math.nan}, "speed"),
    "point not a number": ({"x": math.nan}, "x"),
    "point at infinity": ({"y": math.inf}, "distance from the axis"),
    "array with one bad point": ({"x": np.array([0.1, math.nan])}, "x"),
    "on the tip": ({"x": 0.0, "y": 0.0}, "node"),
    "on a node": ({"x": 0.25, "y": 0.0}, "node"),
    "array with one point on a node": ({"x": np.array([0.1, 0.25]), "y": np.array([0.0, 0.0])}, "node"),
    "nodes descending": ({"profile": [(0.0, 0.0), (0.5, 0.05), (0.25, 0.0)]}, "backwards"),
    "nodes coincide": ({"profile": [(0.0, 0.0), (0.5, 0.05), (0.5, 0.0)]}, "backwards"),
    "first node thick": ({"profile": [(0.0, 0.01), (0.5, 0.05)]}, "first node"),
    "single node": ({"profile": [(0.0, 0.0)]}, "two nodes"),
    "node not a number": ({"profile": [(0.0, 0.0), (0.5, math.nan)]}, "finite"),
    "node at infinity": ({"profile": [(0.0, 0.0), (math.inf, 0.05)]}, "finite"),
}


@pytest.mark.parametrize("quantity", ["wedge_stress", "wedge_gradient", "wedge_displacement"])
@pytest.mark.parametrize(("change", "sentence"), REFUSED.values(), ids=REFUSED)
def test_what_the_theory_does_not_cover_is_refused(quantity, change, sentence):
    soil, speed = ground()
    given = {"x": 0.2, "y": 0.1, "profile": GOOD, "soil": soil, "speed": speed, **change}
    if quantity == "wedge_displacement" and sentence == "node":
        # The displacement has a corner there, and a value.
        assert np.all(np.isfinite(po.elastic.wedge_displacement(**given)))
        return
    with pytest.raises((po.DomainError, po.InputError), match=sentence):
        getattr(po.elastic, quantity)(**given)


@pytest.mark.parametrize("missing", ["youngs_modulus", "poisson_ratio"])
def test_a_soil_without_moduli_is_refused_with_a_remedy(missing):
    known = {"youngs_modulus": 4e7, "poisson_ratio": 0.3}
    known[missing] = None
    soil = po.Soil(1600.0, 0.8, 15e3, 0.5, 0.3, **known)
    with pytest.raises((po.DomainError, po.InputError), match=missing):
        po.elastic.wedge_stress(0.2, 0.1, GOOD, soil, 1.0)
