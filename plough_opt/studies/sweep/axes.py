"""The values of a quantity in a sweep: a range, or a list."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from plough_opt.core.checks import check_switch, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count

MOST_VALUES: Final = 1_000_000
"""Limit on the values of one quantity of a grid, which are held in memory; the points are not."""


@dataclass(frozen=True)
class Range:
    """A range of a quantity, for a grid or for a sample.

    Args:
        lower: first value, SI.
        upper: last value, above ``lower``.
        count: number of values of a grid, ends included, 2 to a million; None for a sample, which fills the range.
        log: whether the steps of the logarithm are equal; both ends must then be above 0.

    Raises:
        InputError: ends that are not finite numbers in ascending order, an invalid count, or a logarithmic range that
            does not begin above 0.

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
        for end in (self.lower, self.upper):
            plain_number("the end of a range", end)
        for side in ("lower", "upper"):
            # 1, 1.0 and NumPy's 1.0 are the same sweep in a store.
            object.__setattr__(self, side, float(getattr(self, side)))
        if not self.lower < self.upper:
            raise InputError(f"the range from {self.lower:g} to {self.upper:g} is empty: its first end must be lower")
        check_switch("log", self.log)
        if self.log and not self.lower > 0.0:
            raise InputError(f"a logarithmic range must begin above 0, not at {self.lower:g}")
        if self.count is not None and (not is_count(self.count) or self.count < 2):
            raise InputError(f"the number of values is {shown(self.count)}: it must be a whole number from 2 on")
        if self.count is not None and self.count > MOST_VALUES:
            given = shown(self.count)
            raise InputError(f"the number of values is {given}: it can be {MOST_VALUES} at most; use a sample")

    def values(self) -> tuple[float, ...]:
        """Return the values of a grid, the ends exactly."""
        if self.count is None:
            raise InputError(
                f"the range from {self.lower:g} to {self.upper:g} has no number of values: a grid needs one"
            )
        steps = np.geomspace if self.log else np.linspace
        return tuple(steps(self.lower, self.upper, self.count).tolist())

    def at(self, fraction: float) -> float:
        """Return the value at a fraction of the range, from 0 to 1.

        Raises:
            InputError: a fraction that is not a number.
        """
        fraction = plain_number("the fraction of a range", fraction)
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** fraction)
        # In the order in which scipy.stats.qmc.scale computes it.
        return fraction * (self.upper - self.lower) + self.lower


Axis = Range | tuple[float, ...]


def axis_of(name: str, given: object) -> Axis:
    """Return the checked values of a quantity.

    Args:
        name: of the quantity.
        given: a `Range` or numbers, SI.

    Raises:
        InputError: another type, fewer than two numbers, the same one twice, or one that is not finite.
    """
    if isinstance(given, Range):
        return given
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f"'{name}' runs over {shown(given)}: give a po.Range or a list of numbers")
    listed = list(given)
    if not all(isinstance(x, int | float | np.number) and not isinstance(x, bool) for x in listed):
        raise InputError(f"'{name}' runs over {shown(listed)}, which are not all numbers")
    values = tuple(float(x) for x in listed)
    if bad := [x for x in values if not math.isfinite(x)]:
        raise InputError(f"'{name}' runs over {bad[0]}: every value must be finite")
    if len(values) < 2:
        raise InputError(f"'{name}' runs over {len(values)} value(s): a sweep needs two or more; fix it instead")
    if len(set(values)) < len(values):
        raise InputError(f"'{name}' runs over the same value twice")
    return values
