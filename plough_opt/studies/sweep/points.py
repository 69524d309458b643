"""The points of a sweep: all combinations of values, or a Sobol sample of ranges."""

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from plough_opt.core.checks import check_bounds, check_switch, plain_number, shown, whole_number
from plough_opt.core.errors import InputError, about
from plough_opt.core.plain_data import Array

MOST_POINTS: Final = 10_000_000
"""Limit on the points of a sweep, which are held in memory with their results."""


@dataclass(frozen=True)
class Range:
    """A range of a quantity, for a grid or for a sample.

    Args:
        lower: first value, SI.
        upper: last value, above ``lower``.
        count: number of values of a grid, ends included, from 2 on; None for a sample, which fills the range.
        log: whether values are equally spaced on a logarithmic scale; both ends must then be above 0.

    Raises:
        InputError: the ends are not finite numbers in ascending order, count is invalid, or a logarithmic range does
            not begin above 0.

    Example:
        >>> import plough_opt as po
        >>> po.Range(1.0, 3.0, 5).count
        5
    """

    lower: float
    upper: float
    count: int | None = None
    log: bool = False

    def __post_init__(self) -> None:
        for side in ("lower", "upper"):
            object.__setattr__(self, side, plain_number("the end of a range", getattr(self, side)))
        check_switch("log", self.log)
        check_bounds("a range", self.lower, self.upper, log=self.log)
        if self.count is not None:
            whole_number("the number of values", self.count, 2, MOST_POINTS)

    def values(self) -> tuple[float, ...]:
        """Return the values for a grid, with both ends exact.

        Example:
            >>> import plough_opt as po
            >>> po.Range(1.0, 3.0, 5).values()
            (1.0, 1.5, 2.0, 2.5, 3.0)
        """
        if self.count is None:
            none = f"the range from {self.lower:g} to {self.upper:g} has no number of values"
            raise InputError(f"{none}, which a grid needs: add one, or set a number of samples")
        return tuple((np.geomspace if self.log else np.linspace)(self.lower, self.upper, self.count).tolist())

    def at(self, fraction: float) -> float:
        """Return the value at a fraction of the range, from 0 to 1.

        Raises:
            InputError: the fraction is not a number.

        Example:
            >>> import plough_opt as po
            >>> po.Range(10.0, 1000.0, 3, log=True).at(0.5)
            100.0
        """
        fraction = plain_number("the fraction of a range", fraction)
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** fraction)
        # The same order of operations as in scipy.stats.qmc.scale.
        return fraction * (self.upper - self.lower) + self.lower


Axis = Range | tuple[float, ...]


def axis_of(name: str, given: object) -> Axis:
    """Check and return the values over which a quantity is swept.

    Args:
        name: of the quantity.
        given: a `Range` or numbers, SI.

    Raises:
        InputError: the type is wrong, there are fewer than two numbers, or one is repeated or not finite.
    """
    if isinstance(given, Range):
        return given
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f"'{name}' runs over {shown(given)}: give a po.Range or a list of numbers")
    values = tuple(plain_number(f"a value of '{name}'", x) for x in given)
    if len(values) < 2:
        raise InputError(f"'{name}' runs over {shown(values)}: a sweep needs two values or more; or set this one")
    if len(set(values)) < len(values):
        raise InputError(f"'{name}' runs over the same value twice")
    return values


def points_of(axes: Mapping[str, Axis], samples: int | None, seed: int) -> Array:
    """Return a row for each point: of a grid, whose last quantity changes fastest, or of a scrambled Sobol sample.

    Args:
        axes: quantity -> values or range.
        samples: number of points of a sample of the ranges (scipy.stats.qmc.Sobol), or None for a grid.
        seed: of the sample.

    Raises:
        InputError: there are no quantities or too many points, a range of a grid has no number of values, or one of a
            sample is none or has such a number.
    """
    if not axes:
        raise InputError("over is empty: a sweep needs at least one quantity")
    if samples is None:
        values = []
        for name, axis in axes.items():
            with about(f"'{name}':"):
                values.append(axis.values() if isinstance(axis, Range) else axis)
        if (count := math.prod(map(len, values))) > MOST_POINTS:
            raise InputError(f"the grid has {count:.3g} points, more than {MOST_POINTS}: use fewer values, or a sample")
        return np.array([*itertools.product(*values)])
    from scipy.stats import qmc  # imported only for samples, because that is slow

    whole_number("the number of samples", samples, 2, MOST_POINTS)
    ranges = [axis for axis in axes.values() if isinstance(axis, Range) and axis.count is None]
    if len(ranges) < len(axes):
        raise InputError(
            "a sample fills the range of each quantity: give a range with two ends, and no number of values"
        )
    sobol = qmc.Sobol(len(axes), scramble=True, seed=whole_number("the seed", seed))
    # SciPy warns unless the size of the first draw is a power of two.
    unit = np.concatenate([sobol.random(1), sobol.random(samples - 1)]).tolist()
    return np.array([[own.at(u) for own, u in zip(ranges, row, strict=True)] for row in unit])
