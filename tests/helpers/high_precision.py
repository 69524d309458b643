"""Derivatives in 120-digit arithmetic, and comparisons of floats with precise numbers."""

import math

import casadi as ca
import numpy as np

from helpers.equations import mp


def derivatives(function, point):
    """Return value, gradient and Hessian, of a number or an array, by central differences with a step of 1e-25.

    The step is 13 decades smaller than the length over which any tested function varies, so the error of the
    differences is 1e-26 relative; rounding, divided by the squared step, stays below 1e-40.
    """
    x, h, n = [mp.mpf(value) for value in point], mp.mpf(10) ** -25, len(point)

    def at(*moves):
        y = list(x)
        for i, sign in moves:
            y[i] += sign * h
        return function(*y)

    value = at()
    ahead, behind = [at((i, 1)) for i in range(n)], [at((i, -1)) for i in range(n)]
    gradient = [(p - q) / (2 * h) for p, q in zip(ahead, behind, strict=True)]
    hessian = [[None] * n for _ in range(n)]
    for i in range(n):
        hessian[i][i] = (ahead[i] - 2 * value + behind[i]) / h**2
        for j in range(i):
            ends = at((i, 1), (j, 1)) + at((i, -1), (j, -1)) + 2 * value
            hessian[i][j] = hessian[j][i] = (ends - ahead[i] - ahead[j] - behind[i] - behind[j]) / (2 * h**2)
    return value, gradient, hessian


def differentiated(quantity, symbol, size):
    """Return a function of a point: value, gradient and Hessian of a quantity, by automatic differentiation."""
    x = symbol.sym("x", size)
    y = quantity(*ca.vertsplit(x))
    hessian, gradient = ca.hessian(y, x)
    function = ca.Function("f", [x], [y, gradient, hessian])

    def at(point):
        value, first, second = (np.asarray(part) for part in function(point))
        return value[0, 0], first[:, 0], second

    return at


def assert_close(got, want, relative, label="", scale=None):
    """Compare one float with one precise number, to ``relative`` of ``scale`` (default: of the number itself).

    The differences turn an exact zero into numbers below 1e-35.
    """
    got, want = float(got), mp.mpf(want)
    assert math.isfinite(got), f"{label}: {got}"
    size = abs(want) if scale is None else mp.mpf(scale)
    if size < mp.mpf(10) ** -35:
        assert abs(got) < 1e-35, f"{label}: {got:.17g} instead of zero"
        return
    error = float(abs(mp.mpf(got) - want) / size)
    assert error <= relative, f"{label}: {got:.17g} instead of {mp.nstr(want, 20)}, off by {error:.1e} relative"


def assert_derivatives(got, wanted, relative, names):
    """Compare value, gradient and Hessian (arrays) with those from `derivatives`, entry by entry.

    Second derivatives in the friction angle pass through zero inside the domain. Errors are then relative to the terms,
    which are as large as the first derivative in the other variable, because angles are of order one.
    """
    got_value, got_gradient, got_hessian = got
    value, gradient, hessian = wanted
    assert_close(got_value, value, relative, "value")
    for i, name in enumerate(names):
        assert_close(got_gradient[i], gradient[i], relative, f"d/d {name}")
        for j, other in enumerate(names):
            scale = abs(hessian[i][j])
            if "friction_angle" in (name, other):
                scale += abs(gradient[j if name == "friction_angle" else i])
            assert_close(got_hessian[i][j], hessian[i][j], relative, f"d2/d {name} d {other}", scale)
