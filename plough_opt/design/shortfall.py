"""The shortfall of designs in the objective's place: a search of it looks for designs that meet all requirements."""

import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import Landscape, Seen


class Shortfall:
    """The violations of a landscape without its objective, and the designs that were seen to meet all requirements.

    Attributes:
        vectorised: whether all runs are followed side by side.
        met: number of designs that met all requirements, some of them several times.
    """

    def __init__(self, landscape: Landscape) -> None:
        """Take the landscape."""
        self._landscape = landscape
        self._kept: list[Seen] = []
        self.vectorised, self.met = landscape.vectorised, 0

    @property
    def tried(self) -> int:
        """Number of designs that were looked at in the landscape."""
        return self._landscape.tried

    def __call__(self, points: Vector, *, finer: float = 1.0) -> Seen:
        """Look at designs, a row each: their objective is none."""
        return self._noted(self._landscape(points, finer=finer))

    def descend(self, start: Vector) -> Seen:
        """Return where the sum of all violations is least beside a start."""
        return self._noted(self._landscape.least_violation(start))

    def _noted(self, seen: Seen) -> Seen:
        if np.any(seen.feasible):
            self._kept.append(seen.of(seen.feasible))
            self.met += len(self._kept[-1].f)
        return without_objective(seen)

    def designs(self) -> Seen | None:
        """Return the different designs that met all requirements, with their objectives, or None if none did."""
        if not self._kept:
            return None
        every = self._kept[0].joined(*self._kept[1:])
        _, first = np.unique(every.points, axis=0, return_index=True)
        return every.of(np.sort(first))


def without_objective(seen: Seen) -> Seen:
    """Return designs whose merit is their violation alone."""
    return Seen(seen.points, np.where(np.isfinite(seen.violation), 0.0, np.nan), seen.violation)
