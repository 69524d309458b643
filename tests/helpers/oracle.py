"""The elastic medium around a thin wedge or a slender cone in 120-digit arithmetic, for comparison with the toolkit.

The potentials' kernels are integrated over each straight piece in closed form. The formulas are not rearranged against
cancellation, and the toolkit is not imported. The toolkit, and so this oracle, agrees with Fourier integrals. A body is
a list of nodes (x, half thickness or radius), joined by straight lines and followed by a parallel shank. V0 must not be
zero, because at rest the potentials coincide and every formula here is 0/0. The field is even and analytic in V0, so
use 1e-15 c2 for rest.
"""

import itertools
from collections import namedtuple

from scipy.optimize import minimize_scalar

from helpers import high_precision as hp

mp = hp.mp

Wedge = namedtuple("Wedge", "xx yy xy zz ux_x uy_y ux_y uy_x uy")
"""Stresses [Pa], displacement gradient [-] and transverse displacement [m]."""

Cone = namedtuple("Cone", "axial radial xx rr tt rx")
"""Displacements [m] and stresses [Pa]."""


class Medium:
    """Moduli and speed ratios of the medium that streams past at the speed V0."""

    def __init__(self, youngs_modulus, poisson_ratio, density, speed):
        E, nu, rho, V0 = (mp.mpf(value) for value in (youngs_modulus, poisson_ratio, density, speed))
        self.mu = E / (2 * (1 + nu))
        self.lam = 2 * self.mu * nu / (1 - 2 * nu)
        self.c1 = mp.sqrt((self.lam + 2 * self.mu) / rho)
        self.c2 = mp.sqrt(self.mu / rho)
        self.alpha = mp.sqrt(1 - (V0 / self.c1) ** 2)
        self.eta = mp.sqrt(1 - (V0 / self.c2) ** 2)
        self.m = 1 - self.eta**2
        self.rayleigh_function = (1 + self.eta**2) ** 2 - 4 * self.alpha * self.eta
        self.nu = nu


def segments(nodes):
    """Yield (a, h(a), b, h(b)) of every straight piece."""
    for (a, left), (b, right) in itertools.pairwise(nodes):
        yield a, left, b, right


# --- wedge -----------------------------------------------------------------------------------------------------------


def wedge(x, y, nodes, medium):
    """Return the field at a point, y > 0 or (y = 0, the upper face).

    The slope g on [a, b] carries the kernels (1/pi) X/(X^2 + k^2 y^2) and (1/pi) k y/(X^2 + k^2 y^2), X = x - s:
    real and imaginary part of 1/(X + i k y), whose antiderivative is a logarithm.
    """
    alpha, eta, m = medium.alpha, medium.eta, medium.m
    ux_x = uy_y = ux_y = uy_x = uy = mp.mpf(0)
    for a, left, b, right in segments(nodes):
        g = (right - left) / (b - a)
        odd, even, step = {}, {}, {}
        for k in (alpha, eta):
            log_a, angle_a = _logarithm(x - a, k * y)
            log_b, angle_b = _logarithm(x - b, k * y)
            odd[k] = g * (log_a - log_b) / mp.pi
            even[k] = g * (angle_a - angle_b) / mp.pi
            # The antiderivative of the angle is X angle - k y log.
            step[k] = g * ((x - a) * angle_a - (x - b) * angle_b - k * y * (log_a - log_b)) / mp.pi + g * (b - a) / 2
        ux_x += (2 * eta * odd[eta] - (1 + eta**2) / alpha * odd[alpha]) / m
        uy_y += ((1 + eta**2) * alpha * odd[alpha] - 2 * eta * odd[eta]) / m
        ux_y += (2 * eta**2 * even[eta] - (1 + eta**2) * even[alpha]) / m
        uy_x += (2 * even[eta] - (1 + eta**2) * even[alpha]) / m
        uy += (2 * step[eta] - (1 + eta**2) * step[alpha]) / m
    dilation, shear = medium.lam * (ux_x + uy_y), medium.mu * (ux_y + uy_x)
    stresses = dilation + 2 * medium.mu * ux_x, dilation + 2 * medium.mu * uy_y, shear, dilation
    return Wedge(*stresses, ux_x, uy_y, ux_y, uy_x, uy)


def _logarithm(X, c):
    """Return ln sqrt(X^2 + c^2) and the angle atan(X/c); at c = 0 its limit from above."""
    return mp.log(X**2 + c**2) / 2, mp.atan(X / c) if c else mp.sign(X) * mp.pi / 2


def wedge_pressure(x, nodes, medium):
    """Return the contact pressure [Pa], the principal value of h'(s)/(x - s) over pi, times mu K."""
    K = -medium.rayleigh_function / (medium.alpha * medium.m)
    logs = ((d - c) / (b - a) * mp.log(abs((x - a) / (x - b))) for a, c, b, d in segments(nodes))
    return medium.mu * K * mp.fsum(logs) / mp.pi


def wedge_force(nodes, medium, *others):
    """Return 2 int (max(p + p_a, 0) - p_a) (h' + mu0) dx, or 2 int p (h' + mu0) dx without separation."""
    return _force(lambda x: wedge_pressure(x, nodes, medium), lambda _: 2, nodes, *others)


def _force(pressure, width, nodes, tool_friction, ambient_pressure, separation=True):
    """Integrate a pressure over the width of a face; the quadrature keeps about two thirds of the working digits."""
    force = mp.mpf(0)
    for a, left, b, right in segments(nodes):

        def thrust(x, a=a, b=b):
            # A quadrature node may be rounded onto the end of the piece.
            return pressure(x) * width(x) if a < x < b else mp.zero

        parts = touching(lambda x: pressure(x) + ambient_pressure, a, b) if separation else [(a, b)]
        pushed = mp.fsum(mp.quad(thrust, [start, (start + end) / 2, end]) for start, end in parts)
        lost = mp.quad(width, [a, b]) - mp.fsum(mp.quad(width, part) for part in parts)
        force += ((right - left) / (b - a) + tool_friction) * (pushed - ambient_pressure * lost)
    return force


def touching(absolute_pressure, a, b):
    """Return the parts of a straight piece on which a pressure is positive.

    Signs are evaluated at distances from both ends that decrease geometrically to 1e-16 of the length, and where the
    pressure comes nearest to zero between two places with the same sign.
    """
    near = [(b - a) / 2 * mp.mpf(10) ** (-mp.mpf(k) / 2) for k in range(32, 0, -1)]
    middle = [(b - a) * mp.mpf(k) / 40 for k in range(7, 34)]
    places = [*(a + d for d in near), *(a + d for d in middle), *(b - d for d in reversed(near))]
    found = [(x, absolute_pressure(x)) for x in places]
    extra = []
    for (before, p), (_, q), (after, r) in zip(found, found[1:], found[2:], strict=False):
        side = 1 if q > 0 else -1
        if 0 < side * q < min(side * p, side * r):
            ends = float(before), float(after)
            least = minimize_scalar(
                lambda x, side=side: float(side * absolute_pressure(x)), bounds=ends, method="bounded"
            )
            extra.append(mp.mpf(least.x))
    found = sorted([*found, *((x, absolute_pressure(x)) for x in extra)])
    edges = [a, b]
    for (low, p), (high, q) in itertools.pairwise(found):
        # The pressure vanishes at an edge, which half of the digits therefore locate well enough.
        while (p > 0) != (q > 0) and high - low > mp.sqrt(mp.eps) * 1e-6 * (b - a):
            middle = (low + high) / 2
            low, high = (middle, high) if (absolute_pressure(middle) > 0) == (p > 0) else (low, middle)
        edges[1:1] = [low] if (p > 0) != (q > 0) else []
    edges.sort()
    return list(itertools.pairwise(edges))[0 if found[0][1] > 0 else 1 :: 2]


# --- cone ------------------------------------------------------------------------------------------------------------


def cone(x, r, nodes, medium):
    """Return the field at a point, r > 0.

    With S = R^2/2 and s = S', N = int s/(2 rho) and M = -int s (1 + X/rho)/(2 r), rho^2 = X^2 + k^2 r^2,
    the displacements are ((1 + eta^2) N(alpha) - 2 eta^2 N(eta))/m and ((1 + eta^2) M(alpha) - 2 M(eta))/m.
    The stresses follow from their derivatives by Hooke's law.
    """
    eta, m = medium.eta, medium.m
    (n_alpha, m_alpha), (n_eta, m_eta) = (source_integrals(x, r, nodes, k) for k in (medium.alpha, eta))
    # Each with its derivatives in x and r.
    axial, ux_x, ux_r = (
        ((1 + eta**2) * of_alpha - 2 * eta**2 * of_eta) / m for of_alpha, of_eta in zip(n_alpha, n_eta, strict=True)
    )
    radial, ur_x, ur_r = (
        ((1 + eta**2) * of_alpha - 2 * of_eta) / m for of_alpha, of_eta in zip(m_alpha, m_eta, strict=True)
    )
    dilation = medium.lam * (ux_x + ur_r + radial / r)
    normal = (dilation + 2 * medium.mu * strain for strain in (ux_x, ur_r, radial / r))
    return Cone(axial, radial, *normal, medium.mu * (ux_r + ur_x))


def source_integrals(x, r, nodes, k):
    """Return N and M for s = R R', each with its derivatives in x and r."""
    n, n_x, n_r, swept, swept_x, swept_r = [mp.mpf(0)] * 6
    for a, left, b, right in segments(nodes):
        t = (right - left) / (b - a)
        slope = t**2
        here, at_a, at_b = (left + t * (x - a)) * t, left * t, right * t
        X0, X1, kr2 = x - a, x - b, (k * r) ** 2
        rho0, rho1 = mp.sqrt(X0**2 + kr2), mp.sqrt(X1**2 + kr2)
        log = mp.asinh(X0 / (k * r)) - mp.asinh(X1 / (k * r))
        log_x = 1 / rho0 - 1 / rho1
        log_r = (X1 / rho1 - X0 / rho0) / r
        n += (here * log - slope * (rho0 - rho1)) / 2
        n_x += (slope * log + here * log_x - slope * (X0 / rho0 - X1 / rho1)) / 2
        n_r += (here * log_r - slope * k**2 * r * log_x) / 2
        swept += (b - a) * (at_a + at_b) / 2 + here * (rho0 - rho1) - slope * (X0 * rho0 - X1 * rho1 - kr2 * log) / 2
        swept_x += slope * (rho0 - rho1) + here * (X0 / rho0 - X1 / rho1)
        swept_x -= slope * (rho0 + X0**2 / rho0 - rho1 - X1**2 / rho1 - kr2 * log_x) / 2
        swept_r += here * k**2 * r * log_x
        swept_r -= slope * (k**2 * r * (X0 / rho0 - X1 / rho1) - 2 * k**2 * r * log - kr2 * log_r) / 2
    return (n, n_x, n_r), (-swept / (2 * r), -swept_x / (2 * r), swept / (2 * r**2) - swept_r / (2 * r))


def radius(x, nodes):
    """Return the radius of a body at x."""
    for a, left, b, right in segments(nodes):
        if a <= x <= b:
            return left + (right - left) * (x - a) / (b - a)
    raise ValueError(f"{x} lies beside the body")


def cone_pressure(x, nodes, medium):
    """Return -sigma_rr on r = R(x) [Pa]."""
    return -cone(x, radius(x, nodes), nodes, medium).rr


def cone_force(nodes, medium, *others):
    """Return 2 pi int (max(p + p_a, 0) - p_a) (R' + mu0) R dx, or 2 pi int p (R' + mu0) R dx without separation."""
    return _force(lambda x: cone_pressure(x, nodes, medium), lambda x: 2 * mp.pi * radius(x, nodes), nodes, *others)
