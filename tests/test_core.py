"""Expressions, labels in graphs, notes and refinement: what every room builds on."""

import itertools
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.high_precision import assert_close, derivatives, mp

import plough_opt as po
from plough_opt.core import expressions as ex
from plough_opt.core.checks import DomainLimit, attach, labels_in, meaning_of
from plough_opt.core.errors import merge
from plough_opt.core.expressions import is_symbolic
from plough_opt.design.model.tight_integration import TightEvaluation

# --- functions of floats, arrays and CasADi expressions, and ratios without cancellation ---


def beside(x):
    """Return a number and its two neighbours, which lie on both sides of a branch."""
    return [math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf)]


BOTH_SIDES = [s * x for x in (1e-20, 1e-12, 1e-8, 1e-4, 0.01, 0.3) for s in (-1, 1)]
EXPM1 = [
    *[0.0, *BOTH_SIDES, -0.9, 0.5, 0.9, *beside(-1.0), *beside(1.0)],
    *[-1.0001, 1.0001, -1.5, 1.5, -5.0, 5.0, -30.0, 30.0, -700.0, 600.0],
]
LOG1P = [
    *[0.0, *BOTH_SIDES, -0.45, 0.45, *beside(-0.5), *beside(0.5)],
    *[-0.5001, 0.5001, -0.7, 1.0, 10.0, 1e6, -0.999, -1 + 1e-9, math.nextafter(-1.0, 0.0)],
]
INSIDE = [0.0, *BOTH_SIDES, -0.45, 0.45, *beside(-0.5), *beside(0.5), -0.5001, 0.5001, -0.9, 0.99]
# Ratio -> the function over x, and value, slope and curvature at 0.
PRECISE = {
    ex.expm1_ratio: (mp.expm1, (1, 1 / 2, 1 / 3)),
    ex.log1p_ratio: (mp.log1p, (1, -1 / 2, 2 / 3)),
    ex.arctanh_ratio: (mp.atanh, (1, 0, 2 / 3)),
    ex.arctan_ratio: (mp.atan, (1, 0, -2 / 3)),
    ex.arcsinh_ratio: (mp.asinh, (1, 0, -1 / 3)),
}
RATIOS = [
    *((ex.expm1_ratio, x) for x in EXPM1),
    *((ex.log1p_ratio, x) for x in LOG1P),
    *((ex.arctanh_ratio, x) for x in INSIDE),
    *((ratio, x) for ratio in (ex.arctan_ratio, ex.arcsinh_ratio) for x in (*INSIDE, -3.0, 20.0)),
]


def with_derivatives(ratio, symbol):
    """Return the Function from a number to a ratio and its first two derivatives."""
    x = symbol.sym("x")
    y = ratio(x)
    first = ca.gradient(y, x)
    return ca.Function("f", [x], [y, first, ca.gradient(first, x)])


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize(("ratio", "at"), RATIOS)
def test_ratio_and_its_two_derivatives_keep_their_digits(ratio, at, symbol):
    value, slope, curvature = with_derivatives(ratio, symbol)(at)
    precise = PRECISE[ratio][0]
    want, [want_slope], [[want_curvature]] = derivatives(lambda x: precise(x) / x if x else mp.mpf(1), [at])
    # The value has some ten roundings; beyond the branch each derivative of the closed form costs a digit.
    assert_close(value, want, 1e-15, "value")
    assert_close(ratio(at), want, 1e-15, "value of a float")
    assert_close(slope, want_slope, 1e-14, "first derivative")
    assert_close(curvature, want_curvature, 1e-13, "second derivative")


@pytest.mark.parametrize("ratio", [ex.expm1_ratio, ex.log1p_ratio, ex.arctan_ratio, ex.arcsinh_ratio])
def test_ratios_of_arrays_are_elementwise(ratio):
    x = np.array([[-0.9, -0.5, -1e-9], [0.0, 0.5, 3.0]])
    # One unit in the last place: NumPy may use different code for whole registers and for single numbers.
    np.testing.assert_allclose(ratio(x), [[ratio(float(v)) for v in row] for row in x], rtol=3e-16)
    assert isinstance(ratio(0.25), float)


UNARY = {
    "sin": mp.sin, "cos": mp.cos, "tan": mp.tan, "arctan": mp.atan, "sqrt": mp.sqrt, "exp": mp.exp, "log1p": mp.log1p,
    "expm1": mp.expm1, "absolute": abs, "arcsinh": mp.asinh,
}  # fmt: skip


@pytest.mark.parametrize("name", UNARY)
def test_operation_is_the_same_for_numbers_arrays_and_symbols(name):
    operation, points = getattr(ex, name), [0.0, 1e-9, 0.3, 1.2]
    of_symbols = [ca.Function("f", [s], [operation(s)]) for s in (ca.SX.sym("s"), ca.MX.sym("s"))]
    for x in points:
        for of in (operation, lambda x: operation(ca.DM(x)), *of_symbols):
            assert_close(of(x), UNARY[name](mp.mpf(x)), 3e-16, name)
    np.testing.assert_allclose(operation(np.array(points)), [operation(x) for x in points], rtol=3e-16)
    assert operation.__name__ in operation.__doc__


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_choice_and_minimum_take_numbers_arrays_and_symbols(symbol):
    def chosen(x):
        return ex.where(x < 2.0, x, -1.0), ex.minimum(x, 2.0), ex.minimum(2.0, x)

    x = symbol.sym("x")
    for value, wanted in ((1.5, (1.5, 1.5, 1.5)), (2.5, (-1.0, 2.0, 2.0))):
        assert chosen(value) == wanted
        assert tuple(map(float, ca.Function("f", [x], [*chosen(x)])(value))) == wanted
    assert [[*found] for found in chosen(np.array([1.5, 2.5]))] == [[1.5, -1.0], [1.5, 2.0], [1.5, 2.0]]


@pytest.mark.parametrize("order", [1, 2, 3, 16, 64])
def test_a_quadrature_is_exact_for_polynomials_below_twice_its_order(order):
    nodes, weights = ex.gauss_legendre(order)
    assert {*map(type, (*nodes, *weights))} == {float}  # CasADi keeps floats as constants
    for power in range(2 * order):
        assert np.dot(weights, np.power(nodes, power)) == pytest.approx(1.0 / (power + 1), rel=2e-14)


# --- labels: calls in a graph that do not change its value and can be found again ---


LOW = DomainLimit("something", at_most=2.0, unit="m")
HIGH = DomainLimit("something else", at_most=3.0)


def whole(*outputs, symbol):
    return ca.Function("whole", [symbol], list(outputs), {"never_inline": True})


def test_carried_expressions_do_not_affect_the_value_even_if_undefined():
    x = ca.MX.sym("x")
    y = attach(x**3, ca.vertcat(ca.sqrt(-x), ca.log(-x)), LOW, LOW)
    hessian, gradient = ca.hessian(y, x)
    assert [float(part) for part in whole(y, gradient, hessian, symbol=x)(2.0)] == [8.0, 12.0, 12.0]


def test_labels_are_found_each_with_its_meaning():
    x = ca.MX.sym("x", 3)
    parts = [(x[0], x[2], LOW), (x[1], x[2], LOW), (x[0], x[2], HIGH), (x[0], x, LOW)]
    graph = whole(*(attach(value, carried, meaning, meaning) for value, carried, meaning in parts), symbol=x)
    found = [(meaning_of(node.which_function()), node.dep(1).numel()) for node in labels_in(graph)]
    assert sorted(found, key=str) == sorted([(LOW, 1), (LOW, 1), (HIGH, 1), (LOW, 3)], key=str)
    assert len({hash(node.which_function()) for node in labels_in(graph)}) == 3  # equal meanings share one


@pytest.mark.parametrize("medium", po.laws.LAWS)
def test_a_design_keeps_the_limits_that_its_scene_lists(medium):
    """Also those on a speed of which the draft at rest does not depend."""
    d = po.Design()
    speed = d.variable("speed", guess="2 m/s", lower="1 m/s", upper="4 m/s")
    soil = replace(po.named_soil("serozem"), youngs_modulus=1e7, poisson_ratio=0.3)
    still = po.Effects(motion=False)
    scene = po.Scene(soil, po.Wedge(po.deg(30), po.deg(55), 0.25), 5e4, 30.0, 1.1 * speed, still, medium)
    d.minimise(po.simulate(scene, "0.2 s").mean_draft)
    evaluation = TightEvaluation(d.declared.expressions(), d.declared.symbols())
    listed = {(limit.name, *limit.kept, limit.unit): value for limit, value in scene.limits() if is_symbolic(value)}
    assert medium in ("plastic", "elastic") or listed
    assert [(name, *rest) for name, _, *rest in evaluation.limits] == sorted(listed)
    for name, value, *rest in evaluation.limits:
        (one, other) = ca.Function("both", d.declared.symbols(), [value, listed[name, *rest]])(2.5)
        assert np.all(np.asarray(one) == np.asarray(other))


# --- notes that differ only in their numbers become one note with the ranges of these ---


# Notes of one kind, and what they become.
ALIKE = [
    (["a carries 92 % of it", "a carries 38 % of it", "a carries 50 % of it"], "a carries 38 to 92 % of it"),
    (["at 1e-9 and -3.5 m", "at 2e-10 and 4 m"], "at 2e-10 to 1e-9 and -3.5 to 4 m"),
    (["from 3 to 5 kPa", "from 2 to 4 kPa", "from 4 to 4.5 kPa"], "from 2 to 5 kPa"),
    (["the wave's part is 0.1 in Poisson's ratio", "the wave's part is 0.2 in Poisson's ratio"],
     "the wave's part is 0.1 to 0.2 in Poisson's ratio"),
    (["1 %", "1.0 %"], "1 %"),
]  # fmt: skip


@pytest.mark.parametrize(("texts", "wanted"), ALIKE)
def test_numbers_become_their_range_in_any_order(texts, wanted):
    for order in itertools.permutations(texts):
        notes = {}
        kinds = {merge(notes, text) for text in order}
        assert list(notes.values()) == [wanted]
        # Merged notes can be merged again, as by several processes of a sweep.
        assert kinds == {merge(notes, wanted)}
        assert list(notes.values()) == [wanted]
