"""Profiles of a body: piecewise-linear nodes, the profile of a share, and knots on a smooth curve."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, TypeAlias

import numpy as np

from plough_opt.core.checks import LEAST, NOT_NUMBERS, check_domain, plain_number, shown
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import (
    Expression,
    as_number,
    column,
    holds_casadi,
    is_count,
    is_symbolic,
    maximum,
    minimum,
)
from plough_opt.soil.geometry import Cone, Wedge

Profile: TypeAlias = Sequence[tuple[Expression, Expression]] | Wedge | Cone
"""Nodes (x, half thickness or radius) [m], or a share, whose profile is that of its (equivalent) cone."""

# Most straight pieces of a profile; each is a term of every stress.
_MOST_PIECES: Final = 100_000


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

    def height(self, x: Expression) -> Expression:
        """Return the half thickness or radius at x [m]; it is constant behind the last node."""
        total: Expression = 0.0
        for segment, offset in zip(self.segments, self.offsets(x), strict=False):
            total = total + segment.slope * minimum(maximum(offset, 0.0), segment.length)
        return total


def body(profile: Profile) -> Body:
    """Check a profile and return it as a body.

    Raises:
        InputError: the profile is not a sequence of at least two pairs.
        DomainError: the nodes do not increase in x, a height is negative, or the height at the first node is not 0.
    """
    if isinstance(profile, Wedge | Cone):
        cone = profile.equivalent_cone() if isinstance(profile, Wedge) else profile
        return Body((0.0, cone.height), (0.0, cone.height * cone.slope))
    pairs = _pairs(profile)
    for k, (place, height) in enumerate(pairs):
        check_domain(f"x of node {k + 1} of the profile", place, "m")
        check_domain(f"half thickness or radius at node {k + 1} of the profile", height, "m", at_least=0.0)
    check_domain(
        "half thickness or radius at the first node of the profile", pairs[0][1], "m", at_most=0.0, why="a tip is sharp"
    )
    for k, ((before, _), (after, _)) in enumerate(pairwise(pairs)):
        check_domain(
            f"x of node {k + 2} minus x of node {k + 1} of the profile",
            after - before,
            "m",
            above=0.0,
            why="nodes must be listed from the tip backwards",
        )
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
    """
    length = plain_number("length of the profile", length)
    check_domain("length of the profile", length, "m", above=0.0)
    if not is_count(count) or count > _MOST_PIECES:
        raise InputError(f"count = {shown(count)} of straight pieces must be a whole number from 1 to {_MOST_PIECES}")
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
    if holds_casadi((first, second, others)):
        first, second = (
            column(np.asarray(value, dtype=float).ravel(), True) if isinstance(value, np.ndarray) else value
            for value in (first, second)
        )
    return first, second


def check_off_nodes(offsets: Sequence[Expression], distance: Expression) -> None:
    """Raise DomainError if a numeric point lies on a node, where the stresses are infinite."""
    for k, offset in enumerate(offsets):
        if is_symbolic(offset) or is_symbolic(distance):
            continue
        # The squares of smaller numbers underflow.
        if np.any((np.abs(as_number(offset)) < LEAST) & (np.abs(as_number(distance)) < LEAST)):
            raise DomainError(
                f"a point lies on node {k + 1} of the profile, where the stresses are infinite: move it off the node"
            )


def _pairs(profile: Any) -> list[tuple[Expression, Expression]]:
    """Return the nodes of a profile as pairs; raise InputError if they are not at least two pairs."""
    wanted = "a profile is a sequence of nodes (x, half thickness or radius) in metres, a Wedge or a Cone"
    try:
        pairs = [tuple(node) for node in profile]
    except TypeError:
        raise InputError(f"{wanted}, not {shown(profile)}") from None
    if len(pairs) < 2:
        raise InputError(f"{wanted}, with at least two nodes, not {len(pairs)}")
    for pair in pairs:
        if len(pair) != 2:
            raise InputError(f"{wanted}: {shown(pair)} is not a pair")
    return [(pair[0], pair[1]) for pair in pairs]
