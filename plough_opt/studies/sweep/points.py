"""The points of a sweep by their number, computed when they are needed, so that a million of them take no memory."""

import hashlib
import math
from collections.abc import Mapping
from typing import Final, Protocol

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.studies.sweep.axes import Axis, Range
from plough_opt.studies.sweep.work import Array

# As many numbers as SciPy's Sobol sequence of the default 30 bits has.
MOST_SAMPLES: Final = 2**30
# As many dimensions as SciPy's direction numbers cover.
_MOST_DIMENSIONS: Final = 21201


class Points(Protocol):
    """Points of a sweep, numbered from 0."""

    names: tuple[str, ...]
    count: int

    def block(self, first: int, last: int) -> Array:
        """Return the points from one number to before another, a row each, a column for each quantity."""

    def question(self) -> dict[str, str]:
        """Return the entries of the sweep's question that identify these points."""


class Grid:
    """All combinations of values; the last quantity changes fastest."""

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        """Take a range with a number of values, or values, for each quantity."""
        self.names = tuple(axes)
        self._values: list[Array] = []
        for name, axis in axes.items():
            if isinstance(axis, Range) and axis.count is None:
                raise InputError(
                    f"'{name}' runs from {axis.lower:g} to {axis.upper:g} without a number of values: a grid needs one;"
                    " or set a number of samples"
                )
            self._values.append(np.array(axis.values() if isinstance(axis, Range) else axis))
        self.count = math.prod(map(len, self._values))
        if self.count >= 2**63:
            raise InputError(f"the grid has {self.count:.3g} points: use fewer values, or a sample")

    def block(self, first: int, last: int) -> Array:
        """Return points, a row each."""
        places = np.unravel_index(np.arange(first, last), [len(values) for values in self._values])
        return np.column_stack([values[k] for values, k in zip(self._values, places, strict=True)])

    def question(self) -> dict[str, str]:
        """Return the values of each quantity."""
        return {f"over {name}": _short(x) for name, x in zip(self.names, self._values, strict=True)}


class Sample:
    """A scrambled Sobol sample of a box: scipy.stats.qmc.Sobol, scaled to the ranges."""

    def __init__(self, axes: Mapping[str, Axis], count: int, seed: int) -> None:
        """Take a range for each quantity.

        Raises:
            InputError: values instead of a range, a range with a number of values, or an invalid number of samples or
                seed.
        """
        if not is_count(count) or not 2 <= count <= MOST_SAMPLES:
            raise InputError(f"{count!r} samples: give a whole number from 2 to {MOST_SAMPLES}, best a power of two")
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise InputError(f"the seed {seed!r} must be a whole number from 0 on")
        if len(axes) > _MOST_DIMENSIONS:
            raise InputError(f"a Sobol sample has at most {_MOST_DIMENSIONS} quantities, not {len(axes)}")
        self.names = tuple(axes)
        self.count = count
        self._seed = seed
        self._ranges: list[Range] = []
        self._position = 0
        for name, axis in axes.items():
            if not isinstance(axis, Range):
                raise InputError(f"'{name}' runs over single values: a sample needs a range with two ends")
            if axis.count is not None:
                raise InputError(
                    f"'{name}' has a number of values, {axis.count}: a sample fills the range; leave it out"
                )
            self._ranges.append(axis)
        self._restart()

    def block(self, first: int, last: int) -> Array:
        """Return points, a row each; ascending blocks are fastest."""
        if first < self._position:
            self._restart()
        if first > self._position:
            self._engine.fast_forward(first - self._position)
        parts = [np.empty((0, len(self._ranges)))]
        if first == 0 and last > 1:
            # SciPy warns if the first draw is not a power of two, though the whole sample may be one.
            parts.append(self._engine.random(1))
            first = 1
        parts.append(self._engine.random(last - first))
        self._position = last
        unit = np.concatenate(parts)
        # One by one: NumPy may round powers differently at the end of a block, outside its vector registers.
        return np.array([[r.at(u) for r, u in zip(self._ranges, row, strict=True)] for row in unit.tolist()])

    def question(self) -> dict[str, str]:
        """Return the ranges, the number of samples and the seed."""
        ranges = {
            f"over {name}": f"{one.lower!r} to {one.upper!r}{' log' * one.log}"
            for name, one in zip(self.names, self._ranges, strict=True)
        }
        return {**ranges, "samples": str(self.count), "seed": str(self._seed)}

    def _restart(self) -> None:
        from scipy.stats import qmc  # slow to import, and not needed by a grid

        self._engine = qmc.Sobol(len(self._ranges), scramble=True, seed=self._seed)
        self._position = 0


def points_of(axes: Mapping[str, Axis], samples: int | None, seed: int) -> Points:
    """Return the grid of axes, or a sample with a number of points.

    Raises:
        InputError: no quantities, or as `Grid` and `Sample` raise.
    """
    if not axes:
        raise InputError("a sweep runs over one quantity or more: over is empty")
    return Grid(axes) if samples is None else Sample(axes, samples, seed)


def _short(values: Array) -> str:
    """Return values as text that identifies them: all of a few, ends and a digest of many."""
    if len(values) <= 16:
        return ", ".join(map(repr, values.tolist()))
    first, last = values[[0, -1]].tolist()
    return f"{len(values)} from {first!r} to {last!r}, digest {hashlib.sha256(values.tobytes()).hexdigest()[:16]}"
