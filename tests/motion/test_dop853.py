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
