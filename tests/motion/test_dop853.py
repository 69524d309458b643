"""The coefficients of the order-8 method are SciPy's, and meet the conditions of order that quadrature alone gives."""

import numpy as np
import pytest
from scipy.integrate import DOP853

from plough_opt.motion.dop853 import NODES, STAGES, WEIGHTS


def test_coefficients_are_scipys():
    assert np.array(NODES) == pytest.approx(DOP853.C, rel=0, abs=0)
    assert np.array(WEIGHTS) == pytest.approx(DOP853.B, rel=0, abs=0)
    for k, row in enumerate(STAGES):
        assert list(row) == list(DOP853.A[k][:k])
        assert not np.any(DOP853.A[k][k:])


@pytest.mark.parametrize("power", range(8))
def test_polynomials_up_to_order_8_are_integrated(power):
    # The coefficients are rounded, and up to 5 in size.
    assert np.dot(WEIGHTS, np.array(NODES) ** power) == pytest.approx(1.0 / (power + 1), rel=1e-14)


def test_stages_are_consistent():
    assert [sum(row) for row in STAGES] == pytest.approx(list(NODES), rel=0, abs=1e-13)
