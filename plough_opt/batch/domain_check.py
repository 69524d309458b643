"""Which designs of a batch lie outside the model's domain, and why: the same checks that a single scene has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.batch.program import Array
from plough_opt.domain import check_domain
from plough_opt.errors import PloughError
from plough_opt.expressions import is_quantity, map_expressions
from plough_opt.scene import Scene


class DomainCheck:
    """Rebuilds a scene with arrays for its quantities; where that is refused, with halves of them, down to one."""

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
            self._search(rows, np.arange(rows.shape[1]), found)
        return found

    def _search(self, rows: Array, where: NDArray[np.int64], found: dict[int, str]) -> None:
        if len(where) == 0:
            return
        if len(where) == 1:
            try:
                self.scene(lambda k: float(rows[k, where[0]]))
            except PloughError as refusal:
                found[int(where[0])] = str(refusal)
            return
        try:
            self.scene(lambda k: rows[k, where])
        except Exception:
            # A user's own class may not take arrays, and then says so in any way.
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
        check_domain("duration", value(next(varying)), "s", above=0.0)
        return scene
