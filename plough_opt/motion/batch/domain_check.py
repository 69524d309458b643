"""Finds the designs of a batch outside the model's domain, by the checks that a single scene has."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import PloughError
from plough_opt.core.expressions import is_quantity, map_expressions, template_of
from plough_opt.core.quantities import BESIDE, QUANTITIES
from plough_opt.motion.batch.engine import Array
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantities_of


class DomainCheck:
    """Builds a scene again with arrays as its quantities, and finds the designs for which that raises an error.

    If the arrays are refused, designs with a quantity outside its own domain are checked one by one, the others by
    halves.
    """

    def __init__(self, template: Scene, fixed: list[float | None]) -> None:
        """Take a scene with placeholders, and for each of them its number, or None if it varies between designs."""
        self._template = template
        self._fixed = fixed
        names = {id(value): name for name, value in quantities_of(template).items() if value is not None}
        placed = zip(template_of(template)[1], fixed, strict=True)
        varying = [QUANTITIES.get(names.get(id(value), "")) for value, number in placed if number is None]
        self._domains = [*varying, BESIDE["scene.duration"]]

    def reasons(self, rows: Array) -> dict[int, str]:
        """Return the reasons why designs are refused, by their position.

        Args:
            rows: the quantities that vary, a row each, and the duration.
        """
        reasons: dict[int, str] = {}
        with np.errstate(all="ignore"):
            if rows.shape[1] > 0 and not self._accepts(lambda k: rows[k]):
                suspect = self._outside(rows)
                for k in np.flatnonzero(suspect):
                    self._search(rows, np.array([k]), reasons)
                self._search(rows, np.flatnonzero(~suspect), reasons)
        return reasons

    def _accepts(self, value: Callable[[int], Any]) -> bool:
        """Return whether a scene with these values is accepted; a user's own class may raise any error for arrays."""
        try:
            self.scene(value)
        except Exception:
            return False
        return True

    def _outside(self, rows: Array) -> NDArray[np.bool_]:
        """Return which designs have a quantity outside its own domain."""
        suspect = np.zeros(rows.shape[1], dtype=bool)
        for values, quantity in zip(rows, self._domains, strict=True):
            if quantity is not None:
                suspect |= ~((values >= quantity.low) & (values <= quantity.high))
        return suspect

    def _search(self, rows: Array, where: NDArray[np.int64], reasons: dict[int, str]) -> None:
        """Enter the reasons of those designs that are refused, by halving."""
        if len(where) == 0:
            return
        if len(where) == 1:
            try:
                self.scene(lambda k: float(rows[k, where[0]]))
            except PloughError as refusal:
                reasons[int(where[0])] = str(refusal)
        elif not self._accepts(lambda k: rows[k, where]):
            half = len(where) // 2
            self._search(rows, where[:half], reasons)
            self._search(rows, where[half:], reasons)

    def scene(self, value: Callable[[int], Any]) -> Scene:
        """Return the scene with values for the quantities that vary.

        Raises:
            DomainError: a value outside the model's domain.
        """
        varying = itertools.count()
        values = iter([value(next(varying)) if number is None else number for number in self._fixed])
        scene: Scene = map_expressions(self._template, lambda _: next(values), is_quantity)
        BESIDE["scene.duration"].check(value(next(varying)))
        return scene
