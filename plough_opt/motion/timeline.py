"""The times of a run: where it is sampled, and where a fixed-step method sets its steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Timeline:
    """Steps and outputs of a run, as fractions of its duration.

    Args:
        outputs: number of equal intervals between output times.
        steps: number of integration steps. Of an adaptive method the most that it takes.
        kink: fraction at which the right-hand side is not smooth (the end of a tow ramp), or None. A
            step ends there, so that the method keeps its order. Between 0 and 1.
        aligned: whether a step ends at each output; each output interval then takes the nearest whole number of
            steps, at least one.
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
        share = self.steps / self.outputs
        per_interval = max(1, math.ceil(share) if self.moving else round(share))
        steps = self.outputs * per_interval if self.aligned else self.steps
        return self._with_kink(np.linspace(0.0, 1.0, steps + 1))

    @cached_property
    def stops(self) -> NDArray[np.float64]:
        """Times at which a fixed step must end: the outputs and the kink, as fractions of the duration."""
        return self._with_kink(self.output_fractions)

    def _with_kink(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        # A kink at rounding distance from a node would make a step of no length.
        if self.kink is None or np.min(np.abs(nodes - self.kink)) < 1e-9:
            return nodes
        return np.sort(np.append(nodes, self.kink))

    @cached_property
    def output_columns(self) -> list[int]:
        """Index of each output time among the nodes of an aligned timeline."""
        return [int(i) for i in np.searchsorted(self.nodes, self.output_fractions - 1e-12)]
