"""The coefficients of the order-8 method are SciPy's, and meet the conditions of order that quadrature alone gives."""

import numpy as np
import pytest
from scipy.integrate import DOP853 as SCIPYS

from plough_opt.motion.methods import DOP853


def test_coefficients_are_scipys():
    assert np.array(DOP853.nodes) == pytest.approx(SCIPYS.C, rel=0, abs=0)
    assert np.array(DOP853.weights) == pytest.approx(SCIPYS.B, rel=0, abs=0)
    for k, row in enumerate(DOP853.stages):
        assert list(row) == list(SCIPYS.A[k][:k])
        assert not np.any(SCIPYS.A[k][k:])
