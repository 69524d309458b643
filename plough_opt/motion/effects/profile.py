"""A strut whose speed varies over time: its table, and its term in the equation.

The deviations of the equation of motion are counted from a strut that keeps its initial speed. The mount feels how far
the true strut is ahead of that, so its acceleration, which jumps at the knots of a table, does not occur.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from plough_opt.core.checks import NOT_NUMBERS, array_of, check_domain, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import COUNT, Expression, where
from plough_opt.core.units import in_si
from plough_opt.motion.effects.terms import Parameters, Term, Towed

# Each piece adds steps to a run, and operations to each of them: a run with so many takes some seconds.
_MOST_PIECES = 200
_TABLE = "a tuple of times [s] and speeds [m/s], such as ([0, 5, 10], [2.0, 1.5, 2.5])"


@dataclass(frozen=True)
class SpeedProfile:
    """Speed of the strut over time relative to the scene's tow speed, with straight lines between its times.

    `po.simulate(scene, duration, tow_speed=...)` makes it of a table.

    Args:
        times: the times [s], rising from 0. After the last one the speed stays as it is.
        speeds: the speed at each time over the tow speed [-], at least 0.

    Raises:
        InputError: the times do not rise from 0, there are more than 201 or not as many speeds, or a speed is below 0
            or not finite.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(tow_profile=po.SpeedProfile((0.0, 2.0), (0.5, 1.0))).tow_profile.times  # from half to full
        (0.0, 2.0)
    """

    times: tuple[float, ...] = field(metadata=COUNT)
    speeds: tuple[float, ...] = field(metadata=COUNT)

    def __post_init__(self) -> None:
        columns = [array_of(getattr(self, name), f"the {name} of a speed profile, {{}}, must be numbers",
                            lambda row: row.ndim == 1) for name in ("times", "speeds")]  # fmt: skip
        times, speeds = columns
        vars(self).update(times=tuple(times.tolist()), speeds=tuple(speeds.tolist()))
        if not (len(times) > 1 and times[0] == 0.0 and np.all(np.diff(times) > 0.0) and np.isfinite(times[-1])):
            raise InputError(f"the times of a speed profile, {shown(self.times)}, must rise from 0: at least two")
        if len(speeds) != len(times) or len(times) > _MOST_PIECES + 1:
            raise InputError(
                f"a speed profile of {len(times)} times has {len(speeds)} speeds: it needs as many of both, at most"
                f" {_MOST_PIECES + 1}; for more integrate scene.equation(controls=('tow_speed',)) yourself"
            )
        if not np.all(speeds >= 0.0) or not np.isfinite(speeds).all():
            wrong = times[np.argmax(~(np.isfinite(speeds) & (speeds >= 0.0)))]
            raise InputError(f"the tow speed must be finite and at least 0 everywhere; at {wrong:.4g} s it is not")

    @property
    def pieces(self) -> int:
        """Number of straight lines."""
        return len(self.times) - 1


def profile_of(table: Any) -> tuple[float, SpeedProfile]:
    """Return the largest tow speed [m/s] and the profile of a table.

    Args:
        table: a tuple of times [s] from 0 on and of speeds [m/s], as numbers or texts with a unit.

    Raises:
        InputError: the argument is something else, or as for `SpeedProfile`.
        DomainError: the speed is nowhere above 0.
    """
    wrong = (
        f"tow_speed = {shown(table)} must be {_TABLE}; give a constant speed to the scene, and a function as a table"
    )
    try:
        rows = [list(row) for row in (table if isinstance(table, Sequence) else array_of(table, wrong).tolist())]
    except NOT_NUMBERS:
        raise InputError(wrong) from None
    sizes = [len(row) for row in rows]
    # Two pairs may also be two columns: only a tuple says which.
    if len(rows) != 2 or sizes[0] != sizes[1] or sizes[0] < 2 or (sizes == [2, 2] and not isinstance(table, tuple)):
        turned = " in two columns: transpose it with tuple(zip(*table))" if set(sizes) == {2} else ""
        raise InputError(f"{wrong}; this one has rows of {sizes} values{turned}")
    times, speeds = (
        [
            plain_number(what, in_si(what, value, unit))
            for row, value in enumerate(column, start=1)
            for what in [f"the {name} in row {row} of tow_speed"]
        ]
        for name, unit, column in (("time", "s", rows[0]), ("speed", "m/s", rows[1]))
    )
    largest = max(speeds)
    check_domain("largest tow speed", largest, "m/s", above=0.0, why="the strut must move at some time")
    return largest, SpeedProfile(tuple(times), tuple(speed / largest for speed in speeds))


@dataclass(frozen=True)
class TowProfile(Term):
    """Strut whose speed follows a profile."""

    profile: SpeedProfile

    field = "tow_profile"
    names = ("speed_pieces",)

    @classmethod
    def of(cls, scene: Towed) -> tuple[TowProfile, ...]:
        profile = scene.effects.tow_profile
        return () if profile is None else (cls(profile),)

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"speed_pieces": float(self.profile.pieces)}

    def start_speed(self, p: Parameters) -> Expression:
        """Return the speed at time 0 [m/s]."""
        return p["tow_speed"] * self.profile.speeds[0]

    def lead(self, p: Parameters, time: Expression) -> tuple[Expression, Expression]:
        """Return how far the strut is ahead [m], and how much faster it is [m/s], than at its initial speed."""
        gains = [speed - self.profile.speeds[0] for speed in self.profile.speeds]
        covered, lines = 0.0, []
        for (begin, end), (first, last) in zip(pairwise(self.profile.times), pairwise(gains), strict=True):
            since, slope = time - begin, (last - first) / (end - begin)
            lines.append((end, covered + since * (first + 0.5 * slope * since), first + slope * since))
            covered += (end - begin) * (first + last) / 2.0
        ahead: Expression = covered + gains[-1] * (time - self.profile.times[-1])
        faster: Expression = gains[-1] + 0.0 * time
        for end, path, gain in reversed(lines):
            ahead, faster = where(time <= end, path, ahead), where(time <= end, gain, faster)
        return p["tow_speed"] * ahead, p["tow_speed"] * faster
