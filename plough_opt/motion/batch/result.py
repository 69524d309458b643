"""The results of a batch, as arrays over its designs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class BatchResult:
    """Results of a batch, an element for each design in the order in which they were given.

    Attributes:
        mean_draft: time average of the mount force P [N].
        force_rms: standard deviation of P about its mean [N].
        mean_deflection: time average of the spring's deflection [m].
        displacement_rms: its standard deviation [m].
        tow_power: mean of P s' [W].
        error_estimate: of mean draft and RMS force, relative to the larger of them: the terms that the steps left out,
            added up as if all of them pointed the same way, and carried along by the equation of small deviations from
            the motion; usually some hundred times too large. It is infinite for a motion that forgets its start.
        steps: number of steps of each design.
        reasons: position of a design without results, which are then NaN -> the reason.
        wanted: the relative error that was wanted.
        seconds: time taken.
        warnings: about the batch as a whole.
    """

    mean_draft: Array
    force_rms: Array
    mean_deflection: Array
    displacement_rms: Array
    tow_power: Array
    error_estimate: Array
    steps: Array
    reasons: dict[int, str]
    wanted: float
    seconds: float
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        """Return a summary in one line; the arrays would fill pages."""
        return (
            f"<BatchResult: {len(self)} designs in {self.seconds:.3g} s, {len(self.reasons)} without results,"
            f" {np.count_nonzero(self.missed)} less exact than {self.wanted:g}>"
        )

    def __len__(self) -> int:
        return len(self.mean_draft)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Which designs have no results: see `reasons`."""
        mask = np.zeros(len(self), dtype=bool)
        mask[list(self.reasons)] = True
        return mask

    @property
    def missed(self) -> NDArray[np.bool_]:
        """Which designs have results whose estimated error is larger than wanted."""
        return np.asarray(self.error_estimate > self.wanted)
