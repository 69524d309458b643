"""The times of a run: where it is sampled, and where a fixed-step method sets its steps."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

READ_FROM: Final = 8
"""Ends of steps from which an output is read that lies at none of them."""

# Of n steps so many times n^(3/4) at the least lie on either side of a kink. They are enough to read between, and of
# a check with fewer steps they are so much fewer there too that what a short ramp leaves of error is seen.
_LEAST: Final = 0.6

# Part of the duration below which a kink is at rounding distance from the end of a step: it would make steps of no
# length.
_SHORT: Final = 1e-9


@dataclass(frozen=True)
class Timeline:
    """Steps and outputs of a run, as fractions of its duration.

    Args:
        outputs: number of equal intervals between output times.
        steps: number of integration steps. Of an adaptive method the most that it takes.
        kink: fraction at which the right-hand side is not smooth (the end of a tow ramp), or None. A
            step ends there, so that the method keeps its order. Between 0 and 1. Where no step need end at the
            outputs, steps are of equal length on either side of it, no longer than without it, and some on each.
        aligned: whether a step ends at each output; each output interval then takes the nearest whole number of
            steps, at least one. Else outputs are read between the ends of `READ_FROM` steps.
        moving: whether steps of order 8 end at kinks too wherever the parameters put these: see
            `plough_opt.motion.breaks`. Then they are aligned, an output interval takes no fewer steps than its share,
            and ``kink`` is None.
    """

    outputs: int
    steps: int
    kink: float | None = None
    aligned: bool = True
    moving: bool = False

    @cached_property
    def output_fractions(self) -> NDArray[np.float64]:
        """Output times as fractions of the duration, both ends included."""
        return np.linspace(0.0, 1.0, self.outputs + 1)

    @cached_property
    def nodes(self) -> NDArray[np.float64]:
        """Ends of the steps as fractions of the duration, both ends included."""
        if not self.aligned:
            return (
                self._in_two()
                if self.kink and _SHORT <= self.kink <= 1.0 - _SHORT
                else self._part(0.0, 1.0, self.steps)
            )
        share = self.steps / self.outputs
        per_interval = max(1, math.ceil(share) if self.moving else round(share))
        return self._with_kink(np.linspace(0.0, 1.0, self.outputs * per_interval + 1))

    def _in_two(self) -> NDArray[np.float64]:
        """Return the ends of steps to the kink and from there."""
        assert self.kink is not None  # else there is one part
        least = min(self.steps, math.ceil(_LEAST * self.steps**0.75))
        before, after = (max(math.ceil(part * self.steps), least) for part in (self.kink, 1.0 - self.kink))
        return np.concatenate([self._part(0.0, self.kink, before), self._part(self.kink, 1.0, after)[1:]])

    def _part(self, start: float, end: float, steps: int) -> NDArray[np.float64]:
        """Return the ends of a part's steps: of equal ones, of which the outermost two are halved.

        What is read from one side, between the outermost ends, is then as exact as in the middle: for half a radian a
        step rates are 1e-14 off, of equal steps 3e-12, and for 1.6 rad 2e-7, of equal steps 8e-5.
        """
        equal = np.linspace(start, end, steps + 1)
        if self.outputs == 1:  # and nothing is read
            return equal
        halves = (equal[0] + equal[1]) / 2.0, (equal[-2] + equal[-1]) / 2.0
        return np.unique(np.append(equal, halves))

    @cached_property
    def stops(self) -> NDArray[np.float64]:
        """Times at which a fixed step must end: the outputs and the kink, as fractions of the duration."""
        return self._with_kink(self.output_fractions)

    def _with_kink(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.kink is None or np.min(np.abs(nodes - self.kink)) < _SHORT:
            return nodes
        return np.sort(np.append(nodes, self.kink))

    @cached_property
    def output_columns(self) -> list[int]:
        """Index of each output time among the nodes of an aligned timeline."""
        return [int(i) for i in np.searchsorted(self.nodes, self.output_fractions - 1e-12)]
