"""Curves of two normalised objectives, both minimised: gaps, what is shown, area, knee.

The objectives are 0 at their own optimum and 1 at the other's. On a connected front the sum of the changes of both
objectives between neighbours on evenly spread positions is the same everywhere.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plough_opt.studies.tradeoff.domination import JOINED, Array

# Neighbours nearer than this many steps are one point twice.
_NEAR = 0.1
# A knee stands out from the line between the anchors by at least this.
_STANDS_OUT = 1e-3


def gaps(front: Array, step: float) -> list[int]:
    """Return after which rows of a front a gap follows.

    Args:
        front: normalised objectives of efficient rows in order.
        step: distance of neighbours, the sum of both changes.
    """
    distance = np.sum(np.abs(np.diff(front, axis=0)), axis=1)
    return [int(k) for k in np.flatnonzero(distance > JOINED * step)]


def spread(front: Array, step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those that crowd beside another; the ends of its parts stay.

    Args:
        front: normalised objectives of efficient rows in order.
        step: distance of neighbours, the sum of both changes.
    """
    ends = {k + 1 for k in gaps(front, step)}
    kept: list[int] = []
    for k in range(len(front)):
        if kept and np.sum(np.abs(front[k] - front[kept[-1]])) < _NEAR * step:
            last = k == len(front) - 1 or k + 1 in ends
            if not last or kept[-1] == 0 or kept[-1] in ends:
                continue
            kept.pop()
        kept.append(k)
    return np.array(kept, dtype=np.intp)


def needed(front: Array, extra: Sequence[bool], step: float) -> NDArray[np.intp]:
    """Return the rows of a front without those between positions that no gap would follow.

    Args:
        front: normalised objectives of efficient rows in order.
        extra: whether a row lies between positions.
        step: distance of neighbours, the sum of both changes.
    """
    kept: list[int] = []
    for k in range(len(front)):
        ends = kept and k + 1 < len(front)
        if extra[k] and ends and np.sum(np.abs(front[k + 1] - front[kept[-1]])) <= JOINED * step:
            continue
        kept.append(k)
    return np.array(kept, dtype=np.intp)


def area(front: Array, reference: Array) -> float:
    """Return the area that rows dominate up to a reference point, in the product of the objectives' units.

    Args:
        front: objectives of each row, both minimised.
        reference: a point; rows beyond it count for nothing.
    """
    total, height = 0.0, float(reference[1])
    for first, second in front[np.lexsort(front.T[::-1])]:
        if first < reference[0] and second < height:
            total += (float(reference[0]) - float(first)) * (height - float(second))
            height = float(second)
    return total


def knee(front: Array) -> int | None:
    """Return the row farthest below the plane on which the best rows of each objective lie, or the nearest of them.

    Args:
        front: objectives of efficient rows, all minimised.

    Returns:
        The row, or None where none is below: of two objectives the farthest below the line between both ends.
    """
    if len(front) < 3:
        return None
    low, high = front.min(axis=0), front.max(axis=0)
    sums = np.sum((front - low) / np.where(high > low, high - low, 1.0), axis=1)
    below = min(sums[k] for k in np.argmin(front, axis=0)) - sums
    best = int(np.argmax(below))
    return best if below[best] > _STANDS_OUT else None
