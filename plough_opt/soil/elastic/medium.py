"""Elastic soil, and profiles of the bodies that move in it."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, TypeAlias

import numpy as np

from plough_opt.core import expressions as ex
from plough_opt.core.checks import (
    LEAST,
    NOT_NUMBERS,
    check_domain,
    checked_in_designs,
    limited_in_designs,
    plain_number,
    shown,
    unlabelled,
    whole_number,
)
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression
from plough_opt.soil.geometry import Cone, Wedge
from plough_opt.soil.soil import Soil, check_soil

medium_law = limited_in_designs("elastic medium")
"""Decorator of functions of an elastic soil and a speed, whose limits designs keep."""

BELOW_SHEAR_WAVES: Final = 1e-4
"""Part by which designs stay below the shear wave speed, where the fields are finite but their derivatives are not."""

FAR = 1.6
"""A Gauss rule replaces the closed form if the distances from both ends of a piece sum to more than this many lengths.

It is then the more accurate of the two.
"""
FAR_NODES = 24
"""Nodes of that rule."""
# Largest argument for which the ratio functions replace the logarithm and the angle.
_SERIES_BELOW = 0.5
Profile: TypeAlias = Sequence[tuple[Expression, Expression]] | Wedge | Cone
"""Nodes (x, half thickness or radius) [m], or a share, whose profile is that of its (equivalent) cone."""
# Most straight pieces of a profile; each is a term of every stress.
_MOST_PIECES: Final = 100_000


@checked_in_designs
def shear_modulus(soil: Soil) -> Expression:
    """Return the shear modulus mu = E/(2 (1 + nu)) [Pa].

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.elastic.shear_modulus(soil)) / 1e6, 3)
        3.759
    """
    modulus, ratio, _ = _constants(soil)
    return modulus / (2.0 * (1.0 + ratio))


@checked_in_designs
def shear_wave_speed(soil: Soil) -> Expression:
    """Return c2 = sqrt(mu/rho) [m/s], the largest speed for which the elastic medium is solved.

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.elastic.shear_wave_speed(soil)), 2)
        52.77
    """
    return ex.sqrt(shear_modulus(soil) / soil.density)


@checked_in_designs
def longitudinal_wave_speed(soil: Soil) -> Expression:
    """Return c1 = c2/sqrt(kappa) [m/s] with kappa = (1 - 2 nu)/(2 (1 - nu)).

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.elastic.longitudinal_wave_speed(soil)), 2)
        104.76
    """
    return shear_wave_speed(soil) / ex.sqrt(_constants(soil)[2])


@checked_in_designs
def rayleigh_speed(soil: Soil) -> Expression:
    """Return the Rayleigh speed c_R [m/s], at which the pressure on a wedge vanishes.

    It satisfies (1 + eta^2)^2 = 4 alpha eta, which is equivalent to the cubic
    m^3 - 8 m^2 + 8 (3 - 2 kappa) m - 16 (1 - kappa) = 0 in m = (c_R/c2)^2.

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> round(float(po.elastic.rayleigh_speed(soil)), 2)
        49.18
    """
    _, ratio, kappa = _constants(soil)
    m = ((0.87 + 1.12 * ratio) / (1.0 + ratio)) ** 2
    for _ in range(5):  # Newton's steps double the number of correct digits, which is three at first
        value = ((m - 8.0) * m + 8.0 * (3.0 - 2.0 * kappa)) * m - 16.0 * (1.0 - kappa)
        m = m - value / ((3.0 * m - 16.0) * m + 8.0 * (3.0 - 2.0 * kappa))
    return shear_wave_speed(soil) * ex.sqrt(m)


@dataclass(frozen=True)
class Ratios:
    """Dimensionless numbers of an elastic soil at a speed, from which all fields follow.

    Attributes:
        m: (V0/c2)^2 [-], from 0 to 1.
        kappa: (c2/c1)^2 [-].
        stiffening: 1 - 2 kappa = nu/(1 - nu) = lambda/(lambda + 2 mu) [-].
        alpha: sqrt(1 - V0^2/c1^2) [-].
        eta: sqrt(1 - V0^2/c2^2) [-].
    """

    m: Expression
    kappa: Expression
    stiffening: Expression
    alpha: Expression
    eta: Expression

    @property
    def in_order(self) -> tuple[Expression, ...]:
        """The five numbers in the order of the constructor's arguments."""
        return self.m, self.kappa, self.stiffening, self.alpha, self.eta

    @property
    def lateral(self) -> Expression:
        """Return 1 + eta^2 = 2 - m."""
        return 2.0 - self.m

    @property
    def slowing(self) -> Expression:
        """Return c = (alpha - eta)/m = (1 - kappa)/(alpha + eta)."""
        return (1.0 - self.kappa) / (self.alpha + self.eta)

    @property
    def product(self) -> Expression:
        """Return q1 = (1 - alpha eta)/m = (1 + kappa - kappa m)/(1 + alpha eta)."""
        return (1.0 + self.kappa - self.kappa * self.m) / (1.0 + self.alpha * self.eta)

    @property
    def rayleigh(self) -> Expression:
        """Return R/m = ((1 + eta^2)^2 - 4 alpha eta)/m, which changes sign at the Rayleigh speed."""
        return 4.0 * self.product - 4.0 + self.m


@dataclass(frozen=True)
class Medium(Ratios):
    """An elastic soil that streams past the body.

    Attributes:
        shear_modulus: mu [Pa].
        mach: V0/c2 [-].
    """

    shear_modulus: Expression
    mach: Expression


def medium(soil: Soil, speed: Expression) -> Medium:
    """Return the medium at a speed [m/s].

    Raises:
        InputError: the soil's Young's modulus or Poisson's ratio is not given.
        DomainError: the speed is negative or above the shear wave speed.
    """
    with unlabelled():
        modulus, fastest = shear_modulus(soil), shear_wave_speed(soil)
    speed = check_domain("speed", speed, "m/s", at_least=0.0)
    mach = speed / fastest
    why = "the elastic medium is solved up to the shear wave speed; see elastic.shear_wave_speed(soil)"
    check_domain("speed over shear wave speed", mach, at_most=1.0, why=why, inside=BELOW_SHEAR_WAVES)
    _, ratio, kappa = _constants(soil)
    m = mach**2
    # Near the shear wave speed 1 - m cancels; at low speed the derivative of the product does.
    eta_squared = ex.where(m < 0.5, 1.0 - m, (fastest - speed) * (fastest + speed) / fastest**2)
    return Medium(
        shear_modulus=modulus,
        m=m,
        kappa=kappa,
        stiffening=ratio / (1.0 - ratio),
        alpha=ex.sqrt(1.0 - kappa * m),
        eta=ex.sqrt(eta_squared),
        mach=mach,
    )


def _constants(soil: Soil) -> tuple[Expression, Expression, Expression]:
    """Return Young's modulus [Pa], Poisson's ratio nu, and kappa = (c2/c1)^2 = (1 - 2 nu)/(2 (1 - nu))."""
    check_soil(soil)
    for name in ("youngs_modulus", "poisson_ratio"):
        if getattr(soil, name) is None:
            raise InputError(f"the elastic medium needs {name}, but {soil.name} does not have it: set soil.{name}")
    modulus: Any = soil.youngs_modulus
    ratio: Any = soil.poisson_ratio
    return modulus, ratio, (1.0 - 2.0 * ratio) / (2.0 * (1.0 - ratio))


# --- differences divided by m, which is small at low speed, without cancellation -------------------------------------


def log_difference(a: Expression, b: Expression, change: Expression, m: Expression = 1.0) -> Expression:
    """Return ln(a/b)/m for positive a and b whose difference a - b = m change is known to rounding."""
    w = change / (a + b)
    near = ex.absolute(m * w) < _SERIES_BELOW
    close = 2.0 * w * ex.arctanh_ratio(ex.where(near, m * w, 0.0))
    return ex.where(near, close, ex.log(a / b) / ex.where(near, 1.0, m))


def angle_difference(rise: Expression, run: Expression, m: Expression) -> Expression:
    """Return the angle of the point (run, m rise), divided by m, without cancellation for small m."""
    near = ex.absolute(m * rise) < _SERIES_BELOW * run
    safe_run = ex.where(near, run, 1.0)
    close = rise / safe_run * ex.arctan_ratio(ex.where(near, m * rise / safe_run, 0.0))
    return ex.where(near, close, ex.arctan2(m * rise, ex.where(near, 1.0, run)) / ex.where(near, 1.0, m))


@dataclass(frozen=True)
class Segment:
    """A straight piece of a profile.

    Attributes:
        start: index of its first node; the next node is its second.
        length: extent in x [m].
        first: half thickness or radius at its first node [m].
        slope: slope of the face [-].
    """

    start: int
    length: Expression
    first: Expression
    slope: Expression


@dataclass(frozen=True)
class Body:
    """A piecewise-linear profile.

    Attributes:
        places: x of the nodes [m].
        heights: half thickness or radius at the nodes [m].
    """

    places: tuple[Expression, ...]
    heights: tuple[Expression, ...]

    @property
    def segments(self) -> list[Segment]:
        """The straight pieces."""
        pieces = []
        for k in range(len(self.places) - 1):
            length = self.places[k + 1] - self.places[k]
            pieces.append(Segment(k, length, self.heights[k], (self.heights[k + 1] - self.heights[k]) / length))
        return pieces

    def offsets(self, x: Expression) -> list[Expression]:
        """Return the distances x - x_i from the nodes [m]."""
        return [x - place for place in self.places]

    def pieces(self, offsets: Sequence[Expression]) -> Iterator[tuple[Segment, Expression, Expression]]:
        """Return the straight pieces, each with the distances of a point from its two nodes, given those from all."""
        return zip(self.segments, offsets[:-1], offsets[1:], strict=True)

    def height(self, x: Expression) -> Expression:
        """Return the half thickness or radius at x [m]; it is constant behind the last node."""
        pieces = self.pieces(self.offsets(x))
        return sum(piece.slope * ex.minimum(ex.maximum(behind, 0.0), piece.length) for piece, behind, _ in pieces)


def body(profile: Profile) -> Body:
    """Check a profile and return it as a body.

    Raises:
        InputError: the profile is not a sequence of at least two pairs.
        DomainError: the nodes do not increase in x, a height is negative, or the height at the first node is not 0.
    """
    if isinstance(profile, Wedge | Cone):
        cone = profile.equivalent_cone() if isinstance(profile, Wedge) else profile
        return Body((0.0, cone.height), (0.0, cone.height * cone.slope))
    wanted = "a profile is a sequence of nodes (x, half thickness or radius) in metres, a Wedge or a Cone"
    try:
        pairs: list[tuple[Expression, ...]] = [tuple(node) for node in profile]
    except TypeError:
        raise InputError(f"{wanted}, not {shown(profile)}") from None
    if len(pairs) < 2:
        raise InputError(f"{wanted}, with at least two nodes, not {len(pairs)}")
    if wrong := [pair for pair in pairs if len(pair) != 2]:
        raise InputError(f"{wanted}: {shown(wrong[0])} is not a pair")
    for k, (place, height) in enumerate(pairs):
        check_domain(f"x of node {k + 1} of the profile", place, "m")
        check_domain(f"half thickness or radius at node {k + 1} of the profile", height, "m", at_least=0.0)
    check_domain("half thickness or radius at the first node", pairs[0][1], "m", at_most=0.0, why="a tip is sharp")
    for k, ((before, _), (after, _)) in enumerate(pairwise(pairs)):
        apart = f"x of node {k + 2} minus x of node {k + 1} of the profile"
        check_domain(apart, after - before, "m", above=0.0, why="nodes must be listed from the tip backwards")
    return Body(tuple(place for place, _ in pairs), tuple(height for _, height in pairs))


def knots(profile: Callable[[float], float], length: float, count: int) -> list[tuple[float, float]]:
    """Return nodes on a smooth profile for the closed forms, spaced more closely towards both ends.

    Away from the body the error of stresses and displacements decreases with the square of the number of pieces;
    `plough_opt.refine` shows it. On the body the pressure is infinite at every node.

    Args:
        profile: function that returns half thickness or radius [m] at a distance x [m] behind the tip; 0 at 0.
        length: length of the body [m], above 0.
        count: number of straight pieces, at least 1.

    Raises:
        InputError: the number of pieces is invalid, or the profile is not a function of one number.
        DomainError: the length is not positive, or a height is not finite.

    Example:
        >>> import plough_opt as po
        >>> nodes = po.elastic.knots(lambda x: 0.2 * x, length=0.25, count=5)
        >>> len(nodes), nodes[0]
        (6, (0.0, 0.0))
    """
    length = plain_number("length of the profile", length)
    check_domain("length of the profile", length, "m", above=0.0)
    whole_number("count", count, 1, _MOST_PIECES)
    places = [length * math.sin(math.pi * k / (2 * count)) ** 2 for k in range(count)] + [length]
    nodes = list(zip(places, heights_at(places, profile), strict=True))
    for place, height in nodes:
        check_domain(f"half thickness or radius at x = {place:.4g} m", height, "m", at_least=0.0)
    return nodes


def heights_at(places: Iterable[float], profile: Callable[[float], float]) -> list[float]:
    """Return half thicknesses or radii [m] of a profile that is given as a function of x.

    Raises:
        InputError: the profile is not a function of one number that returns a number.
    """
    try:
        return [float(profile(place)) for place in places]
    except NOT_NUMBERS as error:
        raise InputError(f"the profile must be a function of x that returns a number, in metres: {error}") from None


def points(first: Expression, second: Expression, *others: Any) -> tuple[Expression, Expression]:
    """Return coordinates; if any argument holds symbols, arrays become columns that can be combined with them.

    Raises:
        DomainError: a coordinate is not a finite number.
    """
    first, second = (np.asarray(value) if isinstance(value, list | tuple) else value for value in (first, second))
    for name, value in (("x", first), ("distance from the axis", second)):
        check_domain(name, value, "m")
    if ex.holds_casadi((first, second, others)):
        first, second = (
            ex.column(np.asarray(value, dtype=float).ravel(), True) if isinstance(value, np.ndarray) else value
            for value in (first, second)
        )
    return first, second


def check_off_nodes(offsets: Sequence[Expression], distance: Expression) -> None:
    """Raise DomainError if a numeric point lies on a node, where the stresses are infinite."""
    for k, offset in enumerate(offsets):
        if ex.is_symbolic(offset) or ex.is_symbolic(distance):
            continue
        # The squares of smaller numbers underflow.
        if np.any((np.abs(ex.as_number(offset)) < LEAST) & (np.abs(ex.as_number(distance)) < LEAST)):
            raise DomainError(f"a point lies on node {k + 1} of the profile, where stresses are infinite: move it")
