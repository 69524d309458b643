"""What a robust design asks of a result that varies with the soil, from its values over common samples.

Every function takes the values of equally likely samples as an array or as a CasADi column of a design's expressions.
Of numbers each measure is that of the samples, sharp. In a design it must be smooth: where it is not so by itself it
takes a width, in the unit of the values, over which it is rounded off, and its docstring says by how much at most.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from plough_opt.core.domain import plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, is_casadi, sqrt, where
from plough_opt.core.kinds import shown
from plough_opt.studies.uncertainty import smoothing

# Halvings of a range of a million widths leave its last 1e-9, which one step of Newton's method squares.
_HALVINGS = 50
# Relative to the mean, below which a spread is none and its root has no derivative.
_LEAST_SPREAD = 1e-10
_TINY = 1e-200


def expected(values: Expression) -> Expression:
    """Return the mean."""
    column = _column(values)
    return _sum(column) / _count(column)


def standard_deviation(values: Expression) -> Expression:
    """Return the standard deviation about the mean, with 1/n.

    In a design its root is rounded off, upwards, by 1e-10 of the mean, where all samples are alike.
    """
    column = _column(values)
    mean = expected(column)
    variance = _sum((column - mean) ** 2) / _count(column)
    if not is_casadi(column):
        return float(np.sqrt(variance))
    return sqrt(variance + (_LEAST_SPREAD * mean) ** 2 + _TINY)


def mean_plus(values: Expression, kappa: float) -> Expression:
    """Return mean + kappa * standard deviation; a negative kappa where small values are bad."""
    return expected(values) + plain_number("kappa", kappa) * standard_deviation(values)


def cvar(values: Expression, level: float, *, width: float = 0.0) -> Expression:
    """Return the mean of the worst part 1 - level of the samples, the largest: the conditional value at risk.

    By the minimum over t of t + mean(max(v - t, 0))/(1 - level) (Rockafellar and Uryasev 2000). In a design the ramp
    is rounded off over a width, and t is eliminated: what is left is a smooth expression with exact first and second
    derivatives and no further variable. It then lies above the sharp one, by at most 35/256 width/(1 - level), and for
    many samples of density f by f(t) width^2/18/(1 - level).

    Args:
        values: of the samples.
        level: from 0 to below 1; 0 is the mean.
        width: over which the ramp is rounded off, in the unit of the values; above 0 in a design.

    Raises:
        InputError: a level or a width that cannot be.
    """
    level = plain_number("the level of a CVaR", level)
    if not 0.0 <= level < 1.0:
        raise InputError(f"the level {shown(level)} of a CVaR must lie from 0 to below 1: 0.9 means the worst tenth")
    column = _column(values)
    part = 1.0 - level
    if not _smooth("CVaR", column, width):
        return _sharp_cvar(np.asarray(column, dtype=float), part)
    scaled = column / width
    t = _threshold(scaled, part)
    above = scaled - t
    rest = 1.0 - expected(smoothing.step(above)) / part
    curvature = expected(smoothing.density(above)) / part
    # t is a number to whoever differentiates: at the minimum the value does not change with it, and the last term, a
    # step of Newton's method, carries what the second derivative owes to its change.
    return width * (t + expected(smoothing.ramp(above)) / part - 0.5 * rest**2 / (curvature + _TINY))


def worst(values: Expression, *, width: float = 0.0) -> Expression:
    """Return the largest value; the smallest is -worst(-values).

    In a design it is the CVaR of the worst single sample, rounded off over a width: above the largest value by at most
    35/256 of the width times the number of samples that come so close to it, and exactly it where the second
    largest is two widths below. `bound_from_above` is the sharp one.

    Raises:
        InputError: a width that cannot be.
    """
    column = _column(values)
    if not _smooth("worst case", column, width):
        return float(np.max(column))
    return cvar(column, 1.0 - 1.0 / _count(column), width=width)


def probability(
    values: Expression, *, at_least: float | None = None, at_most: float | None = None, width: float = 0.0
) -> Expression:
    """Return the part of the samples within limits.

    In a design a sample counts by a smooth step of its distance from the limit over +- a width. For many samples of
    density f the probability is then off by f'(limit) width^2/18, of either sign, to first order.

    Args:
        values: of the samples.
        at_least: lower limit, in the unit of the values, or None.
        at_most: upper limit, or None.
        width: half the range over which a sample comes to count; above 0 in a design.

    Raises:
        InputError: no limit, limits that contradict each other, or a width that cannot be.
    """
    if at_least is None and at_most is None:
        raise InputError("a probability needs a limit: give at_least, at_most or both")
    low = -math.inf if at_least is None else plain_number("at_least", at_least)
    high = math.inf if at_most is None else plain_number("at_most", at_most)
    if low > high:
        raise InputError(f"the limits of a probability contradict each other: at least {low:g}, at most {high:g}")
    column = _column(values)
    if not _smooth("probability", column, width):
        return float(np.mean((column >= low) & (column <= high)))
    parts = [] if at_least is None else [smoothing.step((column - low) / width)]
    parts += [] if at_most is None else [smoothing.step((high - column) / width)]
    return expected(sum(parts[1:], parts[0])) - (len(parts) - 1.0)


def quantile(values: Expression, level: float, *, width: float = 0.0) -> Expression:
    """Return the value that a part ``level`` of the samples does not exceed.

    Rounded off it is where `probability` with at_most and the same width equals the level: to require that the quantile
    is at most a limit is to require that probability, but it has a slope wherever the design is, where a
    probability of 0 or 1 has none. It must then lie within a width of some sample: take more than their distance.

    Args:
        values: of the samples.
        level: between 0 and 1.
        width: as of `probability`; above 0 in a design.

    Raises:
        InputError: a level or a width that cannot be.
    """
    level = plain_number("the level of a quantile", level)
    if not 0.0 < level < 1.0:
        raise InputError(f"the level {shown(level)} of a quantile must lie between 0 and 1")
    column = _column(values)
    if not _smooth("quantile", column, width):
        return float(np.quantile(column, level, method="inverted_cdf"))
    scaled = column / width
    t = _threshold(scaled, 1.0 - level)
    # The threshold is a constant to whoever differentiates: the first step of Newton's method carries the first
    # derivative of the root, the next one the second.
    for _ in range(2):
        excess = expected(smoothing.step(scaled - t)) - (1.0 - level)
        t = t + excess / (expected(smoothing.density(scaled - t)) + _TINY)
    return width * t


def _threshold(scaled: Expression, part: float) -> Expression:
    """Return t where mean(step(scaled - t)) = part, by halving; a constant to whoever differentiates.

    Its first bracket ends at whole numbers, which change by jumps.
    """
    low, high = _floor(_least(scaled)) - 1.0, _floor(-_least(-scaled)) + 2.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        beyond = expected(smoothing.step(scaled - middle)) > part
        low, high = where(beyond, middle, low), where(beyond, high, middle)
    return 0.5 * (low + high)


def _sharp_cvar(values: np.ndarray, part: float) -> float:
    """Return the mean of the largest values, the last of them in part."""
    falling = np.sort(values)[::-1]
    left = part * len(falling) - np.arange(len(falling))
    shares = np.clip(left, 0.0, 1.0)
    return float(shares @ falling / np.sum(shares))


def _smooth(what: str, column: Expression, width: float) -> bool:
    """Return whether a width rounds the measure off, which it must do of expressions."""
    if plain_number(f"the width of a {what}", width) < 0.0:
        raise InputError(
            f"the width {shown(width)} of a {what} must be a number of at least 0, in the unit of the values"
        )
    if width == 0.0 and is_casadi(column):
        raise InputError(
            f"in a design a {what} needs a width, in the unit of its values, over which it is rounded off: a few"
            " tenths of their standard deviation will do"
        )
    return width > 0.0


def _column(values: Expression) -> Expression:
    """Return values as a column; refuse none, and numbers that are none."""
    if is_casadi(values):
        column = ca.vec(values)
        if column.numel() == 0:
            raise InputError("there are no samples to take a measure of")
        return column
    try:
        numbers = np.asarray(values, dtype=float).ravel()
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{shown(values)} are no samples: give a column of numbers") from None
    if not len(numbers):
        raise InputError("there are no samples to take a measure of")
    if not np.all(np.isfinite(numbers)):
        raise InputError(f"{np.sum(~np.isfinite(numbers))} of {len(numbers)} samples are not finite: leave them out")
    return numbers


def _count(column: Expression) -> int:
    return int(column.numel()) if is_casadi(column) else int(column.size)


def _sum(column: Expression) -> Expression:
    return ca.sum1(column) if is_casadi(column) else float(np.sum(column))


def _least(column: Expression) -> Expression:
    return ca.mmin(column) if is_casadi(column) else float(np.min(column))


def _floor(value: Expression) -> Expression:
    return ca.floor(value) if is_casadi(value) else math.floor(value)
