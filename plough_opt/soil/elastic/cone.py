"""The slender cone: equations (3) and (4), and the stresses by Hooke's law, for piecewise-linear profiles.

The body acts as a line of sources s = S' on its axis, so that r u_r = S(x) on a small cylinder around it, with
S = section_factor R^2. With X = x - xi and rho_k^2 = X^2 + k^2 r^2, for k = alpha and eta, the potentials are::

    N_k = 1/2 int s/rho_k dxi,    M_k = -1/(2r) int s (1 + X/rho_k) dxi

The axial displacement is 2 (N_alpha - N_eta)/m - N_alpha + 2 N_eta, the radial one 2 (M_alpha - M_eta)/m - M_alpha.
Differences divided by m are formed without cancellation, in closed form near a piece and by quadrature far from it. The
part S(x)/r of the radial displacement is split off, so that digits are not lost near the axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from plough_opt.core import expressions as ex
from plough_opt.core.checks import LEAST, check_domain
from plough_opt.core.expressions import Expression
from plough_opt.soil.elastic.medium import (
    BELOW_SHEAR_WAVES,
    FAR,
    FAR_NODES,
    Body,
    Medium,
    Profile,
    Ratios,
    Segment,
    body,
    medium,
    medium_law,
    points,
)
from plough_opt.soil.soil import Soil

_Field = TypeVar("_Field")

SECTION_FACTOR = 0.5
"""S/R^2 that conserves the displaced volume; 1 balances the energy. Slender-body theory leaves the choice open."""


@dataclass(frozen=True)
class ConeDisplacement:
    """Displacement of the soil around a cone [m]: along the axis, in the direction of the stream, and radial.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(1e3 * float(po.elastic.cone_displacement(0.1, 0.1, profile, soil, 2.0).axial), 2)
        2.41
    """

    axial: Expression
    radial: Expression


@dataclass(frozen=True)
class ConeStress:
    """Stresses around a cone [Pa], tension positive: along x, radial, circumferential, and shear.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(float(po.elastic.cone_stress(0.1, 0.1, profile, soil, 2.0).rr) / 1e3, 1)
        -55.7
    """

    xx: Expression
    rr: Expression
    tt: Expression
    rx: Expression


def displacement_of(found: ConePotentials, section: Expression, r: Expression, soil: Medium) -> ConeDisplacement:
    """Return the displacement that follows from the potentials and the displaced section S(x)."""
    return ConeDisplacement(axial=found.n + 2.0 * soil.eta**2 * found.n_change, radial=section / r + found.outward)


def stress_of(found: ConePotentials, section: Expression, r: Expression, soil: Medium) -> ConeStress:
    """Return the stresses that follow from the potentials and the displaced section S(x)."""
    mu, hoop = soil.shear_modulus, (section / r + found.outward) / r
    dilatation = soil.stiffening * soil.lateral * found.n_x
    along = found.n_x + 2.0 * soil.eta**2 * found.n_x_change
    # u_x + u_r,r + u_r/r = kappa (1 + eta^2) N_x gives the radial strain.
    radial = soil.kappa * soil.lateral * found.n_x - along - hoop
    return ConeStress(
        xx=mu * (dilatation + 2.0 * along),
        rr=mu * (dilatation + 2.0 * radial),
        tt=mu * (dilatation + 2.0 * hoop),
        rx=2.0 * mu * soil.lateral * found.n_r_change,
    )


def cone_displacement(
    x: Expression,
    r: Expression,
    profile: Profile,
    soil: Soil,
    speed: Expression,
    section_factor: Expression = SECTION_FACTOR,
) -> ConeDisplacement:
    """Return the displacement around a slender cone in steady motion, equations (3) and (4).

    The printed (4) lacks + S(infinity)/(2r), without which an open body would disturb the soil far ahead. The result is
    valid away from the body; at its surface the strains are of order one, too large for linear elasticity.

    Args:
        x: distance behind the tip [m]; a float, an array, or a CasADi column.
        r: distance from the axis [m], above 0, of the same shape.
        profile: nodes (x, radius) [m] from the tip, where the radius is 0; it is constant behind the last node. A
            `Wedge` or `Cone` is replaced by its (equivalent) cone.
        soil: soil with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to below `shear_wave_speed`. For an MX expression a `Design` adds this limit as a
            requirement.
        section_factor: S/R^2 [-]: 1/2 conserves the displaced volume, 1 balances the energy; the theory leaves it open.

    Raises:
        DomainError: the speed is not below the shear wave speed, a point lies on the axis, or a number is outside its
            domain.
        InputError: the profile is invalid, or the soil lacks elastic constants.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> found = po.elastic.cone_displacement(0.1, 0.1, profile, soil, 2.0)
        >>> round(1e3 * float(found.radial), 2)
        2.4
    """
    return _around(displacement_of, x, r, profile, soil, speed, section_factor)


def cone_stress(
    x: Expression,
    r: Expression,
    profile: Profile,
    soil: Soil,
    speed: Expression,
    section_factor: Expression = SECTION_FACTOR,
) -> ConeStress:
    """Return the stresses around a slender cone; arguments, errors and limits are those of `cone_displacement`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> found = po.elastic.cone_stress(0.1, 0.1, profile, soil, 2.0)
        >>> round(float(found.rr) / 1e3, 1)
        -55.7
    """
    return _around(stress_of, x, r, profile, soil, speed, section_factor)


@medium_law
def cone_pressure(
    x: Expression, profile: Profile, soil: Soil, speed: Expression, section_factor: Expression = SECTION_FACTOR
) -> Expression:
    """Return the gauge pressure -sigma_rr [Pa] of the soil on the face of a slender cone.

    It is an order of magnitude only: it is about mu for any slender cone, strains on the face are of order one, and its
    dependence on the speed is of the order that linear elasticity neglects.

    Args:
        x: distance behind the tip [m], between the first and the last node, where the radius is above 0.
        profile: nodes (x, radius) [m], or a share.
        soil: soil with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s].
        section_factor: as in `cone_displacement`.

    Raises:
        DomainError: as `cone_displacement`, or x is not on the body.
        InputError: as `cone_displacement`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> round(float(po.elastic.cone_pressure(0.1, profile, soil, 2.0)) / 1e3, 1)
        3490.8
    """
    check_domain("section factor", section_factor, above=0.0)
    state, cone = state_of(soil, speed), body(profile)
    x, _ = points(x, 0.0, cone, state, section_factor)
    check_domain("x from the first node", x - cone.places[0], "m", above=0.0, why="the face begins there")
    check_domain("x beyond the last node", x - cone.places[-1], "m", at_most=0.0, why="the face ends there")
    radius = cone.height(x)
    check_domain("radius of the cone at x", radius, "m", above=0.0)
    return face_pressure(cone.offsets(x), radius, cone, state, section_factor)


def face_pressure(
    offsets: list[Expression], radius: Expression, cone: Body, soil: Medium, section_factor: Expression
) -> Expression:
    """Return the pressure on the face at distances from the nodes [Pa]."""
    found = potentials(offsets, radius, cone, soil, section_factor)
    return -stress_of(found, displaced(offsets, cone, section_factor), radius, soil).rr


def state_of(soil: Soil, speed: Expression) -> Medium:
    """Return the medium at a speed below the shear wave speed, where the cone's logarithms are finite."""
    state = medium(soil, speed)
    why = "the cone's potentials diverge there"
    check_domain("speed over shear wave speed", state.mach, below=1.0, why=why, inside=BELOW_SHEAR_WAVES)
    return state


@medium_law
def _around(
    field_of: Callable[[ConePotentials, Expression, Expression, Medium], _Field],
    x: Expression,
    r: Expression,
    profile: Profile,
    soil: Soil,
    speed: Expression,
    section_factor: Expression,
) -> _Field:
    """Return a field at points off the axis, computed from the potentials and the displaced section there."""
    check_domain("r", r, "m", above=0.0, at_least=LEAST, why="the axis itself is singular inside the body")
    check_domain("section factor", section_factor, above=0.0)
    state, cone = state_of(soil, speed), body(profile)
    x, r = points(x, r, cone, state, section_factor)
    offsets = cone.offsets(x)
    found = potentials(offsets, r, cone, state, section_factor)
    return field_of(found, displaced(offsets, cone, section_factor), r, state)


# --- potentials of a line of sources ---------------------------------------------------------------------------------


class ConePotentials(NamedTuple):
    """Functions whose linear combinations are the fields of a cone.

    Attributes:
        n: N_alpha.
        n_change: (N_alpha - N_eta)/m.
        n_x: derivative of N_alpha along x.
        n_x_change: derivative of n_change along x.
        n_r_change: derivative of n_change along r.
        outward: u_r - S(x)/r.
    """

    n: Expression
    n_change: Expression
    n_x: Expression
    n_x_change: Expression
    n_r_change: Expression
    outward: Expression


class _Point:
    """Distances of a point from a place on the axis, and their differences over m, without cancellation.

    Attributes:
        distance: |X|. At X = 0 its derivative is that for X > 0, as for the section S(x), so that their kinks cancel.
        fast: rho_alpha.
        slow: rho_eta.
        change: (rho_alpha - rho_eta)/(m r^2).
        inverse_change: (1/rho_alpha - 1/rho_eta)/m.
        beyond_fast: rho_alpha - |X|, in a form that does not cancel near the axis.
        beyond_slow: rho_eta - |X|, likewise.
    """

    def __init__(self, x: Expression, r: Expression, soil: Ratios) -> None:
        self.x, self.r, self.soil = x, r, soil
        wide, narrow = (soil.alpha * r) ** 2, (soil.eta * r) ** 2
        self.distance = ex.where(x < 0.0, -x, x)
        self.fast, self.slow = ex.sqrt(x**2 + wide), ex.sqrt(x**2 + narrow)
        self.change = (1.0 - soil.kappa) / (self.fast + self.slow)
        self.inverse_change = -(r**2) * self.change / (self.fast * self.slow)
        self.beyond_fast, self.beyond_slow = wide / (self.fast + self.distance), narrow / (self.slow + self.distance)

    @property
    def scaled_inverse_change(self) -> Expression:
        """(alpha^2/rho_alpha - eta^2/rho_eta)/m."""
        return (1.0 - self.soil.kappa) / self.fast + self.soil.eta**2 * self.inverse_change

    @property
    def gap(self) -> Expression:
        """2 (rho_alpha - rho_eta)/(m r^2) - (rho_alpha - |X|)/r^2."""
        upper = (2.0 * self.distance + self.beyond_fast) * _stiffness(self.soil)
        upper = upper - self.soil.alpha**2 * self.beyond_slow
        return upper / ((self.fast + self.slow) * (self.fast + self.distance))


def _stiffness(soil: Ratios) -> Expression:
    """Return 2 (1 - kappa) - alpha^2 = 1 - 2 kappa + kappa m, which does not cancel."""
    return soil.stiffening + soil.kappa * soil.m


def sources(segment: Segment, section_factor: Expression) -> tuple[Expression, Expression]:
    """Return S' [m] at the first node of a piece and its slope along x [-]."""
    slope = 2.0 * section_factor * segment.slope
    return slope * segment.first, slope * segment.slope


def potentials(
    offsets: list[Expression], r: Expression, cone: Body, soil: Medium, section_factor: Expression
) -> ConePotentials:
    """Return the potentials of a cone.

    Args:
        offsets: distances from the nodes along the axis [m].
        r: distance from the axis [m].
        cone: the body.
        soil: the medium.
        section_factor: S/R^2 [-].
    """
    pieces = [
        _piece(x0, x1, r, piece.length, *sources(piece, section_factor), *soil.in_order)
        for piece, x0, x1 in cone.pieces(offsets)
    ]
    return ConePotentials(*map(sum, zip(*pieces, strict=True)))


@ex.one_node
def _piece(
    x0: Expression,
    x1: Expression,
    r: Expression,
    length: Expression,
    at_first: Expression,
    slope: Expression,
    *state: Expression,
) -> tuple[Expression, ...]:
    """Return the potentials of one piece: in closed form near it, by quadrature far from it.

    Args:
        x0: distance from its first node along the axis [m].
        x1: distance from its second node [m].
        r: distance from the axis [m].
        length: length of the piece [m].
        at_first: source S' at the first node [m].
        slope: slope of the source [-].
        state: the numbers of `Ratios`.
    """
    soil = Ratios(*state)
    first, last = _Point(x0, r, soil), _Point(x1, r, soil)
    far = first.slow + last.slow > FAR * length
    source = at_first, slope
    near = _near(first, last, source)
    # As on the face, where the quadrature would take nearly all the time.
    if not ex.is_symbolic(far) and not np.any(ex.as_number(far)):
        return near
    return tuple(ex.where(far, *pair) for pair in zip(_far(first, last, length, source), near, strict=True))


def _near(first: _Point, last: _Point, source: tuple[Expression, Expression]) -> ConePotentials:
    """Return the potentials of a piece in closed form."""
    at_first, slope = source
    soil, r = first.soil, first.r
    here = at_first + slope * first.x
    at_last = here - slope * last.x
    log, log_change = _logarithm(first, last)
    inverse = first.inverse_change, last.inverse_change
    scaled = first.scaled_inverse_change - last.scaled_inverse_change
    moments = last.x * last.gap - first.x * first.gap + _stiffness(soil) * log + 2.0 * soil.eta**2 * log_change
    return ConePotentials(
        n=(here * log - slope * (first.fast - last.fast)) / 2.0,
        n_change=(here * log_change - slope * r**2 * (first.change - last.change)) / 2.0,
        n_x=(slope * log + at_first / first.fast - at_last / last.fast) / 2.0,
        n_x_change=(slope * log_change + at_first * inverse[0] - at_last * inverse[1]) / 2.0,
        n_r_change=-(here / r * (first.x * inverse[0] - last.x * inverse[1]) + slope * r * scaled) / 2.0,
        outward=r / 2.0 * (here * (last.gap - first.gap) - slope * moments / 2.0),
    )


def _logarithm(first: _Point, last: _Point) -> tuple[Expression, Expression]:
    """Return ln((X0 + rho0)/(X1 + rho1)) for alpha, and its difference from that for eta divided by m."""
    soil, r = first.soil, first.r
    log = ex.arcsinh(first.x / (soil.alpha * r)) - ex.arcsinh(last.x / (soil.alpha * r))
    shift = (1.0 - soil.kappa) / (soil.alpha * soil.eta)
    z0, z1 = (shift * point.x / (point.fast + point.slow) for point in (first, last))
    root0, root1 = (ex.sqrt(1.0 + (soil.m * z) ** 2) for z in (z0, z1))
    # Beside the piece the terms of z0 root1 - z1 root0 nearly cancel; use the difference of their squares instead.
    beside = first.x * last.x > 0.0
    crossings = (
        k**2 / ex.where(beside, first.x * last_rho + last.x * first_rho, 1.0)
        for k, first_rho, last_rho in ((soil.alpha, first.fast, last.fast), (soil.eta, first.slow, last.slow))
    )
    span = (first.x - last.x) * (first.x + last.x) * r**2
    apart = shift * span * sum(crossings) / ((first.fast + first.slow) * (last.fast + last.slow))
    alike = apart * (z0 + z1) / ex.where(beside, z0 * root1 + z1 * root0, 1.0)
    turn = ex.where(beside, alike, z0 * root1 - z1 * root0)
    return log, -turn * ex.arcsinh_ratio(soil.m * turn)


def _far(first: _Point, last: _Point, length: Expression, source: tuple[Expression, Expression]) -> ConePotentials:
    """Return the potentials of a piece by Gauss-Legendre quadrature."""
    at_first, slope = source
    soil, r = first.soil, first.r
    above = (first.x >= 0.0) * (last.x < 0.0)
    total = ConePotentials(*[0.0] * 6)
    for node, weight in zip(*ex.gauss_legendre(FAR_NODES), strict=True):
        point = _Point(first.x - node * length, r, soil)
        cubed = 1.0 / point.fast**2 + 1.0 / (point.fast * point.slow) + 1.0 / point.slow**2
        cubed_change = point.inverse_change * cubed
        share = length * weight * (at_first + slope * node * length) / 2.0
        side = ex.where(point.x < 0.0, -1.0, 1.0)
        # Above the piece use the whole of u_r; ahead of and behind it, u_r - S/r.
        radial = (
            ex.where(point.x < 0.0, point.beyond_fast, point.fast + point.x) / (r * point.fast)
            - 2.0 * point.x * point.inverse_change / r
        )
        kernel = ConePotentials(
            n=1.0 / point.fast,
            n_change=point.inverse_change,
            n_x=-point.x / point.fast**3,
            n_x_change=-point.x * cubed_change,
            n_r_change=-r * ((1.0 - soil.kappa) / point.fast**3 + soil.eta**2 * cubed_change),
            outward=ex.where(above, radial, side * _outward(point)),
        )
        total = ConePotentials(*(a + share * b for a, b in zip(total, kernel, strict=True)))
    passed = _passed(first.x, last.x, length, source)
    return total._replace(outward=total.outward + ex.where(above, -passed / r, 0.0))


def _passed(x0: Expression, x1: Expression, length: Expression, source: tuple[Expression, Expression]) -> Expression:
    """Return the contribution of a piece to S(x), given the distances from its ends."""
    over = ex.where(x0 < 0.0, 0.0, ex.where(x1 < 0.0, x0, length))
    return over * (source[0] + source[1] * over / 2.0)


def _outward(point: _Point) -> Expression:
    """Return the kernel of u_r - S/r behind a source; ahead of the source it has the opposite sign."""
    distance, fast, slow = point.distance, point.beyond_fast, point.beyond_slow
    upper = _stiffness(point.soil) * distance * (2.0 * distance + fast)
    upper = upper - point.soil.alpha**2 * slow * (3.0 * distance + fast + slow)
    return point.r * upper / (point.fast * point.slow * (point.fast + point.slow) * (point.fast + distance))


def displaced(offsets: list[Expression], cone: Body, section_factor: Expression) -> Expression:
    """Return S(x) = section_factor R^2 [m^2] at distances from the nodes."""
    pieces = cone.pieces(offsets)
    return sum(_passed(x0, x1, piece.length, sources(piece, section_factor)) for piece, x0, x1 in pieces)
