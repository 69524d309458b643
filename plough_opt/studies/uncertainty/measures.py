"""Measures of a result that varies with the soil, from its values over common samples.

Every function accepts the values of equally likely samples, as an array or as a CasADi column of a design's
expressions. From numbers, and without a width, the measure is exact for these samples. In a design it must be smooth:
a measure with kinks or jumps takes a width, in the unit of the values, over which it is smoothed. Its docstring gives
the largest difference.

The smoothed step and ramp are convolutions with the triweight kernel k(u) = 35/32 (1 - u^2)^3 on [-1, 1], u = x/width
(Wand and Jones 1995, "Kernel smoothing", section 2.2). They have continuous second derivatives, and beyond the width
they equal the step 1(x > 0) and the ramp max(x, 0). The kernel has the variance 1/9: averages over a density f differ
from the exact ones by f'(0) width^2/18 for the step and f(0) width^2/18 for the ramp, to first order. The smoothed ramp
exceeds the exact one by at most 35/256 of the width.
"""

import math
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.checks import LARGEST, LEAST, array_of, check_limits, check_single, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, floor, is_casadi, maximum, minimum, sqrt, total, where

# Halvings reduce a bracket of three widths to a thousandth of a width, an error that each Newton step squares.
_HALVINGS = 12
# The threshold is rounded to this part of a width.
_PER_WIDTH = 2.0**40
# Spread added to a standard deviation, relative to the mean, because the square root has no derivative at 0.
_LEAST_SPREAD = 1e-10
# Keeps denominators and roots above 0, and changes no digit of anything else.
_TINY = 1e-200
MOST_ROUNDING = 35.0 / 256.0
"""Largest difference of the smoothed ramp from max(x, 0), in widths."""

# Largest value of the kernel.
_PEAK = 35.0 / 32.0


# --- step and ramp ---------------------------------------------------------------------------------------------


def density(u: Column) -> Column:
    """Return the kernel k(u)."""
    inner = 1.0 - _clipped(u) ** 2
    return _PEAK * inner**3


def step(u: Column) -> Column:
    """Return the integral of the kernel up to u: 0 below -1, 1/2 at 0, 1 above 1."""
    u = _clipped(u)
    square = u * u
    # With the constants multiplied out, because a design evaluates this for each sample a dozen times.
    return 0.5 + u * (_PEAK + square * (-_PEAK + square * (0.6 * _PEAK + square * (-_PEAK / 7.0))))


def ramp(u: Column) -> Column:
    """Return the integral of the step up to u: 0 below -1, u above 1."""
    inner = _clipped(u)
    square = inner * inner
    rounded = _PEAK * square * (0.5 + square * (-0.25 + square * (0.1 - square / 56.0)))
    return MOST_ROUNDING + 0.5 * inner + rounded + maximum(u - 1.0, 0.0)


def _clipped(u: Column) -> Column:
    return minimum(maximum(u, -1.0), 1.0)


# --- measures --------------------------------------------------------------------------------------------------


def expected(values: Column) -> Column:
    """Return the mean.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> round(float(po.uncertainty.expected(values)), 3)
        4.0
    """
    column = _column(values)
    return total(column) / _count(column)


def standard_deviation(values: Column) -> Column:
    """Return the standard deviation about the mean, with 1/n.

    In a design it is larger by up to 1e-10 of the mean, so that it has a derivative if all samples are equal.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> round(float(po.uncertainty.standard_deviation(values)), 3)
        3.536
    """
    column = _column(values)
    mean = expected(column)
    variance: Column = total((column - mean) ** 2) / _count(column)
    if not is_casadi(column):
        return float(np.sqrt(variance))
    return sqrt(variance + (_LEAST_SPREAD * mean) ** 2 + _TINY)


def mean_plus(values: Column, kappa: float) -> Column:
    """Return mean + kappa * standard deviation; kappa is negative if small values are bad.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> round(float(po.uncertainty.mean_plus(values, 1.0)), 3)
        7.536
    """
    return expected(values) + plain_number("kappa", kappa) * standard_deviation(values)


def cvar(values: Column, level: float, *, width: Expression = 0.0) -> Column:
    """Return the conditional value at risk: the mean of the largest samples, a fraction 1 - level of all.

    It is the minimum over t of t + mean(max(v - t, 0))/(1 - level) (Rockafellar and Uryasev 2000). In a design the ramp
    is smoothed over a width and t is eliminated: the expression is smooth, has exact first and second derivatives and
    needs no further variable. It exceeds the exact measure by at most 35/256 width/(1 - level), and for many samples
    of density f by f(t) width^2/18/(1 - level).

    Args:
        values: values of the samples.
        level: from 0 to below 1; 0 gives the mean.
        width: width over which the ramp is smoothed, in the unit of the values; above 0 in a design.

    Raises:
        InputError: an invalid level or width.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> round(float(po.uncertainty.cvar(values, 0.5)), 3)
        6.5
    """
    level = plain_number("the level of a CVaR", level, at_least=0.0, below=1.0, why="0.9 means the worst tenth")
    column = _column(values)
    tail = 1.0 - level
    if not _is_smoothed("CVaR", column, width):
        # The last of the largest values has the fractional weight that is left.
        descending = np.sort(np.asarray(column, dtype=float))[::-1]
        weights = np.clip(tail * len(descending) - np.arange(len(descending)), 0.0, 1.0)
        return float(weights @ descending / np.sum(weights))
    scaled = column / width
    t = _threshold(scaled, tail)
    above = scaled - t
    slope = 1.0 - expected(step(above)) / tail
    curvature = expected(density(above)) / tail
    # The threshold t is computed without derivatives. The first derivative needs none, because the value is stationary
    # in t. The last term, a Newton step in t, adds the part of the second derivative that comes from the change of t.
    return width * (t + expected(ramp(above)) / tail - 0.5 * slope**2 / (curvature + _TINY))


def worst(values: Column, *, width: Expression = 0.0) -> Column:
    """Return the largest value; the smallest is -worst(-values).

    In a design it is the CVaR of the worst single sample, smoothed over a width. It exceeds the largest value by at
    most 35/256 of the width times the number of samples within a width of it, and equals it if the second largest is
    two widths below. `Robust.bound_from_above` is exact.

    Raises:
        InputError: an invalid width.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> round(float(po.uncertainty.worst(values)), 3)
        10.0
    """
    column = _column(values)
    if not _is_smoothed("worst case", column, width):
        return float(np.max(column))
    return cvar(column, 1.0 - 1.0 / _count(column), width=width)


def probability(
    values: Column, *, at_least: float | None = None, at_most: float | None = None, width: Expression = 0.0
) -> Column:
    """Return the fraction of the samples within limits.

    In a design each sample is weighted by a smooth step of its distance from the limit, over +- a width. For many
    samples of density f the probability is then wrong by f'(limit) width^2/18, of either sign, to first order.

    Args:
        values: values of the samples.
        at_least: lower limit, in the unit of the values, or None.
        at_most: upper limit, or None.
        width: half the range of the smooth step; above 0 in a design.

    Raises:
        InputError: no limit, limits that contradict each other, or an invalid width.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> float(po.uncertainty.probability(values, at_most=5.0))
        0.75
    """
    if at_least is None and at_most is None:
        raise InputError("a probability needs a limit: give at_least, at_most or both")
    low = -math.inf if at_least is None else plain_number("at_least", at_least)
    high = math.inf if at_most is None else plain_number("at_most", at_most)
    check_limits("a probability", low, high)
    column = _column(values)
    if not _is_smoothed("probability", column, width):
        return float(np.mean((column >= low) & (column <= high)))
    steps = [] if at_least is None else [step((column - low) / width)]
    steps += [] if at_most is None else [step((high - column) / width)]
    return expected(sum(steps[1:], steps[0])) - (len(steps) - 1.0)


def quantile(values: Column, level: float, *, width: Expression = 0.0) -> Column:
    """Return the value that a fraction ``level`` of the samples does not exceed.

    In a design it is the limit at which `probability` with at_most and the same width equals the level. Requiring a
    quantile therefore allows the same designs as requiring that probability, but a quantile has a slope everywhere and
    a probability of 0 or 1 has none. The quantile must lie within a width of some sample: use a width larger than the
    samples' distance.

    Args:
        values: values of the samples.
        level: between 0 and 1.
        width: as for `probability`; above 0 in a design.

    Raises:
        InputError: an invalid level or width.

    Example:
        >>> import numpy as np
        >>> import plough_opt as po
        >>> values = np.array([1.0, 2.0, 3.0, 10.0])
        >>> round(float(po.uncertainty.quantile(values, 0.5)), 3)
        2.0
    """
    level = plain_number("the level of a quantile", level, above=0.0, below=1.0)
    column = _column(values)
    if not _is_smoothed("quantile", column, width):
        return float(np.quantile(column, level, method="inverted_cdf"))
    scaled = column / width
    t = _threshold(scaled, 1.0 - level)
    # The threshold is computed without derivatives. A first Newton step gives the root its first derivative, a second
    # one its second.
    for _ in range(2):
        excess = expected(step(scaled - t)) - (1.0 - level)
        t = t + excess / (expected(density(scaled - t)) + _TINY)
    return width * t


def _threshold(scaled: Column, part: float) -> Column:
    """Return t with mean(step(scaled - t)) = part, found by bisection and Newton steps; its derivatives are 0.

    The first bracket and the result are rounded, because rounding has the derivative 0.
    """
    # Fewer samples than the part lie above the bracket, whose ends are a width and more from this one.
    middle: Column = floor(_largest(scaled, math.ceil(part * _count(scaled))))
    low, high = middle - 1.0, middle + 2.0
    for _ in range(_HALVINGS):
        t = 0.5 * (low + high)
        too_low = expected(step(scaled - t)) > part
        low, high = where(too_low, t, low), where(too_low, high, t)
    t = 0.5 * (low + high)
    for _ in range(2):
        t = t + (expected(step(scaled - t)) - part) / (expected(density(scaled - t)) + _TINY)
        t = minimum(maximum(t, low), high)
    return floor(t * _PER_WIDTH) / _PER_WIDTH


def _largest(column: Column, number: int) -> Column:
    """Return the n-th largest value of a column, counted from 1.

    Expressions go through the sorting network of Batcher (1968), "Sorting networks and their applications": compared
    with counting the values above a threshold, halving by halving, it takes a quarter of the operations.
    """
    if not is_casadi(column):
        return float(np.sort(column)[-number])
    count, size = _count(column), 1
    values: Any = type(column)(column)
    while size < count:
        apart = size
        while apart:
            k = np.arange(apart % size, count - apart)
            compared = ((k - apart % size) // apart % 2 == 0) & (k // (2 * size) == (k + apart) // (2 * size))
            lower, upper = k[compared].tolist(), (k[compared] + apart).tolist()
            smaller, larger = ca.fmin(values[lower], values[upper]), ca.fmax(values[lower], values[upper])
            values[lower], values[upper] = smaller, larger
            apart //= 2
        size *= 2
    return values[count - number]


def _is_smoothed(what: str, column: Column, width: Expression) -> bool:
    """Return whether a measure is smoothed; raise InputError for an invalid width, or for expressions without one."""
    if is_casadi(width):
        check_single(f"the width of a {what}", width)
        return True
    number = plain_number(f"the width of a {what}", width, at_least=0.0, why="it is in the unit of the values")
    if 0.0 < number < LEAST:
        raise InputError(f"the width {shown(width)} of a {what} must be 0 or at least {LEAST:g}: leave it out")
    if number == 0.0 and is_casadi(column):
        raise InputError(
            f"in a design a {what} needs a width, in the unit of its values, over which it is smoothed: a few"
            " tenths of their standard deviation will do"
        )
    return number > 0.0


def _column(values: Column) -> Column:
    """Return values as a column; raise InputError if there are none, or if some are not finite numbers."""
    symbolic = is_casadi(values)
    column = ca.vec(values) if symbolic else array_of(values, "{} are not samples: give a column of numbers").ravel()
    if not _count(column):
        raise InputError("there are no samples: a measure needs at least one value")
    if symbolic:
        return column
    numbers = np.asarray(column)
    if not np.all(np.isfinite(numbers)):
        raise InputError(f"{np.sum(~np.isfinite(numbers))} of {len(numbers)} samples are not finite: leave them out")
    if np.any(np.abs(numbers) > LARGEST):
        raise InputError(f"a sample of {numbers[np.argmax(np.abs(numbers))]:g} must lie within {LARGEST:g} in size")
    return numbers


def _count(column: Column) -> int:
    return int(column.numel()) if is_casadi(column) else int(column.size)
