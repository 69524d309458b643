"""The straight ways between designs, which show whether they lie in one basin."""

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Landscape, Seen
from plough_opt.design.shortfall import Shortfall

SAME = 1e-3
"""Two scaled designs nearer than this are one."""

# Positions on a way at which a barrier is looked for.
_BETWEEN = 24
# A rise by less than this part of the merit is a ripple within a basin.
_RIPPLE = 1e-3
# Positions on a way down to an end, denser towards both of its ends, where narrow basins would show; by what part of
# the merit it may rise, as rounding and the end's own digits do; and how many ends, the nearest first, are tried.
_DOWN, _RISE, _NEAREST = 40, 1e-6, 4
# Each of how many positions is tried first.
_COARSE = 5


def barriers(landscape: Landscape | Shortfall, one: Seen, others: Seen) -> NDArray[np.bool_]:
    """Return for each of some designs whether a barrier, more than a ripple, parts it from another."""
    parts = np.linspace(0.0, 1.0, _BETWEEN + 2)[1:-1]
    way = one.points + parts[:, None, None] * (others.points - one.points)
    merit = landscape(way.reshape(-1, way.shape[2])).merit.reshape(_BETWEEN, -1)
    higher = np.maximum(others.merit, one.merit)
    found: NDArray[np.bool_] = merit.max(axis=0) > higher + _RIPPLE * np.abs(higher)
    return found


def straight_below(landscape: Landscape, start: Vector, ends: Seen) -> int | None:
    """Return the number of an end to which the merit does nothing but fall on the way from a start, or None.

    Such a start lies in the end's basin: a descent from it would lead there.
    """
    near: list[int] = []
    distance = np.max(np.abs(ends.points - start), axis=1)
    # Of ends that are one, the lowest.
    for k in np.lexsort((ends.merit, distance.round(3))):
        if np.isfinite(ends.merit[k]) and all(np.max(np.abs(ends.points[k] - ends.points[j])) >= SAME for j in near):
            near.append(int(k))
        if len(near) == _NEAREST:
            break
    parts = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _DOWN))
    # Most ways rise at once or not at all: a few positions suffice for most that do.
    for some in (parts[::_COARSE], parts):
        if near:
            near = [k for k, falls in zip(near, _fall(landscape, start, ends.points[near], some), strict=True) if falls]
    return near[0] if near else None


def _fall(landscape: Landscape, start: Vector, ends: Vector, parts: Vector) -> list[bool]:
    """Return for each of some ends whether the merit does nothing but fall at parts of the way from a start."""
    ways = start + parts[:, None] * (ends - start)[:, None]
    # Equal numbers of steps along a way, so that it rises by nothing that changes of these bring.
    merit = landscape(ways.reshape(-1, len(start)), together=len(parts)).merit.reshape(-1, len(parts))
    with np.errstate(invalid="ignore"):
        rise = np.max(merit[:, 1:] - np.minimum.accumulate(merit, axis=1)[:, :-1], axis=1)
        falls: list[bool] = (np.isfinite(merit).all(axis=1) & (rise <= _RISE * np.abs(merit[:, -1]))).tolist()
    return falls
