"""Why the scenes of many designs lie outside the model's domain."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain, recorded_limits
from plough_opt.core.errors import PloughError
from plough_opt.core.expressions import is_quantity, map_expressions
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import BESIDE
from plough_opt.motion.equation import check_strength
from plough_opt.motion.scene import Scene


class DomainCheck:
    """Rebuilds a scene with the numbers of many designs, and finds those for which that raises an error.

    All designs are tried at once, as arrays, and only those beyond a limit one by one. If arrays fail, as in a class of
    the user's, they are halved.
    """

    def __init__(self, template: Scene, fixed: list[float | None]) -> None:
        """Take the scene to rebuild.

        Args:
            template: the scene with a placeholder for each quantity.
            fixed: the value of each placeholder, or None if it varies between designs.
        """
        numbers = iter(fixed)
        # Parts of the scene that do not vary are built once.
        self._template = map_expressions(
            template, lambda placeholder: placeholder if (number := next(numbers)) is None else number, is_quantity
        )
        self._varying = fixed.count(None)

    def reasons(self, rows: Array, *, declared: bool = True) -> dict[int, str]:
        """Return the positions of the designs outside the domain, each with the reason.

        Args:
            rows: a row for each quantity that varies, then one for the duration; a column for each design.
            declared: whether limits that `check_domain` declares count, or only other errors of a user's class.
        """
        reasons: dict[int, str] = {}
        with np.errstate(all="ignore"):
            for k in self._suspects(rows, np.arange(rows.shape[1]), declared):
                try:
                    with nullcontext() if declared else recorded_limits():
                        self.scene(rows[:, k].tolist().__getitem__)
                except PloughError as error:
                    reasons[int(k)] = str(error)
        return reasons

    def scene(self, value: Callable[[int], Any]) -> Scene:
        """Return the scene with the given values of the quantities that vary.

        Args:
            value: index of such a quantity -> its value; the index after the last one is that of the duration.

        Raises:
            DomainError: a value outside the model's domain.
        """
        values = map(value, range(self._varying))
        scene: Scene = map_expressions(self._template, lambda _: next(values))
        if scene.effects.orbit != "transient":
            check_domain("tow speed", scene.tow_speed, "m/s", above=0.0, why="a standing share has no orbit")
        BESIDE["scene.duration"].check(value(self._varying))
        if scene.soil.density_profile is None:
            scene.check_reaction()
        else:  # a profile accepts no arrays; designs without a compaction front have no finite results anyway
            check_strength(scene.effects.waves)
        return scene

    def _suspects(self, rows: Array, where: NDArray[np.int64], declared: bool) -> NDArray[np.int64]:
        """Return those among some designs that have to be tried one by one."""
        if len(where) <= 1:
            return where
        inside = np.ones(len(where), dtype=bool)
        try:
            with recorded_limits() as limits:
                self.scene(lambda row: rows[row, where])
            for limit, values in limits if declared else ():
                inside &= limit.holds(values)
        except Exception:  # a user's own class may raise any error for arrays
            halves = (self._suspects(rows, part, declared) for part in np.array_split(where, 2))
            return np.concatenate([*halves])
        return where[~inside]
