"""The textbook formulas in 120-digit arithmetic, with which the toolkit's rearranged forms are compared.

The formulas are not rearranged against cancellation, and the toolkit is not imported.
"""

import math

import casadi as ca
import mpmath
import numpy as np

mp = mpmath.mp.clone()  # its own precision: other tests may set theirs
mp.dps = 120

NAMES = (
    "wedge_angle",
    "chisel_angle",
    "height",
    "density",
    "density_ratio",
    "friction_angle",
    "cohesion",
    "tool_friction",
    "ambient_pressure",
    "speed",
    "acceleration",
)
"""Arguments of `resistance`, in order."""

FIRM = {
    "wedge_angle": 0.5,
    "chisel_angle": 0.2,
    "height": 0.3,
    "density": 1400.0,
    "density_ratio": 0.8,
    "friction_angle": 0.5,
    "cohesion": 2e4,
    "tool_friction": 0.45,
    "ambient_pressure": 101325.0,
    "speed": 2.0,
    "acceleration": 3.0,
}
"""An ordinary share in an ordinary soil."""


def wedge_area(wedge_angle, chisel_angle, height):
    """Equation (5)."""
    return height**2 * mp.tan(wedge_angle) / mp.cos(chisel_angle) ** 2


def cone_area(half_angle, height):
    """Equation (6)."""
    return mp.pi * height**2 * mp.tan(half_angle) / mp.cos(half_angle)


def half_angle(wedge_angle, chisel_angle):
    """Equation (7) as printed, by the arcsine."""
    p = mp.pi * mp.cos(chisel_angle) ** 2 / (2 * mp.tan(wedge_angle))
    return mp.asin(mp.sqrt(p**2 + 1) - p)


def strength(density_ratio, friction_angle, cohesion, ambient_pressure):
    """Static part of equation (23) [Pa]."""
    mu, nu, phi, _ = _friction(density_ratio, friction_angle)
    tau0 = 2 * cohesion * mp.cos(friction_angle)
    return phi * (nu * ambient_pressure + tau0 / (1 + mu))


def rate(density_ratio, friction_angle):
    """The bracket of R'^2 in equation (23) [-]."""
    _, nu, phi, a = _friction(density_ratio, friction_angle)
    return phi / density_ratio + a ** (nu / 2) + (1 - a ** (nu / 2 - 1)) / (density_ratio * (nu - 2))


def inertia(density_ratio, friction_angle):
    """The factor of R R'' in equation (23) [-]."""
    return _friction(density_ratio, friction_angle)[2] / density_ratio


def _friction(density_ratio, friction_angle):
    mu = mp.sin(friction_angle)
    nu = 2 * mu / (1 + mu)
    a = 1 / (1 - density_ratio)
    # For an angle of 1e-107 a power minus 1 would keep only 13 of the 120 digits.
    phi = mp.expm1(nu / 2 * mp.log(a)) / nu if nu else mp.log(a) / 2
    return mu, nu, phi, a


def coefficients(v):
    """A, B and C of equation (26)."""
    tan = mp.tan(half_angle(v["wedge_angle"], v["chisel_angle"]))
    b1, theta = v["density_ratio"], v["friction_angle"]
    A = tan**2 * strength(b1, theta, v["cohesion"], v["ambient_pressure"])
    return A, tan**4 * rate(b1, theta), tan**4 * inertia(b1, theta) * 2 / 3


def resistance_terms(v):
    """Return the terms of equation (25) [N]: static, with the squared speed, with the acceleration."""
    A, B, C = coefficients(v)
    friction = 1 + v["tool_friction"] / mp.tan(half_angle(v["wedge_angle"], v["chisel_angle"]))
    scale = mp.pi * friction * v["height"] ** 2
    return (
        scale * A,
        scale * B * v["density"] * v["speed"] ** 2,
        scale * C * v["density"] * v["height"] * v["acceleration"],
    )


def resistance(*values):
    """Equation (25) [N], arguments in the order of `NAMES`."""
    return mp.fsum(resistance_terms(dict(zip(NAMES, values, strict=True))))


def in_order(values):
    """Return values by name as the list that `resistance` takes."""
    return [values[name] for name in NAMES]


def exact(values):
    """Return floats as 120-digit numbers: a list, or a dictionary by name."""
    if isinstance(values, dict):
        return {name: mp.mpf(float(value)) for name, value in values.items()}
    return [mp.mpf(float(value)) for value in values]


def derivatives(function, point):
    """Return value, gradient and Hessian by central differences with a step of 1e-25.

    The step is 13 decades smaller than the length over which any tested function varies, so the error of the
    differences is 1e-26 relative; rounding, divided by the squared step, stays below 1e-40.
    """
    x, h, n = exact(point), mp.mpf(10) ** -25, len(point)

    def at(*moves):
        y = list(x)
        for i, sign in moves:
            y[i] += sign * h
        return function(*y)

    value = at()
    ahead, behind = [at((i, 1)) for i in range(n)], [at((i, -1)) for i in range(n)]
    gradient = [(p - q) / (2 * h) for p, q in zip(ahead, behind, strict=True)]
    hessian = [[mp.mpf(0)] * n for _ in range(n)]
    for i in range(n):
        hessian[i][i] = (ahead[i] - 2 * value + behind[i]) / h**2
        for j in range(i):
            mixed = at((i, 1), (j, 1)) - at((i, 1), (j, -1)) - at((i, -1), (j, 1)) + at((i, -1), (j, -1))
            hessian[i][j] = hessian[j][i] = mixed / (4 * h**2)
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
