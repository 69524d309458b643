"""Which designs of a batch lie outside the model's domain, and why: the same checks that a single scene has."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import PloughError
from plough_opt.core.expressions import is_quantity, map_expressions
from plough_opt.core.quantities import BESIDE
from plough_opt.motion.batch.program import Array
from plough_opt.motion.scene import Scene

# Designs among which one without a fault is looked for.
_TRIALS = 32


class DomainCheck:
    """Rebuilds a scene with arrays for its quantities, and looks for the designs for which that is refused."""

    def __init__(self, template: Scene, fixed: list[float | None]) -> None:
        """Take a scene with placeholders, and what of its quantities is a number for all designs."""
        self._template = template
        self._fixed = fixed

    def reasons(self, rows: Array) -> dict[int, str]:
        """Return why designs are refused, by their position.

        Args:
            rows: the quantities that vary, a row each, and the duration.
        """
        found: dict[int, str] = {}
        with np.errstate(all="ignore"):
            if rows.shape[1] > 0 and not self._accepts(lambda k: rows[k]):
                suspect = self._outside(rows)
                for k in np.flatnonzero(suspect):
                    self._search(rows, np.array([k]), found)
                self._search(rows, np.flatnonzero(~suspect), found)
        return found

    def _accepts(self, value: Callable[[int], Any]) -> bool:
        """Tell whether a scene with these values is accepted; a user's own class may refuse arrays in any way."""
        try:
            self.scene(value)
        except Exception:
            return False
        return True

    def _outside(self, rows: Array) -> NDArray[np.bool_]:
        """Return which designs have a quantity outside the interval in which it is accepted, all else being sound."""
        suspect = np.zeros(rows.shape[1], dtype=bool)
        for sound in rows.T[:_TRIALS]:
            if self._accepts(sound.tolist().__getitem__):
                break
        else:
            return suspect
        for changed, values in enumerate(rows):

            def accepts(x: Any, changed: int = changed) -> bool:
                return self._accepts(lambda k: x if k == changed else float(sound[k]))

            if not accepts(values):
                # NaN is sorted to the end, where it is refused as too large.
                ordered = np.sort(values)
                middle = int(np.searchsorted(ordered, sound[changed]))
                top = bisect_left(range(middle, len(ordered)), True, key=lambda k: not accepts(float(ordered[k])))
                low = bisect_left(range(middle + 1), True, key=lambda k: accepts(float(ordered[k])))
                suspect |= ~((values >= ordered[low]) & (values <= ordered[middle + top - 1]))
        return suspect

    def _search(self, rows: Array, where: NDArray[np.int64], found: dict[int, str]) -> None:
        """Enter the designs that are refused, by halves of those among which there are some."""
        if len(where) == 0:
            return
        if len(where) == 1:
            try:
                self.scene(lambda k: float(rows[k, where[0]]))
            except PloughError as refusal:
                found[int(where[0])] = str(refusal)
        elif not self._accepts(lambda k: rows[k, where]):
            half = len(where) // 2
            self._search(rows, where[:half], found)
            self._search(rows, where[half:], found)

    def scene(self, value: Callable[[int], Any]) -> Scene:
        """Return the scene with values for the quantities that vary.

        Raises:
            DomainError: a value outside the model's domain.
        """
        varying = iter(range(sum(number is None for number in self._fixed) + 1))
        fixed = iter(self._fixed)

        def filled(_: Any) -> Any:
            number = next(fixed)
            return value(next(varying)) if number is None else number

        scene: Scene = map_expressions(self._template, filled, is_quantity)
        BESIDE["scene.duration"].check(value(next(varying)))
        return scene
