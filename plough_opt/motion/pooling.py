"""Averages of a run from those of its steps, with their derivatives."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

Average = Callable[[Sequence[ca.MX]], list[ca.MX]]
"""Taylor coefficients of what is averaged, a column for each step -> those of its average over the steps."""


def pairs(count: int) -> list[tuple[int, int]]:
    """Return the index pairs (a, b) with a <= b of second derivatives, in the order that jets use."""
    return [(a, b) for a in range(count) for b in range(a, count)]


def product(x: Sequence[Any], y: Sequence[Any], count: int) -> list[Any]:
    """Return the Taylor coefficients of a product, element by element, from those of its factors.

    Args:
        x: value, first derivatives by ``count`` parameters and, of order 2, the second ones of `pairs`.
        y: the same of the other factor.
        count: number of parameters.
    """
    found = [x[0] * y[0], *(x[0] * y[a] + x[a] * y[0] for a in range(1, 1 + count))]
    for k, (a, b) in enumerate(pairs(count) if len(x) > 1 + count else [], start=1 + count):
        found.append(x[0] * y[k] + x[k] * y[0] + x[1 + a] * y[1 + b] + x[1 + b] * y[1 + a])
    return found


def pooled(moments: Sequence[ca.MX], average: Average, signals: int, count: int = 0) -> tuple[ca.MX, ca.MX]:
    """Pool the moments of steps into means and mean squares about the mean.

    Args:
        moments: Taylor coefficients of the moments (means of all signals, then their spreads), a column for each step.
        average: over the steps.
        signals: their number.
        count: number of parameters by which the moments are differentiated.

    Returns:
        Both with the Taylor coefficients as columns.
    """
    own, spreads = [m[:signals, :] for m in moments], [m[signals:, :] for m in moments]
    means, squared, steps = average(own), spreads[0].shape[0], moments[0].shape[1]
    # Pooling the steps' own spreads with the spread of their means adds squares only: nothing cancels.
    drift = [m[:squared, :] - ca.repmat(mean[:squared], 1, steps) for m, mean in zip(own, means, strict=True)]
    squares = product(drift, drift, count)
    variances = average([spread + square for spread, square in zip(spreads, squares, strict=True)])
    return ca.horzcat(*means), ca.horzcat(*variances)
