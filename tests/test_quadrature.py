"""Gauss-Legendre nodes between 0 and 1, against 50 digits."""

import math

import mpmath
import numpy as np
import pytest

from plough_opt.core.quadrature import gauss_legendre

mp = mpmath.mp.clone()
mp.dps = 50

ORDERS = [1, 2, 3, 8, 16, 33, 64]


def integral(order, power):
    """The rule's integral of the shifted Legendre polynomial of a degree, as a sum without rounding of its own."""
    nodes, weights = gauss_legendre(order)
    return mp.fsum(mp.mpf(w) * mp.legendre(power, 2 * mp.mpf(x) - 1) for x, w in zip(nodes, weights, strict=True))


@pytest.mark.parametrize("order", ORDERS)
def test_exact_up_to_degree_twice_the_order_minus_one_and_not_further(order):
    # The weights come with a rounding of a few units each; what a node is off by, at most 1.1e-16, the slope of a
    # polynomial of a high degree magnifies.
    for degree in range(2 * order):
        truth = 1 if degree == 0 else 0
        assert abs(integral(order, degree) - truth) < 1e-16 * (2 + order)
    # P_2n is c P_n^2 and polynomials that the rule integrates; P_n vanishes on the nodes, c follows from the powers.
    n = mp.mpf(order)
    c = mp.factorial(4 * n) * mp.factorial(n) ** 4 / mp.factorial(2 * n) ** 4
    assert integral(order, 2 * order) == pytest.approx(-c / (2 * n + 1), rel=3e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_nodes_and_weights_are_the_roots_and_their_christoffel_numbers(order):
    nodes, weights = gauss_legendre(order)
    assert len(nodes) == len(weights) == order
    assert list(nodes) == sorted(nodes)
    for node, weight in zip(nodes, weights, strict=True):
        root = mp.findroot(lambda t: mp.legendre(order, t), 2 * mp.mpf(node) - 1)
        slope = mp.diff(lambda t: mp.legendre(order, t), root)
        assert abs((root + 1) / 2 - mp.mpf(node)) < 1.2e-16
        assert weight == pytest.approx(float(1 / ((1 - root**2) * slope**2)), rel=2e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_the_rule_is_symmetric_and_inside(order):
    nodes, weights = (np.array(values) for values in gauss_legendre(order))
    np.testing.assert_allclose(nodes + nodes[::-1], 1.0, rtol=3e-16)
    np.testing.assert_allclose(weights, weights[::-1], rtol=3e-16)
    assert nodes[0] > 0.0
    assert nodes[-1] < 1.0
    assert min(weights) > 0.0


def test_values_by_hand():
    assert gauss_legendre(1) == ((0.5,), (1.0,))
    nodes, weights = gauss_legendre(2)
    assert nodes == pytest.approx((0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12)), rel=3e-16)
    assert weights == pytest.approx((0.5, 0.5), rel=3e-16)


def test_numbers_are_plain_and_cannot_be_changed_by_accident():
    nodes, weights = gauss_legendre(4)
    assert all(type(value) is float for value in (*nodes, *weights))  # CasADi keeps floats as constants
    assert isinstance(nodes, tuple)
    assert gauss_legendre(4) is gauss_legendre(4)
