"""The points of a sweep: ranges and lists of values, and the grids and samples made of them.

Points are computed from their numbers when they are needed, so that a million of them take no memory.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from plough_opt.core.checks import check_switch, plain_number, shown, whole_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.plain_data import Array

MOST_VALUES: Final = 1_000_000
"""Limit on the values of one quantity of a grid, which are held in memory, unlike the points."""
# Length of SciPy's Sobol sequence with the default 30 bits.
MOST_SAMPLES: Final = 2**30


@dataclass(frozen=True)
class Range:
    """A range of a quantity, for a grid or for a sample.

    Args:
        lower: first value, SI.
        upper: last value, above ``lower``.
        count: number of values of a grid, ends included, 2 to a million; None for a sample, which fills the range.
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
            # As floats, so that 1, 1.0 and NumPy's 1.0 give the same question in a store.
            object.__setattr__(self, side, plain_number("the end of a range", getattr(self, side)))
        if not self.lower < self.upper:
            raise InputError(
                f"the range from {self.lower:g} to {self.upper:g} is empty: the first end must be the lower one"
            )
        check_switch("log", self.log)
        if self.log and not self.lower > 0.0:
            raise InputError(f"a logarithmic range must begin above 0, not at {self.lower:g}")
        if self.count is not None and (not is_count(self.count) or self.count < 2):
            raise InputError(f"the number of values is {shown(self.count)}: it must be a whole number, at least 2")
        if self.count is not None and self.count > MOST_VALUES:
            given = shown(self.count)
            raise InputError(f"the number of values is {given}: it can be at most {MOST_VALUES}; use a sample instead")

    def values(self) -> tuple[float, ...]:
        """Return the values for a grid, with both ends exact.

        Example:
            >>> import plough_opt as po
            >>> po.Range(1.0, 3.0, 5).values()
            (1.0, 1.5, 2.0, 2.5, 3.0)
        """
        if self.count is None:
            raise InputError(
                f"the range from {self.lower:g} to {self.upper:g} has no number of values, which a grid needs: add"
                " one, or set a number of samples"
            )
        steps = np.geomspace if self.log else np.linspace
        return tuple(steps(self.lower, self.upper, self.count).tolist())

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
    listed = list(given)
    if not all(isinstance(x, int | float | np.number) and not isinstance(x, bool) for x in listed):
        raise InputError(f"'{name}' runs over {shown(listed)}, which are not all numbers")
    values = tuple(float(x) for x in listed)
    if bad := [x for x in values if not math.isfinite(x)]:
        raise InputError(f"'{name}' runs over {bad[0]}: every value must be finite")
    if len(values) < 2:
        raise InputError(
            f"'{name}' runs over {shown(listed)}: a sweep needs two values or more; set a single one instead"
        )
    if len(set(values)) < len(values):
        raise InputError(f"'{name}' runs over the same value twice")
    return values


class PointGrid:
    """All combinations of the values of several quantities; the last quantity changes fastest."""

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        """Take, for each quantity, values or a range with a number of values."""
        self.names = tuple(axes)
        self._values: list[Array] = []
        for name, axis in axes.items():
            try:
                self._values.append(np.array(axis.values() if isinstance(axis, Range) else axis))
            except InputError as error:
                raise InputError(f"'{name}': {error}") from None
        self.count = math.prod(map(len, self._values))
        if self.count >= 2**63:
            raise InputError(f"the grid has {self.count:.3g} points: use fewer values, or a sample")

    def block(self, first: int, last: int) -> Array:
        """Return the points from number ``first`` to before ``last``, a row each."""
        places = np.unravel_index(np.arange(first, last), [len(values) for values in self._values])
        return np.column_stack([values[k] for values, k in zip(self._values, places, strict=True)])

    def question(self) -> dict[str, str]:
        """Return the values of each quantity as texts."""
        return {f"over {name}": _short(x) for name, x in zip(self.names, self._values, strict=True)}


class PointSample:
    """A scrambled Sobol sample: scipy.stats.qmc.Sobol, scaled to the ranges of several quantities."""

    def __init__(self, axes: Mapping[str, Axis], count: int, seed: int) -> None:
        """Take a range for each quantity.

        Raises:
            InputError: values are given instead of a range, a range has a number of values, or the number of samples or
                the seed is invalid.
        """
        if not is_count(count) or not 2 <= count <= MOST_SAMPLES:
            raise InputError(f"{count!r} samples: give a whole number from 2 to {MOST_SAMPLES}, best a power of two")
        self.names = tuple(axes)
        self.count = count
        self._seed = whole_number("the seed", seed)
        self._ranges: list[Range] = []
        self._position = 0
        for name, axis in axes.items():
            if not isinstance(axis, Range):
                raise InputError(f"'{name}' runs over single values: a sample needs a range with two ends")
            if axis.count is not None:
                raise InputError(
                    f"'{name}' has a number of values, {axis.count}: leave it out, because a sample fills the range"
                )
            self._ranges.append(axis)
        self._restart()

    def block(self, first: int, last: int) -> Array:
        """Return the points from number ``first`` to before ``last``, a row each; ascending blocks are fastest."""
        if first < self._position:
            self._restart()
        if first > self._position:
            self._engine.fast_forward(first - self._position)
        parts = [np.empty((0, len(self._ranges)))]
        if first == 0 and last > 1:
            # SciPy warns unless the size of the first draw is a power of two.
            parts.append(self._engine.random(1))
            first = 1
        parts.append(self._engine.random(last - first))
        self._position = last
        unit = np.concatenate(parts)
        # One value at a time, because NumPy may round the last ones of a block differently (outside vector registers).
        return np.array([[r.at(u) for r, u in zip(self._ranges, row, strict=True)] for row in unit.tolist()])

    def question(self) -> dict[str, str]:
        """Return the ranges, the number of samples and the seed as texts."""
        ranges = {
            f"over {name}": f"{axis.lower!r} to {axis.upper!r}{' log' * axis.log}"
            for name, axis in zip(self.names, self._ranges, strict=True)
        }
        return {**ranges, "samples": str(self.count), "seed": str(self._seed)}

    def _restart(self) -> None:
        from scipy.stats import qmc  # imported only for samples, because that is slow

        self._engine = qmc.Sobol(len(self._ranges), scramble=True, seed=self._seed)
        self._position = 0


def points_of(axes: Mapping[str, Axis], samples: int | None, seed: int) -> PointGrid | PointSample:
    """Return a grid, or a sample if a number of samples is given.

    Raises:
        InputError: there are no quantities, or `PointGrid` or `PointSample` raises.
    """
    if not axes:
        raise InputError("over is empty: a sweep needs at least one quantity")
    return PointGrid(axes) if samples is None else PointSample(axes, samples, seed)


def _short(values: Array) -> str:
    """Return a text that identifies values: all of them if they are few, otherwise the ends and a digest."""
    if len(values) <= 16:
        return ", ".join(map(repr, values.tolist()))
    first, last = values[[0, -1]].tolist()
    return f"{len(values)} from {first!r} to {last!r}, digest {hashlib.sha256(values.tobytes()).hexdigest()[:16]}"
