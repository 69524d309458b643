"""What a front is made of: objectives, certified designs and holes, and which designs dominate others.

All objectives of the functions on domination are minimised, with a row for each design. They are normalised, except
in `volume` and `knee`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import comb

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, is_casadi
from plough_opt.core.plain_data import Array
from plough_opt.design.model.ipopt import Point

EQUAL = 1e-7
"""Smaller differences of normalised objectives are rounding of the solves."""

CURVE_GAP = 1.5
"""Two points of a curve that are neighbours and farther apart than this many steps have a gap between them."""

SURFACE_GAP = 1.75
"""Two points of a surface farther apart than this many steps on the plane of utopia are not neighbours."""

ACROSS = np.array([[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]]) / np.sqrt([2.0, 6.0])
"""Two orthonormal directions across (1, 1, 1), as columns."""

# Designs outside a triangle by no more than this part of its size lie on its side.
_ON_SIDE = 1e-12
# Rows that are compared with each other before all others are compared with those of them that stay.
_BLOCK = 32
# Designs compared with a front at once, which bounds the memory that takes.
_CHUNK = 20_000
# A knee lies at least this far below the line, or the plane, through the best point of each objective.
_LEAST_KNEE = 1e-3


def undominated(designs: Array, tolerance: float = EQUAL) -> NDArray[np.intp]:
    """Return the rows that no other row dominates; of rows that differ by less than a tolerance only one stays.

    Rows are taken by rising sum, and each is compared only with those that stay. So one stays of three rows that
    dominate each other in a circle by rounding.

    Args:
        designs: objectives, a row for each design.
        tolerance: a row must be better than each that stays by more than this in some objective.
    """
    left = np.argsort(designs.sum(axis=1), kind="stable")
    chosen = [left[:0]]
    while len(left):
        block, left = left[:_BLOCK], left[_BLOCK:]
        better, stays = _better(designs[block], designs[block], tolerance), np.ones(len(block), dtype=bool)
        for k in range(len(block)):
            if stays[k]:
                stays[k + 1 :] &= better[k + 1 :, k]
        chosen.append(block[stays])
        left = left[_better(designs[left], designs[block[stays]], tolerance).all(axis=1)]
    return np.concatenate(chosen)


def _better(designs: Array, others: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return whether each design, a row, is better than each other one, a column, in any objective."""
    least = others.T - tolerance
    found: NDArray[np.bool_] = designs[:, :1] < least[0]
    for k in range(1, len(least)):
        found |= designs[:, k : k + 1] < least[k]
    return found


def thinned(designs: Array, apart: float) -> NDArray[np.intp]:
    """Return undominated rows that differ by about ``apart`` or more, in a fraction of the time of `undominated`.

    Of the rows in one cell of this size only that of the least sum is compared with others.
    """
    order = np.argsort(designs.sum(axis=1), kind="stable")
    cells = np.floor((designs[order] - designs.min(axis=0, initial=0.0)) / apart).astype(np.int64)
    sizes = cells.max(axis=0, initial=0) + 1
    _, first = np.unique(cells @ np.cumprod(np.r_[1, sizes[:-1]]), return_index=True)
    lowest = order[first]
    return lowest[undominated(designs[lowest], apart)]


def undominated_in_order(objectives: Array) -> NDArray[np.intp]:
    """Return the undominated rows of two objectives, from the best in the first objective to the worst."""
    best = undominated(objectives)
    return best[np.argsort(objectives[best, 0], kind="stable")]


def lead_over_points(front: Array, designs: Array) -> Array:
    """Return how far each design leads a front: positive if no point of the front dominates it.

    A design leads a point by the largest amount by which it is better in any objective, and a front by the least of
    its leads over the points.

    Args:
        front: points, a row each; the lead over an empty front is infinite.
        designs: rows to compare.
    """
    leads = np.empty(len(designs))
    for rows, gains in _gains(front, designs, np.maximum):
        leads[rows] = gains.min(axis=1, initial=np.inf)
    return leads


def strongest_dominators(front: Array, designs: Array) -> tuple[NDArray[np.intp], Array]:
    """Return for each point of a front the design that dominates it most, and by how much.

    A design dominates a point by the least amount by which it is better in any objective, which is negative if it does
    not dominate it.
    """
    strongest, by = np.zeros(len(front), dtype=np.intp), np.full(len(front), -np.inf)
    for rows, gains in _gains(front, designs, np.minimum):
        rows_of = np.argmax(gains, axis=0)
        best = gains[rows_of, np.arange(len(front))]
        better = best > by
        strongest[better], by[better] = rows.start + rows_of[better], best[better]
    return strongest, by


def _gains(front: Array, designs: Array, extreme: np.ufunc) -> Iterator[tuple[slice, Array]]:
    """Yield, for one chunk of designs after another, an extreme over the objectives of their gains over each point.

    Args:
        front: points, which become columns.
        designs: rows.
        extreme: ``np.maximum`` or ``np.minimum``.
    """
    for first in range(0, len(designs), _CHUNK):
        part = designs[first : first + _CHUNK]
        # One objective at a time, because NumPy reduces a short axis slowly.
        gains = front[:, 0] - part[:, :1]
        for k in range(1, front.shape[1]):
            extreme(gains, front[:, k] - part[:, k : k + 1], out=gains)
        yield slice(first, first + len(part)), gains


def lead_over_front(front: Array, designs: Array, step: float) -> Array:
    """Return how far each design leads the points of a front and the lines or triangles between neighbouring points.

    Beyond the edges of a surface and in its holes there are no triangles. There the lead over the points is reduced by
    half a step, because points on an edge lie about that far from any place beside it.

    Args:
        front: efficient rows; of two objectives in order.
        designs: rows to compare, of three objectives a few thousand at most.
        step: distance of neighbours on the front.
    """
    over_points = lead_over_points(front, designs)
    if front.shape[1] == 2:
        return np.minimum(over_points, _depth_below_curve(front, designs, step))
    below = _depth_below_surface(front, designs, step)
    return np.where(np.isfinite(below), np.minimum(over_points, below), over_points - step / 2.0)


def _depth_below_curve(front: Array, designs: Array, step: float) -> Array:
    """Return how far designs lie below the lines between neighbours of a curve, along (1, 1).

    Infinite in gaps of the curve and beyond its ends.
    """
    if len(front) < 2:
        return np.full(len(designs), np.inf)
    along, height = front[:, 0] - front[:, 1], front.sum(axis=1) / 2.0
    location = designs[:, 0] - designs[:, 1]
    after = np.clip(np.searchsorted(along, location), 1, len(front) - 1)
    joined = np.sum(np.abs(np.diff(front, axis=0)), axis=1) <= CURVE_GAP * step
    inside = (location >= along[0]) & (location <= along[-1]) & joined[after - 1]
    return np.where(inside, np.interp(location, along, height) - designs.sum(axis=1) / 2.0, np.inf)


def _depth_below_surface(front: Array, designs: Array, step: float) -> Array:
    """Return how far designs lie below the triangles between neighbours of a surface, along (1, 1, 1).

    Infinite in holes of the surface and beyond its edges.
    """
    from scipy.spatial import Delaunay, QhullError  # slow to import, and every problem file imports this module

    depth = np.full(len(designs), np.inf)
    try:
        triangles = Delaunay(front @ ACROSS).simplices
    except (QhullError, ValueError):  # too few points, or all on a line
        return depth
    corners = front[triangles]
    heights = corners.mean(axis=2)
    locations = corners - heights[:, :, None]
    sides = np.abs(locations - np.roll(locations, 1, axis=1)).max(axis=(1, 2))
    # SciPy would find the triangle of each design by LAPACK on matrices of 2 x 2, whose threads cost a hundred times as
    # much as the arithmetic.
    order = np.argsort(designs @ ACROSS[:, 0], kind="stable")
    u, v = (designs[order] @ ACROSS).T
    mean = designs[order].mean(axis=1)
    for k in np.flatnonzero(sides <= SURFACE_GAP * step):
        (au, av), (bu, bv), (cu, cv) = corners[k] @ ACROSS
        first, last = np.searchsorted(u, [min(au, bu, cu), max(au, bu, cu)], side="left").tolist()
        pu, pv = u[first:last] - cu, v[first:last] - cv
        twice_area = (au - cu) * (bv - cv) - (bu - cu) * (av - cv)
        a, b = (pu * (bv - cv) - (bu - cu) * pv) / twice_area, ((au - cu) * pv - pu * (av - cv)) / twice_area
        inside = np.flatnonzero((a >= -_ON_SIDE) & (b >= -_ON_SIDE) & (a + b <= 1.0 + _ON_SIDE))
        height = heights[k] @ np.array([a[inside], b[inside], 1.0 - a[inside] - b[inside]])
        depth[order[first + inside]] = height - mean[first + inside]
    return depth


def volume(front: Array, reference: Array) -> float:
    """Return the area, or the volume, between a front and a reference point, slice by slice.

    Args:
        front: two or three objectives of each row.
        reference: the far corner; rows that do not dominate it count for nothing.
    """
    inside = front[np.all(front < reference, axis=1)]
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    if front.shape[1] == 2:
        slices = reference[0] - np.minimum.accumulate(inside[:, 0])
    else:
        slices = np.array([volume(inside[: k + 1, :2], reference[:2]) for k in range(len(inside))])
    return float(slices @ np.diff(inside[:, -1], append=reference[-1]))


def knee(front: Array) -> int | None:
    """Return the row farthest below the line, or the plane, through the best row of each objective.

    Objectives count in units of their ranges. If the best rows differ in the sum of these, the plane is that of the
    least sum.

    Args:
        front: objectives of efficient rows.

    Returns:
        The row, or None if no row lies clearly below.
    """
    if len(front) < 3:
        return None
    low, high = front.min(axis=0), front.max(axis=0)
    sums = np.sum((front - low) / np.where(high > low, high - low, 1.0), axis=1)
    below = min(sums[k] for k in np.argmin(front, axis=0)) - sums
    best = int(np.argmax(below))
    return best if below[best] > _LEAST_KNEE else None


# Scaled residual of the first-order conditions above which a point is not an optimum.
_LARGEST_RESIDUAL = 1e-6
# Relative violation of a requirement above which a point is not a design.
_LARGEST_VIOLATION = 1e-6
# Relative curvature below which a point is not a minimum; smaller negative values are rounding.
_LEAST_CURVATURE = -1e-6


class Aimed:
    """What is minimised, or maximised."""

    maximise: bool

    @property
    def sign(self) -> float:
        """1 for what is minimised, -1 for what is maximised."""
        return -1.0 if self.maximise else 1.0


@dataclass(frozen=True)
class Goal(Aimed):
    """One objective of a trade-off.

    Attributes:
        name: name in reports.
        expression: scalar CasADi expression of the design's variables.
        unit: unit of the expression, for reports.
        maximise: whether more is better.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> po.Goal("draft", 5e4 * height**2, unit="N").sign
        1.0
    """

    name: str
    expression: Column = field(repr=False)
    unit: str = ""
    maximise: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"an objective's name = {shown(self.name)} must be a text, such as 'draft'")
        if not is_casadi(self.expression) or isinstance(self.expression, ca.SX):
            raise InputError(f"the objective '{self.name}' must be an expression of the design's variables")
        if self.expression.numel() != 1:
            count = self.expression.numel()
            raise InputError(f"the objective '{self.name}' must be one number, not {count}: sum or average it")


@dataclass(frozen=True)
class Axis(Aimed):
    """Objective or variable of a front, as reports and pictures need it.

    Attributes:
        name: as declared.
        unit: SI unit.
        maximise: whether more is better; False for a variable.
        log: whether a variable is scaled by its logarithm.
        lower: lower bound of a variable; None for an objective.
        upper: upper bound of a variable; None for an objective.
    """

    name: str
    unit: str
    maximise: bool = False
    log: bool = False
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class FrontPoint:
    """Design on the front, or one that others dominate.

    Attributes:
        objectives: all objectives by a tight integration, in their units.
        variables: name -> value, SI units.
        margins: name of each requirement -> distance of its worst value from its limit, positive inside, in its unit.
        active: names of the requirements and variables whose limits are active.
        rate: change of the second of two objectives per change of the first along the front, in their units; None for
            an isolated design, one that is not on the front, or three objectives.
        branch: "soft" or "stiff" for a design on the front under a strength wave, according to whether its natural
            frequency lies below or above the wave's; else "".
        residual: scaled residual of the first-order conditions.
        violation: largest violation of a requirement by a tight integration, relative to its limit.
        gap: largest relative difference of the optimiser's objectives from the tightly integrated ones.
        curvature: least curvature of the Lagrangian along directions that keep the active limits, relative to the
            largest, by a rough integration; None without such a direction, or for a dominated or unconfirmed design.
        weights: weights of the objectives per unit, from the multipliers. Along the front the weighted changes of the
            objectives add up to zero. None for an isolated design.
        medians: medians of the objectives over the design's tolerances, by the integration of a search; None if runs
            are integrated one by one, which takes too long.
        needle: whether the median of some objective is worse than its own value by more than 5 % of that value and of
            the objective's range over the front. No workshop can hit such a design.
        confirmed: whether the design is certified as a local optimum. False if it was simulated and meets all
            requirements, but the optimiser found no optimum near it that can be made.
    """

    objectives: tuple[float, ...]
    variables: dict[str, float]
    margins: dict[str, float]
    active: tuple[str, ...]
    rate: float | None
    branch: str
    residual: float
    violation: float
    gap: float
    curvature: float | None = None
    weights: tuple[float, ...] | None = None
    medians: tuple[float, ...] | None = None
    needle: bool = False
    confirmed: bool = True

    @property
    def doubt(self) -> str:
        """Reason why the design does not belong to a front; empty if it does."""
        if self.confirmed and not self.residual <= _LARGEST_RESIDUAL:
            return f"the first-order conditions are only met to {self.residual:.1e}"
        if self.confirmed and self.curvature is not None and not self.curvature >= _LEAST_CURVATURE:
            return f"it is not a minimum: the curvature in a direction without an active limit is {self.curvature:.1e}"
        if not self.violation <= _LARGEST_VIOLATION:
            return f"a tight integration violates a requirement by {self.violation:.1e} of its limit"
        return ""

    def rate_of(self, of: int, by: int) -> float | None:
        """Return the change of one objective per change of another along the front; None if there is no finite one."""
        return None if self.weights is None or not self.weights[of] else -self.weights[by] / self.weights[of]


@dataclass(frozen=True)
class MissingPoint:
    """Position on a front without a certified design.

    Attributes:
        objectives: objectives of the neighbour from which a design was sought, in their units.
        reason: why none was found.
    """

    objectives: tuple[float, ...]
    reason: str


@dataclass(frozen=True)
class Hole:
    """Interruption of a front: every feasible design there is dominated.

    Attributes:
        start: objectives at which one part ends.
        end: objectives at which the next part begins.
        settled: False if the optimiser failed inside, so that designs may be missing.
    """

    start: tuple[float, ...]
    end: tuple[float, ...]
    settled: bool = True


# --- candidates for a front, and which of them are neighbours ---

# Each further order of a prediction must correct it by less than this fraction of the correction before.
_SHRINKS = 0.5
# Neighbours on a curve closer than this many steps are shown as one point.
_CROWDED = 0.1


@dataclass(eq=False)
class FrontCandidate:
    """A local optimum on some branch, or a simulated design that is just as good; equal to itself alone.

    Attributes:
        point: as the optimiser left it.
        p: parameters of the subproblem that it solves.
        objectives: normalised.
        exact: whether it was solved with exact slopes.
        followed: numbers of the objectives that were reduced when its branch was followed from here.
        between: whether it was sought because the front missed a design, so that it lies between positions.
        inner_neighbour: for an end, an optimum a little inside the front, where multipliers are unique, and its p.
        needle: whether it is a needle; None until that is judged.
        confirmed: whether it is an optimum; otherwise it is a design of a search, near which no optimum was found.
    """

    point: Point
    p: Array
    objectives: Array
    exact: bool = False
    followed: set[int] = field(default_factory=set)
    between: bool = False
    inner_neighbour: tuple[Point, Array] | None = None
    needle: bool | None = None
    confirmed: bool = True


def extrapolated(points: Sequence[Array]) -> Array:
    """Return the design to which equally spaced designs lead, within the bounds.

    It is the next value of the polynomial through the last of them. The degree rises as long as each further design
    corrects the prediction by much less than the one before.
    """
    predicted, correction = points[-1], np.inf
    for count in range(2, len(points) + 1):
        weights = np.array([(-1.0) ** (k + 1) * comb(count, k) for k in range(count, 0, -1)])
        better = weights @ np.array(points[-count:])
        size = float(np.max(np.abs(better - predicted)))
        if size > _SHRINKS * correction:
            break
        predicted, correction = better, size
    return np.clip(predicted, 0.0, 1.0)


@dataclass(frozen=True)
class Arrangement:
    """Candidates arranged as a front.

    Attributes:
        efficient: candidates that no other dominates.
        shown: those of them that are not crowded, in order.
        parts: for each connected part the numbers of its shown candidates.
        holes: numbers of the two shown candidates on either side of each hole.
    """

    efficient: list[FrontCandidate]
    shown: list[FrontCandidate]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


def gaps(front: Array, step: float) -> list[int]:
    """Return the rows of a front that are followed by a gap.

    Args:
        front: normalised objectives of efficient rows, in order.
        step: distance of neighbours, the sum of both changes.
    """
    distance = np.sum(np.abs(np.diff(front, axis=0)), axis=1)
    return [int(k) for k in np.flatnonzero(distance > CURVE_GAP * step)]


def uncrowded_on_curve(front: Array, step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those too close to another; the ends of its parts stay.

    Args:
        front: normalised objectives of efficient rows, in order.
        step: distance of neighbours, the sum of both changes.
    """
    begins = {0, *(k + 1 for k in gaps(front, step))}
    chosen: list[int] = []
    for k in range(len(front)):
        if chosen and np.sum(np.abs(front[k] - front[chosen[-1]])) < _CROWDED * step:
            if k + 1 not in {*begins, len(front)} or chosen[-1] in begins:
                continue
            chosen.pop()
        chosen.append(k)
    return np.array(chosen, dtype=np.intp)


def without_needless(front: Array, between: Sequence[bool], step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those between two positions that have no gap between them.

    Args:
        front: normalised objectives of efficient rows, in order.
        between: for each row whether it lies between positions.
        step: distance of neighbours, the sum of both changes.
    """
    chosen: list[int] = []
    for k in range(len(front)):
        inside = chosen and k + 1 < len(front)
        if between[k] and inside and np.sum(np.abs(front[k + 1] - front[chosen[-1]])) <= CURVE_GAP * step:
            continue
        chosen.append(k)
    return np.array(chosen, dtype=np.intp)


def locations(objectives: Array) -> Array:
    """Return the locations of normalised objectives on the plane of utopia, a row each."""
    return np.asarray(objectives - np.mean(objectives, axis=1, keepdims=True))


def distances(objectives: Array) -> Array:
    """Return the distances between the locations of all rows, as the largest difference in any objective."""
    places = locations(objectives)
    return np.asarray(np.max(np.abs(places[:, None, :] - places[None, :, :]), axis=2))


def parts_of(objectives: Array, step: float) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """Return the connected parts of a surface, the largest first, and for each hole the two rows nearest across it.

    Holes are those of the shortest tree that connects all parts.

    Args:
        objectives: normalised objectives of efficient rows.
        step: distance of neighbouring positions.
    """
    from scipy.sparse import csr_array  # slow to import, and every problem file imports this module
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    apart = distances(objectives)
    count, label = connected_components(csr_array(apart <= SURFACE_GAP * step), directed=False)
    parts = sorted(([int(k) for k in np.flatnonzero(label == c)] for c in range(count)), key=len, reverse=True)
    between_parts, ends = np.zeros((count, count)), {}
    for a in range(count):
        for b in range(a + 1, count):
            between = apart[np.ix_(parts[a], parts[b])]
            i, j = np.unravel_index(np.argmin(between), between.shape)
            between_parts[a, b] = between[i, j]
            ends[a, b] = parts[a][i], parts[b][j]
    tree = minimum_spanning_tree(csr_array(between_parts)).tocoo()
    return parts, [ends[int(a), int(b)] for a, b in zip(tree.row, tree.col, strict=True)]


def covering(objectives: Array, chosen: NDArray[np.intp], room: float) -> NDArray[np.intp]:
    """Return the chosen rows, with others added until every row lies near one of them.

    Args:
        objectives: normalised objectives.
        chosen: rows to begin with.
        room: largest distance of a row from the nearest chosen one, in any objective.
    """
    rows = [int(k) for k in chosen]
    apart = np.max(np.abs(objectives[:, None] - objectives[rows][None]), axis=2).min(axis=1)
    while np.max(apart) > room:
        rows.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.max(np.abs(objectives - objectives[rows[-1]]), axis=1))
    return np.array(sorted(rows), dtype=np.intp)
