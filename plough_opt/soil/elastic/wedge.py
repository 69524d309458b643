"""The thin wedge in plane strain: equations (1) and (2), in closed form for a piecewise-linear profile.

The face is frictionless and moves the soil aside by its half thickness, v(x, 0) = h(x). For a straight piece of slope g
between a and b, with X0 = x - a, X1 = x - b and L = b - a, the potentials are::

    Q_k = (g/2 pi) ln((X0^2 + k^2 y^2)/(X1^2 + k^2 y^2)),   P_k = (g/pi) arg(k^2 y^2 + X0 X1, k y L)

for k = alpha and eta. The stresses need Q_alpha, P_alpha and the differences (Q_alpha - Q_eta)/m and
(P_eta - P_alpha)/m, which are computed without losing digits at low speed (m -> 0).
"""

import math
from dataclasses import dataclass, replace

from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import Expression, arctan2, gauss_legendre, one_node, sqrt, where
from plough_opt.soil.elastic.medium import (
    FAR,
    FAR_NODES,
    Medium,
    Ratios,
    angle_difference,
    log_difference,
    medium,
    medium_law,
)
from plough_opt.soil.elastic.profile import Body, Profile, body, check_off_nodes, points
from plough_opt.soil.soil import Soil

# Added to squared distances, so that y ln(distance from a node) is 0 on the node itself.
_TINY = 1e-300


@dataclass(frozen=True)
class WedgeStress:
    """Stresses around a thin wedge [Pa], tension positive: x along the motion, y across, z along the edge."""

    xx: Expression
    yy: Expression
    xy: Expression
    zz: Expression


@dataclass(frozen=True)
class WedgeGradient:
    """Gradient of the displacement (ux, uy) around a thin wedge [-]."""

    ux_x: Expression
    ux_y: Expression
    uy_x: Expression
    uy_y: Expression


@dataclass(frozen=True)
class Potentials:
    """Functions whose linear combinations are the fields of a wedge, for y >= 0.

    Attributes:
        q: Q_alpha.
        q_change: (Q_alpha - Q_eta)/m.
        p: P_alpha.
        p_change: (P_eta - P_alpha)/m.
    """

    q: Expression
    q_change: Expression
    p: Expression
    p_change: Expression


def potentials(offsets: list[Expression], y: Expression, wedge: Body, soil: Medium) -> Potentials:
    """Return the potentials at given distances from the nodes and from the plane of symmetry, y >= 0."""
    pieces = []
    for segment in wedge.segments:
        place = offsets[segment.start], offsets[segment.start + 1], y, segment.length
        pieces.append([segment.slope / math.pi * value for value in _piece(*place, *soil.in_order)])
    return Potentials(*map(sum, zip(*pieces, strict=True)))


@one_node
def _piece(
    x0: Expression, x1: Expression, y: Expression, length: Expression, *state: Expression
) -> tuple[Expression, ...]:
    """Return the four `Potentials` of a piece of slope g, multiplied by pi/g."""
    soil = Ratios(*state)
    m, kappa, alpha, eta, slowing = soil.m, soil.kappa, soil.alpha, soil.eta, soil.slowing
    product = alpha * eta * y**2
    slow, fast = ((x0**2 + (k * y) ** 2, x1**2 + (k * y) ** 2) for k in (eta, alpha))
    change = length * (x0 + x1)
    # A_alpha B_eta - A_eta B_alpha = -m (1 - kappa) y^2 L (X0 + X1)
    crossed = fast[0] * slow[1], slow[0] * fast[1]
    rise = slowing * y * length * (product - x0 * x1)
    run = (product + x0**2) * (product + x1**2) + (m * slowing * y) ** 2 * x0 * x1
    return (
        log_difference(*fast, change) / 2.0,
        log_difference(*crossed, -(1.0 - kappa) * y**2 * change, m) / 2.0,
        arctan2(alpha * y * length, (alpha * y) ** 2 + x0 * x1),
        angle_difference(rise, run, m),
    )


def stress_of(found: Potentials, soil: Medium) -> WedgeStress:
    """Return the stresses that follow from the potentials, for y >= 0: (1) and (2) in units of rho V0^2 = mu m."""
    alpha, eta = soil.alpha, soil.eta
    difference = 4.0 * alpha * eta * found.q_change
    # 4 kappa - 4 q1 + m (1 - 2 kappa)
    along = 4.0 * soil.kappa - 4.0 * soil.product + soil.m * soil.stiffening
    return WedgeStress(
        xx=soil.shear_modulus * (along * found.q - difference) / alpha,
        yy=soil.shear_modulus * (soil.rayleigh * found.q + difference) / alpha,
        xy=2.0 * soil.shear_modulus * soil.lateral * found.p_change,
        zz=-soil.shear_modulus * soil.stiffening * soil.lateral * found.q / alpha,
    )


@medium_law
def wedge_stress(x: Expression, y: Expression, profile: Profile, soil: Soil, speed: Expression) -> WedgeStress:
    """Return the stresses around a thin wedge in steady motion, equations (1) and (2) corrected.

    The result is exact within linear elasticity for every speed from 0 to the shear wave speed. The printed (2) lacks a
    factor 2, and both equations lack the unit rho V0^2.

    Args:
        x: distance behind the tip [m]; a float, an array, or a CasADi column.
        y: distance from the plane of symmetry [m], of the same shape; y < 0 is the mirror image, y = 0 the upper face.
        profile: nodes (x, half thickness) [m] from the tip, where the half thickness is 0; it is constant behind the
            last node. A `Wedge` or `Cone` is replaced by a straight profile with the slope tan(beta) of its equivalent
            cone.
        soil: soil with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to `shear_wave_speed`. For an MX expression a `Design` adds this limit as a requirement.

    Raises:
        DomainError: the speed exceeds the shear wave speed, a point lies on a node, or a number is outside its domain.
        InputError: the profile is invalid, or the soil lacks elastic constants.
    """
    state = medium(soil, speed)
    found, side = _potentials_at(x, y, profile, state)
    upper = stress_of(found, state)
    return replace(upper, xy=side * upper.xy)


@medium_law
def wedge_gradient(x: Expression, y: Expression, profile: Profile, soil: Soil, speed: Expression) -> WedgeGradient:
    """Return the displacement gradient around a thin wedge; arguments and errors are those of `wedge_stress`.

    The displacement ux itself is determined only up to a constant, which has no natural value for an open body.
    """
    state = medium(soil, speed)
    found, side = _potentials_at(x, y, profile, state)
    alpha, eta = state.alpha, state.eta
    slip = 2.0 * found.p_change + found.p
    return WedgeGradient(
        ux_x=-(2.0 * alpha * eta * found.q_change + (2.0 * state.product - 1.0) * found.q) / alpha,
        ux_y=side * (slip - 2.0 * (found.p + state.m * found.p_change)),
        uy_x=side * slip,
        uy_y=2.0 * eta * found.q_change + (2.0 * state.slowing - alpha) * found.q,
    )


@medium_law
def wedge_displacement(x: Expression, y: Expression, profile: Profile, soil: Soil, speed: Expression) -> Expression:
    """Return the displacement uy around a thin wedge [m]; arguments and errors are those of `wedge_stress`.

    On the face it equals the half thickness; far ahead it vanishes.
    """
    state = medium(soil, speed)
    offsets, y, side, wedge = _place(x, y, profile, state)
    total: Expression = 0.0
    for segment in wedge.segments:
        place = offsets[segment.start], offsets[segment.start + 1], y, segment.length
        (shift,) = _shift(*place, *state.in_order)
        total = total + segment.slope / math.pi * shift
    return side * total


@medium_law
def wedge_pressure(x: Expression, profile: Profile, soil: Soil, speed: Expression) -> Expression:
    """Return the gauge pressure -sigma_yy [Pa] of the soil on the face of a thin wedge.

    Each straight piece contributes mu K (g/pi) ln|X0/X1| with K = -R/(alpha m). The pressure is infinite at the nodes,
    negative near the tip and positive near the shoulder. It vanishes at the Rayleigh speed and changes sign beyond it.

    Args:
        x: distance behind the tip [m], between the first and the last node; a float, an array, or a CasADi column.
        profile: nodes (x, half thickness) [m], or a share, as in `wedge_stress`.
        soil: soil with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s].

    Raises:
        DomainError: as `wedge_stress`, or x is not on the body.
        InputError: as `wedge_stress`.
    """
    state, wedge = medium(soil, speed), body(profile)
    x, _ = points(x, 0.0, wedge, state)
    check_domain("x from the first node", x - wedge.places[0], "m", at_least=0.0, why="the face begins there")
    check_domain("x beyond the last node", x - wedge.places[-1], "m", at_most=0.0, why="the face ends there")
    offsets = wedge.offsets(x)
    check_off_nodes(offsets, 0.0)
    return face_pressure(offsets, wedge, state)


def face_pressure(offsets: list[Expression], wedge: Body, soil: Medium) -> Expression:
    """Return the pressure on the face at distances from the nodes [Pa]."""
    q: Expression = 0.0
    for segment in wedge.segments:
        (log,) = _face_log(offsets[segment.start], offsets[segment.start + 1], segment.length)
        q = q + segment.slope / (2.0 * math.pi) * log
    return -soil.shear_modulus * soil.rayleigh / soil.alpha * q


@one_node
def _face_log(x0: Expression, x1: Expression, length: Expression) -> tuple[Expression, ...]:
    """Return ln(X0^2/X1^2)."""
    return (log_difference(x0**2, x1**2, length * (x0 + x1)),)


def _place(
    x: Expression, y: Expression, profile: Profile, soil: Medium
) -> tuple[list[Expression], Expression, Expression, Body]:
    """Return distances from the nodes, |y|, the sign of y (1 or -1), and the body."""
    wedge = body(profile)
    x, y = points(x, y, wedge, soil)
    side = where(y < 0.0, -1.0, 1.0)
    return wedge.offsets(x), side * y, side, wedge


def _potentials_at(x: Expression, y: Expression, profile: Profile, soil: Medium) -> tuple[Potentials, Expression]:
    """Return the potentials at points on either side, and the sign of y."""
    offsets, y, side, wedge = _place(x, y, profile, soil)
    check_off_nodes(offsets, y)
    return potentials(offsets, y, wedge, soil), side


@one_node
def _shift(
    x0: Expression, x1: Expression, y: Expression, length: Expression, *state: Expression
) -> tuple[Expression, ...]:
    """Return uy of a piece of slope pi, which is the integral of uy_x from far ahead."""
    soil = Ratios(*state)
    m, kappa, alpha, eta, slowing = soil.m, soil.kappa, soil.alpha, soil.eta, soil.slowing
    product, change = alpha * eta * y**2, length * (x0 + x1)

    def turn(x: Expression) -> Expression:
        """Return the difference of the angles of x + i alpha y and x + i eta y, divided by m."""
        return angle_difference(slowing * y * x, x**2 + product + _TINY, m)

    fast0, fast1, slow0, slow1 = (x**2 + (k * y) ** 2 + _TINY for k in (alpha, eta) for x in (x0, x1))
    log_fast = log_difference(fast0, fast1, change)
    log_change = log_difference(fast0 * slow1, slow0 * fast1, -(1.0 - kappa) * y**2 * change, m)
    near_by = x0 * (arctan2(alpha * y, -x0) + 2.0 * turn(x0)) - x1 * (arctan2(alpha * y, -x1) + 2.0 * turn(x1))
    near_by = near_by + y * ((slowing - alpha / 2.0) * log_fast + eta * log_change)

    from_far: Expression = 0.0
    for node, weight in zip(*gauss_legendre(FAR_NODES), strict=True):
        x = x0 - node * length
        from_far = from_far + weight * length * (arctan2(alpha * y, -x) + 2.0 * turn(x))
    far = sqrt(slow0) + sqrt(slow1) > FAR * length
    return (where(far, from_far, near_by),)
