"""The designs of a batch that lie outside the model's domain, with the reasons."""

from __future__ import annotations

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
from plough_opt.soil.waves import check_strength


class DomainCheck:
    """Rebuilds a scene with the numbers of many designs, and finds those for which that raises an error.

    All designs are tried at once, as arrays. If that fails, designs with a quantity outside its own domain are checked
    one by one and the others by repeated halving.
    """

    def __init__(self, template: Scene, fixed: list[float | None]) -> None:
        """Take the scene to rebuild.

        Args:
            template: the scene with a placeholder for each quantity.
            fixed: the value of each placeholder, or None if it varies between designs.
        """
        self._template = template
        self._fixed = fixed
        names = {id(value): name for name, value in quantities_of(template).items() if value is not None}
        placeholders = zip(template_of(template)[1], fixed, strict=True)
        varying = [QUANTITIES.get(names.get(id(value), "")) for value, number in placeholders if number is None]
        self._domains = [*varying, BESIDE["scene.duration"]]

    def reasons(self, rows: Array) -> dict[int, str]:
        """Return the positions of the designs outside the domain, each with the reason.

        Args:
            rows: a row for each quantity that varies, then one for the duration; a column for each design.
        """
        reasons: dict[int, str] = {}
        with np.errstate(all="ignore"):
            if rows.shape[1] > 0 and not self._accepts(lambda k: rows[k]):
                suspect = self._outside(rows)
                for k in np.flatnonzero(suspect):
                    self._search(rows, np.array([k]), reasons)
                self._search(rows, np.flatnonzero(~suspect), reasons)
        return reasons

    def scene(self, value: Callable[[int], Any]) -> Scene:
        """Return the scene with the given values of the quantities that vary.

        Args:
            value: index of such a quantity -> its value; the index after the last one is that of the duration.

        Raises:
            DomainError: a value outside the model's domain.
        """
        varying = itertools.count()
        values = iter([value(next(varying)) if number is None else number for number in self._fixed])
        scene: Scene = map_expressions(self._template, lambda _: next(values), is_quantity)
        BESIDE["scene.duration"].check(value(next(varying)))
        if scene.soil.density_profile is None:
            scene.check_reaction()
        else:  # a profile accepts no arrays; designs without a compaction front have no finite results anyway
            check_strength(scene.effects.waves)
        return scene

    def _accepts(self, value: Callable[[int], Any]) -> bool:
        """Return True if the scene can be built; a user's own class may raise any error for arrays."""
        try:
            self.scene(value)
        except Exception:
            return False
        return True

    def _outside(self, rows: Array) -> NDArray[np.bool_]:
        """Return a mask of the designs with a quantity outside its own domain."""
        outside = np.zeros(rows.shape[1], dtype=bool)
        for values, quantity in zip(rows, self._domains, strict=True):
            if quantity is not None:
                outside |= ~((values >= quantity.low) & (values <= quantity.high))
        return outside

    def _search(self, rows: Array, where: NDArray[np.int64], reasons: dict[int, str]) -> None:
        """Enter the reasons of those among some designs that cannot be built, by repeated halving."""
        if len(where) == 0:
            return
        if len(where) == 1:
            try:
                self.scene(lambda k: float(rows[k, where[0]]))
            except PloughError as error:
                reasons[int(where[0])] = str(error)
        elif not self._accepts(lambda k: rows[k, where]):
            half = len(where) // 2
            self._search(rows, where[:half], reasons)
            self._search(rows, where[half:], reasons)
