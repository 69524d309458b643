"""The source's formulas for a share in soil, as printed; the toolkit is not imported.

``m`` is the module of the numbers: `mp` for 120 digits (where nothing needs rearranging against cancellation), ``math``
for floats, NumPy for arrays.
"""

import mpmath

mp = mpmath.mp.clone()  # its own precision: other tests may set theirs
mp.dps = 120

SOIL = ("density", "density_ratio", "cohesion", "friction_angle", "tool_friction", "ambient_pressure")
"""The properties of a soil that `forces` takes, in the order of `po.Soil`."""


FIRM = {
    "wedge_angle": 0.5, "chisel_angle": 0.2, "height": 0.3,
    "density": 1400.0, "density_ratio": 0.8, "friction_angle": 0.5, "cohesion": 2e4, "tool_friction": 0.45,
    "ambient_pressure": 101325.0, "speed": 2.0, "acceleration": 3.0,
}  # fmt: skip
"""An ordinary share in an ordinary soil: the arguments of `resistance`, in order."""


def half_angle(wedge_angle, chisel_angle, m=mp):
    """Equation (7); sin(beta) = sqrt(p^2 + 1) - p is written as a quotient, for the floats."""
    p = m.pi * m.cos(chisel_angle) ** 2 / (2 * m.tan(wedge_angle))
    return m.asin(1 / (m.sqrt(p**2 + 1) + p))


def friction(friction_angle, m=mp):
    """Return mu and nu, below equation (14)."""
    mu = m.sin(friction_angle)
    return mu, 2 * mu / (1 + mu)


def forces(v, m=mp):
    """Return F0 [N], Fd [N s^2/m^2] and the added mass [kg] of equations (23), (25) and (26), for values by name."""
    b1, h, slope = v["density_ratio"], v["height"], m.tan(half_angle(v["wedge_angle"], v["chisel_angle"], m))
    mu, nu = friction(v["friction_angle"], m)
    a = 1 / (1 - b1)
    # For an angle of 1e-107 a power minus 1 would keep only 13 of the 120 digits.
    phi = m.expm1(nu / 2 * m.log(a)) / nu if nu else m.log(a) / 2
    strength = phi * (nu * v["ambient_pressure"] + 2 * v["cohesion"] * m.cos(v["friction_angle"]) / (1 + mu))
    rate = phi / b1 + a ** (nu / 2) + (1 - a ** (nu / 2 - 1)) / (b1 * (nu - 2))
    face = m.pi * (1 + v["tool_friction"] / slope) * h**2 * slope**2
    carried = face * slope**2 * v["density"]
    return face * strength, carried * rate, carried * h * phi / b1 * 2 / 3


def resistance(*values):
    """Equation (25) [N], arguments in the order of `FIRM`."""
    v = dict(zip(FIRM, values, strict=True))
    static, drag, added = forces(v)
    return static + drag * v["speed"] ** 2 + added * v["acceleration"]
