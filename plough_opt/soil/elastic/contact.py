"""Contact force of the elastic medium with friction, and with loss of contact where the soil would be in tension.

Forces follow from the gauge pressure p, as in equation (24); the ambient pressure p_a only determines where contact is
lost. With the weight w dx of an element of the face::

    F = int p w dx - int over {p + p_a < 0} of (p + p_a) w dx

This truncates the solution in which the soil adheres to the face. The true problem, with a crack ahead and a cavity
behind, is a mixed boundary value problem that the source's formulas do not cover, so the force is an estimate.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from plough_opt.core.checks import check_domain, check_single, check_switch
from plough_opt.core.expressions import (
    Expression,
    absolute,
    column,
    exp,
    gauss_legendre,
    holds_casadi,
    log,
    maximum,
    minimum,
    total,
    where,
)
from plough_opt.soil.elastic import cone as cones
from plough_opt.soil.elastic import wedge as wedges
from plough_opt.soil.elastic.medium import Medium, medium, medium_law
from plough_opt.soil.elastic.profile import Body, Profile, Segment, body
from plough_opt.soil.soil import Soil

# Each half of a straight piece is parametrised as x = node +- (length/2) exp(-tau). The pressure, logarithmic at the
# node, is nearly linear in tau, so a few cells with a few nodes suffice.
_CELLS = (0.0, 1.0, 2.5, 5.0, 9.0, 15.0, 24.0, 38.0)
_ORDER = 12
# Regula falsi steps for a change of sign in a cell; in these nearly linear cells they reach rounding.
_ROOT_STEPS = 9


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
        return self.segment.length / 2.0 * exp(-tau)

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


Pair = tuple[Expression, Expression]
Curve = Callable[[Expression], Expression]
Field = Callable[[_Half, Expression], Expression]
"""Pressure [Pa] or weight of a half as a function of tau."""


def _ends(symbolic: bool) -> Pair:
    """Return the start and end of each cell of a half in tau."""
    cells = np.array(_CELLS)
    return column(cells[:-1], symbolic), column(cells[1:], symbolic)


def _over(half: _Half, first: Expression, last: Expression, integrand: Field) -> Expression:
    """Return the integral along the face over parts of the cells, from first to last in tau."""
    value: Expression = 0.0
    for node, weight in zip(*gauss_legendre(_ORDER), strict=True):
        tau = first + (last - first) * node
        value = value + weight * (last - first) * half.distance(tau) * integrand(half, tau)
    return total(value)


def _lost(face: Body, pressure: Field, weight: Field, symbolic: bool) -> Expression:
    """Return -int p w dx over the part of the face where the absolute pressure p is negative."""
    first, last = _ends(symbolic)
    total: Expression = 0.0
    for half in _halves(face):
        along = partial(pressure, half)
        for begin, end in _monotonic(along, (first, last), len(face.segments)):
            at_begin, at_end = along(begin), along(end)
            turn = _root(along, (begin, end), (at_begin, at_end))
            turn = where((at_begin < 0.0) != (at_end < 0.0), turn, end)
            lost_from, lost_to = where(at_begin < 0.0, begin, turn), where(at_begin < 0.0, turn, end)
            total = total - _over(half, lost_from, lost_to, lambda part, tau: pressure(part, tau) * weight(part, tau))
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
    top = where(at_first * at_last < 0.0, _root(slope, ends, (at_first, at_last)), ends[1])
    return [(ends[0], top), (top, ends[1])]


def _root(function: Curve, ends: Pair, values: Pair) -> Expression:
    """Return where a function changes sign between two ends, by the Illinois variant of regula falsi."""
    low, high = ends
    at_low, at_high = values
    guess = low
    for _ in range(_ROOT_STEPS):
        span = at_high - at_low
        # Both values are zero once the root is found to all digits.
        open_ = absolute(span) > 0.0
        crossing = where(open_, (low * at_high - high * at_low) / where(open_, span, 1.0), high)
        # In cells without a change of sign the guess has no meaning, but must stay finite.
        guess = minimum(maximum(crossing, ends[0]), ends[1])
        found = function(guess)
        same = found * at_high > 0.0
        # Halving the value at the retained end makes that end move too.
        low, at_low = where(same, low, high), where(same, at_low / 2.0, at_high)
        high, at_high = guess, found
    return guess


@medium_law
def wedge_force(profile: Profile, soil: Soil, speed: Expression, *, separation: bool = True) -> Expression:
    """Return the contact force on both faces of a thin wedge, friction included [N per metre of its width].

    Use MX symbols: an SX graph holds every operation of the quadrature and takes minutes to differentiate. If the soil
    adhered to the face, the pressure drag would be zero for every profile, because no energy is radiated below the
    shear wave speed, and so would be the friction of a single straight wedge. The force therefore comes from the
    compressed part of the face after the rest has separated. For a straight wedge of slope t and length l it is
    2 (t + mu0) l A ln(1 + exp(-p_a/A)) with A = mu |K| t/pi.

    Args:
        profile: nodes (x, half thickness) [m], or a share, as in `wedge_stress`.
        soil: soil whose elastic constants, density, tool friction and ambient pressure are used.
        speed: V0 [m/s].
        separation: whether the soil separates from the face where it would be in tension.

    Raises:
        DomainError: as `wedge_stress`.
        InputError: as `wedge_stress`.
    """
    check_switch("separation", separation)
    state, face = medium(soil, speed), body(profile)
    check_single("the contact force of the elastic medium", (face, soil, speed))
    force = 2.0 * soil.tool_friction * _face_integral(face, state)
    if separation:
        ambient = soil.ambient_pressure

        def pressure(half: _Half, tau: Expression) -> Expression:
            return wedges.face_pressure(half.offsets(tau), face, state) + ambient

        def weight(half: _Half, _tau: Expression) -> Expression:
            return half.segment.slope + soil.tool_friction

        force = force + 2.0 * _lost(face, pressure, weight, holds_casadi((face, soil, speed)))
    return force


def _face_integral(face: Body, state: Medium) -> Expression:
    """Return int p dx over one face of a wedge [N/m]; exactly 0 for a single straight piece."""

    def moment(node: int, end: int) -> Expression:
        distance = face.places[end] - face.places[node]
        return 0.0 if node == end else distance * log(absolute(distance))

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
    """
    check_switch("separation", separation)
    check_domain("section factor", section_factor, above=0.0)
    state, face = cones.state_of(soil, speed), body(profile)
    check_single("the contact force of the elastic medium", (face, soil, speed, section_factor))
    for radius in face.heights[1:-1] or face.heights[-1:]:
        check_domain("radius at a node between the first and the last", radius, "m", above=0.0)
    symbolic = holds_casadi((face, soil, speed, section_factor))

    def pressure(half: _Half, tau: Expression) -> Expression:
        return cones.face_pressure(half.offsets(tau), half.height(tau), face, state, section_factor)

    def absolute_pressure(half: _Half, tau: Expression) -> Expression:
        return pressure(half, tau) + soil.ambient_pressure

    def weight(half: _Half, tau: Expression) -> Expression:
        return 2.0 * math.pi * (half.segment.slope + soil.tool_friction) * half.height(tau)

    force: Expression = 0.0
    for half in _halves(face):
        force = force + _over(half, *_ends(symbolic), lambda part, tau: pressure(part, tau) * weight(part, tau))
    if separation:
        force = force + _lost(face, absolute_pressure, weight, symbolic)
    return force
