"""Thin wedges in an elastic soil: stresses around them, and the contact force, with friction and loss of contact.

Forces follow from the gauge pressure p, as in equation (24); the ambient pressure p_a only determines where contact is
lost, because the soil would be in tension. With the weight w dx of an element of the face::

    F = int p w dx - int over {p + p_a < 0} of (p + p_a) w dx

This truncates the solution in which the soil adheres to the face. The true problem, with a crack ahead and a cavity
behind, is a mixed boundary value problem that the source's formulas do not cover, so the force is an estimate.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from plough_opt.core import expressions as ex
from plough_opt.core.checks import check_domain, check_single, check_switch
from plough_opt.core.expressions import Expression
from plough_opt.soil.elastic import cone as cones
from plough_opt.soil.elastic.medium import (
    FAR,
    FAR_NODES,
    Body,
    Medium,
    Profile,
    Ratios,
    Segment,
    angle_difference,
    body,
    check_off_nodes,
    log_difference,
    medium,
    medium_law,
    points,
)
from plough_opt.soil.soil import Soil

# Added to squared distances, so that y ln(distance from a node) is 0 on the node itself.
_TINY = 1e-300
# Each half of a straight piece is parametrised as x = node +- (length/2) exp(-tau). The pressure, logarithmic at the
# node, is nearly linear in tau, so a few cells with a few nodes suffice.
_CELLS = (0.0, 1.0, 2.5, 5.0, 9.0, 15.0, 24.0, 38.0)
Pair = tuple[Expression, Expression]
Curve = Callable[[Expression], Expression]


@dataclass(frozen=True)
class WedgeStress:
    """Stresses around a thin wedge [Pa], tension positive: x along the motion, y across, z along the edge.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(float(po.elastic.wedge_stress(0.1, 0.1, profile, soil, 2.0).yy) / 1e3, 1)
        155.3
    """

    xx: Expression
    yy: Expression
    xy: Expression
    zz: Expression


@dataclass(frozen=True)
class WedgeGradient:
    """Gradient of the displacement (ux, uy) around a thin wedge [-].

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> type(po.elastic.wedge_gradient(0.1, 0.1, profile, soil, 2.0)).__name__
        'WedgeGradient'
    """

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
    pieces = [
        [piece.slope / math.pi * value for value in _piece(x0, x1, y, piece.length, *soil.in_order)]
        for piece, x0, x1 in wedge.pieces(offsets)
    ]
    return Potentials(*map(sum, zip(*pieces, strict=True)))


@ex.one_node
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
        ex.arctan2(alpha * y * length, (alpha * y) ** 2 + x0 * x1),
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

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(float(po.elastic.wedge_stress(0.1, 0.1, profile, soil, 2.0).yy) / 1e3, 1)
        155.3
    """
    state = medium(soil, speed)
    found, side = _potentials_at(x, y, profile, state)
    upper = stress_of(found, state)
    return replace(upper, xy=side * upper.xy)


@medium_law
def wedge_gradient(x: Expression, y: Expression, profile: Profile, soil: Soil, speed: Expression) -> WedgeGradient:
    """Return the displacement gradient around a thin wedge; arguments and errors are those of `wedge_stress`.

    The displacement ux itself is determined only up to a constant, which has no natural value for an open body.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> gradient = po.elastic.wedge_gradient(0.1, 0.1, profile, soil, 2.0)
        >>> type(gradient).__name__
        'WedgeGradient'
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

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(1e3 * float(po.elastic.wedge_displacement(0.1, 0.1, profile, soil, 2.0)), 2)
        21.01
    """
    state = medium(soil, speed)
    offsets, y, side, wedge = _place(x, y, profile, state)
    upper: Expression = sum(
        piece.slope / math.pi * _shift(x0, x1, y, piece.length, *state.in_order)[0]
        for piece, x0, x1 in wedge.pieces(offsets)
    )
    return side * upper


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

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(float(po.elastic.wedge_pressure(0.1, profile, soil, 2.0)) / 1e3, 1)
        -144.7
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
    pieces = wedge.pieces(offsets)
    q: Expression = sum(piece.slope / (2.0 * math.pi) * _face_log(x0, x1, piece.length)[0] for piece, x0, x1 in pieces)
    return -soil.shear_modulus * soil.rayleigh / soil.alpha * q


@ex.one_node
def _face_log(x0: Expression, x1: Expression, length: Expression) -> tuple[Expression, ...]:
    """Return ln(X0^2/X1^2)."""
    return (log_difference(x0**2, x1**2, length * (x0 + x1)),)


def _place(
    x: Expression, y: Expression, profile: Profile, soil: Medium
) -> tuple[list[Expression], Expression, Expression, Body]:
    """Return distances from the nodes, |y|, the sign of y (1 or -1), and the body."""
    wedge = body(profile)
    x, y = points(x, y, wedge, soil)
    side = ex.where(y < 0.0, -1.0, 1.0)
    return wedge.offsets(x), side * y, side, wedge


def _potentials_at(x: Expression, y: Expression, profile: Profile, soil: Medium) -> tuple[Potentials, Expression]:
    """Return the potentials at points on either side, and the sign of y."""
    offsets, y, side, wedge = _place(x, y, profile, soil)
    check_off_nodes(offsets, y)
    return potentials(offsets, y, wedge, soil), side


@ex.one_node
def _shift(
    x0: Expression, x1: Expression, y: Expression, length: Expression, *state: Expression
) -> tuple[Expression, ...]:
    """Return uy of a piece of slope pi, which is the integral of uy_x from far ahead."""
    soil = Ratios(*state)
    m, kappa, alpha, eta, slowing = soil.m, soil.kappa, soil.alpha, soil.eta, soil.slowing
    product, change = alpha * eta * y**2, length * (x0 + x1)

    def angle(x: Expression) -> Expression:
        """Return that of -x + i alpha y, and twice the difference of those of x + i alpha y and x + i eta y over m."""
        return ex.arctan2(alpha * y, -x) + 2.0 * angle_difference(slowing * y * x, x**2 + product + _TINY, m)

    fast0, fast1, slow0, slow1 = (x**2 + (k * y) ** 2 + _TINY for k in (alpha, eta) for x in (x0, x1))
    log_fast = log_difference(fast0, fast1, change)
    log_change = log_difference(fast0 * slow1, slow0 * fast1, -(1.0 - kappa) * y**2 * change, m)
    near_by = x0 * angle(x0) - x1 * angle(x1)
    near_by = near_by + y * ((slowing - alpha / 2.0) * log_fast + eta * log_change)
    nodes = zip(*ex.gauss_legendre(FAR_NODES), strict=True)
    from_far = sum(weight * length * angle(x0 - node * length) for node, weight in nodes)
    far = ex.sqrt(slow0) + ex.sqrt(slow1) > FAR * length
    return (ex.where(far, from_far, near_by),)


@dataclass(frozen=True)
class _Half:
    """Half of a straight piece of a face, from one of its nodes to its middle.

    Attributes:
        body: the body.
        segment: the piece.
        node: index of the node.
        towards: 1 if the half lies behind the node, -1 if ahead.
    """

    body: Body
    segment: Segment
    node: int
    towards: float

    def distance(self, tau: Expression) -> Expression:
        """Return the distance from the node [m]."""
        return self.segment.length / 2.0 * ex.exp(-tau)

    def offsets(self, tau: Expression) -> list[Expression]:
        """Return the distances from all nodes [m]; the distance from its own node is accurate to rounding."""
        own = self.body.places[self.node]
        return [(own - place) + self.towards * self.distance(tau) for place in self.body.places]

    def height(self, tau: Expression) -> Expression:
        """Return the half thickness or radius [m]."""
        return self.body.heights[self.node] + self.towards * self.segment.slope * self.distance(tau)


def _halves(face: Body) -> Iterator[_Half]:
    """Yield the halves of all pieces."""
    for segment in face.segments:
        yield _Half(face, segment, segment.start, 1.0)
        yield _Half(face, segment, segment.start + 1, -1.0)


Field = Callable[[_Half, Expression], Expression]
"""Pressure [Pa] or weight of a half as a function of tau."""


def _ends(symbolic: bool) -> Pair:
    """Return the start and end of each cell of a half in tau."""
    cells = np.array(_CELLS)
    return ex.column(cells[:-1], symbolic), ex.column(cells[1:], symbolic)


def _over(half: _Half, first: Expression, last: Expression, pressure: Field, weight: Field) -> Expression:
    """Return int p w dx along the face over parts of the cells, from first to last in tau."""
    value: Expression = 0.0
    for node, share in zip(*ex.gauss_legendre(12), strict=True):
        tau = first + (last - first) * node
        value = value + share * (last - first) * half.distance(tau) * (pressure(half, tau) * weight(half, tau))
    return ex.total(value)


def _lost(face: Body, pressure: Field, weight: Field, symbolic: bool) -> Expression:
    """Return -int p w dx over the part of the face where the absolute pressure p is negative."""
    first, last = _ends(symbolic)
    total: Expression = 0.0
    for half in _halves(face):
        along = partial(pressure, half)
        for begin, end in _monotonic(along, (first, last), len(face.segments)):
            at_begin, at_end = along(begin), along(end)
            turn = _root(along, (begin, end), (at_begin, at_end))
            turn = ex.where((at_begin < 0.0) != (at_end < 0.0), turn, end)
            lost_from, lost_to = ex.where(at_begin < 0.0, begin, turn), ex.where(at_begin < 0.0, turn, end)
            total = total - _over(half, lost_from, lost_to, pressure, weight)
    return total


def _monotonic(function: Curve, ends: Pair, pieces: int) -> list[Pair]:
    """Return parts of each cell in which the pressure changes sign at most once.

    On a face with several pieces the pressure has an extremum between two shoulders, and may change sign on either side
    of it. The cell is split there. Finite differences are accurate enough, because the split need only separate the two
    changes of sign.
    """
    if pieces == 1:
        return [ends]
    step = 1e-3 * (ends[1] - ends[0])

    def slope(tau: Expression) -> Expression:
        return function(tau + step) - function(tau - step)

    at_first, at_last = slope(ends[0]), slope(ends[1])
    top = ex.where(at_first * at_last < 0.0, _root(slope, ends, (at_first, at_last)), ends[1])
    return [(ends[0], top), (top, ends[1])]


def _root(function: Curve, ends: Pair, values: Pair) -> Expression:
    """Return where a function changes sign between two ends, by the Illinois variant of regula falsi."""
    low, high = ends
    at_low, at_high = values
    guess = low
    for _ in range(9):  # in these nearly linear cells they reach rounding
        span = at_high - at_low
        # Both values are zero once the root is found to all digits.
        open_ = ex.absolute(span) > 0.0
        crossing = ex.where(open_, (low * at_high - high * at_low) / ex.where(open_, span, 1.0), high)
        # In cells without a change of sign the guess has no meaning, but must stay finite.
        guess = ex.minimum(ex.maximum(crossing, ends[0]), ends[1])
        found = function(guess)
        same = found * at_high > 0.0
        # Halving the value at the retained end makes that end move too.
        low, at_low = ex.where(same, low, high), ex.where(same, at_low / 2.0, at_high)
        high, at_high = guess, found
    return guess


@medium_law
def wedge_force(profile: Profile, soil: Soil, speed: Expression, *, separation: bool = True) -> Expression:
    """Return the contact force on both faces of a thin wedge, friction included [N per metre of its width].

    Use MX symbols: an SX graph holds every operation of the quadrature and takes minutes to differentiate. If the soil
    adhered to the face, the pressure drag would be zero for every profile, because no energy is radiated below the
    shear wave speed, and so would be the friction of a single straight wedge. The force therefore comes from the
    compressed part of the face after the rest has separated. For a straight wedge of slope t and length l it is
    2 (t + mu0) l A ln(1 + exp(-p_a/A)) with A = mu abs(K) t/pi.

    Args:
        profile: nodes (x, half thickness) [m], or a share, as in `wedge_stress`.
        soil: soil whose elastic constants, density, tool friction and ambient pressure are used.
        speed: V0 [m/s].
        separation: whether the soil separates from the face where it would be in tension.

    Raises:
        DomainError: as `wedge_stress`.
        InputError: as `wedge_stress`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(float(po.elastic.wedge_force(profile, soil, 2.0)) / 1e3, 1)
        70.1
    """
    check_switch("separation", separation)
    state, face = medium(soil, speed), body(profile)
    check_single("the contact force of the elastic medium", (face, soil, speed))
    force = 2.0 * soil.tool_friction * _face_integral(face, state)
    if separation:
        ambient = soil.ambient_pressure

        def pressure(half: _Half, tau: Expression) -> Expression:
            return face_pressure(half.offsets(tau), face, state) + ambient

        def weight(half: _Half, _tau: Expression) -> Expression:
            return half.segment.slope + soil.tool_friction

        force = force + 2.0 * _lost(face, pressure, weight, ex.holds_casadi((face, soil, speed)))
    return force


def _face_integral(face: Body, state: Medium) -> Expression:
    """Return int p dx over one face of a wedge [N/m]; exactly 0 for a single straight piece."""

    def moment(node: int, end: int) -> Expression:
        distance = face.places[end] - face.places[node]
        return 0.0 if node == end else distance * ex.log(ex.absolute(distance))

    first, last = 0, len(face.places) - 1
    total: Expression = 0.0
    for segment in face.segments:
        k = segment.start
        change = moment(k, last) - moment(k, first) - moment(k + 1, last) + moment(k + 1, first)
        total = total + segment.slope / math.pi * change
    return -state.shear_modulus * state.rayleigh / state.alpha * total


@medium_law
def cone_force(
    profile: Profile,
    soil: Soil,
    speed: Expression,
    *,
    section_factor: Expression = cones.SECTION_FACTOR,
    separation: bool = True,
) -> Expression:
    """Return the contact force on a slender cone, friction included [N], equation (24) with the elastic pressure.

    Use MX symbols, as for `wedge_force`.

    The result is an order of magnitude: without friction it is about pi mu (t l)^2 for a cone of slope t and length l
    with the default section factor, and twice that for a factor of 1. Its dependence on the speed is of the order that
    linear elasticity neglects.

    Args:
        profile: nodes (x, radius) [m], or a share, as in `cone_displacement`; only the first and the last radius
            may be 0.
        soil: soil whose elastic constants, density, tool friction and ambient pressure are used.
        speed: V0 [m/s], below the shear wave speed.
        section_factor: as in `cone_displacement`.
        separation: whether the soil separates from the face where it would be in tension.

    Raises:
        DomainError: as `cone_displacement`, or the body has radius 0.
        InputError: as `cone_displacement`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.elastic.cone_force(po.Cone('10 deg', '25 cm'), soil, 2.0)) / 1e3, 1)
        87.2
    """
    check_switch("separation", separation)
    check_domain("section factor", section_factor, above=0.0)
    state, face = cones.state_of(soil, speed), body(profile)
    check_single("the contact force of the elastic medium", (face, soil, speed, section_factor))
    for radius in face.heights[1:-1] or face.heights[-1:]:
        check_domain("radius at a node between the first and the last", radius, "m", above=0.0)
    symbolic = ex.holds_casadi((face, soil, speed, section_factor))

    def pressure(half: _Half, tau: Expression) -> Expression:
        return cones.face_pressure(half.offsets(tau), half.height(tau), face, state, section_factor)

    def absolute_pressure(half: _Half, tau: Expression) -> Expression:
        return pressure(half, tau) + soil.ambient_pressure

    def weight(half: _Half, tau: Expression) -> Expression:
        return 2.0 * math.pi * (half.segment.slope + soil.tool_friction) * half.height(tau)

    force: Expression = sum(_over(half, *_ends(symbolic), pressure, weight) for half in _halves(face))
    if separation:
        force = force + _lost(face, absolute_pressure, weight, symbolic)
    return force
