"""The Fourier integrals of equations (1)-(4) by quadrature, for a profile of any shape.

They are independent of the closed forms for the fields of wedge and cone, and also handle curved profiles. They need
numbers; a design uses the closed forms with `knots` on its profile.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain, check_single, whole_number
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, expm1_ratio, gauss_legendre, holds_casadi
from plough_opt.soil.elastic import cone as cones
from plough_opt.soil.elastic import wedge as wedges
from plough_opt.soil.elastic.medium import Medium, heights_at, medium
from plough_opt.soil.soil import Soil

Array = NDArray[np.float64]
Curve = Callable[[float], float]
Integrals = Callable[[Medium, Array, Array, Array, float, float], list[Any]]

ORDER = 12
"""Default number of Gauss-Legendre nodes in a panel, which is one wavelength of the integrand wide."""

# Most entries of the matrix of nodes in x and in the wave number; larger ones take minutes.
_MOST_NODES = 40_000_000


def wedge_stress(
    x: Expression, y: Expression, profile: Curve, length: float, soil: Soil, speed: float, order: int = ORDER
) -> wedges.WedgeStress:
    """Return the stresses around a thin wedge with any profile by J1 and J2, equations (1) and (2) corrected.

    Args:
        x: distance behind the tip [m]; a float or an array.
        y: distance from the plane of symmetry [m], above 0, of the same shape; the cost grows with 1/y.
        profile: smooth function that returns the half thickness [m] at a distance [m] behind the tip; 0 at 0.
        length: length of the profile [m]; the thickness is constant behind it.
        soil: soil with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to below the shear wave speed.
        order: Gauss-Legendre nodes in a panel one wavelength wide; the error decreases exponentially with it.

    Raises:
        DomainError: a number is outside its domain, or a point is so near that the quadrature would take too long.
        InputError: an argument holds symbols, or the soil lacks elastic constants.
    """

    def integrals(state: Medium, p: Array, along: Array, across: Array, _x: float, y: Any) -> list[Any]:
        fast, slow = np.exp(-p * state.alpha * y), np.exp(-p * state.eta * y)
        # (exp(-p alpha y) - exp(-p eta y))/m, with alpha - eta = m c.
        change = -p * state.slowing * y * slow * expm1_ratio(-p * state.m * state.slowing * y)
        return [-across @ fast, -across @ change, along @ fast, -(along @ change)]

    found, state = _integrated(profile, x, y, length, soil, speed, order, integrals)
    return wedges.stress_of(wedges.Potentials(*found), state)


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
    """Return the displacement around a slender body with any profile by equations (3) and (4) corrected.

    Args:
        x: distance behind the tip [m]; a float or an array.
        r: distance from the axis [m], above 0, of the same shape; the cost grows with 1/r.
        profile: smooth function that returns the radius [m] at a distance [m] behind the tip; 0 at 0.
        length: length of the profile [m]; the radius is constant behind it.
        soil: soil with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to below the shear wave speed.
        order: Gauss-Legendre nodes in a panel one wavelength wide.
        section_factor: as in `plough_opt.soil.elastic.cone_displacement`.

    Raises:
        DomainError: a number is outside its domain, or a point is so near that the quadrature would take too long.
        InputError: an argument holds symbols, or the soil lacks elastic constants.
    """
    return cones.displacement_of(*_cone(x, r, profile, length, soil, speed, order, section_factor))


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
    """Return the stresses around a slender body with any profile; arguments and errors as for `cone_displacement`."""
    return cones.stress_of(*_cone(x, r, profile, length, soil, speed, order, section_factor))


def _cone(
    x: Expression, r: Expression, profile: Curve, length: float, soil: Soil, speed: float, order: int, factor: float
) -> tuple[cones.ConePotentials, Expression, Expression, Medium]:
    """Return the potentials of a slender body, its displaced section S(x), r, and the medium."""
    check_domain("section factor", factor, above=0.0)
    check_single("a Fourier integral", factor)

    def section(x: float) -> float:
        return factor * float(profile(min(max(x, 0.0), length))) ** 2

    def integrals(state: Medium, p: Array, along: Array, across: Array, x: float, r: float) -> list[Any]:
        fast, change, turned, turned_change = _bessel(p * r, state)
        return [
            along @ fast,
            along @ change,
            across @ (p * fast),
            across @ (p * change),
            -(along @ (p * turned_change)),
            across @ (2.0 * turned_change - turned) + (section(length) / 2.0 - section(x)) / r,
            section(x),
            r,
        ]

    (*found, displaced, away), state = _integrated(section, x, r, length, soil, speed, order, integrals, graded=True)
    return cones.ConePotentials(*found), displaced, away, state


def _bessel(z: Array, state: Medium) -> tuple[Array, Array, Array, Array]:
    """Return K0(alpha z), (K0(alpha z) - K0(eta z))/m, alpha K1(alpha z), (alpha K1(alpha z) - eta K1(eta z))/m."""
    from scipy.special import k0, k1  # slow to import, and needed here only

    alpha, eta, m = state.alpha, state.eta, state.m
    fast, turned = k0(alpha * z), alpha * k1(alpha * z)
    if m > 0.2:
        return fast, (fast - k0(eta * z)) / m, turned, (turned - eta * k1(eta * z)) / m
    # In slow motion as a mean slope: d K0(k z)/dk = -z K1(k z), d (k K1(k z))/dk = -k z K0(k z), and alpha - eta = m c.
    change, turned_change = np.zeros_like(z), np.zeros_like(z)
    for node, weight in zip(*gauss_legendre(10), strict=True):
        k = eta + (alpha - eta) * node
        change -= weight * state.slowing * z * k1(k * z)
        turned_change -= weight * state.slowing * z * k * k0(k * z)
    return fast, change, turned, turned_change


def _integrated(
    curve: Curve, x: Expression, distance: Expression, length: float, soil: Soil, speed: float, order: int,
    integrals: Integrals, *, graded: bool = False,
) -> tuple[list[Expression], Medium]:  # fmt: skip
    """Check the arguments, and return integrals over the wave number at all points, and the medium.

    Args:
        curve: half thickness, or S, as a function of x.
        x: distance of the points behind the tip [m].
        distance: distance of the points from the axis [m].
        length: length of the body [m].
        soil: the soil.
        speed: V0 [m/s].
        order: Gauss-Legendre nodes in a panel.
        integrals: (medium, wave numbers, real and imaginary part of the curve's transform times exp(-i p x) and the
            quadrature weight, x, distance) -> the integrals at a point.
        graded: whether the panels become narrower towards a wave number of 0.
    """
    if holds_casadi((x, distance, length, soil, speed)):
        raise InputError("the Fourier integrals need numbers: for symbols use the closed forms, with elastic.knots")
    x, distance = (np.asarray(value) if isinstance(value, list | tuple) else value for value in (x, distance))
    check_domain("x", x, "m")
    check_domain("distance from the axis", distance, "m", above=0.0, why="on the axis the integrals do not converge")
    check_domain("length of the profile", length, "m", above=0.0)
    check_single("a Fourier integral", (length, soil, speed))
    whole_number("order", order, 2)
    state = medium(soil, speed)
    check_domain("speed over shear wave speed", state.mach, below=1.0, why="at 1 the integrals do not converge")
    across, away = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(distance, dtype=float))
    # The integrals end where the integrand has decayed to exp(-36), the rounding error of the largest term.
    last = 36.0 / (float(state.eta) * float(np.min(away)))
    longest = max(length, *(float(np.max(np.abs(across - end))) for end in (0.0, length)))
    waves, lengths = (order * last * extent / (2.0 * math.pi) for extent in (longest, length))
    if waves * lengths > _MOST_NODES:
        raise DomainError(
            f"distance from the axis = {np.min(away):.3g} m must be larger for a body of {length:g} m:"
            f" the Fourier integrals would take {waves:.0f} by {lengths:.0f} nodes; the closed forms have no such limit"
        )
    p, weights = _panels(last, 2.0 * math.pi / longest, order, graded)
    s, s_weights = _panels(length, 2.0 * math.pi / last, order, False)
    values = np.array(heights_at([*s, length], curve))
    check_domain("profile", values, "m")
    (tip,) = heights_at([0.0], curve)
    check_domain("profile at its tip", tip, "m", at_least=0.0, at_most=0.0, why="a tip is sharp")
    # Integrated by parts, which avoids the profile's slope: int h' e = h(l) e(l) - i p int h e.
    weighted, end = values[:-1] * s_weights, values[-1]
    # In chunks, each of which has a matrix that fits into memory.
    chunks = np.array_split(p, max(p.size * s.size // 4_000_000, 1))
    moment = np.concatenate([np.exp(1j * np.outer(part, s)) @ weighted for part in chunks])
    transform = (end * np.exp(1j * p * length) - 1j * p * moment) / math.pi * weights
    rows = []
    for place, apart in zip(across.ravel(), away.ravel(), strict=True):
        wave = transform * np.exp(-1j * p * place)
        rows.append(integrals(state, p, wave.real, wave.imag, place, apart))
    shape = across.shape
    return [row.reshape(shape) if shape else float(row[0]) for row in np.array(rows).T], state


def _panels(length: float, width: float, order: int, graded: bool) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights in panels from 0 to a length; graded panels become narrower towards 0."""
    edges = np.linspace(0.0, length, max(math.ceil(length / width), 1) + 1)
    if graded:  # towards p = 0, where the Bessel functions are logarithmic
        edges = np.concatenate([[0.0], edges[1] * 0.5 ** np.arange(44, 0, -1), edges[1:]])
    nodes, weights = (np.array(values) for values in gauss_legendre(order))
    sizes = np.diff(edges)
    return (edges[:-1, None] + sizes[:, None] * nodes).ravel(), (sizes[:, None] * weights).ravel()
