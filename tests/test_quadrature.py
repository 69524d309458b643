"""Gauss-Legendre nodes between 0 and 1, against 50 digits."""

import mpmath
import pytest

from plough_opt.core.expressions import gauss_legendre

mp = mpmath.mp.clone()
mp.dps = 50

ORDERS = [1, 2, 3, 8, 16, 33, 64]


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


def test_numbers_are_plain_and_cannot_be_changed_by_accident():
    nodes, weights = gauss_legendre(4)
    assert all(type(value) is float for value in (*nodes, *weights))  # CasADi keeps floats as constants
    assert isinstance(nodes, tuple)
    assert gauss_legendre(4) is gauss_legendre(4)
