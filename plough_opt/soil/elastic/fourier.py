"""The Fourier integrals of equations (1)-(4), by quadrature, for a profile of any form.

They are an independent method for the fields of the wedge and the cone, and the one for profiles
that are not straight. They need numbers; a design uses the closed forms with `knots` on its profile.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain, check_single
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, expm1_ratio, gauss_legendre, holds_casadi, is_count
from plough_opt.soil.elastic import cone as cones
from plough_opt.soil.elastic import wedge as wedges
from plough_opt.soil.elastic.medium import Medium, medium
from plough_opt.soil.soil import Soil

Array = NDArray[np.float64]
Curve = Callable[[float], float]

ORDER = 12
"""Default number of Gauss-Legendre nodes in a panel, which one wave of the integrand crosses."""

# exp(-36) is the rounding error of the largest term.
_DECAY = 36.0
_MOST_NODES = 40_000_000
# Panels towards p = 0, where the Bessel functions are logarithmic, each half as wide as the one before.
_GRADED = 44
# Below this m the difference of two Bessel functions over m is computed as their mean slope.
_SLOW = 0.2
_SLOPE_NODES = 10


@dataclass(frozen=True)
class _Places:
    """Points beside a body in the medium that streams past.

    Attributes:
        medium: the soil at a speed.
        at: the points as rows (x, distance from the axis) [m].
        shape: of the points as they were given.
        length: of the body [m].
        order: Gauss-Legendre nodes in a panel.
    """

    medium: Medium
    at: Array
    shape: tuple[int, ...]
    length: float
    order: int

    def shaped(self, columns: Array) -> list[Expression]:
        """Return columns over the points in the points' shape, as floats for a single point."""
        return [column.reshape(self.shape) if self.shape else float(column[0]) for column in columns.T]


@dataclass(frozen=True)
class _Spectrum:
    """A transform of the profile on the nodes of the quadrature over the wave number.

    Attributes:
        p: wave numbers [1/m], above 0.
        weights: of the quadrature [1/m].
        transform: of the profile's slope, (2 pi)^-1/2 int h' exp(i p x) dx, or of S'.
    """

    p: Array
    weights: Array
    transform: NDArray[np.complex128]

    def at(self, x: float) -> NDArray[np.complex128]:
        """Return sqrt(2/pi) weight transform exp(-i p x): the part of the integrand that depends on the place."""
        wave: NDArray[np.complex128] = np.exp(-1j * self.p * x)
        return math.sqrt(2.0 / math.pi) * self.weights * self.transform * wave


def wedge_stress(
    x: Expression, y: Expression, profile: Curve, length: float, soil: Soil, speed: float, order: int = ORDER
) -> wedges.WedgeStress:
    """Return the stresses around a thin wedge of any profile by J1 and J2, equations (1) and (2) corrected.

    Args:
        x: behind the tip [m]; a float or an array.
        y: across [m], above 0, of the same shape; the cost grows with 1/y.
        profile: half thickness [m] at a distance [m] behind the tip, 0 at 0; a smooth function of a number.
        length: of the profile [m]; behind it the body keeps its thickness.
        soil: with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to below the shear wave's.
        order: Gauss-Legendre nodes in a panel, which one wave crosses; the error falls exponentially with it.

    Raises:
        DomainError: a number outside its domain, or a point so near that the quadrature would be too long.
        InputError: symbols, or a soil without elastic constants.
    """
    places = _places(x, y, length, soil, speed, order)
    spectrum, state = _spectrum(profile, places, graded=False), places.medium
    p, c = spectrum.p, state.slowing
    found = np.empty((len(places.at), 4))
    for k, (xk, yk) in enumerate(places.at):
        wave = spectrum.at(xk)
        fast, slow = np.exp(-p * state.alpha * yk), np.exp(-p * state.eta * yk)
        # exp(-p alpha y) - exp(-p eta y), over m: alpha - eta = m c.
        change = -p * c * yk * slow * expm1_ratio(-p * state.m * c * yk)
        found[k] = [
            -wave.imag @ fast,
            -wave.imag @ change,
            wave.real @ fast,
            -(wave.real @ change),
        ]
    return wedges.stress_of(wedges.Potentials(*places.shaped(found)), state)


def cone_displacement(
    x: Expression,
    r: Expression,
    profile: Curve,
    length: float,
    soil: Soil,
    speed: float,
    order: int = ORDER,
    section_factor: float = cones.SECTION_FACTOR,
) -> cones.ConeDisplacement:
    """Return the displacement around a slender body of any profile by equations (3) and (4) corrected.

    Args:
        x: behind the tip [m]; a float or an array.
        r: from the axis [m], above 0, of the same shape; the cost grows with 1/r.
        profile: radius [m] at a distance [m] behind the tip, 0 at 0; a smooth function of a number.
        length: of the profile [m]; behind it the body keeps its radius.
        soil: with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to below the shear wave's.
        order: Gauss-Legendre nodes in a panel, which one wave crosses.
        section_factor: as in `plough_opt.soil.elastic.cone_displacement`.

    Raises:
        DomainError: a number outside its domain, or a point so near that the quadrature would be too long.
        InputError: symbols, or a soil without elastic constants.
    """
    return cones.displacement_of(*_cone(_places(x, r, length, soil, speed, order), profile, section_factor))


def cone_stress(
    x: Expression,
    r: Expression,
    profile: Curve,
    length: float,
    soil: Soil,
    speed: float,
    order: int = ORDER,
    section_factor: float = cones.SECTION_FACTOR,
) -> cones.ConeStress:
    """Return the stresses around a slender body of any profile: arguments and errors as of `cone_displacement`."""
    return cones.stress_of(*_cone(_places(x, r, length, soil, speed, order), profile, section_factor))


def _cone(
    places: _Places, profile: Curve, section_factor: float
) -> tuple[cones.Potentials, Expression, Expression, Medium]:
    """Return the potentials of a slender body, its displaced section S(x), r, and the medium."""
    check_domain("section factor", section_factor, above=0.0)
    state, length = places.medium, places.length

    def section(x: float) -> float:
        return section_factor * float(profile(min(max(x, 0.0), length))) ** 2

    spectrum = _spectrum(section, places, graded=True)
    p = spectrum.p
    found, sections = np.empty((len(places.at), 6)), np.empty(len(places.at))
    for k, (xk, rk) in enumerate(places.at):
        wave = spectrum.at(xk)
        along, across = wave.real, wave.imag
        fast, change, turned, turned_change = _bessel(p * rk, state)
        found[k] = [
            along @ fast,
            along @ change,
            across @ (p * fast),
            across @ (p * change),
            -(along @ (p * turned_change)),
            across @ (2.0 * turned_change - turned),
        ]
        sections[k] = section(xk)
        found[k, 5] += (section(length) / 2.0 - sections[k]) / rk
    displaced, r = (places.shaped(values[:, None])[0] for values in (sections, places.at[:, 1]))
    return cones.Potentials(*places.shaped(found)), displaced, r, state


def _bessel(z: Array, state: Medium) -> tuple[Array, Array, Array, Array]:
    """Return K0(alpha z), its difference to K0(eta z) over m, alpha K1(alpha z), and its difference to that of eta."""
    from scipy.special import k0, k1  # slow to import, and needed for this quadrature only

    alpha, eta, m = state.alpha, state.eta, state.m
    fast, turned = k0(alpha * z), alpha * k1(alpha * z)
    if m > _SLOW:
        return fast, (fast - k0(eta * z)) / m, turned, (turned - eta * k1(eta * z)) / m
    # d K0(k z)/dk = -z K1(k z), d (k K1(k z))/dk = -k z K0(k z), and alpha - eta = m c.
    change, turned_change = np.zeros_like(z), np.zeros_like(z)
    for node, weight in zip(*gauss_legendre(_SLOPE_NODES), strict=True):
        k = eta + (alpha - eta) * node
        change -= weight * state.slowing * z * k1(k * z)
        turned_change -= weight * state.slowing * z * k * k0(k * z)
    return fast, change, turned, turned_change


def _places(x: Expression, distance: Expression, length: float, soil: Soil, speed: float, order: int) -> _Places:
    """Return the points, checked."""
    if holds_casadi((x, distance, length, soil, speed)):
        raise InputError("the Fourier integrals need numbers: for symbols use the closed forms, with elastic.knots")
    x, distance = (np.asarray(value) if isinstance(value, list | tuple) else value for value in (x, distance))
    check_domain("x", x, "m")
    check_domain("distance from the axis", distance, "m", above=0.0, why="on the axis the integrals do not converge")
    check_domain("length of the profile", length, "m", above=0.0)
    check_single("a Fourier integral", (length, soil, speed))
    if not is_count(order) or order < 2:
        raise InputError(f"order = {order!r} must be at least 2, and whole: the number of nodes in a panel")
    state = medium(soil, speed)
    check_domain("speed over shear wave speed", state.mach, below=1.0, why="at it the integrals do not converge")
    across, away = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(distance, dtype=float))
    return _Places(state, np.column_stack([across.ravel(), away.ravel()]), across.shape, length, order)


def _spectrum(curve: Curve, places: _Places, *, graded: bool) -> _Spectrum:
    """Return the transform of a curve's slope on wave numbers that resolve the integrals at all places."""
    length, order, nearest = places.length, places.order, float(np.min(places.at[:, 1]))
    last = _DECAY / (float(places.medium.eta) * nearest)
    longest = max(length, *(float(np.max(np.abs(places.at[:, 0] - end))) for end in (0.0, length)))
    waves, lengths = (order * last * longest / (2.0 * math.pi), order * length * last / (2.0 * math.pi))
    if waves * lengths > _MOST_NODES:
        raise DomainError(
            f"distance from the axis = {nearest:.3g} m must be larger for a body of {length:g} m:"
            f" the Fourier integrals would take {waves:.0f} by {lengths:.0f} nodes; the closed forms have no such limit"
        )
    p, weights = _panels(last, 2.0 * math.pi / longest, order, graded)
    s, s_weights = _panels(length, 2.0 * math.pi / last, order, False)
    values = np.array([float(curve(place)) for place in s])
    end = float(curve(length))
    check_domain("profile", np.append(values, end), "m")
    check_domain("profile at its tip", float(curve(0.0)), "m", at_least=0.0, at_most=0.0, why="a tip is sharp")
    # By parts, so that the profile's slope is not needed: int h' e = h(l) e(l) - i p int h e.
    moment = np.concatenate([np.exp(1j * np.outer(part, s)) @ (values * s_weights) for part in _chunks(p, s.size)])
    transform = (end * np.exp(1j * p * length) - 1j * p * moment) / math.sqrt(2.0 * math.pi)
    return _Spectrum(p, weights, transform)


def _panels(length: float, width: float, order: int, graded: bool) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights from 0 to a length in panels; graded ones become narrower towards 0."""
    edges = np.linspace(0.0, length, max(math.ceil(length / width), 1) + 1)
    if graded:
        edges = np.concatenate([[0.0], edges[1] * 0.5 ** np.arange(_GRADED, 0, -1), edges[1:]])
    nodes, weights = (np.array(values) for values in gauss_legendre(order))
    sizes = np.diff(edges)
    return (edges[:-1, None] + sizes[:, None] * nodes).ravel(), (sizes[:, None] * weights).ravel()


def _chunks(p: Array, other: int) -> list[Array]:
    """Return wave numbers in parts, such that a matrix over each and the other nodes fits into memory."""
    return np.array_split(p, max(p.size * other // 4_000_000, 1))
