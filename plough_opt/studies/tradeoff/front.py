"""What a front is made of: objectives, certified designs and holes, and which designs dominate others.

All objectives of the functions on domination are minimised, with a row for each design. They are normalised, except
in `volume` and `knee`.
"""

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, is_casadi
from plough_opt.core.plain_data import Array

EQUAL = 1e-7
"""Smaller differences of normalised objectives are rounding of the solves."""

GAP = {2: 1.5, 3: 1.75}
"""Neighbours on a front of so many objectives that are farther apart than this many steps have a gap between them."""


# Rows that are compared with each other before all others are compared with those of them that stay.
_BLOCK = 32
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
        better = _better(designs[block], designs[block], tolerance)
        stays = np.ones(len(block), dtype=bool)
        for k in range(len(block)):
            if stays[k]:
                stays[k + 1 :] &= better[k + 1 :, k]
        chosen.append(block[stays])
        left = left[_better(designs[left], designs[block[stays]], tolerance).all(axis=1)]
    return np.concatenate(chosen)


def _better(designs: Array, others: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return whether each design, a row, is better than each other one, a column, in any objective."""
    pairs = zip(designs.T, others.T - tolerance, strict=True)
    return np.asarray(np.logical_or.reduce([own[:, None] < least for own, least in pairs]))


def leads(front: Array, designs: Array) -> Array:
    """Return how far each design leads a front: positive if no point of the front dominates it.

    A design leads a point by the largest amount by which it is better in any objective, and a front by the least of
    its leads over the points.

    Args:
        front: points, a row each; the lead over an empty front is infinite.
        designs: rows to compare.
    """
    least, columns = np.full(len(designs), np.inf), np.ascontiguousarray(designs.T)
    for point in front:
        np.minimum(least, (point[:, None] - columns).max(axis=0), out=least)
    return least


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
            largest, by a rough integration; None without such a direction, or for a dominated design.
        weights: weights of the objectives per unit, from the multipliers. Along the front the weighted changes of the
            objectives add up to zero. None for an isolated design.
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

    @property
    def doubt(self) -> str:
        """Reason why the design does not belong to a front; empty if it does."""
        if not self.residual <= _LARGEST_RESIDUAL:
            return f"the first-order conditions are only met to {self.residual:.1e}"
        if self.curvature is not None and not self.curvature >= _LEAST_CURVATURE:
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


# --- neighbours on a front ---


def locations(objectives: Array) -> Array:
    """Return the locations of normalised objectives on the line or plane of utopia, a row each."""
    return np.asarray(objectives - np.mean(objectives, axis=1, keepdims=True))


def distances(objectives: Array) -> Array:
    """Return the distances between the locations of all rows, as the largest difference in any objective."""
    places = locations(objectives)
    return np.asarray(np.max(np.abs(places[:, None, :] - places[None, :, :]), axis=2))


def parts_of(objectives: Array, step: float) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """Return the connected parts of a front, and for each hole the two rows nearest across it.

    Holes are those of the shortest tree that connects all parts.

    Args:
        objectives: normalised objectives of efficient rows, in order.
        step: distance of neighbouring positions.
    """
    from scipy.sparse import csr_array  # slow to import, and every problem file imports this module
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    # To a sparse array a distance of 0 is none at all.
    tree = minimum_spanning_tree(csr_array(distances(objectives) + EQUAL)).tocoo()
    wide = tree.data > GAP[objectives.shape[1]] * step
    near = csr_array((tree.data[~wide], (tree.row[~wide], tree.col[~wide])), shape=tree.shape)
    _, label = connected_components(near, directed=False)
    parts = [np.flatnonzero(label == c).tolist() for c in dict.fromkeys(label.tolist())]
    pairs = np.sort(np.column_stack([tree.row, tree.col])[wide], axis=1).tolist()
    return parts, sorted((a, b) for a, b in pairs)
